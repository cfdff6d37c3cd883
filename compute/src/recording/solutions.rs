//! The positions of a recording.

use std::collections::VecDeque;

use crate::config::PositioningOptions;
use crate::gnss::{Epoch, GpsTime, LeapSeconds, Solution};
use crate::snapshot::{Snapshot, SnapshotError, SnapshotReader, SnapshotWriter};

use super::{AnswerKind, Provenance, Recording, RecordingError, RecordingInputs, Solver};

/// Layout of checkpoints, around snapshots of solvers. Raise it when their content changes.
const LAYOUT: u16 = 1;

/// The positions of a recording, in the order in which the estimator gives them: one for each epoch
/// of the requested span.
///
/// An error ends the iteration. A recording without an epoch in the span is an error.
///
/// ```no_run
/// use std::fs::File;
/// use std::io::BufReader;
///
/// use graphfix_compute::config::{Mode, PositioningOptions, Profile};
/// use graphfix_compute::recording::{AnswerKind, Input, RecordingInputs, Solutions};
///
/// let file = |path: &'static str| {
///     Input::new(path.to_owned(), move || Ok(Box::new(BufReader::new(File::open(path)?))))
/// };
/// let inputs = RecordingInputs {
///     navigation: vec![file("navigation.rnx")],
///     base: Some(file("base.obs")),
///     ..RecordingInputs::of_rover(file("rover.obs"))
/// };
/// let options = PositioningOptions::new(Mode::RtkFgo, Profile::General);
/// let mut solutions = Solutions::open(&inputs, options, AnswerKind::Causal)?;
/// for solution in &mut solutions {
///     println!("{:?}", solution?.estimate);
/// }
/// println!("{}", solutions.provenance().lines().join("\n"));
/// # Ok::<(), graphfix_compute::recording::RecordingError>(())
/// ```
pub struct Solutions<'a> {
    recording: Recording<'a>,
    /// Whether the mode is relative to the base.
    is_relative: bool,
    /// `None` after the last answer.
    solver: Option<Solver>,
    epoch: Epoch,
    /// Number of epochs that are read.
    epochs: u64,
    /// Number of epochs before the checkpoint after which it goes on. They are read only.
    positioned: u64,
    /// Answers that have not been returned yet.
    due: VecDeque<Solution>,
}

impl<'a> Solutions<'a> {
    /// Opens the files and reads their headers and the navigation data.
    ///
    /// # Errors
    /// A file cannot be read or dated, no source gives the base's position, or the mode or the kind
    /// of answer is refused.
    pub fn open(
        inputs: &'a RecordingInputs,
        options: PositioningOptions,
        answer: AnswerKind,
    ) -> Result<Self, RecordingError> {
        inputs.check(&options, answer)?;
        Ok(Self {
            recording: Recording::open(inputs)?,
            is_relative: options.mode.is_relative(),
            solver: Some(Solver::new(options, answer)),
            epoch: Epoch::new(GpsTime::EPOCH),
            epochs: 0,
            positioned: 0,
            due: VecDeque::new(),
        })
    }

    /// Leap seconds of the navigation data.
    pub fn leap_seconds(&self) -> LeapSeconds {
        self.recording.navigation().leap_seconds
    }

    /// The recording, which it reads.
    pub const fn recording(&self) -> &Recording<'a> {
        &self.recording
    }

    /// The provenance of the positions so far.
    pub fn provenance(&self) -> Provenance {
        let provenance = self.recording.provenance();
        match self.is_relative {
            true => provenance,
            false => provenance.without_base(),
        }
    }

    /// What [`Self::resume`] needs to go on after the last epoch: the number of epochs and the
    /// state of the estimator. `None` if all answers come at the end.
    pub fn checkpoint(&self) -> Option<Vec<u8>> {
        let mut writer = SnapshotWriter::new(LAYOUT);
        self.epochs.max(self.positioned).save(&mut writer);
        writer.bytes(&self.solver.as_ref()?.snapshot()?);
        Some(writer.finish())
    }

    /// Goes on after a checkpoint of the same inputs, options and kind of answer, with the same
    /// bits. The epochs before it are read again, and have no answers. Call it before the first
    /// epoch.
    ///
    /// # Errors
    /// The bytes are no such checkpoint, or have another layout. Nothing has changed then.
    pub fn resume(&mut self, checkpoint: &[u8]) -> Result<(), SnapshotError> {
        let mut reader = SnapshotReader::open(checkpoint, LAYOUT)?;
        let positioned = u64::load(&mut reader)?;
        let snapshot = reader.bytes()?;
        reader.finish()?;
        if let Some(solver) = &mut self.solver {
            *solver = solver.restored(snapshot)?;
            self.positioned = positioned;
        }
        Ok(())
    }

    /// Positions the next epoch, or at the end gives the estimator's remaining answers. Appends
    /// the answers that are due to `answers`. Returns whether the recording goes on.
    ///
    /// # Errors
    /// A file cannot be read, or the recording has no epoch. Nothing follows then.
    pub fn step(&mut self, answers: &mut Vec<Solution>) -> Result<bool, RecordingError> {
        let advanced = self.advance();
        answers.extend(self.due.drain(..));
        if advanced.is_err() {
            self.solver = None;
        }
        advanced.map(|()| self.solver.is_some())
    }

    /// Number of the rover's epochs that are read.
    pub const fn epochs(&self) -> u64 {
        self.epochs
    }

    fn advance(&mut self) -> Result<(), RecordingError> {
        let Some(solver) = &mut self.solver else { return Ok(()) };
        if self.recording.read_epoch(&mut self.epoch)? {
            self.epochs += 1;
            if self.positioned < self.epochs {
                self.due.extend(solver.advance(&self.epoch, &self.recording.aiding()));
            }
            return Ok(());
        }
        self.due.extend(self.solver.take().map(Solver::finish).unwrap_or_default());
        if self.epochs == 0 {
            return Err(self.recording.without_epochs());
        }
        Ok(())
    }
}

impl Iterator for Solutions<'_> {
    type Item = Result<Solution, RecordingError>;

    fn next(&mut self) -> Option<Self::Item> {
        while self.due.is_empty() && self.solver.is_some() {
            if let Err(error) = self.advance() {
                self.solver = None;
                return Some(Err(error));
            }
        }
        self.due.pop_front().map(Ok)
    }
}

#[cfg(test)]
mod tests {
    use std::io::{Read, Write};

    use super::*;
    use crate::config::{Mode, Profile};
    use crate::formats::receiver::RawxWriter;
    use crate::formats::rinex::{
        ObservationHeader, ObservationWriter, RinexVersion, write_navigation,
    };
    use crate::gnss::{Ecef, PositionSource, Reason};
    use crate::recording::{BasePosition, Input};
    use crate::simulation::{Scenario, Simulator};

    const EPOCHS: usize = 20;

    fn options(mode: Mode) -> PositioningOptions {
        PositioningOptions::new(mode, Profile::General)
    }

    /// A simulated rover with a base whose header gives no position.
    fn simulated() -> RecordingInputs {
        let scenario = Scenario { duration_s: EPOCHS as f64 - 1.0, ..Scenario::rtk_open() };
        let mut header = ObservationHeader::new(RinexVersion::new(3, 5));
        for constellation in &scenario.constellations {
            header.codes[constellation.index()] = scenario.signals(*constellation).collect();
        }
        let simulator = Simulator::new(scenario, 1);
        let mut navigation = Vec::new();
        write_navigation(&mut navigation, simulator.navigation()).unwrap();
        let writer = || ObservationWriter::new(Vec::new(), &header).unwrap();
        let (mut rover, mut base) = (writer(), writer());
        for epoch in simulator {
            rover.write_epoch(&epoch.rover).unwrap();
            base.write_epoch(&epoch.base.unwrap()).unwrap();
        }
        let input = |name: &str, bytes: Vec<u8>| Input::from_bytes(name.to_owned(), bytes.into());
        RecordingInputs {
            navigation: vec![input("navigation", navigation)],
            base: Some(input("base", base.finish().unwrap())),
            ..RecordingInputs::of_rover(input("rover", rover.finish().unwrap()))
        }
    }

    /// The same with the eighth epoch written twice, and the fourth once more after it.
    fn twice_written(inputs: &RecordingInputs) -> RecordingInputs {
        let mut text = String::new();
        inputs.rover.open().unwrap().read_to_string(&mut text).unwrap();
        let starts: Vec<usize> = text.match_indices("\n>").map(|(at, _)| at + 1).collect();
        let epoch = |index: usize| &text[starts[index]..starts[index + 1]];
        let disturbed = [&text[..starts[8]], epoch(7), epoch(3), &text[starts[8]..]].concat();
        let rover = Input::from_bytes("rover".to_owned(), disturbed.into_bytes().into());
        RecordingInputs { rover, ..simulated() }
    }

    /// With every kind of answer, each epoch has one, in the order of time.
    #[test]
    fn each_epoch_is_answered_once() {
        let inputs = simulated();
        for answer in [AnswerKind::Causal, AnswerKind::FixedLag, AnswerKind::Batch] {
            let solutions = Solutions::open(&inputs, options(Mode::Fgo), answer).unwrap();
            let times: Vec<GpsTime> = solutions.map(|solution| solution.unwrap().time).collect();
            assert_eq!(times.len(), EPOCHS, "{answer:?}");
            assert!(times.is_sorted(), "{answer:?}");
        }
    }

    /// Epochs written twice, and one out of order, repeat the answer before them. All other answers
    /// are the same as without them.
    #[test]
    fn epochs_not_after_the_last_one_repeat_its_answer() {
        let inputs = simulated();
        let again = twice_written(&inputs);
        for answer in [AnswerKind::Causal, AnswerKind::FixedLag, AnswerKind::Batch] {
            let all = |inputs: &RecordingInputs| -> Vec<Solution> {
                let solutions = Solutions::open(inputs, options(Mode::Fgo), answer).unwrap();
                solutions.map(Result::unwrap).collect()
            };
            let (plain, mut with) = (all(&inputs), all(&again));
            let repeated: Vec<Solution> = with.drain(8..10).collect();
            assert_eq!(with, plain, "{answer:?}");
            for (solution, behind_s) in repeated.into_iter().zip([0.0, 4.0]) {
                let mut expected = plain[7].clone();
                expected.reasons.push(Reason::EpochRepeated { behind_s });
                assert_eq!(solution, expected, "{answer:?}");
            }
        }
    }

    /// Wherever a recording is cut off, the answers before the checkpoint and those after it are
    /// the answers of a recording that is not; also with epochs that are written twice.
    #[test]
    fn a_checkpoint_goes_on_with_the_same_bits() {
        let inputs = twice_written(&simulated());
        for (mode, answer) in [
            (Mode::Spp, AnswerKind::Causal),
            (Mode::RtkEkf, AnswerKind::Causal),
            (Mode::RtkFgo, AnswerKind::Causal),
            (Mode::RtkFgo, AnswerKind::FixedLag),
        ] {
            let open = || Solutions::open(&inputs, options(mode), answer).unwrap();
            let whole: Vec<Solution> = open().map(Result::unwrap).collect();
            for cut in [0, 1, 7, 9, 15, 21, 22] {
                let (mut first, mut answers) = (open(), Vec::new());
                for _ in 0..cut {
                    assert!(first.step(&mut answers).unwrap());
                }
                let (mut second, checkpoint) = (open(), first.checkpoint().unwrap());
                second.resume(&checkpoint).unwrap();
                assert_eq!(second.checkpoint().unwrap(), checkpoint);
                while second.step(&mut answers).unwrap() {}
                assert_eq!(answers, whole, "{mode:?} {answer:?} {cut}");
            }
        }
    }

    #[test]
    fn what_is_no_checkpoint_changes_nothing() {
        let inputs = simulated();
        let open = |mode, answer| Solutions::open(&inputs, options(mode), answer).unwrap();
        assert_eq!(open(Mode::Fgo, AnswerKind::Batch).checkpoint(), None);
        let other = open(Mode::RtkFgo, AnswerKind::Causal).checkpoint().unwrap();
        for answer in [AnswerKind::Causal, AnswerKind::Batch] {
            let mut solutions = open(Mode::Fgo, answer);
            let before = solutions.checkpoint();
            for wrong in [&other[..], &other[..other.len() - 1], b""] {
                assert!(solutions.resume(wrong).is_err(), "{answer:?}");
            }
            assert_eq!(solutions.checkpoint(), before);
            assert_eq!(solutions.filter(Result::is_ok).count(), EPOCHS);
        }
    }

    #[test]
    fn the_provenance_names_the_source_of_the_base_position() {
        let inputs = simulated();
        let mut solutions =
            Solutions::open(&inputs, options(Mode::RtkFgo), AnswerKind::Causal).unwrap();
        assert_eq!(solutions.by_ref().filter(Result::is_ok).count(), EPOCHS);
        let base = solutions.provenance().base.unwrap();
        assert_eq!(base.site.source, PositionSource::SinglePoints);
        assert_eq!(base.averaged, EPOCHS as u64);
    }

    #[test]
    fn a_base_that_the_mode_does_not_use_is_said_to_be_unused() {
        let inputs = simulated();
        let of = |mode| Solutions::open(&inputs, options(mode), AnswerKind::Causal).unwrap();
        let lines = of(Mode::Fgo).provenance().lines();
        assert_eq!(lines, ["base: not used, as the mode is not relative to one"]);
        let lines = of(Mode::RtkFgo).provenance().lines();
        assert!(lines[1].starts_with("base: marker at "), "{lines:?}");
    }

    /// Without navigation data, receiver data of the base are read for those, too.
    #[test]
    fn a_base_of_observations_and_navigation_data_is_listed_once() {
        let scenario = Scenario { duration_s: 3.0, ..Scenario::rtk_open() };
        let mut writer = RawxWriter::default();
        let epochs = Simulator::new(scenario, 1).map(|epoch| writer.frame(&epoch.base.unwrap()));
        let frames: Vec<u8> = epochs.flat_map(|frame| [frame, b"junk".to_vec()].concat()).collect();
        let base = Input::from_bytes("base".to_owned(), frames.into());
        let base_position = Some(BasePosition::Marker(Ecef::new(6_378_137.0, 0.0, 0.0)));
        let navigation = Vec::new();
        let inputs = RecordingInputs { base: Some(base), base_position, navigation, ..simulated() };
        let mut solutions =
            Solutions::open(&inputs, options(Mode::RtkFgo), AnswerKind::Causal).unwrap();
        assert_eq!(solutions.by_ref().filter(Result::is_ok).count(), EPOCHS);
        let left_out = solutions.provenance().left_out;
        let names: Vec<&str> = left_out.iter().map(|(name, _)| name.as_str()).collect();
        assert_eq!(names, ["rover", "base"]);
        let base = left_out[1].1.to_string();
        assert!(base.starts_with("left out 16 bytes that belong to no frame"), "{base}");
    }

    #[test]
    fn a_rover_without_an_epoch_before_its_gzip_stream_is_cut_off_is_refused() {
        let inputs = simulated();
        let mut text = Vec::new();
        inputs.rover.open().unwrap().read_to_end(&mut text).unwrap();
        let end = b"END OF HEADER\n";
        let header = text.windows(end.len()).position(|bytes| bytes == end).unwrap() + end.len();
        let mut packer = flate2::write::GzEncoder::new(Vec::new(), Default::default());
        packer.write_all(&text[..header]).unwrap();
        let mut packed = packer.finish().unwrap();
        packed.pop();
        let rover = Input::from_bytes("rover".to_owned(), packed.into());
        let cut = RecordingInputs { rover, ..inputs };
        let mut solutions = Solutions::open(&cut, options(Mode::Spp), AnswerKind::Causal).unwrap();
        let refused = solutions.next().unwrap().unwrap_err();
        let expected = format!(
            "rover: no epoch in the span; the gzip stream is cut off after {header} unpacked bytes"
        );
        assert_eq!(refused.to_string(), expected);
    }

    #[test]
    fn what_the_recording_has_not_is_refused() {
        let refusal = |inputs: &RecordingInputs, mode, answer| {
            Solutions::open(inputs, options(mode), answer).map(drop).unwrap_err()
        };
        let inputs = simulated();
        let refused = refusal(&inputs, Mode::Spp, AnswerKind::Batch);
        assert!(matches!(refused, RecordingError::NoSuchAnswer { .. }), "{refused}");
        let alone = RecordingInputs { base: None, ..simulated() };
        let refused = refusal(&alone, Mode::RtkEkf, AnswerKind::Causal);
        assert!(matches!(refused, RecordingError::BaseRequired { .. }), "{refused}");
        let late = RecordingInputs { from_s: Some(604_799.0), ..simulated() };
        let mut solutions = Solutions::open(&late, options(Mode::Spp), AnswerKind::Causal).unwrap();
        let refused = solutions.next().unwrap().unwrap_err();
        assert!(matches!(refused, RecordingError::NoEpochs { .. }), "{refused}");
        assert!(solutions.next().is_none());
    }
}
