//! Epochs whose answer may still become better.
//!
//! An epoch is answered again by going back to it from the newest: its state and ambiguities are
//! then those of all epochs so far. The integers known by now of the arcs it named are held, those
//! included that were found after it; integers refuted since are not.

use std::collections::VecDeque;
use std::ops::Range;
use std::sync::Arc;

use crate::config::{GraphOptions, RtkOptions};
use crate::gnss::{GpsTime, LocalFrame, Solution};
use crate::graph::{Departure, Elimination, Estimate, Smoother};
use crate::lambda::Resolver;
use crate::snapshot::state_fields;

use super::answered::{Answered, Named};
use super::epoch::STATE;
use super::integers::may_be_integer;
use super::labels::Labels;
use super::revision::Revision;
use super::tracking::Tracking;

/// Epochs that wait at least, however far apart they are.
const EPOCHS_MIN: usize = 10;

/// The epochs not yet answered for good, in order of time.
#[derive(Debug, Default)]
pub(super) struct History {
    /// Shared between copies, of which a session makes one for each epoch.
    answers: VecDeque<Arc<Answered>>,
    /// How many of them have been answered again.
    revised: usize,
    /// Of the first of those answers that are in the graph.
    departures: VecDeque<Arc<Departure<STATE>>>,
    /// Epochs of the graph that were answered for good before they left it.
    answered_early: usize,
    labels: Labels,
}

state_fields!(History { answers, revised, departures, answered_early, labels });

/// The graph where it stands, factored, and the memory to go back from it.
pub(super) struct Window<'a> {
    pub(super) elimination: &'a Elimination<STATE>,
    pub(super) estimate: &'a Estimate<STATE>,
    pub(super) frame: &'a LocalFrame,
    pub(super) smoother: &'a mut Smoother<STATE>,
    pub(super) resolver: &'a mut Resolver,
}

impl History {
    /// Takes the answer of an epoch without the graph, which is for good.
    pub(super) fn push_alone(&mut self, solution: Solution) {
        let named = Vec::new();
        let answered = Answered { solution, is_in_graph: false, era: 0, named };
        self.answers.push_back(Arc::new(answered));
    }

    /// Takes the answer of the graph's newest epoch.
    pub(super) fn push(&mut self, solution: Solution, tracking: &Tracking, options: &RtkOptions) {
        let Tracking { arcs, trust, .. } = tracking;
        self.labels.learn(&arcs.list, trust);
        let present = arcs.list.iter().filter(|arc| arc.last == solution.time);
        let whole = present.filter(|arc| may_be_integer(arc, options));
        let named = whole.map(|arc| Named {
            serial: arc.serial,
            variable: arc.variable,
            group: arc.group(),
        });
        let (named, era) = (named.collect(), trust.era);
        let answered = Answered { solution, is_in_graph: true, era, named };
        self.answers.push_back(Arc::new(answered));
    }

    /// Takes what the graph's oldest epoch leaves behind.
    pub(super) fn depart(&mut self, departure: Departure<STATE>) {
        match self.answered_early.checked_sub(1) {
            Some(fewer) => self.answered_early = fewer,
            None => self.departures.push_back(Arc::new(departure)),
        }
    }

    /// Whether the graph has or had any of the epochs.
    pub(super) fn has_graph(&self, epochs: Range<usize>) -> bool {
        self.answers.range(epochs).any(|answered| answered.is_in_graph)
    }

    /// Time of the oldest epoch.
    pub(super) fn oldest_time(&self) -> Option<GpsTime> {
        self.answers.front().map(|answered| answered.solution.time)
    }

    /// All epochs.
    pub(super) fn all(&self) -> Range<usize> {
        0..self.answers.len()
    }

    /// The epochs to be answered again at `time`: the oldest of those that were not yet.
    pub(super) fn due(&self, time: GpsTime, options: &GraphOptions) -> Range<usize> {
        let waiting = self.answers.range(self.revised..);
        let count = waiting.len();
        let is_late = |answered: &&Arc<Answered>| options.window_s < time - answered.solution.time;
        let late = waiting.take_while(is_late).count().min(count.saturating_sub(EPOCHS_MIN));
        let over = count.saturating_sub(options.window_epochs_max);
        self.revised..self.revised + over.max(late)
    }

    /// Answers some epochs again, as far as they can be reached from the newest.
    pub(super) fn revise(
        &mut self,
        epochs: Range<usize>,
        window: Window<'_>,
        options: &RtkOptions,
    ) {
        let Window { elimination, estimate, frame, smoother, resolver } = window;
        self.revised = self.revised.max(epochs.end);
        smoother.begin(elimination, estimate);
        let mut gone = self.departures.iter().rev();
        let mut is_newest = true;
        for (index, answered) in self.answers.iter_mut().enumerate().skip(epochs.start).rev() {
            if !answered.is_in_graph {
                continue;
            }
            let is_reached = std::mem::take(&mut is_newest)
                || smoother.go_back(elimination, estimate)
                || gone.next().is_some_and(|departure| smoother.go_back_to(departure));
            if !is_reached {
                return;
            }
            if epochs.contains(&index) {
                let revision = Revision::at(smoother, frame, options);
                *answered = Arc::new(revision.of(answered, &self.labels, resolver));
            }
        }
    }

    /// Removes the oldest `count` epochs; their last answers, in order of time.
    pub(super) fn leave(&mut self, count: usize) -> Vec<Solution> {
        let mut left = Vec::with_capacity(count);
        for answered in self.answers.drain(..count) {
            if answered.is_in_graph && self.departures.pop_front().is_none() {
                self.answered_early += 1;
            }
            left.push(answered.solution.clone());
        }
        self.revised = self.revised.saturating_sub(count);
        match self.oldest_time() {
            Some(time) => self.labels.forget_before(time),
            None => self.labels = Labels::default(),
        }
        left
    }
}
