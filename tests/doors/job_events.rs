//! Watches of batch jobs, by both doors.

use std::time::Duration;

use graphfix::config::{JobsConfiguration, Limits};
use graphfix::contract::v1;
use graphfix::grpc::code_of;
use graphfix::grpc::v1::jobs_client::JobsClient;
use serde_json::json;
use tokio::time::timeout;

use super::jobs::{all_turns, created, held_midway};
use crate::support::doors::{Doors, code};
use crate::support::events::Events;
use crate::support::jobs::{LONG, MINUTE};
use crate::support::wait::until;

async fn doors() -> Doors {
    Doors::with_jobs(JobsConfiguration::standard()).await
}

#[tokio::test]
async fn events_follow_a_job_to_its_end() {
    let doors = doors().await;
    let turns = all_turns(&doors).await;
    let job = created(&doors, LONG.body(&json!({"mode": "rtk-fgo"}))).await;
    let mut events = Events::of(&doors, &format!("/v1/jobs/{job}/events")).await;
    let (name, first) = events.next().await.unwrap();
    assert_eq!((&*name, &first["job"]), ("job", &json!(job)), "{first}");
    assert!(["QUEUED", "RUNNING"].contains(&first["state"].as_str().unwrap()), "{first}");
    assert_eq!(first["progress"]["epochs"], 0, "{first}");
    drop(turns);
    let mut epochs = 0;
    let last = loop {
        let (name, job) = events.next().await.unwrap();
        let now = job["progress"]["epochs"].as_u64().unwrap();
        assert!(epochs <= now, "{job}");
        epochs = now;
        match &*name {
            "job" => assert_eq!(job["endedUtc"], "", "{job}"),
            "ended" => break job,
            other => panic!("event {other}: {job}"),
        }
    };
    assert_eq!((&last["state"], &last["progress"]["epochs"]), (&json!("SUCCEEDED"), &json!(301)));
    assert_eq!(events.next().await, None, "something follows the end");
    assert_eq!(doors.get(&format!("/v1/jobs/{job}")).await.1, last);
    // A watch of a job that has ended gets one event.
    let mut again = Events::of(&doors, &format!("/v1/jobs/{job}/events")).await;
    assert_eq!(again.next().await, Some(("ended".to_owned(), last)));
    assert_eq!(again.next().await, None);
    drop((events, again));
    until("returned to the budget", async || doors.service.budget().used(), |used| *used == 0)
        .await;
}

/// A watch by gRPC has the same messages, and sees changes by another client.
#[tokio::test]
async fn a_watch_sees_a_cancellation() {
    let doors = doors().await;
    let job = created(&doors, LONG.body(&json!({"mode": "rtk-fgo"}))).await;
    let (turns, running) = held_midway(&doors, &job).await;
    let mut client = JobsClient::new(doors.router.clone());
    let request = v1::GetJobRequest { job: job.clone() };
    let mut watch = client.watch(request).await.unwrap().into_inner();
    let message = async |watch: &mut tonic::Streaming<v1::Job>| {
        let message = timeout(Duration::from_secs(60), watch.message()).await;
        message.expect("the watch is silent").unwrap()
    };
    let first = message(&mut watch).await.unwrap();
    assert_eq!(first.state, "RUNNING");
    assert!(running["progress"]["epochs"].as_u64().unwrap() <= first.progress.unwrap().epochs);
    doors.send("DELETE", &format!("/v1/jobs/{job}"), json!({})).await;
    let mut last = first;
    while let Some(next) = message(&mut watch).await {
        last = next;
    }
    assert_eq!(last.state, "CANCELLED");
    drop(turns);
}

#[tokio::test]
async fn a_watch_ends_in_a_drain() {
    let doors = doors().await;
    let _turns = all_turns(&doors).await;
    let job = created(&doors, MINUTE.body(&json!({}))).await;
    let mut events = Events::of(&doors, &format!("/v1/jobs/{job}/events")).await;
    assert_eq!(events.next().await.unwrap().0, "job");
    doors.service.drain();
    let end = loop {
        let (name, content) = events.next().await.unwrap();
        if name != "job" {
            break (name, content);
        }
    };
    assert_eq!((&*end.0, code(&end.1)), ("end", "DRAINING"), "{}", end.1);
    assert_eq!(events.next().await, None);
    let (status, refused) = doors.get(&format!("/v1/jobs/{job}/events")).await;
    assert_eq!((status.as_u16(), code(&refused)), (503, "DRAINING"), "{refused}");
}

#[tokio::test]
async fn a_wrong_watch_of_a_job_is_refused() {
    let doors = Doors::with(Limits { watches: 1, ..Limits::standard() }).await;
    for wrong in ["job_0", "job_00000000000000000000000000000000"] {
        let (status, refused) = doors.get(&format!("/v1/jobs/{wrong}/events")).await;
        assert_eq!((status.as_u16(), code(&refused)), (404, "JOB_NOT_FOUND"), "{refused}");
    }
    let _turns = all_turns(&doors).await;
    let job = created(&doors, MINUTE.body(&json!({}))).await;
    let _events = Events::of(&doors, &format!("/v1/jobs/{job}/events")).await;
    let (status, refused) = doors.get(&format!("/v1/jobs/{job}/events")).await;
    assert_eq!((status.as_u16(), code(&refused)), (429, "TOO_MANY_WATCHES"), "{refused}");
    let mut client = JobsClient::new(doors.router.clone());
    let status = client.watch(v1::GetJobRequest { job }).await.unwrap_err();
    assert_eq!(code_of(&status).as_deref(), Some("TOO_MANY_WATCHES"));
}
