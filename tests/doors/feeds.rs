//! Bases that casters fill, end to end: through `str2str`, and through casters that misbehave.

use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use graphfix::aiding::bases::BaseId;
use graphfix::config::Limits;
use graphfix::contract::{calls, convert, v1};
use graphfix::formats::receiver::{Decoder, Event, TimeReference};
use graphfix::gnss::{Epoch, GpsTime};
use serde_json::{Value, json};
use tokio::io::AsyncWriteExt;
use tokio::sync::watch;

use crate::support::casters::{BRISK, CONTENT, HostileCaster, Str2str, drip, keep};
use crate::support::device::{NEAR, fixed, logs, push, relative};
use crate::support::doors::Doors;
use crate::support::server::free_port;
use crate::support::streams::{decode, epochs, navigation};
use crate::support::wait::{stays, until};

/// A base that a caster on this machine fills.
async fn base_of(doors: &Doors, port: u16, user: &str, password: &str) -> String {
    let near: v1::GpsTime = NEAR.into();
    let near = json!({"week": near.week, "nsOfWeek": near.ns_of_week});
    let caster = format!("ntrip://127.0.0.1:{port}");
    let ntrip = json!({
        "caster": caster, "mountpoint": "BASE", "user": user, "password": password, "near": near
    });
    let (status, base) = doors.post("/v1/bases", json!({"ntrip": ntrip})).await;
    assert_eq!(status.as_u16(), 201, "{base}");
    assert!(!base.to_string().contains("secret"), "the password is shown: {base}");
    base["base"].as_str().unwrap().to_owned()
}

fn path(base: &str) -> String {
    format!("/v1/bases/{base}")
}

async fn feed(doors: &Doors, base: &str) -> Value {
    doors.get(&path(base)).await.1["feed"].clone()
}

/// Waits until the feed satisfies a condition.
async fn feed_once(doors: &Doors, base: &str, is_so: impl Fn(&Value) -> bool) -> Value {
    doors.until(&path(base), |base| is_so(&base["feed"])).await["feed"].clone()
}

async fn session(doors: &Doors, base: &str) -> String {
    session_of(doors, base, "rtk-fgo", &[]).await
}

async fn session_of(doors: &Doors, base: &str, mode: &str, options: &[(&str, &str)]) -> String {
    let options = options.iter().map(|(key, value)| ((*key).to_owned(), (*value).to_owned()));
    let new = v1::CreateSessionRequest {
        mode: mode.to_owned(),
        profile: "static".to_owned(),
        overrides: options.collect(),
        base: base.to_owned(),
        ..Default::default()
    };
    calls::sessions::create(&doors.caller(), new).await.unwrap().0.session
}

fn second(solution: &v1::Solution) -> f64 {
    solution.time.unwrap().ns_of_week as f64 * 1e-9
}

/// End to end: `str2str` plays the base's log, a device sends its receiver's bytes, and no file is
/// uploaded. Then the caster stops and the session reports the missing base; the caster starts
/// again, and the session is fixed again.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_device_and_a_caster_are_enough() {
    let Some((rover, base_log)) = logs() else { return };
    let doors = Doors::open().await;
    let port = free_port();
    let mut caster = Str2str::start_at("BASE", port).await;
    let base = base_of(&doors, port, Str2str::NAME, Str2str::PASSWORD).await;
    feed_once(&doors, &base, |feed| feed["state"] == "STREAMING").await;

    let (first, rest) = base_log.split_at(base_log.len() / 2);
    caster.play(&doors, &base, first).await;
    let held = doors.get(&format!("/v1/bases/{base}")).await.1;
    assert_eq!(held["site"]["source"], "message", "{held}");
    assert_eq!(held["feed"]["connections"], 1);
    let kinds: Vec<&str> = held["feed"]["messages"]
        .as_array()
        .unwrap()
        .iter()
        .map(|total| total["kind"].as_str().unwrap())
        .collect();
    assert!(kinds.contains(&"RTCM 1077") && kinds.contains(&"RTCM 1005"), "{kinds:?}");

    let session = session(&doors, &base).await;
    let half = rover.len() / 2 + rover.len() / 10;
    let before = push(&doors, &session, 0, &rover[..half]).await;
    let start = second(&before[0]);
    let first_fix = before.iter().find(|s| s.status() == v1::Status::Fixed).map(second);
    let since_s = first_fix.unwrap_or(f64::INFINITY) - start;
    eprintln!("first fix after {since_s:.0} s, {} of {} fixed", fixed(&before), before.len());
    let stale = before.last().unwrap();
    let reasons: Vec<&str> = stale.reasons.iter().map(|reason| reason.code.as_str()).collect();
    assert!(reasons.contains(&"BASE_STALE"), "{reasons:?} at {}", second(stale));
    assert_ne!(stale.status(), v1::Status::Fixed);

    drop(caster);
    let lost = feed_once(&doors, &base, |feed| feed["state"] != "STREAMING").await;
    assert!(lost["problem"]["code"].is_string(), "{lost}");
    let granted = lost["connections"].as_u64().unwrap();
    let (begin, attempts) = (Instant::now(), |feed: &Value| feed["attempts"].as_u64().unwrap());
    let waiting = feed_once(&doors, &base, |feed| attempts(&lost) + 5 <= attempts(feed)).await;
    // Five delays, the last four of which are 100 to 800 ms, reduced at random by up to half.
    assert!(Duration::from_millis(700) < begin.elapsed(), "asked without a pause");
    assert_eq!(waiting["problem"]["code"], "HOST_UNREACHABLE", "{waiting}");

    let mut caster = Str2str::start_at("BASE", port).await;
    feed_once(&doors, &base, |feed| feed["state"] == "STREAMING").await;
    caster.play(&doors, &base, rest).await;
    assert_eq!(feed(&doors, &base).await["connections"], granted + 1);
    let after = push(&doors, &session, half, &rover[half..]).await;
    eprintln!("after the break {} of {} fixed", fixed(&after), after.len());
    assert!(since_s <= 60.0, "first fix after {since_s} s");
    assert!(after.len() / 2 < fixed(&after), "{} of {}", fixed(&after), after.len());
}

/// Two bases of one stream and two hundred sessions have one connection. When the last base is
/// deleted, the connection is closed.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn one_connection_serves_everybody() {
    let Some((_, base_log)) = logs() else { return };
    let doors = Doors::open().await;
    let (ended, mut ends) = tokio::sync::mpsc::unbounded_channel();
    let log = base_log[..200_000].to_vec();
    let caster = HostileCaster::start(move |_, mut stream, _| {
        let (log, ended) = (log.clone(), ended.clone());
        async move {
            stream.write_all(b"ICY 200 OK\r\n").await.unwrap();
            let pieces: Vec<_> = log.chunks(1000).map(<[u8]>::to_vec).collect();
            drip(stream, pieces.into_iter().cycle(), Duration::from_millis(5)).await;
            ended.send(()).ok();
        }
    })
    .await;
    let bases =
        [base_of(&doors, caster.port, "", "").await, base_of(&doors, caster.port, "", "").await];
    for index in 0..200 {
        session(&doors, &bases[index % 2]).await;
    }
    for base in &bases {
        doors.until(&path(base), |base| 3 <= base["epochs"].as_u64().unwrap()).await;
    }
    assert_eq!(caster.connections.load(Ordering::SeqCst), 1);
    let sessions = doors.get("/v1/sessions?pageSize=1000&view=BASIC").await.1;
    for session in sessions["sessions"].as_array().unwrap() {
        let path = format!("/v1/sessions/{}", session["session"].as_str().unwrap());
        doors.send("DELETE", &path, json!({})).await;
    }
    for base in &bases {
        let (status, answer) = doors.send("DELETE", &format!("/v1/bases/{base}"), json!({})).await;
        assert_eq!(status.as_u16(), 200, "{answer}");
    }
    tokio::time::timeout(Duration::from_secs(10), ends.recv()).await.unwrap().unwrap();
    assert_eq!(caster.connections.load(Ordering::SeqCst), 1);
}

/// The data of a caster: bytes of a log, while it runs.
#[derive(Clone, Copy)]
struct Air {
    lives: bool,
    /// New clients receive the log from this offset …
    from: usize,
    /// … to this one.
    until: usize,
}

/// A caster that sends current data and records the times of requests.
async fn station(
    log: Vec<u8>,
    air: &watch::Sender<Air>,
) -> (HostileCaster, Arc<Mutex<Vec<Instant>>>) {
    let asked: Arc<Mutex<Vec<Instant>>> = Arc::default();
    let (noting, air) = (asked.clone(), air.subscribe());
    let caster = HostileCaster::start(move |_, mut stream, _| {
        noting.lock().unwrap().push(Instant::now());
        let (mut air, log) = (air.clone(), log.clone());
        async move {
            let Air { lives, from: mut sent, .. } = *air.borrow_and_update();
            if lives {
                stream.write_all(b"ICY 200 OK\r\n").await.unwrap();
            }
            loop {
                let Air { lives, until, .. } = *air.borrow_and_update();
                if !lives || stream.write_all(&log[sent..until.max(sent)]).await.is_err() {
                    return;
                }
                sent = until.max(sent);
                if air.changed().await.is_err() {
                    return;
                }
            }
        }
    })
    .await;
    (caster, asked)
}

/// Offset in a log after all epochs before a second of the week.
fn place_in(log: &[u8], second: f64) -> usize {
    let mut decoder = Decoder::new(Some(TimeReference::Day(NEAR)));
    let mut events = Vec::new();
    for (index, piece) in log.chunks(250).enumerate() {
        decoder.push(piece, &mut events);
        let is_past = |event: &Event| match event {
            Event::Epoch(epoch) => second <= epoch.time.seconds_of_week(),
            _ => false,
        };
        if events.drain(..).any(|event| is_past(&event)) {
            return (index + 1) * 250;
        }
    }
    panic!("the log ends before {second}")
}

/// Waits until a base has an epoch of a second of the week.
async fn until_held(doors: &Doors, base: &str, second: f64) {
    let base = BaseId::parse(base).unwrap();
    let span = async || doors.service.bases().get(&base).await.unwrap().span;
    let reaches = |span: &Option<(GpsTime, GpsTime)>| {
        span.is_some_and(|(_, newest)| second <= newest.seconds_of_week())
    };
    until("held", span, reaches).await;
}

/// The latest answers of each session to some epochs.
async fn last_answers(
    doors: &Doors,
    sessions: &[String],
    first_seq: u64,
    epochs: &[Epoch],
) -> Vec<v1::Solution> {
    let numbered = (first_seq..).zip(epochs);
    let messages: Vec<v1::Epoch> =
        numbered.map(|(seq, e)| convert::epoch_message(seq, e)).collect();
    let mut answers = Vec::new();
    for session in sessions {
        let push = v1::PushEpochsRequest { session: session.clone(), epochs: messages.clone() };
        let answer = calls::positioning::push_epochs(&doors.caller(), push).await.unwrap();
        assert_eq!(answer.durable_through, Some(first_seq + epochs.len() as u64 - 1));
        answers.push(answer.results.into_iter().next_back().unwrap().solution.unwrap());
    }
    answers
}

/// The caster is down for 30 s on the service's time scale, of which the test takes a twentieth,
/// while two hundred sessions use it. Each session reports that its base is stale, and each is
/// fixed again. The caster receives only the requests that the backoff allows, on one connection.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_caster_that_dies_is_missed_and_comes_back() {
    let Some((rover_log, base_log)) = logs() else { return };
    let doors = Doors::with_feeds(Limits::standard(), CONTENT).await;
    let events = decode(&rover_log[..rover_log.len() / 4], None).0;
    doors.service.navigation().push(navigation(&events), "test").await.unwrap();
    let mut rover = epochs(events);
    // The base's stream contains its position from 391166 on.
    rover.retain(|epoch| 391_199.5 < epoch.time.seconds_of_week());
    let start = rover[0].time.seconds_of_week().round();
    let at = |second: f64| place_in(&base_log, start + second);
    let (air, _) = watch::channel(Air { lives: true, from: 0, until: at(7.0) });
    let (caster, asked) = station(base_log.clone(), &air).await;
    let base = base_of(&doors, caster.port, "", "").await;
    let options = [("differencing.base_age_max_s", "5")];
    let mut sessions = Vec::new();
    for _ in 0..200 {
        sessions.push(session_of(&doors, &base, "rtk-ekf", &options).await);
    }
    until_held(&doors, &base, start + 7.0).await;
    assert_eq!(relative(&last_answers(&doors, &sessions, 1, &rover[..7]).await), 200);
    // After a connection that lasts this long the next request has no delay of earlier failures.
    let asked_times = async || asked.lock().unwrap().len();
    stays("asked once", BRISK.steady, asked_times, |times| *times == 1).await;

    let death = Instant::now();
    air.send_modify(|air| air.lives = false);
    let stale = last_answers(&doors, &sessions, 8, &rover[20..21]).await;
    for answer in &stale {
        let codes: Vec<&str> = answer.reasons.iter().map(|reason| reason.code.as_str()).collect();
        assert!(codes.contains(&"BASE_STALE"), "{codes:?}");
    }
    assert_eq!((relative(&stale), stale.len()), (0, 200));
    until("asked again and again", asked_times, |times| 5 <= *times).await;
    let told = feed(&doors, &base).await;
    assert_eq!(told["problem"]["code"], "CASTER_CLOSED", "{told}");

    air.send_replace(Air { lives: true, from: at(20.0), until: at(41.0) });
    until_held(&doors, &base, start + 40.0).await;
    assert_eq!(relative(&last_answers(&doors, &sessions, 9, &rover[25..40]).await), 200);
    let times = asked.lock().unwrap().clone();
    let mut delay = BRISK.delay;
    for pair in [&[death], &times[1..]].concat().windows(2) {
        let gap = pair[1] - pair[0];
        // The limit has one second more, for a busy machine.
        let bounds = delay / 2..delay + Duration::from_secs(1);
        assert!(bounds.contains(&gap), "asked after {gap:?}, not {bounds:?}");
        delay = (2 * delay).min(BRISK.delay_ceiling);
    }
    assert!(3 < times.len(), "asked {} times", times.len());
    let told = feed(&doors, &base).await;
    assert_eq!(told["connections"], 2, "{told}");
    assert_eq!(told["attempts"], times.len(), "{told}");
}

/// The code of each caster that misbehaves; it is not contacted continuously.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn casters_that_misbehave_are_told_and_left_alone() {
    let doors = Doors::open().await;
    let silent = HostileCaster::start(|_, mut stream, _| async move {
        stream.write_all(b"ICY 200 OK\r\n").await.unwrap();
        keep(stream).await;
    })
    .await;
    let garbage = HostileCaster::start(|_, mut stream, _| async move {
        stream.write_all(b"HTTP/1.1 200 OK\r\n\r\n").await.unwrap();
        let piece = vec![0xd3, 0, 4, 0xb5, 0x62, 1, 2, b'$'];
        drip(stream, std::iter::repeat(piece), Duration::from_millis(1)).await;
    })
    .await;
    let cut = HostileCaster::answering("ICY 200 OK\r\n\u{3}").await;
    let busy = HostileCaster::answering("HTTP/1.1 503 Busy\r\nRetry-After: 1\r\n\r\n").await;
    let wrong = HostileCaster::answering("HTTP/1.1 401 Unauthorized\r\n\r\n").await;
    let mut asked = Vec::new();
    for (caster, code, most) in [
        (&silent, "CASTER_SILENT", 4),
        (&garbage, "CASTER_NO_EPOCHS", 3),
        (&cut, "CASTER_CLOSED", 20),
        (&busy, "CASTER_TRY_LATER", 5),
        (&wrong, "CASTER_UNAUTHORISED", 7),
    ] {
        asked.push((base_of(&doors, caster.port, "", "").await, caster, code, most));
    }
    for (base, caster, code, most) in asked {
        let feed = feed_once(&doors, &base, |feed| feed["problem"]["code"] == code).await;
        assert!(!feed["problem"]["remedy"].as_str().unwrap().is_empty());
        let connections = caster.connections.load(Ordering::SeqCst);
        assert!((1..=most).contains(&connections), "{code}: {connections} connections");
    }
}
