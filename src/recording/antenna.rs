//! The antennas of a recording: what their phase centres add to observations is taken off.

use crate::config::{Mode, PositioningOptions, Profile};
use crate::gnss::{
    AntennaCalibration, AntennaCatalogue, Ecef, Epoch, Navigation, Signal, split_antenna_name,
};
use crate::positioning::{Aiding, Estimator, correct_for_antenna};

use super::AntennaProvenance;

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

    /// Brings the observations to the antenna reference point.
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

    /// What was corrected, and what was not.
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

/// The rover's position to some metres, from its own pseudoranges: it gives the directions in which
/// antenna corrections are taken.
pub struct ApproximatePosition {
    single_point: Estimator,
    position: Option<Ecef>,
}

impl ApproximatePosition {
    /// `reported` serves until there is a single-point position.
    pub fn new(reported: Option<Ecef>) -> Self {
        let options = PositioningOptions::new(Mode::Spp, Profile::General);
        Self { single_point: Estimator::new(options), position: reported }
    }

    /// The position at an epoch; the last one where the epoch gives none.
    pub fn at(&mut self, epoch: &Epoch, navigation: &Navigation) -> Option<Ecef> {
        let solution = self.single_point.advance(epoch, &Aiding::alone(navigation));
        self.position = solution.estimate.map(|estimate| estimate.position).or(self.position);
        self.position
    }
}
