//! The formats of what comes of a recording or a session, by name: those of positions, and RINEX
//! for the observations.

use super::track::TrackFormat;

/// A format of a result.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ResultFormat {
    /// Positions.
    Track(TrackFormat),
    /// Observations as RINEX 3.05.
    Rinex,
}

impl ResultFormat {
    /// The name of the format of observations.
    pub const RINEX: &str = "rinex";
    /// The ending of files of observations.
    pub const RINEX_ENDING: &str = "rnx";

    /// The format of a name.
    pub fn from_name(name: &str) -> Option<Self> {
        match name {
            Self::RINEX => Some(Self::Rinex),
            _ => TrackFormat::from_name(name).map(Self::Track),
        }
    }

    /// The format of a file by its ending: `rnx` and `obs` are observations.
    pub fn from_ending(ending: &str) -> Option<Self> {
        match ending {
            Self::RINEX_ENDING | "obs" => Some(Self::Rinex),
            _ => TrackFormat::from_name(ending).map(Self::Track),
        }
    }

    /// All names, for a message: `pos, csv, …`.
    pub fn names() -> String {
        format!("{}, {}", TrackFormat::names(), Self::RINEX)
    }

    /// The ending of a file in this format.
    pub const fn ending(self) -> &'static str {
        match self {
            Self::Track(format) => format.name(),
            Self::Rinex => Self::RINEX_ENDING,
        }
    }

    /// The media type.
    pub const fn content_type(self) -> &'static str {
        match self {
            Self::Track(format) => format.content_type(),
            Self::Rinex => "text/plain; charset=utf-8",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_and_endings_lead_to_formats() {
        for format in
            TrackFormat::ALL.map(ResultFormat::Track).into_iter().chain([ResultFormat::Rinex])
        {
            assert_eq!(ResultFormat::from_ending(format.ending()), Some(format));
        }
        assert_eq!(ResultFormat::from_name("rinex"), Some(ResultFormat::Rinex));
        assert_eq!(ResultFormat::from_ending("obs"), Some(ResultFormat::Rinex));
        assert_eq!(ResultFormat::from_name("rnx"), None);
        assert_eq!(ResultFormat::from_ending("rinex"), None);
        assert!(
            ResultFormat::names().starts_with("pos, csv, ")
                && ResultFormat::names().ends_with(", rinex")
        );
    }
}
