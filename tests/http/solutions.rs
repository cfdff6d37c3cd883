//! `/v1/sessions/{session}/solutions`.

use axum::http::StatusCode;
use serde_json::{Value, json};

use crate::doors::{Doors, epoch};

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
