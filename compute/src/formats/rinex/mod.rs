//! RINEX: the receiver-independent exchange format, read and written.
//!
//! Read: observation and navigation files of versions 2.00 to 4.0x, and Hatanaka-compressed
//! observation files (CRINEX 1 and 3). Written: version 3.05. GPS, GLONASS, Galileo, BeiDou and
//! QZSS are decoded; other systems are skipped and counted in [`Skipped`].
//!
//! A reader holds one buffer of 64 kB and one epoch. Errors inside the data are skipped with line
//! and reason, so that the valid rest of the file is read; what makes the whole file unreadable is
//! a [`RinexError`].
//!
//! Interpretation where the format is ambiguous:
//! - Blank and zero observations are missing (RINEX 3.05).
//! - `SYS / PHASE SHIFT` lists corrections already applied to align carriers (RINEX 3.05), so the
//!   phases are used as they are.
//! - Observations are divided by `SYS / SCALE FACTOR`.
//! - Loss-of-lock indicator: bit 0 is loss of lock, bit 1 half-cycle ambiguity; bit 2
//!   (anti-spoofing in RINEX 2, BOC tracking later) is ignored. RTKLIB's convbin 2.4 adds 3, not 2,
//!   for half cycles that RTCM 3 messages report: where the header says that it made the file of
//!   RTCM 3, 3 is a half-cycle ambiguity alone and 4 a loss of lock with it.
//! - RINEX 2 observation types are mapped to RINEX 3 codes as in the `columns` module.
//! - Receiver clock offsets on epoch lines are not applied: epochs keep the receiver's time tags.
//!
//! # Example
//!
//! Two epochs written and read again:
//!
//! ```
//! use graphfix_compute::formats::rinex::{
//!     ObservationHeader, ObservationReader, ObservationWriter, RinexVersion,
//! };
//! use graphfix_compute::gnss::{Epoch, GpsTime};
//! use graphfix_compute::simulation::{Scenario, Simulator};
//!
//! let scenario = Scenario { duration_s: 2.0, ..Scenario::open_sky() };
//! let epochs: Vec<Epoch> = Simulator::new(scenario, 1).map(|epoch| epoch.rover).collect();
//! let mut header = ObservationHeader::new(RinexVersion::new(3, 5));
//! for observation in &epochs[0].observations {
//!     let codes = &mut header.codes[observation.satellite.constellation.index()];
//!     if !codes.contains(&observation.code) {
//!         codes.push(observation.code);
//!     }
//! }
//! let mut writer = ObservationWriter::new(Vec::new(), &header)?;
//! for epoch in &epochs {
//!     writer.write_epoch(epoch)?;
//! }
//! let file = writer.finish()?;
//!
//! let mut reader = ObservationReader::new(file.as_slice())?;
//! let (mut epoch, mut count) = (Epoch::new(GpsTime::EPOCH), 0);
//! while reader.read_epoch(&mut epoch)? {
//!     assert_eq!(epoch.observations.len(), epochs[count].observations.len());
//!     count += 1;
//! }
//! assert_eq!((count, reader.skipped().is_empty()), (epochs.len(), true));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! Sources: RINEX 2.11 (Gurtner & Estey 2007); RINEX 3.05 (IGS/RTCM 2020); RINEX 4.01 (2023);
//! Hatanaka (2008), *A compression format and tools for GNSS observation data*, Bulletin of the
//! Geographical Survey Institute 55.

mod chunks;
mod columns;
mod compact;
mod differences;
mod epoch;
mod epoch2;
mod epoch3;
mod error;
mod fields;
mod header;
mod header_lines;
mod header_writer;
mod lines;
mod navigation;
mod navigation_writer;
mod observation;
mod observation_writer;
#[cfg(test)]
mod round_trip;
mod satellites;
mod skipped;

pub use chunks::ChunkReader;
pub use error::RinexError;
pub use header::{ObservationHeader, RinexVersion};
pub use header_writer::RinexWriteError;
pub use navigation::{read_navigation, read_navigation_within};
pub use navigation_writer::write_navigation;
pub use observation::ObservationReader;
pub use observation_writer::ObservationWriter;
pub use skipped::{SkipReason, Skipped, SkippedEntry};
