//! The integers of one epoch by LAMBDA and the ratio test.

use nalgebra::{DMatrix, DVector, Matrix3};

use crate::config::RtkOptions;
use crate::gnss::Reason;
use crate::lambda::{Options, Partial, Resolver};
use crate::positioning::rtk::ambiguity::{FixedPosition, Joint, Resolution, condition, refusal};

use super::epoch::{DoubleDifference, PaperEpoch, STATE, State};

/// Candidates whose likelihoods make up the stated probability.
const CANDIDATES: usize = 4;
/// Largest number of nodes of the search tree in one epoch.
const NODES_MAX: usize = 20_000;
/// Number of ambiguities for which storage is reserved at first.
const CAPACITY: usize = 32;

/// Searches for the integers of an epoch; its memory is used again.
#[derive(Debug)]
pub(crate) struct PaperIntegers(Resolver);

impl Default for PaperIntegers {
    fn default() -> Self {
        Self(Resolver::with_capacity(CAPACITY))
    }
}

impl PaperIntegers {
    /// The integers of an epoch with this position (m) and its covariance (m²), both local.
    pub(crate) fn resolve(
        &mut self,
        epoch: &PaperEpoch,
        (position, covariance): (&State, &Matrix3<f64>),
        options: &RtkOptions,
    ) -> Resolution {
        let count = epoch.phases.len();
        let unresolved = Resolution::unresolved(count);
        if !options.resolve {
            return unresolved;
        }
        if count < options.fixed_min {
            let (used, needed) = (count, options.fixed_min);
            return unresolved.refused(Reason::TooFewCommonSatellites { used, needed });
        }
        let joint = joint(epoch, position, covariance);
        let lambda = Options {
            success_rate_min: 0.0,
            ratio_min: options.ratio_min,
            probability_min: 0.0,
            scale: None,
            fixed_min: count,
            candidates: CANDIDATES,
            nodes_max: NODES_MAX,
            attempts_max: 1,
        };
        let float = &joint.estimate.as_slice()[STATE..];
        let own = joint.covariance.view((STATE, STATE), (count, count)).into_owned();
        let Ok(found) = self.0.resolve(float, &own, Partial::None, &lambda) else {
            return unresolved.refused(Reason::FixRejected);
        };
        let (ratio, success_rate) = (found.ratio, Some(found.success_rate));
        let resolution = Resolution { ratio, success_rate, ..unresolved };
        if let Some(reason) = refusal(&found, &lambda) {
            return resolution.refused(reason);
        }
        let entries = self.0.fix().entries().iter().flatten();
        let (all, values): (Vec<_>, Vec<_>) = entries.map(|z| *z as f64).enumerate().unzip();
        let Some((fixed, _)) = condition(&joint, &all, &values, &[]) else {
            return resolution.refused(Reason::FixRejected);
        };
        let fixed = FixedPosition {
            position: fixed.estimate.fixed_rows::<STATE>(0).into_owned(),
            covariance: fixed.covariance.fixed_view::<STATE, STATE>(0, 0).into_owned(),
            held: count,
            probability: found.probability.unwrap_or(0.0),
            by_proven: None,
        };
        Resolution { outcome: Ok(fixed), ..resolution }
    }
}

/// The position and the float ambiguities N = (z − h(p)) / λ, (22) and (23), with their covariance.
/// The phases have not determined the position, so their errors are independent of it.
fn joint(epoch: &PaperEpoch, position: &State, covariance: &Matrix3<f64>) -> Joint {
    let (lines, phases) = (epoch.lines(position), &epoch.phases);
    let size = STATE + phases.len();
    // ∂/∂p of the position itself, and of the ambiguities.
    let mut slopes = DMatrix::<f64>::zeros(size, STATE);
    slopes.fill_diagonal(1.0);
    let mut estimate = DVector::zeros(size);
    estimate.fixed_rows_mut::<STATE>(0).copy_from(position);
    for (i, phase) in phases.iter().enumerate() {
        let (range_m, slope) = phase.model(&lines);
        estimate[STATE + i] = (phase.range_m - range_m) / phase.wavelength_m;
        slopes
            .fixed_view_mut::<1, STATE>(STATE + i, 0)
            .tr_copy_from(&(-slope / phase.wavelength_m));
    }
    let mut joint = &slopes * covariance * slopes.transpose();
    for (i, a) in phases.iter().enumerate() {
        for (j, b) in phases.iter().enumerate() {
            joint[(STATE + i, STATE + j)] += noise_cycles2(a, b, i == j);
        }
    }
    Joint { estimate, covariance: joint }
}

/// Covariance of the noise of two phases, or of one with itself (cycles²).
fn noise_cycles2(a: &DoubleDifference, b: &DoubleDifference, is_one: bool) -> f64 {
    let shared_m2 = if a.signal == b.signal { a.variances_m2[1] } else { 0.0 };
    let own_m2 = if is_one { a.variances_m2[0] } else { 0.0 };
    (shared_m2 + own_m2) / (a.wavelength_m * b.wavelength_m)
}
