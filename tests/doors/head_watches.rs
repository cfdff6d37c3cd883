//! Watches of a fleet's heads, by both doors.

use std::collections::BTreeSet;
use std::time::Duration;

use graphfix::config::Limits;
use graphfix::contract::v1;
use graphfix::grpc::code_of;
use graphfix::grpc::v1::sessions_client::SessionsClient;
use serde_json::{Value, json};
use tokio::time::timeout;

use crate::support::doors::{Doors, code, epoch};
use crate::support::events::Events;

const PATH: &str = "/v1/sessions:watch";

/// The content of the next event, which has heads.
async fn heads(events: &mut Events) -> Value {
    let (name, content) = events.next().await.expect("the watch has ended");
    assert_eq!(name, "heads", "{content}");
    content
}

fn sessions(content: &Value) -> Vec<&str> {
    let heads = content["heads"].as_array().unwrap().iter();
    heads.map(|head| head["session"].as_str().unwrap()).collect()
}

/// All sessions come first, then those that change: by an epoch, a label, their end, or as new
/// sessions.
#[tokio::test]
async fn a_watch_has_all_heads_and_then_what_changes() {
    let doors = Doors::open().await;
    let (one, other) = (doors.session().await, doors.session().await);
    let mut events = Events::of(&doors, PATH).await;
    let first = heads(&mut events).await;
    assert_eq!(BTreeSet::from_iter(sessions(&first)), BTreeSet::from([&*one, &*other]));
    assert_eq!((&first["complete"], &first["gone"]), (&json!(true), &json!([])));

    doors.post(&format!("/v1/sessions/{one}/epochs"), json!({"epochs": [epoch(1)]})).await;
    let changed = heads(&mut events).await;
    assert_eq!(sessions(&changed), [&*one]);
    let (_, listed) = doors.get("/v1/sessions:heads?order=OLDEST_FIRST").await;
    let without_age = |head: &Value| {
        let mut head = head.clone();
        assert!(head.as_object_mut().unwrap().remove("ageS").is_some_and(|age| age.is_number()));
        head
    };
    assert_eq!(without_age(&changed["heads"][0]), without_age(&listed["heads"][0]));

    doors.send("PATCH", &format!("/v1/sessions/{other}"), json!({"label": "renamed"})).await;
    let renamed = heads(&mut events).await;
    assert_eq!(renamed["heads"][0]["label"], "renamed");
    doors.send("DELETE", &format!("/v1/sessions/{other}"), json!(null)).await;
    let closed = heads(&mut events).await;
    assert_eq!((&closed["heads"][0]["closed"], sessions(&closed).len()), (&json!(true), 1));
    let new = doors.session().await;
    assert_eq!(sessions(&heads(&mut events).await), [&*new]);
    doors.send("DELETE", &format!("/v1/sessions/{other}?purge=true"), json!(null)).await;
    let gone = heads(&mut events).await;
    assert_eq!((&gone["gone"], sessions(&gone).len()), (&json!([other]), 0));
}

/// A session that no longer matches the filter is reported as gone.
#[tokio::test]
async fn a_watch_has_a_filter() {
    let doors = Doors::open().await;
    let session = doors.session().await;
    let mut client = SessionsClient::new(doors.router.clone());
    let open = v1::WatchHeadsRequest { closed: Some(false), ..Default::default() };
    let mut watch = client.watch_heads(open).await.unwrap().into_inner();
    let mut next = async || {
        let message = timeout(Duration::from_secs(60), watch.message()).await;
        message.expect("the watch is silent").unwrap().expect("the watch has ended")
    };
    let first = next().await;
    assert_eq!((&*first.heads[0].session, first.complete), (&*session, true));
    doors.send("DELETE", &format!("/v1/sessions/{session}"), json!(null)).await;
    assert_eq!(next().await.gone, [session]);
}

/// There are more sessions than a message may have heads.
#[tokio::test]
async fn a_large_fleet_comes_in_several_messages() {
    const SESSIONS: usize = 501;
    let doors = Doors::open().await;
    let new = |index: usize| json!({"label": index.to_string()});
    for index in 0..SESSIONS {
        doors.post("/v1/sessions", new(index)).await;
    }
    let mut events = Events::of(&doors, PATH).await;
    let (first, second) = (heads(&mut events).await, heads(&mut events).await);
    assert_eq!((sessions(&first).len(), &first["complete"]), (500, &json!(false)));
    assert_eq!((sessions(&second).len(), &second["complete"]), (1, &json!(true)));
    let all: BTreeSet<&str> = sessions(&first).into_iter().chain(sessions(&second)).collect();
    assert_eq!(all.len(), SESSIONS);
}

#[tokio::test]
async fn watches_of_heads_are_limited_and_end_in_a_drain() {
    let doors = Doors::with(Limits { watches: 1, ..Limits::standard() }).await;
    let (status, refused) = doors.get(&format!("{PATH}?mode=%00")).await;
    assert_eq!((status.as_u16(), &refused["field"]), (400, &json!("mode")), "{refused}");
    let mut events = Events::of(&doors, PATH).await;
    assert_eq!(heads(&mut events).await["heads"], json!([]));
    let (status, refused) = doors.get(PATH).await;
    assert_eq!((status.as_u16(), code(&refused)), (429, "TOO_MANY_WATCHES"), "{refused}");
    let mut client = SessionsClient::new(doors.router.clone());
    let status = client.watch_heads(v1::WatchHeadsRequest::default()).await.unwrap_err();
    assert_eq!(code_of(&status).as_deref(), Some("TOO_MANY_WATCHES"));
    doors.service.drain();
    let (name, end) = events.next().await.unwrap();
    assert_eq!((&*name, code(&end)), ("end", "DRAINING"), "{end}");
    assert_eq!(events.next().await, None);
}
