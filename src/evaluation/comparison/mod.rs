//! Several estimators on one recording: what each answered, how far they agree, and a report.
//!
//! [`Comparison`] holds the solutions of each [`Method`], judged where a truth is at hand. `html`
//! makes one self-contained page of it, `figures` its drawings, `agreement` the distances between
//! methods, which is all there is to say without a truth.

mod agreement;
mod figures;
mod html;

pub use agreement::Agreement;

use std::collections::BTreeMap;

use super::plot::PlotError;
use super::{Criteria, Expected, Judgement, Truth, judge};
use crate::formats::pos::PosRow;
use crate::gnss::{GpsTime, Solution, Status};

/// One estimator's answers to a recording.
#[derive(Clone, Debug)]
pub struct Method {
    /// Estimator, as users write it.
    pub mode: String,
    /// Which of its answers: `causal`, `smoothed` or `batch`.
    pub answer: String,
    /// Profile, as users write it.
    pub profile: String,
    /// Hash of the configuration in force.
    pub configuration_hash: String,
    /// Options that differ from the profile's, name and value.
    pub overrides: Vec<(String, String)>,
    /// In order of time.
    pub solutions: Vec<Solution>,
    /// Time the run took on the clock, files read included (s).
    pub elapsed_s: f64,
}

impl Method {
    /// Mode and answer in one line.
    pub fn name(&self) -> String {
        format!("{} {}", self.mode.to_uppercase(), self.answer)
    }

    fn with_position(&self) -> impl Iterator<Item = &Solution> {
        self.solutions.iter().filter(|solution| solution.status != Status::None)
    }

    fn share_with(&self, status: Status) -> f64 {
        let count = self.solutions.iter().filter(|solution| solution.status == status).count();
        count as f64 / self.solutions.len().max(1) as f64
    }

    /// Epochs by the code of a reason their answer gave.
    fn reasons(&self) -> BTreeMap<&'static str, usize> {
        let mut counts = BTreeMap::new();
        for reason in self.solutions.iter().flat_map(|solution| &solution.reasons) {
            *counts.entry(reason.code()).or_default() += 1;
        }
        counts
    }
}

/// Methods on one recording.
#[derive(Clone, Debug)]
pub struct Comparison {
    /// What was compared, such as the name of the rover's file.
    pub title: String,
    /// The command that made it.
    pub command: String,
    /// The methods, in the order asked.
    pub methods: Vec<Method>,
    /// Each against the truth; empty where there is none.
    pub judgements: Vec<Judgement>,
}

impl Comparison {
    /// Compares `methods`, and judges each where there is a `truth`.
    ///
    /// An epoch counts as expected if any method was given it and the truth covers it.
    pub fn new(
        title: String,
        command: String,
        methods: Vec<Method>,
        truth: Option<&Truth>,
        fix_tolerance_m: f64,
    ) -> Self {
        let mut times: Vec<GpsTime> =
            methods.iter().flat_map(|m| &m.solutions).map(|solution| solution.time).collect();
        times.sort_unstable();
        times.dedup();
        let span = |time: Option<&GpsTime>| time.map_or(0.0, |time| time.seconds_of_week());
        let window_tow_s = (span(times.first()), span(times.last()));
        let is_one_week = times.first().map(|t| t.week()) == times.last().map(|t| t.week());
        let mut criteria = Criteria {
            expected: Expected::RoverEpochs(times),
            fix_tolerance_m,
            ..Criteria::whole_file()
        };
        if is_one_week {
            criteria.window_tow_s = window_tow_s;
        }
        let judged = |truth: &Truth| {
            let rows = |method: &Method| -> Vec<PosRow> {
                method.solutions.iter().filter_map(PosRow::of).collect()
            };
            methods.iter().map(|m| judge(&rows(m), truth.clone(), &criteria)).collect()
        };
        let judgements = truth.map(judged).unwrap_or_default();
        Self { title, command, methods, judgements }
    }

    /// The distance between each pair of methods, the earlier one first.
    pub fn agreements(&self) -> Vec<Agreement> {
        let pairs = (0..self.methods.len())
            .flat_map(|first| (first + 1..self.methods.len()).map(move |second| (first, second)));
        pairs.filter_map(|pair| Agreement::of(&self.methods, pair)).collect()
    }

    /// Whether any method has positions relative to a base.
    fn is_relative(&self) -> bool {
        let mut solutions = self.methods.iter().flat_map(|method| &method.solutions);
        solutions.any(|solution| {
            solution.estimate.as_ref().is_some_and(|estimate| estimate.relative.is_some())
        })
    }

    /// The report as one HTML page that needs nothing else.
    ///
    /// # Errors
    /// A figure cannot be drawn.
    pub fn html(&self) -> Result<String, PlotError> {
        html::page(self)
    }
}
