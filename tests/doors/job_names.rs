//! Names of the files of jobs: each way in refuses what cannot be stored and printed, and a name
//! that an earlier version has stored stops nothing.

use axum::body::Body;
use axum::http::{Request, StatusCode};
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use futures::stream;
use graphfix::contract::v1;
use graphfix::contract::v1::create_job_request::Content;
use graphfix::grpc::code_of;
use graphfix::grpc::v1::jobs_client::JobsClient;
use serde_json::{Value, json};

use crate::support::database::{Database, on_both_databases, on_postgres};
use crate::support::doors::{Doors, code};
use crate::support::jobs::{BOUNDARY, MINUTE, body};

use super::jobs::post;
use super::tenants::world::{Key, asked, get, key_of, operator, sent};

on_both_databases!(a_stored_name_with_a_nul_stops_nothing);

/// Creates a job of a tenant; returns its id.
async fn job_of(doors: &Doors, key: &Key) -> String {
    let kind = format!("multipart/form-data; boundary={BOUNDARY}");
    let request = Request::post("/v1/jobs").header("content-type", kind);
    let content = MINUTE.body(&json!({"mode": "spp"}));
    let answer = sent(doors, key, request.body(Body::from(content)).unwrap()).await;
    assert_eq!(answer.status, StatusCode::CREATED, "{}", answer.text);
    let job: Value = serde_json::from_str(&answer.text).unwrap();
    job["job"].as_str().unwrap().to_owned()
}

#[tokio::test]
async fn names_are_short_and_printable() {
    let doors = Doors::open().await;
    let long = "x".repeat(201);
    for name in ["a\0b", "a\nb", "\u{1b}[31m", "\u{85}", &long] {
        let begin = v1::JobPart { part: "rover".to_owned(), name: name.to_owned() };
        let begin = v1::CreateJobRequest { content: Some(Content::Part(begin)) };
        let mut client = JobsClient::new(doors.router.clone());
        let refused = client.create(stream::iter([begin])).await.unwrap_err();
        assert_eq!(code_of(&refused).as_deref(), Some("INVALID_FIELD"), "{name:?}: {refused}");

        let metadata = format!("filename {}", STANDARD.encode(name));
        let upload = Request::post("/v1/uploads").header("tus-resumable", "1.0.0");
        let upload = upload.header("upload-length", "1").header("upload-metadata", metadata);
        let (status, refused) = doors.ask(upload.body(Body::empty()).unwrap()).await;
        let got = (status.as_u16(), code(&refused), refused["field"].as_str());
        assert_eq!(got, (400, "INVALID_FIELD", Some("Upload-Metadata")), "{name:?}");

        let url = format!("http://127.0.0.1:9/{name}{long}");
        let url = if name == long { url.repeat(10) } else { url };
        let options = json!({"urls": [{"part": "rover", "url": url}]}).to_string();
        let (status, refused) = post(&doors, body(&[("options", options.as_bytes())]), &[]).await;
        let got = (status.as_u16(), code(&refused), refused["field"].as_str());
        assert_eq!(got, (400, "INVALID_FIELD", Some("options.urls[0].url")), "{name:?}");
    }
    for name in [&long, "\u{85}"] {
        let content = MINUTE.body(&json!({}));
        let named = format!("filename=\"{name}\"");
        let content = String::from_utf8(content).unwrap().replace("filename=\"a.file\"", &named);
        let (status, refused) = post(&doors, content.into_bytes(), &[]).await;
        let got = (status.as_u16(), code(&refused), refused["field"].as_str());
        assert_eq!(got, (400, "INVALID_FIELD", Some("rover")), "{name:?}: {refused}");
    }
}

/// The database has names that contain a NUL, and the six characters of its escape. The tenant's
/// bytes are counted, its quotas can be set, and the service starts again.
async fn a_stored_name_with_a_nul_stops_nothing(database: Database) {
    let doors = Doors::on(&database.url).await;
    let operator = operator(&doors).await;
    let a = key_of(&doors, &operator, "a", "").await;
    job_of(&doors, &a).await;
    let bytes = (MINUTE.rover.len() + MINUTE.navigation.len() + MINUTE.base.len()) as u64;
    for stored in [r"a\u0000\u0000", r"a\\u0000", r"\\\u0000"] {
        let names = "UPDATE jobs SET request = REPLACE(request, 'a.file', '";
        database.execute(&format!("{names}{stored}')")).await;
        let used = async || {
            let page = get(&doors, &operator, "/v1/tenants").await;
            let of_a = page["tenants"].as_array().unwrap().iter().find(|t| t["tenant"] == "a");
            of_a.unwrap()["used"]["jobBytes"].as_u64().unwrap()
        };
        assert!(bytes <= used().await, "{stored}");
        let quotas = json!({"quotas": {"jobBytes": 100_000_000}});
        let (status, set) = asked(&doors, &operator, "PUT", "/v1/tenants/a", quotas).await;
        assert_eq!(status, StatusCode::OK, "{set}");
        job_of(&doors, &a).await;
        let back = format!("UPDATE jobs SET request = REPLACE(request, '{stored}', 'a.file')");
        database.execute(&back).await;
    }
    let names = r"UPDATE jobs SET request = REPLACE(request, 'a.file', 'a\u0000')";
    database.execute(names).await;
    let doors = doors.restarted().await;
    assert_eq!(get(&doors, &a, "/v1/tenants").await["tenants"].as_array().unwrap().len(), 1);
    doors.close().await;
}

/// The bytes of one tenant cannot be counted: the sum is beyond 64 bits.
#[tokio::test]
async fn a_tenant_that_cannot_be_counted_stops_no_other() {
    on_postgres(async |database| {
        let doors = Doors::on(&database.url).await;
        let operator = operator(&doors).await;
        let (a, b) =
            (key_of(&doors, &operator, "a", "").await, key_of(&doors, &operator, "b", "").await);
        let job = job_of(&doors, &a).await;
        let done = async || get(&doors, &a, &format!("/v1/jobs/{job}")).await;
        crate::support::wait::until("ended", done, |job| job["state"] == "SUCCEEDED").await;
        let huge = format!("\"bytes\":{}", u64::MAX);
        let bytes = format!("\"bytes\":{}", MINUTE.rover.len());
        let sql = format!("UPDATE jobs SET request = REPLACE(request, '{bytes}', '{huge}')");
        database.execute(&sql).await;
        let quotas = json!({"quotas": {"jobBytes": 100_000_000}});
        let (status, set) = asked(&doors, &operator, "PUT", "/v1/tenants/a", quotas.clone()).await;
        assert_eq!((status, &set["used"]), (StatusCode::OK, &Value::Null), "{set}");
        let doors = doors.restarted().await;
        let page = get(&doors, &operator, "/v1/tenants").await;
        let used = |name: &str| {
            let tenants = page["tenants"].as_array().unwrap();
            tenants.iter().find(|tenant| tenant["tenant"] == name).unwrap()["used"].is_object()
        };
        assert_eq!((used("a"), used("b"), used("default")), (false, true, true), "{page}");
        let (status, set) = asked(&doors, &operator, "PUT", "/v1/tenants/b", quotas).await;
        assert_eq!((status, set["used"].is_object()), (StatusCode::OK, true), "{set}");
        job_of(&doors, &b).await;
        doors.close().await;
    })
    .await;
}
