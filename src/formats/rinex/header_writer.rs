//! What both writers share: header lines, and why writing fails.

use std::fmt::Write;
use std::io;

use crate::gnss::{NavigationMessage, SatelliteId, Signal};

/// Why something cannot be written as RINEX 3.05.
#[derive(Debug, thiserror::Error)]
pub enum RinexWriteError {
    /// The header does not list the signal.
    #[error("signal {signal} is not in the file's header")]
    UndeclaredSignal {
        /// The signal.
        signal: Signal,
    },
    /// A number has more digits than its columns.
    #[error("{value} of signal {signal} does not fit into its columns")]
    ValueTooLarge {
        /// The signal.
        signal: Signal,
        /// The number.
        value: f64,
    },
    /// More satellites than an epoch line can count.
    #[error("{satellites} satellites in one epoch, 999 can be written")]
    TooManySatellites {
        /// How many there are.
        satellites: usize,
    },
    /// Version 3 has no form for the message.
    #[error("the {message:?} message of {satellite} has no form in RINEX 3")]
    MessageUnsupported {
        /// The satellite.
        satellite: SatelliteId,
        /// Its message.
        message: NavigationMessage,
    },
    /// The output failed.
    #[error("writing failed: {0}")]
    WriteFailed(#[from] io::Error),
}

/// The label of a header line, from column 60 on.
pub(super) struct Label(pub(super) &'static str);

/// Appends a header line; content beyond column 60 is cut.
pub(super) fn header_line(text: &mut String, content: &str, Label(label): Label) {
    // One column per byte, as readers count.
    let ascii: String = content.chars().map(|c| if c.is_ascii() { c } else { '?' }).collect();
    writeln!(text, "{ascii:60.60}{label}").expect("a String takes all");
}
