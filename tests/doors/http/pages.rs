//! Health, the schema and the pages.

use std::io::Read;

use axum::body::Body;
use axum::http::{Request, StatusCode};
use graphfix::formats::decompress;
use tower::ServiceExt;

use crate::support::doors::Doors;
use crate::support::snapshot;

#[tokio::test]
async fn readiness_ends_when_the_service_drains() {
    let doors = Doors::open().await;
    assert_eq!(doors.get("/readyz").await.0, StatusCode::OK);
    doors.service.drain();
    assert_eq!(doors.get("/readyz").await.0, StatusCode::SERVICE_UNAVAILABLE);
    assert_eq!(doors.get("/healthz").await.0, StatusCode::OK);
}

#[tokio::test]
async fn the_page_of_the_schema_comes_from_the_binary() {
    let doors = Doors::open().await;
    for path in ["/", "/docs/", "/docs/swagger-ui-bundle.js"] {
        let request = Request::get(path).body(Body::empty()).unwrap();
        let response = doors.router.clone().oneshot(request).await.unwrap();
        assert_eq!(response.status(), StatusCode::OK, "{path}");
        let is_packed = response.headers().get("content-encoding").is_some_and(|it| it == "gzip");
        assert_eq!(is_packed, path != "/", "{path}");
        let body = axum::body::to_bytes(response.into_body(), usize::MAX).await.unwrap();
        let mut page = String::new();
        decompress(&*body).read_to_string(&mut page).unwrap();
        assert!(page.to_lowercase().contains("swagger") || path == "/", "{path}");
        assert!(
            path.ends_with(".js") || !page.contains("src=\"http"),
            "{path} loads from elsewhere"
        );
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
            let request = request.uri(path.replace("{session}", "ses_0"));
            let (_, answer) = doors.ask(request.body(Body::empty()).unwrap()).await;
            let code = answer["code"].as_str().unwrap_or_default();
            let absent = ["ROUTE_NOT_FOUND", "METHOD_NOT_ALLOWED"].contains(&code);
            assert!(!absent, "{method} {path}: {code}");
        }
    }
    let text = serde_json::to_string_pretty(&snapshot::sorted(&document)).unwrap();
    snapshot::assert("openapi.json", &format!("{text}\n"));
}
