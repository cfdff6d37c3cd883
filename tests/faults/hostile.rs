//! Clients that try to exhaust the service: each is refused, and others are served meanwhile.

use axum::http::StatusCode;
use graphfix::config::Limits;
use graphfix::contract::convert;
use graphfix::session::SequencedEpoch;
use serde_json::{Value, json};

use crate::support::doors::{Doors, code};
use crate::support::drive::DRIVE;

/// What one request may compute is bounded by time and by the window.
#[tokio::test]
async fn a_solve_has_a_largest_cost() {
    let doors = Doors::with(Limits { solve_s: 0, ..Limits::standard() }).await;
    doors.service.navigation().push(DRIVE.navigation.clone(), "test").await.unwrap();
    let epochs = |count: usize| -> Vec<Value> {
        let message = |e: &SequencedEpoch| json!(convert::epoch_message(e.seq, &e.epoch));
        DRIVE.epochs[..count].iter().map(message).collect()
    };
    let (status, solved) = doors.post("/v1/solve", json!({"epochs": epochs(1)})).await;
    assert_eq!(status, StatusCode::OK, "{solved}");
    let request = json!({"mode": "fgo", "epochs": epochs(60)});
    let (status, refusal) = doors.post("/v1/solve", request).await;
    assert_eq!((status.as_u16(), code(&refusal)), (413, "TOO_COSTLY"), "{refusal}");
    let overrides = json!({"window_epochs_max": "1000"});
    let request = json!({"mode": "fgo", "overrides": overrides, "epochs": epochs(1)});
    let (_, refusal) = doors.post("/v1/solve", request).await;
    let at_fault = (code(&refusal), refusal["field"].as_str());
    assert_eq!(at_fault, ("TOO_COSTLY", Some("overrides.window_epochs_max")), "{refusal}");
}
