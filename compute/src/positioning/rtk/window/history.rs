//! Epochs that may be revised.
//!
//! A smoother goes back from the newest epoch to an earlier one, whose state and ambiguities then
//! depend on all epochs so far. They are conditioned on the integers that are known now: integers
//! found later are included, refuted ones are not.

use std::collections::VecDeque;
use std::ops::Range;
use std::sync::Arc;

use crate::config::{GraphOptions, RtkOptions};
use crate::gnss::{GpsTime, LocalFrame, Solution};
use crate::graph::{Departure, Elimination, Estimate, Smoother};
use crate::lambda::Resolver;
use crate::positioning::rtk::ambiguity::{IntegerHistory, may_be_integer};
use crate::positioning::rtk::observed::{CarrierArc, STATE};
use crate::positioning::rtk::tracking::Tracking;
use crate::positioning::starts::WINDOW_EPOCHS_MIN;
use crate::snapshot::state_fields;

use super::record::EpochRecord;
use super::revision::Revision;

/// The epochs that may still be revised, in order of time.
#[derive(Debug, Default)]
pub(crate) struct History {
    /// Shared between copies of the state: a session makes a copy for each batch.
    records: VecDeque<Arc<EpochRecord>>,
    /// Number of epochs that have been revised once.
    revised: usize,
    /// Data for smoothing back, oldest first, one for each record that has left the graph.
    departures: VecDeque<Arc<Departure<STATE>>>,
    /// Number of epochs in the graph whose final answer has been returned.
    answered_early: usize,
    integers: IntegerHistory,
}

state_fields!(History { records, revised, departures, answered_early, integers });

/// A factored window, and the scratch to go back from its newest epoch.
pub(crate) struct FactoredWindow<'a> {
    pub(crate) elimination: &'a Elimination<STATE>,
    pub(crate) estimate: &'a Estimate<STATE>,
    pub(crate) frame: &'a LocalFrame,
    pub(crate) smoother: &'a mut Smoother<STATE>,
    pub(crate) resolver: &'a mut Resolver,
    /// Factor on the variance of a position without integers.
    pub(crate) float_factor: f64,
}

impl History {
    /// Records the answer of an epoch that is not in the graph. It is never revised.
    pub(crate) fn push_alone(&mut self, solution: Solution) {
        let record = EpochRecord { solution, is_in_graph: false, period: 0, arcs: Vec::new() };
        self.records.push_back(Arc::new(record));
    }

    /// Records the answer of the graph's newest epoch.
    pub(crate) fn push(&mut self, solution: Solution, tracking: &Tracking, options: &RtkOptions) {
        let Tracking { arcs, hold, .. } = tracking;
        self.integers.learn(arcs.list(), hold);
        let may_be = arcs.present(solution.time).filter(|arc| may_be_integer(arc, options));
        let (arcs, period) = (may_be.map(CarrierArc::reference).collect(), hold.period);
        self.records.push_back(Arc::new(EpochRecord { solution, is_in_graph: true, period, arcs }));
    }

    /// Records what smoothing needs of the epoch that leaves the graph.
    pub(crate) fn depart(&mut self, departure: Departure<STATE>) {
        match self.answered_early.checked_sub(1) {
            Some(fewer) => self.answered_early = fewer,
            None => self.departures.push_back(Arc::new(departure)),
        }
    }

    /// Whether any of the epochs is or was in the graph.
    pub(crate) fn has_graph(&self, epochs: Range<usize>) -> bool {
        self.records.range(epochs).any(|record| record.is_in_graph)
    }

    /// Time of the oldest epoch.
    pub(crate) fn oldest_time(&self) -> Option<GpsTime> {
        self.records.front().map(|record| record.solution.time)
    }

    /// Indices of all epochs.
    pub(crate) fn all(&self) -> Range<usize> {
        0..self.records.len()
    }

    /// Indices of the epochs to be revised at `time`: the oldest of those not revised yet.
    pub(crate) fn due(&self, time: GpsTime, options: &GraphOptions) -> Range<usize> {
        let waiting = self.records.range(self.revised..);
        let count = waiting.len();
        let is_late = |record: &&Arc<EpochRecord>| options.window_s < time - record.solution.time;
        let late = waiting.take_while(is_late).count().min(count.saturating_sub(WINDOW_EPOCHS_MIN));
        let over = count.saturating_sub(options.window_epochs_max);
        self.revised..self.revised + over.max(late)
    }

    /// Revises some epochs, as far as the smoother can go back from the newest one.
    pub(crate) fn revise(
        &mut self,
        epochs: Range<usize>,
        window: FactoredWindow<'_>,
        options: &RtkOptions,
    ) {
        let FactoredWindow { elimination, estimate, frame, smoother, resolver, float_factor } =
            window;
        self.revised = self.revised.max(epochs.end);
        smoother.begin(elimination, estimate);
        let mut gone = self.departures.iter().rev();
        let mut is_newest = true;
        for (index, record) in self.records.iter_mut().enumerate().skip(epochs.start).rev() {
            if !record.is_in_graph {
                continue;
            }
            let is_reached = std::mem::take(&mut is_newest)
                || smoother.go_back(elimination, estimate)
                || gone.next().is_some_and(|departure| smoother.go_back_to(departure));
            if !is_reached {
                return;
            }
            if epochs.contains(&index) {
                let revision = Revision::at(smoother, frame, options, float_factor);
                *record = Arc::new(revision.of(record, &self.integers, resolver));
            }
        }
    }

    /// Removes the oldest `count` epochs; returns their last answers in order of time.
    pub(crate) fn leave(&mut self, count: usize) -> Vec<Solution> {
        let mut left = Vec::with_capacity(count);
        for record in self.records.drain(..count) {
            if record.is_in_graph && self.departures.pop_front().is_none() {
                self.answered_early += 1;
            }
            left.push(record.solution.clone());
        }
        self.revised = self.revised.saturating_sub(count);
        match self.oldest_time() {
            Some(time) => self.integers.forget_before(time),
            None => self.integers = IntegerHistory::default(),
        }
        left
    }
}
