//! The sources of a recording's positions.

use crate::formats::observations::LeftOut;
use crate::gnss::{BaseSite, Ecef, PositionSource, Signal};

/// The decisions about a recording, and its skipped content.
#[derive(Clone, Debug)]
pub struct Provenance {
    /// Position of the base and its source, in modes relative to one.
    pub base: Option<BaseProvenance>,
    /// Whether there is a base that the mode does not use.
    pub is_base_unused: bool,
    /// The antennas that were looked up, the base's first.
    pub antennas: Vec<AntennaProvenance>,
    /// Number of the rover's epochs that are left out because the epochs after them are earlier.
    pub out_of_time: u64,
    /// Number of rows of odometry without an epoch, if there is odometry.
    pub unmatched_odometry: Option<usize>,
    /// Skipped content of each file, the rover's first.
    pub left_out: Vec<(String, LeftOut)>,
}

/// Position of the base.
#[derive(Clone, Debug, PartialEq)]
pub struct BaseProvenance {
    /// Marker, antenna and the source of the position.
    pub site: BaseSite,
    /// Number of single-point positions of which the base's position is the mean; zero if another
    /// source gives it.
    pub averaged: u64,
    /// Number of times that messages, as with virtual bases, or header records moved the base.
    pub moves: u64,
}

/// Antenna corrections of one receiver.
#[derive(Clone, Debug, PartialEq)]
pub struct AntennaProvenance {
    /// "rover" or "base".
    pub receiver: &'static str,
    /// Type; empty if unknown.
    pub antenna: String,
    /// Radome.
    pub radome: String,
    /// Type and radome as header or message contain them.
    pub name: String,
    /// Number of frequencies with a calibrated phase centre; `None` if the antenna is not
    /// calibrated.
    pub frequencies: Option<usize>,
    /// Signals without a calibration, which were not corrected.
    pub uncalibrated: Vec<Signal>,
    /// Number of epochs that were not corrected because the receiver's position was unknown.
    pub unplaced_epochs: u64,
}

impl Provenance {
    /// The same of positions that are not relative to the base.
    pub(super) fn without_base(mut self) -> Self {
        self.is_base_unused = self.base.take().is_some();
        self.antennas.retain(|antenna| antenna.receiver != "base");
        self
    }

    /// The provenance as lines of text; lines that need attention begin with "warning: ".
    pub fn lines(&self) -> Vec<String> {
        let mut lines = Vec::new();
        if let Some(base) = &self.base {
            lines.push("positions are of the rover's antenna reference point".to_owned());
            lines.extend(base.lines());
        }
        if self.is_base_unused {
            lines.push("base: not used, as the mode is not relative to one".to_owned());
        }
        lines.extend(self.antennas.iter().flat_map(AntennaProvenance::lines));
        if 0 < self.out_of_time {
            lines.push(format!(
                "warning: rover: {} epochs are left out: they are dated later than the epochs \
                 after them",
                self.out_of_time
            ));
        }
        if let Some(rows) = self.unmatched_odometry {
            lines.push(format!("odometry: {rows} rows without an epoch"));
        }
        lines
    }
}

impl BaseProvenance {
    fn lines(&self) -> Vec<String> {
        let Ecef(marker) = self.site.marker;
        let [height_m, east_m, north_m] = self.site.antenna_delta_hen_m;
        let source = match self.site.source {
            PositionSource::Given => "as given",
            PositionSource::Header => "from its header",
            PositionSource::Message => "from its messages 1005 and 1006",
            PositionSource::SinglePoints => "from its own single-point positions",
        };
        let mut lines = vec![format!(
            "base: marker at {:.4},{:.4},{:.4} (ECEF, m) {source}, antenna reference point \
             {height_m:.4} m above, {east_m:.4} m east, {north_m:.4} m north of it",
            marker.x, marker.y, marker.z
        )];
        if self.site.source == PositionSource::SinglePoints {
            lines.push(format!(
                "warning: base: no source gives its position; the mean of {} single-point \
                 positions may be metres off, and all positions relative to it by as much",
                self.averaged
            ));
        }
        if 0 < self.moves {
            lines.push(format!(
                "base: its file moved it {} times; each epoch uses the position of its time",
                self.moves
            ));
        }
        lines
    }
}

impl AntennaProvenance {
    fn lines(&self) -> Vec<String> {
        let Self { receiver, antenna, radome, .. } = self;
        let Some(frequencies) = self.frequencies else {
            let name = if antenna.is_empty() { "unnamed" } else { &self.name };
            return vec![format!(
                "warning: {receiver}: antenna {name} is not in the ANTEX file; its observations \
                 are not corrected"
            )];
        };
        let mut lines = vec![format!(
            "{receiver}: antenna {antenna} {radome}, phase centres on {frequencies} frequencies"
        )];
        if !self.uncalibrated.is_empty() {
            let names: Vec<_> = self.uncalibrated.iter().map(Signal::to_string).collect();
            let names = names.join(", ");
            lines.push(format!("warning: {receiver}: not calibrated, not corrected: {names}"));
        }
        if 0 < self.unplaced_epochs {
            lines.push(format!(
                "warning: {receiver}: {} epochs are not corrected: no position was known",
                self.unplaced_epochs
            ));
        }
        lines
    }
}
