//! Ephemerides that the service fetches itself: archives by HTTP, and streams that fill no base.

use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use graphfix::feeds::{
    ArchiveTemplate, Connector, FetchPolicy, Fetched, NavigationSources, Validators, fetch,
};
use tokio::io::AsyncWriteExt;

use crate::support::casters::{
    HostileCaster, PATIENCE, answer, connector, drip, gzip, keep, request,
};
use crate::support::data;
use crate::support::doors::Doors;
use crate::support::drive::DRIVE;
use crate::support::streams::unpacked;
use crate::support::wait::until;

const LIMIT: usize = 100_000;

async fn fetched(wire: Vec<u8>) -> Result<Vec<u8>, &'static str> {
    let host = HostileCaster::answering(wire).await;
    let place = format!("http://127.0.0.1:{}/file?a=b", host.port).parse().unwrap();
    match fetch(&connector(None), &place, &Validators::default(), LIMIT).await {
        Ok(Fetched::New { content, .. }) => Ok(content),
        Ok(Fetched::Unchanged { .. }) => Err("UNCHANGED"),
        Err(error) => Err(error.code().name()),
    }
}

#[tokio::test]
async fn bodies_end_where_they_say() {
    assert_eq!(fetched(answer("200 OK\r\nContent-Length: 5", b"hello")).await.unwrap(), b"hello");
    assert_eq!(fetched(answer("200 OK\r\nContent-Length: 4", b"hello")).await.unwrap(), b"hell");
    assert_eq!(fetched(answer("200 OK", b"hello")).await.unwrap(), b"hello");
    let chunks = b"2\r\nhe\r\n3\r\nllo\r\n0\r\n\r\n";
    let chunked = answer("200 OK\r\nTransfer-Encoding: chunked", chunks);
    assert_eq!(fetched(chunked.clone()).await.unwrap(), b"hello");
    assert_eq!(fetched(chunked[..chunked.len() - 7].to_vec()).await, Err("FILE_CUT"));
    assert_eq!(fetched(answer("200 OK\r\nContent-Length: 6", b"hello")).await, Err("FILE_CUT"));
    assert_eq!(fetched(answer("304 Not Modified", b"")).await, Err("UNCHANGED"));
}

#[tokio::test]
async fn hosts_that_misbehave_are_told_apart() {
    for (wire, code) in [
        (answer("404 Not Found", b""), "FILE_NOT_FOUND"),
        (answer("503 Busy\r\nRetry-After: 9", b""), "HOST_REFUSES"),
        (answer("302 Found\r\nLocation: http://169.254.169.254/x", b""), "HOST_REDIRECTS"),
        (answer("302 Found\r\nLocation: //127.0.0.2/x", b""), "HOST_REDIRECTS"),
        (answer("302 Found\r\nLocation: /again", b""), "HOST_REDIRECTS"), // Ever again.
        (answer("200 OK\r\nContent-Length: 9999999", b""), "FILE_TOO_LARGE"),
        (answer("200 OK", &vec![b'x'; 2 * LIMIT]), "FILE_TOO_LARGE"),
        (answer("200 OK\r\nContent-Length: -1", b""), "HOST_PROTOCOL"),
        (answer("200 OK\r\nTransfer-Encoding: chunked", b"zz\r\n"), "HOST_PROTOCOL"),
        (b"SSH-2.0-x\r\n".to_vec(), "HOST_PROTOCOL"),
        (answer(&format!("200 OK\r\n{}", "X: y\r\n".repeat(9000)), b""), "HOST_PROTOCOL"),
        (Vec::new(), "FILE_CUT"),
    ] {
        assert_eq!(
            fetched(wire.clone()).await,
            Err(code),
            "{:?}",
            String::from_utf8_lossy(&wire[..wire.len().min(60)])
        );
    }
    let drips = HostileCaster::start(|_, stream, _| {
        let piece = b"HTTP/1.1 200 OK\r\nX: y\r\n\r\nz".to_vec();
        drip(stream, std::iter::repeat(piece), Duration::from_millis(100))
    })
    .await;
    let place = format!("http://127.0.0.1:{}/", drips.port).parse().unwrap();
    let start = Instant::now();
    let slow = fetch(&connector(None), &place, &Validators::default(), LIMIT).await.unwrap_err();
    assert_eq!(slow.code().name(), "HOST_SLOW");
    assert!(start.elapsed() < PATIENCE.listing + Duration::from_secs(1));
    let nobody = Connector::new(FetchPolicy::new(&[], false).unwrap(), PATIENCE, None).unwrap();
    let refused = fetch(&nobody, &place, &Validators::default(), LIMIT).await.unwrap_err();
    assert_eq!(refused.code().name(), "HOST_NOT_ALLOWED");
}

fn bring(doors: &Doors, sources: NavigationSources) {
    let own = Connector::new(sources.policy().unwrap(), PATIENCE, None).unwrap();
    doors.service.feeds().bring_navigation(sources, &own).unwrap();
}

/// One file per day: it is fetched, unpacked and stored; then it is fetched again only if it is
/// newer.
#[tokio::test]
async fn an_archive_is_asked_again_only_for_news() {
    let file = gzip(&DRIVE.navigation_file());
    let requests = Arc::new(Mutex::new(Vec::new()));
    let seen = requests.clone();
    let host = HostileCaster::start(move |_, mut stream, request| {
        seen.lock().unwrap().push(request.clone());
        let head = format!("200 OK\r\nETag: \"v1\"\r\nContent-Length: {}", file.len());
        let wire = match request.contains("If-None-Match: \"v1\"\r\n") {
            true => answer("304 Not Modified", b""),
            false => answer(&head, &file),
        };
        async move {
            stream.write_all(&wire).await.ok();
            stream.shutdown().await.ok();
        }
    })
    .await;
    let doors = Doors::open().await;
    let text = format!("http://127.0.0.1:{}/{{yyyy}}/BRDC_{{ddd}}.rnx.gz?token=secret", host.port);
    bring(
        &doors,
        NavigationSources {
            archives: vec![ArchiveTemplate::new(&text).unwrap()],
            interval: Duration::from_millis(300),
            streams: Vec::new(),
        },
    );
    let held = doors
        .until("/v1/navigation", |navigation| navigation["sources"][0]["state"] == "CURRENT")
        .await;
    let source = &held["sources"][0];
    assert_eq!((&source["kind"], source["name"].as_str()), (&"archive".into(), Some(&*text)));
    assert_eq!(source["ephemerides"], held["ephemerides"]);
    assert!(0 < held["ephemerides"].as_u64().unwrap(), "{held}");
    let from = held["satellites"][0]["source"].as_str().unwrap();
    // Other tenants see it, too.
    assert!(from.ends_with(".rnx.gz") && from.contains("/BRDC_"), "{from}");
    until("asked five times", async || host.connections.load(Ordering::SeqCst), |n| 5 <= *n).await;
    let requests = requests.lock().unwrap().clone();
    // Today and yesterday, then each again with its validator.
    assert!(requests[..2].iter().all(|request| !request.contains("If-None-Match")));
    assert!(requests[2..].iter().all(|request| request.contains("If-None-Match: \"v1\"")));
    let days: std::collections::BTreeSet<_> = requests.iter().map(|r| r.lines().next()).collect();
    assert_eq!(days.len(), 2, "{days:?}");
    let after = doors.get("/v1/navigation").await.1;
    assert_eq!(after["ephemerides"], held["ephemerides"]);
}

/// Wrong content of an archive is reported and has no other effect.
#[tokio::test]
async fn archives_that_fail_are_told() {
    let doors = Doors::open().await;
    let mut cut = gzip(&DRIVE.navigation_file());
    cut.truncate(cut.len() / 2);
    let bodies = [
        (answer("200 OK", &cut), "FILE_UNREADABLE"),
        (answer("200 OK", b"<html>not a file</html>"), "FILE_UNREADABLE"),
        (answer("404 Not Found", b""), "FILE_NOT_FOUND"),
    ];
    let mut hosts = Vec::new();
    let mut archives = Vec::new();
    for (wire, _) in &bodies {
        let host = HostileCaster::answering(wire.clone()).await;
        let text = format!("http://127.0.0.1:{}/x", host.port);
        archives.push(ArchiveTemplate::new(&text).unwrap());
        hosts.push(host);
    }
    let interval = Duration::from_secs(3600);
    bring(&doors, NavigationSources { archives, interval, streams: Vec::new() });
    for (index, (_, code)) in bodies.iter().enumerate() {
        let held = doors
            .until("/v1/navigation", |navigation| {
                navigation["sources"][index]["state"] == "WAITING"
            })
            .await;
        let source = &held["sources"][index];
        assert_eq!(source["problem"]["code"], *code, "{source}");
        assert!(1.0 < source["retryInS"].as_f64().unwrap(), "{source}");
        assert_eq!(hosts[index].connections.load(Ordering::SeqCst), 1);
    }
    assert_eq!(doors.get("/v1/navigation").await.1["ephemerides"], 0);
}

/// A caster's stream supplies ephemerides although it fills no base.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_stream_brings_ephemerides() {
    let Some(folder) = data::set("galway-static") else { return };
    let mut log = unpacked(&folder.join("rover-20181004-1237.ubx.gz"));
    log.truncate(150_000);
    let caster = HostileCaster::start(move |_, mut stream, _| {
        let log = log.clone();
        async move {
            stream.write_all(b"ICY 200 OK\r\n").await.unwrap();
            stream.write_all(&log).await.ok();
            keep(stream).await;
        }
    })
    .await;
    let doors = Doors::open().await;
    let streams = vec![request(caster.port, "EPH")];
    let interval = Duration::from_secs(3600);
    bring(&doors, NavigationSources { archives: Vec::new(), interval, streams });
    let held = doors
        .until("/v1/navigation", |navigation| 5 < navigation["ephemerides"].as_u64().unwrap())
        .await;
    assert_eq!(held["sources"][0]["kind"], "caster");
    assert_eq!(held["sources"][0]["state"], "STREAMING");
    let name = format!("ntrip://127.0.0.1:{}/EPH", caster.port);
    assert_eq!(held["sources"][0]["name"], *name);
    assert_eq!(held["satellites"][0]["source"], *name);
    doors.service.feeds().close().await;
    assert_eq!(doors.get("/v1/navigation").await.1["sources"], serde_json::json!([]));
}
