//! Solutions as callers receive them: in the frame and with the heights that the options ask for.

use crate::aiding::BaseBroker;
use crate::config::OutputOptions;
use crate::gnss::{Presentation, Presented, Solution};
use crate::store::BaseChoice;

use super::Caller;

/// Presents the solutions of one session or request.
pub struct Presenter<'a> {
    presentation: Presentation,
    bases: &'a BaseBroker,
}

impl Caller {
    /// Presents solutions by these options.
    pub(super) fn presenter(&self, output: &OutputOptions) -> Presenter<'_> {
        let aiding = self.aiding();
        let presentation = output.presentation(aiding.geoid.as_ref());
        Presenter { presentation, bases: &aiding.bases }
    }
}

impl Presenter<'_> {
    /// The same for files of a session with these bases, which may state their frames.
    pub(super) fn naming_frames(mut self, caller: &Caller, bases: &BaseChoice) -> Self {
        self.presentation.names_frames |= caller.bases().states_frame(bases);
        self
    }

    /// The frame and heights in which solutions are presented.
    pub(super) const fn presentation(&self) -> &Presentation {
        &self.presentation
    }

    /// A solution as its reader receives it, with the present frame of its base.
    pub(super) fn present<'a>(&self, solution: &'a Solution) -> Presented<'a> {
        self.presentation.present(solution, |base| self.bases.frame(base))
    }
}
