//! The desk for recordings: positions the files of a rover with those of a base and of navigation
//! data.
//!
//! [`Solutions`] gives the positions of the recording that [`RecordingInputs`] name. This module,
//! not the doors, has the rules: which source gives the base's position ([`BasePosition`]), what
//! dates receiver data without a GPS week, which observations are corrected for antennas
//! ([`ApproximatePosition`]), which row of odometry belongs to which epoch, and which kind of
//! answer the estimator gives ([`AnswerKind`]). [`Provenance`] reports these decisions and the
//! skipped content.
//!
//! [`Survey`] tells time, place and ephemerides of a recording's own files, before the rest is
//! chosen.
//!
//! Nothing here opens a file. An [`Input`] is a name and a way to read its bytes from the first
//! one; it is read several times, to recognise its format, to date it and to find the station.

mod answers;
mod antenna;
mod base;
mod error;
mod export;
mod input;
mod navigation;
mod observations;
mod odometry;
mod order;
mod provenance;
mod reading;
mod solutions;
mod span;
mod survey;
mod writing;

pub use answers::{AnswerKind, Solver};
pub use antenna::ApproximatePosition;
pub use base::{BasePosition, BaseRecording};
pub use error::RecordingError;
pub use export::{ExportError, ObservationExport};
pub use input::Input;
pub use provenance::{AntennaProvenance, BaseProvenance, Provenance};
pub use reading::{Recording, RecordingInputs};
pub use solutions::Solutions;
pub use survey::{InForce, Survey};
pub use writing::{SolutionWriter, Tally, comments_of};
