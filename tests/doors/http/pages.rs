//! Health, the schema and the pages.

use std::io::Read;

use axum::body::Body;
use axum::http::{HeaderMap, Request, StatusCode};
use graphfix::formats::decompress;
use serde_json::{Value, json};
use tower::ServiceExt;

use crate::support::doors::{Doors, code};
use crate::support::snapshot;

#[tokio::test]
async fn readiness_ends_when_the_service_drains() {
    let doors = Doors::open().await;
    let (status, answer) = doors.get("/readyz").await;
    assert_eq!((status, answer.get("retryAfterMs")), (StatusCode::OK, None), "{answer}");
    doors.service.drain();
    let mut delays = Vec::new();
    for _ in 0..20 {
        let request = Request::get("/readyz").body(Body::empty()).unwrap();
        let response = doors.router.clone().oneshot(request).await.unwrap();
        assert_eq!(response.status(), StatusCode::SERVICE_UNAVAILABLE);
        assert_eq!(response.headers()["retry-after"], "1", "whole seconds");
        let body = axum::body::to_bytes(response.into_body(), usize::MAX).await.unwrap();
        let answer: Value = serde_json::from_slice(&body).unwrap();
        delays.push(answer["retryAfterMs"].as_u64().unwrap());
    }
    assert!(delays.iter().all(|ms| (500..=1000).contains(ms)), "{delays:?}");
    assert!(delays.iter().any(|ms| *ms != delays[0]), "clients do not return together");
    assert_eq!(doors.get("/healthz").await.0, StatusCode::OK);
}

#[tokio::test]
async fn the_page_of_the_schema_comes_from_the_binary() {
    let doors = Doors::open().await;
    for path in ["/docs/", "/docs/swagger-ui-bundle.js"] {
        let request = Request::get(path).body(Body::empty()).unwrap();
        let response = doors.router.clone().oneshot(request).await.unwrap();
        assert_eq!(response.status(), StatusCode::OK, "{path}");
        let is_packed = response.headers().get("content-encoding").is_some_and(|it| it == "gzip");
        assert!(is_packed, "{path}");
        let body = axum::body::to_bytes(response.into_body(), usize::MAX).await.unwrap();
        let mut page = String::new();
        decompress(&*body).read_to_string(&mut page).unwrap();
        assert!(page.to_lowercase().contains("swagger"), "{path}");
        assert!(
            path.ends_with(".js") || !page.contains("src=\"http"),
            "{path} loads from elsewhere"
        );
    }
}

/// Status, headers and content of a file of the dashboard.
async fn file(doors: &Doors, path: &str, accepted: &str) -> (StatusCode, HeaderMap, String) {
    let request = Request::get(path).header("accept-encoding", accepted);
    let request = request.body(Body::empty()).unwrap();
    let response = doors.router.clone().oneshot(request).await.unwrap();
    let (head, body) = response.into_parts();
    let body = axum::body::to_bytes(body, usize::MAX).await.unwrap();
    let mut text = String::new();
    decompress(&*body).read_to_string(&mut text).unwrap();
    (head.status, head.headers, text)
}

/// The page loads its own files only, by names that never change their content.
#[tokio::test]
async fn the_dashboard_comes_from_the_binary() {
    let doors = Doors::open().await;
    let (status, headers, page) = file(&doors, "/", "identity").await;
    assert_eq!((status, headers["cache-control"].to_str().unwrap()), (StatusCode::OK, "no-cache"));
    let policy = headers["content-security-policy"].to_str().unwrap();
    assert!(policy.contains("default-src 'none'") && !policy.contains("unsafe"), "{policy}");
    assert!(!page.contains("://"), "{page}");
    let links = page.split(['"', '\'']).filter(|part| part.starts_with("/assets/"));
    let links: Vec<&str> = links.collect();
    assert!(4 <= links.len(), "{page}");
    for path in links {
        let (status, headers, plain) = file(&doors, path, "identity").await;
        assert_eq!(status, StatusCode::OK, "{path}");
        assert!(headers["cache-control"].to_str().unwrap().contains("immutable"), "{path}");
        assert!(headers.get("content-encoding").is_none(), "{path}");
        let (_, headers, unpacked) = file(&doors, path, "br, gzip").await;
        assert_eq!(headers["content-encoding"].to_str().unwrap(), "gzip", "{path}");
        assert!(plain == unpacked, "{path}");
    }
    let (status, _, licences) = file(&doors, "/licences.txt", "gzip").await;
    assert_eq!(status, StatusCode::OK);
    assert!(licences.contains("preact") && licences.contains("uplot"), "{licences}");
    let (status, refused) = doors.get("/assets/app-0.js").await;
    assert_eq!((status, code(&refused)), (StatusCode::NOT_FOUND, "ROUTE_NOT_FOUND"));
}

/// The names of what has a type: the values of an enumeration, or a time.
fn choices(schema: &Value) -> Vec<&str> {
    let values = schema["enum"].as_array().into_iter().flatten();
    values.map(|value| value.as_str().unwrap()).collect()
}

/// Nothing that is a time or one of a few names is a mere text.
#[test]
fn the_schema_types_choices_and_times() {
    let document = serde_json::to_value(graphfix::http::document()).unwrap();
    let schemas = &document["components"]["schemas"];
    let property = |schema: &str, name: &str| &schemas[schema]["properties"][name];
    let statuses = ["NONE", "SINGLE", "FGO", "EKF", "FLOAT", "FIXED"];
    assert_eq!(choices(property("Solution", "status")), statuses);
    assert!(property("Solution", "status")["default"].is_null(), "an answer always has one");
    let of_head = choices(property("SessionHead", "status"));
    assert_eq!(of_head, [&statuses[..], &["UNSPECIFIED"]].concat());
    let states = ["QUEUED", "RUNNING", "SUCCEEDED", "FAILED", "CANCELLED"];
    assert_eq!(choices(property("Job", "state")), states);
    let deliveries = ["WAITING", "DELIVERED", "FAILED", ""];
    assert_eq!(choices(property("JobDeliveries", "state")), deliveries);
    assert_eq!(property("Solution", "timeUtc")["format"], "date-time");
    let expected = json!([{"format": "date-time"}, {"maxLength": 0}]);
    assert_eq!(property("Job", "endedUtc")["anyOf"], expected);
    assert_eq!(property("Job", "endedUtc")["type"], "string");

    for (name, schema) in schemas.as_object().unwrap() {
        for (property, schema) in schema["properties"].as_object().into_iter().flatten() {
            let name = format!("{name}.{property}");
            let is_text = schema["type"] == "string";
            if property.ends_with("Utc") {
                let is_time = |schema: &Value| schema["format"] == "date-time";
                let may_be_empty = schema["anyOf"].as_array().is_some_and(|any| is_time(&any[0]));
                assert!(is_time(schema) || may_be_empty, "{name}: {schema}");
            } else if is_text && ["tatus", "tate"].iter().any(|end| property.ends_with(end)) {
                assert!(!choices(schema).is_empty(), "{name}: {schema}");
            }
        }
    }
    for (path, methods) in document["paths"].as_object().unwrap() {
        for (method, operation) in methods.as_object().unwrap() {
            let parameters = operation["parameters"].as_array().into_iter().flatten();
            let named = |name: &str| parameters.clone().find(|p| p["name"] == name);
            for name in ["view", "order", "status", "state", "revisions"] {
                let typed = named(name).is_none_or(|p| 1 < choices(&p["schema"]).len());
                assert!(typed, "{method} {path}: {name}");
            }
            let is_on_session = path.starts_with("/v1/sessions/{session}");
            let header = named("x-graphfix-session");
            assert_eq!(header.is_some(), is_on_session, "{method} {path}");
            assert!(header.is_none_or(|header| header["required"] == false));
        }
    }
}

/// Every path of the document is routed, and the document is the reviewed one.
#[tokio::test]
async fn the_schema_is_a_snapshot_and_true() {
    let doors = Doors::open().await;
    let (_, document) = doors.get("/openapi.json").await;
    assert!(document["openapi"].as_str().unwrap().starts_with("3.1"));
    let mut ids = std::collections::BTreeSet::new();
    for (path, methods) in document["paths"].as_object().unwrap() {
        for (method, operation) in methods.as_object().unwrap() {
            let id = operation["operationId"].as_str().unwrap();
            assert!(ids.insert(id), "{id} twice");
            assert!(operation["responses"]["5XX"].is_object(), "{id} describes no failure");
            let request = Request::builder().method(method.to_uppercase().as_str());
            let request = request.uri(
                path.replace("{session}", "ses_0")
                    .replace("{seq}", "1")
                    .replace("{format}", "pos")
                    .replace("{job}", "job_0")
                    // Refused, as a watch has no end.
                    .replace("sessions:watch", "sessions:watch?closed=perhaps"),
            );
            let (_, answer) = doors.ask(request.body(Body::empty()).unwrap()).await;
            let code = answer["code"].as_str().unwrap_or_default();
            let absent = ["ROUTE_NOT_FOUND", "METHOD_NOT_ALLOWED"].contains(&code);
            assert!(!absent, "{method} {path}: {code}");
        }
    }
    let text = serde_json::to_string_pretty(&snapshot::sorted(&document)).unwrap();
    snapshot::assert("openapi.json", &format!("{text}\n"));
}
