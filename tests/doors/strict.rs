//! Fields and parameters that a call does not have are refused, and the refusal names them.

use std::io::Write;

use axum::body::Body;
use axum::http::{Request, StatusCode};
use flate2::Compression;
use flate2::write::GzEncoder;
use serde_json::{Value, json};
use tower::ServiceExt;

use super::jobs;
use crate::support::doors::{Doors, code, epoch};
use crate::support::jobs::{BOUNDARY, body};

/// Code and field of a refusal; the field is empty if it names none.
fn at_fault(refusal: &Value) -> (&str, &str) {
    (code(refusal), refusal["field"].as_str().unwrap_or_default())
}

/// The answer to a job with these options.
async fn job_with(doors: &Doors, options: &str) -> (StatusCode, Value) {
    jobs::post(doors, body(&[("options", options.as_bytes())]), &[]).await
}

/// A reset needs no body. If it has one, the body is checked as that of every other call.
#[tokio::test]
async fn a_reset_takes_its_own_message_or_nothing() {
    let doors = Doors::open().await;
    let session = doors.session().await;
    let path = format!("/v1/sessions/{session}:reset");
    let ask = async |kind: Option<&str>, body: String| {
        let request = Request::post(&path);
        let request = kind.into_iter().fold(request, |r, kind| r.header("content-type", kind));
        doors.ask(request.body(Body::from(body)).unwrap()).await
    };
    let own = json!({"session": session}).to_string();
    for (kind, body) in [
        (None, String::new()),
        (Some("text/plain"), String::new()),
        (Some("application/json"), "{}".to_owned()),
        (Some("application/json"), own),
    ] {
        let (status, answer) = ask(kind, body.clone()).await;
        assert_eq!((status, &answer["session"]), (StatusCode::OK, &json!(session)), "{body}");
    }
    for (kind, body, expected) in [
        (Some("text/plain"), "{}", ("UNSUPPORTED_MEDIA_TYPE", "")),
        (None, "{}", ("UNSUPPORTED_MEDIA_TYPE", "")),
        (Some("application/json"), r#"{"hard":true}"#, ("UNKNOWN_FIELD", "hard")),
        (Some("application/json"), r#"{"session":"ses_1"}"#, ("INVALID_FIELD", "session")),
        (Some("application/json"), "{", ("MALFORMED_BODY", "")),
    ] {
        let (_, refusal) = ask(kind, body.to_owned()).await;
        assert_eq!(at_fault(&refusal), expected, "{body}: {refusal}");
    }
}

/// Texts that Rust reads as `f64` are no time in a query if they are not finite or too large.
#[tokio::test]
async fn a_time_in_a_query_is_finite() {
    let doors = Doors::open().await;
    let path = format!("/v1/sessions/{}", doors.session().await);
    for list in
        [format!("{path}/solutions"), format!("{path}/track.csv"), "/v1/history/fleet".to_owned()]
    {
        for text in ["nan", "NaN", "-nan", "inf", "-inf", "infinity", "1e300"] {
            let (_, refusal) = doors.get(&format!("{list}?from=2399:{text}")).await;
            assert_eq!(at_fault(&refusal), ("INVALID_TIME", "from"), "{list} {text}: {refusal}");
        }
    }
    let (_, refusal) = doors.upload(&format!("{path}/raw?near=2399:nan"), vec![0]).await;
    assert_eq!(at_fault(&refusal), ("INVALID_TIME", "near"), "{refusal}");
    for text in ["nan,8,47,9", "46,8,inf,9"] {
        let (status, refusal) = doors.get(&format!("/v1/sessions:heads?area={text}")).await;
        assert_eq!(status, StatusCode::BAD_REQUEST, "{text}: {refusal}");
    }
}

/// A JSON list is not accepted in place of a message, at any depth.
#[tokio::test]
async fn a_message_is_an_object() {
    let doors = Doors::open().await;
    let epochs = format!("/v1/sessions/{}/epochs", doors.session().await);
    let listed = |observation: Value| {
        let mut epoch = epoch(1);
        epoch["observations"] = json!([observation]);
        json!({"epochs": [epoch]})
    };
    let mut timed = epoch(1);
    timed["time"] = json!([2051, 46_701_000_000_000_u64]);
    for (path, body, field) in [
        ("/v1/sessions", json!(["lbl"]), ""),
        ("/v1/sessions", json!([]), ""),
        ("/v1/sessions", json!({"overrides": ["none"]}), "overrides"),
        ("/v1/bases", json!({"marker": [4_033_460.75, 23_538.02, 4_924_318.39]}), "marker"),
        (&epochs, json!([[epoch(1)]]), ""),
        (&epochs, json!({"epochs": [timed]}), "epochs[0].time"),
        (&epochs, listed(json!(["G05", "1C", 2.2e7])), "epochs[0].observations[0]"),
    ] {
        let (status, refusal) = doors.post(path, body.clone()).await;
        assert_eq!(status, StatusCode::BAD_REQUEST, "{body}");
        assert_eq!(at_fault(&refusal), ("INVALID_FIELD", field), "{body}: {refusal}");
    }
    let (_, refusal) = job_with(&doors, r#"["spp"]"#).await;
    assert_eq!(at_fault(&refusal), ("INVALID_FIELD", "options"), "{refusal}");
    assert_eq!(doors.get("/v1/sessions").await.1["sessions"].as_array().unwrap().len(), 1);
}

#[tokio::test]
async fn a_malformed_parameter_is_named() {
    let doors = Doors::open().await;
    let session = format!("/v1/sessions/{}", doors.session().await);
    for (method, path, parameter) in [
        ("GET", "/v1/sessions?closed=maybe".to_owned(), "closed"),
        ("GET", "/v1/sessions?pageSize=x".to_owned(), "pageSize"),
        ("GET", "/v1/sessions?label=a&pageSize=-1".to_owned(), "pageSize"),
        ("GET", "/v1/sessions?label=a&label=b".to_owned(), "label"),
        ("GET", "/v1/jobs?pageSize=1&pageSize=1".to_owned(), "pageSize"),
        ("GET", "/v1/audit?refused=".to_owned(), "refused"),
        ("DELETE", format!("{session}?purge=maybe"), "purge"),
        ("DELETE", "/v1/jobs/job_1?purge=maybe".to_owned(), "purge"),
        ("GET", format!("{session}/solutions:series?points=1.5"), "points"),
    ] {
        let (status, refusal) = doors.send(method, &path, json!({})).await;
        assert_eq!(status, StatusCode::BAD_REQUEST, "{path}");
        assert_eq!(at_fault(&refusal), ("INVALID_FIELD", parameter), "{path}: {refusal}");
    }
    let (_, refusal) = doors.upload(&format!("{session}/raw?offset=abc"), vec![0]).await;
    assert_eq!(at_fault(&refusal), ("INVALID_FIELD", "offset"), "{refusal}");
    let (_, refusal) = doors.get("/v1/sessions?pagesize=1").await;
    assert_eq!(at_fault(&refusal), ("UNKNOWN_FIELD", "pagesize"), "{refusal}");
    assert!(refusal["detail"].as_str().unwrap().contains("pageSize"), "{refusal}");
}

#[tokio::test]
async fn a_field_that_is_repeated_or_no_message_is_named() {
    let doors = Doors::open().await;
    let ask = async |path: &str, body: &str| {
        let request = Request::post(path).header("content-type", "application/json");
        doors.ask(request.body(Body::from(body.to_owned())).unwrap()).await.1
    };
    for (path, body, field) in [
        ("/v1/sessions", "null", ""),
        ("/v1/sessions", "7", ""),
        ("/v1/sessions", r#"{"label":"a","label":"b"}"#, "label"),
        ("/v1/sessions", r#"{"label":"unknown field","mode":7}"#, "mode"),
        ("/v1/solve", r#"{"epochs":[null]}"#, "epochs[0]"),
        ("/v1/solve", r#"{"epochs":[{"seq":1},{"seq":1,"seq":2}]}"#, "epochs[1].seq"),
    ] {
        let refusal = ask(path, body).await;
        assert_eq!(at_fault(&refusal), ("INVALID_FIELD", field), "{body}: {refusal}");
        assert_eq!(refusal.get("field").is_some(), !field.is_empty(), "{refusal}");
    }
    for (options, expected) in [
        ("null", ("INVALID_FIELD", "options")),
        (r#"{"mode":"spp","mode":"fgo"}"#, ("INVALID_FIELD", "options.mode")),
        (r#"{"webhook":{"url":"a","url":"b"}}"#, ("INVALID_FIELD", "options.webhook.url")),
        (r#"{"node":"spp"}"#, ("UNKNOWN_FIELD", "options.node")),
    ] {
        let (_, refusal) = job_with(&doors, options).await;
        assert_eq!(at_fault(&refusal), expected, "{options}: {refusal}");
    }
}

/// Calls without parameters refuse any, before they do anything.
#[tokio::test]
async fn a_call_without_parameters_takes_none() {
    let doors = Doors::open().await;
    let id = doors.session().await;
    let session = format!("/v1/sessions/{id}");
    for (method, path) in [
        ("GET", session.clone()),
        ("PATCH", session.clone()),
        ("POST", format!("{session}/epochs")),
        ("POST", format!("{session}:reset")),
        ("POST", format!("{session}:solve")),
        ("GET", format!("{session}/epochs/last")),
        ("POST", "/v1/sessions".to_owned()),
        ("POST", "/v1/solve".to_owned()),
        ("GET", "/v1/navigation".to_owned()),
        ("POST", "/v1/navigation".to_owned()),
        ("POST", "/v1/bases".to_owned()),
        ("DELETE", "/v1/bases/bas_1".to_owned()),
        ("POST", "/v1/jobs".to_owned()),
        ("GET", "/v1/jobs/job_1".to_owned()),
        ("GET", "/v1/jobs/job_1/result".to_owned()),
        ("GET", "/v1/jobs/job_1/report".to_owned()),
        ("GET", "/v1/jobs/job_1/events".to_owned()),
        ("GET", "/v1/jobs/job_1/deliveries".to_owned()),
        ("POST", "/v1/keys".to_owned()),
        ("GET", "/v1/tenants/default".to_owned()),
        ("GET", "/v1/sign-in".to_owned()),
    ] {
        let (status, refusal) = doors.send(method, &format!("{path}?foo=1&b"), json!({})).await;
        assert_eq!(status, StatusCode::BAD_REQUEST, "{method} {path}");
        assert_eq!(at_fault(&refusal), ("UNKNOWN_FIELD", "foo"), "{method} {path}: {refusal}");
    }
    // Accepted: parameters of calls, empty queries, and queries of pages, which have no schema.
    for path in [
        format!("{session}?"),
        format!("{session}/track.csv?status=NONE"),
        format!("{session}/solutions:series?points=10"),
        "/healthz?x=1".to_owned(),
        "/?x=1".to_owned(),
    ] {
        assert_eq!(doors.get(&path).await.0, StatusCode::OK, "{path}");
    }
    let head = Request::head(format!("{session}?foo=1")).body(Body::empty()).unwrap();
    assert_eq!(doors.ask(head).await.0, StatusCode::BAD_REQUEST);
    let (_, refusal) = doors.get(&format!("{session}/track.csv?foo=1")).await;
    assert_eq!(at_fault(&refusal), ("UNKNOWN_FIELD", "foo"), "{refusal}");
    assert_eq!(doors.get("/v1/sessions").await.1["sessions"].as_array().unwrap().len(), 1);
}

/// A body is refused if its encoding is unknown, or if it is not encoded as its header states.
#[tokio::test]
async fn an_encoding_that_is_unknown_or_untrue_is_named() {
    let doors = Doors::open().await;
    let ask = async |path: &str, kind: &str, encoding: &str, body: &[u8]| {
        let request = Request::post(path).header("content-type", kind);
        let request = request.header("content-encoding", encoding);
        let request = request.body(Body::from(body.to_vec())).unwrap();
        let response = doors.router.clone().oneshot(request).await.unwrap();
        let accepted = response.headers().get("accept-encoding").cloned();
        let body = axum::body::to_bytes(response.into_body(), usize::MAX).await.unwrap();
        (accepted, serde_json::from_slice::<Value>(&body).unwrap())
    };
    let raw = format!("/v1/sessions/{}/raw", doors.session().await);
    let (json, octets) = ("application/json", "application/octet-stream");
    for (path, kind) in [("/v1/sessions", json), (&raw, octets), ("/v1/jobs", "multipart/x")] {
        for encoding in ["br", "deflate", "zstd", "gzip, gzip"] {
            let (accepted, refusal) = ask(path, kind, encoding, b"{}").await;
            let expected = ("UNSUPPORTED_MEDIA_TYPE", "Content-Encoding");
            assert_eq!(at_fault(&refusal), expected, "{path} {encoding}: {refusal}");
            assert_eq!(accepted.unwrap(), "gzip, identity");
            assert!(refusal["detail"].as_str().unwrap().contains("gzip"), "{refusal}");
        }
    }
    let mut packed = GzEncoder::new(Vec::new(), Compression::default());
    packed.write_all(b"{\"label\":\"packed\"}").unwrap();
    let packed = packed.finish().unwrap();
    assert_eq!(ask("/v1/sessions", json, "gzip", &packed).await.1["label"], "packed");
    let cut = &packed[..packed.len() - 12];
    let whole = body(&[("rover", b"")]);
    let parts = format!("multipart/form-data; boundary={BOUNDARY}");
    for (path, kind, body) in [
        ("/v1/sessions", json, &b"{}"[..]),
        ("/v1/sessions", json, cut),
        (&raw, octets, cut),
        ("/v1/jobs", &parts, &whole),
    ] {
        let (_, refusal) = ask(path, kind, "gzip", body).await;
        let expected = ("MALFORMED_BODY", "Content-Encoding");
        assert_eq!(at_fault(&refusal), expected, "{path}: {refusal}");
    }
}
