//! Start values of estimators, and limits beyond which they start again.

use crate::gnss::constants::WGS84_SEMI_MAJOR_AXIS;
use crate::gnss::{Ecef, LocalFrame};

use super::pseudorange_error::WILD_M;
use crate::graph::median;

/// Standard deviation of the first position about its start (m): much wider than any measurement's.
pub(super) const START_M: f64 = 1e4;
/// Standard deviation of the first velocity about its start, per axis (m/s).
pub(super) const START_M_S: f64 = 100.0;
/// Standard deviation of the first clock about the median of the pseudoranges (m).
pub(super) const START_CLOCK_M: f64 = 1e5;
/// Standard deviation of an inter-system bias before it is measured (m): 1 µs.
pub(super) const START_BIAS_M: f64 = 300.0;
/// Standard deviation of the velocity between epochs without Doppler (m/s).
pub(super) const UNKNOWN_SPEED_M_S: f64 = 50.0;
/// Distance from the frame's origin at which an estimator restarts (m): the vertical has turned by
/// 1°.
pub(super) const FRAME_LIMIT_M: f64 = 1e5;
/// Time for which most pseudoranges may fail the test before a filter restarts (s).
pub(super) const FAILING_MAX_S: f64 = 10.0;
/// Minimum number of epochs in a window, however far apart they are: with fewer, an epoch is
/// marginalised before others have shown which of its pseudoranges are reflections.
pub(super) const WINDOW_EPOCHS_MIN: usize = 5;

/// Smallest number of pseudoranges of which most can refute a position: one more than the unknowns.
const REFUTING_MIN: usize = 5;

/// Whether most of these pseudorange residuals are farther from their median, the clock, than any
/// multipath. The position is then not the receiver's, wherever the phases have led it.
pub(super) fn are_refuting(residuals_m: &mut [f64]) -> bool {
    let Some(clock_m) = median(residuals_m).filter(|_| REFUTING_MIN <= residuals_m.len()) else {
        return false;
    };
    let far = residuals_m.iter().filter(|residual_m| WILD_M < (*residual_m - clock_m).abs());
    residuals_m.len() < 2 * far.count()
}

/// A local frame, used before any position is known.
pub(super) fn start_frame() -> LocalFrame {
    LocalFrame::at(Ecef::new(WGS84_SEMI_MAJOR_AXIS, 0.0, 0.0))
}

#[cfg(test)]
mod tests {
    /// The clock is 7 km off. Reflections are late by less than 440 m.
    #[test]
    fn only_most_of_the_pseudoranges_refute_a_position() {
        let are_refuting = |off_m: &[f64]| {
            super::are_refuting(&mut off_m.iter().map(|off_m| 7e3 + off_m).collect::<Vec<_>>())
        };
        assert!(!are_refuting(&[0.0, 400.0, 300.0, -2.0, 410.0, 5.0]));
        assert!(!are_refuting(&[0.0, 1.0, 2.0, 5e3, -3e4, 1e6]), "three wild pseudoranges");
        assert!(are_refuting(&[-1900.0, -900.0, 300.0, 900.0, 1600.0, 2000.0]));
        assert!(!are_refuting(&[-1900.0, -900.0, 900.0, 1600.0]), "no redundancy");
        assert!(!are_refuting(&[]));
    }
}
