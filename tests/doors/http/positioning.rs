//! Epochs in, solutions out.

use axum::http::StatusCode;
use serde_json::json;

use crate::support::doors::{Doors, code, epoch};

#[tokio::test]
async fn no_position_is_an_answer_and_a_resend_gets_it_again() {
    let doors = Doors::open().await;
    let path = format!("/v1/sessions/{}/epochs", doors.session().await);
    let push = json!({"epochs": [epoch(1), epoch(2)]});
    let (status, answer) = doors.post(&path, push.clone()).await;
    assert_eq!(status, StatusCode::OK, "{answer}");
    assert_eq!(answer["durableThrough"], 2);
    let solution = &answer["results"][0]["solution"];
    assert_eq!((&solution["status"], &solution["seq"]), (&json!("NONE"), &json!(1)));
    let reason = &solution["reasons"][0];
    assert_eq!(reason["code"], "EPHEMERIS_MISSING");
    assert_eq!(reason["values"]["satellites"], json!(["G05"]));
    assert_eq!(doors.post(&path, push).await, (StatusCode::OK, answer));
}

#[tokio::test]
async fn one_refusal_stops_no_other_epoch() {
    let doors = Doors::open().await;
    let path = format!("/v1/sessions/{}/epochs", doors.session().await);
    doors.post(&path, json!({"epochs": [epoch(1)]})).await;
    let mut other = epoch(1);
    other["observations"][0]["pseudorangeM"] = json!(2.3e7);
    let (status, answer) = doors.post(&path, json!({"epochs": [other.clone(), epoch(2)]})).await;
    assert_eq!(status, StatusCode::OK, "{answer}");
    let refusal = &answer["results"][0]["refusal"];
    assert_eq!((code(refusal), &refusal["field"]), ("SEQUENCE_CONFLICT", &json!("epochs[0].seq")));
    assert_eq!(answer["results"][1]["solution"]["seq"], 2);

    let (status, refused) = doors.post(&path, json!({"epochs": [other]})).await;
    assert_eq!((status, code(&refused)), (StatusCode::CONFLICT, "SEQUENCE_CONFLICT"));
}

/// GPS time begins on 1980-01-06; a receiver without a time may count from before it.
#[tokio::test]
async fn an_epoch_before_gps_time_is_refused() {
    let doors = Doors::open().await;
    let path = format!("/v1/sessions/{}/epochs", doors.session().await);
    let mut early = epoch(1);
    early["time"] = json!({"week": -1, "nsOfWeek": 604_799_999_999_999_u64});
    for path in [&*path, "/v1/solve"] {
        let (status, refused) = doors.post(path, json!({"epochs": [early.clone()]})).await;
        let expected = (StatusCode::CONFLICT, "TIME_IMPLAUSIBLE");
        assert_eq!((status, code(&refused)), expected, "{path}: {refused}");
    }
    early["time"] = json!({"week": 0, "nsOfWeek": 0});
    let (status, answer) = doors.post(&path, json!({"epochs": [early, epoch(2)]})).await;
    assert_eq!((status, &answer["durableThrough"]), (StatusCode::OK, &json!(2)), "{answer}");
}

#[tokio::test]
async fn a_solve_on_request_stores_nothing() {
    let doors = Doors::open().await;
    let session = doors.session().await;
    let solve = format!("/v1/sessions/{session}:solve");
    let (_, empty) = doors.post(&solve, json!({})).await;
    assert_eq!(code(&empty), "SESSION_EMPTY");
    doors.post(&format!("/v1/sessions/{session}/epochs"), json!({"epochs": [epoch(1)]})).await;
    let (status, solved) = doors.post(&solve, json!({"overrides": {"ionosphere": "none"}})).await;
    assert_eq!((status, &solved["solution"]["seq"]), (StatusCode::OK, &json!(1)));
    let (_, stored) = doors.get(&format!("/v1/sessions/{session}/solutions")).await;
    let hash = |solution: &serde_json::Value| solution["provenance"]["configurationHash"].clone();
    assert_eq!(stored["solutions"].as_array().unwrap().len(), 1);
    assert_ne!(hash(&stored["solutions"][0]), hash(&solved["solution"]));
}

#[tokio::test]
async fn one_epoch_needs_no_session() {
    let doors = Doors::open().await;
    let (status, answer) = doors.post("/v1/solve", json!({"epochs": [epoch(1), epoch(2)]})).await;
    assert_eq!(status, StatusCode::OK, "{answer}");
    assert_eq!(answer["solutions"].as_array().unwrap().len(), 2);
    assert_eq!(doors.get("/v1/sessions").await.1["sessions"], json!([]));
}
