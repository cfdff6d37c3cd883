//! `/v1/sign-in`: a browser exchanges a key for a cookie.
//!
//! Scripts cannot read the cookie (`HttpOnly`), and browsers send it only from this service's own
//! pages (`SameSite=Strict`). A change also needs a token, which a page reads here.

use axum::extract::State;
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode, header};
use axum::{Extension, Json};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::contract::{Service, SignedIn};

use super::conditions::Location;
use super::connection::Peer;
use super::problem::Refused;

/// Path of the sign-in of the browser that sends the request.
const PATH: &str = "/v1/sign-in";
/// Time for which a browser keeps the cookie (s). The service ends a sign-in by itself.
const LIFETIME_S: u32 = 12 * 3600;
/// Name of the cookie.
pub(super) const COOKIE: &str = "graphfix_sign_in";
/// Header with the token that a change needs if a cookie is sent instead of a key.
pub(super) const CSRF: HeaderName = HeaderName::from_static("x-graphfix-csrf");
/// Header in which a proxy states the protocol between the browser and itself.
const FORWARDED_PROTO: &str = "x-forwarded-proto";

/// The header of an answer that contains a secret.
pub(super) type NoStore = [(HeaderName, HeaderValue); 1];

/// Browsers and proxies must not store an answer that contains a secret.
pub(super) const NO_STORE: (HeaderName, HeaderValue) =
    (header::CACHE_CONTROL, HeaderValue::from_static("no-store"));

/// Whether a browser is signed in, and whether it needs to be.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "camelCase")]
pub(super) struct SignInState {
    /// Whether calls need a key.
    pub needed: bool,
    /// Id of the key that the browser signed in with; absent if it is not signed in.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub key: Option<String>,
    /// Rights of that key.
    pub rights: Vec<String>,
    /// Comes as `x-graphfix-csrf` with each change that is made by the cookie.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub csrf_token: Option<String>,
    /// When the sign-in ends, RFC 3339, unless its key ends before.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub expires_utc: Option<String>,
}

/// Headers of an answer that sets the cookie.
type SetCookie = [(HeaderName, HeaderValue); 2];

/// Tells whether this browser is signed in.
#[utoipa::path(get, operation_id = "signInGet", path = "/v1/sign-in", tag = "Sign-in",
    responses((status = 200, description = "Whether the browser is signed in",
        body = SignInState), Refused))]
pub(super) async fn get(
    State(service): State<Service>,
    headers: HeaderMap,
) -> (NoStore, Json<SignInState>) {
    let signed_in = cookie(&headers).and_then(|cookie| service.signed_in(cookie));
    ([NO_STORE], Json(state(&service, signed_in)))
}

/// Exchanges the key of this request (`authorization: Bearer`) for a cookie, which lasts twelve
/// hours, or as long as the key.
#[utoipa::path(post, operation_id = "signInCreate", path = "/v1/sign-in", tag = "Sign-in",
    responses((status = 201, description = "The sign-in, with its cookie", body = SignInState,
        headers(("Location" = String, description = "Path of the sign-in"))), Refused))]
pub(super) async fn create(
    State(service): State<Service>,
    headers: HeaderMap,
    peer: Option<Extension<Peer>>,
) -> Result<(StatusCode, Location, SetCookie, Json<SignInState>), Refused> {
    let has_key = headers.contains_key(header::AUTHORIZATION);
    let (cookie, signed_in) = service.sign_in(has_key).await?.unzip();
    let set = set_cookie(has_tls(&headers, peer.as_deref()), cookie.as_deref());
    let place = [(header::LOCATION, PATH.to_owned())];
    Ok((StatusCode::CREATED, place, set, Json(state(&service, signed_in))))
}

/// Signs out: the cookie is worth nothing from now on.
#[utoipa::path(delete, operation_id = "signInDelete", path = "/v1/sign-in", tag = "Sign-in",
    responses((status = 200, description = "The browser is signed out",
        body = SignInState), Refused))]
pub(super) async fn delete(
    State(service): State<Service>,
    headers: HeaderMap,
    peer: Option<Extension<Peer>>,
) -> Result<(SetCookie, Json<SignInState>), Refused> {
    if let Some(cookie) = cookie(&headers) {
        service.sign_out(cookie).await?;
    }
    let set = set_cookie(has_tls(&headers, peer.as_deref()), None);
    Ok((set, Json(state(&service, None))))
}

fn state(service: &Service, signed_in: Option<SignedIn>) -> SignInState {
    let needed = service.keys().are_needed();
    match signed_in {
        Some(SignedIn { key, rights, csrf_token, expires_utc }) => SignInState {
            needed,
            key: Some(key),
            rights,
            csrf_token: Some(csrf_token),
            expires_utc: Some(expires_utc),
        },
        None => {
            let (rights, csrf_token, expires_utc) = (Vec::new(), None, None);
            SignInState { needed, key: None, rights, csrf_token, expires_utc }
        }
    }
}

/// The value of the cookie of a request.
pub(super) fn cookie(headers: &HeaderMap) -> Option<&str> {
    let values = headers.get_all(header::COOKIE).iter();
    let pairs = values.filter_map(|value| value.to_str().ok()).flat_map(|text| text.split(';'));
    let mut named = pairs.filter_map(|pair| pair.trim().split_once('='));
    named.find(|(name, _)| *name == COOKIE).map(|(_, value)| value)
}

/// Whether the browser uses TLS, to this service or to a proxy that states it.
fn has_tls(headers: &HeaderMap, peer: Option<&Peer>) -> bool {
    let by_proxy = headers.get(FORWARDED_PROTO).is_some_and(|proto| proto.as_bytes() == b"https");
    by_proxy || peer.is_some_and(|peer| peer.is_encrypted)
}

/// Sets the cookie, or removes it. Browsers and proxies must not store the answer. If the browser
/// uses TLS, it must never send the cookie without TLS.
fn set_cookie(has_tls: bool, cookie: Option<&str>) -> SetCookie {
    let (value, lifetime_s) = cookie.map_or(("", 0), |cookie| (cookie, LIFETIME_S));
    let secure = if has_tls { "; Secure" } else { "" };
    let text = format!(
        "{COOKIE}={value}; Path=/; HttpOnly; SameSite=Strict; Max-Age={lifetime_s}{secure}"
    );
    let cookie = HeaderValue::from_str(&text).expect("a secret is hexadecimal digits");
    [(header::SET_COOKIE, cookie), NO_STORE]
}
