//! The factors of one epoch.

use nalgebra::{Matrix3, SVector, Vector3};

use crate::config::PositioningOptions;
use crate::gnss::{Ecef, Enu, GpsTime, LocalFrame};
use crate::graph::{Estimate, Kernel, Prior, Problem, Row, System, Widening};
use crate::positioning::differencing::{SingleDifference, SingleDifferences};
use crate::positioning::factors::{DopplerVelocityFactor, Line, Sight};
use crate::positioning::measurements::receiver_weights;
use crate::positioning::velocity::VelocityEstimator;
use crate::snapshot::{snapshot_fields, state_fields};

/// Numbers in a state: local position (m).
pub(crate) const STATE: usize = 3;

/// The state of one epoch.
pub(crate) type State = SVector<f64, STATE>;

/// Kernel of pseudoranges (GraphGNSSLib).
const KERNEL: Kernel = Kernel::huber(1.0);

/// A difference of two receivers and two satellites, (15) and (16).
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct DoubleDifference {
    /// Indices in [`PaperEpoch::sights`]: the satellite, and the highest one of its signal.
    pub(crate) sight: usize,
    pub(crate) reference: usize,
    /// Pseudorange, or carrier phase times λ (m).
    pub(crate) range_m: f64,
    /// Variances of the single differences of both satellites (m²).
    pub(crate) variances_m2: [f64; 2],
    /// λ (m).
    pub(crate) wavelength_m: f64,
    /// Number of its signal. Differences of one signal share the reference's error.
    pub(crate) signal: usize,
}

impl DoubleDifference {
    /// ρ of the satellite minus that of the reference (m), and its derivative by the position.
    pub(crate) fn model(&self, lines: &[Line]) -> Line {
        let ((own_m, own), (reference_m, reference)) = (lines[self.sight], lines[self.reference]);
        (own_m - reference_m, own - reference)
    }

    /// (19) to (21): r = (h − z) / σ.
    fn linearize(&self, lines: &[Line]) -> Row<3> {
        let (range_m, slope) = self.model(lines);
        let inverse_sigma = (self.variances_m2[0] + self.variances_m2[1]).sqrt().recip();
        let jacobian = [slope.x, slope.y, slope.z].map(|d| d * inverse_sigma);
        Row { residual: (range_m - self.range_m) * inverse_sigma, columns: [0, 1, 2], jacobian }
    }
}

/// One epoch.
#[derive(Debug)]
pub(crate) struct PaperEpoch {
    pub(crate) time: GpsTime,
    pub(crate) sights: Vec<Sight>,
    pub(crate) ranges: Vec<DoubleDifference>,
    pub(crate) phases: Vec<DoubleDifference>,
    /// From the previous epoch.
    pub(crate) tie: Option<DopplerVelocityFactor>,
}

snapshot_fields!(DoubleDifference {
    sight,
    reference,
    range_m,
    variances_m2,
    wavelength_m,
    signal
});
state_fields!(PaperEpoch { time, sights, ranges, phases, tie } checked by is_whole);

impl PaperEpoch {
    /// The epoch with these differences, without a tie.
    pub(crate) fn new(
        time: GpsTime,
        frame: &LocalFrame,
        differences: &SingleDifferences,
        options: &PositioningOptions,
    ) -> Self {
        let satellites = &differences.satellites;
        let weights = receiver_weights(options);
        let pseudorange = |d: &SingleDifference| {
            let common = &satellites[d.common];
            let receiver_m2 = weights.variance_m2(common.look.elevation_rad, common.cn0_db_hz);
            Some((d.pseudorange?.range_m, 2.0 * receiver_m2))
        };
        let carrier = |d: &SingleDifference| {
            let carrier = d.carrier.filter(|_| !d.half_cycle)?;
            Some((carrier.range_m, carrier.variance_m2))
        };
        let sights = satellites.iter().map(|common| Sight::new(frame, common.state.position));
        let (mut ranges, mut phases) = (Vec::new(), Vec::new());
        let groups = differences.list.chunk_by(|a, b| a.group() == b.group());
        for (signal, group) in groups.enumerate() {
            double_differences(signal, group, differences, pseudorange, &mut ranges);
            double_differences(signal, group, differences, carrier, &mut phases);
        }
        // Ambiguities in cycles of different lengths do not cancel: their difference is not an
        // integer.
        let has_one_length = |d: &DoubleDifference| d.wavelength_m.is_finite();
        phases.retain(has_one_length);
        Self { time, sights: sights.collect(), ranges, phases, tie: None }
    }

    fn is_whole(&self) -> bool {
        let known = |d: &DoubleDifference| d.sight.max(d.reference) < self.sights.len();
        self.ranges.iter().chain(&self.phases).all(known)
    }

    /// Lines of sight from a position.
    pub(crate) fn lines(&self, position: &State) -> Vec<Line> {
        self.sights.iter().map(|sight| sight.range(position)).collect()
    }

    /// Adds the factors on this epoch's state alone.
    pub(crate) fn add_to(&self, k: usize, estimate: &Estimate<STATE>, system: &mut System<STATE>) {
        let lines = self.lines(&estimate.states[k]);
        for range in &self.ranges {
            system.add(k, &range.linearize(&lines), &KERNEL);
        }
    }

    /// Adds the link from the previous epoch, state `k`.
    pub(crate) fn add_tie_to(
        &self,
        k: usize,
        estimate: &Estimate<STATE>,
        system: &mut System<STATE>,
    ) {
        if let Some(tie) = &self.tie {
            tie.add_to(k, estimate, system);
        }
    }
}

/// Appends the differences of the measurements of one signal against that of the highest satellite.
/// The wavelength is not a number where the two satellites' differ.
fn double_differences(
    signal: usize,
    group: &[SingleDifference],
    differences: &SingleDifferences,
    measured: impl Fn(&SingleDifference) -> Option<(f64, f64)>,
    list: &mut Vec<DoubleDifference>,
) {
    let elevation_rad = |d: &SingleDifference| differences.satellites[d.common].look.elevation_rad;
    let with = || group.iter().filter_map(|d| Some((d, measured(d)?)));
    let highest = with().max_by(|(a, _), (b, _)| elevation_rad(a).total_cmp(&elevation_rad(b)));
    let Some((reference, (reference_m, reference_m2))) = highest else { return };
    list.extend(with().filter(|(d, _)| d.common != reference.common).map(
        |(d, (own_m, own_m2))| {
            let is_same = d.frequency_hz == reference.frequency_hz;
            DoubleDifference {
                sight: d.common,
                reference: reference.common,
                range_m: own_m - reference_m,
                variances_m2: [own_m2, reference_m2],
                wavelength_m: if is_same { d.wavelength_m() } else { f64::NAN },
                signal,
            }
        },
    ));
}

/// The local velocity from the rover's Doppler by plain least squares, (2) to (6), with its
/// covariance; `None` if the Doppler does not determine it.
pub(crate) fn doppler_velocity(
    frame: &LocalFrame,
    position: &State,
    differences: &SingleDifferences,
    options: &PositioningOptions,
    estimator: &mut VelocityEstimator,
) -> Option<(Vector3<f64>, Matrix3<f64>)> {
    let at: Ecef = frame.to_ecef(Enu(*position));
    let is_used = |common: usize| differences.list.iter().any(|d| d.common == common);
    let used = differences.satellites.iter().enumerate().filter(|(common, _)| is_used(*common));
    let rates = used.filter_map(|(_, common)| {
        Some((&common.state, common.range_rate?.rate_m_s, common.cn0_db_hz))
    });
    let velocity = estimator.estimate_rates(at, rates, options)?;
    let rotation = &frame.rotation;
    Some((rotation * velocity.velocity_m_s, rotation * velocity.covariance * rotation.transpose()))
}

/// Epochs in order of time, with the prior of the first, as a problem of the solver.
pub(crate) struct Rows<'a> {
    pub(crate) epochs: &'a [PaperEpoch],
    pub(crate) prior: &'a Prior<STATE>,
}

impl Problem<STATE> for Rows<'_> {
    fn linearize(&mut self, estimate: &Estimate<STATE>, _: Widening, system: &mut System<STATE>) {
        self.prior.add_to(0, estimate, system);
        for (k, epoch) in self.epochs.iter().enumerate() {
            epoch.add_to(k, estimate, system);
            if 0 < k {
                epoch.add_tie_to(k - 1, estimate, system);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gnss::Ecef;

    fn sights() -> (LocalFrame, [Sight; 2]) {
        let frame = LocalFrame::at(Ecef::new(6_378_137.0, 0.0, 0.0));
        let sight = |direction: Vector3<f64>| {
            Sight::new(&frame, frame.to_ecef(Enu(direction.normalize() * 2.2e7)))
        };
        let sights = [sight(Vector3::new(1.0, 0.0, 1.0)), sight(Vector3::z())];
        (frame, sights)
    }

    fn difference(range_m: f64) -> DoubleDifference {
        DoubleDifference {
            sight: 0,
            reference: 1,
            range_m,
            variances_m2: [3.0, 1.0],
            wavelength_m: 0.19,
            signal: 0,
        }
    }

    /// 1 m to the east of the frame's origin: a satellite in the east at 45° is nearer by √½ m, one
    /// at the zenith is not; over 2 m, whose square is 3 + 1.
    #[test]
    fn a_double_difference_worked_by_hand() {
        let (_, sights) = sights();
        let lines = |at: Vector3<f64>| sights.map(|sight| sight.range(&at));
        let (origin_m, _) = difference(0.0).model(&lines(Vector3::zeros()));
        let row = difference(origin_m).linearize(&lines(Vector3::x()));
        assert!((row.residual + 0.5_f64.sqrt() / 2.0).abs() < 1e-6, "{}", row.residual);
    }

    #[test]
    fn the_jacobian_is_the_derivative() {
        let (_, sights) = sights();
        let at = Vector3::new(30.0, -20.0, 5.0);
        let row = |at: Vector3<f64>| difference(7.0).linearize(&sights.map(|s| s.range(&at)));
        for axis in 0..3 {
            let step = Vector3::ith(axis, 0.5);
            let slope = row(at + step).residual - row(at - step).residual;
            assert!((row(at).jacobian[axis] - slope).abs() < 1e-6);
        }
    }
}
