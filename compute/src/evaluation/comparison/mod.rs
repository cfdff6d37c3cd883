//! Several estimators on one recording: their answers, their agreement, and a report.
//!
//! `Comparison` holds the solutions of each [`Method`], judged if there is a truth. `html` makes
//! a self-contained page of it, `figures` its figures, `agreement` the distances between methods,
//! the only measure without a truth.

mod agreement;
mod figures;
mod html;

pub use agreement::Agreement;

use std::collections::BTreeMap;

use super::plot::PlotError;
use super::{Criteria, Expected, Judgement, Truth, judge};
use crate::formats::pos::PosRow;
use crate::gnss::constants::SECONDS_PER_WEEK;
use crate::gnss::{GpsTime, Solution, Status};

/// The answers of one estimator to a recording.
#[derive(Clone, Debug)]
pub struct Method {
    /// Name of the mode, such as `fgo`.
    pub mode: String,
    /// Kind of answer: `causal`, `smoothed` or `batch`.
    pub answer: String,
    /// Name of the profile.
    pub profile: String,
    /// Hash of the configuration in force.
    pub configuration_hash: String,
    /// Options that differ from the profile's, name and value.
    pub overrides: Vec<(String, String)>,
    /// Solutions in order of time.
    pub solutions: Vec<Solution>,
    /// Elapsed time of the run, files included (s).
    pub elapsed_s: f64,
}

impl Method {
    /// Mode and kind of answer, for titles.
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

    /// Number of epochs by the code of each reason.
    fn reasons(&self) -> BTreeMap<&'static str, usize> {
        let mut counts = BTreeMap::new();
        for reason in self.solutions.iter().flat_map(|solution| &solution.reasons) {
            *counts.entry(reason.code()).or_default() += 1;
        }
        counts
    }
}

/// Several methods on one recording.
#[derive(Clone, Debug)]
pub struct Comparison {
    /// Title of the report, such as the name of the rover's file.
    pub title: String,
    /// The command that made the report.
    pub command: String,
    /// The methods, in the order given.
    pub methods: Vec<Method>,
    /// The judgement of each method; empty without truth.
    pub judgements: Vec<Judgement>,
}

impl Comparison {
    /// Compares `methods`, and judges each if there is a `truth`.
    ///
    /// An epoch is expected if any method was given it and the truth covers it.
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
        let ends = times.first().copied().zip(times.last().copied());
        let mut criteria = Criteria {
            expected: Expected::RoverEpochs(times),
            fix_tolerance_m,
            ..Criteria::whole_file()
        };
        if let Some((first, last)) = ends.filter(|(first, last)| *last - *first < SECONDS_PER_WEEK)
        {
            criteria.window_tow_s = (first.seconds_of_week(), last.seconds_of_week());
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

    /// The distances between each pair of methods, in the methods' order.
    pub(crate) fn agreements(&self) -> Vec<Agreement> {
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

    /// The report as one self-contained HTML page.
    ///
    /// # Errors
    /// A figure cannot be drawn.
    pub fn html(&self) -> Result<String, PlotError> {
        html::page(self)
    }
}
