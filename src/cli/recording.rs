//! The arguments that name a recording, which `solve` and `compare` take.

use std::path::{Path, PathBuf};

use clap::Args;

use crate::gnss::Ecef;
use crate::recording::{BasePosition, RecordingInputs};

use super::files::{self, TimeArguments};

/// The arguments that name a recording.
#[derive(Clone, Debug, Args)]
pub(crate) struct RecordingArguments {
    /// Observations of the rover: RINEX, CRINEX, UBX, RTCM 3 or an Android GnssLogger log,
    /// recognised by their content.
    #[arg(long, value_name = "FILE")]
    pub(crate) rover: PathBuf,
    /// Navigation data: RINEX, or UBX or RTCM 3 with ephemerides; may be repeated. Default: the
    /// ephemerides in the UBX or RTCM 3 data of rover and base.
    #[arg(long, value_name = "FILE", num_args = 1..)]
    nav: Vec<PathBuf>,
    /// Phase centres of antennas (ANTEX); headers and messages name the antennas of rover and base.
    #[arg(long, value_name = "FILE")]
    antex: Option<PathBuf>,
    /// Displacements of another sensor, CSV as simulate writes it; each belongs to the epoch within
    /// 0.05 s of its time.
    #[arg(long, value_name = "FILE")]
    odometry: Option<PathBuf>,
    /// First epoch, GPS seconds of week.
    #[arg(long, value_name = "TOW", allow_negative_numbers = true)]
    from: Option<f64>,
    /// Last epoch, GPS seconds of week.
    #[arg(long, value_name = "TOW", allow_negative_numbers = true)]
    to: Option<f64>,
    #[command(flatten)]
    times: TimeArguments,
    /// Observations of the base, for modes relative to one.
    #[arg(long, value_name = "FILE")]
    base: Option<PathBuf>,
    /// Position of the base's marker, ECEF (m); the antenna offset of the header is added. Default:
    /// the position in the header, or in messages 1005 and 1006 of UBX and RTCM 3 data; without
    /// these, the mean of the base's own single-point positions.
    #[arg(long, value_name = "X,Y,Z|from-header", allow_hyphen_values = true, requires = "base")]
    #[arg(value_parser = base_position)]
    base_position: Option<BasePosition>,
}

fn base_position(text: &str) -> Result<BasePosition, String> {
    if text == "from-header" {
        return Ok(BasePosition::FromHeader);
    }
    let numbers: Result<Vec<f64>, _> = text.split(',').map(|n| n.trim().parse()).collect();
    match numbers.as_deref() {
        Ok([x, y, z]) if [x, y, z].iter().all(|n| n.is_finite()) => {
            Ok(BasePosition::Marker(Ecef::new(*x, *y, *z)))
        }
        _ => Err("expected X,Y,Z in metres, or from-header".to_owned()),
    }
}

impl RecordingArguments {
    /// Whether a base is named.
    pub(crate) const fn has_base(&self) -> bool {
        self.base.is_some()
    }

    /// All files that the arguments name.
    pub(crate) fn files(&self) -> impl Iterator<Item = &Path> {
        let aiding = self.nav.iter().chain(&self.antex).chain(&self.odometry);
        std::iter::once(&self.rover).chain(&self.base).chain(aiding).map(PathBuf::as_path)
    }

    /// The inputs that the arguments name.
    pub(crate) fn inputs(&self) -> RecordingInputs {
        let input = |path: &PathBuf| files::input(path);
        RecordingInputs {
            rover: input(&self.rover),
            navigation: self.nav.iter().map(input).collect(),
            base: self.base.as_ref().map(input),
            base_position: self.base_position,
            antex: self.antex.as_ref().map(input),
            odometry: self.odometry.as_ref().map(input),
            reference: self.times.reference(),
            from_s: self.from,
            to_s: self.to,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_position_is_three_numbers_or_the_headers() {
        let marker = Ecef::new(4033460.75, 23538.0, -4924318.5);
        let parsed = base_position("4033460.75, 23538,-4924318.5");
        assert_eq!(parsed, Ok(BasePosition::Marker(marker)));
        assert_eq!(base_position("from-header"), Ok(BasePosition::FromHeader));
        for wrong in ["", "1,2", "1,2,3,4", "1,2,x", "nan,1,2"] {
            assert!(base_position(wrong).is_err(), "{wrong}");
        }
    }
}
