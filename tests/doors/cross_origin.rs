//! Web pages of other hosts (CORS). A page may call only if the operator lists its origin for the
//! tenant of its key.

use std::collections::BTreeMap;

use axum::body::Body;
use axum::http::{HeaderMap, Request, StatusCode};
use serde_json::{Value, json};
use tower::ServiceExt;

use super::tenants::world::{Key, key_of, operator};
use crate::support::doors::{Doors, code};

const PAGE: &str = "https://fleet.acme.example";

/// Sends a request of a page. Returns status, header fields and JSON of the answer.
async fn from_page(
    doors: &Doors,
    (method, path): (&str, &str),
    fields: &[(&str, &str)],
) -> (StatusCode, HeaderMap, Value) {
    let mut request = Request::builder().method(method).uri(path).header("host", "localhost");
    for (name, value) in fields {
        request = request.header(*name, *value);
    }
    let response = doors.router.clone().oneshot(request.body(Body::empty()).unwrap()).await;
    let (parts, body) = response.unwrap().into_parts();
    let bytes = axum::body::to_bytes(body, usize::MAX).await.unwrap();
    (parts.status, parts.headers, serde_json::from_slice(&bytes).unwrap_or_default())
}

/// Lists sessions from a page of an origin, with a key.
async fn listed(doors: &Doors, origin: &str, key: &Key) -> (StatusCode, HeaderMap, Value) {
    let bearer = format!("Bearer {}", key.secret);
    let fields = [("origin", origin), ("authorization", bearer.as_str())];
    from_page(doors, ("GET", "/v1/sessions"), &fields).await
}

/// Asks whether a page of an origin may create a session, as browsers do.
async fn question(doors: &Doors, origin: &str) -> (StatusCode, HeaderMap) {
    let fields = [
        ("origin", origin),
        ("access-control-request-method", "POST"),
        ("access-control-request-headers", "authorization,content-type"),
    ];
    let (status, headers, _) = from_page(doors, ("OPTIONS", "/v1/sessions"), &fields).await;
    (status, headers)
}

fn field<'a>(headers: &'a HeaderMap, name: &str) -> &'a str {
    headers.get(name).map_or("", |value| value.to_str().unwrap())
}

const ALLOWED: &str = "access-control-allow-origin";

#[tokio::test]
async fn without_a_list_no_other_page_may_call() {
    let doors = Doors::open().await;
    let operator = operator(&doors).await;
    let (status, headers, problem) = listed(&doors, PAGE, &operator).await;
    assert_eq!((status, code(&problem)), (StatusCode::FORBIDDEN, "ORIGIN_REFUSED"));
    assert_eq!((field(&headers, ALLOWED), field(&headers, "vary")), ("", ""));
    let (status, headers) = question(&doors, PAGE).await;
    assert_eq!((status, field(&headers, ALLOWED)), (StatusCode::FORBIDDEN, ""));
}

#[tokio::test]
async fn a_listed_page_may_call_with_a_key_of_its_tenant() {
    let origins = |text: &str| vec![text.to_owned()];
    let lists = BTreeMap::from([
        ("acme".to_owned(), origins(PAGE)),
        ("other".to_owned(), origins("https://other.example:8443")),
    ]);
    let doors = Doors::with_cors(lists).await;
    let operator = operator(&doors).await;
    let acme = key_of(&doors, &operator, "acme", "").await;
    let other = key_of(&doors, &operator, "other", "").await;

    let (status, headers, sessions) = listed(&doors, PAGE, &acme).await;
    assert_eq!(status, StatusCode::OK, "{sessions}");
    assert_eq!(field(&headers, ALLOWED), PAGE);
    assert!(field(&headers, "access-control-expose-headers").contains("retry-after"));
    assert_eq!(field(&headers, "access-control-allow-credentials"), "");
    assert!(headers.get_all("vary").iter().any(|value| value == "origin"));

    // A page can read the reason of a refusal, and gets no data of another tenant.
    for key in [&other, &operator] {
        let (status, headers, problem) = listed(&doors, PAGE, key).await;
        assert_eq!((status, code(&problem)), (StatusCode::FORBIDDEN, "ORIGIN_REFUSED"));
        assert_eq!(field(&headers, ALLOWED), PAGE);
    }
    let none = Key { id: String::new(), secret: "no-key".to_owned() };
    let (status, headers, _) = listed(&doors, PAGE, &none).await;
    assert_eq!((status, field(&headers, ALLOWED)), (StatusCode::UNAUTHORIZED, PAGE));

    // An origin is a scheme, a host and a port.
    for origin in ["http://fleet.acme.example", "https://fleet.acme.example:8443", "null"] {
        let (status, headers, problem) = listed(&doors, origin, &acme).await;
        assert_eq!((status, code(&problem)), (StatusCode::FORBIDDEN, "ORIGIN_REFUSED"), "{origin}");
        assert_eq!(field(&headers, ALLOWED), "", "{origin}");
    }
    // Clients that are not web pages need no origin.
    assert_eq!(
        super::tenants::world::asked(&doors, &other, "GET", "/v1/sessions", Value::Null).await.0,
        StatusCode::OK
    );

    let (status, headers) = question(&doors, PAGE).await;
    assert_eq!((status, field(&headers, ALLOWED)), (StatusCode::NO_CONTENT, PAGE));
    assert!(field(&headers, "access-control-allow-methods").contains("POST"));
    assert!(field(&headers, "access-control-allow-headers").contains("authorization"));
    let (status, headers) = question(&doors, "https://elsewhere.example").await;
    assert_eq!((status, field(&headers, ALLOWED)), (StatusCode::FORBIDDEN, ""));
    // Without the header `access-control-request-method` this is the question of a client of
    // uploads, not of a browser.
    let (status, headers, _) =
        from_page(&doors, ("OPTIONS", "/v1/uploads"), &[("origin", PAGE)]).await;
    assert_eq!((status, field(&headers, ALLOWED)), (StatusCode::NO_CONTENT, PAGE));
    assert_eq!(field(&headers, "tus-version"), "1.0.0");
}

#[tokio::test]
async fn a_name_that_leads_here_is_refused_for_listed_pages_too() {
    let lists = BTreeMap::from([("acme".to_owned(), vec![PAGE.to_owned()])]);
    let doors = Doors::with_cors(lists).await;
    let request = Request::get("/v1/sessions").header("host", "rebound.example");
    let (status, problem) =
        doors.ask(request.header("origin", PAGE).body(Body::empty()).unwrap()).await;
    assert_eq!((status, problem["code"].clone()), (StatusCode::FORBIDDEN, json!("HOST_REFUSED")));
}
