//! Times of the stages of a batch, for the spans of its pushes.

use std::mem;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Instant;

use crate::refusal::Class;
use crate::session::SessionError;
use crate::traces::Work;

use super::MailboxPermit;

/// The stages of the batch that is being answered, if one of its pushes is traced.
#[derive(Default)]
pub(in crate::session) struct Stages(Mutex<Option<Vec<StageTime>>>);

/// A stage with its beginning and end.
type StageTime = (Work, (Instant, Instant));

impl Stages {
    /// Starts recording stages, if one of these pushes is traced.
    pub(super) fn begin<'a>(&self, pushes: impl Iterator<Item = &'a Option<MailboxPermit>>) {
        let mut pushes = pushes.flatten();
        if pushes.any(|push| push.trace.is_some()) {
            *self.noted() = Some(Vec::new());
        }
    }

    /// Records a stage that has ended.
    pub(super) fn note(&self, work: Work, begun: Instant) {
        if let Some(stages) = &mut *self.noted() {
            stages.push((work, (begun, Instant::now())));
        }
    }

    /// Takes the recorded stages.
    pub(super) fn take(&self) -> Vec<StageTime> {
        mem::take(&mut *self.noted()).unwrap_or_default()
    }

    fn noted(&self) -> MutexGuard<'_, Option<Vec<StageTime>>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl MailboxPermit {
    /// Adds the stages of the batch and the outcome to the push's span, if the push is traced.
    pub(super) fn answered<T>(&mut self, stages: &[StageTime], answer: &Result<T, SessionError>) {
        let Some(span) = &mut self.trace else { return };
        for (work, times) in stages {
            span.done(*work, *times);
        }
        if let Err(error) = answer {
            let code = error.code();
            span.set("graphfix.code", code);
            if matches!(code.class(), Class::Unavailable | Class::Internal) {
                span.fail();
            }
        }
    }
}
