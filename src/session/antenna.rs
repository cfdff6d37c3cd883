//! Antenna corrections of a session: the estimator receives observations that refer to the antenna
//! reference points. The store keeps the observations as received.

use crate::aiding::bases::BaseInput;
use crate::gnss::{AntennaCalibration, Epoch, Navigation};
use crate::positioning::correct_for_antenna;
use crate::recording::ApproximatePosition;

/// An epoch of the rover and the base's epochs, corrected to the antenna reference points: the
/// rover's with `calibration`, the base's with the calibration of its own antenna, if it has one.
pub(super) fn corrected(
    calibration: &AntennaCalibration,
    position: &mut ApproximatePosition,
    epoch: &Epoch,
    navigation: &Navigation,
    base: Option<&BaseInput>,
) -> (Epoch, Option<BaseInput>) {
    let mut rover = epoch.clone();
    if let Some(position) = position.at(epoch, navigation) {
        correct_for_antenna(&mut rover, calibration, position, navigation, &mut Vec::new());
    }
    let mut base = base.cloned();
    if let Some(base) = &mut base {
        base.correct_for_antenna(navigation);
    }
    (rover, base)
}
