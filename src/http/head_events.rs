//! `/v1/sessions:watch`: server-sent events.

use std::convert::Infallible;

use axum::response::Sse;
use axum::response::sse::Event;
use futures::Stream;
use serde::Deserialize;
use utoipa::IntoParams;

use crate::contract::{Caller, calls, v1};

use super::body::StrictQuery;
use super::problem::Refused;
use super::watch;

/// Which heads to watch.
#[derive(Clone, Debug, Default, Deserialize, IntoParams)]
#[serde(rename_all = "camelCase", default, deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct HeadsWatchQuery {
    /// Only those of closed sessions, or only of open ones; all if absent.
    closed: Option<bool>,
    /// Only those of this mode.
    mode: String,
    /// Only those with exactly this label.
    label: String,
}

/// Sends the latest status and position of sessions as they change, as server-sent events.
///
/// The first events `heads` have all of them; the last of these has `complete`. Each later one has
/// the heads that have changed since, about once a second, and in `gone` the ids of sessions that
/// match no longer or are deleted. An event `end` with a problem document says why the events end.
/// After a break everything comes again.
#[utoipa::path(get, operation_id = "sessionsWatchHeads",
    path = "/v1/sessions:watch", tag = "Sessions", params(HeadsWatchQuery),
    responses((status = 200, description = "Events with heads",
        body = v1::WatchHeadsResponse, content_type = "text/event-stream"),
        Refused))]
pub(super) async fn events(
    caller: Caller,
    StrictQuery(query): StrictQuery<HeadsWatchQuery>,
) -> Result<Sse<impl Stream<Item = Result<Event, Infallible>>>, Refused> {
    let HeadsWatchQuery { closed, mode, label } = query;
    let request = v1::WatchHeadsRequest { closed, mode, label };
    let messages = calls::head_watch::watch(&caller, request).await?;
    Ok(watch::events(messages, |message| watch::named("heads", &message)))
}
