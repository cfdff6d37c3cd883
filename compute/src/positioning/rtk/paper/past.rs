//! Epochs that may be revised.

use std::collections::VecDeque;

use nalgebra::Matrix3;

use crate::config::RtkOptions;
use crate::gnss::{GpsTime, LocalFrame, Solution, Status};
use crate::positioning::rtk::answer::{keeps_from_fixing, moved};
use crate::snapshot::state_fields;

use super::epoch::{PaperEpoch, State};
use super::integers::PaperIntegers;

/// An epoch with its latest answer.
#[derive(Debug)]
struct Record {
    solution: Solution,
    /// Whether it is or was in the graph, and is not revised yet.
    is_waiting: bool,
    /// In a batch, once the epoch has left the graph: the epoch with its position.
    left: Option<(PaperEpoch, State)>,
}

state_fields!(Record { solution, is_waiting, left });

/// The answers of epochs that may be revised, in order of time.
#[derive(Debug, Default)]
pub(crate) struct PaperPast {
    records: VecDeque<Record>,
}

state_fields!(PaperPast { records });

/// What is known of an epoch now.
pub(crate) struct Known<'a> {
    pub(crate) frame: &'a LocalFrame,
    pub(crate) epoch: &'a PaperEpoch,
    pub(crate) position: &'a State,
    pub(crate) covariance: &'a Matrix3<f64>,
}

impl PaperPast {
    /// Adds the answer of an epoch, and whether it is in the graph.
    pub(crate) fn push(&mut self, solution: Solution, is_waiting: bool) {
        self.records.push_back(Record { solution, is_waiting, left: None });
    }

    /// Revises the oldest epoch that is not revised.
    pub(crate) fn revise(
        &mut self,
        known: &Known<'_>,
        options: &RtkOptions,
        integers: &mut PaperIntegers,
    ) {
        if let Some(record) = self.records.iter_mut().find(|record| record.is_waiting) {
            record.solution = revised(&record.solution, known, options, integers);
            record.is_waiting = false;
        }
    }

    /// Keeps the epoch that leaves the graph: that of the oldest record still in the graph.
    pub(crate) fn keep(&mut self, epoch: PaperEpoch, position: State) {
        let waiting = |record: &&mut Record| record.is_waiting && record.left.is_none();
        if let Some(record) = self.records.iter_mut().find(waiting) {
            record.left = Some((epoch, position));
        }
    }

    /// Takes the epochs that were kept, with their positions.
    pub(crate) fn take_left(&mut self) -> (Vec<PaperEpoch>, Vec<State>) {
        self.records.iter_mut().filter_map(|record| record.left.take()).unzip()
    }

    /// Removes and returns the answers before the first one that is not revised.
    pub(crate) fn leave(&mut self) -> Vec<Solution> {
        let count = self.records.iter().take_while(|record| !record.is_waiting).count();
        self.records.drain(..count).map(|record| record.solution).collect()
    }

    /// Time of the oldest answer.
    pub(crate) fn oldest_time(&self) -> Option<GpsTime> {
        self.records.front().map(|record| record.solution.time)
    }

    /// Removes and returns all answers.
    pub(crate) fn leave_all(&mut self) -> Vec<Solution> {
        self.records.drain(..).map(|record| record.solution).collect()
    }
}

/// The answer revised with what is known now.
fn revised(
    solution: &Solution,
    known: &Known<'_>,
    options: &RtkOptions,
    integers: &mut PaperIntegers,
) -> Solution {
    let Known { frame, epoch, position, covariance } = *known;
    let resolution = integers.resolve(epoch, (position, covariance), options);
    let place = match &resolution.outcome {
        Ok(fixed) => (&fixed.position, &fixed.covariance),
        Err(_) => (position, covariance),
    };
    let mut solution = moved(solution, frame, place, options);
    solution.reasons.retain(|reason| !keeps_from_fixing(reason));
    let estimate = solution.estimate.as_mut();
    let relative = estimate.and_then(|estimate| estimate.relative.as_mut());
    if let Some(relative) = relative {
        (relative.ratio, relative.success_rate) = (resolution.ratio, resolution.success_rate);
        let fixed = resolution.outcome.as_ref().ok();
        relative.fixed_ambiguities = fixed.map_or(0, |fixed| fixed.held);
        relative.fix_probability = fixed.map(|fixed| fixed.probability);
    }
    solution.status = if resolution.outcome.is_ok() { Status::Fixed } else { Status::Float };
    solution.reasons.extend(resolution.outcome.err().filter(|_| options.resolve));
    solution
}
