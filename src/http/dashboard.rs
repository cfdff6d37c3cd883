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

use crate::contract::Tiles;

use super::pages;

/// Path and content of each file.
const FILES: &[(&str, &[u8])] = include!(concat!(env!("OUT_DIR"), "/dashboard.rs"));

/// The page, which loads the other files.
const PAGE: &str = "/index.html";
/// The part of the page with the address of map tiles: none.
const NO_TILES: &str = "<meta name=\"graphfix-tiles\" content=\"\">";
/// The part of the page that says whether results may be Parquet.
const NO_PARQUET: &str = "<meta name=\"graphfix-parquet\" content=\"\">";
const PARQUET: &str = "<meta name=\"graphfix-parquet\" content=\"yes\">";

/// Caching of a file whose name has the hash of its content: the content never changes.
const FOR_EVER: &str = "public, max-age=31536000, immutable";
/// Caching of the page, which names the files of this version.
const ASK_AGAIN: &str = "no-cache";

/// The files with their gzip form, which is made at the first request.
#[derive(Clone)]
struct Files {
    packed: Arc<[OnceLock<Bytes>]>,
    /// The page with the options of the dashboard.
    page: Bytes,
    policy: HeaderValue,
}

/// The routes of the dashboard.
pub(super) fn routes(tiles: Option<&Tiles>) -> Router {
    let page = FILES.iter().find(|(path, _)| *path == PAGE).map_or(&[][..], |(_, page)| *page);
    let files = Files {
        packed: FILES.iter().map(|_| OnceLock::new()).collect(),
        page: with_options(page, tiles, cfg!(feature = "parquet")),
        policy: policy(tiles),
    };
    Router::new()
        .route("/", get(page_of))
        .route("/licences.txt", get(licences))
        .route("/assets/{file}", get(asset))
        .with_state(files)
}

/// The page with the address of the tiles, if there are any, and whether results may be Parquet.
fn with_options(page: &[u8], tiles: Option<&Tiles>, has_parquet: bool) -> Bytes {
    let mut page = String::from_utf8_lossy(page).into_owned();
    if has_parquet {
        page = page.replace(NO_PARQUET, PARQUET);
    }
    if let Some(Tiles { template, attribution, .. }) = tiles {
        let (template, attribution) = (escaped(template), escaped(attribution));
        let name = "<meta name=\"graphfix-tiles\"";
        let meta = format!("{name} content=\"{template}\" data-attribution=\"{attribution}\">");
        page = page.replace(NO_TILES, &meta);
    }
    page.into()
}

/// A text as the value of an attribute.
fn escaped(text: &str) -> String {
    let escaped = text.replace('&', "&amp;").replace('"', "&quot;");
    escaped.replace('<', "&lt;").replace('>', "&gt;")
}

/// `Content-Security-Policy` of the dashboard: its own files and calls, nothing inline, and
/// pictures from the host of the tiles, if there is one.
fn policy(tiles: Option<&Tiles>) -> HeaderValue {
    let tiles = tiles.map(|tiles| format!(" {}", tiles.origin)).unwrap_or_default();
    let policy = format!(
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'{tiles}; \
         connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    );
    policy.try_into().expect("the configuration has checked the host")
}

/// `GET /`: the page, which loads the other files.
async fn page_of(State(files): State<Files>, headers: HeaderMap) -> Response {
    files.answer(PAGE, &headers).unwrap_or_default()
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
        let content = match path {
            PAGE => self.page.clone(),
            _ => Bytes::from_static(FILES[index].1),
        };
        let is_packed = accepts_gzip(asked);
        let body = match is_packed {
            true => self.packed[index].get_or_init(|| packed(&content)).clone(),
            false => content,
        };
        let mut response = Body::from(body).into_response();
        let headers = response.headers_mut();
        let caching = if path.starts_with("/assets/") { FOR_EVER } else { ASK_AGAIN };
        headers.insert(header::CONTENT_TYPE, HeaderValue::from_static(kind(path)));
        headers.insert(header::CACHE_CONTROL, HeaderValue::from_static(caching));
        headers.insert(header::CONTENT_SECURITY_POLICY, self.policy.clone());
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_page_knows_whether_results_may_be_parquet() {
        let (_, page) = FILES.iter().find(|(path, _)| *path == PAGE).unwrap();
        assert!(String::from_utf8_lossy(page).contains(NO_PARQUET), "the page has lost its mark");
        let shown = with_options(page, None, true);
        assert!(String::from_utf8_lossy(&shown).contains(PARQUET));
    }

    #[test]
    fn tiles_open_the_policy_for_their_host_alone() {
        let (_, page) = FILES.iter().find(|(path, _)| *path == PAGE).unwrap();
        assert_eq!(with_options(page, None, false), *page);
        assert!(policy(None).to_str().unwrap().contains("img-src 'self'; "));
        let tiles = Tiles {
            template: "https://tiles.example:8443/{z}/{x}/{y}.png?a=1&b=2".to_owned(),
            origin: "https://tiles.example:8443".to_owned(),
            attribution: "© \"A\" <B>".to_owned(),
        };
        let shown = String::from_utf8(with_options(page, Some(&tiles), false).to_vec()).unwrap();
        assert!(shown.contains("/{z}/{x}/{y}.png?a=1&amp;b=2\""), "{shown}");
        assert!(shown.contains("\"© &quot;A&quot; &lt;B&gt;\""), "{shown}");
        let policy = policy(Some(&tiles));
        let policy = policy.to_str().unwrap();
        assert!(policy.contains("img-src 'self' https://tiles.example:8443; connect"), "{policy}");
    }
}
