//! The report of `graphfix solve`: one HTML page.

use std::path::{Path, PathBuf};
use std::time::Duration;

use crate::evaluation::{Overview, RunPage};
use crate::gnss::Solution;
use crate::recording::{Provenance, Tally};
use crate::refusal::Code;

use super::Failure;

/// A report to which solutions are added.
pub(super) struct SolveReport {
    path: PathBuf,
    overview: Overview,
}

impl SolveReport {
    /// A report in a file of this name.
    ///
    /// # Errors
    /// The name does not end in `.html`.
    pub(super) fn new(path: &Path) -> Result<Self, Failure> {
        if path.extension().is_none_or(|ending| ending != "html") {
            let message = format!("{} does not end in .html", path.display());
            return Err(Failure::new(Code::UnknownOutputFormat, message, "end the name in .html"));
        }
        Ok(Self { path: path.to_owned(), overview: Overview::new() })
    }

    /// Adds the next solution.
    pub(super) fn add(&mut self, solution: &Solution) {
        self.overview.add(solution);
    }

    /// Writes the page. `facts` are names and values that describe the run.
    ///
    /// # Errors
    /// The file cannot be written.
    pub(super) fn write(
        &self,
        facts: Vec<(&'static str, String)>,
        tally: &Tally,
        provenance: &Provenance,
        elapsed: Duration,
    ) -> Result<(), Failure> {
        let further = [
            ("Positions", format!("{} of {} epochs", tally.answered, tally.epochs)),
            ("Computed by", format!("Graphfix {}", env!("CARGO_PKG_VERSION"))),
            ("Time of the run", format!("{:.1} s", elapsed.as_secs_f64())),
        ];
        let facts = facts.into_iter().chain(further);
        let title = facts.clone().find(|(name, _)| *name == "Rover");
        let file_name = |text: String| {
            let name = Path::new(&text).file_name().map(|name| name.to_string_lossy().into_owned());
            name.unwrap_or(text)
        };
        let remedy = |code: &str| tally.remedies.get(code).copied().unwrap_or_default().to_owned();
        let skipped = provenance.left_out.iter().flat_map(|(name, left_out)| {
            let text = left_out.to_string();
            text.lines().map(|line| format!("{name}: {line}")).collect::<Vec<_>>()
        });
        let reasons = tally.reasons.iter();
        let page = RunPage {
            title: title.map(|(_, rover)| file_name(rover)).unwrap_or_default(),
            facts: facts.map(|(name, value)| (name.to_owned(), value)).collect(),
            epochs: tally.epochs,
            statuses: tally.statuses.iter().map(|(name, n)| ((*name).to_owned(), *n)).collect(),
            reasons: reasons.map(|(code, n)| ((*code).to_owned(), *n, remedy(code))).collect(),
            provenance: provenance.lines(),
            skipped: skipped.collect(),
        };
        let unwritable = |error: &dyn std::fmt::Display| {
            let message = format!("cannot write {}: {error}", self.path.display());
            Failure::of(Code::FileNotWritable, message)
        };
        let figures = self.overview.figures().map_err(|error| unwritable(&error))?;
        std::fs::write(&self.path, page.html(Some(&figures))).map_err(|error| unwritable(&error))
    }

    /// The file.
    pub(super) fn path(&self) -> &Path {
        &self.path
    }
}
