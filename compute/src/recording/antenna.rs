//! Corrections of a recording's observations for the phase centres of its antennas.

use crate::config::{Mode, PositioningOptions, Profile};
use crate::gnss::{
    AntennaCalibration, AntennaCatalogue, Ecef, Epoch, GpsTime, Navigation, Signal,
    split_antenna_name,
};
use crate::positioning::{Aiding, Estimator, correct_for_antenna};
use crate::snapshot::snapshot_fields;

use super::AntennaProvenance;

/// Age after which a single-point position is computed again (s).
const LASTS_S: f64 = 60.0;

/// The antenna of one receiver.
pub(super) struct ReceiverAntenna {
    /// "rover" or "base".
    receiver: &'static str,
    name: String,
    calibration: Option<AntennaCalibration>,
    uncalibrated: Vec<Signal>,
    /// Epochs before the receiver's position was known.
    unplaced_epochs: u64,
}

impl ReceiverAntenna {
    /// The antenna that a header or message names, looked up in the catalogue.
    pub(super) fn new(receiver: &'static str, name: &str, catalogue: &AntennaCatalogue) -> Self {
        Self {
            receiver,
            name: name.to_owned(),
            calibration: catalogue.receiver(name, "").cloned(),
            uncalibrated: Vec::new(),
            unplaced_epochs: 0,
        }
    }

    /// Corrects the observations to the antenna reference point.
    pub(super) fn correct(
        &mut self,
        epoch: &mut Epoch,
        position: Option<Ecef>,
        navigation: &Navigation,
    ) {
        match (&self.calibration, position) {
            (Some(calibration), Some(position)) => correct_for_antenna(
                epoch,
                calibration,
                position,
                navigation,
                &mut self.uncalibrated,
            ),
            (Some(_), None) => self.unplaced_epochs += 1,
            (None, _) => {}
        }
    }

    /// Signals that were corrected, and signals that were not.
    pub(super) fn provenance(&self) -> AntennaProvenance {
        let (antenna, radome) = split_antenna_name(&self.name);
        AntennaProvenance {
            receiver: self.receiver,
            antenna: antenna.to_owned(),
            radome: radome.to_owned(),
            name: self.name.clone(),
            frequencies: self.calibration.as_ref().map(|known| known.patterns.len()),
            uncalibrated: self.uncalibrated.clone(),
            unplaced_epochs: self.unplaced_epochs,
        }
    }
}

/// The rover's approximate position, to a few kilometres, for the directions of antenna
/// corrections: an error of 1 km turns a direction by 5·10⁻⁵ rad, which changes the correction of a
/// phase centre 10 cm from the antenna reference point by 5 µm.
///
/// It is a single-point position, computed again after a minute.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ApproximatePosition {
    position: Option<Ecef>,
    /// Time of the single-point position; `None` where a header or message reports the position.
    since: Option<GpsTime>,
}

snapshot_fields!(ApproximatePosition { position, since });

impl ApproximatePosition {
    /// `reported` is used until there is a single-point position.
    pub const fn new(reported: Option<Ecef>) -> Self {
        Self { position: reported, since: None }
    }

    /// The position at an epoch; the last position if the epoch gives none.
    pub fn at(&mut self, epoch: &Epoch, navigation: &Navigation) -> Option<Ecef> {
        if self.since.is_none_or(|since| LASTS_S < epoch.time - since) {
            let options = PositioningOptions::new(Mode::Spp, Profile::General);
            let solution = Estimator::new(options).advance(epoch, &Aiding::alone(navigation));
            if let Some(estimate) = solution.estimate {
                (self.position, self.since) = (Some(estimate.position), Some(epoch.time));
            }
        }
        self.position
    }
}
