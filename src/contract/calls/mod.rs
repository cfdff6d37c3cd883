//! The calls: one file per service, one function per call, from a request to an answer or a
//! refusal.

pub mod bases;
mod feeds;
mod job_options;
pub mod job_watch;
pub mod jobs;
pub mod keys;
pub mod navigation;
mod outlet;
mod paging;
pub mod positioning;
pub mod raw;
pub mod sessions;
pub mod solutions;
pub mod stream;
pub mod tenants;
pub mod track;
mod upload;
pub mod watch;

use prost::Message;

use crate::aiding::bases::{BaseChoice, BaseId};
use crate::gnss::{CivilTime, GpsTime, LeapSeconds, TimeScale};
use crate::refusal::Code;
use crate::session::SessionId;
use crate::store::NamedRequest;

use super::texts::{self, brief};
use super::{Caller, Refusal, v1};

/// The mode if the request has none.
const MODE: &str = "spp";
/// The profile if the request has none.
const PROFILE: &str = "general";
/// The value of `base` for the nearest of all bases.
const NEAREST: &str = "nearest";

fn session_id(text: &str) -> Result<SessionId, Refusal> {
    SessionId::parse(text).ok_or_else(|| {
        Refusal::new(Code::SessionNotFound, format!("there is no session {:?}", brief(text)))
            .at("session")
    })
}

fn base_id(text: &str) -> Result<BaseId, Refusal> {
    BaseId::parse(text).ok_or_else(|| {
        Refusal::new(Code::BaseNotFound, format!("there is no base {:?}", brief(text))).at("base")
    })
}

/// The bases of a request: one by id, the nearest of all, or the nearest of a list.
fn base_choice(
    caller: &Caller,
    base: &str,
    bases: &[String],
) -> Result<BaseChoice<BaseId>, Refusal> {
    if bases.is_empty() {
        return match base {
            "" => Ok(BaseChoice::None),
            NEAREST => Ok(BaseChoice::Nearest),
            id => base_id(id).map(BaseChoice::One),
        };
    }
    if !base.is_empty() {
        let message = "base and bases are both given";
        return Err(Refusal::new(Code::InvalidField, message).at("bases"));
    }
    let named = |(index, text): (usize, &String)| {
        let at = |refusal: Refusal| refusal.at(format!("bases[{index}]"));
        let id = base_id(text).map_err(at)?;
        caller.bases().name(&id).map_err(|error| at(error.into()))?;
        Ok(id)
    };
    let ids: Result<_, Refusal> = bases.iter().enumerate().map(named).collect();
    Ok(BaseChoice::NearestOf(ids?))
}

/// `text`, or `standard` if it is empty.
fn or_standard(text: String, standard: &str) -> String {
    if text.is_empty() { standard.to_owned() } else { text }
}

/// Whether a list begins with the oldest.
fn oldest_first(order: i32) -> Result<bool, Refusal> {
    match v1::Order::try_from(order) {
        Ok(v1::Order::Unspecified | v1::Order::NewestFirst) => Ok(false),
        Ok(v1::Order::OldestFirst) => Ok(true),
        Err(_) => {
            let message = format!("{order} is not an order of a list");
            Err(Refusal::new(Code::InvalidField, message).at("order"))
        }
    }
}

/// Whether the items of a list have their large fields.
fn is_full(view: i32) -> Result<bool, Refusal> {
    match v1::View::try_from(view) {
        Ok(v1::View::Unspecified | v1::View::Full) => Ok(true),
        Ok(v1::View::Basic) => Ok(false),
        Err(_) => {
            let message = format!("{view} is not a view of a list");
            Err(Refusal::new(Code::InvalidField, message).at("view"))
        }
    }
}

/// The name of a request that creates something, with the hash of its content; `None` without a
/// name. `content` is the request without its name.
fn named_request<M: Message>(name: String, content: &M) -> Result<Option<NamedRequest>, Refusal> {
    texts::check("requestId", &name, texts::NAME_MAX)?;
    let hash = || blake3::hash(&content.encode_to_vec()).to_hex().to_string();
    Ok((!name.is_empty()).then(|| NamedRequest { name, hash: hash() }))
}

/// The page size of a request, or the call's standard size if it is zero.
const fn page_size(asked: u32, standard: usize) -> usize {
    if asked == 0 { standard } else { asked as usize }
}

/// A system time (ms since 1970-01-01 UTC, without leap seconds) as RFC 3339.
pub(crate) fn utc(unix_ms: i64) -> String {
    const EPOCH: CivilTime =
        CivilTime { year: 1970, month: 1, day: 1, hour: 0, minute: 0, second: 0, nanosecond: 0 };
    let leap = LeapSeconds::table();
    // GPS time has no leap seconds, as the system clock.
    let start = GpsTime::from_civil(&EPOCH, TimeScale::Gps, &leap).expect("the date exists");
    let civil = GpsTime::from_ns(start.as_ns().saturating_add(unix_ms.saturating_mul(1_000_000)))
        .to_civil(TimeScale::Gps, &leap);
    let CivilTime { year, month, day, hour, minute, second, nanosecond } = civil;
    let ms = nanosecond / 1_000_000;
    format!("{year:04}-{month:02}-{day:02}T{hour:02}:{minute:02}:{second:02}.{ms:03}Z")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn system_time_is_written_as_it_is() {
        assert_eq!(utc(0), "1970-01-01T00:00:00.000Z");
        // date -u -d @1556456281 gives 2019-04-28 12:58:01.
        assert_eq!(utc(1_556_456_281_250), "2019-04-28T12:58:01.250Z");
    }
}
