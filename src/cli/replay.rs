//! `graphfix replay`: computes a stored session again.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::Instant;

use clap::Args;

use crate::aiding::bases::BaseChoice;
use crate::app;
use crate::config::Limits;
use crate::gnss::{AntennaCatalogue, Presentation, Status};
use crate::refusal::Code;
use crate::session::{Check, Recomputation, SessionError, SessionId, SolveRequest};

use super::Failure;
use super::database::DatabaseArgument;
use super::host;
use super::option_arguments::{assignments, check_as_computed};
use super::output::print;
use super::solve::{create, unwritable};

/// Computes a stored session again from its epochs and the navigation data of that time.
///
/// Without further options it checks that the same bits result, and fails if they do not. With
/// `--mode`, `--profile` or `--set` it reports the result of these. The database is only read, and
/// its schema stays as it is; a service may be using it.
#[derive(Clone, Debug, Args)]
pub(super) struct ReplayArguments {
    /// Id of the session.
    session: String,
    #[command(flatten)]
    database: DatabaseArgument,
    /// Another estimator than the session's.
    #[arg(long, value_name = "MODE")]
    mode: Option<String>,
    /// Another profile than the session's.
    #[arg(long, value_name = "NAME")]
    profile: Option<String>,
    /// Overrides one option, as in ionosphere=none; may be repeated. See `graphfix config`.
    #[arg(long, value_name = "KEY=VALUE", allow_hyphen_values = true)]
    set: Vec<String>,
    /// Write each epoch as it leaves the window, smoothed by the epochs that follow.
    #[arg(long, requires = "output")]
    smoothed: bool,
    /// Output file; its extension selects .pos, .csv, .geojson, .kml, .gpx, .nmea or .parquet.
    #[arg(long, value_name = "FILE")]
    output: Option<PathBuf>,
}

/// Runs the command; prints the result on standard output.
///
/// # Errors
/// The session or database does not exist, an option is invalid, or the bits differ from the stored
/// ones.
pub(super) fn run(arguments: &ReplayArguments) -> Result<(), Failure> {
    host::block_on(replay(arguments))
}

async fn replay(arguments: &ReplayArguments) -> Result<(), Failure> {
    let change = arguments.change()?;
    let id = SessionId::parse(&arguments.session)
        .ok_or_else(|| SessionError::NotFound { id: arguments.session.clone() })?;
    let limits = Limits::standard();
    let database = arguments.database.url()?;
    let opened = app::open_stored(&database, &limits, AntennaCatalogue::default());
    let (store, aiding) = opened.await?;
    let again = Recomputation::open(store.clone(), aiding, &id, change.as_ref()).await?;
    let report = match (&change, &arguments.output) {
        (None, None) => verdict(&id, &again.check().await?),
        _ => write(arguments, again).await,
    };
    store.close().await;
    let text = report?;
    print(&text)
}

impl ReplayArguments {
    /// The changed options, if there are any.
    fn change(&self) -> Result<Option<SolveRequest>, Failure> {
        check_as_computed(&self.set)?;
        let mut overrides = BTreeMap::new();
        for (key, value) in assignments(&self.set)? {
            overrides.insert(key.to_owned(), value.to_owned());
        }
        let (mode, profile) = (self.mode.clone(), self.profile.clone());
        let is_given = mode.is_some() || profile.is_some() || !overrides.is_empty();
        Ok(is_given.then_some(SolveRequest { mode, profile, overrides, base: BaseChoice::None }))
    }
}

fn verdict(id: &SessionId, check: &Check) -> Result<String, Failure> {
    let Check { compared, different, not_stored, not_computed, first, began_after } = check;
    let Some((seq, revision)) = first else {
        let beginning = beginning(*began_after);
        return Ok(format!("{beginning}{compared} solutions compared, 0 different\n"));
    };
    let message = format!(
        "session {id}: {compared} solutions compared, {different} different, {not_stored} not \
         stored, {not_computed} not computed again; first: epoch {seq}, revision {revision}"
    );
    Err(Failure::of(Code::ReplayDiffers, message))
}

/// A line that states after which epoch a replay begins, if it does not begin with the session.
fn beginning(began_after: Option<u64>) -> String {
    began_after.map_or_else(String::new, |after| {
        format!(
            "the replay begins after epoch {after}: those before were removed by the session's \
             retention\n"
        )
    })
}

/// Writes the computed solutions; returns the summary.
async fn write(arguments: &ReplayArguments, mut again: Recomputation) -> Result<String, Failure> {
    let began = Instant::now();
    let revision = u32::from(arguments.smoothed);
    let mut output = match &arguments.output {
        Some(path) => {
            let comments = [
                format!("program   : graphfix {}", env!("CARGO_PKG_VERSION")),
                format!("session   : {}", arguments.session),
                format!("options   : {}", again.configuration_hash()),
            ];
            let plain = Presentation::default();
            Some((path, create(path, &comments, again.leap_seconds(), plain)?))
        }
        None => None,
    };
    let mut counts = [0_usize; Status::ALL.len()];
    while let Some(answers) = again.next().await? {
        for answer in answers.iter().filter(|answer| answer.revision == revision) {
            let place = Status::ALL.iter().position(|status| *status == answer.solution.status);
            counts[place.expect("every status is in the list")] += 1;
            if let Some((path, output)) = &mut output {
                output.write(&answer.solution).map_err(|error| unwritable(path, &error))?;
            }
        }
    }
    if let Some((path, output)) = output {
        output.finish().map_err(|error| unwritable(path, &error))?;
    }
    let epochs: usize = counts.iter().sum();
    let mut text = beginning(again.began_after());
    text += &format!("{epochs} epochs in {:.3} s", began.elapsed().as_secs_f64());
    for (status, count) in Status::ALL.iter().zip(counts).filter(|(_, count)| *count != 0) {
        text += &format!(", {count} {}", status.name());
    }
    Ok(text + "\n")
}

impl From<SessionError> for Failure {
    fn from(error: SessionError) -> Self {
        Self::of(error.code(), &error)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn other_bits_fail() {
        let id = SessionId::random();
        let check = Check { compared: 3, began_after: Some(256), ..Check::default() };
        assert!(verdict(&id, &check).unwrap().starts_with("the replay begins after epoch 256"));
        let check = Check { began_after: None, ..check };
        assert_eq!(verdict(&id, &check), Ok("3 solutions compared, 0 different\n".to_owned()));
        let check = Check { different: 1, first: Some((7, 0)), ..check };
        let failure = verdict(&id, &check).unwrap_err();
        assert_eq!(failure.code(), Code::ReplayDiffers);
        assert!(failure.to_string().contains("first: epoch 7, revision 0"), "{failure}");
    }
}
