//! `/v1/sessions/{session}/solutions:watch`: server-sent events.

use std::convert::Infallible;
use std::time::Duration;

use axum::extract::Path;
use axum::http::HeaderMap;
use axum::response::Sse;
use axum::response::sse::Event;
use futures::{Stream, StreamExt, stream};
use serde::{Deserialize, Serialize};
use utoipa::IntoParams;

use crate::contract::{Caller, Refusal, calls, v1};
use crate::refusal::Code;

use super::body::StrictQuery;
use super::problem::{Problem, Refused};
use super::solutions::revisions;

/// Header with which a browser names the last event that it has.
const LAST_EVENT: &str = "last-event-id";
/// Delay before a browser watches again after an interruption.
const RETRY: Duration = Duration::from_secs(2);

/// Where a watch begins.
#[derive(Clone, Debug, Default, Deserialize, IntoParams)]
#[serde(rename_all = "camelCase", default, deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct WatchQuery {
    /// The revisions of each epoch: `all` (if absent) or `first`.
    revisions: Option<String>,
    /// `id` of the last event: the watch goes on behind it. The header `Last-Event-ID`, which
    /// browsers send by themselves, has precedence.
    cursor: String,
    /// Without a cursor: the solutions of epochs after this number, stored ones first; 0 for all.
    /// Only what is committed from now on if absent.
    after_seq: Option<u64>,
}

/// Sends the solutions of a session as they are committed, as server-sent events.
///
/// Each event `solutions` has new solutions, and an `id` with which another watch goes on behind
/// them. Its content is that of the gRPC call's message. The last event is `closed` if the session
/// is closed, or `end` with a problem document that says why the watch ends; then watch again with
/// the last `id`, as browsers do by themselves.
#[utoipa::path(get, operation_id = "solutionsWatch",
    path = "/v1/sessions/{session}/solutions:watch", tag = "Solutions",
    params(("session" = String, Path, description = "Its id"), WatchQuery),
    responses((status = 200, description = "Events with solutions",
        body = v1::WatchSolutionsResponse, content_type = "text/event-stream"),
        Refused))]
pub(super) async fn watch(
    caller: Caller,
    Path(session): Path<String>,
    headers: HeaderMap,
    StrictQuery(query): StrictQuery<WatchQuery>,
) -> Result<Sse<impl Stream<Item = Result<Event, Infallible>>>, Refused> {
    let last = headers.get(LAST_EVENT).map(|id| id.to_str().map(ToOwned::to_owned));
    let last = last.transpose().map_err(|_| {
        Refusal::new(Code::CursorInvalid, "Last-Event-ID is not a text").at("cursor")
    })?;
    let request = v1::WatchSolutionsRequest {
        session,
        revisions: query.revisions.map_or(Ok(0), |name| revisions(&name))?,
        // A cursor is later than the number from which a watch began.
        after_seq: query.after_seq.filter(|_| last.is_none()),
        cursor: last.unwrap_or(query.cursor),
    };
    let messages = calls::watch::watch(&caller, request).await?;
    Ok(events(messages, |message| {
        let name = if message.closed { "closed" } else { "solutions" };
        named(name, &message).id(message.cursor)
    }))
}

/// Messages as server-sent events, converted by `event`. A refusal becomes the event `end`.
pub(super) fn events<T>(
    messages: impl Stream<Item = Result<T, Refusal>> + Send + 'static,
    event: impl Fn(T) -> Event + Send + 'static,
) -> Sse<impl Stream<Item = Result<Event, Infallible>>> {
    let retry = stream::iter([Ok(Event::default().retry(RETRY))]);
    let events = messages.map(move |message| {
        Ok(message.map_or_else(|refusal| named("end", &Problem::of(&refusal)), &event))
    });
    Sse::new(retry.chain(events))
}

/// An event with this name.
pub(super) fn named(name: &str, content: &impl Serialize) -> Event {
    let written = "a message is texts and finite numbers";
    Event::default().event(name).json_data(content).expect(written)
}
