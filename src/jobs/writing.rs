//! Writes the result of a run into its file.

use std::fs::File;
use std::io::{self, BufWriter};

use crate::config::PositioningOptions;
use crate::formats::result::ResultFormat;
use crate::gnss::{FrameRefusal, LeapSeconds, Presentation, Solution};
use crate::recording::{SolutionWriter, comments_of};
use crate::refusal::Code;

use super::Failure;

const WRITE_BUFFER_BYTES: usize = 1 << 16;

/// The file of a result that is being written.
pub(super) enum ResultWriter {
    /// Positions, as they come.
    Positions(SolutionWriter<BufWriter<File>>),
    /// The rover's observations, once all epochs are positioned.
    Observations(BufWriter<File>),
}

impl ResultWriter {
    /// Begins a file in this format, of answers with these options.
    ///
    /// # Errors
    /// The disk fails.
    pub(super) fn begin(
        file: File,
        format: ResultFormat,
        options: &PositioningOptions,
        (leap, presentation): (LeapSeconds, Presentation),
    ) -> io::Result<Self> {
        let file = BufWriter::with_capacity(WRITE_BUFFER_BYTES, file);
        match format {
            ResultFormat::Rinex => Ok(Self::Observations(file)),
            ResultFormat::Track(format) => {
                let comments = comments_of(options);
                let writer = SolutionWriter::new(file, format, &comments, leap, presentation);
                writer.map(Self::Positions)
            }
        }
    }

    /// Writes a position. Returns why it is not in the frame that is asked for.
    ///
    /// # Errors
    /// The disk fails.
    pub(super) fn write(&mut self, solution: &Solution) -> io::Result<Option<FrameRefusal>> {
        match self {
            Self::Positions(writer) => writer.write(solution),
            Self::Observations(_) => Ok(None),
        }
    }

    /// Number of bytes written so far.
    pub(super) const fn bytes(&self) -> u64 {
        match self {
            Self::Positions(writer) => writer.bytes(),
            Self::Observations(_) => 0,
        }
    }
}

pub(super) fn unwritable(error: &io::Error) -> Failure {
    Failure::new(Code::JobFilesFailed, format!("writing the result: {error}"), None)
}
