//! Start values of estimators, and limits beyond which they start again.

use crate::gnss::constants::WGS84_SEMI_MAJOR_AXIS;
use crate::gnss::{Ecef, LocalFrame};

/// Standard deviation of the first position about its start (m): much wider than any measurement's.
pub(super) const START_M: f64 = 1e4;
/// Standard deviation of the first velocity about its start, per axis (m/s).
pub(super) const START_M_S: f64 = 100.0;
/// Standard deviation of the first clock about the median of the pseudoranges (m).
pub(super) const START_CLOCK_M: f64 = 1e5;
/// Standard deviation of the velocity between epochs without Doppler (m/s).
pub(super) const UNKNOWN_SPEED_M_S: f64 = 50.0;
/// Distance from the frame's origin at which an estimator restarts (m): the vertical has turned by
/// 1°.
pub(super) const FRAME_LIMIT_M: f64 = 1e5;
/// Time for which most pseudoranges may fail the test before a filter restarts (s).
pub(super) const LOST_S: f64 = 10.0;
/// Minimum number of epochs in a window, however far apart they are: with fewer, an epoch is
/// marginalised before others have shown which of its pseudoranges are reflections.
pub(super) const WINDOW_EPOCHS_MIN: usize = 5;

/// A local frame, used before any position is known.
pub(super) fn start_frame() -> LocalFrame {
    LocalFrame::at(Ecef::new(WGS84_SEMI_MAJOR_AXIS, 0.0, 0.0))
}
