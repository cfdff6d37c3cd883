//! Standard output and standard error of the commands.
//!
//! `println!` and `eprintln!` panic where nobody reads or the disk is full. A command ends with a
//! failure if its result cannot be written, and goes on without lines that only tell its progress.

use std::io::{self, ErrorKind, Write};

use crate::refusal::Code;

use super::Failure;

/// Writes a result to standard output. A reader that has read enough and closed the pipe is no
/// failure.
///
/// # Errors
/// It cannot be written, for instance to a full disk.
pub(super) fn print(text: &str) -> Result<(), Failure> {
    match written(text) {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => Err(failure(&error)),
        _ => Ok(()),
    }
}

/// Writes what is shown only once to standard output.
///
/// # Errors
/// It cannot be written; a closed pipe counts, too.
pub(super) fn print_once(text: &str) -> Result<(), Failure> {
    written(text).map_err(|error| failure(&error))
}

fn written(text: &str) -> io::Result<()> {
    let mut output = io::stdout().lock();
    output.write_all(text.as_bytes())?;
    output.flush()
}

fn failure(error: &io::Error) -> Failure {
    Failure::of(Code::FileNotWritable, format!("cannot write to standard output: {error}"))
}

/// A line on standard output about the progress.
macro_rules! say {
    ($($text:tt)*) => {{
        use std::io::Write as _;
        writeln!(std::io::stdout(), $($text)*).ok(); // Err: nobody reads it.
    }};
}

/// A line on standard error about the progress, or about a failure.
macro_rules! note {
    ($($text:tt)*) => {{
        use std::io::Write as _;
        writeln!(std::io::stderr(), $($text)*).ok(); // Err: nobody reads it.
    }};
}

pub(super) use {note, say};
