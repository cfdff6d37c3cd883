//! The dashboard: the files of `web/dist`, embedded in the program.

use std::io::Write;
use std::sync::{Arc, OnceLock};

use axum::Router;
use axum::body::{Body, Bytes};
use axum::extract::{Path, State};
use axum::http::{HeaderMap, HeaderValue, Uri, header};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use flate2::Compression;
use flate2::write::GzEncoder;

use super::pages;

/// Path and content of each file.
const FILES: &[(&str, &[u8])] = include!(concat!(env!("OUT_DIR"), "/dashboard.rs"));

/// `Content-Security-Policy` of the dashboard: its own files and calls, nothing inline.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; \
                      connect-src 'self'; base-uri 'none'; form-action 'none'; \
                      frame-ancestors 'none'";
/// A name with the hash of its content never has another content.
const FOR_EVER: &str = "public, max-age=31536000, immutable";
/// The page names the files of this version.
const ASK_AGAIN: &str = "no-cache";

/// The files with their gzip form, which is made when it is first asked for.
#[derive(Clone)]
struct Files(Arc<[OnceLock<Bytes>]>);

/// The routes of the dashboard.
pub(super) fn routes() -> Router {
    let files = Files(FILES.iter().map(|_| OnceLock::new()).collect());
    Router::new()
        .route("/", get(page))
        .route("/licences.txt", get(licences))
        .route("/assets/{file}", get(asset))
        .with_state(files)
}

/// `GET /`: the page, which loads the others.
async fn page(State(files): State<Files>, headers: HeaderMap) -> Response {
    files.answer("/index.html", &headers).unwrap_or_default()
}

/// `GET /licences.txt`: the licences of the libraries in the dashboard.
async fn licences(State(files): State<Files>, headers: HeaderMap) -> Response {
    files.answer("/licences.txt", &headers).unwrap_or_default()
}

/// `GET /assets/{file}`: a script, style sheet, picture or data file.
async fn asset(
    State(files): State<Files>,
    Path(file): Path<String>,
    uri: Uri,
    headers: HeaderMap,
) -> Response {
    match files.answer(&format!("/assets/{file}"), &headers) {
        Some(response) => response,
        None => pages::no_route(uri).await.into_response(),
    }
}

impl Files {
    /// The answer to a request for a file; `None` if there is no such file.
    fn answer(&self, path: &str, asked: &HeaderMap) -> Option<Response> {
        let index = FILES.iter().position(|(known, _)| *known == path)?;
        let (_, content) = FILES[index];
        let is_packed = accepts_gzip(asked);
        let body = match is_packed {
            true => self.0[index].get_or_init(|| packed(content)).clone(),
            false => Bytes::from_static(content),
        };
        let mut response = Body::from(body).into_response();
        let headers = response.headers_mut();
        let caching = if path.starts_with("/assets/") { FOR_EVER } else { ASK_AGAIN };
        headers.insert(header::CONTENT_TYPE, HeaderValue::from_static(kind(path)));
        headers.insert(header::CACHE_CONTROL, HeaderValue::from_static(caching));
        headers.insert(header::CONTENT_SECURITY_POLICY, HeaderValue::from_static(POLICY));
        headers.insert(header::REFERRER_POLICY, HeaderValue::from_static("no-referrer"));
        headers.insert(header::VARY, HeaderValue::from_static("accept-encoding"));
        if is_packed {
            headers.insert(header::CONTENT_ENCODING, HeaderValue::from_static("gzip"));
        }
        Some(response)
    }
}

fn accepts_gzip(headers: &HeaderMap) -> bool {
    let accepted = headers.get(header::ACCEPT_ENCODING).and_then(|value| value.to_str().ok());
    let mut codings = accepted.unwrap_or_default().split(',').map(str::trim);
    codings.any(|coding| coding == "gzip" || coding.starts_with("gzip;q=1"))
}

fn packed(content: &[u8]) -> Bytes {
    let mut packer = GzEncoder::new(Vec::new(), Compression::best());
    let packed = packer.write_all(content).and_then(|()| packer.finish());
    packed.expect("memory takes all bytes").into()
}

fn kind(path: &str) -> &'static str {
    match path.rsplit_once('.').map_or("", |(_, extension)| extension) {
        "html" => "text/html; charset=utf-8",
        "js" => "text/javascript; charset=utf-8",
        "css" => "text/css; charset=utf-8",
        "svg" => "image/svg+xml",
        "json" => "application/json",
        _ => "text/plain; charset=utf-8",
    }
}
