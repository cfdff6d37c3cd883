//! The antennas of a recording and what they add to its observations.

use std::path::PathBuf;

use clap::Args;

use crate::config::{Mode, PositioningOptions, Profile};
use crate::gnss::{
    AntennaCalibration, AntennaCatalogue, Ecef, Epoch, Navigation, Signal, split_antenna_name,
};
use crate::positioning::{Aiding, Estimator, correct_for_antenna};

/// The argument that names phase centres.
#[derive(Clone, Debug, Args)]
pub(crate) struct AntennaArguments {
    /// Phase centres of antennas (ANTEX); the headers name the antennas of rover and base.
    #[arg(long, value_name = "FILE")]
    pub(crate) antex: Option<PathBuf>,
}

/// The antenna of one receiver.
pub(crate) struct ReceiverAntenna {
    /// "rover" or "base".
    whose: &'static str,
    name: String,
    calibration: Option<AntennaCalibration>,
    uncalibrated: Vec<Signal>,
    /// Epochs before the receiver's place was known.
    unplaced: u64,
}

impl ReceiverAntenna {
    /// The antenna that a header names, looked up.
    pub(crate) fn new(whose: &'static str, name: &str, catalogue: &AntennaCatalogue) -> Self {
        Self {
            whose,
            name: name.to_owned(),
            calibration: catalogue.receiver(name, "").cloned(),
            uncalibrated: Vec::new(),
            unplaced: 0,
        }
    }

    /// Brings the observations to the antenna reference point.
    pub(crate) fn correct(
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
            (Some(_), None) => self.unplaced += 1,
            (None, _) => {}
        }
    }

    /// What was done, and what was not.
    pub(crate) fn notes(&self) -> Vec<String> {
        let (antenna, radome) = split_antenna_name(&self.name);
        let whose = self.whose;
        let Some(calibration) = &self.calibration else {
            let name = if antenna.is_empty() { "unnamed".to_owned() } else { self.name.clone() };
            return vec![format!(
                "warning: {whose}: antenna {name} is not in the ANTEX file; its observations are \
                 not corrected"
            )];
        };
        let bands = calibration.patterns.len();
        let mut notes = vec![format!(
            "{whose}: antenna {antenna} {radome}, phase centres on {bands} frequencies"
        )];
        if !self.uncalibrated.is_empty() {
            let names: Vec<_> = self.uncalibrated.iter().map(Signal::to_string).collect();
            let names = names.join(", ");
            notes.push(format!("warning: {whose}: not calibrated, not corrected: {names}"));
        }
        if 0 < self.unplaced {
            let count = self.unplaced;
            notes.push(format!(
                "warning: {whose}: {count} epochs are not corrected: no position was known"
            ));
        }
        notes
    }
}

/// Where a rover is, from its own pseudoranges, for the directions of its satellites.
pub(crate) struct Whereabouts {
    single_point: Estimator,
    position: Option<Ecef>,
}

impl Whereabouts {
    /// From the header's position, if it has one.
    pub(crate) fn new(position: Option<Ecef>) -> Self {
        let options = PositioningOptions::new(Mode::Spp, Profile::General);
        Self { single_point: Estimator::new(options), position }
    }

    /// The place at an epoch; the last one where the epoch gives none.
    pub(crate) fn at(&mut self, epoch: &Epoch, navigation: &Navigation) -> Option<Ecef> {
        let solution = self.single_point.advance(epoch, &Aiding::alone(navigation));
        self.position = solution.estimate.map(|estimate| estimate.position).or(self.position);
        self.position
    }
}
