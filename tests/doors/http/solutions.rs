//! `/v1/sessions/{session}/solutions`.

use axum::http::StatusCode;
use graphfix::contract::convert;
use graphfix::session::SequencedEpoch;
use serde_json::{Value, json};

use crate::support::doors::{Doors, epoch};
use crate::support::drive::DRIVE;

fn numbers(page: &Value) -> Vec<u64> {
    let solutions = page["solutions"].as_array().unwrap();
    solutions.iter().map(|solution| solution["seq"].as_u64().unwrap()).collect()
}

#[tokio::test]
async fn solutions_are_listed_by_time_status_and_page() {
    let doors = Doors::open().await;
    let session = doors.session().await;
    let epochs: Vec<_> = (1..=5).map(epoch).collect();
    doors.post(&format!("/v1/sessions/{session}/epochs"), json!({"epochs": epochs})).await;
    let path = format!("/v1/sessions/{session}/solutions");

    let (status, first) = doors.get(&format!("{path}?pageSize=3")).await;
    assert_eq!((status, numbers(&first)), (StatusCode::OK, vec![1, 2, 3]));
    let token = first["nextPageToken"].as_str().unwrap();
    let (_, second) = doors.get(&format!("{path}?pageSize=3&pageToken={token}")).await;
    assert_eq!((numbers(&second), &second["nextPageToken"]), (vec![4, 5], &json!("")));

    let (_, within) = doors.get(&format!("{path}?from=2051:46703&to=2051:46704.5")).await;
    assert_eq!(numbers(&within), [2, 3]);
    assert_eq!(numbers(&doors.get(&format!("{path}?status=NONE")).await.1).len(), 5);
    assert_eq!(numbers(&doors.get(&format!("{path}?status=SINGLE")).await.1), [0; 0]);
}

/// The latest answer to each epoch unless the query requires another one.
#[tokio::test]
async fn revisions_are_chosen() {
    let doors = Doors::open().await;
    let (status, _) = doors.upload("/v1/navigation", DRIVE.navigation_file()).await;
    assert_eq!(status, StatusCode::OK);
    let (_, session) = doors.post("/v1/sessions", json!({"mode": "fgo"})).await;
    let session = session["session"].as_str().unwrap();
    let message = |e: &SequencedEpoch| convert::epoch_message(e.seq, &e.epoch);
    let epochs: Vec<_> = DRIVE.epochs[..30].iter().map(message).collect();
    let (status, answer) =
        doors.post(&format!("/v1/sessions/{session}/epochs"), json!({"epochs": epochs})).await;
    assert_eq!((status, &answer["durableThrough"]), (StatusCode::OK, &json!(30)));
    let (status, closed) =
        doors.send("DELETE", &format!("/v1/sessions/{session}"), json!({})).await;
    assert_eq!((status, &closed["closed"]), (StatusCode::OK, &json!(true)));
    let listed = async |query: &str| {
        let path = format!("/v1/sessions/{session}/solutions{query}");
        let (status, page) = doors.get(&path).await;
        assert_eq!(status, StatusCode::OK, "{page}");
        let revision = |solution: &Value| solution["revision"].as_u64().unwrap();
        page["solutions"].as_array().unwrap().iter().map(revision).collect::<Vec<_>>()
    };
    assert_eq!(listed("").await, [1; 30]);
    assert_eq!(listed("?revisions=last").await, [1; 30]);
    assert_eq!(listed("?revisions=first").await, [0; 30]);
    assert_eq!(listed("?revisions=all").await, [0, 1].repeat(30));
    let (status, refused) =
        doors.get(&format!("/v1/sessions/{session}/solutions?revisions=ALL")).await;
    assert_eq!((status, &refused["field"]), (StatusCode::BAD_REQUEST, &json!("revisions")));
}
