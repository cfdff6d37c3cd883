//! The calls: one file per service, one function per call, from a request to an answer or a
//! refusal.

pub mod audit;
pub mod bases;
mod feeds;
pub mod head_watch;
pub mod history;
pub mod job_deliveries;
mod job_options;
pub mod job_watch;
pub mod jobs;
pub mod keys;
pub mod navigation;
pub mod observations;
pub mod operations;
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
pub mod uploads;
pub mod watch;

use prost::Message;
use prost_types::Timestamp;

use crate::aiding::bases::{BaseChoice, BaseId};
use crate::clock::unix_epoch;
pub(crate) use crate::clock::utc;
use crate::gnss::{CivilTime, GpsTime, LeapSeconds, TimeScale};
use crate::refusal::Code;
use crate::session::SessionId;
use crate::store::{Bounds, NamedRequest};

use super::texts::{self, brief};
use super::{Caller, Lease, Refusal, v1};

/// The mode if the request has none.
const MODE: &str = "spp";
/// The profile if the request has none.
const PROFILE: &str = "general";
/// The value of `base` for the nearest of all bases.
const NEAREST: &str = "nearest";

fn session_id(text: &str) -> Result<SessionId, Refusal> {
    let id = SessionId::parse(text);
    if let Some(lease) = Lease::current().filter(|_| id.is_some()) {
        lease.set_session(text);
    }
    id.ok_or_else(|| {
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

/// The area of a request.
///
/// # Errors
/// A side is out of range, or the north side is south of the south side.
fn bounds(area: Option<v1::Area>) -> Result<Option<Bounds>, Refusal> {
    let Some(v1::Area { south_deg, west_deg, north_deg, east_deg }) = area else { return Ok(None) };
    let sides = [
        ("southDeg", south_deg, 90.0),
        ("westDeg", west_deg, 180.0),
        ("northDeg", north_deg, 90.0),
        ("eastDeg", east_deg, 180.0),
    ];
    for (side, value_deg, limit_deg) in sides {
        if !(-limit_deg..=limit_deg).contains(&value_deg) {
            let message = format!("{value_deg}° is not from -{limit_deg}° to {limit_deg}°");
            return Err(Refusal::new(Code::InvalidField, message).at(format!("area.{side}")));
        }
    }
    if north_deg < south_deg {
        let message = format!("{north_deg}° is south of {south_deg}°");
        return Err(Refusal::new(Code::InvalidField, message).at("area.northDeg"));
    }
    Ok(Some(Bounds { south_deg, west_deg, north_deg, east_deg }))
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

/// A time (ms since 1970-01-01 UTC) as a message.
fn timestamp(unix_ms: i64) -> Option<Timestamp> {
    let nanos = i32::try_from(unix_ms.rem_euclid(1000) * 1_000_000).unwrap_or_default();
    Some(Timestamp { seconds: unix_ms.div_euclid(1000), nanos })
}

/// The number of the enumeration value with this name; zero (unspecified) for an unknown name.
fn typed<E: Into<i32>>(name: &str, of_name: impl Fn(&str) -> Option<E>) -> i32 {
    of_name(name).map_or(0, Into::into)
}

/// The name of a request that creates something, with the hash of its content; `None` without a
/// name. `content` is the request without its name.
fn named_request<M: Message>(name: String, content: &M) -> Result<Option<NamedRequest>, Refusal> {
    let hash = |content: &[u8]| blake3::hash(content).to_hex().to_string();
    named_request_by(name, content, hash)
}

/// Like [`named_request`], with another hash, for content that contains a secret.
fn named_request_by<M: Message>(
    name: String,
    content: &M,
    hash: impl Fn(&[u8]) -> String,
) -> Result<Option<NamedRequest>, Refusal> {
    texts::check("requestId", &name, texts::NAME_MAX)?;
    let is_named = !name.is_empty();
    Ok(is_named.then(|| NamedRequest { name, hash: hash(&content.encode_to_vec()) }))
}

/// The page size of a request; the default of the call if it is zero.
const fn page_size(asked: u32, standard: usize) -> usize {
    if asked == 0 { standard } else { asked as usize }
}

/// Parses a system time of RFC 3339 in UTC, such as `2026-11-24T01:30:00Z` (ms since
/// 1970-01-01 UTC).
///
/// # Errors
/// The text is not such a time.
fn unix_ms(field: &str, text: &str) -> Result<i64, Refusal> {
    parsed_utc(text).ok_or_else(|| {
        let message = format!("{:?} is not a time such as 2026-11-24T01:30:00Z", brief(text));
        Refusal::new(Code::InvalidField, message).at(field)
    })
}

fn parsed_utc(text: &str) -> Option<i64> {
    let (date, time) = text.strip_suffix('Z')?.split_once('T')?;
    let (time, fraction) = time.split_once('.').unwrap_or((time, "0"));
    let [year, month, day] = numbers(date, '-', [4, 2, 2])?;
    let [hour, minute, second] = numbers(time, ':', [2, 2, 2])?;
    let is_fraction = (1..=9).contains(&fraction.len()) && is_digits(fraction);
    let ms: i64 = format!("{fraction:0<3}").get(..3).filter(|_| is_fraction)?.parse().ok()?;
    let (year, month, day) = (i32::try_from(year).ok()?, month as u8, day as u8);
    let (hour, minute, second) = (hour as u8, minute as u8, second as u8);
    let civil = CivilTime { year, month, day, hour, minute, second, nanosecond: 0 };
    let since = GpsTime::from_civil(&civil, TimeScale::Gps, &LeapSeconds::table())?;
    let epoch = unix_epoch();
    Some((since.as_ns() - epoch.as_ns()) / 1_000_000 + ms)
}

/// Three numbers with these numbers of digits.
fn numbers(text: &str, separator: char, digits: [usize; 3]) -> Option<[u32; 3]> {
    let mut parts = text.split(separator);
    let mut numbers = [0; 3];
    for (number, digits) in numbers.iter_mut().zip(digits) {
        let part = parts.next().filter(|part| part.len() == digits && is_digits(part))?;
        *number = part.parse().ok()?;
    }
    parts.next().is_none().then_some(numbers)
}

fn is_digits(text: &str) -> bool {
    text.bytes().all(|byte| byte.is_ascii_digit())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn system_time_is_read_as_it_is_written() {
        for unix_ms in [0, 1_556_456_281_250, 4_102_444_799_999, -1] {
            assert_eq!(parsed_utc(&utc(unix_ms)), Some(unix_ms));
        }
        // date -u -d 2024-02-29T23:59:59Z +%s gives 1709251199.
        assert_eq!(parsed_utc("2024-02-29T23:59:59Z"), Some(1_709_251_199_000));
        assert_eq!(parsed_utc("2024-02-29T23:59:59.0509Z"), Some(1_709_251_199_050));
        for other in [
            "",
            "2024-02-29",
            "2023-02-29T00:00:00Z",
            "2024-02-29T24:00:00Z",
            "2024-02-29T00:00:00",
            "2024-02-29T00:00:00+01:00",
            "2024-02-29T00:00:00.Z",
            "2024-2-29T00:00:00Z",
            "2024-02-29T00:00:-1Z",
            "２024-02-29T00:00:00Z",
        ] {
            assert_eq!(parsed_utc(other), None, "{other:?}");
        }
    }

    #[test]
    fn system_time_is_written_as_it_is() {
        assert_eq!(utc(0), "1970-01-01T00:00:00.000Z");
        // date -u -d @1556456281 gives 2019-04-28 12:58:01.
        assert_eq!(utc(1_556_456_281_250), "2019-04-28T12:58:01.250Z");
    }
}
