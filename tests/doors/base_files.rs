//! Bases that an archive's files fill, each fetched when a session needs it.

use std::collections::BTreeMap;
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use graphfix::contract::{calls, convert, v1};
use graphfix::formats::rinex::write_navigation;
use graphfix::gnss::{GpsTime, LeapSeconds};
use graphfix::grpc::v1::bases_client::BasesClient;
use serde_json::{Value, json};
use tokio::io::AsyncWriteExt;
use tokio::sync::watch;

use crate::support::casters::{HostileCaster, answer, gzip};
use crate::support::data;
use crate::support::doors::{Doors, code};
use crate::support::pair::{PAIR, Pair, simulated};
use crate::support::reading::epochs_of;
use crate::support::streams::unpacked;
use crate::support::wait::{stays, until};

/// The pair around six o'clock: 75 epochs of one hour, 75 of the next.
fn around_six() -> Pair {
    simulated(PAIR.base[0].time - 75.0)
}

/// An archive that answers each path with the listed content, otherwise with 404.
/// The requested paths, in order.
struct Archive {
    host: HostileCaster,
    asked: Arc<Mutex<Vec<String>>>,
    files: Arc<Mutex<BTreeMap<String, Vec<u8>>>>,
    /// Whether the archive answers, or lets clients wait.
    opening: watch::Sender<bool>,
}

impl Archive {
    async fn start() -> Self {
        let asked = Arc::new(Mutex::new(Vec::new()));
        let files: Arc<Mutex<BTreeMap<String, Vec<u8>>>> = Arc::default();
        let (noted, listed) = (asked.clone(), files.clone());
        let (opening, open) = watch::channel(true);
        let host = HostileCaster::start(move |_, mut stream, request| {
            let path = request.split(' ').nth(1).unwrap().to_owned();
            let wire = listed.lock().unwrap().get(&path).cloned();
            noted.lock().unwrap().push(path);
            let wire = wire.unwrap_or_else(|| answer("404 Not Found", b""));
            let mut open = open.clone();
            async move {
                open.wait_for(|open| *open).await.unwrap();
                stream.write_all(&wire).await.ok();
                stream.shutdown().await.ok();
            }
        })
        .await;
        Self { host, asked, files, opening }
    }

    fn put(&self, path: &str, file: &[u8]) {
        let head = format!("200 OK\r\nContent-Length: {}", file.len());
        self.files.lock().unwrap().insert(path.to_owned(), answer(&head, file));
    }

    fn template(&self, path: &str) -> String {
        format!("http://127.0.0.1:{}{path}", self.host.port)
    }

    fn asked(&self) -> Vec<String> {
        self.asked.lock().unwrap().clone()
    }
}

async fn navigated(pair: &Pair) -> Doors {
    let doors = Doors::open().await;
    let mut file = Vec::new();
    write_navigation(&mut file, &pair.navigation).unwrap();
    assert_eq!(doors.upload("/v1/navigation", file).await.0.as_u16(), 200);
    doors
}

async fn base_of(doors: &Doors, template: &str) -> String {
    let (status, base) = doors.post("/v1/bases", json!({"archive": {"template": template}})).await;
    assert_eq!(status.as_u16(), 201, "{base}");
    let archive = &base["archive"];
    assert_eq!((&archive["template"], &archive["state"]), (&json!(template), &json!("CURRENT")));
    base["base"].as_str().unwrap().to_owned()
}

async fn session(doors: &Doors, base: &str) -> String {
    let new = v1::CreateSessionRequest {
        mode: "rtk-fgo".to_owned(),
        base: base.to_owned(),
        ..Default::default()
    };
    calls::sessions::create(&doors.caller(), new).await.unwrap().0.session
}

/// Positions some of the rover's epochs.
async fn push(
    doors: &Doors,
    session: &str,
    pair: &Pair,
    epochs: std::ops::Range<usize>,
) -> Vec<v1::Solution> {
    let message = |e: &graphfix::session::SequencedEpoch| convert::epoch_message(e.seq, &e.epoch);
    let epochs = pair.rover[epochs].iter().map(message).collect();
    let push = v1::PushEpochsRequest { session: session.to_owned(), epochs };
    let pushed = calls::positioning::push_epochs(&doors.caller(), push).await.unwrap();
    pushed.results.into_iter().map(|result| result.solution.unwrap()).collect()
}

fn lacks_base(solution: &v1::Solution) -> bool {
    solution.reasons.iter().any(|reason| reason.code == "BASE_MISSING")
}

fn path(base: &str) -> String {
    format!("/v1/bases/{base}")
}

fn count(archive: &Value, field: &str) -> u64 {
    archive[field].as_u64().unwrap_or_else(|| panic!("{field} of {archive}"))
}

/// The file of an hour is fetched when epochs of that hour arrive, the next file one minute before
/// its hour. The session continues meanwhile and is fixed from then on. No file is fetched twice,
/// also not after a restart. Both doors report the same.
#[tokio::test]
async fn hours_come_as_they_are_needed() {
    let pair = around_six();
    let archive = Archive::start().await;
    let (five, six) = pair.base.split_at(75);
    archive.put("/2026/001/base001f.26o.gz", &gzip(&pair.file_of(five, Some(pair.position))));
    archive.put("/2026/001/base001g.26o.gz", &gzip(&pair.file_of(six, Some(pair.position))));
    let doors = navigated(&pair).await;
    let template = archive.template("/{yyyy}/{ddd}/base{ddd}{h}.{yy}o.gz");
    let base = base_of(&doors, &template).await;
    let rover = session(&doors, &base).await;
    assert!(archive.asked().is_empty());

    let before = push(&doors, &rover, &pair, 0..5).await;
    assert!(before.iter().all(lacks_base), "{before:?}");
    let held = doors.until(&path(&base), |base| count(&base["archive"], "files") == 1).await;
    assert_eq!(held["site"]["source"], "header");
    let after = push(&doors, &rover, &pair, 5..70).await;
    assert!(!after.iter().any(lacks_base));
    let held = doors.until(&path(&base), |base| count(&base["archive"], "files") == 2).await;
    assert_eq!((&held["epochs"], &held["archive"]["epochs"]), (&json!(150), &json!(150)));
    let after = push(&doors, &rover, &pair, 70..150).await;
    let fixed = after.iter().filter(|s| s.status() == v1::Status::Fixed).count();
    assert!(70 < fixed, "{fixed} of {} fixed", after.len());

    let held = doors.until(&path(&base), |base| base["archive"]["state"] == "CURRENT").await;
    let told = &held["archive"];
    assert_eq!((count(told, "missing"), count(told, "requests")), (0, 2), "{told}");
    let last = archive.template("/2026/001/base001g.26o.gz");
    assert_eq!((&told["lastFile"], &told["problem"]), (&json!(last), &Value::Null), "{told}");
    let get = v1::GetBaseRequest { base: base.clone() };
    let by_grpc = BasesClient::new(doors.router.clone()).get(get).await.unwrap().into_inner();
    let by_rest: v1::Base = serde_json::from_value(held).unwrap();
    let typed = by_grpc.archive.unwrap();
    assert_eq!(typed.source_state(), v1::SourceState::Current);
    // JSON has the texts alone.
    let texts = v1::BaseArchive { source_state: 0, since_time: None, ..typed };
    assert_eq!(Some(texts), by_rest.archive);
    let expected = ["/2026/001/base001f.26o.gz", "/2026/001/base001g.26o.gz"];
    assert_eq!(archive.asked(), expected);

    let doors = doors.restarted().await;
    let rover = session(&doors, &base).await;
    assert!(!push(&doors, &rover, &pair, 0..60).await.iter().any(lacks_base));
    // The file of six o'clock ends after 75 s, which its header does not contain, so it is fetched
    // again.
    let asked = until("asked", async || archive.asked(), |asked| 2 < asked.len()).await;
    assert!(!asked[2..].contains(&expected[0].to_owned()), "{asked:?}");
}

/// The file is fetched once for any number of sessions, in every format.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn twenty_sessions_share_one_fetch() {
    let archive = Archive::start().await;
    archive.put("/day/2026-001.rnx", &PAIR.base_file(Some(PAIR.position)));
    let doors = navigated(&PAIR).await;
    let base = base_of(&doors, &archive.template("/day/{yyyy}-{ddd}.rnx")).await;
    let mut sessions = Vec::new();
    for _ in 0..20 {
        sessions.push(session(&doors, &base).await);
    }
    archive.opening.send_replace(false);
    let first = sessions.iter().map(|rover| push(&doors, rover, &PAIR, 0..1));
    futures::future::join_all(first).await;
    archive.opening.send_replace(true);
    doors.until(&path(&base), |base| count(&base["archive"], "files") == 1).await;
    let later = sessions.iter().map(|rover| push(&doors, rover, &PAIR, 1..30));
    for solutions in futures::future::join_all(later).await {
        assert!(!solutions.iter().any(lacks_base));
    }
    let connections = async || archive.host.connections.load(Ordering::SeqCst);
    stays("one connection", Duration::from_millis(500), connections, |n| *n == 1).await;
}

/// A file that does not exist yet is requested again at long intervals; when it exists, sessions
/// use it.
#[tokio::test]
async fn a_late_file_is_waited_for() {
    let archive = Archive::start().await;
    let doors = navigated(&PAIR).await;
    let base = base_of(&doors, &archive.template("/{yyyy}{mm}{dd}_{hh}{min}.rnx")).await;
    let rover = session(&doors, &base).await;
    push(&doors, &rover, &PAIR, 0..1).await;
    let held = doors.until(&path(&base), |base| 2 <= count(&base["archive"], "requests")).await;
    let told = &held["archive"];
    assert_eq!((&told["state"], count(told, "missing")), (&json!("WAITING"), 1), "{told}");
    assert_eq!(told["problem"]["code"], "FILE_NOT_FOUND", "{told}");
    assert!(told["problem"]["message"].as_str().unwrap().contains("20260101_0600.rnx"), "{told}");
    assert!(told["retryInS"].is_number(), "{told}");
    assert!(push(&doors, &rover, &PAIR, 1..3).await.iter().all(lacks_base));
    archive.put("/20260101_0600.rnx", &PAIR.base_file(Some(PAIR.position)));
    let held = doors.until(&path(&base), |base| base["archive"]["state"] == "CURRENT").await;
    assert_eq!((&held["archive"]["problem"], &held["epochs"]), (&Value::Null, &json!(150)));
    assert!(!push(&doors, &rover, &PAIR, 3..30).await.iter().any(lacks_base));
    // With delays of 50 ms to 0.8 s, and not once for each received epoch.
    assert!(archive.asked().len() < 30, "{:?}", archive.asked());
}

/// A file of another station is reported and has no other effect.
#[tokio::test]
async fn files_that_are_none_are_told() {
    let tomorrow = simulated(PAIR.base[0].time + 86_400.0);
    let cut = gzip(&PAIR.base_file(None));
    for (wire, expected) in [
        (answer("200 OK", b"<html>no file</html>"), "FILE_UNREADABLE"),
        (answer("200 OK", &cut[..cut.len() / 2]), "FILE_UNREADABLE"),
        (answer("200 OK\r\nContent-Length: 99999999", b""), "FILE_TOO_LARGE"),
        (answer("200 OK", &tomorrow.base_file(None)), "FILE_OF_OTHER_TIME"),
        (answer("200 OK", &PAIR.base_file(None)), "BASE_POSITION_MISSING"),
        (answer("302 Found\r\nLocation: http://169.254.169.254/x", b""), "HOST_REDIRECTS"),
        (answer("503 Busy\r\nRetry-After: 7", b""), "HOST_REFUSES"),
    ] {
        let archive = Archive::start().await;
        archive.files.lock().unwrap().insert("/001g?26".to_owned(), wire);
        let doors = navigated(&PAIR).await;
        let base = base_of(&doors, &archive.template("/{ddd}{h}?{yy}")).await;
        let rover = session(&doors, &base).await;
        push(&doors, &rover, &PAIR, 0..1).await;
        let held = doors.until(&path(&base), |base| !base["archive"]["problem"].is_null()).await;
        let told = &held["archive"];
        assert_eq!(told["problem"]["code"], expected, "{told}");
        assert_eq!((&held["epochs"], &told["state"]), (&json!(0), &json!("WAITING")), "{told}");
        if expected == "HOST_REFUSES" {
            assert!(5.0 < told["retryInS"].as_f64().unwrap(), "{told}");
        }
        let (status, _) = doors.send("DELETE", &format!("/v1/bases/{base}"), json!(null)).await;
        assert_eq!(status.as_u16(), 409, "a session names it");
    }
}

/// Only hosts that the operator lists are contacted, and only addresses with placeholders for the
/// day are accepted.
#[tokio::test]
async fn archives_that_may_not_be_asked_are_refused() {
    let doors = Doors::open().await;
    let ntrip = json!({"caster": "ntrip://127.0.0.1:1", "mountpoint": "M"});
    let allowed = "http://127.0.0.1/{yy}{ddd}";
    for (template, ntrip, expected, field) in [
        ("https://archive.example.org/{yy}{ddd}", Value::Null, "HOST_NOT_ALLOWED", "template"),
        ("http://127.0.0.1:80@evil.example/{yy}{ddd}", Value::Null, "LOCATION_INVALID", "template"),
        ("http://127.0.0.1/latest.rnx", Value::Null, "LOCATION_INVALID", "template"),
        ("http://127.0.0.1/{yy}{ddd}{what}", Value::Null, "LOCATION_INVALID", "template"),
        ("file:///etc/passwd", Value::Null, "LOCATION_INVALID", "template"),
        ("", Value::Null, "LOCATION_INVALID", "template"),
        (allowed, ntrip, "INVALID_FIELD", ""),
    ] {
        let request = json!({"archive": {"template": template}, "ntrip": ntrip});
        let (status, refused) = doors.post("/v1/bases", request).await;
        assert_eq!(code(&refused), expected, "{template}: {refused}");
        let field = if field.is_empty() { "archive" } else { "archive.template" };
        assert_eq!((status.is_client_error(), &refused["field"]), (true, &json!(field)));
    }
    assert_eq!(doors.get("/v1/bases").await.1["bases"], json!([]));
}

/// A base's epochs are numbered in order of time: older files are not requested, and this is
/// reported.
#[tokio::test]
async fn older_data_needs_another_base() {
    let pair = around_six();
    let archive = Archive::start().await;
    let (five, six) = pair.base.split_at(75);
    archive.put("/26001f", &pair.file_of(five, Some(pair.position)));
    archive.put("/26001g", &pair.file_of(six, Some(pair.position)));
    let doors = navigated(&pair).await;
    let base = base_of(&doors, &archive.template("/{yy}{ddd}{h}")).await;
    let (late, early) = (session(&doors, &base).await, session(&doors, &base).await);
    push(&doors, &late, &pair, 140..141).await;
    doors.until(&path(&base), |base| count(&base["archive"], "files") == 1).await;
    push(&doors, &early, &pair, 0..1).await;
    let held = doors.until(&path(&base), |base| !base["archive"]["refusal"].is_null()).await;
    let told = &held["archive"];
    assert_eq!(told["refusal"]["code"], "BASE_OUT_OF_ORDER", "{told}");
    assert!(told["refusal"]["remedy"].as_str().unwrap().contains("another base"), "{told}");
    assert_eq!(archive.asked(), ["/26001g"]);
    // The remedy recommends this.
    let other = base_of(&doors, &archive.template("/{yy}{ddd}{h}")).await;
    let early = session(&doors, &other).await;
    push(&doors, &early, &pair, 0..1).await;
    doors.until(&path(&other), |base| count(&base["archive"], "files") == 1).await;
    assert_eq!(archive.asked(), ["/26001g", "/26001f"]);
}

/// While a file cannot be fetched, newer files wait for some time: after newer epochs, older ones
/// cannot be added.
#[tokio::test]
async fn a_file_that_fails_is_not_overtaken() {
    let pair = around_six();
    let archive = Archive::start().await;
    let (five, six) = pair.base.split_at(75);
    archive.files.lock().unwrap().insert("/26001f".to_owned(), answer("503 Busy", b""));
    archive.put("/26001g", &pair.file_of(six, Some(pair.position)));
    let doors = navigated(&pair).await;
    let base = base_of(&doors, &archive.template("/{yy}{ddd}{h}")).await;
    let rover = session(&doors, &base).await;
    push(&doors, &rover, &pair, 0..100).await;
    doors.until(&path(&base), |base| 1 <= count(&base["archive"], "requests")).await;
    let asked = until("asked again", async || archive.asked(), |asked| 2 <= asked.len()).await;
    assert!(asked.iter().all(|path| path == "/26001f"), "{asked:?}");
    archive.put("/26001f", &pair.file_of(five, Some(pair.position)));
    let held = doors.until(&path(&base), |base| count(&base["archive"], "files") == 2).await;
    assert_eq!(held["epochs"], 150);
    assert_eq!(archive.asked().last().unwrap(), "/26001g");
}

/// A file of today is requested again while it grows, with its validator.
#[tokio::test]
async fn a_growing_file_is_followed() {
    let now = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap();
    let now = GpsTime::from_unix_ms(now.as_millis() as i64, &LeapSeconds::table());
    let day = GpsTime::from_ns(now.as_ns().div_euclid(86_400_000_000_000) * 86_400_000_000_000);
    let second = GpsTime::from_ns((now.as_ns() / 1_000_000_000 - 160) * 1_000_000_000);
    let pair = Arc::new(simulated(second.max(day)));
    let requests = Arc::new(Mutex::new(Vec::<String>::new()));
    let (seen, shown) = (requests.clone(), pair.clone());
    let host = HostileCaster::start(move |number, mut stream, request| {
        seen.lock().unwrap().push(request.clone());
        let epochs = if number < 2 { 60 } else { 150 };
        let wire = if request.contains(&format!("If-None-Match: \"{epochs}\"")) {
            answer("304 Not Modified", b"")
        } else {
            let file = gzip(&shown.file_of(&shown.base[..epochs], Some(shown.position)));
            answer(&format!("200 OK\r\nETag: \"{epochs}\""), &file)
        };
        async move {
            stream.write_all(&wire).await.ok();
            stream.shutdown().await.ok();
        }
    })
    .await;
    let doors = navigated(&pair).await;
    let template = format!("http://127.0.0.1:{}/{{yyyy}}/{{ddd}}.gz", host.port);
    let base = base_of(&doors, &template).await;
    let rover = session(&doors, &base).await;
    push(&doors, &rover, &pair, 0..1).await;
    let held = doors.until(&path(&base), |base| count(&base["archive"], "epochs") == 60).await;
    assert_eq!(held["archive"]["missing"], 1, "{held}");
    doors.until(&path(&base), |base| count(&base["archive"], "epochs") == 150).await;
    let held = doors.until(&path(&base), |base| 4 < count(&base["archive"], "requests")).await;
    assert_eq!((count(&held["archive"], "files"), &held["epochs"]), (2, &json!(150)), "{held}");
    let requests = requests.lock().unwrap().clone();
    assert!(!requests[0].contains("If-None-Match") && requests[1].contains("\"60\""));
    assert!(requests[4].contains("\"150\""), "{:?}", requests[4]);
}

/// The clock of the service is hours ahead of the host's. A file that still grows is not taken for
/// a complete one.
#[tokio::test]
async fn a_growing_file_is_followed_by_a_clock_that_is_ahead() {
    let host = HostileCaster::start(move |number, mut stream, _| {
        let (epochs, minute) = if number < 2 { (60, 1) } else { (150, 3) };
        let file = PAIR.file_of(&PAIR.base[..epochs], Some(PAIR.position));
        let date = format!("Date: Thu, 01 Jan 2026 06:0{minute}:00 GMT");
        let wire = answer(&format!("200 OK\r\n{date}"), &file);
        async move {
            stream.write_all(&wire).await.ok();
            stream.shutdown().await.ok();
        }
    })
    .await;
    let doors = navigated(&PAIR).await;
    let template = format!("http://127.0.0.1:{}/{{yyyy}}/{{ddd}}/{{hh}}", host.port);
    let base = base_of(&doors, &template).await;
    let rover = session(&doors, &base).await;
    push(&doors, &rover, &PAIR, 0..1).await;
    let held = doors.until(&path(&base), |base| count(&base["archive"], "epochs") == 150).await;
    assert_eq!(held["archive"]["missing"], 1, "the hour is not over for the host: {held}");
}

/// One real hour in the format of archives: CRINEX packed with gzip.
#[tokio::test]
async fn crinex_is_taken_as_archives_have_it() {
    let Some(folder) = data::set("formats") else { return };
    let name = "YEBE00ESP_R_20230891800_01H_30S_MO.crx.gz";
    let packed = std::fs::read(folder.join("crx3").join(name)).unwrap();
    let text = unpacked(&folder.join("crx3").join(name));
    let expected = epochs_of(&text);
    let archive = Archive::start().await;
    archive.put(&format!("/{name}"), &packed);
    let doors = Doors::open().await;
    let template = archive.template("/YEBE00ESP_R_{yyyy}{ddd}{hh}00_01H_30S_MO.crx.gz");
    let base = base_of(&doors, &template).await;
    let rover = session(&doors, &base).await;
    let epochs = vec![convert::epoch_message(1, &expected[0])];
    let push = v1::PushEpochsRequest { session: rover, epochs };
    calls::positioning::push_epochs(&doors.caller(), push).await.unwrap();
    let held = doors.until(&path(&base), |base| count(&base["archive"], "files") == 1).await;
    let missing = &held["archive"]["missing"];
    assert_eq!((&held["epochs"], missing), (&json!(expected.len()), &json!(0)));
    assert!(100 < expected.len(), "{}", expected.len());
}
