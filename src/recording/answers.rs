//! Which of an estimator's answers is asked for: at once, smoothed, or from the whole recording.

use crate::config::PositioningOptions;
use crate::gnss::{Epoch, Solution};
use crate::positioning::{Aiding, Batch, Estimator};

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
pub enum Solver {
    /// Answers at once, or when epochs leave the window.
    Window(AnswerKind, Box<Estimator>),
    /// Answers at the end.
    Whole(Box<Batch>),
}

impl Solver {
    /// A solver before its first epoch.
    pub fn new(options: PositioningOptions, kind: AnswerKind) -> Self {
        match kind {
            AnswerKind::Causal => Self::Window(kind, Box::new(Estimator::new(options))),
            AnswerKind::FixedLag => Self::Window(kind, Box::new(Estimator::revising(options))),
            AnswerKind::Batch => Self::Whole(Box::new(Batch::new(options))),
        }
    }

    /// The answers due after an epoch.
    pub fn advance(
        &mut self,
        epoch: &Epoch,
        aiding: &Aiding<'_>,
    ) -> impl Iterator<Item = Solution> + use<> {
        let (now, revised) = match self {
            Self::Window(AnswerKind::FixedLag, estimator) => {
                estimator.advance(epoch, aiding);
                (None, estimator.take_revisions())
            }
            Self::Window(_, estimator) => (Some(estimator.advance(epoch, aiding)), Vec::new()),
            Self::Whole(batch) => {
                batch.push(epoch, aiding);
                (None, Vec::new())
            }
        };
        now.into_iter().chain(revised)
    }

    /// The answers due at the end.
    pub fn finish(self) -> Vec<Solution> {
        match self {
            Self::Window(AnswerKind::FixedLag, estimator) => estimator.finish(),
            Self::Window(..) => Vec::new(),
            Self::Whole(batch) => batch.finish(),
        }
    }
}
