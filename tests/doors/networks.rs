//! Casters whose sourcetable lists bases: the stream nearest to a rover is connected while the
//! rover needs it.

use std::sync::{Arc, Mutex};
use std::time::Duration;

use graphfix::config::Limits;
use graphfix::contract::{calls, v1};
use graphfix::feeds::ntrip::Credentials;
use graphfix::feeds::{NetworkHealth, NetworkRequest, SourceState};
use serde_json::Value;
use tokio::io::{AsyncReadExt, AsyncWriteExt};

use crate::support::casters::{CONTENT, HostileCaster, Str2str};
use crate::support::device::{NEAR, fixed, logs, push};
use crate::support::doors::Doors;
use crate::support::wait::until;

/// Number of bytes of the rover's log after which its position is known.
const AT_FIRST: usize = 300_000;

/// Two streams of a station in Galway, 80 km apart, and unusable ones nearer than both.
const TABLE: &str = "SOURCETABLE 200 OK\r\nContent-Type: text/plain\r\n\r\n\
    STR;THERE;Athlone;RTCM 3.2;1005(10),1077(1);2;GPS;N;IRL;53.42;-7.94;0;0;x;none;N;N;9;\r\n\
    STR;HERE;Galway;RTCM 3.2;1005(10),1077(1),1087(1);2;GPS;N;IRL;53.28;-9.06;0;0;x;none;N;N;9;\r\n\
    STR;VRS;Virtual;RTCM 3.2;1077(1);2;GPS;N;IRL;53.28;-9.05;1;1;x;none;N;N;9;\r\n\
    STR;OLD;Galway;RTCM 2.3;1(1);2;GPS;N;IRL;53.28;-9.05;0;0;x;none;N;N;9;\r\n\
    ENDSOURCETABLE\r\n";

fn network(port: u16) -> NetworkRequest {
    NetworkRequest {
        caster: format!("ntrip://127.0.0.1:{port}").parse().unwrap(),
        credentials: None,
        near: Some(NEAR),
        table_interval: Duration::from_secs(3600),
        idle: Duration::from_secs(4),
        demand_interval: Duration::from_millis(50),
    }
}

const BASES: &str = "/v1/bases";

async fn nearest(doors: &Doors) -> String {
    let new = v1::CreateSessionRequest {
        mode: "rtk-fgo".to_owned(),
        profile: "static".to_owned(),
        base: "nearest".to_owned(),
        ..Default::default()
    };
    calls::sessions::create(&doors.caller(), new).await.unwrap().0.session
}

fn bases_of(solutions: &[v1::Solution]) -> Vec<String> {
    let base = |s: &v1::Solution| Some(s.provenance.as_ref()?.base.as_ref()?.base.clone());
    solutions.iter().filter_map(base).collect()
}

/// Two sessions, one connection to the nearest usable stream. It is closed when no rover needs it
/// and opened again when one does; the base stays the same.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_nearest_stream_is_connected_while_it_is_needed() {
    let Some((rover, base_log)) = logs() else { return };
    let (asked, ended) = (Arc::new(Mutex::new(Vec::new())), Arc::new(Mutex::new(0)));
    let (noted, given_up) = (asked.clone(), ended.clone());
    let base_log = Arc::new(base_log);
    let caster = HostileCaster::start(move |_, mut stream, request| {
        let (noted, given_up, base_log) = (noted.clone(), given_up.clone(), base_log.clone());
        async move {
            let path = request.split(' ').nth(1).unwrap().to_owned();
            noted.lock().unwrap().push(path.clone());
            if path == "/" {
                stream.write_all(TABLE.as_bytes()).await.unwrap();
                stream.shutdown().await.ok();
                return;
            }
            stream.write_all(b"ICY 200 OK\r\n").await.unwrap();
            // Err: the client has closed the connection.
            stream.write_all(&base_log).await.ok();
            stream.read_to_end(&mut Vec::new()).await.ok();
            *given_up.lock().unwrap() += 1;
        }
    })
    .await;
    let doors = Doors::with_feeds(Limits::standard(), CONTENT).await;
    doors.service.feeds().bring_bases(vec![network(caster.port)]).unwrap();
    let list = doors.until(BASES, |list| list["networks"][0]["state"] == "CURRENT").await;
    let health = &list["networks"][0];
    assert_eq!((&health["listed"], &health["usable"]), (&Value::from(4), &Value::from(2)));
    assert_eq!(list["bases"].as_array().unwrap().len(), 0, "nobody needs one");

    let (one, other) = (nearest(&doors).await, nearest(&doors).await);
    let alone = push(&doors, &one, 0, &rover[..AT_FIRST]).await;
    assert_eq!(bases_of(&alone[..1]), Vec::<String>::new(), "nobody knew where it is");
    let is_filled = |list: &Value| 300 < list["bases"][0]["epochs"].as_u64().unwrap_or(0);
    let list = doors.until(BASES, is_filled).await;
    let base = list["bases"][0]["base"].as_str().unwrap().to_owned();
    assert_eq!(list["bases"].as_array().unwrap().len(), 1);
    assert_eq!(
        (&list["bases"][0]["label"], &list["bases"][0]["feed"]["mountpoint"]),
        (&Value::from("Galway"), &Value::from("HERE"))
    );
    for session in [&one, &other] {
        let from = if session == &one { AT_FIRST } else { 0 };
        let solutions = push(&doors, session, from, &rover[from..2 * AT_FIRST]).await;
        let bases = bases_of(&solutions);
        assert!(bases.len() * 10 > solutions.len() * 5, "{} of {}", bases.len(), solutions.len());
        assert!(bases.iter().all(|used| *used == base));
        assert!(0 < fixed(&solutions));
    }
    assert_eq!(*asked.lock().unwrap(), ["/", "/HERE"], "one connection, and never there");

    let is_idle = |list: &Value| list["bases"][0]["feed"]["state"] == "IDLE";
    let list = doors.until(BASES, is_idle).await;
    assert_eq!(list["networks"][0]["connected"], 0);
    until("given up", async || *ended.lock().unwrap(), |ended| 0 < *ended).await;
    let held = list["bases"][0]["epochs"].clone();
    push(&doors, &one, 2 * AT_FIRST, &rover[2 * AT_FIRST..2 * AT_FIRST + 40_000]).await;
    let list = doors.until(BASES, |list| list["networks"][0]["connected"] == 1).await;
    assert_eq!(
        (&list["bases"][0]["base"], &list["bases"][0]["epochs"]),
        (&Value::from(base), &held)
    );
    doors.until(BASES, |_| *asked.lock().unwrap() == ["/", "/HERE", "/HERE"]).await;
    doors.service.feeds().close().await;
}

/// The caster of RTKLIB's `str2str`, which requires a password, and its sourcetable.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn str2str_brings_the_base_that_it_lists() {
    let Some((rover, base_log)) = logs() else { return };
    let mut caster = Str2str::start("BASE").await;
    let doors = Doors::with_feeds(Limits::standard(), CONTENT).await;
    let credentials =
        Credentials { name: Str2str::NAME.to_owned(), password: Str2str::PASSWORD.to_owned() };
    let request = NetworkRequest {
        credentials: Some(credentials),
        idle: Duration::from_secs(60),
        ..network(caster.port)
    };
    let feeds = doors.service.feeds();
    // If the caster does not listen yet, the table would be requested again only after half a
    // minute.
    let ask = async || {
        feeds.close().await;
        feeds.bring_bases(vec![request.clone()]).unwrap();
        let is_over = |h: &NetworkHealth| h.state != SourceState::Fetching;
        until("answered", async || feeds.networks(), |health| health.iter().all(is_over)).await
    };
    let is_current = |h: &NetworkHealth| h.state == SourceState::Current;
    let health = until("listening", ask, |health| health.iter().any(is_current)).await;
    assert_eq!((health[0].listed, health[0].usable), (1, 1), "{health:?}");
    let session = nearest(&doors).await;
    push(&doors, &session, 0, &rover[..AT_FIRST]).await;
    let is_streaming = |list: &Value| list["bases"][0]["feed"]["state"] == "STREAMING";
    let list = doors.until(BASES, is_streaming).await;
    assert!(!list.to_string().contains(Str2str::PASSWORD), "{list}");
    let base = list["bases"][0]["base"].as_str().unwrap().to_owned();
    caster.play(&doors, &base, &base_log).await;
    let is_filled = |list: &Value| 200 < list["bases"][0]["epochs"].as_u64().unwrap_or(0);
    let list = doors.until(BASES, is_filled).await;
    let solutions = push(&doors, &session, AT_FIRST, &rover[AT_FIRST..2 * AT_FIRST]).await;
    let bases = bases_of(&solutions);
    assert!(bases.iter().all(|used| list["bases"][0]["base"] == used.as_str()));
    assert!(solutions.len() < 2 * bases.len() && 0 < fixed(&solutions), "{}", bases.len());
}

/// A host that the operator does not list is not contacted; a caster without a table is reported.
#[tokio::test]
async fn casters_without_a_table_are_said() {
    let doors = Doors::open().await;
    let mut elsewhere = network(2101);
    elsewhere.caster = "ntrip://caster.example.org".parse().unwrap();
    let refused = doors.service.feeds().bring_bases(vec![elsewhere]).unwrap_err();
    assert_eq!(refused.code().name(), "HOST_NOT_ALLOWED");
    assert_eq!(doors.get(BASES).await.1["networks"], Value::from(Vec::<Value>::new()));
    let caster = HostileCaster::answering("HTTP/1.1 503 Busy\r\n\r\n").await;
    doors.service.feeds().bring_bases(vec![network(caster.port)]).unwrap();
    let list = doors.until(BASES, |list| list["networks"][0]["state"] == "WAITING").await;
    let health = &list["networks"][0];
    assert_eq!(health["problem"]["code"], "CASTER_TRY_LATER", "{health}");
    let retry_in_s = health["retryInS"].as_f64().unwrap();
    assert!((14.0..31.0).contains(&retry_in_s), "{retry_in_s}");
}
