//! The report of a job as an HTML page.

use crate::evaluation::RunPage;
use crate::gnss::{GpsTime, LeapSeconds};

use super::desk::Jobs;
use super::info::{JobId, JobInfo};
use super::request::{BaseOrigin, JobInput, Part};
use super::{JobError, Report};

impl Jobs {
    /// The report of a job that has succeeded, as an HTML page that needs no other file.
    ///
    /// # Errors
    /// No job has this id, it has not ended or has no result, or the store, the disk or the bucket
    /// fails.
    pub async fn report_page(&self, id: &JobId) -> Result<String, JobError> {
        let job = self.ended(id).await?;
        let (Some(report), Some(result)) = (&job.report, &job.result) else {
            return Err(JobError::WithoutResult { id: id.to_string(), state: job.state.name() });
        };
        let figures = self.desk.files()?.figures(&result.file).await?;
        Ok(page(&job, report).html(figures.as_deref()))
    }
}

fn page(job: &JobInfo, report: &Report) -> RunPage {
    let remedy = |code: &String| report.remedies.get(code).cloned().unwrap_or_default();
    let reasons = report.reasons.iter();
    RunPage {
        title: title(job),
        facts: facts(job, report),
        epochs: report.epochs,
        statuses: report.statuses.clone(),
        reasons: reasons.map(|(code, epochs)| (code.clone(), *epochs, remedy(code))).collect(),
        provenance: report.provenance.clone(),
        skipped: report.skipped.clone(),
    }
}

/// The title: the rover's file, or the session.
fn title(job: &JobInfo) -> String {
    let session = job.request.options.session.as_ref();
    match (job.request.input(Part::Rover), session) {
        (Some(rover), _) => rover.name.clone(),
        (None, Some(session)) => session.id.clone(),
        (None, None) => job.id.to_string(),
    }
}

/// Request, files, times and program version of a job.
fn facts(job: &JobInfo, report: &Report) -> Vec<(String, String)> {
    let (request, options) = (&job.request, &job.request.options);
    let session = request.session.as_ref();
    // An omitted option is that of the session.
    let name = |own: &String, of_session: Option<&String>| match own.is_empty() {
        true => of_session.cloned().unwrap_or_default(),
        false => own.clone(),
    };
    let overrides = options.overrides.iter().map(|(name, value)| format!("{name}={value}"));
    let utc = |unix_ms: Option<i64>| {
        let leap = LeapSeconds::table();
        unix_ms.map(|ms| GpsTime::from_unix_ms(ms, &leap).to_rfc3339(&leap)).unwrap_or_default()
    };
    let files = |part: Part| {
        let files = request.inputs.iter().filter(|input| input.part == part);
        files.map(file).collect::<Vec<_>>().join("; ")
    };
    let position = match options.base_position {
        BaseOrigin::Any => String::new(),
        BaseOrigin::FromHeader => "from its header or messages".to_owned(),
        BaseOrigin::Marker([x, y, z]) => format!("{x:.4}, {y:.4}, {z:.4} (ECEF, m), as given"),
    };
    let epochs = |numbers: (u64, u64)| format!("epochs {} to {}", numbers.0, numbers.1);
    let facts = [
        ("Job", job.id.to_string()),
        ("Mode", name(&options.mode, session.map(|session| &session.mode))),
        ("Profile", name(&options.profile, session.map(|session| &session.profile))),
        ("Answers", options.answer.clone()),
        ("Options changed", overrides.collect::<Vec<_>>().join(", ")),
        ("Session", session.map(|session| epochs(session.numbers)).unwrap_or_default()),
        ("Rover", files(Part::Rover)),
        ("Base", files(Part::Base)),
        ("Position of the base", position),
        ("Ephemerides", ephemerides(&files(Part::Navigation), session.is_some())),
        ("Positions", format!("{} of {} epochs", report.answered, report.epochs)),
        ("Configuration", report.configuration_hash.clone()),
        ("Computed by", format!("Graphfix {}", report.version)),
        ("Created", utc(Some(job.created_unix_ms))),
        ("Started", utc(job.started_unix_ms)),
        ("Ended", utc(job.ended_unix_ms)),
        ("Time of the run", format!("{:.1} s", report.seconds)),
    ];
    let given = facts.into_iter().filter(|(_, value)| !value.is_empty());
    given.map(|(name, value)| (name.to_owned(), value)).collect()
}

/// A file as text: its name and origin.
fn file(input: &JobInput) -> String {
    match (&input.url, input.is_own) {
        (Some(url), _) => format!("{}, fetched from {url}", input.name),
        (None, true) => format!("{}, added by the service", input.name),
        (None, false) => format!("{}, {} bytes", input.name, input.bytes),
    }
}

fn ephemerides(files: &str, is_session: bool) -> String {
    match (files.is_empty(), is_session) {
        (false, _) => files.to_owned(),
        (true, true) => "those with which the session was answered".to_owned(),
        (true, false) => "those in the files of rover and base".to_owned(),
    }
}
