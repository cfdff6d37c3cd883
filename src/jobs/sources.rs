//! The source of the epochs of a run: the files of a recording, or the stored epochs of a session.

use tokio::runtime::Handle;

use crate::config::Mode;
use crate::formats::receiver::TimeReference;
use crate::gnss::{LeapSeconds, Solution};
use crate::recording::{AnswerKind, BaseRecording, Input, Provenance, Recording, Solutions};
use crate::session::{Rerun, RerunRequest, SessionError, SessionId};
use crate::snapshot::SnapshotError;

use super::Failure;
use super::request::{Plan, SessionInput};
use super::watched::Watched;

/// Most epochs of a session that are answered together, because they are all in memory.
const BATCH_EPOCHS: u64 = 100_000;

/// Epochs that a run positions one by one.
pub(super) trait Source {
    /// Reads the data for the next steps. Returns false once everything is computed.
    ///
    /// # Errors
    /// It cannot be read.
    fn read(&mut self, runtime: &Handle) -> Result<bool, Failure>;

    /// Positions the next epoch, or returns the last answers. Appends the answers that are due.
    /// Returns whether another step can follow without a read.
    ///
    /// # Errors
    /// A file cannot be read.
    fn step(&mut self, due: &mut Vec<Solution>) -> Result<bool, Failure>;

    /// The state from which [`Self::resume`] continues after the last step; `None` before the first
    /// step, and if all answers come at the end.
    fn checkpoint(&self) -> Option<Vec<u8>>;

    /// Continues after a checkpoint of the same job. The epochs before the checkpoint are read
    /// again, but get no answers. Returns false if this program cannot read the checkpoint.
    ///
    /// # Errors
    /// Data that the checkpoint depends on cannot be read.
    fn resume(&mut self, checkpoint: &[u8], runtime: &Handle) -> Result<bool, Failure>;

    /// The recording and the reports of its readers, if the source is files.
    fn recording(&self) -> Option<(&Recording<'_>, &Watched)>;

    /// Leap seconds of the navigation data.
    fn leap_seconds(&self) -> LeapSeconds;

    /// Number of the rover's epochs that are read.
    fn epochs(&self) -> u64;

    /// Bytes of the rover's file, or numbers of the session's epochs, that are read.
    fn passed(&self) -> u64;

    /// The data on which the positions so far rest.
    fn provenance(&self) -> Provenance;

    /// Further lines for the report.
    fn remarks(&self) -> Vec<String>;
}

/// The files of a recording.
pub(super) struct Files<'a> {
    solutions: Solutions<'a>,
    watched: Watched,
    has_more: bool,
}

impl<'a> Files<'a> {
    pub(super) const fn new(solutions: Solutions<'a>, watched: Watched) -> Self {
        Self { solutions, watched, has_more: true }
    }
}

impl Source for Files<'_> {
    fn read(&mut self, _: &Handle) -> Result<bool, Failure> {
        Ok(self.has_more)
    }

    fn step(&mut self, due: &mut Vec<Solution>) -> Result<bool, Failure> {
        let stepped = self.solutions.step(due);
        self.has_more = stepped.map_err(|error| self.watched.failure(&error))?;
        Ok(self.has_more)
    }

    fn checkpoint(&self) -> Option<Vec<u8>> {
        self.solutions.checkpoint()
    }

    fn resume(&mut self, checkpoint: &[u8], _: &Handle) -> Result<bool, Failure> {
        let resumed = self.solutions.resume(checkpoint);
        Ok(resumed.inspect_err(unreadable).is_ok())
    }

    fn recording(&self) -> Option<(&Recording<'_>, &Watched)> {
        Some((self.solutions.recording(), &self.watched))
    }

    fn leap_seconds(&self) -> LeapSeconds {
        self.solutions.leap_seconds()
    }

    fn epochs(&self) -> u64 {
        self.solutions.epochs()
    }

    fn passed(&self) -> u64 {
        self.watched.rover_bytes()
    }

    fn provenance(&self) -> Provenance {
        self.solutions.provenance()
    }

    fn remarks(&self) -> Vec<String> {
        Vec::new()
    }
}

fn unreadable(error: &SnapshotError) {
    tracing::warn!(%error, "a job begins again, as its checkpoint cannot be read");
}

/// The stored epochs of a session.
pub(super) struct SessionEpochs<'a> {
    rerun: Rerun<'a>,
    id: SessionId,
    session: &'a SessionInput,
    mode: Mode,
    answer: AnswerKind,
    watched: Watched,
    /// Number of epochs so far.
    epochs: u64,
    is_read: bool,
    is_done: bool,
}

impl<'a> SessionEpochs<'a> {
    /// The epochs of a session that is open.
    pub(super) fn new(
        rerun: Rerun<'a>,
        (id, request): (SessionId, &RerunRequest),
        session: &'a SessionInput,
        mode: Mode,
        watched: Watched,
    ) -> Self {
        let (answer, epochs, is_read, is_done) = (request.answer, 0, false, false);
        Self { rerun, id, session, mode, answer, watched, epochs, is_read, is_done }
    }

    /// From now on, takes the epochs of the base from a file. The rover's first epoch must be read.
    ///
    /// # Errors
    /// The file cannot be read, or no source gives the position.
    pub(super) fn follow(&mut self, base: &'a Input, plan: &Plan) -> Result<(), Failure> {
        let Some((time, navigation)) = self.rerun.next_epoch() else { return Ok(()) };
        let reference = plan.reference.unwrap_or(TimeReference::Day(time));
        let base = BaseRecording::beside(base, plan.base_position, reference, navigation);
        self.rerun.follow(base.map_err(|error| self.watched.failure(&error))?);
        Ok(())
    }
}

impl Source for SessionEpochs<'_> {
    fn read(&mut self, runtime: &Handle) -> Result<bool, Failure> {
        if !self.is_read {
            let read = runtime.block_on(self.rerun.read());
            self.is_read = !read.map_err(|error| Failure::of_session(&error))?;
        }
        if self.is_read && self.epochs == 0 {
            let error = SessionError::NoEpochInSpan { id: self.id.to_string() };
            return Err(Failure::of_session(&error));
        }
        Ok(!self.is_done)
    }

    fn step(&mut self, due: &mut Vec<Solution>) -> Result<bool, Failure> {
        let stepped = self.rerun.step(due);
        if stepped.map_err(|error| self.watched.failure(&error))? {
            self.epochs += 1;
            return match self.answer == AnswerKind::Batch && BATCH_EPOCHS < self.epochs {
                true => Err(Failure::of_long_batch(BATCH_EPOCHS)),
                false => Ok(true),
            };
        }
        if self.is_read {
            self.rerun.finish(due);
            self.is_done = true;
        }
        Ok(false)
    }

    fn checkpoint(&self) -> Option<Vec<u8>> {
        self.rerun.checkpoint()
    }

    fn resume(&mut self, checkpoint: &[u8], runtime: &Handle) -> Result<bool, Failure> {
        let resumed = runtime.block_on(self.rerun.resume(checkpoint));
        let resumed = resumed.map_err(|error| Failure::of_session(&error))?;
        Ok(resumed.inspect_err(unreadable).is_ok())
    }

    fn recording(&self) -> Option<(&Recording<'_>, &Watched)> {
        None
    }

    fn leap_seconds(&self) -> LeapSeconds {
        self.rerun.leap_seconds()
    }

    fn epochs(&self) -> u64 {
        self.epochs
    }

    fn passed(&self) -> u64 {
        self.rerun.passed()
    }

    fn provenance(&self) -> Provenance {
        let base = self.rerun.base();
        let left_out = base.map(BaseRecording::left_out).into_iter();
        Provenance {
            base: base.map(BaseRecording::provenance),
            is_base_unused: false,
            antennas: Vec::new(),
            out_of_time: 0,
            unmatched_odometry: None,
            left_out: left_out.map(|(name, left_out)| (name.to_owned(), left_out)).collect(),
        }
    }

    fn remarks(&self) -> Vec<String> {
        let (first, last) = self.session.numbers;
        let mut lines = vec![format!(
            "session {}: epochs {first} to {last}, each with the navigation data with which it was \
             answered",
            self.id
        )];
        if self.session.is_as_answered {
            lines.push("options and base epochs are those of the session's answers".to_owned());
        } else if self.mode.is_relative() && self.rerun.base().is_none() {
            lines.push("base epochs are those that are stored now".to_owned());
        }
        let bases = self.rerun.bases();
        lines.extend((!bases.is_empty()).then(|| format!("base {}", bases.join(", "))));
        if let Some(removed) = self.rerun.removed_through() {
            lines.push(format!(
                "warning: epochs through {removed} were removed by the session's retention before \
                 they were read"
            ));
        }
        lines
    }
}
