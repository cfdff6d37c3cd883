//! URLs as inputs of batch jobs: the service fetches them before the job can run.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use axum::http::StatusCode;
use futures::stream;
use graphfix::config::JobsConfiguration;
use graphfix::contract::v1;
use graphfix::grpc::v1::jobs_client::JobsClient;
use serde_json::{Value, json};
use tokio::io::{AsyncReadExt, AsyncWriteExt};

use crate::support::casters::{HostileCaster, answer, gzip};
use crate::support::database::{Database, on_both_databases};
use crate::support::doors::{Doors, code};
use crate::support::jobs::{MINUTE, body};
use crate::support::wait::until;

use super::jobs::{bytes_of, created, ended, post};

on_both_databases!(a_job_of_urls_gives_the_bytes_of_solve);

/// A host that has these files.
pub(super) async fn host(files: Vec<(&'static str, Vec<u8>)>) -> HostileCaster {
    let files = Arc::new(files);
    HostileCaster::start(move |_, mut stream, head| {
        let files = files.clone();
        async move {
            let path = head.split(' ').nth(1).unwrap();
            let file = files.iter().find(|(name, _)| *name == path);
            let content = match file {
                Some((_, content)) => {
                    let head = format!("200 OK\r\nContent-Length: {}", content.len());
                    answer(&head, content)
                }
                None => answer("404 Not Found\r\nContent-Length: 0", b""),
            };
            stream.write_all(&content).await.ok();
            stream.shutdown().await.ok();
        }
    })
    .await
}

fn options(port: u16, parts: &[(&str, &str)], mode: &str) -> Value {
    let url = |(part, path): &(&str, &str)| json!({"part": part, "url": format!("http://127.0.0.1:{port}{path}")});
    json!({"mode": mode, "urls": parts.iter().map(url).collect::<Vec<_>>()})
}

fn without_files(options: &Value) -> Vec<u8> {
    body(&[("options", options.to_string().as_bytes())])
}

/// Files that arrive and are stored.
fn files(doors: &Doors) -> (usize, usize) {
    let folder = doors.folder().join("test.db.jobs");
    let count = |name| std::fs::read_dir(folder.join(name)).unwrap().count();
    (count("incoming"), count("inputs"))
}

async fn a_job_of_urls_gives_the_bytes_of_solve(database: Database) {
    let doors = Doors::on_with_jobs(&database.url, JobsConfiguration::standard()).await;
    let host = host(vec![
        ("/day/rover.obs.gz", gzip(&MINUTE.rover)),
        ("/nav?format=rinex", MINUTE.navigation.clone()),
        ("/base.obs", MINUTE.base.clone()),
    ]);
    let host = host.await;
    let parts = [
        ("rover", "/day/rover.obs.gz"),
        ("navigation", "/nav?format=rinex"),
        ("base", "/base.obs"),
    ];
    let options = options(host.port, &parts, "rtk-ekf");
    let named = [("idempotency-key", "urls")];
    let (status, job) = post(&doors, without_files(&options), &named).await;
    assert_eq!(status, StatusCode::CREATED, "{job}");
    let job = job["job"].as_str().unwrap().to_owned();
    let done = ended(&doors, &job).await;
    assert_eq!(done["state"], "SUCCEEDED", "{done}");
    let (_, result) = bytes_of(&doors, &format!("/v1/jobs/{job}/result")).await;
    assert_eq!(result, MINUTE.solved(&["--mode", "rtk-ekf"], "pos"));
    let names =
        [(0_usize, "rover", "rover.obs.gz"), (1, "navigation", "nav"), (2, "base", "base.obs")];
    for (index, part, name) in names {
        let input = &done["inputs"][index];
        assert_eq!((&input["part"], &input["name"]), (&json!(part), &json!(name)), "{done}");
        assert_eq!(input["hash"].as_str().unwrap().len(), 64);
        assert_eq!(input["url"], options["urls"][index]["url"]);
    }
    assert_eq!(done["inputs"][2]["bytes"], MINUTE.base.len());
    // The same request gives the same job, and fetches nothing again.
    let connections = host.connections.load(Ordering::SeqCst);
    let (status, again) = post(&doors, without_files(&options), &named).await;
    assert_eq!((status, &again["job"]), (StatusCode::OK, &json!(job)));
    assert_eq!((connections, host.connections.load(Ordering::SeqCst)), (3, 3));

    // A request through the other door has a file and URLs.
    use v1::create_job_request::Content;
    let message = |content| v1::CreateJobRequest { content: Some(content) };
    let url = |part: &str, path: &str| v1::JobUrl {
        part: part.to_owned(),
        url: format!("http://127.0.0.1:{}{path}", host.port),
    };
    let urls = vec![url("navigation", "/nav?format=rinex")];
    let options = v1::JobOptions { mode: "spp".to_owned(), urls, ..Default::default() };
    let part = v1::JobPart { part: "rover".to_owned(), name: "rover.obs".to_owned() };
    let messages = [
        message(Content::Options(options)),
        message(Content::Part(part)),
        message(Content::Chunk(MINUTE.rover.clone())),
    ];
    let mut client = JobsClient::new(doors.router.clone());
    let by_grpc = client.create(stream::iter(messages)).await.unwrap().into_inner();
    assert_eq!(ended(&doors, &by_grpc.job).await["state"], "SUCCEEDED");
    doors.close().await;
}

#[tokio::test]
async fn what_cannot_be_fetched_fails_the_job_with_its_part() {
    let largest = MINUTE.rover.len().max(MINUTE.navigation.len());
    let file_bytes = largest as u64;
    let limits = JobsConfiguration { file_bytes, ..JobsConfiguration::standard() };
    let doors = Doors::with_jobs(limits).await;
    let large = vec![b'x'; largest + 1];
    let host = host(vec![
        ("/rover", MINUTE.rover.clone()),
        ("/navigation", MINUTE.navigation.clone()),
        ("/large", large),
        ("/text", b"no observations".to_vec()),
    ]);
    let host = host.await;
    for (parts, expected, field) in [
        ([("rover", "/none"), ("navigation", "/navigation")], "FILE_NOT_FOUND", "rover"),
        ([("rover", "/rover"), ("navigation", "/large")], "JOB_TOO_LARGE", "navigation"),
        ([("rover", "/text"), ("navigation", "/navigation")], "FILE_NOT_UNDERSTOOD", "rover"),
    ] {
        let job = created(&doors, without_files(&options(host.port, &parts, "spp"))).await;
        let failed = ended(&doors, &job).await;
        let failure = &failed["failure"];
        assert_eq!((&failure["code"], &failure["field"]), (&json!(expected), &json!(field)));
        assert!(!failure["remedy"].as_str().unwrap().is_empty(), "{failure}");
    }
    let elsewhere = HostileCaster::answering(answer("200 OK", &MINUTE.rover)).await;
    let to = format!("302 Found\r\nLocation: http://127.0.0.1:{}/", elsewhere.port);
    let redirecting = HostileCaster::answering(answer(&to, b"")).await;
    let silent = HostileCaster::start(|_, mut stream, _| async move {
        stream.write_all(b"HTTP/1.1 200 OK\r\n\r\nthe beginning").await.ok();
        stream.read_to_end(&mut Vec::new()).await.ok();
    });
    let silent = silent.await;
    for (port, expected, tries) in
        [(redirecting.port, "HOST_REDIRECTS", 1), (silent.port, "HOST_SLOW", 3)]
    {
        let parts = [("rover", "/rover"), ("navigation", "/navigation")];
        let job = created(&doors, without_files(&options(port, &parts, "spp"))).await;
        let failed = ended(&doors, &job).await;
        assert_eq!(failed["failure"]["code"], expected, "{failed}");
        // The job has ended: nothing is tried again by itself.
        let remedy = failed["failure"]["remedy"].as_str().unwrap();
        assert!(!remedy.contains("by itself"), "{remedy}");
        let host = if port == silent.port { &silent } else { &redirecting };
        assert_eq!(host.connections.load(Ordering::SeqCst), tries);
    }
    assert_eq!(elsewhere.connections.load(Ordering::SeqCst), 0, "a redirection was followed");
    assert_eq!(files(&doors).0, 0);
}

#[tokio::test]
async fn urls_that_are_not_allowed_are_refused() {
    let limits = JobsConfiguration { files: 2, ..JobsConfiguration::standard() };
    let doors = Doors::with_jobs(limits).await;
    let here = "http://127.0.0.1:9/file";
    let urls = |urls: &[(&str, &str)]| {
        let url = |(part, url): &(&str, &str)| json!({"part": part, "url": url});
        json!({"mode": "spp", "urls": urls.iter().map(url).collect::<Vec<_>>()})
    };
    let both = |rover| [("rover", rover), ("navigation", here)];
    for (options, status, expected, field) in [
        (urls(&both("file:///etc/passwd")), 400, "LOCATION_INVALID", Some("options.urls")),
        (urls(&both("http://10.0.0.1/")), 409, "HOST_NOT_ALLOWED", Some("options.urls")),
        (urls(&[("truth", here)]), 400, "INVALID_FIELD", Some("options.urls[0].part")),
        (urls(&[("navigation", here)]), 400, "INVALID_FIELD", Some("rover")),
        (urls(&[("rover", here), ("rover", here)]), 400, "INVALID_FIELD", Some("rover")),
        (
            urls(&[("rover", here), ("navigation", here), ("base", here)]),
            413,
            "JOB_TOO_LARGE",
            None,
        ),
    ] {
        let (answered, problem) = post(&doors, without_files(&options), &[]).await;
        let got = (answered.as_u16(), code(&problem), problem["field"].as_str());
        assert_eq!(got, (status, expected, field), "{problem}");
    }
    assert_eq!(doors.get("/v1/jobs").await.1["jobs"], json!([]));
}

/// A host that sends only half of a file, until the `whole`-th request gets the whole file.
async fn hesitant(whole: usize) -> HostileCaster {
    HostileCaster::start(move |number, mut stream, _| async move {
        let content = &MINUTE.rover;
        let head = format!("200 OK\r\nContent-Length: {}", content.len());
        stream.write_all(&answer(&head, &content[..content.len() / 2])).await.ok();
        if number + 1 < whole {
            stream.shutdown().await.ok();
            return;
        }
        stream.write_all(&content[content.len() / 2..]).await.ok();
    })
    .await
}

#[tokio::test]
async fn a_connection_that_is_cut_is_tried_again() {
    let doors = Doors::with_jobs(JobsConfiguration::standard()).await;
    let host = hesitant(2).await;
    let options = options(host.port, &[("rover", "/rover")], "spp").to_string();
    let parts = [("navigation", &MINUTE.navigation[..]), ("options", options.as_bytes())];
    let job = created(&doors, body(&parts)).await;
    let done = ended(&doors, &job).await;
    assert_eq!(done["state"], "SUCCEEDED", "{done}");
    let (_, result) = bytes_of(&doors, &format!("/v1/jobs/{job}/result")).await;
    assert_eq!(result, MINUTE.solved(&["--mode", "spp"], "pos"));
    assert_eq!(host.connections.load(Ordering::SeqCst), 2);
}

/// Neither a cancellation nor the end of the service waits for a host.
#[tokio::test]
async fn a_fetch_ends_with_its_job_and_begins_again_after_a_restart() {
    let doors = Doors::with_jobs(JobsConfiguration::standard()).await;
    let dripping = HostileCaster::start(|number, mut stream, _| async move {
        if number == 2 {
            let head = format!("200 OK\r\nContent-Length: {}", MINUTE.rover.len());
            stream.write_all(&answer(&head, &MINUTE.rover)).await.ok();
            return;
        }
        stream.write_all(b"HTTP/1.1 200 OK\r\n\r\n").await.ok();
        while stream.write_all(b"x").await.is_ok() {
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
    });
    let dripping = dripping.await;
    let options = options(dripping.port, &[("rover", "/rover")], "spp").to_string();
    let parts = [("navigation", &MINUTE.navigation[..]), ("options", options.as_bytes())];
    let cancelled = created(&doors, body(&parts)).await;
    let arriving = |arriving: &usize| *arriving == 1;
    until("arriving", async || files(&doors).0, arriving).await;
    let (_, shown) = doors.get(&format!("/v1/jobs/{cancelled}")).await;
    assert_eq!((&shown["state"], &shown["inputs"][0]["hash"]), (&json!("QUEUED"), &json!("")));
    let (_, job) = doors.send("DELETE", &format!("/v1/jobs/{cancelled}"), json!({})).await;
    assert_eq!(job["state"], "CANCELLED", "{job}");
    until("left", async || files(&doors).0, |arriving: &usize| *arriving == 0).await;

    let job = created(&doors, body(&parts)).await;
    until("arriving", async || files(&doors).0, arriving).await;
    let doors = doors.restarted().await;
    let done = ended(&doors, &job).await;
    assert_eq!(done["state"], "SUCCEEDED", "{done}");
    let (_, result) = bytes_of(&doors, &format!("/v1/jobs/{job}/result")).await;
    assert_eq!(result, MINUTE.solved(&["--mode", "spp"], "pos"));
    assert_eq!(files(&doors).0, 0);
}
