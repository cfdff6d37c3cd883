//! A pseudorange factor with what names it.

use crate::gnss::{EphemerisIssue, LocalFrame, SatelliteId};

use crate::snapshot::snapshot_fields;

use super::Measurement;
use super::factors::{PseudorangeFactor, Sight, State};

/// A pseudorange with what names it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Ranging {
    pub(super) factor: PseudorangeFactor,
    pub(super) satellite: SatelliteId,
    pub(super) ephemeris: EphemerisIssue,
    /// Place of its inter-system bias among all; `None` for the reference constellation.
    pub(super) bias: Option<usize>,
    /// Standard deviation of what the ionosphere's model puts into it (m).
    pub(super) ionosphere_m: f64,
    /// Standard deviation of what the troposphere's does (m).
    pub(super) troposphere_m: f64,
}

impl Ranging {
    /// Of a placed measurement.
    pub(super) fn new(frame: &LocalFrame, measurement: &Measurement, bias: Option<usize>) -> Self {
        let factor = PseudorangeFactor {
            sight: Sight::new(frame, measurement.state.position),
            corrected_range_m: measurement.corrected_range_m,
            inverse_sigma: measurement.variance_m2.sqrt().recip(),
        };
        Self {
            factor,
            satellite: measurement.satellite,
            ephemeris: measurement.ephemeris,
            bias,
            ionosphere_m: measurement.ionosphere_share_m,
            troposphere_m: measurement.troposphere_share_m,
        }
    }

    /// The bias in force (m), of all of them.
    pub(super) fn bias_m(&self, biases_m: &[f64]) -> f64 {
        self.bias.map_or(0.0, |variable| biases_m[variable])
    }

    /// Measured less predicted (m).
    pub(super) fn miss_m(&self, state: &State, biases_m: &[f64]) -> f64 {
        let row = self.factor.linearize(state, self.bias_m(biases_m));
        -row.residual / self.factor.inverse_sigma
    }
}

snapshot_fields!(Ranging { factor, satellite, ephemeris, bias, ionosphere_m, troposphere_m });

/// The lower median; `None` of nothing. Reorders.
pub(super) fn median(values: &mut [f64]) -> Option<f64> {
    let middle = values.len().checked_sub(1)? / 2;
    Some(*values.select_nth_unstable_by(middle, f64::total_cmp).1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_median_is_one_of_the_values() {
        assert_eq!(median(&mut [3.0, -1.0, 7.0, 2.0]), Some(2.0));
        assert_eq!(median(&mut [3.0, -1.0, 7.0]), Some(3.0));
        assert_eq!(median(&mut []), None);
    }
}
