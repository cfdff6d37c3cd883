//! `/v1/uploads`: uploads of job files that continue after a break, by the protocol tus.

use std::process::Command;
use std::time::Duration;

use axum::body::Body;
use axum::http::{HeaderMap, Request, StatusCode};
use futures::{StreamExt, stream};
use graphfix::config::JobsConfiguration;
use serde_json::{Value, json};
use tokio::sync::oneshot;
use tokio::time::timeout;
use tower::ServiceExt;

use crate::support::database::{Database, on_both_databases};
use crate::support::doors::{Doors, code};
use crate::support::jobs::{MINUTE, body};
use crate::support::python;
use crate::support::server::{Server, free_port, status_of};
use crate::support::wait::until;

use super::jobs::{bytes_of, ended, post};

on_both_databases!(an_upload_goes_on_after_a_break);

/// Sends a request of the protocol.
async fn tus(
    doors: &Doors,
    method: &str,
    path: &str,
    headers: &[(&str, &str)],
    content: Body,
) -> (StatusCode, HeaderMap, Value) {
    let mut request = Request::builder().method(method).uri(path).header("tus-resumable", "1.0.0");
    for (name, value) in headers {
        request = request.header(*name, *value);
    }
    let response = doors.router.clone().oneshot(request.body(content).unwrap()).await.unwrap();
    let (status, headers) = (response.status(), response.headers().clone());
    assert_eq!(headers["tus-resumable"], "1.0.0", "{method} {path}");
    let content = axum::body::to_bytes(response.into_body(), usize::MAX).await.unwrap();
    (status, headers, serde_json::from_slice(&content).unwrap_or_default())
}

/// Begins an upload; returns its path.
async fn begun(doors: &Doors, bytes: usize) -> String {
    let length = bytes.to_string();
    let headers =
        [("upload-length", &*length), ("upload-metadata", "filename cm92ZXIub2Jz,x eA==")];
    let (status, headers, upload) =
        tus(doors, "POST", "/v1/uploads", &headers, Body::empty()).await;
    assert_eq!(status, StatusCode::CREATED, "{upload}");
    assert_eq!((&upload["name"], &upload["offset"]), (&json!("rover.obs"), &json!(0)));
    let expires = headers["upload-expires"].to_str().unwrap();
    assert!(expires.ends_with(" GMT"), "{expires}");
    let path = headers["location"].to_str().unwrap().to_owned();
    assert_eq!(path, format!("/v1/uploads/{}", upload["upload"].as_str().unwrap()));
    path
}

async fn appended(
    doors: &Doors,
    path: &str,
    offset: usize,
    content: Body,
) -> (StatusCode, HeaderMap, Value) {
    let offset = offset.to_string();
    let kind = ("content-type", "application/offset+octet-stream");
    tus(doors, "PATCH", path, &[kind, ("upload-offset", &offset)], content).await
}

/// The offset that the service states.
async fn offset(doors: &Doors, path: &str) -> usize {
    let (status, headers, _) = tus(doors, "HEAD", path, &[], Body::empty()).await;
    assert_eq!((status, &headers["cache-control"]), (StatusCode::OK, &"no-store".parse().unwrap()));
    headers["upload-offset"].to_str().unwrap().parse().unwrap()
}

/// An upload continues after a break and a restart of the service. A second upload has the same
/// content. The job gives the bytes of `graphfix solve`.
async fn an_upload_goes_on_after_a_break(database: Database) {
    let doors = Doors::on(&database.url).await;
    let content = &MINUTE.rover;
    let path = begun(&doors, content.len()).await;
    let (first, rest) = content.split_at(content.len() / 3);
    let broken = [Ok(first.to_vec()), Err(std::io::Error::other("cut"))];
    let (status, _, problem) =
        appended(&doors, &path, 0, Body::from_stream(stream::iter(broken))).await;
    assert!(status.is_client_error(), "{status} {problem}");
    assert_eq!(offset(&doors, &path).await, first.len());
    let doors = doors.restarted().await;
    assert_eq!(offset(&doors, &path).await, first.len());
    let options = |uploads: Value| json!({"mode": "spp", "uploads": uploads}).to_string();
    let rover = json!([{"part": "rover", "upload": path.rsplit('/').next().unwrap()}]);
    let job = async |doors: &Doors| {
        let options = options(rover.clone());
        let parts = [("navigation", &MINUTE.navigation[..]), ("options", options.as_bytes())];
        post(doors, body(&parts), &[]).await
    };
    let (status, problem) = job(&doors).await;
    let got = (status.as_u16(), code(&problem), problem["field"].as_str());
    assert_eq!(got, (409, "UPLOAD_INCOMPLETE", Some("options.uploads[0].upload")), "{problem}");
    let (status, headers, _) =
        appended(&doors, &path, first.len(), Body::from(rest.to_vec())).await;
    assert_eq!(status, StatusCode::NO_CONTENT);
    assert_eq!(headers["upload-offset"], content.len().to_string());
    let (_, _, upload) = tus(&doors, "GET", &path, &[], Body::empty()).await;
    assert_eq!(upload["hash"].as_str().unwrap().len(), 64, "{upload}");
    let (status, created) = job(&doors).await;
    assert_eq!(status, StatusCode::CREATED, "{created}");
    let inputs = created["inputs"].as_array().unwrap();
    let input = inputs.iter().find(|input| input["part"] == "rover").unwrap();
    assert_eq!((&input["name"], &input["hash"]), (&json!("rover.obs"), &upload["hash"]));
    let job = created["job"].as_str().unwrap();
    // The file belongs to the job now, so the upload can be deleted.
    let (status, _, _) = tus(&doors, "DELETE", &path, &[], Body::empty()).await;
    assert_eq!(status, StatusCode::NO_CONTENT);
    let (status, _, problem) = tus(&doors, "GET", &path, &[], Body::empty()).await;
    assert_eq!((status.as_u16(), code(&problem)), (404, "UPLOAD_NOT_FOUND"));
    assert_eq!(ended(&doors, job).await["state"], "SUCCEEDED");
    let (_, result) = bytes_of(&doors, &format!("/v1/jobs/{job}/result")).await;
    assert_eq!(result, MINUTE.solved(&["--mode", "spp"], "pos"));
    doors.close().await;
}

#[tokio::test]
async fn what_does_not_go_on_is_refused() {
    let jobs =
        JobsConfiguration { file_bytes: 100, open_uploads: 2, ..JobsConfiguration::standard() };
    let doors = Doors::with_jobs(jobs).await;
    let (status, headers, _) = {
        let request = Request::builder().method("OPTIONS").uri("/v1/uploads");
        let response =
            doors.router.clone().oneshot(request.body(Body::empty()).unwrap()).await.unwrap();
        (response.status(), response.headers().clone(), ())
    };
    assert_eq!(
        (status, &headers["tus-version"]),
        (StatusCode::NO_CONTENT, &"1.0.0".parse().unwrap())
    );
    let path = begun(&doors, 10).await;
    let patch = [("content-type", "application/offset+octet-stream"), ("upload-offset", "0")];
    for (method, at, headers, content, status, expected) in [
        ("POST", "/v1/uploads", &[][..], "", 400, "INVALID_FIELD"),
        ("POST", "/v1/uploads", &[("upload-length", "101")], "", 413, "JOB_TOO_LARGE"),
        (
            "POST",
            "/v1/uploads",
            &[("upload-length", "1"), ("upload-metadata", "filename ?")],
            "",
            400,
            "INVALID_FIELD",
        ),
        ("PATCH", &path, &[("upload-offset", "0")], "x", 415, "UNSUPPORTED_MEDIA_TYPE"),
        ("PATCH", &path, &[patch[0], ("upload-offset", "3")], "x", 409, "UPLOAD_OFFSET_DIFFERS"),
        ("PATCH", &path, &[patch[0]], "x", 400, "INVALID_FIELD"),
        ("PATCH", &path, &patch, "12345678901", 413, "UPLOAD_TOO_LONG"),
        ("PATCH", "/v1/uploads/upl_0", &patch, "x", 404, "UPLOAD_NOT_FOUND"),
    ] {
        let (answered, _, problem) = tus(&doors, method, at, headers, Body::from(content)).await;
        assert_eq!((answered.as_u16(), code(&problem)), (status, expected), "{method} {headers:?}");
    }
    // No byte of a refused request is stored.
    assert_eq!(offset(&doors, &path).await, 0);
    let pieces = stream::iter(["1234567", "8901"].map(Ok::<_, std::io::Error>));
    // The refusal does not wait for the rest of the body.
    let pieces = Body::from_stream(pieces.chain(stream::pending()));
    let answered = timeout(Duration::from_secs(30), appended(&doors, &path, 0, pieces)).await;
    let (status, _, problem) = answered.expect("no answer");
    assert_eq!((status.as_u16(), code(&problem)), (413, "UPLOAD_TOO_LONG"), "{problem}");
    assert_eq!(offset(&doors, &path).await, 0);
    let old = Request::patch(&path).header("tus-resumable", "0.2.2").body(Body::empty()).unwrap();
    let response = doors.router.clone().oneshot(old).await.unwrap();
    assert_eq!(response.status(), StatusCode::PRECONDITION_FAILED);
    assert_eq!(response.headers()["tus-version"], "1.0.0");
    let problem = axum::body::to_bytes(response.into_body(), usize::MAX).await.unwrap();
    let problem: Value = serde_json::from_slice(&problem).unwrap();
    assert_eq!(code(&problem), "UPLOAD_PROTOCOL_UNKNOWN");
    begun(&doors, 10).await;
    let third = tus(&doors, "POST", "/v1/uploads", &[("upload-length", "1")], Body::empty()).await;
    assert_eq!((third.0.as_u16(), code(&third.2)), (429, "TOO_MANY_UPLOADS"), "{}", third.2);
    assert!((600_000..=1_200_000).contains(&third.2["retryAfterMs"].as_u64().unwrap()));
    let unknown = json!({"uploads": [{"part": "rover", "upload": "upl_0"}]}).to_string();
    let (status, problem) = post(&doors, body(&[("options", unknown.as_bytes())]), &[]).await;
    assert_eq!((status.as_u16(), code(&problem)), (404, "UPLOAD_NOT_FOUND"), "{problem}");
}

/// A complete upload takes no byte more, and its file is not there to be opened.
#[tokio::test]
async fn a_complete_upload_takes_no_byte() {
    let doors = Doors::with_jobs(JobsConfiguration::standard()).await;
    let path = begun(&doors, 8).await;
    appended(&doors, &path, 0, Body::from("12345678")).await;
    let incoming = doors.folder().join("test.db.jobs/incoming");
    for (content, expected) in [("9", 413), ("", 204)] {
        let (status, _, problem) = appended(&doors, &path, 8, Body::from(content)).await;
        assert_eq!(status.as_u16(), expected, "{problem}");
        assert_eq!(offset(&doors, &path).await, 8);
        assert_eq!(std::fs::read_dir(&incoming).unwrap().count(), 0, "a file is left");
    }
    let (status, _, problem) = appended(&doors, &path, 7, Body::from("9")).await;
    assert_eq!((status.as_u16(), code(&problem)), (409, "UPLOAD_OFFSET_DIFFERS"), "{problem}");
}

/// Two requests never append at the same time.
#[tokio::test]
async fn one_request_appends_at_a_time() {
    let doors = Doors::with_jobs(JobsConfiguration::standard()).await;
    let path = begun(&doors, 8).await;
    let (go_on, waiting) = oneshot::channel::<()>();
    let first = stream::iter([Ok::<_, std::io::Error>("1234")]);
    let second =
        stream::once(async { waiting.await.map(|()| "5678").map_err(std::io::Error::other) });
    let slow = appended(&doors, &path, 0, Body::from_stream(first.chain(second)));
    let others = async {
        until("the first bytes", async || offset(&doors, &path).await, |offset| *offset == 4).await;
        let (status, _, problem) = appended(&doors, &path, 4, Body::from("5678")).await;
        assert_eq!((status.as_u16(), code(&problem)), (409, "UPLOAD_BUSY"), "{problem}");
        go_on.send(()).unwrap();
    };
    let ((status, headers, _), ()) = tokio::join!(slow, others);
    assert_eq!(
        (status, &headers["upload-offset"]),
        (StatusCode::NO_CONTENT, &"8".parse().unwrap())
    );
}

/// An expired upload is not found, and its file is removed.
#[tokio::test]
async fn an_upload_expires() {
    let database = Database::sqlite();
    let doors = Doors::on(&database.url).await;
    let path = begun(&doors, 8).await;
    appended(&doors, &path, 0, Body::from("1234")).await;
    database.execute("UPDATE job_uploads SET expires_unix_ms = 1").await;
    let (status, _, problem) = tus(&doors, "HEAD", &path, &[], Body::empty()).await;
    assert_eq!(status, StatusCode::NOT_FOUND, "{problem}");
    doors.service.jobs().remove_expired().await.unwrap();
    assert_eq!(database.count("job_uploads").await, 0);
    let doors = doors.restarted().await;
    assert_eq!(std::fs::read_dir(doors.folder().join("jobs/incoming")).unwrap().count(), 0);
    doors.close().await;
}

/// The independent client tuspy uploads in chunks, stops, and continues.
#[tokio::test]
async fn a_client_of_others_uploads_and_goes_on() {
    let Some(python) = python::with("tusclient") else { return };
    let (database, port) = (Database::sqlite(), free_port());
    let server = Server::start(&database.url, port);
    let ready = async || std::panic::catch_unwind(|| status_of(port, "/readyz")).ok();
    until("ready", ready, |status| *status == Some(200)).await;
    let folder = tempfile::tempdir().unwrap();
    let [rover, ..] = MINUTE.write(folder.path());
    let script = "import sys\n\
        from tusclient import client\n\
        url, path = sys.argv[1:]\n\
        tus = client.TusClient(url)\n\
        first = tus.uploader(path, chunk_size=50_000, metadata={'filename': 'rover.obs'})\n\
        first.upload_chunk()\n\
        rest = tus.uploader(path, chunk_size=50_000, url=first.url)\n\
        assert rest.offset == 50_000, rest.offset\n\
        rest.upload()\n\
        print(rest.url)";
    let url = format!("http://127.0.0.1:{port}/v1/uploads");
    let output = Command::new(python).args(["-c", script, &url]).arg(&rover).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let upload = String::from_utf8(output.stdout).unwrap();
    let answer = Command::new("curl").args(["--silent", "--fail", upload.trim()]).output().unwrap();
    let upload: Value = serde_json::from_slice(&answer.stdout).unwrap();
    assert_eq!(upload["offset"], json!(MINUTE.rover.len()), "{upload}");
    assert_eq!(
        (&upload["name"], upload["hash"].as_str().map(str::len)),
        (&json!("rover.obs"), Some(64))
    );
    drop(server);
}
