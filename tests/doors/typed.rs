//! States and times with types on gRPC, beside the texts that both doors have.

use graphfix::contract::v1;
use graphfix::grpc::v1::bases_client::BasesClient;
use graphfix::grpc::v1::jobs_client::JobsClient;
use graphfix::grpc::v1::sessions_client::SessionsClient;
use prost_types::Timestamp;
use serde_json::json;

use crate::support::doors::Doors;
use crate::support::jobs::MINUTE;

use super::jobs::{created, ended};

/// A time in the form of the text field beside it.
fn text(time: Option<Timestamp>) -> String {
    let text = time.unwrap().to_string();
    // The text always has milliseconds; protobuf omits them if they are zero.
    if text.contains('.') { text } else { text.replace('Z', ".000Z") }
}

#[tokio::test]
async fn states_and_times_have_types_on_grpc() {
    let doors = Doors::open().await;
    let id = created(&doors, MINUTE.body(&json!({"mode": "spp"}))).await;
    ended(&doors, &id).await;
    let request = v1::GetJobRequest { job: id.clone() };
    let job = JobsClient::new(doors.router.clone()).get(request).await.unwrap().into_inner();
    assert_eq!((&*job.state, job.job_state()), ("SUCCEEDED", v1::JobState::Succeeded));
    assert_eq!(job.delivery_state(), v1::DeliveryState::Unspecified);
    for (time, expected) in [
        (job.create_time, &job.created_utc),
        (job.start_time, &job.started_utc),
        (job.end_time, &job.ended_utc),
        (job.expire_time, &job.expires_utc),
    ] {
        assert_eq!(text(time), *expected);
    }
    // JSON has the texts only.
    let by_rest = doors.get(&format!("/v1/jobs/{id}")).await.1;
    assert_eq!(by_rest["state"], "SUCCEEDED");
    assert!(by_rest.get("jobState").is_none() && by_rest.get("createTime").is_none(), "{by_rest}");

    let mut sessions = SessionsClient::new(doors.router.clone());
    let new = v1::CreateSessionRequest::default();
    let session = sessions.create(new).await.unwrap().into_inner();
    assert_eq!(text(session.create_time), session.created_utc);
    let ntrip = v1::NtripSource {
        caster: "ntrip://127.0.0.1:1".to_owned(),
        mountpoint: "ROOF".to_owned(),
        ..Default::default()
    };
    let new = v1::CreateBaseRequest { ntrip: Some(ntrip), ..Default::default() };
    let mut bases = BasesClient::new(doors.router.clone());
    let base = bases.create(new).await.unwrap().into_inner();
    assert_eq!(text(base.create_time), base.created_utc);
    let feed = base.feed.unwrap();
    let expected = format!("SOURCE_STATE_{}", feed.state);
    assert_eq!(feed.source_state().as_str_name(), expected);
    assert_eq!(text(feed.since_time), feed.since_utc);
    doors.close().await;
}

/// Every state has a value in `proto/`, so none becomes `UNSPECIFIED`.
#[test]
fn every_state_has_a_value() {
    for state in ["QUEUED", "RUNNING", "SUCCEEDED", "FAILED", "CANCELLED"] {
        assert!(v1::JobState::from_str_name(&format!("JOB_STATE_{state}")).is_some(), "{state}");
    }
    for state in ["WAITING", "DELIVERED", "FAILED"] {
        let name = format!("DELIVERY_STATE_{state}");
        assert!(v1::DeliveryState::from_str_name(&name).is_some(), "{state}");
    }
    for state in ["CONNECTING", "STREAMING", "WAITING", "IDLE", "FETCHING", "CURRENT"] {
        let name = format!("SOURCE_STATE_{state}");
        assert!(v1::SourceState::from_str_name(&name).is_some(), "{state}");
    }
}
