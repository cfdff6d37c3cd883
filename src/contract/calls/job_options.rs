//! The options of a batch job: conversion between messages and the desk's form.

use crate::config::Mode;
use crate::contract::{Caller, Refusal, convert, texts, v1};
use crate::gnss::GpsTime;
use crate::jobs::{
    BaseOrigin, JobError, JobOptions, JobRequest, SessionInput, SessionSource, Webhook,
    WebhookSecret,
};
use crate::refusal::Code;
use crate::store::BaseChoice;

use super::{NEAREST, PROFILE, base_choice, or_standard};

/// The format if the request has none.
const FORMAT: &str = "pos";

/// The options in a message, with defaults for those that are missing.
///
/// # Errors
/// Options contradict each other, or the caller may not read the session.
pub(super) fn read(
    caller: &Caller,
    message: v1::JobOptions,
    has_base: bool,
) -> Result<JobOptions, Refusal> {
    let near = convert::time(message.near, "options.near")?;
    let session = session(caller, &message, has_base)?;
    let bases = match &session {
        Some(_) => BaseChoice::None, // It has them.
        None => bases(caller, &message, has_base)?,
    };
    let is_relative = has_base || !bases.is_none();
    let answer = match (message.smoothed, message.batch) {
        (false, false) => "causal",
        (true, false) => "smoothed",
        (false, true) => "batch",
        (true, true) => return contradiction("smoothed", "batch"),
    };
    let base_position = match (message.base_position, message.base_position_from_header) {
        (None, false) => BaseOrigin::Any,
        (None, true) => BaseOrigin::FromHeader,
        (Some(v1::Ecef { x_m, y_m, z_m }), false) => BaseOrigin::Marker([x_m, y_m, z_m]),
        (Some(_), true) => return contradiction("basePosition", "basePositionFromHeader"),
    };
    // A session has its own mode and profile.
    let standard = |name: &'static str| if session.is_some() { "" } else { name };
    Ok(JobOptions {
        mode: or_standard(message.mode, standard(Mode::of_recording(is_relative).name())),
        profile: or_standard(message.profile, standard(PROFILE)),
        overrides: message.overrides,
        answer: answer.to_owned(),
        base_position,
        format: or_standard(message.format, FORMAT),
        near_ns: near.map(GpsTime::as_ns),
        bases,
        session,
        webhook: None,
    })
}

/// The webhook of a request.
///
/// # Errors
/// The secret is invalid.
pub(super) fn webhook(message: Option<v1::JobWebhook>) -> Result<Option<Webhook>, JobError> {
    let Some(v1::JobWebhook { url, secret }) = message else { return Ok(None) };
    Ok(Some(Webhook { url, secret: WebhookSecret::parse(&secret)? }))
}

fn contradiction<T>(field: &str, other: &str) -> Result<T, Refusal> {
    let text = format!("{field} and {other} are both given");
    Err(Refusal::new(Code::InvalidField, text).at(format!("options.{other}")))
}

/// The session that replaces the rover's file, if one is named.
fn session(
    caller: &Caller,
    message: &v1::JobOptions,
    has_base: bool,
) -> Result<Option<SessionSource>, Refusal> {
    let v1::JobOptions { session, from, to, .. } = message;
    if session.is_empty() {
        let given = [("from", from.is_some()), ("to", to.is_some())];
        return match given.into_iter().find(|(_, is_given)| *is_given) {
            None => Ok(None),
            Some((field, _)) => {
                let text = format!("{field} is for a session, and session is not given");
                Err(Refusal::new(Code::InvalidField, text).at(format!("options.{field}")))
            }
        };
    }
    caller.check_reader()?;
    let bases = bases(caller, message, has_base)?;
    let span = convert::span(*from, *to).map_err(|refusal| refusal.within("options"))?;
    Ok(Some(SessionSource {
        id: texts::brief(session).to_owned(),
        span_ns: (span.0.map(GpsTime::as_ns), span.1.map(GpsTime::as_ns)),
        bases,
    }))
}

/// The bases of the service whose stored epochs are used instead of the part `base`.
///
/// # Errors
/// There is no such base, or the request also has the part.
fn bases(
    caller: &Caller,
    message: &v1::JobOptions,
    has_base: bool,
) -> Result<BaseChoice<String>, Refusal> {
    let v1::JobOptions { base, bases, .. } = message;
    let bases = base_choice(caller, base, bases).map_err(|refusal| refusal.within("options"))?;
    if has_base && !bases.is_none() {
        return contradiction("the part base", "base");
    }
    if let BaseChoice::One(id) = &bases {
        let named = caller.bases().name(id);
        named.map_err(|error| Refusal::from(error).at("options.base"))?;
    }
    bases.try_map(|id| Ok(id.to_string()))
}

/// The options of a job as a message. Missing ones are those of its session.
pub(super) fn message(request: &JobRequest) -> v1::JobOptions {
    let JobRequest { options, session, .. } = request;
    let base_position = match options.base_position {
        BaseOrigin::Marker([x_m, y_m, z_m]) => Some(v1::Ecef { x_m, y_m, z_m }),
        BaseOrigin::Any | BaseOrigin::FromHeader => None,
    };
    let of_session = |name: fn(&SessionInput) -> &String| session.as_ref().map_or("", |s| name(s));
    let time = |ns: Option<i64>| ns.map(|ns| GpsTime::from_ns(ns).into());
    let source = options.session.as_ref();
    let (base, bases) = names(source.map_or(&options.bases, |source| &source.bases));
    v1::JobOptions {
        mode: or_standard(options.mode.clone(), of_session(|session| &session.mode)),
        profile: or_standard(options.profile.clone(), of_session(|session| &session.profile)),
        overrides: options.overrides.clone(),
        smoothed: options.answer == "smoothed",
        batch: options.answer == "batch",
        base_position,
        base_position_from_header: options.base_position == BaseOrigin::FromHeader,
        format: options.format.clone(),
        near: time(options.near_ns),
        session: source.map(|source| source.id.clone()).unwrap_or_default(),
        from: source.and_then(|source| time(source.span_ns.0)),
        to: source.and_then(|source| time(source.span_ns.1)),
        base,
        bases,
        urls: Vec::new(),
        uploads: Vec::new(),
        webhook: options.webhook.clone().map(|url| v1::JobWebhook { url, secret: String::new() }),
    }
}

/// The fields `base` and `bases` of a choice.
fn names(choice: &BaseChoice<String>) -> (String, Vec<String>) {
    match choice {
        BaseChoice::None => Default::default(),
        BaseChoice::One(id) => (id.clone(), Vec::new()),
        BaseChoice::NearestOf(ids) => (String::new(), ids.clone()),
        BaseChoice::Nearest => (NEAREST.to_owned(), Vec::new()),
    }
}
