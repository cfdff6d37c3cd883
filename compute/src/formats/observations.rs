//! Files of observations and navigation data in any format: RINEX, CRINEX, raw bytes of receivers,
//! or Android GnssLogger logs. The content decides on the format, not the file name.
//!
//! A file whose gzip stream is cut off or damaged is read as one that ends there, and
//! [`LeftOut`] has the [`GzipDamage`]. It is refused if nothing before that can be used.

use std::fmt;
use std::io::{BufRead, Chain, Cursor, Read};

use crate::gnss::{Epoch, GpsTime, Navigation};
use crate::refusal::Code;

use super::damage::{DamageReport, UntilDamage};
use super::gnss_logger::{self, LogFileError, LogReader, is_gnss_logger};
use super::receiver::{
    ReceiverError, ReceiverReader, RefusalEntry, Station, Statistics, TimeReference,
    is_receiver_data,
};
use super::rinex::{self, ObservationHeader, ObservationReader, RinexError};
use super::skipped::{Skipped, SkippedEntry};

pub use super::damage::GzipDamage;

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

/// The bytes of a file; the first ones are read.
type FileBytes<R> = Chain<Cursor<Vec<u8>>, UntilDamage<R>>;

/// A file with recognised format, from its first byte.
#[derive(Debug)]
pub struct Recognised<R> {
    input: FileBytes<R>,
    format: FileFormat,
    damage: DamageReport,
}

impl<R: BufRead> Recognised<R> {
    /// Recognises the format: receiver data if the first bytes hold a whole frame, a GnssLogger log
    /// by its first lines, else RINEX.
    pub fn new(input: R) -> Self {
        let mut input = UntilDamage::new(input);
        let damage = input.report();
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
        Self { input: Cursor::new(head).chain(input), format, damage }
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
    /// The gzip stream of the file is cut off or damaged, and what is before cannot be used.
    #[error("{why}; {damage}")]
    Damaged {
        /// Why it cannot be used.
        why: String,
        /// Where the stream ends.
        damage: GzipDamage,
    },
}

impl FileError {
    /// What the user can do about it, where it differs from file to file.
    pub(crate) const fn remedy(&self) -> Option<&'static str> {
        match self {
            Self::Rinex(RinexError::CompressionUnsupported { .. }) => {
                Some(Code::RinexCompressionUnsupported.remedy())
            }
            Self::Rinex(_) | Self::Receiver(_) => None,
            Self::GnssLogger(error) => Some(error.remedy()),
            Self::Damaged { .. } => Some(GzipDamage::REMEDY),
        }
    }

    /// The error of a file, whose reader may have met damage.
    fn of(error: impl Into<Self>, damage: &DamageReport) -> Self {
        let error = error.into();
        match damage.get() {
            Some(damage) if error.may_be_of_damage() => {
                Self::Damaged { why: error.to_string(), damage: damage.clone() }
            }
            _ => error,
        }
    }

    /// Whether content that is missing or wrong can be the cause.
    const fn may_be_of_damage(&self) -> bool {
        match self {
            Self::Rinex(error) => matches!(
                error,
                RinexError::NotRinex { .. }
                    | RinexError::HeaderInvalid { .. }
                    | RinexError::Truncated { .. }
                    | RinexError::LineTooLong { .. }
            ),
            Self::GnssLogger(error) => {
                matches!(error, LogFileError::Log(_) | LogFileError::NothingUsable { .. })
            }
            Self::Receiver(_) | Self::Damaged { .. } => false,
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
pub struct Observations<R> {
    reader: FormatReader<FileBytes<R>>,
    damage: DamageReport,
}

/// The reader of a format.
#[derive(Debug)]
enum FormatReader<B> {
    Rinex(Box<ObservationReader<B>>),
    Receiver(Box<ReceiverReader<B>>),
    GnssLogger(Box<LogReader<B>>),
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
        let Recognised { input, format, damage } = file;
        let reader = match format {
            FileFormat::Rinex => {
                let reader = ObservationReader::new(input);
                let reader = reader.map_err(|error| FileError::of(error, &damage))?;
                FormatReader::Rinex(Box::new(reader))
            }
            FileFormat::Receiver => {
                let mut reader = ReceiverReader::new(input, reference);
                reader.learn_channels(navigation);
                FormatReader::Receiver(Box::new(reader))
            }
            FileFormat::GnssLogger => {
                let mut reader = LogReader::new(input);
                reader.learn_channels(navigation);
                FormatReader::GnssLogger(Box::new(reader))
            }
        };
        Ok(Self { reader, damage })
    }

    /// Reads the next epoch into `epoch`; false at the end.
    ///
    /// # Errors
    /// The rest of the file cannot be read.
    pub fn read_epoch(&mut self, epoch: &mut Epoch) -> Result<bool, FileError> {
        let read = match &mut self.reader {
            FormatReader::Rinex(reader) => reader.read_epoch(epoch).map_err(FileError::from),
            FormatReader::Receiver(reader) => reader.read_epoch(epoch).map_err(FileError::from),
            FormatReader::GnssLogger(reader) => reader.read_epoch(epoch).map_err(FileError::from),
        };
        read.map_err(|error| FileError::of(error, &self.damage))
    }

    /// The format.
    pub const fn format(&self) -> FileFormat {
        match self.reader {
            FormatReader::Rinex(_) => FileFormat::Rinex,
            FormatReader::Receiver(_) => FileFormat::Receiver,
            FormatReader::GnssLogger(_) => FileFormat::GnssLogger,
        }
    }

    /// The header of RINEX, with the changes of events read so far; `None` for other formats.
    pub fn header(&self) -> Option<&ObservationHeader> {
        match &self.reader {
            FormatReader::Rinex(reader) => Some(reader.header()),
            FormatReader::Receiver(_) | FormatReader::GnssLogger(_) => None,
        }
    }

    /// The station as described by the messages read so far; `None` for other formats.
    pub fn station(&self) -> Option<&Station> {
        match &self.reader {
            FormatReader::Rinex(_) | FormatReader::GnssLogger(_) => None,
            FormatReader::Receiver(reader) => reader.station(),
        }
    }

    /// What was left out so far.
    pub fn left_out(&self) -> LeftOut {
        let parts = match &self.reader {
            FormatReader::Rinex(reader) => SkippedParts::Rinex(reader.skipped().clone()),
            FormatReader::Receiver(reader) => SkippedParts::Receiver(reader.statistics().clone()),
            FormatReader::GnssLogger(reader) => SkippedParts::GnssLogger(reader.skipped().clone()),
        };
        LeftOut { parts, damage: self.damage.get().cloned() }
    }
}

/// Reads all navigation data of a file.
///
/// # Errors
/// The file as a whole cannot be read, or is a GnssLogger log, or its gzip stream ends before the
/// first ephemeris of RINEX. Damaged records and messages are left out and listed.
pub fn read_navigation<R: BufRead>(
    file: Recognised<R>,
    reference: Option<TimeReference>,
) -> Result<(Navigation, LeftOut), FileError> {
    let Recognised { input, format, damage } = file;
    let (navigation, parts) = match format {
        FileFormat::Rinex => {
            let read = rinex::read_navigation(input);
            let (navigation, skipped) = read.map_err(|error| FileError::of(error, &damage))?;
            if let (true, Some(damage)) = (navigation.is_empty(), damage.get()) {
                let why = "the file has no ephemeris".to_owned();
                return Err(FileError::Damaged { why, damage: damage.clone() });
            }
            (navigation, SkippedParts::Rinex(skipped))
        }
        FileFormat::Receiver => {
            let mut navigation = Navigation::default();
            let mut reader = ReceiverReader::new(input, reference);
            while let Some(event) = reader.read_event()? {
                event.apply_to(&mut navigation);
            }
            (navigation, SkippedParts::Receiver(reader.statistics().clone()))
        }
        FileFormat::GnssLogger => return Err(LogFileError::NoNavigation.into()),
    };
    Ok((navigation, LeftOut { parts, damage: damage.get().cloned() }))
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

/// What was left out of a file.
#[derive(Clone, Debug)]
pub struct LeftOut {
    /// The parts that were skipped.
    pub parts: SkippedParts,
    /// Where the gzip stream is cut off or damaged: what follows is missing.
    pub damage: Option<GzipDamage>,
}

/// The parts of a file that were skipped.
#[derive(Clone, Debug)]
pub enum SkippedParts {
    /// Parts of a RINEX file, by line.
    Rinex(rinex::Skipped),
    /// Parts of receiver data, by byte.
    Receiver(Statistics),
    /// Parts of a GnssLogger log, by line.
    GnssLogger(gnss_logger::Skipped),
}

/// A line for each reason: count, reason, and first positions. The last line is the damage.
impl fmt::Display for LeftOut {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.parts.fmt(f)?;
        match &self.damage {
            None => Ok(()),
            Some(cut @ GzipDamage { why: None, .. }) => {
                writeln!(f, "{cut}: what follows is missing")
            }
            Some(damage) => {
                writeln!(f, "{damage}: what follows is missing, what is before may have errors")
            }
        }
    }
}

/// A line for each reason: count, reason, and first positions.
impl fmt::Display for SkippedParts {
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
                    let times = Times(*count);
                    writeln!(f, "left out {times}: {kind}: {reason} ({positions})")?;
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
        writeln!(f, "left out {}: {reason} ({positions})", Times(*count))?;
    }
    Ok(())
}

/// How often, for display.
struct Times(u64);

impl fmt::Display for Times {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.0 {
            1 => f.write_str("once"),
            count => write!(f, "{count} times"),
        }
    }
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

#[cfg(test)]
mod tests {
    use std::io::Write;

    use super::*;
    use crate::formats::decompress;
    use crate::formats::gnss_logger::LogWriter;
    use crate::formats::receiver::RawxWriter;
    use crate::formats::rinex::{ObservationWriter, RinexVersion, write_navigation};
    use crate::simulation::{Scenario, Simulator, navigation};

    const EPOCHS: usize = 20;

    /// A file that is packed in another way than with gzip is named with what unpacks it.
    #[test]
    fn unsupported_compression_has_a_remedy_of_its_own() {
        for packed in [&b"\x1f\x9d\x90abcdef"[..], b"PK\x03\x04abcdef", b"BZh91AY&SYabc"] {
            let opened = Observations::new(Recognised::new(packed), None, &Navigation::default());
            let Err(error) = opened else { panic!("a packed file has no observations") };
            let remedy = error.remedy().unwrap_or("none");
            assert!(remedy.contains("unpack the file"), "{error}: {remedy}");
        }
    }

    fn scenario() -> Scenario {
        Scenario { duration_s: EPOCHS as f64 - 1.0, ..Scenario::open_sky() }
    }

    /// One recording as RINEX, as UBX and as a GnssLogger log.
    fn files() -> [Vec<u8>; 3] {
        let mut header = ObservationHeader::new(RinexVersion::new(3, 5));
        for constellation in &scenario().constellations {
            header.codes[constellation.index()] = scenario().signals(*constellation).collect();
        }
        let broadcast = navigation(&scenario());
        let mut rinex = ObservationWriter::new(Vec::new(), &header).unwrap();
        let (mut ubx, mut writer) = (Vec::new(), RawxWriter::default());
        let mut log = LogWriter::new(Vec::new(), &broadcast).unwrap();
        for epoch in Simulator::new(scenario(), 1) {
            rinex.write_epoch(&epoch.rover).unwrap();
            ubx.extend(writer.frame(&epoch.rover));
            log.write_epoch(&epoch.rover).unwrap();
        }
        [rinex.finish().unwrap(), ubx, log.finish().unwrap()]
    }

    fn gzip(content: &[u8]) -> Vec<u8> {
        let mut packer = flate2::write::GzEncoder::new(Vec::new(), Default::default());
        packer.write_all(content).unwrap();
        packer.finish().unwrap()
    }

    /// The epochs of a file, and what was left out of it.
    fn read(bytes: &[u8]) -> Result<(Vec<Epoch>, LeftOut), FileError> {
        let file = Recognised::new(decompress(bytes));
        let mut observations = Observations::new(file, None, &Navigation::default())?;
        let (mut epochs, mut epoch) = (Vec::new(), Epoch::new(GpsTime::EPOCH));
        while observations.read_epoch(&mut epoch)? {
            epochs.push(epoch.clone());
        }
        Ok((epochs, observations.left_out()))
    }

    /// Cut off packed, a file has the epochs that it has cut off at the same byte unpacked.
    #[test]
    fn what_is_before_a_cut_is_used_and_the_cut_is_listed() {
        for content in files() {
            let packed = gzip(&content);
            let (whole, left_out) = read(&packed).unwrap();
            assert_eq!((whole.len(), left_out.to_string().as_str()), (EPOCHS, ""));
            let (epochs, left_out) = read(&packed[..packed.len() / 2]).unwrap();
            let damage = left_out.damage.clone().unwrap();
            let (expected, skipped) = read(&content[..damage.unpacked_bytes as usize]).unwrap();
            assert!((1..EPOCHS).contains(&epochs.len()), "{}", epochs.len());
            assert_eq!(epochs, expected);
            let line = format!("{damage}: what follows is missing\n");
            assert_eq!(left_out.to_string(), skipped.to_string() + &line);
        }
    }

    #[test]
    fn what_is_before_damage_is_used_and_the_damage_is_listed() {
        for content in files() {
            let (first, second) = content.split_at(content.len() / 2);
            let mut packed = [gzip(first), gzip(second)].concat();
            packed[gzip(first).len()] ^= 1;
            let (epochs, left_out) = read(&packed).unwrap();
            assert_eq!(epochs, read(first).unwrap().0);
            let lines = left_out.to_string();
            let last = lines.lines().last().unwrap();
            let damaged =
                format!("the gzip stream is damaged after {} unpacked bytes", first.len());
            assert!(last.starts_with(&damaged), "{last}");
        }
    }

    #[test]
    fn a_file_without_anything_before_the_damage_is_refused() {
        let [rinex, _, log] = files();
        let (packed, header, title) = (gzip(&rinex), gzip(&rinex[..400]), gzip(&log[..400]));
        let [header, title] = [&header, &title].map(|whole| &whole[..whole.len() - 1]);
        for cut in [&packed[..2], &packed[..10], header, title] {
            let error = read(cut).unwrap_err();
            assert!(matches!(error, FileError::Damaged { .. }), "{error}");
            assert!(error.to_string().contains("; the gzip stream is cut off after "), "{error}");
            assert_eq!(error.remedy(), Some(GzipDamage::REMEDY));
        }
    }

    #[test]
    fn navigation_data_before_a_cut_are_used_if_there_are_any() {
        let mut content = Vec::new();
        write_navigation(&mut content, &navigation(&scenario())).unwrap();
        let packed = gzip(&content);
        let read = |bytes: &[u8]| read_navigation(Recognised::new(decompress(bytes)), None);
        let whole = read(&packed).unwrap().0.len();
        let (navigation, left_out) = read(&packed[..packed.len() * 3 / 4]).unwrap();
        assert!((1..whole).contains(&navigation.len()), "{} of {whole}", navigation.len());
        assert!(left_out.to_string().ends_with("unpacked bytes: what follows is missing\n"));

        let end = "END OF HEADER\n";
        let length = content.windows(end.len()).position(|bytes| bytes == end.as_bytes()).unwrap();
        let header = gzip(&content[..length + end.len()]);
        let error = read(&header[..header.len() - 1]).unwrap_err();
        let expected = format!(
            "the file has no ephemeris; the gzip stream is cut off after {} ",
            length + end.len()
        );
        assert!(error.to_string().starts_with(&expected), "{error}");
    }
}
