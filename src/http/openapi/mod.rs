//! The REST door as OpenAPI 3.1.

mod types;

use std::collections::BTreeSet;

use utoipa::OpenApi;
use utoipa::openapi::path::{Operation, Parameter, ParameterBuilder, ParameterIn, PathItem};
use utoipa::openapi::schema::{ObjectBuilder, Type};
use utoipa::openapi::security::{
    ApiKey, ApiKeyValue, HttpAuthScheme, HttpBuilder, SecurityRequirement, SecurityScheme,
};
use utoipa::openapi::{RefOr, Required};

use crate::contract::access::{CALLS, Call, Need};
use crate::contract::v1;

use super::forwarding::SESSION;
use super::problem::Problem;
use super::{
    audit, bases, head_events, history, job_events, job_report, jobs, keys, navigation,
    observations, positioning, raw, sessions, sign_in, solutions, tenants, track, uploads, watch,
};

/// Names of the security schemes.
const KEY: &str = "key";
const SIGN_IN: &str = "signIn";
const CSRF_TOKEN: &str = "csrfToken";

#[derive(OpenApi)]
#[openapi(
    components(schemas(Problem, v1::ResetSessionRequest)),
    info(
        title = "Graphfix",
        description = "GNSS positioning: raw observations in, stored positions out. Every call has \
                       its twin in the gRPC package graphfix.v1, on the same port. Times are \
                       GPS week and nanoseconds of week; refusals are RFC 9457 problem documents \
                       with a stable code.",
        license(name = "MIT OR Apache-2.0"),
    ),
    tags(
        (name = "Sessions", description = "A rover's sessions"),
        (name = "Positioning", description = "Epochs in, solutions out"),
        (name = "Solutions", description = "What was stored"),
        (name = "History", description = "What sessions have been doing for a day or a month"),
        (name = "Navigation", description = "Broadcast ephemerides, which every session uses"),
        (name = "Jobs", description = "Files in, a file of positions and a report out"),
        (name = "Bases", description = "Base stations, which sessions relative to one name"),
        (name = "Keys", description = "API keys: who may call what"),
        (name = "Tenants", description = "What each tenant may use, and what it uses"),
        (name = "Audit", description = "Who has administered the service, and who was refused"),
        (name = "Sign-in", description = "A cookie for a browser in place of a key"),
    ),
    paths(
        sessions::create,
        sessions::list,
        sessions::heads,
        head_events::events,
        sessions::get,
        sessions::update,
        sessions::reset,
        sessions::close,
        observations::observations,
        positioning::push_epochs,
        raw::push,
        positioning::solve,
        positioning::solve_once,
        solutions::list,
        solutions::series,
        solutions::residuals,
        history::fleet,
        history::sessions,
        history::session,
        watch::watch,
        solutions::explain,
        track::track,
        navigation::push,
        navigation::status,
        bases::create,
        bases::list,
        bases::get,
        bases::delete,
        bases::push_epochs,
        bases::upload,
        jobs::create,
        jobs::list,
        jobs::get,
        job_events::events,
        jobs::end,
        jobs::result,
        job_report::report,
        jobs::deliveries,
        uploads::options,
        uploads::create,
        uploads::get,
        uploads::append,
        uploads::remove,
        keys::create,
        keys::list,
        keys::get,
        keys::revoke,
        tenants::get,
        tenants::list,
        tenants::set,
        audit::list,
        sign_in::get,
        sign_in::create,
        sign_in::delete,
    )
)]
struct Rest;

/// The document at `/openapi.json`.
pub fn document() -> utoipa::openapi::OpenApi {
    let mut document = Rest::openapi();
    let components = document.components.get_or_insert_default();
    let named = |(name, scheme): (&str, SecurityScheme)| (name.to_owned(), RefOr::T(scheme));
    components.security_schemes.extend(schemes().map(named));
    types::add(&mut document);
    for (path, item) in &mut document.paths.paths {
        for (method, operation) in operations(item) {
            if path.starts_with("/v1/sessions/{session}") {
                operation.parameters.get_or_insert_default().push(session_header().into());
            }
            let parameters = operation.parameters.iter_mut().flatten();
            parameters.for_each(|parameter| types::add_to_parameter(path, parameter));
            let is_this = |call: &&Call| {
                let rest = call.rest.split('?').next().unwrap_or_default();
                rest.split_once(' ') == Some((method, path))
            };
            // A path that is not in the table is not served.
            if let Some(call) = CALLS.iter().find(is_this) {
                secure(operation, method, call.need);
            }
        }
    }
    document
}

/// The header that every call on a session may have. The service itself uses the id in the path.
fn session_header() -> Parameter {
    let description = "The session's id once more, by which a balancer before several nodes finds \
                       the session's node";
    ParameterBuilder::new()
        .name(SESSION.as_str())
        .parameter_in(ParameterIn::Header)
        .required(Required::False)
        .description(Some(description))
        .schema(Some(ObjectBuilder::new().schema_type(Type::String)))
        .build()
}

/// Methods and paths, in the form of the table of calls, of the calls without query parameters.
pub(super) fn without_query() -> BTreeSet<&'static str> {
    let mut paths = Rest::openapi().paths.paths;
    let mut known = BTreeSet::new();
    for (path, item) in &mut paths {
        for (method, operation) in operations(item) {
            if !has_query(operation) {
                let is_this = |call: &&Call| call.rest.split_once(' ') == Some((method, path));
                known.extend(CALLS.iter().filter(is_this).map(|call| call.rest));
            }
        }
    }
    known
}

fn has_query(operation: &Operation) -> bool {
    let is_of_query = |parameter: &RefOr<Parameter>| match parameter {
        RefOr::T(parameter) => parameter.parameter_in == ParameterIn::Query,
        RefOr::Ref(_) => true,
    };
    operation.parameters.iter().flatten().any(is_of_query)
}

/// The operations of a path with their methods.
fn operations(item: &mut PathItem) -> impl Iterator<Item = (&'static str, &mut Operation)> {
    let of_methods = [
        ("GET", &mut item.get),
        ("PUT", &mut item.put),
        ("POST", &mut item.post),
        ("PATCH", &mut item.patch),
        ("DELETE", &mut item.delete),
    ];
    of_methods.into_iter().filter_map(|(method, operation)| Some((method, operation.as_mut()?)))
}

/// The security schemes.
fn schemes() -> impl Iterator<Item = (&'static str, SecurityScheme)> {
    let key = HttpBuilder::new()
        .scheme(HttpAuthScheme::Bearer)
        .description(Some("An API key. A service that has no key yet takes calls without one."));
    let cookie = "The cookie of a browser that is signed in; see /v1/sign-in.";
    let token = "csrfToken of the sign-in, with each change that is made by its cookie.";
    let cookie = ApiKeyValue::with_description(super::sign_in::COOKIE, cookie);
    let token = ApiKeyValue::with_description(super::sign_in::CSRF.as_str(), token);
    [
        (KEY, SecurityScheme::Http(key.build())),
        (SIGN_IN, SecurityScheme::ApiKey(ApiKey::Cookie(cookie))),
        (CSRF_TOKEN, SecurityScheme::ApiKey(ApiKey::Header(token))),
    ]
    .into_iter()
}

/// Adds to an operation the key that it needs.
fn secure(operation: &mut Operation, method: &str, need: Need) {
    let rights = match need {
        Need::Nothing => {
            operation.security = Some(Vec::new());
            return;
        }
        Need::Key => "Needs a key.".to_owned(),
        Need::OneOf(rights) => format!("Needs the right {}.", rights.names().join(" or ")),
        Need::OfOperator(rights) => {
            format!("Needs the right {}, and is for the operator.", rights.names().join(" or "))
        }
    };
    let scopes = || std::iter::empty::<&str>();
    let mut sign_in = SecurityRequirement::new(SIGN_IN, scopes());
    if method != "GET" {
        sign_in = sign_in.add(CSRF_TOKEN, scopes());
    }
    operation.security = Some(vec![SecurityRequirement::new(KEY, scopes()), sign_in]);
    let before = operation.description.take().filter(|text| !text.is_empty());
    operation.description = Some(match before {
        Some(text) => format!("{text}\n\n{rights}"),
        None => rights,
    });
}
