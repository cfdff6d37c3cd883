//! Header lines and errors of both writers.

use std::fmt::Write;
use std::io;

use crate::gnss::{NavigationMessage, SatelliteId, Signal};

/// Why data cannot be written as RINEX 3.05.
#[derive(Debug, thiserror::Error)]
pub enum RinexWriteError {
    /// The header does not list the signal.
    #[error("signal {signal} is not in the file's header")]
    UndeclaredSignal {
        /// The signal that is missing.
        signal: Signal,
    },
    /// A number has more digits than its columns allow.
    #[error("{value} of signal {signal} does not fit into its columns")]
    ValueTooLarge {
        /// The signal of the number.
        signal: Signal,
        /// The number, in the unit of the file.
        value: f64,
    },
    /// An epoch has more satellites than an epoch line can count.
    #[error("{satellites} satellites in one epoch, 999 can be written")]
    TooManySatellites {
        /// Number of satellites in the epoch.
        satellites: usize,
    },
    /// Version 3 has no record for the navigation message.
    #[error("the {message:?} message of {satellite} has no record in RINEX 3")]
    MessageUnsupported {
        /// The satellite of the message.
        satellite: SatelliteId,
        /// The type of the message.
        message: NavigationMessage,
    },
    /// The output cannot be written.
    #[error("writing failed: {0}")]
    WriteFailed(#[from] io::Error),
}

/// The label of a header line, from column 60 on.
pub(super) struct Label(pub(super) &'static str);

/// Appends a header line; content beyond column 60 is cut off.
pub(super) fn header_line(text: &mut String, content: &str, Label(label): Label) {
    // Readers count bytes as columns.
    let ascii: String = content.chars().map(|c| if c.is_ascii() { c } else { '?' }).collect();
    writeln!(text, "{ascii:60.60}{label}").expect("a String takes all");
}
