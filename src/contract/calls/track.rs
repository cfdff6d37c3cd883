//! Tracks: a session's stored solutions as the bytes of a file that other programs open.

use bytes::Bytes;
use futures::stream::BoxStream;
use futures::{Stream, StreamExt, stream};

use crate::config::OutputOptions;
use crate::contract::{Caller, Lease, Refusal, convert, texts, v1};
use crate::formats::result::ResultFormat;
use crate::formats::track::{Revision, TrackFormat, TrackWriter};
use crate::gnss::LeapSeconds;
use crate::keys::Pass;
use crate::refusal::Code;
use crate::session::{SessionId, SolutionPage};
use crate::store::{Page, Revisions, SolutionQuery, StoredSolution};

use super::observations::observations;
use super::session_id;
use super::solutions::SOLUTION_BYTES;

/// Solutions that are read at a time.
const BATCH: usize = 128;
/// Memory of a track that is being read: a batch of solutions, their text, and the current line of
/// the track (bytes).
const TRACK_BYTES: usize = BATCH * SOLUTION_BYTES + (256 << 10);

/// Names of all formats of solutions.
pub fn formats() -> impl Iterator<Item = &'static str> {
    TrackFormat::ALL.into_iter().map(TrackFormat::name)
}

/// File ending and media type of a format.
///
/// # Errors
/// There is no such format.
pub fn kind(format: &str) -> Result<(&'static str, &'static str), Refusal> {
    known(format).map(|format| (format.ending(), format.content_type()))
}

/// The stored data of a session as a file: its solutions in order of seq and revision, or as RINEX
/// the epochs that they answer. It is read from the store in batches, as fast as the stream is
/// read.
///
/// # Errors
/// The session or the format does not exist, or a time, the status or the revisions are invalid.
pub async fn track(
    caller: &Caller,
    request: v1::TrackRequest,
) -> Result<BoxStream<'static, Result<Bytes, Refusal>>, Refusal> {
    match known(&request.format)? {
        ResultFormat::Track(format) => Ok(solutions(caller, request, format).await?.boxed()),
        ResultFormat::Rinex => {
            let chosen = [("status", request.status != 0), ("revisions", request.revisions != 0)];
            if let Some((field, _)) = chosen.into_iter().find(|(_, is_chosen)| *is_chosen) {
                let message = "RINEX has the observations of all epochs, whatever their solutions";
                return Err(Refusal::new(Code::InvalidField, message).at(field));
            }
            let v1::TrackRequest { session, from, to, .. } = request;
            let request = v1::SessionObservationsRequest { session, from, to };
            Ok(observations(caller, request).await?.boxed())
        }
    }
}

/// The stored solutions of a session as a file.
async fn solutions(
    caller: &Caller,
    request: v1::TrackRequest,
    format: TrackFormat,
) -> Result<impl Stream<Item = Result<Bytes, Refusal>> + Send + use<>, Refusal> {
    let id = session_id(&request.session)?;
    let revisions = convert::revisions(request.revisions)?;
    if revisions == Revisions::All && !format.has_revisions() {
        let message = format!(
            "{} has one row for each epoch; ask for the last or the first revision, or for csv, \
             geojson or parquet",
            format.name()
        );
        return Err(Refusal::new(Code::InvalidField, message).at("revisions"));
    }
    let (from, to) = convert::span(request.from, request.to)?;
    let query = SolutionQuery {
        from,
        to,
        status: convert::status_filter(request.status)?,
        revisions,
        page_size: BATCH,
        page_token: None,
    };
    Lease::current().map_or(Ok(()), |lease| lease.reserve(TRACK_BYTES + format.memory_bytes()))?;
    let SolutionPage { page, output, bases, .. } = caller.sessions().solutions(&id, &query).await?;
    let comments = comments(&id, revisions, &output);
    let presenter = caller.presenter(&output).naming_frames(caller, &bases);
    let leap = LeapSeconds::table();
    let writer = TrackWriter::of_stored(format, &comments, leap, presenter.presentation());
    let pass = Lease::current().and_then(|lease| lease.pass().cloned());
    let (caller, step) = (caller.clone(), Step::Begin(page));
    let track = Track { caller, id, query, writer, output, step, pass };
    Ok(stream::unfold(track, |mut track| async move {
        let bytes = track.next().await.transpose()?;
        Some((bytes, track))
    }))
}

fn known(format: &str) -> Result<ResultFormat, Refusal> {
    let known = ResultFormat::from_name(format).ok_or_else(|| {
        let (given, names) = (texts::brief(format), ResultFormat::names());
        let message = format!("{given:?} is not a format of tracks; known are {names}");
        Refusal::new(Code::InvalidField, message).at("format")
    })?;
    match known {
        ResultFormat::Track(track) if !track.is_built() => {
            Err(Refusal::new(Code::FeatureNotBuilt, track.not_built()).at("format"))
        }
        _ => Ok(known),
    }
}

/// Comment lines at the head of a `.pos` file.
fn comments(id: &SessionId, revisions: Revisions, output: &OutputOptions) -> Vec<String> {
    let revisions = match revisions {
        Revisions::First => "first",
        Revisions::Last => "last",
        Revisions::All | Revisions::Later => "all",
    };
    let lines = [
        format!("program   : graphfix {}", env!("CARGO_PKG_VERSION")),
        format!("session   : {id}"),
        format!("revisions : {revisions}"),
    ];
    lines.into_iter().chain(output.comment()).collect()
}

/// A track that is being read.
struct Track {
    caller: Caller,
    id: SessionId,
    query: SolutionQuery,
    writer: TrackWriter,
    /// Output options as at the beginning, even if the session changes meanwhile.
    output: OutputOptions,
    step: Step,
    /// The sender of the request. When the sender's key ends, the track ends, too.
    pass: Option<Pass>,
}

enum Step {
    /// Nothing is written yet. The first page is read.
    Begin(Page<StoredSolution>),
    /// The page with this token is next.
    Read(String),
    End,
}

impl Track {
    /// The next bytes; `None` at the end. After a refusal there are no more.
    async fn next(&mut self) -> Result<Option<Bytes>, Refusal> {
        let mut out = Vec::new();
        let step = std::mem::replace(&mut self.step, Step::End);
        self.pass.as_ref().map_or(Ok(()), Pass::check)?;
        let page = match step {
            Step::End => return Ok(None),
            Step::Begin(page) => {
                self.writer.begin(&mut out);
                page
            }
            Step::Read(token) => {
                self.query.page_token = Some(token);
                self.caller.sessions().solutions(&self.id, &self.query).await?.page
            }
        };
        let presenter = self.caller.presenter(&self.output);
        for StoredSolution { seq, revision, solution, .. } in &page.items {
            let revision = Revision { seq: *seq, revision: *revision };
            self.writer.push(presenter.present(solution), Some(revision), &mut out);
        }
        match page.next_page_token {
            Some(token) => self.step = Step::Read(token),
            None => self.writer.finish(&mut out),
        }
        Ok(Some(out.into()))
    }
}
