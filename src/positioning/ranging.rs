//! The satellites that an epoch sees, and its pseudorange factors with what names them.

use crate::gnss::{Ecef, EphemerisIssue, GpsTime, LocalFrame, SatelliteId};
use crate::graph::Row;
use crate::snapshot::snapshot_fields;

use super::Measurement;
use super::factors::{DopplerFactor, Line, PseudorangeFactor, Sight, State};
use super::velocity::{CN0_IF_MISSING_DB_HZ, variance_m2_s2};

/// The measurements above the mask, each with the place of its satellite among the epoch's sights.
pub(super) fn sighted(list: &[Measurement]) -> impl Iterator<Item = (u16, &Measurement)> {
    (0..).zip(list.iter().filter(|measurement| measurement.is_above_mask))
}

/// One sight for each measurement above the mask, in their order, into `sights`.
pub(super) fn look(frame: &LocalFrame, list: &[Measurement], sights: &mut Vec<Sight>) {
    sights.clear();
    sights.extend(sighted(list).map(|(_, m)| Sight::new(frame, m.state.position)));
}

/// Doppler rows, in the frame, of a receiver about at `receiver`, of the measurements above the
/// mask; `sigma_m_s` is their standard deviation at the reference C/N0.
pub(super) fn rates<'a>(
    list: impl Iterator<Item = &'a Measurement>,
    frame: &LocalFrame,
    receiver: Ecef,
    sigma_m_s: f64,
) -> impl Iterator<Item = DopplerFactor> {
    list.filter(|m| m.is_above_mask && !m.is_excluded).filter_map(move |measurement| {
        let cn0_db_hz = measurement.cn0_db_hz.unwrap_or(CN0_IF_MISSING_DB_HZ);
        let sigma_m_s = variance_m2_s2(sigma_m_s, cn0_db_hz).sqrt();
        let rate_m_s = measurement.range_rate_m_s?;
        Some(DopplerFactor::new(frame, receiver, &measurement.state, rate_m_s, sigma_m_s))
    })
}

/// A pseudorange with what names it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Ranging {
    pub(super) factor: PseudorangeFactor,
    /// Place of its satellite among the epoch's sights.
    pub(super) sight: u16,
    pub(super) satellite: SatelliteId,
    /// Time and issue of its ephemeris.
    pub(super) toe: GpsTime,
    pub(super) issue: u32,
    /// Place of its inter-system bias among all; `None` for the reference constellation.
    pub(super) bias: Option<u32>,
    /// Standard deviation of what the ionosphere's model puts into it (m).
    pub(super) ionosphere_m: f64,
    /// Standard deviation of what the troposphere's does (m).
    pub(super) troposphere_m: f64,
}

impl Ranging {
    /// Of a placed measurement, its satellite at place `sight`.
    pub(super) fn new(sight: u16, measurement: &Measurement, bias: Option<u32>) -> Self {
        let factor = PseudorangeFactor {
            corrected_range_m: measurement.corrected_range_m,
            inverse_sigma: measurement.variance_m2.sqrt().recip(),
        };
        Self {
            factor,
            sight,
            satellite: measurement.satellite,
            toe: measurement.ephemeris.toe,
            issue: measurement.ephemeris.issue,
            bias,
            ionosphere_m: measurement.ionosphere_share_m,
            troposphere_m: measurement.troposphere_share_m,
        }
    }

    /// Its ephemeris.
    pub(super) fn ephemeris(&self) -> EphemerisIssue {
        EphemerisIssue { satellite: self.satellite, toe: self.toe, issue: self.issue }
    }

    /// The bias in force (m), of all of them.
    pub(super) fn bias_m(&self, biases_m: &[f64]) -> f64 {
        self.bias.map_or(0.0, |variable| biases_m[variable as usize])
    }

    /// Whitened residual and its Jacobian on [p; b], of the epoch's lines of sight.
    #[inline]
    pub(super) fn linearize(&self, lines: &[Line], state: &State, biases_m: &[f64]) -> Row<4> {
        self.factor.linearize(&lines[usize::from(self.sight)], state, self.bias_m(biases_m))
    }

    /// Measured less predicted (m).
    pub(super) fn miss_m(&self, lines: &[Line], state: &State, biases_m: &[f64]) -> f64 {
        let row = self.linearize(lines, state, biases_m);
        -row.residual / self.factor.inverse_sigma
    }
}

snapshot_fields!(Ranging {
    factor,
    sight,
    satellite,
    toe,
    issue,
    bias,
    ionosphere_m,
    troposphere_m,
});

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
