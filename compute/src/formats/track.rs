//! The formats of solutions by name, and one writer for all of them.

use std::io::BufRead;

use super::encoder::{Additions, Encoder};
#[cfg(feature = "parquet")]
use super::parquet;
use super::pos::{PosError, PosFile};
use super::{csv, geojson, gpx, kml, nmea, pos};
use crate::gnss::{LeapSeconds, Presentation, Presented};

pub use super::encoder::Revision;

/// A format of solutions.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TrackFormat {
    /// RTKLIB's solution file.
    Pos,
    /// Comma-separated values.
    Csv,
    /// GeoJSON, RFC 7946.
    Geojson,
    /// KML 2.2.
    Kml,
    /// GPX 1.1.
    Gpx,
    /// NMEA 0183.
    Nmea,
    /// Apache Parquet, in programs that are built with it.
    Parquet,
}

impl TrackFormat {
    /// Every format.
    pub const ALL: [Self; 7] =
        [Self::Pos, Self::Csv, Self::Geojson, Self::Kml, Self::Gpx, Self::Nmea, Self::Parquet];

    /// The name: the ending of a file in this format.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Pos => "pos",
            Self::Csv => "csv",
            Self::Geojson => "geojson",
            Self::Kml => "kml",
            Self::Gpx => "gpx",
            Self::Nmea => "nmea",
            Self::Parquet => "parquet",
        }
    }

    /// The format of a name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|format| format.name() == name)
    }

    /// All names, for a message: `pos, csv, …`.
    pub fn names() -> String {
        Self::ALL.map(Self::name).join(", ")
    }

    /// The media type.
    pub const fn content_type(self) -> &'static str {
        match self {
            Self::Pos | Self::Nmea => "text/plain; charset=utf-8",
            Self::Csv => "text/csv; charset=utf-8",
            Self::Geojson => "application/geo+json",
            Self::Kml => "application/vnd.google-earth.kml+xml",
            Self::Gpx => "application/gpx+xml",
            Self::Parquet => "application/vnd.apache.parquet",
        }
    }

    /// Whether this program writes the format.
    pub const fn is_built(self) -> bool {
        cfg!(feature = "parquet") || !matches!(self, Self::Parquet)
    }

    /// What a program without the format answers who asks for it.
    pub fn not_built(self) -> String {
        format!("the format {} is only in a build with the feature \"parquet\"", self.name())
    }

    /// Whether the format can tell in which frame a position is.
    pub(crate) const fn has_frames(self) -> bool {
        matches!(self, Self::Csv | Self::Geojson | Self::Parquet)
    }

    /// Whether the format can tell the revisions of one epoch apart.
    pub const fn has_revisions(self) -> bool {
        self.has_frames()
    }

    /// Memory of a writer beside the line that it writes (bytes).
    pub const fn memory_bytes(self) -> usize {
        match self {
            #[cfg(feature = "parquet")]
            Self::Parquet => parquet::GROUP_BYTES,
            _ => 0,
        }
    }
}

/// Turns solutions into the bytes of a file.
pub struct TrackWriter {
    format: TrackFormat,
    encoder: Box<dyn Encoder>,
}

impl TrackWriter {
    /// A writer of computed solutions that are presented so. `comments` stand at the head of a
    /// `.pos` file; `leap` converts GPS time to UTC.
    pub fn of_computed(
        format: TrackFormat,
        comments: &[String],
        leap: LeapSeconds,
        presentation: &Presentation,
    ) -> Self {
        Self::new(format, comments, leap, Additions::new(presentation, false))
    }

    /// A writer of stored solutions, which have numbers and revisions.
    pub fn of_stored(
        format: TrackFormat,
        comments: &[String],
        leap: LeapSeconds,
        presentation: &Presentation,
    ) -> Self {
        Self::new(format, comments, leap, Additions::new(presentation, true))
    }

    fn new(
        format: TrackFormat,
        comments: &[String],
        leap: LeapSeconds,
        additions: Additions,
    ) -> Self {
        let encoder: Box<dyn Encoder> = match format {
            TrackFormat::Pos => Box::new(pos::Rows { comments: comments.to_vec() }),
            TrackFormat::Csv => Box::new(csv::Rows { additions }),
            TrackFormat::Geojson => Box::new(geojson::Collection::new(leap, additions)),
            TrackFormat::Kml => Box::new(kml::Kml::new(leap)),
            TrackFormat::Gpx => Box::new(gpx::Gpx::new(leap, additions)),
            TrackFormat::Nmea => Box::new(nmea::Nmea::new(leap)),
            #[cfg(feature = "parquet")]
            TrackFormat::Parquet => Box::new(parquet::Table::new(leap, additions)),
            #[cfg(not(feature = "parquet"))]
            TrackFormat::Parquet => unreachable!("a format that is not built is refused before"),
        };
        Self { format, encoder }
    }

    /// Appends what precedes the first solution.
    pub fn begin(&mut self, out: &mut Vec<u8>) {
        self.encoder.begin(out);
    }

    /// Appends one solution. `revision` is that of a stored one. A position in another frame than
    /// the one that is asked for is left out where the format cannot tell its frame.
    pub fn push(
        &mut self,
        presented: Presented<'_>,
        revision: Option<Revision>,
        out: &mut Vec<u8>,
    ) {
        let presented = match self.format.has_frames() {
            true => presented,
            false => presented.without_foreign_position(),
        };
        self.encoder.push(&presented, revision, out);
    }

    /// Appends what follows the last solution.
    pub fn finish(&mut self, out: &mut Vec<u8>) {
        self.encoder.finish(out);
    }
}

/// Reads the positions of a solution file, `.pos` or CSV by its content.
///
/// # Errors
/// The input cannot be read, or has coordinates or times that would be evaluated wrongly.
pub fn read_positions(mut input: impl BufRead) -> Result<PosFile, PosError> {
    let first = input.fill_buf()?;
    let line = first.split(|byte| *byte == b'\n').next().unwrap_or_default();
    if csv::has_titles(line) { csv::read(input) } else { pos::read(input) }
}
