//! The desk for recordings: files of a rover, of a base and of what belongs to them, positioned
//! together.
//!
//! [`Solutions`] gives the positions of the recording that [`RecordingInputs`] name. The rules
//! stand here and not in the doors: which source gives the base's position ([`BasePosition`]), what
//! dates receiver data without a GPS week, which observations are corrected for antennas
//! ([`ApproximatePosition`]), which row of odometry belongs to which epoch, and which of the
//! estimator's answers is the one asked for ([`AnswerKind`]). [`Provenance`] says afterwards what
//! was decided and what was left out.
//!
//! Nothing here opens a file: an [`Input`] is a name and a way to read its bytes from the first
//! one. It is read several times, to recognise its format, to date it and to find the station.

mod answers;
mod antenna;
mod base;
mod error;
mod input;
mod navigation;
mod observations;
mod odometry;
mod provenance;
mod reading;
mod solutions;

pub use answers::{AnswerKind, Solver};
pub use antenna::ApproximatePosition;
pub use base::BasePosition;
pub use error::RecordingError;
pub use input::Input;
pub use provenance::{AntennaProvenance, BaseProvenance, Provenance};
pub use reading::{Recording, RecordingInputs};
pub use solutions::Solutions;
