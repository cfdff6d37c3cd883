//! Requests that another node of the cluster answers. They are forwarded once; bodies and answers
//! are passed on as they arrive.
//!
//! The first node has checked host and key. Its secret proves that it is a node, and the second
//! node trusts its checks. A forwarded request is never forwarded again. If the second node ends,
//! or the first one stops, the answer ends with a status that makes clients try again.

mod answer;
mod peers;

use axum::body::Body;
use axum::extract::Request;
use axum::http::{HeaderMap, HeaderName, HeaderValue, Version, header, uri};
use axum::response::Response;

use crate::contract::access::{Call, Pass};
use crate::contract::nodes::OtherNode;
use crate::contract::{Refusal, Service};
use crate::refusal::Code;

use answer::Forwarded;
pub(super) use peers::Peers;

/// Header with the id of the session that a request is for. Balancers use it for hashing, too.
pub(super) const SESSION: HeaderName = HeaderName::from_static("x-graphfix-session");
/// Header of a forwarded request: fence and secret of the node that has forwarded it.
const FROM: HeaderName = HeaderName::from_static("x-graphfix-from");
/// Header of a forwarded request: id of the sender's key; empty if no key was needed.
const KEY: HeaderName = HeaderName::from_static("x-graphfix-key");
/// Headers that belong to one connection (RFC 9110, section 7.6.1), and are not forwarded.
const OF_CONNECTION: [HeaderName; 6] = [
    header::CONNECTION,
    header::EXPECT,
    header::TRANSFER_ENCODING,
    header::UPGRADE,
    HeaderName::from_static("keep-alive"),
    HeaderName::from_static("proxy-connection"),
];

/// Whether another node has forwarded a request.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Mark {
    /// A client has sent it.
    None,
    /// It claims to be forwarded, but not by a known node. It is checked like a client's request.
    Unknown,
    /// A live node has checked and forwarded it; the text is the id of the key.
    Node(String),
}

impl Mark {
    /// The id of the key of a request that another node has checked.
    pub(super) fn key(&self) -> Option<&str> {
        match self {
            Self::Node(key) => Some(key),
            Self::None | Self::Unknown => None,
        }
    }
}

/// The mark of a request.
pub(super) fn mark(service: &Service, headers: &HeaderMap) -> Mark {
    let Some(from) = headers.get(FROM) else { return Mark::None };
    let parts = from.to_str().ok().and_then(|from| from.split_once('.'));
    let known = parts.and_then(|(fence, secret)| Some((fence.parse().ok()?, secret)));
    match (known, headers.get(KEY).and_then(|key| key.to_str().ok())) {
        (Some((fence, secret)), Some(key)) if service.is_of_node(fence, secret) => {
            Mark::Node(key.to_owned())
        }
        _ => Mark::Unknown,
    }
}

/// The node that answers a request.
pub(super) enum Route {
    /// This node.
    Here(Request),
    /// Another node, which has answered.
    Answered(Response),
}

/// The other node that a request is for, if there is one. `session` is the id in the request.
///
/// # Errors
/// The database fails, there is no leader, or the request was already forwarded.
async fn other(
    service: &Service,
    call: &Call,
    (mark, pass): (&Mark, Option<&Pass>),
    session: Option<&str>,
) -> Result<Option<OtherNode>, Refusal> {
    match (service.node_for(call, session).await?, mark) {
        (Some(node), Mark::None) => Ok(Some(node)),
        (Some(node), _) => {
            let message = format!("the call is for node {}, and was sent on already", node.name);
            Err(Refusal::new(Code::SessionElsewhere, message))
        }
        (None, Mark::Node(_)) if service.give_up(call, session, pass).await? => {
            let message = "the session moves to the node at which its requests arrive";
            Err(Refusal::new(Code::SessionElsewhere, message))
        }
        (None, _) => Ok(None),
    }
}

/// The id of the session that a request names, in its path or otherwise in its header.
fn session(request: &Request) -> Option<String> {
    let of_path = request.uri().path().strip_prefix("/v1/sessions/");
    let of_path = of_path.map(|rest| rest.split(['/', ':']).next().unwrap_or(rest));
    let of_header = || request.headers().get(SESSION)?.to_str().ok();
    of_path.or_else(of_header).map(ToOwned::to_owned)
}

impl Peers {
    /// Forwards a request if another node answers it.
    ///
    /// # Errors
    /// The database fails, there is no leader, the other node cannot be reached, or the request was
    /// already forwarded.
    pub(super) async fn route(
        &self,
        service: &Service,
        call: &Call,
        (mark, pass): (&Mark, Option<&Pass>),
        (request, is_grpc): (Request, bool),
    ) -> Result<Route, Refusal> {
        if service.nodes().is_none() {
            return Ok(Route::Here(request));
        }
        let session = session(&request);
        // Boxed, so that a service without a cluster needs no memory for it.
        let other = Box::pin(other(service, call, (mark, pass), session.as_deref()));
        match other.await? {
            None => Ok(Route::Here(request)),
            Some(node) => Box::pin(self.answer(service, &node, (request, is_grpc), pass))
                .await
                .map(Route::Answered),
        }
    }

    /// Forwards a request to another node, and returns its answer.
    ///
    /// # Errors
    /// The node cannot be reached.
    async fn answer(
        &self,
        service: &Service,
        node: &OtherNode,
        (request, is_grpc): (Request, bool),
        pass: Option<&Pass>,
    ) -> Result<Response, Refusal> {
        let request = marked(service, request, pass)?;
        let (response, permit) = self.send(node, request).await?;
        let (mut parts, body) = response.into_parts();
        parts.version = Version::HTTP_11; // The server sets its own.
        parts.extensions.clear();
        let ended = self.ended(node.fence);
        let stopping = service.drained();
        let body = Forwarded::new(body, permit, is_grpc, (ended, stopping));
        Ok(Response::from_parts(parts, Body::new(body)))
    }
}

/// The request with the headers for the other node.
fn marked(service: &Service, request: Request, pass: Option<&Pass>) -> Result<Request, Refusal> {
    let (mut parts, body) = request.into_parts();
    let host = parts.headers.remove(header::HOST);
    OF_CONNECTION.iter().for_each(|name| drop(parts.headers.remove(name)));
    if !is_trailers(parts.headers.get(header::TE)) {
        parts.headers.remove(header::TE);
    }
    let invalid = || Refusal::new(Code::Internal, "the request cannot be sent on");
    let own = service.nodes().and_then(|nodes| nodes.cluster.own()).ok_or_else(invalid)?;
    let from = HeaderValue::from_str(&format!("{}.{}", own.fence, own.secret));
    parts.headers.insert(FROM, from.map_err(|_| invalid())?);
    let key = HeaderValue::from_str(pass.and_then(Pass::key).unwrap_or_default());
    parts.headers.insert(KEY, key.map_err(|_| invalid())?);
    let named = host.and_then(|host| host.to_str().ok()?.parse::<uri::Authority>().ok());
    let authority = parts.uri.authority().cloned().or(named);
    let mut target = parts.uri.into_parts();
    target.scheme = Some(uri::Scheme::HTTP);
    target.authority = authority.or_else(|| "localhost".parse().ok());
    parts.uri = target.try_into().map_err(|_| invalid())?;
    parts.version = Version::HTTP_2;
    parts.extensions.clear();
    Ok(Request::from_parts(parts, body))
}

fn is_trailers(value: Option<&HeaderValue>) -> bool {
    value.is_some_and(|value| value.as_bytes() == b"trailers")
}
