//! Files of observations and navigation data in any format: RINEX, CRINEX, raw bytes of receivers,
//! or Android GnssLogger logs. The content decides on the format, not the file name.

use std::fmt;
use std::io::{BufRead, Chain, Cursor, Read};

use crate::gnss::{Epoch, GpsTime, Navigation};

use super::gnss_logger::{self, LogFileError, LogReader, is_gnss_logger};
use super::receiver::{
    ReceiverError, ReceiverReader, RefusalEntry, Station, Statistics, TimeReference,
    is_receiver_data,
};
use super::rinex::{self, ObservationReader, RinexError};
use super::skipped::{Skipped, SkippedEntry};

/// Number of leading bytes from which the format is recognised.
const HEAD_BYTES: u64 = 1 << 16;

/// The format of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FileFormat {
    /// RINEX or CRINEX; also of a file with an unknown format, which its reader refuses.
    Rinex,
    /// Raw bytes of a receiver.
    Receiver,
    /// Android GnssLogger log.
    GnssLogger,
}

/// A file with recognised format, from its first byte.
#[derive(Debug)]
pub struct Recognised<R> {
    input: Chain<Cursor<Vec<u8>>, R>,
    format: FileFormat,
}

impl<R: BufRead> Recognised<R> {
    /// Recognises the format: receiver data if the first bytes hold a whole frame, a GnssLogger log
    /// by its first lines, else RINEX.
    pub fn new(mut input: R) -> Self {
        let mut head = Vec::new();
        // An error here occurs again, and is reported, when the caller reads on.
        let _ = input.by_ref().take(HEAD_BYTES).read_to_end(&mut head);
        let format = if is_gnss_logger(&head) == Some(true) {
            FileFormat::GnssLogger
        } else if is_receiver_data(&head) {
            FileFormat::Receiver
        } else {
            FileFormat::Rinex
        };
        Self { input: Cursor::new(head).chain(input), format }
    }

    /// The format.
    pub const fn format(&self) -> FileFormat {
        self.format
    }
}

/// Why a file is refused.
#[derive(Debug, thiserror::Error)]
pub enum FileError {
    /// The file was recognised as RINEX.
    #[error(transparent)]
    Rinex(#[from] RinexError),
    /// The file was recognised as receiver data.
    #[error(transparent)]
    Receiver(#[from] ReceiverError),
    /// The file was recognised as a GnssLogger log.
    #[error(transparent)]
    GnssLogger(#[from] LogFileError),
}

impl FileError {
    /// What the user can do about it, where it differs from file to file.
    pub(crate) const fn remedy(&self) -> Option<&'static str> {
        match self {
            Self::Rinex(_) | Self::Receiver(_) => None,
            Self::GnssLogger(error) => Some(error.remedy()),
        }
    }
}

/// Reads the observations of a file epoch by epoch.
///
/// # Example
/// ```
/// use graphfix_compute::formats::observations::{FileFormat, Observations, Recognised};
/// use graphfix_compute::gnss::{Epoch, GpsTime, Navigation};
///
/// let header = |contents: &str, label: &str| format!("{contents:<60}{label}\n");
/// let file = header("     3.05           O                   G", "RINEX VERSION / TYPE")
///     + &header("G    1 C1C", "SYS / # / OBS TYPES")
///     + &header("", "END OF HEADER")
///     + "> 2019 04 28 12 58 21.0000000  0  1\nG05  22000000.123\n";
/// let file = Recognised::new(file.as_bytes());
/// assert_eq!(file.format(), FileFormat::Rinex);
/// let mut observations = Observations::new(file, None, &Navigation::default())?;
/// let mut epoch = Epoch::new(GpsTime::EPOCH);
/// assert!(observations.read_epoch(&mut epoch)?);
/// assert_eq!(epoch.observations[0].pseudorange_m, Some(22_000_000.123));
/// # Ok::<(), graphfix_compute::formats::observations::FileError>(())
/// ```
#[derive(Debug)]
pub enum Observations<R> {
    /// A RINEX or CRINEX file.
    Rinex(Box<ObservationReader<Chain<Cursor<Vec<u8>>, R>>>),
    /// Receiver data.
    Receiver(Box<ReceiverReader<Chain<Cursor<Vec<u8>>, R>>>),
    /// A GnssLogger log.
    GnssLogger(Box<LogReader<Chain<Cursor<Vec<u8>>, R>>>),
}

impl<R: BufRead> Observations<R> {
    /// Reads the header, if the format has one. `reference` and the GLONASS channels of
    /// `navigation` are used for receiver data without them.
    ///
    /// # Errors
    /// The header cannot be read.
    pub fn new(
        file: Recognised<R>,
        reference: Option<TimeReference>,
        navigation: &Navigation,
    ) -> Result<Self, FileError> {
        Ok(match file.format {
            FileFormat::Rinex => Self::Rinex(Box::new(ObservationReader::new(file.input)?)),
            FileFormat::Receiver => {
                let mut reader = ReceiverReader::new(file.input, reference);
                reader.learn_channels(navigation);
                Self::Receiver(Box::new(reader))
            }
            FileFormat::GnssLogger => {
                let mut reader = LogReader::new(file.input);
                reader.learn_channels(navigation);
                Self::GnssLogger(Box::new(reader))
            }
        })
    }

    /// Reads the next epoch into `epoch`; false at the end.
    ///
    /// # Errors
    /// The rest of the file cannot be read.
    pub fn read_epoch(&mut self, epoch: &mut Epoch) -> Result<bool, FileError> {
        Ok(match self {
            Self::Rinex(reader) => reader.read_epoch(epoch)?,
            Self::Receiver(reader) => reader.read_epoch(epoch)?,
            Self::GnssLogger(reader) => reader.read_epoch(epoch)?,
        })
    }

    /// The station as described by the messages read so far; `None` for other formats.
    pub fn station(&self) -> Option<&Station> {
        match self {
            Self::Rinex(_) | Self::GnssLogger(_) => None,
            Self::Receiver(reader) => reader.station(),
        }
    }

    /// What was left out so far.
    pub(crate) fn left_out(&self) -> LeftOut {
        match self {
            Self::Rinex(reader) => LeftOut::Rinex(reader.skipped().clone()),
            Self::Receiver(reader) => LeftOut::Receiver(reader.statistics().clone()),
            Self::GnssLogger(reader) => LeftOut::GnssLogger(reader.skipped().clone()),
        }
    }
}

/// Reads all navigation data of a file.
///
/// # Errors
/// The file as a whole cannot be read, or is a GnssLogger log. Damaged records and messages are
/// left out and listed.
pub fn read_navigation<R: BufRead>(
    file: Recognised<R>,
    reference: Option<TimeReference>,
) -> Result<(Navigation, LeftOut), FileError> {
    match file.format {
        FileFormat::Rinex => {
            let (navigation, skipped) = rinex::read_navigation(file.input)?;
            return Ok((navigation, LeftOut::Rinex(skipped)));
        }
        FileFormat::Receiver => {}
        FileFormat::GnssLogger => return Err(LogFileError::NoNavigation.into()),
    }
    let mut navigation = Navigation::default();
    let mut reader = ReceiverReader::new(file.input, reference);
    while let Some(event) = reader.read_event()? {
        event.apply_to(&mut navigation);
    }
    Ok((navigation, LeftOut::Receiver(reader.statistics().clone())))
}

/// The first complete time of receiver data or a GnssLogger log; `None` if it has none, and for
/// RINEX.
///
/// # Errors
/// The rest of the file cannot be read.
pub(crate) fn first_time<R: BufRead>(file: Recognised<R>) -> Result<Option<GpsTime>, FileError> {
    match file.format {
        FileFormat::Rinex => return Ok(None),
        FileFormat::Receiver => {}
        FileFormat::GnssLogger => {
            let mut epoch = Epoch::new(GpsTime::EPOCH);
            let has_epoch = LogReader::new(file.input).read_epoch(&mut epoch)?;
            return Ok(has_epoch.then_some(epoch.time));
        }
    }
    let mut reader = ReceiverReader::new(file.input, None);
    while reader.decoder().time().is_none() && reader.read_event()?.is_some() {}
    Ok(reader.decoder().time())
}

/// The station of receiver data. Messages are read until position and antenna are known, or to the
/// end; if the position changes, the first one counts. `None` without such messages, and for other
/// formats.
///
/// # Errors
/// The rest of the file cannot be read.
pub fn station<R: BufRead>(file: Recognised<R>) -> Result<Option<Station>, FileError> {
    if file.format != FileFormat::Receiver {
        return Ok(None);
    }
    let mut reader = ReceiverReader::new(file.input, None);
    let is_known = |s: &Station| s.antenna_reference_point.is_some() && !s.antenna.is_empty();
    let mut first = None;
    while !reader.station().is_some_and(is_known) && reader.read_event()?.is_some() {
        first = first.or(reader.station().and_then(|s| s.antenna_reference_point));
    }
    let station = reader.station().cloned();
    Ok(station.map(|station| Station { antenna_reference_point: first, ..station }))
}

/// The parts of a file that were left out.
#[derive(Clone, Debug)]
pub enum LeftOut {
    /// Parts of a RINEX file, by line.
    Rinex(rinex::Skipped),
    /// Parts of receiver data, by byte.
    Receiver(Statistics),
    /// Parts of a GnssLogger log, by line.
    GnssLogger(gnss_logger::Skipped),
}

/// One line for each reason: count, reason, and first positions.
impl fmt::Display for LeftOut {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Rinex(skipped) => write_lines(f, skipped)?,
            Self::GnssLogger(skipped) => write_lines(f, skipped)?,
            Self::Receiver(statistics) => {
                for entry in statistics.refusals() {
                    let RefusalEntry { kind, reason, count, offsets, has_more } = entry;
                    let has_more = *has_more;
                    let positions = Positions { unit: "bytes", first: offsets, has_more };
                    let kind = kind.map_or_else(|| "frame".to_owned(), |kind| kind.to_string());
                    writeln!(f, "left out {count} times: {kind}: {reason} ({positions})")?;
                }
                if 0 < statistics.garbage_bytes() {
                    let (count, first) = (statistics.garbage_bytes(), statistics.first_garbage());
                    let has_more = statistics.has_more_garbage();
                    let positions = Positions { unit: "from bytes", first, has_more };
                    writeln!(f, "left out {count} bytes that belong to no frame ({positions})")?;
                }
            }
        }
        Ok(())
    }
}

/// The reasons of a text format.
fn write_lines<R: Copy + PartialEq + fmt::Display>(
    f: &mut fmt::Formatter<'_>,
    skipped: &Skipped<R>,
) -> fmt::Result {
    for SkippedEntry { reason, count, lines, has_more } in skipped.entries() {
        let positions = Positions { unit: "lines", first: lines, has_more: *has_more };
        writeln!(f, "left out {count} times: {reason} ({positions})")?;
    }
    Ok(())
}

/// The first positions of one reason, for display.
struct Positions<'a> {
    unit: &'static str,
    first: &'a [u64],
    has_more: bool,
}

impl fmt::Display for Positions<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let first: Vec<String> = self.first.iter().map(u64::to_string).collect();
        let more = if self.has_more { " …" } else { "" };
        write!(f, "{} {}{more}", self.unit, first.join(", "))
    }
}
