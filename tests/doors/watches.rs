//! Watches of a session's solutions, by both doors.

use std::time::Duration;

use axum::body::Body;
use axum::http::Request;
use futures::StreamExt;
use graphfix::config::Limits;
use graphfix::contract::{calls, convert, v1};
use graphfix::grpc::code_of;
use graphfix::grpc::v1::solutions_client::SolutionsClient;
use serde_json::json;
use tokio::time::timeout;
use tonic::{Code, Status, Streaming};
use tower::ServiceExt;

use crate::support::doors::{Doors, epoch};
use crate::support::drive::DRIVE;
use crate::support::wait::until;

type Watch = Streaming<v1::WatchSolutionsResponse>;

fn request(session: &str) -> v1::WatchSolutionsRequest {
    v1::WatchSolutionsRequest { session: session.to_owned(), ..Default::default() }
}

async fn watched(doors: &Doors, request: v1::WatchSolutionsRequest) -> Result<Watch, Status> {
    let mut client = SolutionsClient::new(doors.router.clone());
    Ok(client.watch(request).await?.into_inner())
}

async fn message(watch: &mut Watch) -> Result<Option<v1::WatchSolutionsResponse>, Status> {
    timeout(Duration::from_secs(60), watch.message()).await.expect("the watch is silent")
}

/// Solutions until there are `count`, and the last cursor.
async fn taken(watch: &mut Watch, count: usize) -> (Vec<v1::Solution>, String) {
    let (mut solutions, mut cursor) = (Vec::new(), String::new());
    while solutions.len() < count {
        let message = message(watch).await.unwrap().expect("the watch has ended");
        solutions.extend(message.solutions);
        cursor = message.cursor;
    }
    (solutions, cursor)
}

async fn push(doors: &Doors, session: &str, range: std::ops::RangeInclusive<u64>) {
    let epochs = range.map(|seq| serde_json::from_value(epoch(seq)).unwrap()).collect();
    let push = v1::PushEpochsRequest { session: session.to_owned(), epochs };
    calls::positioning::push_epochs(&doors.caller(), push).await.unwrap();
}

async fn drive(doors: &Doors, session: &str, range: std::ops::Range<usize>) {
    let epochs = &DRIVE.epochs[range];
    let epochs = epochs.iter().map(|e| convert::epoch_message(e.seq, &e.epoch)).collect();
    let push = v1::PushEpochsRequest { session: session.to_owned(), epochs };
    calls::positioning::push_epochs(&doors.caller(), push).await.unwrap();
}

/// All revisions as stored, in the order of number and revision.
async fn listed(doors: &Doors, session: &str) -> Vec<v1::Solution> {
    let list = v1::ListSolutionsRequest {
        session: session.to_owned(),
        page_size: 10_000,
        revisions: v1::Revisions::All.into(),
        ..Default::default()
    };
    calls::solutions::list(&doors.caller(), list).await.unwrap().solutions
}

/// A watch breaks and resumes by its cursor, also over a restart of the service, until the session
/// is closed. It gets every answer and revision once.
#[tokio::test]
async fn a_watch_goes_on_behind_its_cursor() {
    let mut doors = Doors::open().await;
    doors.service.navigation().push(DRIVE.navigation.clone(), "test").await.unwrap();
    let create = json!({"mode": "fgo", "overrides": {"window_s": "10"}});
    let session = doors.post("/v1/sessions", create).await.1["session"].clone();
    let session = session.as_str().unwrap();
    drive(&doors, session, 0..10).await;
    let begin = v1::WatchSolutionsRequest { after_seq: Some(0), ..request(session) };
    let mut watch = watched(&doors, begin).await.unwrap();
    let (mut seen, _) = taken(&mut watch, 10).await;
    drive(&doors, session, 10..25).await;
    let (live, cursor) = taken(&mut watch, 15).await;
    seen.extend(live);
    drop(watch);
    drive(&doors, session, 25..60).await;
    doors = doors.restarted().await;
    let resumed = v1::WatchSolutionsRequest { cursor, ..request(session) };
    let mut watch = watched(&doors, resumed).await.unwrap();
    drive(&doors, session, 60..70).await;
    doors.send("DELETE", &format!("/v1/sessions/{session}"), json!(null)).await;
    let mut is_closed = false;
    while let Some(message) = message(&mut watch).await.unwrap() {
        seen.extend(message.solutions);
        is_closed = message.closed;
    }
    assert!(is_closed, "the last message");
    let mut in_order = seen.clone();
    in_order.sort_by_key(|solution| (solution.seq, solution.revision));
    let stored = listed(&doors, session).await;
    assert!(stored.iter().any(|solution| solution.revision == 1));
    assert_eq!(in_order.len(), stored.len(), "missed or doubled");
    assert_eq!(in_order, stored);
}

/// Without a cursor a watch begins at the present. A watch may ask for no revisions.
#[tokio::test]
async fn a_watch_begins_at_the_present() {
    let doors = Doors::open().await;
    let session = doors.session().await;
    push(&doors, &session, 1..=3).await;
    let first = v1::Revisions::First.into();
    let begin = v1::WatchSolutionsRequest { revisions: first, ..request(&session) };
    let mut watch = watched(&doors, begin).await.unwrap();
    let opened = message(&mut watch).await.unwrap().unwrap();
    assert!(opened.solutions.is_empty() && opened.cursor == "3.0", "{opened:?}");
    push(&doors, &session, 3..=5).await; // Epoch 3 is resent.
    let (solutions, cursor) = taken(&mut watch, 2).await;
    let numbers: Vec<u64> = solutions.iter().map(|solution| solution.seq).collect();
    assert_eq!((numbers, &*cursor), (vec![4, 5], "5.0"));
    doors.service.drain();
    let status = loop {
        match message(&mut watch).await {
            Ok(more) => assert!(more.unwrap().solutions.is_empty()),
            Err(status) => break status,
        }
    };
    assert_eq!(code_of(&status).as_deref(), Some("DRAINING"));
}

/// A watch that still reads earlier solutions also ends when the service drains, before it has read
/// all.
#[tokio::test]
async fn a_watch_of_the_past_ends_in_a_drain() {
    let doors = Doors::open().await;
    let session = doors.session().await;
    push(&doors, &session, 1..=400).await;
    let begin = v1::WatchSolutionsRequest { after_seq: Some(0), ..request(&session) };
    let mut watch = watched(&doors, begin).await.unwrap();
    let (first, _) = taken(&mut watch, 1).await;
    doors.service.drain();
    let mut solutions = first.len();
    let status = loop {
        match message(&mut watch).await {
            Ok(more) => solutions += more.unwrap().solutions.len(),
            Err(status) => break status,
        }
    };
    assert_eq!(code_of(&status).as_deref(), Some("DRAINING"));
    assert!(solutions < 400, "{solutions}");
}

#[tokio::test]
async fn a_wrong_watch_is_refused() {
    let doors = Doors::with(Limits { watches: 1, ..Limits::standard() }).await;
    let session = doors.session().await;
    let good = || request(&session);
    let cases = [
        (request("ses_0"), "SESSION_NOT_FOUND"),
        (v1::WatchSolutionsRequest { cursor: "x".to_owned(), ..good() }, "CURSOR_INVALID"),
        (v1::WatchSolutionsRequest { cursor: "1000.0".to_owned(), ..good() }, "CURSOR_INVALID"),
        (
            v1::WatchSolutionsRequest { cursor: "1.0".to_owned(), after_seq: Some(1), ..good() },
            "INVALID_FIELD",
        ),
        (
            v1::WatchSolutionsRequest { revisions: v1::Revisions::Last.into(), ..good() },
            "INVALID_FIELD",
        ),
    ];
    for (wrong, expected) in cases {
        let status = watched(&doors, wrong).await.unwrap_err();
        assert_eq!(code_of(&status).as_deref(), Some(expected));
    }
    let _watch = watched(&doors, good()).await.unwrap();
    let status = watched(&doors, good()).await.unwrap_err();
    assert_eq!(status.code(), Code::ResourceExhausted);
    assert_eq!(code_of(&status).as_deref(), Some("TOO_MANY_WATCHES"));
}

/// The watch of a reader that takes nothing is ended, with the cursor to continue. Others get
/// everything.
#[tokio::test]
async fn a_slow_reader_is_shed() {
    let limits = Limits { body_silence_s: 1, live_solutions: 8, ..Limits::standard() };
    let doors = Doors::with(limits).await;
    let session = doors.session().await;
    let mut slow = watched(&doors, request(&session)).await.unwrap();
    let mut quick = watched(&doors, request(&session)).await.unwrap();
    for seq in 1..=40 {
        push(&doors, &session, seq..=seq).await;
        let (solutions, _) = taken(&mut quick, 1).await;
        assert_eq!(solutions[0].seq, seq);
    }
    tokio::time::sleep(Duration::from_millis(1200)).await;
    let (mut last, mut cursor) = (0, String::new());
    let status = loop {
        match message(&mut slow).await {
            Ok(message) => {
                let message = message.unwrap();
                last = message.solutions.last().map_or(last, |solution| solution.seq);
                cursor = message.cursor;
            }
            Err(status) => break status,
        }
    };
    assert!(last < 40);
    assert_eq!(code_of(&status).as_deref(), Some("WATCH_TOO_SLOW"));
    let again = v1::WatchSolutionsRequest { cursor, ..request(&session) };
    let mut watch = watched(&doors, again).await.unwrap();
    let (solutions, _) = taken(&mut watch, 40 - last as usize).await;
    let numbers: Vec<u64> = solutions.iter().map(|solution| solution.seq).collect();
    assert_eq!(numbers, (last + 1..=40).collect::<Vec<_>>());
    drop((watch, quick, slow));
    let budget = async || doors.service.budget().used();
    until("returned to the budget", budget, |used| *used == 0).await;
}

/// Each server-sent event has its solutions and an id, with which a browser continues.
#[tokio::test]
async fn browsers_watch_by_events() {
    let doors = Doors::open().await;
    let session = doors.session().await;
    push(&doors, &session, 1..=3).await;
    let path = format!("/v1/sessions/{session}/solutions:watch");
    let ask = Request::get(&path).header("last-event-id", "1.0").body(Body::empty()).unwrap();
    let response = doors.router.clone().oneshot(ask).await.unwrap();
    assert_eq!(response.headers()["content-type"], "text/event-stream");
    doors.send("DELETE", &format!("/v1/sessions/{session}"), json!(null)).await;
    let mut text = String::new();
    let mut body = response.into_body().into_data_stream();
    while let Some(bytes) = timeout(Duration::from_secs(60), body.next()).await.unwrap() {
        text.push_str(std::str::from_utf8(&bytes.unwrap()).unwrap());
    }
    let events: Vec<&str> = text.split("\n\n").collect();
    let of =
        |name: &str| events.iter().filter(|event| event.lines().any(|line| line == name)).count();
    assert!(0 < of("event: solutions") && of("event: closed") == 1, "{text}");
    assert!(text.contains("id: 3.0\n"), "{text}");
    let seqs = |seq: u64| text.matches(&format!("{{\"seq\":{seq},\"revision\":0")).count();
    assert_eq!([seqs(1), seqs(2), seqs(3)], [0, 1, 1], "{text}");
    let (status, problem) = doors.get(&format!("{path}?cursor=x")).await;
    assert_eq!((status.as_u16(), problem["code"].as_str()), (400, Some("CURSOR_INVALID")));
}
