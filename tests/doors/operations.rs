//! Batch jobs by `google.longrunning.Operations`: the same jobs under the same ids.

use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant};

use graphfix::config::JobsConfiguration;
use graphfix::contract::v1;
use graphfix::grpc::code_of;
use graphfix::grpc::longrunning::operation::Result as Outcome;
use graphfix::grpc::longrunning::operations_client::OperationsClient;
use graphfix::grpc::longrunning::{
    CancelOperationRequest, DeleteOperationRequest, GetOperationRequest, ListOperationsRequest,
    Operation, WaitOperationRequest,
};
use graphfix::grpc::v1::jobs_client::JobsClient;
use prost::Message;
use prost_types::Any;
use serde_json::{Value, json};
use tonic::{Code, Status};

use super::jobs::{all_turns, created, ended};
use crate::support::database::{Database, on_both_databases, sqlite_url};
use crate::support::doors::{Doors, code};
use crate::support::jobs::{HOUR, MINUTE, body};
use crate::support::python;
use crate::support::server::{Server, free_port, opened};

on_both_databases!(a_job_that_has_ended_is_deleted);

type Client = OperationsClient<axum::Router>;

async fn doors() -> (Doors, Client) {
    let doors = Doors::with_jobs(JobsConfiguration::standard()).await;
    let client = OperationsClient::new(doors.router.clone());
    (doors, client)
}

fn good() -> Vec<u8> {
    MINUTE.body(&json!({"mode": "fgo"}))
}

/// A body whose rover file is not a recording.
fn bad() -> Vec<u8> {
    body(&[("rover", b"nothing of a receiver"), ("navigation", &MINUTE.navigation)])
}

async fn got(client: &mut Client, name: &str) -> Operation {
    let request = GetOperationRequest { name: name.to_owned() };
    client.get_operation(request).await.unwrap().into_inner()
}

async fn waited(client: &mut Client, name: &str, timeout: Option<Duration>) -> Operation {
    let timeout = timeout.map(|timeout| timeout.try_into().unwrap());
    let request = WaitOperationRequest { name: name.to_owned(), timeout };
    client.wait_operation(request).await.unwrap().into_inner()
}

async fn deleted(client: &mut Client, name: &str) -> Result<(), Status> {
    let request = DeleteOperationRequest { name: name.to_owned() };
    client.delete_operation(request).await.map(drop)
}

async fn listed(client: &mut Client, request: ListOperationsRequest) -> (Vec<String>, String) {
    let page = client.list_operations(request).await.unwrap().into_inner();
    let names = page.operations.into_iter().map(|operation| operation.name).collect();
    (names, page.next_page_token)
}

/// The message in an `Any`, whose type is checked.
fn unpacked<M: Message + Default>(any: &Any, name: &str) -> M {
    assert_eq!(any.type_url, format!("type.googleapis.com/graphfix.v1.{name}"));
    M::decode(&*any.value).unwrap()
}

fn refusal(status: &Status) -> (Code, String) {
    (status.code(), code_of(status).unwrap_or_default())
}

#[tokio::test]
async fn an_operation_is_the_job_of_its_id() {
    let (doors, mut client) = doors().await;
    let turns = all_turns(&doors).await;
    let name = created(&doors, good()).await;
    let begun = Instant::now();
    let running = waited(&mut client, &name, Some(Duration::from_millis(300))).await;
    assert!(Duration::from_millis(300) <= begun.elapsed());
    assert_eq!((running.done, &running.result), (false, &None));
    let job: v1::Job = unpacked(&running.metadata.unwrap(), "Job");
    assert!(["QUEUED", "RUNNING"].contains(&&*job.state), "{job:?}");
    let refused = deleted(&mut client, &name).await.unwrap_err();
    assert_eq!(refusal(&refused), (Code::FailedPrecondition, "JOB_NOT_ENDED".to_owned()));
    drop(turns);

    // The time limit is longer than the computation. The call answers as soon as the job ends.
    let done = waited(&mut client, &name, None).await;
    assert_eq!((&done.name, done.done), (&name, true));
    let job: v1::Job = unpacked(done.metadata.as_ref().unwrap(), "Job");
    let mut jobs = JobsClient::new(doors.router.clone());
    let request = v1::GetJobRequest { job: name.clone() };
    let same = jobs.get(request.clone()).await.unwrap().into_inner();
    assert_eq!((&*job.state, &job), ("SUCCEEDED", &same));
    let Some(Outcome::Response(response)) = &done.result else { panic!("{done:?}") };
    let report: v1::JobReport = unpacked(response, "JobReport");
    assert_eq!(report, jobs.report(request).await.unwrap().into_inner());
    assert_eq!(report.epochs, 61);
    assert_eq!(got(&mut client, &name).await, done);
}

#[tokio::test]
async fn what_fails_and_what_is_cancelled_is_an_error() {
    let (doors, mut client) = doors().await;
    let failed = created(&doors, bad()).await;
    let Value::Object(failure) = ended(&doors, &failed).await["failure"].take() else {
        panic!("it has not failed")
    };
    let Some(Outcome::Error(error)) = got(&mut client, &failed).await.result else {
        panic!("no error")
    };
    let expected = (Code::FailedPrecondition as i32, &failure["message"]);
    assert_eq!((error.code, &json!(error.message)), expected);
    let status = Status::with_details(
        Code::from_i32(error.code),
        error.message.clone(),
        error.encode_to_vec().into(),
    );
    assert_eq!(json!(code_of(&status)), failure["code"]);

    let turns = all_turns(&doors).await;
    let name = created(&doors, good()).await;
    let request = CancelOperationRequest { name: name.clone() };
    client.cancel_operation(request.clone()).await.unwrap();
    let cancelled = waited(&mut client, &name, None).await;
    let Some(Outcome::Error(error)) = &cancelled.result else { panic!("{cancelled:?}") };
    assert_eq!((cancelled.done, error.code), (true, Code::Cancelled as i32));
    // A second cancellation changes nothing.
    client.cancel_operation(request).await.unwrap();
    assert_eq!(got(&mut client, &name).await, cancelled);
    drop(turns);
}

#[tokio::test]
async fn lists_come_in_pages_and_by_state() {
    let (doors, mut client) = doors().await;
    let mut names = Vec::new();
    for content in [good(), bad(), good()] {
        let name = created(&doors, content).await;
        ended(&doors, &name).await;
        names.insert(0, name);
    }
    let all = ListOperationsRequest::default();
    assert_eq!(listed(&mut client, all.clone()).await, (names.clone(), String::new()));
    let first = ListOperationsRequest { page_size: 2, ..all.clone() };
    let (page, page_token) = listed(&mut client, first.clone()).await;
    assert_eq!(page, names[..2]);
    let next = ListOperationsRequest { page_token: page_token.clone(), ..first };
    assert_eq!(listed(&mut client, next).await, (names[2..].to_vec(), String::new()));
    let of_state = |state: &str| ListOperationsRequest {
        filter: format!("metadata.state = \"{state}\""),
        ..all.clone()
    };
    assert_eq!(listed(&mut client, of_state("FAILED")).await.0, names[1..2]);
    assert!(listed(&mut client, of_state("RUNNING")).await.0.is_empty());
    for (wrong, code) in [
        (ListOperationsRequest { filter: "done".to_owned(), ..all.clone() }, "INVALID_FIELD"),
        (of_state("LOST"), "INVALID_FIELD"),
        (ListOperationsRequest { page_size: -1, ..all.clone() }, "INVALID_FIELD"),
        (ListOperationsRequest { name: "operations".to_owned(), ..all.clone() }, "INVALID_FIELD"),
        (ListOperationsRequest { page_token, ..of_state("FAILED") }, "PAGE_TOKEN_INVALID"),
    ] {
        let refused = client.list_operations(wrong.clone()).await.unwrap_err();
        assert_eq!(refusal(&refused), (Code::InvalidArgument, code.to_owned()), "{wrong:?}");
    }
}

/// Deletes a job by one of the calls. Returns the code of a refusal.
async fn deleted_by(doors: &Doors, call: usize, job: &str) -> Result<(), String> {
    let job = job.to_owned();
    match call {
        0 => {
            let mut client = OperationsClient::new(doors.router.clone());
            deleted(&mut client, &job).await.map_err(|status| refusal(&status).1)
        }
        1 => {
            let mut client = JobsClient::new(doors.router.clone());
            let was = client.delete(v1::DeleteJobRequest { job: job.clone() }).await;
            let was = was.map_err(|status| refusal(&status).1)?.into_inner();
            assert_eq!((was.job, &*was.state), (job, "SUCCEEDED"));
            Ok(())
        }
        _ => {
            let path = format!("/v1/jobs/{job}?purge=true");
            let (status, was) = doors.send("DELETE", &path, Value::Null).await;
            match status.is_success() {
                true => {
                    assert_eq!((&was["job"], &was["state"]), (&json!(job), &json!("SUCCEEDED")))
                }
                false => return Err(code(&was).to_owned()),
            }
            Ok(())
        }
    }
}

/// Each call that deletes jobs refuses a running job, and one that is already deleted.
#[tokio::test]
async fn every_call_deletes_what_has_ended_only() {
    let doors = Doors::with_jobs(JobsConfiguration::standard()).await;
    for call in 0..3 {
        let turns = all_turns(&doors).await;
        let name = created(&doors, good()).await;
        assert_eq!(deleted_by(&doors, call, &name).await, Err("JOB_NOT_ENDED".to_owned()));
        drop(turns);
        assert_eq!(ended(&doors, &name).await["state"], "SUCCEEDED");
        // The result and its figures.
        let results =
            || std::fs::read_dir(doors.folder().join("test.db.jobs/results")).unwrap().count();
        assert_eq!(results(), 2);
        assert_eq!(deleted_by(&doors, call, &name).await, Ok(()));
        assert_eq!(results(), 0);
        assert_eq!(deleted_by(&doors, call, &name).await, Err("JOB_NOT_FOUND".to_owned()));
    }
}

async fn a_job_that_has_ended_is_deleted(database: Database) {
    let doors = Doors::on(&database.url).await;
    let mut client = OperationsClient::new(doors.router.clone());
    let (gone, kept) = (created(&doors, good()).await, created(&doors, good()).await);
    ended(&doors, &gone).await;
    ended(&doors, &kept).await;
    // Two results with their figures.
    let results = || std::fs::read_dir(doors.folder().join("jobs/results")).unwrap().count();
    assert_eq!(results(), 4);
    deleted(&mut client, &gone).await.unwrap();
    assert_eq!(results(), 2);
    for refused in [
        deleted(&mut client, &gone).await.unwrap_err(),
        client.get_operation(GetOperationRequest { name: gone.clone() }).await.unwrap_err(),
        deleted(&mut client, "job").await.unwrap_err(),
    ] {
        assert_eq!(refusal(&refused), (Code::NotFound, "JOB_NOT_FOUND".to_owned()));
    }
    // Both have the same inputs, which stay.
    doors.service.jobs().remove_expired().await.unwrap();
    let inputs = std::fs::read_dir(doors.folder().join("jobs/inputs")).unwrap().count();
    assert_eq!(
        (inputs, listed(&mut client, ListOperationsRequest::default()).await.0),
        (3, vec![kept])
    );
    doors.close().await;
}

/// Google's client polls, cancels, lists and deletes, and reads results and errors.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn googles_client_follows_jobs() {
    let (Some(python), Some(_)) = (python::with("google.api_core"), python::with("grpc_tools"))
    else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let server = Server::start(&sqlite_url(&folder.path().join("operations.db")), free_port());
    let address = format!("127.0.0.1:{}", server.port);
    opened(&server.channel(), None).await;
    std::fs::write(folder.path().join("nothing"), "nothing of a receiver").unwrap();
    MINUTE.write(folder.path());
    let hour = folder.path().join("hour");
    std::fs::create_dir(&hour).unwrap();
    HOUR.write(&hour);
    let create = |parts: &[&str]| {
        let mut curl = Command::new("curl");
        curl.args(["-sS", &format!("http://{address}/v1/jobs")]).current_dir(folder.path());
        for part in parts {
            curl.args(["-F", part]);
        }
        let job: Value = serde_json::from_str(&printed(&mut curl)).unwrap();
        job["job"].as_str().unwrap_or_else(|| panic!("{job}")).to_owned()
    };
    let good = create(&["rover=@rover", "navigation=@navigation"]);
    let bad = create(&["rover=@nothing", "navigation=@navigation"]);
    // This job runs for seconds, so it can be cancelled.
    let last = create(&["rover=@hour/rover", "base=@hour/base", "navigation=@hour/navigation"]);

    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let names = ["lists", "observation", "solution", "sessions", "positioning", "jobs"];
    let mut generate = Command::new(&python);
    generate.args(["-m", "grpc_tools.protoc", "-I"]).arg(root.join("proto"));
    generate.arg(format!("--python_out={}", folder.path().display()));
    printed(generate.args(names.map(|name| format!("graphfix/v1/{name}.proto"))));
    let mut client = Command::new(&python);
    client.arg(root.join("tests/support/python/operations.py")).arg(folder.path());
    let seen: Value =
        serde_json::from_str(&printed(client.args([&address, &good, &bad, &last]))).unwrap();
    let listed = seen["listed"].as_array().unwrap();
    assert!(listed.contains(&json!(good)) && !listed.contains(&json!(bad)), "{seen}");
    assert_eq!(seen["epochs"], 61);
    assert_eq!(seen["state"], "SUCCEEDED");
    assert_eq!(seen["failure"][0], "FAILED_PRECONDITION");
    assert!(seen["failure"][1].as_str().is_some_and(|reason| !reason.is_empty()), "{seen}");
    assert_eq!(seen["cancelled"], true);
    assert_eq!((&seen["waited"], &seen["gone"]), (&json!(true), &json!("JOB_NOT_FOUND")));
}

fn printed(command: &mut Command) -> String {
    let output = command.output().unwrap();
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{command:?}: {errors}");
    String::from_utf8(output.stdout).unwrap()
}
