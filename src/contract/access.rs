//! The right that each call needs: one table for both doors.
//!
//! A door serves only calls in this table, so no call is without an entry. It looks a request up by
//! its method and path before it reads any other part of the request.

use std::net::IpAddr;

pub(crate) use crate::keys::{CsrfToken, Pass};
use crate::keys::{Right, Rights};
use crate::refusal::Code;

use super::{Refusal, Service};

/// The credential that a call needs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Need {
    /// None: health, and content that is the same in every service of this version.
    Nothing,
    /// A key, whatever its rights.
    Key,
    /// A key with one of these rights.
    OneOf(Rights),
    /// A key of the operator with one of these rights, for data of all tenants together.
    OfOperator(Rights),
}

/// A call, or a page of the dashboard.
#[derive(Clone, Copy, Debug)]
pub struct Call {
    /// Its path on gRPC without the package of this service. If the package is another one, the
    /// path has it, and `/` at the front. Empty if only REST has the call.
    pub grpc: &'static str,
    /// Its method and path on REST; empty if only gRPC has the call.
    pub rest: &'static str,
    /// The credential that it needs.
    pub need: Need,
    /// Its name in the audit log, if it is an administrative act.
    pub act: Option<&'static str>,
}

impl Call {
    const fn new(grpc: &'static str, rest: &'static str, need: Need) -> Self {
        Self { grpc, rest, need, act: None }
    }

    /// The same call as an administrative act with this name.
    const fn act(self, act: &'static str) -> Self {
        Self { act: Some(act), ..self }
    }
}

const fn call(grpc: &'static str, rest: &'static str, rights: &[Right]) -> Call {
    Call::new(grpc, rest, Need::OneOf(Rights::of(rights)))
}

const fn page(rest: &'static str) -> Call {
    Call::new("", rest, Need::Nothing)
}

use Right::{Admin, Device, Operate, Read};

/// Every call and page of both doors.
pub const CALLS: &[Call] = &[
    call("Sessions/Create", "POST /v1/sessions", &[Device, Operate]),
    call("Sessions/Get", "GET /v1/sessions/{session}", &[Device, Read]),
    call("Sessions/List", "GET /v1/sessions", &[Read]),
    call("Sessions/Heads", "GET /v1/sessions:heads", &[Read]),
    call("Sessions/WatchHeads", "GET /v1/sessions:watch", &[Read]),
    call("Sessions/Update", "PATCH /v1/sessions/{session}", &[Operate]).act("Sessions.Update"),
    call("Sessions/Reset", "POST /v1/sessions/{session}:reset", &[Device, Operate])
        .act("Sessions.Reset"),
    call("Sessions/Close", "DELETE /v1/sessions/{session}", &[Operate]).act("Sessions.Close"),
    call("Sessions/Delete", "DELETE /v1/sessions/{session}?purge=true", &[Operate])
        .act("Sessions.Delete"),
    call("Sessions/Observations", "GET /v1/sessions/{session}/observations.rnx", &[Read]),
    call("Positioning/PushEpochs", "POST /v1/sessions/{session}/epochs", &[Device]),
    call("Positioning/PushRaw", "POST /v1/sessions/{session}/raw", &[Device]),
    call("Positioning/Stream", "", &[Device]),
    call("Positioning/StreamRaw", "", &[Device]),
    call("Positioning/Solve", "POST /v1/sessions/{session}:solve", &[Device, Read]),
    call("Positioning/SolveOnce", "POST /v1/solve", &[Device, Read]),
    call("Solutions/List", "GET /v1/sessions/{session}/solutions", &[Read]),
    call("Solutions/Watch", "GET /v1/sessions/{session}/solutions:watch", &[Read]),
    call("Solutions/Track", "GET /v1/sessions/{session}/track.{format}", &[Read]),
    call("Solutions/Series", "GET /v1/sessions/{session}/solutions:series", &[Read]),
    call("Solutions/Residuals", "GET /v1/sessions/{session}/solutions:residuals", &[Read]),
    call("Solutions/Explain", "GET /v1/sessions/{session}/epochs/{seq}", &[Read]),
    call("History/Fleet", "GET /v1/history/fleet", &[Read]),
    call("History/Sessions", "GET /v1/history/sessions", &[Read]),
    call("History/Session", "GET /v1/history/sessions/{session}", &[Read]),
    call("Navigation/Push", "POST /v1/navigation", &[Operate]).act("Navigation.Push"),
    call("Navigation/Status", "GET /v1/navigation", &[Read]),
    call("Bases/Create", "POST /v1/bases", &[Operate]).act("Bases.Create"),
    call("Bases/List", "GET /v1/bases", &[Read]),
    call("Bases/Get", "GET /v1/bases/{base}", &[Read]),
    call("Bases/Delete", "DELETE /v1/bases/{base}", &[Operate]).act("Bases.Delete"),
    call("Bases/PushEpochs", "POST /v1/bases/{base}/epochs", &[Operate]),
    call("Bases/Upload", "POST /v1/bases/{base}/observations", &[Operate]),
    call("Jobs/Create", "POST /v1/jobs", &[Operate]),
    call("Jobs/Get", "GET /v1/jobs/{job}", &[Read]),
    call("Jobs/Watch", "GET /v1/jobs/{job}/events", &[Read]),
    call("Jobs/List", "GET /v1/jobs", &[Read]),
    call("Jobs/Cancel", "DELETE /v1/jobs/{job}", &[Operate]),
    call("Jobs/Delete", "DELETE /v1/jobs/{job}?purge=true", &[Operate]).act("Jobs.Delete"),
    call("Jobs/Report", "GET /v1/jobs/{job}/report", &[Read]),
    call("Jobs/Result", "GET /v1/jobs/{job}/result", &[Read]),
    call("Jobs/Deliveries", "GET /v1/jobs/{job}/deliveries", &[Read]),
    call("/google.longrunning.Operations/GetOperation", "", &[Read]),
    call("/google.longrunning.Operations/ListOperations", "", &[Read]),
    call("/google.longrunning.Operations/WaitOperation", "", &[Read]),
    call("/google.longrunning.Operations/CancelOperation", "", &[Operate]),
    call("/google.longrunning.Operations/DeleteOperation", "", &[Operate])
        .act("Operations.DeleteOperation"),
    page("OPTIONS /v1/uploads"),
    call("", "POST /v1/uploads", &[Operate]),
    call("", "GET /v1/uploads/{upload}", &[Operate, Read]),
    call("", "PATCH /v1/uploads/{upload}", &[Operate]),
    call("", "DELETE /v1/uploads/{upload}", &[Operate]),
    call("Keys/Create", "POST /v1/keys", &[Admin]).act("Keys.Create"),
    call("Keys/List", "GET /v1/keys", &[Admin]),
    call("Keys/Get", "GET /v1/keys/{key}", &[Admin]),
    call("Keys/Revoke", "DELETE /v1/keys/{key}", &[Admin]).act("Keys.Revoke"),
    call("Tenants/Get", "GET /v1/tenants/{tenant}", &[Read, Admin]),
    call("Tenants/List", "GET /v1/tenants", &[Read, Admin]),
    Call::new("Tenants/Set", "PUT /v1/tenants/{tenant}", Need::OfOperator(Rights::of(&[Admin])))
        .act("Tenants.Set"),
    call("Audit/List", "GET /v1/audit", &[Admin]),
    page("GET /v1/sign-in"),
    Call::new("", "POST /v1/sign-in", Need::Key),
    Call::new("", "DELETE /v1/sign-in", Need::Key),
    Call::new("", "GET /metrics", Need::OfOperator(Rights::of(&[Read]))),
    page("GET /healthz"),
    page("GET /readyz"),
    page("GET /openapi.json"),
    page("GET /docs"),
    page("GET /docs/"),
    page("GET /docs/{file}"),
    page("GET /"),
    page("GET /licences.txt"),
    page("GET /assets/{file}"),
    Call::new("/grpc.health.v1.Health/Check", "", Need::Nothing),
    Call::new("/grpc.health.v1.Health/Watch", "", Need::Nothing),
    Call::new(REFLECTION, "", Need::Key),
    Call::new(REFLECTION_ALPHA, "", Need::Key),
];

const REFLECTION: &str = "/grpc.reflection.v1.ServerReflection/ServerReflectionInfo";
const REFLECTION_ALPHA: &str = "/grpc.reflection.v1alpha.ServerReflection/ServerReflectionInfo";
/// The package of this service on gRPC.
const PACKAGE: &str = "/graphfix.v1.";

/// The credential in a request.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Credential<'a> {
    /// Nothing.
    None,
    /// A key, or a text in its header that is not a key.
    Key(&'a str),
    /// The cookie of a browser that is signed in, and the token for changes.
    Cookie(&'a str, CsrfToken<'a>),
}

/// The call that a request is for.
#[derive(Clone, Debug)]
pub(crate) enum Target {
    /// This call.
    Call(&'static Call),
    /// The path has calls with these methods, but none with the method of the request.
    OtherMethod(Vec<&'static str>),
    /// No path of the table matches.
    Unknown,
}

/// The call of a request.
pub(crate) fn target(method: &str, path: &str) -> Target {
    if let Some(call) = CALLS.iter().find(|call| has_grpc_path(call, path)) {
        return Target::Call(call);
    }
    let asked = if method == "HEAD" { "GET" } else { method };
    let mut methods = Vec::new();
    for call in CALLS {
        let Some((method, template)) = call.rest.split_once(' ') else { continue };
        if !has_form(path, template) {
            continue;
        }
        if method == asked {
            return Target::Call(call);
        }
        methods.push(method);
    }
    methods.dedup();
    if methods.is_empty() { Target::Unknown } else { Target::OtherMethod(methods) }
}

/// Whether this is the path of a call on gRPC.
fn has_grpc_path(call: &Call, path: &str) -> bool {
    match call.grpc.starts_with('/') {
        true => call.grpc == path,
        false => !call.grpc.is_empty() && path.strip_prefix(PACKAGE) == Some(call.grpc),
    }
}

/// Whether a path, as sent, matches a template. A part in braces must not be empty.
fn has_form(path: &str, template: &str) -> bool {
    let template = template.split_once('?').map_or(template, |(path, _)| path);
    let (mut segments, mut forms) = (path.split('/'), template.split('/'));
    loop {
        let (segment, form) = match (segments.next(), forms.next()) {
            (None, None) => return true,
            (Some(segment), Some(form)) => (segment, form),
            _ => return false,
        };
        let parts = form
            .split_once('{')
            .and_then(|(before, name)| name.split_once('}').map(|(_, after)| (before, after)));
        let fits = match parts {
            Some((before, after)) => segment
                .strip_prefix(before)
                .and_then(|rest| rest.strip_suffix(after))
                .is_some_and(|value| !value.is_empty()),
            None => segment == form,
        };
        if !fits {
            return false;
        }
    }
}

impl Service {
    /// The sender of a request for this call with this credential; `None` if no key is needed.
    ///
    /// # Errors
    /// The credential is missing or not in force, or has none of the rights that the call needs.
    pub(crate) fn admit(
        &self,
        call: &Call,
        credential: Credential<'_>,
        peer: Option<IpAddr>,
    ) -> Result<Option<Pass>, Refusal> {
        let needed = match call.need {
            Need::Nothing => return Ok(None),
            Need::Key => Rights::ALL,
            Need::OneOf(rights) | Need::OfOperator(rights) => rights,
        };
        let pass = match credential {
            Credential::None => self.keys().admit(None, peer)?,
            Credential::Key(key) => self.keys().admit(Some(key), peer)?,
            Credential::Cookie(cookie, token) => self.keys().admit_cookie(cookie, token)?,
        };
        if !pass.rights().meets(needed) {
            let (id, has) = (pass.key().unwrap_or_default(), pass.rights());
            let needed = needed.names().join(" or ");
            let message = format!("the key {id} has {has}, and this call needs {needed}");
            return Err(Refusal::new(Code::RightMissing, message));
        }
        if matches!(call.need, Need::OfOperator(_)) && !pass.tenant().is_operator() {
            let message = "the call is for the operator, and the key is of another tenant";
            return Err(Refusal::new(Code::OperatorOnly, message));
        }
        Ok(Some(pass))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn found(method: &str, path: &str) -> &'static str {
        match target(method, path) {
            Target::Call(call) if call.grpc.is_empty() => call.rest,
            Target::Call(call) => call.grpc,
            Target::OtherMethod(_) => "other method",
            Target::Unknown => "unknown",
        }
    }

    #[test]
    fn a_request_is_found_by_its_method_and_path() {
        for (method, path, expected) in [
            ("POST", "/graphfix.v1.Sessions/Create", "Sessions/Create"),
            ("POST", "/v1/sessions", "Sessions/Create"),
            ("HEAD", "/v1/sessions/ses_1", "Sessions/Get"),
            ("POST", "/v1/sessions/ses_1:solve", "Positioning/Solve"),
            ("POST", "/v1/sessions/a:solve:reset", "Sessions/Reset"),
            ("GET", "/v1/sessions:heads", "Sessions/Heads"),
            ("GET", "/v1/sessions:watch", "Sessions/WatchHeads"),
            ("GET", "/v1/sessions/ses_1/solutions:watch", "Solutions/Watch"),
            ("GET", "/v1/sessions/ses_1/epochs/7", "Solutions/Explain"),
            ("GET", "/v1/sessions/ses_1/track.kml", "Solutions/Track"),
            ("GET", "/v1/sessions/ses_1/track.", "unknown"),
            ("GET", "/", "GET /"),
            ("GET", "/docs/", "GET /docs/"),
            ("GET", "/docs/a/b", "unknown"),
            ("POST", "/v1/sessions/ses_1", "other method"),
            ("POST", "/v1/sessions/ses_1%3Areset", "other method"),
            ("PUT", "/v1/sessions", "other method"),
            ("GET", "/v1/sessions/", "unknown"),
            ("GET", "//v1/sessions", "unknown"),
            ("POST", "/v1/sessions/:reset", "other method"),
            ("GET", "/v1/sessions/a/b", "unknown"),
            ("POST", "Sessions/Create", "unknown"),
            ("POST", "", "unknown"),
        ] {
            assert_eq!(found(method, path), expected, "{method} {path}");
        }
    }

    /// Calls with the same method and path need the same, because only the first of them is found.
    #[test]
    fn calls_of_one_path_need_the_same() {
        let path = |call: &Call| call.rest.split('?').next().unwrap_or_default().to_owned();
        for one in CALLS {
            for other in CALLS.iter().filter(|other| !path(other).is_empty()) {
                assert!(path(one) != path(other) || one.need == other.need, "{}", one.rest);
            }
        }
    }
}
