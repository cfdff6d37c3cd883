//! The decoder of a log that arrives in chunks.

use super::columns::{Columns, RAW};
use super::measurement::{Channels, ClockReading, observation};
use super::{Cause, GnssLoggerError, Skipped};
use crate::gnss::{
    Constellation, Ephemeris, Epoch, Navigation, Observation, ObservationCode, SatelliteId,
};

/// Longest line (bytes): antenna patterns of a phone in one `GnssAntennaInfo` record.
const LINE_LIMIT: usize = 1 << 16;
/// Largest number of observations in an epoch.
const OBSERVATIONS_LIMIT: usize = 1024;
/// An epoch ends, and the previous one is forgotten, this many bytes after its first record, so
/// that the bytes that restore a decoder are bounded. Sensors write 50 kB a second.
const SPAN_BYTES: u64 = 1 << 17;

/// Decodes a log in chunks of any size into epochs.
///
/// ```
/// use graphfix_compute::formats::gnss_logger::Decoder;
///
/// let log = "# Raw,TimeNanos,FullBiasNanos,Svid,State,ReceivedSvTimeNanos,ConstellationType\n\
///     Raw,5000000000000,-1304648600000000000,5,16393,99999930000000,1\n";
/// let (mut decoder, mut epochs) = (Decoder::new(), Vec::new());
/// for chunk in log.as_bytes().chunks(7) {
///     decoder.push(chunk, &mut epochs)?;
/// }
/// decoder.finish(&mut epochs)?;
/// assert_eq!(epochs[0].time.to_string(), "2157:100000.000000000");
/// let range_m = epochs[0].observations[0].pseudorange_m.expect("the time of week is decoded");
/// assert!((range_m - 0.07 * 299_792_458.0).abs() < 1e-6);
/// # Ok::<(), graphfix_compute::formats::gnss_logger::GnssLoggerError>(())
/// ```
#[derive(Debug, Default)]
pub struct Decoder {
    /// The beginning of a line whose end has not arrived.
    line: Vec<u8>,
    /// Number of complete lines.
    lines: u64,
    /// Number of bytes in them.
    offset: u64,
    columns: Option<Columns>,
    /// Number of bytes up to the end of the title.
    header_bytes: u64,
    current: Option<Current>,
    previous: Option<Previous>,
    channels: Channels,
    skipped: Skipped,
    records: u64,
}

/// The epoch whose records are arriving.
#[derive(Debug)]
struct Current {
    /// Offset of its first record.
    start: u64,
    clock: ClockReading,
    observations: Vec<Observation>,
}

/// What the next epoch is compared with.
#[derive(Debug)]
struct Previous {
    /// Offset of its first record.
    start: u64,
    discontinuities: Option<i64>,
    /// Signals with a valid phase, in order.
    phases: Vec<(SatelliteId, ObservationCode)>,
}

impl Decoder {
    /// A decoder at the start of a log.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds known FDMA channels of GLONASS satellites, for phones that state no frequency.
    pub(crate) fn learn_channels(&mut self, navigation: &Navigation) {
        for (satellite, ephemerides) in navigation.satellites() {
            let channel = ephemerides.last().and_then(Ephemeris::glonass_channel);
            if let (Constellation::Glonass, Some(channel)) = (satellite.constellation, channel) {
                self.channels.set(satellite.number, channel);
            }
        }
    }

    /// Decodes the next bytes and appends the completed epochs to `epochs`. An epoch is complete
    /// when the next one begins.
    ///
    /// # Errors
    /// The log cannot be decoded. The decoder is then unusable.
    pub fn push(&mut self, bytes: &[u8], epochs: &mut Vec<Epoch>) -> Result<(), GnssLoggerError> {
        let mut rest = bytes;
        while let Some(end) = memchr::memchr(b'\n', rest) {
            let (line, after) = rest.split_at(end + 1);
            if self.line.is_empty() {
                self.take_line(line, epochs)?;
            } else {
                let mut whole = std::mem::take(&mut self.line);
                whole.extend_from_slice(line);
                self.take_line(&whole, epochs)?;
                whole.clear();
                self.line = whole;
            }
            rest = after;
        }
        self.line.extend_from_slice(rest);
        self.check_length(self.line.len())?;
        self.expire(epochs);
        Ok(())
    }

    /// Ends the log and passes on the last epoch. A line without end is left out: its last number
    /// may be cut.
    ///
    /// # Errors
    /// None today; as [`Decoder::push`].
    pub fn finish(&mut self, epochs: &mut Vec<Epoch>) -> Result<(), GnssLoggerError> {
        if self.line.starts_with(RAW) {
            self.skipped.note(Cause::CutLine, self.lines + 1);
        }
        self.offset += std::mem::take(&mut self.line).len() as u64;
        self.close(epochs);
        Ok(())
    }

    /// What was left out so far.
    pub const fn skipped(&self) -> &Skipped {
        &self.skipped
    }

    /// What was left out since the last call.
    pub(crate) fn take_skipped(&mut self) -> Skipped {
        std::mem::take(&mut self.skipped)
    }

    /// Number of complete lines.
    pub(super) const fn lines(&self) -> u64 {
        self.lines
    }

    /// Number of `Raw` records.
    pub(super) const fn records(&self) -> u64 {
        self.records
    }

    /// Length up to the end of the title (bytes); zero before it is complete.
    pub(crate) const fn header_bytes(&self) -> u64 {
        self.header_bytes
    }

    /// Number of bytes at the end that a decoder needs after the header to go on as this one does:
    /// the previous epoch and the incomplete one.
    pub(crate) fn tail_bytes(&self) -> u64 {
        let previous = self.previous.as_ref().map(|previous| previous.start);
        let current = self.current.as_ref().map(|current| current.start);
        let start = previous.or(current).unwrap_or(self.offset);
        let start = if self.columns.is_none() { 0 } else { start };
        self.offset + self.line.len() as u64 - start
    }

    fn check_length(&self, bytes: usize) -> Result<(), GnssLoggerError> {
        match bytes <= LINE_LIMIT {
            true => Ok(()),
            false => Err(GnssLoggerError::LineTooLong { line: self.lines + 1, limit: LINE_LIMIT }),
        }
    }

    /// Takes a line with its end.
    fn take_line(&mut self, line: &[u8], epochs: &mut Vec<Epoch>) -> Result<(), GnssLoggerError> {
        self.check_length(line.len())?;
        self.expire(epochs);
        self.lines += 1;
        if line.starts_with(RAW) {
            self.records += 1;
            let columns = self.columns.take();
            let columns = columns.ok_or(GnssLoggerError::NoColumns { line: self.lines })?;
            if let Err(cause) = self.take_record(&columns, line, epochs) {
                self.skipped.note(cause, self.lines);
            }
            self.columns = Some(columns);
        } else if let Some(columns) = Columns::of_line(line, self.lines)? {
            if self.columns.as_ref().is_some_and(|known| *known != columns) {
                return Err(GnssLoggerError::ColumnsChange { line: self.lines });
            }
            if self.columns.is_none() {
                self.header_bytes = self.offset + line.len() as u64;
            }
            self.columns = Some(columns);
        } else if !is_other_record(line) {
            self.skipped.note(Cause::StrayLine, self.lines);
        }
        self.offset += line.len() as u64;
        Ok(())
    }

    /// Adds a record to its epoch.
    ///
    /// # Errors
    /// The measurement is not usable.
    fn take_record(
        &mut self,
        columns: &Columns,
        line: &[u8],
        epochs: &mut Vec<Epoch>,
    ) -> Result<(), Cause> {
        let row = columns.row(line);
        let clock = ClockReading::of(&row)?;
        if self.current.as_ref().is_none_or(|current| current.clock != clock) {
            self.close(epochs);
            self.current = Some(Current { start: self.offset, clock, observations: Vec::new() });
        }
        let Self { current, channels, skipped, lines, .. } = self;
        let mut note = |cause| skipped.note(cause, *lines);
        let observation = observation(&row, clock.time, channels, &mut note)?;
        let current = current.as_mut().expect("the record's epoch was begun above");
        current.add(observation)
    }

    /// Ends the epoch whose records were arriving.
    fn close(&mut self, epochs: &mut Vec<Epoch>) {
        let Some(current) = self.current.take() else { return };
        let Current { start, clock: ClockReading { time, discontinuities }, mut observations } =
            current;
        observations.sort_by_key(|observation| observation.satellite);
        let previous = self.previous.take();
        let is_continuous = |p: &Previous| p.discontinuities == discontinuities;
        let tracked: &[_] = match &previous {
            Some(previous) if is_continuous(previous) => &previous.phases,
            _ => &[],
        };
        let mut phases = Vec::new();
        for observation in observations.iter_mut().filter(|o| o.carrier_phase.is_some()) {
            let signal = (observation.satellite, observation.code);
            observation.loss_of_lock |= tracked.binary_search(&signal).is_err();
            phases.push(signal);
        }
        phases.sort_unstable();
        let power_failure = previous.is_some_and(|previous| !is_continuous(&previous));
        self.previous = Some(Previous { start, discontinuities, phases });
        if !observations.is_empty() {
            epochs.push(Epoch { power_failure, observations, ..Epoch::new(time) });
        }
    }

    /// Ends the current epoch and forgets the previous one if they began too far before.
    fn expire(&mut self, epochs: &mut Vec<Epoch>) {
        let is_past = |start: u64, span: u64| start + span < self.offset;
        if self.previous.as_ref().is_some_and(|p| is_past(p.start, 2 * SPAN_BYTES)) {
            self.previous = None;
        }
        if self.current.as_ref().is_some_and(|c| is_past(c.start, SPAN_BYTES)) {
            self.close(epochs);
        }
    }
}

impl Current {
    fn add(&mut self, observation: Observation) -> Result<(), Cause> {
        let signal = |o: &Observation| (o.satellite, o.code);
        if self.observations.iter().any(|known| signal(known) == signal(&observation)) {
            return Err(Cause::DuplicateSignal);
        }
        if OBSERVATIONS_LIMIT <= self.observations.len() {
            return Err(Cause::TooManyMeasurements);
        }
        self.observations.push(observation);
        Ok(())
    }
}

/// Whether a line is a comment, blank, or a record of another kind, whose name is a word.
fn is_other_record(line: &[u8]) -> bool {
    let line = line.trim_ascii();
    let kind = line.split(|byte| *byte == b',').next().unwrap_or_default();
    let is_word = kind.iter().all(u8::is_ascii_alphanumeric);
    line.is_empty() || line.starts_with(b"#") || (is_word && kind.len() < line.len())
}
