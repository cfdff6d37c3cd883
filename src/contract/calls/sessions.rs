//! Sessions.

use std::mem;

use crate::aiding::bases::BaseChoice;
use crate::clock::gps_time;
use crate::config::Mode;
use crate::contract::{Caller, Lease, Refusal, convert, finished, texts, v1};
use crate::gnss::GpsTime;
use crate::session::{NewSession, SessionHead, SessionInfo, SessionUpdate};
use crate::store::{SCANNED_HEADS, SessionFilter};

use super::paging::{PAGE_BYTES, Pages, Reading};
use super::{
    MODE, NEAREST, PROFILE, base_choice, bounds, is_full, named_request, oldest_first, or_standard,
    page_size, session_id, timestamp, utc,
};

/// Sessions on a page if the request gives no size.
const PAGE: usize = 100;
/// Most sessions on a page.
const PAGE_LIMIT: usize = 1000;
/// Memory of a session with its configuration of 75 options, its message and its JSON (bytes).
const FULL_BYTES: usize = 64 << 10;
const _: () = assert!(PAGE_BYTES / FULL_BYTES == 128, "proto/ and docs/api.md state it");
/// Memory of a session without its configuration, its message and its JSON (bytes).
const BASIC_BYTES: usize = 8 << 10;
/// Heads on a page if the request gives no size.
const HEADS: usize = 1000;
/// Most heads on a page.
const HEADS_MAX: usize = 10_000;
/// Memory of a head, its message and its JSON (bytes).
pub(super) const HEAD_BYTES: usize = 1024;
/// Memory of a head that is searched for an area (bytes).
const SCANNED_BYTES: usize = 256;

/// Opens a session. Returns it, and whether it is new: a repetition of a named request returns the
/// session that the first one has opened.
///
/// # Errors
/// The configuration does not exist, a request with this name had other content, or the store
/// fails.
pub async fn create(
    caller: &Caller,
    mut request: v1::CreateSessionRequest,
) -> Result<(v1::Session, bool), Refusal> {
    let named = named_request(mem::take(&mut request.request_id), &request)?;
    texts::check_label(&request.label)?;
    texts::check_names([("mode", &*request.mode), ("profile", &*request.profile)])?;
    texts::check_overrides(&request.overrides)?;
    texts::check("antenna", &request.antenna, texts::ANTENNA_MAX)?;
    let new = NewSession {
        label: request.label,
        mode: or_standard(request.mode, MODE),
        profile: or_standard(request.profile, PROFILE),
        overrides: request.overrides,
        base: base_choice(caller, &request.base, &request.bases)?,
        antenna: request.antenna,
        retention_days: request.retention_days,
    };
    let (session, is_new) = caller.sessions().create_once(new, named).await?;
    Ok((message(session), is_new))
}

/// A session.
///
/// # Errors
/// The session does not exist.
pub async fn get(caller: &Caller, request: v1::GetSessionRequest) -> Result<v1::Session, Refusal> {
    let id = session_id(&request.session)?;
    Ok(message(caller.sessions().get(&id).await?))
}

/// A page of sessions. It may have fewer than asked, so that it needs no more than a bounded part
/// of the memory of requests.
///
/// # Errors
/// The page token, the page size or the filter is invalid.
pub async fn list(
    caller: &Caller,
    mut request: v1::ListSessionsRequest,
) -> Result<v1::ListSessionsResponse, Refusal> {
    let size = page_size(mem::take(&mut request.page_size), PAGE);
    let token = mem::take(&mut request.page_token);
    let pages = Pages::of("Sessions/List", &request, &token)?;
    let is_full = is_full(request.view)?;
    let v1::ListSessionsRequest { closed, mode, label, order, .. } = request;
    let filter = filter(closed, mode, label, order)?;
    let item_bytes = if is_full { FULL_BYTES } else { BASIC_BYTES };
    let mut reading = Reading::of(&pages, (size, PAGE_LIMIT), item_bytes)?;
    while let Some(count) = reading.batch()? {
        let page = caller.sessions().list(&filter, count, reading.after()).await?;
        let shown = |mut session: SessionInfo| {
            if !is_full {
                session.configuration = Vec::new();
            }
            message(session)
        };
        reading.add(page.items.into_iter().map(shown), page.next_page_token);
    }
    let (sessions, next) = reading.end();
    Ok(v1::ListSessionsResponse { sessions, next_page_token: pages.token(next) })
}

/// Which sessions a list has.
pub(super) fn filter(
    closed: Option<bool>,
    mode: String,
    label: String,
    order: i32,
) -> Result<SessionFilter, Refusal> {
    texts::check_names([("mode", &*mode), ("label", &*label)])?;
    if !mode.is_empty() {
        Mode::parse(&mode)?;
    }
    let oldest_first = oldest_first(order)?;
    Ok(SessionFilter { is_closed: closed, mode, label, oldest_first })
}

/// A page of heads.
///
/// # Errors
/// The page token, the page size or the filter is invalid.
pub async fn heads(
    caller: &Caller,
    mut request: v1::ListHeadsRequest,
) -> Result<v1::ListHeadsResponse, Refusal> {
    let size = page_size(mem::take(&mut request.page_size), HEADS);
    let token = mem::take(&mut request.page_token);
    let pages = Pages::of("Sessions/Heads", &request, &token)?;
    let v1::ListHeadsRequest { closed, mode, label, order, area, .. } = request;
    let (filter, area) = (filter(closed, mode, label, order)?, bounds(area)?);
    let scanned_bytes = if area.is_some() { SCANNED_HEADS * SCANNED_BYTES } else { 0 };
    let bytes = size.min(HEADS_MAX) * HEAD_BYTES + scanned_bytes;
    Lease::current().as_ref().map_or(Ok(()), |lease| lease.reserve(bytes))?;
    let (page, now_ms) =
        caller.sessions().heads(&filter, area.as_ref(), size, pages.after()).await?;
    let now = gps_time(now_ms);
    Ok(v1::ListHeadsResponse {
        heads: page.items.into_iter().map(|head| head_message(head, now)).collect(),
        next_page_token: pages.token(page.next_page_token),
        now_utc: utc(now_ms),
    })
}

/// Changes the given fields of a session.
///
/// # Errors
/// The session does not exist, is closed or has another etag, or the configuration does not exist.
pub async fn update(
    caller: &Caller,
    request: v1::UpdateSessionRequest,
) -> Result<v1::Session, Refusal> {
    let (caller, session) = (caller.clone(), request.session.clone());
    // The session's task must see settings that are stored.
    let act = async move {
        let updated = updated(&caller, request).await;
        caller.noted("Sessions.Update", &session, updated).await
    };
    finished(act).await
}

async fn updated(
    caller: &Caller,
    request: v1::UpdateSessionRequest,
) -> Result<v1::Session, Refusal> {
    let id = session_id(&request.session)?;
    request.label.iter().try_for_each(|label| texts::check_label(label))?;
    let names = [("mode", &request.mode), ("profile", &request.profile)];
    texts::check_names(names.iter().filter_map(|(field, name)| Some((*field, name.as_deref()?))))?;
    texts::check_overrides(&request.overrides)?;
    texts::check_names(request.clear_overrides.iter().map(|key| ("clearOverrides", key.as_str())))?;
    if let Some(antenna) = &request.antenna {
        texts::check("antenna", antenna, texts::ANTENNA_MAX)?;
    }
    let base = match (&request.base, &*request.bases) {
        (None, []) => None,
        (base, bases) => Some(base_choice(caller, base.as_deref().unwrap_or_default(), bases)?),
    };
    let update = SessionUpdate {
        label: request.label,
        mode: request.mode,
        profile: request.profile,
        overrides: request.overrides,
        clear_overrides: request.clear_overrides,
        base,
        antenna: request.antenna,
        retention_days: request.retention_days,
        etag: Some(request.etag).filter(|etag| !etag.is_empty()),
    };
    let author = caller.administrator();
    Ok(message(caller.sessions().update_by(&id, update, author.as_ref()).await?))
}

/// Begins a new arc of a session.
///
/// # Errors
/// The session does not exist or is closed.
pub async fn reset(
    caller: &Caller,
    request: v1::ResetSessionRequest,
) -> Result<v1::Session, Refusal> {
    let act = async {
        let (id, author) = (session_id(&request.session)?, caller.administrator());
        Ok(message(caller.sessions().reset_by(&id, author.as_ref()).await?))
    };
    caller.noted("Sessions.Reset", &request.session, act.await).await
}

/// Closes a session.
///
/// # Errors
/// The session does not exist.
pub async fn close(
    caller: &Caller,
    request: v1::CloseSessionRequest,
) -> Result<v1::Session, Refusal> {
    let act = async {
        let (id, author) = (session_id(&request.session)?, caller.administrator());
        Ok(message(caller.sessions().close_by(&id, author.as_ref()).await?))
    };
    caller.noted("Sessions.Close", &request.session, act.await).await
}

/// Deletes a session with everything that it has stored.
///
/// # Errors
/// The session does not exist.
pub async fn delete(
    caller: &Caller,
    request: v1::DeleteSessionRequest,
) -> Result<v1::Session, Refusal> {
    let act = async {
        let (id, author) = (session_id(&request.session)?, caller.administrator());
        Ok(message(caller.sessions().delete_by(&id, author.as_ref()).await?))
    };
    caller.noted("Sessions.Delete", &request.session, act.await).await
}

pub(super) fn head_message(head: SessionHead, now: GpsTime) -> v1::SessionHead {
    v1::SessionHead {
        session: head.id,
        label: head.label,
        mode: head.mode,
        created_utc: utc(head.created_unix_ms),
        closed: head.is_closed,
        last_seq: head.last_seq,
        last_time: head.last_time.map(Into::into),
        age_s: head.last_time.map(|last| now - last),
        status: head.status.map_or(v1::Status::Unspecified, convert::status).into(),
        position: head.position.map(convert::geodetic),
        create_time: timestamp(head.created_unix_ms),
    }
}

fn message(info: SessionInfo) -> v1::Session {
    let option = |entry: crate::config::OptionEntry| v1::Option {
        name: entry.name.to_owned(),
        unit: entry.unit.to_owned(),
        value: entry.value,
        default: entry.default,
        meaning: entry.meaning.to_owned(),
        allowed: entry.allowed.to_owned(),
    };
    let (base, bases) = match info.base {
        BaseChoice::None => (String::new(), Vec::new()),
        BaseChoice::One(id) => (id.to_string(), Vec::new()),
        BaseChoice::NearestOf(ids) => {
            (String::new(), ids.iter().map(ToString::to_string).collect())
        }
        BaseChoice::Nearest => (NEAREST.to_owned(), Vec::new()),
    };
    let (antenna, antenna_calibration) =
        info.antenna.map(|antenna| (antenna.name, antenna.calibration)).unwrap_or_default();
    v1::Session {
        session: info.id.to_string(),
        label: info.label,
        mode: info.mode,
        profile: info.profile,
        overrides: info.overrides,
        configuration: info.configuration.into_iter().map(option).collect(),
        configuration_hash: info.configuration_hash.to_string(),
        created_utc: utc(info.created_unix_ms),
        closed: info.closed_unix_ms.is_some(),
        durable_through: info.durable_through,
        raw_through: info.raw_through,
        base,
        bases,
        antenna,
        antenna_calibration: antenna_calibration.to_string(),
        retention_days: info.retention_days,
        oldest_available_seq: info.oldest_available,
        etag: info.etag,
        create_time: timestamp(info.created_unix_ms),
    }
}
