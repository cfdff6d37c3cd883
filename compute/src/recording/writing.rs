//! Writes the positions of a recording, and counts them.

use std::collections::BTreeMap;
use std::io::{self, Write};

use crate::config::PositioningOptions;
use crate::formats::track::{TrackFormat, TrackWriter};
use crate::gnss::{FrameRefusal, LeapSeconds, Presentation, Solution, Status};

/// Lines at the head of a solution file: what computed it, and the frame of its positions.
pub fn comments_of(options: &PositioningOptions) -> Vec<String> {
    vec![
        format!("program   : graphfix {}", env!("CARGO_PKG_VERSION")),
        format!("mode      : {}, profile {}", options.mode.name(), options.profile.name()),
        format!("options   : {}", options.configuration_hash()),
        options.output.frame_comment(options.mode.is_relative()),
    ]
}

/// A solution file that is being written.
pub struct SolutionWriter<W> {
    output: W,
    writer: TrackWriter,
    presentation: Presentation,
    buffer: Vec<u8>,
    bytes: u64,
}

impl<W: Write> SolutionWriter<W> {
    /// Begins the file. `comments` stand at the head of a `.pos` file; `leap` converts GPS time to
    /// UTC; solutions are written as `presentation` has them.
    ///
    /// # Errors
    /// The output fails.
    pub fn new(
        output: W,
        format: TrackFormat,
        comments: &[String],
        leap: LeapSeconds,
        presentation: Presentation,
    ) -> io::Result<Self> {
        let writer = TrackWriter::of_computed(format, comments, leap, &presentation);
        let mut file = Self { output, writer, presentation, buffer: Vec::new(), bytes: 0 };
        file.writer.begin(&mut file.buffer);
        file.flush_buffer()?;
        Ok(file)
    }

    /// Writes one solution. Returns why its position is not in the frame that is asked for.
    ///
    /// # Errors
    /// The output fails.
    pub fn write(&mut self, solution: &Solution) -> io::Result<Option<FrameRefusal>> {
        // The base of a recording has no frame but that of the options.
        let presented = self.presentation.present(solution, |_| None);
        let refusal = presented.refusal;
        self.writer.push(presented, None, &mut self.buffer);
        self.flush_buffer().map(|()| refusal)
    }

    /// Number of bytes written so far.
    pub const fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Completes the file. Returns the output and the number of bytes.
    ///
    /// # Errors
    /// The output fails.
    pub fn finish(mut self) -> io::Result<(W, u64)> {
        self.writer.finish(&mut self.buffer);
        self.flush_buffer()?;
        self.output.flush()?;
        Ok((self.output, self.bytes))
    }

    fn flush_buffer(&mut self) -> io::Result<()> {
        self.output.write_all(&self.buffer)?;
        self.bytes += self.buffer.len() as u64;
        self.buffer.clear();
        Ok(())
    }
}

/// Counts of the epochs of a recording and of their answers.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Tally {
    /// Number of epochs.
    pub epochs: u64,
    /// Number of epochs with a position.
    pub answered: u64,
    /// Number of epochs by status, in order of first appearance.
    pub statuses: Vec<(&'static str, u64)>,
    /// Number of epochs by the code of a reason in their solution, in order of first appearance.
    pub reasons: Vec<(&'static str, u64)>,
    /// What the user can do about each reason, by its code.
    pub remedies: BTreeMap<&'static str, &'static str>,
}

impl Tally {
    /// Counts one epoch, with the reason why its position is in another frame, if there is one.
    pub fn add(&mut self, solution: &Solution, foreign: Option<FrameRefusal>) {
        self.epochs += 1;
        self.answered += u64::from(solution.status != Status::None);
        count(&mut self.statuses, solution.status.name());
        let reasons = &solution.reasons;
        for (index, reason) in reasons.iter().enumerate() {
            if reasons[..index].iter().any(|before| before.code() == reason.code()) {
                continue;
            }
            count(&mut self.reasons, reason.code());
            self.remedies.entry(reason.code()).or_insert(reason.remedy());
        }
        if let Some(refusal) = foreign {
            count(&mut self.reasons, FrameRefusal::CODE);
            self.remedies.entry(FrameRefusal::CODE).or_insert(refusal.remedy());
        }
    }
}

fn count(counts: &mut Vec<(&'static str, u64)>, name: &'static str) {
    match counts.iter_mut().find(|(known, _)| *known == name) {
        Some((_, count)) => *count += 1,
        None => counts.push((name, 1)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gnss::{GpsTime, Reason};

    #[test]
    fn epochs_statuses_and_reasons_are_counted() {
        let mut tally = Tally::default();
        let missing = Reason::BaseMissing;
        let twice = vec![missing.clone(), Reason::NotConverged, missing.clone()];
        for reasons in [vec![], vec![missing], twice] {
            tally.add(&Solution::none(GpsTime::EPOCH, reasons), None);
        }
        assert_eq!((tally.epochs, tally.answered), (3, 0));
        assert_eq!(tally.statuses, [("NONE", 3)]);
        assert_eq!(tally.reasons, [("BASE_MISSING", 2), ("NOT_CONVERGED", 1)]);
        assert_eq!(tally.remedies["BASE_MISSING"], Reason::BaseMissing.remedy());
    }

    #[test]
    fn a_position_of_another_frame_is_a_reason() {
        let mut tally = Tally::default();
        let nothing = Solution::none(GpsTime::EPOCH, Vec::new());
        tally.add(&nothing, Some(FrameRefusal::Outside));
        tally.add(&nothing, None);
        assert_eq!(tally.reasons, [(FrameRefusal::CODE, 1)]);
        assert_eq!(tally.remedies[FrameRefusal::CODE], FrameRefusal::Outside.remedy());
    }

    #[test]
    fn the_bytes_are_those_of_the_output() {
        let (leap, plain) = (LeapSeconds::table(), Presentation::default());
        let mut file =
            SolutionWriter::new(Vec::new(), TrackFormat::Csv, &[], leap, plain).expect("a Vec");
        file.write(&Solution::none(GpsTime::EPOCH, Vec::new())).expect("a Vec");
        let (output, bytes) = file.finish().expect("a Vec");
        assert_eq!(bytes, output.len() as u64);
        assert_eq!(output.iter().filter(|byte| **byte == b'\n').count(), 2);
    }
}
