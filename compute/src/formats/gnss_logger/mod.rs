//! Text logs of Android phones, as the app GnssLogger of Google and many others write them.
//!
//! Each line is a record, and its first field names the kind. Comments begin with `#`; the comment
//! `# Raw,…` names the columns of the `Raw` records, whose number and order depend on the version
//! of the app. A `Raw` record is one signal of `GnssMeasurement` with its `GnssClock`. All other
//! records (`Fix`, `Nav`, `NMEA`, `Status`, sensors) are passed over.
//!
//! # Time and pseudorange
//! All in integer nanoseconds. The phone estimates GPS time as
//!
//! t̂ = TimeNanos − (FullBiasNanos + BiasNanos)
//!
//! and steers this estimate from epoch to epoch. Code, phase and Doppler are measured with the
//! free-running oscillator that TimeNanos counts. If the pseudoranges followed t̂, their clock
//! would not be that of phase and Doppler. Therefore the bias is rounded to whole milliseconds, B:
//!
//! t_r = TimeNanos − B,  P = c·((t_r − t_t) mod M + TimeOffsetNanos) − Ṗ·TimeOffsetNanos
//!
//! The epoch has the time tag t_r. Its clock error is that of the oscillator, within ±0.5 ms, and
//! steps by a millisecond when it drifts out of this interval, as in many receivers; the phases do
//! not step. The white paper takes the bias of the first epoch instead. That is the same up to a
//! constant as long as no step occurs, but the result would depend on where a log begins, and the
//! time tag would drift away from GPS time. The last term moves the measurement to the time tag.
//!
//! t_t is ReceivedSvTimeNanos in the time scale of the constellation: time of week of GPS, Galileo
//! or BeiDou (14 s behind), time of day of GLONASS (UTC + 3 h, with LeapSecond). It is known modulo
//! M, which the bits of State give: see the `state` module. A measurement with M below 100 ms is
//! left out.
//!
//! # Phase and Doppler
//! With the nominal carrier frequency f, because the stated one is a 32-bit float (2·10⁻⁸ of it):
//!
//! φ = AccumulatedDeltaRangeMeters·f/c,  D = −PseudorangeRateMetersPerSecond·f/c
//!
//! Signs as in RINEX: the accumulated range of a receding satellite grows. A phase is used if
//! `ADR_STATE_VALID` is set. Its loss-of-lock indicator is set with `ADR_STATE_RESET` or
//! `ADR_STATE_CYCLE_SLIP`, after a change of HardwareClockDiscontinuityCount (then the epoch also
//! has `power_failure`), and if the previous epoch of the log had no valid phase of the signal: a
//! reset could have been reported there. It may be off by half a cycle unless
//! `ADR_STATE_HALF_CYCLE_RESOLVED` is set.
//!
//! # Not used
//! MultipathIndicator: it does not say which of the quantities is affected or by how much, and
//! estimators find reflections themselves. CarrierPhase, CarrierCycles and SnrInDb: deprecated.
//! Inter-signal biases: estimators have them as unknowns or use the broadcast ones.
//! DriftNanosPerSecond: Doppler has it.
//!
//! Measurements that are not usable are left out, and counted by [`Cause`] with the first lines.
//! Memory is bounded: a line, an epoch, and the signals of the previous one.
//!
//! Sources: Android API reference, `GnssMeasurement`, `GnssClock` and `GnssStatus` (level 37);
//! Android hardware interface, `GnssSignalType.aidl` (code types); GSA GNSS Raw Measurements Task
//! Force (2017), *Using GNSS raw measurements on Android devices*, doi:10.2878/449581, section 2.4;
//! Google, gps-measurement-tools, `LOGGING_FORMAT.md` (columns), `ProcessGnssMeas.m` (limits).

mod cause;
mod columns;
mod decoder;
mod error;
mod measurement;
mod reader;
mod signals;
mod state;
mod writer;

pub use cause::Cause;
pub use decoder::Decoder;
pub use error::{GnssLoggerError, LogFileError};
pub use reader::LogReader;
pub use writer::LogWriter;

/// Counts of what was left out of a log, by cause.
pub type Skipped = super::skipped::Skipped<Cause>;

/// Whether text that begins with `head` is such a log; `None` if more bytes are needed.
///
/// It is one if its first lines are comments up to `# Raw,…` or up to a `Raw` record.
///
/// ```
/// use graphfix_compute::formats::gnss_logger::is_gnss_logger;
///
/// assert_eq!(is_gnss_logger(b"# Version: v3.1.0.4\n# \n# Raw,utcTimeMillis,"), Some(true));
/// assert_eq!(is_gnss_logger(b"# Version: v3.1"), None);
/// assert_eq!(is_gnss_logger(b"$GPGGA,123519,4807.038,N\n"), Some(false));
/// ```
pub fn is_gnss_logger(head: &[u8]) -> Option<bool> {
    let mut rest = head;
    loop {
        let end = memchr::memchr(b'\n', rest);
        let line = &rest[..end.unwrap_or(rest.len())];
        if columns::is_title(line) || line.starts_with(columns::RAW) {
            return Some(true);
        }
        let is_comment = line.first().is_some_and(|byte| *byte == b'#');
        let is_blank = line.iter().all(u8::is_ascii_whitespace);
        let may_become_raw = end.is_none() && columns::RAW.starts_with(line);
        if !is_comment && !is_blank && !may_become_raw {
            return Some(false);
        }
        rest = &rest[end? + 1..];
    }
}
