//! Why a recording is refused. The doors give each reason its code and remedy.

use std::io;

use crate::gnss::FrameRefusal;

/// Why a recording cannot be positioned.
#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    /// A file cannot be opened.
    #[error("cannot open {name}: {source}")]
    NotReadable {
        /// The file.
        name: String,
        /// What the system reports.
        source: io::Error,
    },
    /// A file is damaged, or not of the required kind.
    #[error("{name}: {reason}")]
    NotUnderstood {
        /// The file.
        name: String,
        /// What is wrong, and where.
        reason: String,
        /// What the user can do about it.
        remedy: &'static str,
    },
    /// Receiver data without a GPS week.
    #[error("nothing gives the GPS week of {name}")]
    NoReferenceTime {
        /// The file.
        name: String,
    },
    /// No navigation data are named, and neither rover nor base can hold any.
    #[error("no navigation data are named, and {name} holds none")]
    NavigationRequired {
        /// The rover's file.
        name: String,
    },
    /// No source gives the base's position.
    #[error("{reason}")]
    BasePositionMissing {
        /// The sources that were tried.
        reason: &'static str,
    },
    /// The mode is relative to a base, and the recording has none.
    #[error("mode {mode} needs a base")]
    BaseRequired {
        /// The mode.
        mode: &'static str,
    },
    /// Positions relative to the base cannot be given in the frame that is asked for.
    #[error("positions cannot be given in the ETRS89: {refusal}")]
    FrameUnavailable {
        /// Why not.
        refusal: FrameRefusal,
    },
    /// The mode has no window, so it does not give this kind of answer.
    #[error("mode {mode} has no answer {answer:?}")]
    NoSuchAnswer {
        /// The mode.
        mode: &'static str,
        /// The requested kind of answer.
        answer: &'static str,
    },
    /// The rover has no epoch in the requested span of time.
    #[error("{name} has no epoch, or none in the span of time")]
    NoEpochs {
        /// The rover's file.
        name: String,
    },
}
