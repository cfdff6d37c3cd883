//! The streams and archives that fill bases.

use crate::aiding::bases::{BaseFeed, BaseId};
use crate::clock::unix_ms;
use crate::contract::{Caller, Refusal, intake, texts, v1};
use crate::feeds::{BaseArchiveHealth, FeedHealth, FeedProblem, NetworkHealth, SourceStatus};
use crate::gnss::{Ecef, Geodetic};
use crate::refusal::Code;

use super::raw::statistics;
use super::{timestamp, typed, utc};

/// Longest user name and longest password at a caster (characters).
const CREDENTIAL_LIMIT: usize = 200;
/// Possible heights of a rover (m).
const HEIGHTS_M: std::ops::RangeInclusive<f64> = -1e3..=1e5;

/// Reads and checks the stream of a request.
pub(super) fn source(caller: &Caller, source: v1::NtripSource) -> Result<BaseFeed, Refusal> {
    let v1::NtripSource { caster, mountpoint, user, password, version, position, near, .. } =
        source;
    texts::check("ntrip.caster", &caster, texts::ADDRESS_MAX)?;
    texts::check("ntrip.mountpoint", &mountpoint, texts::NAME_MAX)?;
    let version = match version {
        0 | 2 => 2,
        1 => 1,
        other => {
            let message = format!("{other} is not a version of NTRIP; known are 1 and 2");
            return Err(refused("version", message));
        }
    };
    check_credentials(&user, &password)?;
    let position = position.map(rover_position).transpose()?;
    let at_near = |refusal: Refusal| refusal.at("ntrip.near");
    let near = near.map(|near| intake::time(near.week, near.ns_of_week).map_err(at_near));
    let near = near.transpose()?;
    let feed = BaseFeed {
        caster,
        mountpoint,
        name: user,
        password,
        version,
        near,
        position,
        follows_rover: source.follow_rover,
        is_on_demand: false,
    };
    caller.feeds().check(&feed)?;
    Ok(feed)
}

fn refused(field: &str, message: String) -> Refusal {
    Refusal::new(Code::InvalidField, message).at(format!("ntrip.{field}"))
}

/// Checks user and password: RFC 7617 separates them by a colon.
fn check_credentials(user: &str, password: &str) -> Result<(), Refusal> {
    let is_text =
        |text: &str| text.len() <= CREDENTIAL_LIMIT && text.chars().all(|c| !c.is_control());
    if !is_text(user) || user.contains(':') {
        let message = format!("a user is up to {CREDENTIAL_LIMIT} bytes without a colon");
        return Err(refused("user", message));
    }
    if !is_text(password) {
        let message =
            format!("a password is up to {CREDENTIAL_LIMIT} bytes without control characters");
        return Err(refused("password", message));
    }
    Ok(())
}

/// Reads and checks the position of the rovers.
fn rover_position(position: v1::Geodetic) -> Result<Ecef, Refusal> {
    let v1::Geodetic { latitude_deg, longitude_deg, height_m } = position;
    let is_valid =
        latitude_deg.abs() <= 90.0 && longitude_deg.abs() <= 360.0 && HEIGHTS_M.contains(&height_m);
    if !is_valid {
        let message = "it is not a position near the Earth's surface".to_owned();
        return Err(refused("position", message));
    }
    let (latitude_rad, longitude_rad) = (latitude_deg.to_radians(), longitude_deg.to_radians());
    Ok(Geodetic { latitude_rad, longitude_rad, height_m }.to_ecef())
}

/// A stream with its health, as a message.
pub(super) fn message(caller: &Caller, base: &str, feed: &BaseFeed) -> v1::Feed {
    let named = v1::Feed {
        caster: feed.caster.clone(),
        mountpoint: feed.mountpoint.clone(),
        user: feed.name.clone(),
        ..Default::default()
    };
    let health = BaseId::parse(base).and_then(|id| caller.feeds().health(&id));
    let Some(health) = health else {
        let state = if feed.is_on_demand { "IDLE" } else { "" };
        return v1::Feed { state: state.to_owned(), source_state: source_state(state), ..named };
    };
    let now = unix_ms();
    let FeedHealth { state, problem, refusal, statistics: counted, .. } = &health;
    let (messages, left_out) = statistics(counted);
    v1::Feed {
        state: state.name().to_owned(),
        since_utc: utc(health.since_unix_ms),
        source_state: source_state(state.name()),
        since_time: timestamp(health.since_unix_ms),
        retry_in_s: health.retry_unix_ms.map(|retry| seconds_between(now, retry)),
        problem: problem.as_ref().map(problem_message),
        refusal: refusal.as_ref().map(problem_message),
        attempts: health.attempts,
        connections: health.connections,
        bytes: health.bytes,
        silent_s: health.received_unix_ms.map(|received| seconds_between(received, now)),
        epochs: health.epochs,
        last_time: health.last_epoch.map(Into::into),
        messages,
        left_out,
        garbage_bytes: counted.garbage_bytes(),
        station_off_m: health.station_off_m,
        ..named
    }
}

/// Reads and checks the archive of a request.
pub(super) fn archive(caller: &Caller, source: v1::ArchiveSource) -> Result<String, Refusal> {
    texts::check("archive.template", &source.template, texts::ADDRESS_MAX)?;
    let checked = caller.feeds().check_archive(&source.template);
    checked.map_err(|error| Refusal::from(error).at("archive.template"))?;
    Ok(source.template)
}

/// An archive with its health, as a message.
pub(super) fn archive_message(caller: &Caller, base: &str, template: &str) -> v1::BaseArchive {
    let named = v1::BaseArchive { template: template.to_owned(), ..Default::default() };
    let health = BaseId::parse(base).and_then(|id| caller.feeds().archive_health(&id));
    let Some(health) = health else { return named };
    let BaseArchiveHealth { state, since_unix_ms, retry_unix_ms, problem, refusal, .. } = health;
    v1::BaseArchive {
        state: state.name().to_owned(),
        since_utc: utc(since_unix_ms),
        source_state: source_state(state.name()),
        since_time: timestamp(since_unix_ms),
        retry_in_s: retry_unix_ms.map(|retry| seconds_between(unix_ms(), retry)),
        problem: problem.as_ref().map(problem_message),
        refusal: refusal.as_ref().map(problem_message),
        missing: health.missing as u32,
        requests: health.requests,
        files: health.files,
        bytes: health.bytes,
        epochs: health.epochs,
        last_file: health.last_file.unwrap_or_default(),
        ..named
    }
}

/// A source of ephemerides with its health, as a message.
pub(super) fn source_message((name, status): (String, SourceStatus)) -> v1::NavigationSource {
    let (kind, state, since, retry, problem, ephemerides, last) = match status {
        SourceStatus::Archive(health) => (
            "archive",
            health.state.name(),
            health.since_unix_ms,
            health.retry_unix_ms,
            health.problem,
            health.ephemerides,
            health.succeeded_unix_ms,
        ),
        SourceStatus::Stream(health) => (
            "caster",
            health.state.name(),
            health.since_unix_ms,
            health.retry_unix_ms,
            health.problem,
            health.ephemerides,
            health.received_unix_ms,
        ),
    };
    v1::NavigationSource {
        name,
        kind: kind.to_owned(),
        state: state.to_owned(),
        since_utc: utc(since),
        retry_in_s: retry.map(|retry| seconds_between(unix_ms(), retry)),
        problem: problem.as_ref().map(problem_message),
        ephemerides,
        last_utc: last.map(utc).unwrap_or_default(),
        source_state: source_state(state),
        since_time: timestamp(since),
        last_time: last.and_then(timestamp),
    }
}

/// A caster whose sourcetable brings bases, with its health, as a message.
pub(super) fn network_message(health: &NetworkHealth) -> v1::Network {
    v1::Network {
        caster: health.caster.clone(),
        state: health.state.name().to_owned(),
        since_utc: utc(health.since_unix_ms),
        retry_in_s: health.retry_unix_ms.map(|retry| seconds_between(unix_ms(), retry)),
        problem: health.problem.as_ref().map(problem_message),
        refusal: health.refusal.as_ref().map(problem_message),
        last_utc: health.succeeded_unix_ms.map(utc).unwrap_or_default(),
        listed: health.listed as u64,
        usable: health.usable as u64,
        connected: health.connected as u64,
        source_state: source_state(health.state.name()),
        since_time: timestamp(health.since_unix_ms),
        last_time: health.succeeded_unix_ms.and_then(timestamp),
    }
}

/// The state of a source, with its type.
fn source_state(name: &str) -> i32 {
    typed(&format!("SOURCE_STATE_{name}"), v1::SourceState::from_str_name)
}

/// The time between two instants (s).
fn seconds_between(from_unix_ms: i64, until_unix_ms: i64) -> f64 {
    (until_unix_ms - from_unix_ms).max(0) as f64 / 1e3
}

fn problem_message(problem: &FeedProblem) -> v1::Refusal {
    v1::Refusal {
        code: problem.code.name().to_owned(),
        message: problem.message.clone(),
        remedy: problem.code.remedy().to_owned(),
        field: String::new(),
    }
}
