//! The kinds of answers of an estimator: at once, smoothed, or from the whole recording.

use std::collections::VecDeque;

use crate::config::PositioningOptions;
use crate::gnss::{Epoch, GpsTime, Reason, Solution};
use crate::positioning::{Aiding, Batch, Estimator};
use crate::snapshot::{Snapshot, SnapshotError, SnapshotReader, SnapshotWriter, snapshot_fields};

/// Layout of a solver's snapshots, around those of estimators. Raise it when their content changes.
const LAYOUT: u16 = 1;

/// The kind of an answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AnswerKind {
    /// At once, from the epochs up to that one.
    Causal,
    /// When the epoch leaves the window, smoothed by the epochs after it.
    FixedLag,
    /// At the end, from all epochs.
    Batch,
}

impl AnswerKind {
    /// The name as users write it.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Causal => "causal",
            Self::FixedLag => "smoothed",
            Self::Batch => "batch",
        }
    }

    /// The kind of a name as users write it.
    pub fn from_name(name: &str) -> Option<Self> {
        [Self::Causal, Self::FixedLag, Self::Batch].into_iter().find(|kind| kind.name() == name)
    }
}

/// An estimator that gives one kind of answer.
///
/// An epoch whose time is not after the last one's does not reach the estimator: the answer to the
/// last one is repeated, with the reason `EPOCH_REPEATED`.
pub struct Solver {
    estimator: AnyEstimator,
    /// Time of the last epoch that the estimator has received.
    last: Option<GpsTime>,
    /// The last answer, if answers come at once.
    answer: Option<Solution>,
    /// Repetitions of epochs before the first answer, in order, if answers come later.
    repetitions: VecDeque<Repetition>,
}

/// A repeated epoch whose answer has not come yet.
#[derive(Clone, Copy)]
struct Repetition {
    of: GpsTime,
    behind_s: f64,
}

snapshot_fields!(Repetition { of, behind_s });

enum AnyEstimator {
    /// Answers at once, or when epochs leave the window.
    Window(AnswerKind, Box<Estimator>),
    /// Answers at the end.
    Whole(Box<Batch>),
}

impl Solver {
    /// A solver before its first epoch.
    pub fn new(options: PositioningOptions, kind: AnswerKind) -> Self {
        use AnyEstimator::{Whole, Window};
        let estimator = match kind {
            AnswerKind::Causal => Window(kind, Box::new(Estimator::new(options))),
            AnswerKind::FixedLag => Window(kind, Box::new(Estimator::revising(options))),
            AnswerKind::Batch => Whole(Box::new(Batch::new(options))),
        };
        Self { estimator, last: None, answer: None, repetitions: VecDeque::new() }
    }

    /// The answers due after an epoch.
    pub fn advance(&mut self, epoch: &Epoch, aiding: &Aiding<'_>) -> Vec<Solution> {
        if let Some(last) = self.last.filter(|last| epoch.time <= *last) {
            return self.repeat(Repetition { of: last, behind_s: last - epoch.time });
        }
        self.last = Some(epoch.time);
        match &mut self.estimator {
            AnyEstimator::Window(AnswerKind::FixedLag, estimator) => {
                estimator.advance(epoch, aiding);
                let revisions = estimator.take_revisions();
                interleave(&mut self.repetitions, revisions)
            }
            AnyEstimator::Window(_, estimator) => {
                let answer = estimator.advance(epoch, aiding);
                self.answer = Some(answer.clone());
                vec![answer]
            }
            AnyEstimator::Whole(batch) => {
                batch.push(epoch, aiding);
                Vec::new()
            }
        }
    }

    /// The state between two epochs as bytes; `None` if all answers come at the end.
    pub fn snapshot(&self) -> Option<Vec<u8>> {
        let Self { estimator: AnyEstimator::Window(_, estimator), last, answer, repetitions } =
            self
        else {
            return None;
        };
        let mut writer = SnapshotWriter::new(LAYOUT);
        last.save(&mut writer);
        answer.save(&mut writer);
        repetitions.save(&mut writer);
        writer.bytes(&estimator.snapshot());
        Some(writer.finish())
    }

    /// The solver of a [`Self::snapshot`] by one of the same options and kind of answer. It goes on
    /// with the same bits.
    ///
    /// # Errors
    /// The bytes are not such a snapshot, or have another layout.
    pub fn restored(&self, snapshot: &[u8]) -> Result<Self, SnapshotError> {
        let mut reader = SnapshotReader::open(snapshot, LAYOUT)?;
        let AnyEstimator::Window(kind, estimator) = &self.estimator else {
            return Err(reader.invalid("kind of answer"));
        };
        let (last, answer) = (Snapshot::load(&mut reader)?, Snapshot::load(&mut reader)?);
        let repetitions = Snapshot::load(&mut reader)?;
        let estimator = estimator.restored(reader.bytes()?)?;
        reader.finish()?;
        let estimator = AnyEstimator::Window(*kind, Box::new(estimator));
        Ok(Self { estimator, last, answer, repetitions })
    }

    /// The answers due at the end.
    pub fn finish(mut self) -> Vec<Solution> {
        let left = match self.estimator {
            AnyEstimator::Window(AnswerKind::FixedLag, estimator) => estimator.finish(),
            AnyEstimator::Window(..) => return Vec::new(),
            AnyEstimator::Whole(batch) => batch.finish(),
        };
        interleave(&mut self.repetitions, left)
    }

    /// Repeats the last answer, at once if there is one.
    fn repeat(&mut self, repetition: Repetition) -> Vec<Solution> {
        match &self.answer {
            Some(answer) => vec![repeated(answer, repetition.behind_s)],
            None => {
                self.repetitions.push_back(repetition);
                Vec::new()
            }
        }
    }
}

/// The solutions, each followed by its repetitions.
fn interleave(repetitions: &mut VecDeque<Repetition>, solutions: Vec<Solution>) -> Vec<Solution> {
    let mut all = Vec::with_capacity(solutions.len());
    for solution in solutions {
        let place = all.len();
        all.push(solution);
        while let Some(next) = repetitions.front().filter(|r| r.of == all[place].time) {
            let again = repeated(&all[place], next.behind_s);
            all.push(again);
            repetitions.pop_front();
        }
    }
    all
}

fn repeated(solution: &Solution, behind_s: f64) -> Solution {
    let mut again = solution.clone();
    again.reasons.push(Reason::EpochRepeated { behind_s });
    again
}
