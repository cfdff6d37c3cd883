//! `/v1/jobs`: a job takes files, and gives a file of positions and a report.

use std::io::Write;
use std::num::NonZero;
use std::thread::available_parallelism;
use std::time::Duration;

use axum::body::Body;
use axum::http::{Request, StatusCode};
use futures::{StreamExt, TryStreamExt, stream};
use graphfix::app;
use graphfix::config::{JobsConfiguration, ServiceConfiguration};
use graphfix::contract::v1;
use graphfix::grpc::v1::jobs_client::JobsClient;
use graphfix::session::BatchTurn;
use graphfix::store::{JobEnd, JobProgress, JobState, NewJob, Store};
use graphfix::tenant::Tenant;
use serde_json::{Value, json};
use tokio::time::sleep;
use tower::ServiceExt;

use crate::support::casters::{BRISK, PATIENCE, gzip};
use crate::support::database::{Database, on_both_databases, on_postgres};
use crate::support::doors::{Doors, code};
use crate::support::jobs::{BOUNDARY, LONG, MINUTE, body};

on_both_databases!(
    a_queue_gives_each_job_once,
    a_request_that_is_repeated_is_one_job,
    a_tenant_that_comes_shares_from_then_on,
    tenants_have_the_same_time,
);

/// Longer than the interval at which a run stores its progress.
const HEARTBEAT: Duration = Duration::from_millis(1100);

async fn doors(change: impl FnOnce(&mut JobsConfiguration)) -> Doors {
    let mut jobs = JobsConfiguration::standard();
    change(&mut jobs);
    Doors::with_jobs(jobs).await
}

/// Sends a body in chunks, as a network would.
pub(crate) async fn post(
    doors: &Doors,
    content: Vec<u8>,
    headers: &[(&str, &str)],
) -> (StatusCode, Value) {
    let kind = format!("multipart/form-data; boundary={BOUNDARY}");
    let mut request = Request::post("/v1/jobs").header("content-type", kind);
    for (name, value) in headers {
        request = request.header(*name, *value);
    }
    let chunks: Vec<_> = content.chunks(60_000).map(<[u8]>::to_vec).collect();
    let chunks = stream::iter(chunks.into_iter().map(Ok::<_, std::io::Error>));
    doors.ask(request.body(Body::from_stream(chunks)).unwrap()).await
}

pub(crate) async fn created(doors: &Doors, content: Vec<u8>) -> String {
    let (status, job) = post(doors, content, &[]).await;
    assert_eq!(status, StatusCode::CREATED, "{job}");
    job["job"].as_str().unwrap().to_owned()
}

/// The job once it has ended.
pub(crate) async fn ended(doors: &Doors, job: &str) -> Value {
    let is_end = |job: &Value| !["QUEUED", "RUNNING"].contains(&job["state"].as_str().unwrap());
    doors.until(&format!("/v1/jobs/{job}"), is_end).await
}

pub(crate) async fn bytes_of(doors: &Doors, path: &str) -> (StatusCode, Vec<u8>) {
    let request = Request::get(path).body(Body::empty()).unwrap();
    let response = doors.router.clone().oneshot(request).await.unwrap();
    let status = response.status();
    (status, axum::body::to_bytes(response.into_body(), usize::MAX).await.unwrap().to_vec())
}

/// Takes all turns of batch jobs, so that no job computes until they are dropped.
pub(crate) async fn all_turns(doors: &Doors) -> Vec<BatchTurn> {
    let lane = doors.service.sessions().batch_lane();
    let threads = available_parallelism().map_or(1, NonZero::get);
    // Batch jobs leave one thread to other work.
    let turns = stream::iter(1..threads.max(2));
    let operator = Tenant::operator();
    turns.then(|_| lane.turn(&operator)).collect().await
}

/// Lets a job compute one turn at a time until it reports progress. The job then waits until the
/// returned turns are dropped.
pub(super) async fn held_midway(doors: &Doors, job: &str) -> (Vec<BatchTurn>, Value) {
    for _ in 0..60 {
        let turns = all_turns(doors).await;
        sleep(HEARTBEAT).await;
        let (_, job) = doors.get(&format!("/v1/jobs/{job}")).await;
        if job["progress"]["epochs"].as_u64().is_some_and(|epochs| 0 < epochs) {
            return (turns, job);
        }
    }
    panic!("the job {job} does not run");
}

/// Restarts a service while a test has all its turns.
pub(super) async fn restarted_midway(doors: Doors, turns: Vec<BatchTurn>) -> Doors {
    // A run that waits for its turn notices the stop of the service when it gets the turn.
    let stopped = async {
        sleep(HEARTBEAT).await;
        drop(turns);
    };
    tokio::join!(doors.restarted(), stopped).0
}

/// Number of the answers of a job that its report ascribes to a run that was cut off.
pub(super) async fn kept_answers(doors: &Doors, job: &str) -> u64 {
    let (_, report) = doors.get(&format!("/v1/jobs/{job}/report")).await;
    let lines: Vec<String> = serde_json::from_value(report["provenance"].clone()).unwrap();
    let kept = |line: &String| {
        let (count, rest) = line.strip_prefix("the first ")?.split_once(' ')?;
        assert_eq!(rest, "answers are those of a run that was cut off");
        count.parse().ok()
    };
    lines.iter().find_map(kept).unwrap_or(0)
}

/// Number of files in the folder of jobs.
pub(super) fn files(doors: &Doors) -> usize {
    let folder = doors.folder().join("test.db.jobs");
    let names = ["incoming", "inputs", "results", "checkpoints"];
    let inside = names.map(|name| folder.join(name));
    inside.iter().map(|folder| std::fs::read_dir(folder).unwrap().count()).sum()
}

#[tokio::test]
async fn a_job_gives_the_bytes_of_solve() {
    let doors = doors(|_| {}).await;
    for (options, arguments, format) in [
        (json!({}), &[] as &[&str], "pos"),
        (json!({"mode": "spp"}), &["--mode", "spp"], "pos"),
        (json!({"mode": "spp", "format": "rinex"}), &["--mode", "spp"], "rnx"),
        (
            json!({"mode": "rtk-fgo", "smoothed": true, "format": "csv"}),
            &["--mode", "rtk-fgo", "--smoothed"],
            "csv",
        ),
        (
            json!({"mode": "fgo", "batch": true, "format": "kml", "profile": "static",
                "overrides": {"elevation_mask_deg": "12"}}),
            &[
                "--mode",
                "fgo",
                "--window",
                "batch",
                "--profile",
                "static",
                "--set",
                "elevation_mask_deg=12",
            ],
            "kml",
        ),
    ] {
        let job = created(&doors, MINUTE.body(&options)).await;
        let ended = ended(&doors, &job).await;
        assert_eq!(ended["state"], "SUCCEEDED", "{ended}");
        assert_eq!(ended["progress"]["percent"], 100.0);
        assert_eq!(ended["progress"]["epochs"], 61);
        let (status, result) = bytes_of(&doors, &format!("/v1/jobs/{job}/result")).await;
        assert_eq!(status, StatusCode::OK);
        assert_eq!(result, MINUTE.solved(arguments, format), "{options}");
        assert_eq!(ended["resultBytes"], result.len());
    }
    let (_, list) = doors.get("/v1/jobs?pageSize=2").await;
    assert_eq!(list["jobs"].as_array().unwrap().len(), 2, "{list}");
    let token = list["nextPageToken"].as_str().unwrap();
    let (_, rest) = doors.get(&format!("/v1/jobs?pageToken={token}")).await;
    // The default mode with a base is that of `solve`.
    assert_eq!(rest["jobs"][2]["options"]["mode"], "rtk-fgo", "{rest}");
    for (query, expected) in
        [("state=SUCCEEDED&order=OLDEST_FIRST", 5), ("state=QUEUED", 0), ("state=RUNNING", 0)]
    {
        let (_, list) = doors.get(&format!("/v1/jobs?{query}")).await;
        assert_eq!(list["jobs"].as_array().unwrap().len(), expected, "{list}");
    }
    let (_, oldest) = doors.get("/v1/jobs?pageSize=1&order=OLDEST_FIRST").await;
    assert_eq!(oldest["jobs"][0]["job"], rest["jobs"][2]["job"]);
    let (status, refused) = doors.get("/v1/jobs?state=DONE").await;
    assert_eq!((status, code(&refused)), (StatusCode::BAD_REQUEST, "INVALID_FIELD"));
    // Five results with their figures, and the files of all five jobs once.
    assert_eq!(files(&doors), 2 * 5 + 3);
    assert_eq!(doors.service.budget().used(), 0);
}

#[tokio::test]
async fn a_report_states_what_the_positions_rest_on() {
    let doors = doors(|_| {}).await;
    let marker = json!({"xM": -2_414_266.9, "yM": 5_386_768.9, "zM": 2_407_460.0});
    let options = json!({"mode": "rtk-ekf", "basePosition": marker, "format": "geojson"});
    let job = created(&doors, MINUTE.body(&options)).await;
    let done = ended(&doors, &job).await;
    assert_eq!(done["options"]["basePosition"], marker, "{done}");
    assert_eq!(done["inputs"][0]["part"], "rover");
    assert_eq!(done["inputs"][0]["name"], "a.file");
    assert_eq!(done["inputs"][0]["bytes"], MINUTE.rover.len());
    let (status, report) = doors.get(&format!("/v1/jobs/{job}/report")).await;
    assert_eq!((status, &report["epochs"]), (StatusCode::OK, &json!(61)), "{report}");
    let counted = report["statuses"].as_array().unwrap().iter();
    assert_eq!(counted.map(|count| count["epochs"].as_u64().unwrap()).sum::<u64>(), 61);
    let reasons = report["reasons"].as_array().unwrap();
    let has_remedy = |reason: &Value| !reason["remedy"].as_str().unwrap().is_empty();
    assert!(!reasons.is_empty() && reasons.iter().all(has_remedy), "{report}");
    let lines = report["provenance"].to_string();
    assert!(lines.contains("marker at -2414266.9000") && lines.contains("as given"), "{lines}");

    // gRPC gives the same job.
    let mut client = JobsClient::new(doors.router.clone());
    let request = v1::GetJobRequest { job: job.clone() };
    let by_grpc = client.get(request.clone()).await.unwrap().into_inner();
    assert_eq!(serde_json::to_value(&by_grpc).unwrap(), done);
    let by_grpc = client.report(request.clone()).await.unwrap().into_inner();
    assert_eq!(serde_json::to_value(&by_grpc).unwrap(), report);
    let stream = client.result(request).await.unwrap().into_inner();
    let chunks: Vec<_> = stream.map(|m| m.map(|m| m.content)).try_collect().await.unwrap();
    let (_, by_rest) = bytes_of(&doors, &format!("/v1/jobs/{job}/result")).await;
    assert_eq!(chunks.concat(), by_rest);
    let listed = client.list(v1::ListJobsRequest::default()).await.unwrap().into_inner();
    assert_eq!(listed.jobs.len(), 1);
    let cancelled = client.cancel(v1::CancelJobRequest { job }).await.unwrap().into_inner();
    assert_eq!(cancelled.state, "SUCCEEDED", "an ended job stays as it is");
}

/// An upload by messages is the same request as one by parts.
#[tokio::test]
async fn grpc_creates_the_same_job() {
    use v1::create_job_request::Content;
    let doors = doors(|_| {}).await;
    let named = [("idempotency-key", "both doors")];
    let (status, by_rest) = post(&doors, MINUTE.body(&json!({"mode": "ekf"})), &named).await;
    assert_eq!(status, StatusCode::CREATED, "{by_rest}");
    let message = |content| v1::CreateJobRequest { content: Some(content) };
    let file = |part: &str, content: &[u8]| {
        let (part, name) = (part.to_owned(), "a.file".to_owned());
        let begin = message(Content::Part(v1::JobPart { part, name }));
        let chunks = content.chunks(50_000).map(|chunk| Content::Chunk(chunk.to_vec()));
        std::iter::once(begin).chain(chunks.map(message)).collect::<Vec<_>>()
    };
    let mut messages = vec![message(Content::IdempotencyKey("both doors".to_owned()))];
    messages.extend(file("rover", &MINUTE.rover));
    let options = v1::JobOptions { mode: "ekf".to_owned(), ..Default::default() };
    messages.push(message(Content::Options(options)));
    messages.extend(file("navigation", &MINUTE.navigation));
    messages.extend(file("base", &MINUTE.base));
    let mut client = JobsClient::new(doors.router.clone());
    let by_grpc = client.create(stream::iter(messages.clone())).await.unwrap().into_inner();
    assert_eq!(by_grpc.job, by_rest["job"]);
    let mut by_metadata = tonic::Request::new(stream::iter(messages.split_off(1)));
    by_metadata.metadata_mut().insert("idempotency-key", "both doors".parse().unwrap());
    let by_metadata = client.create(by_metadata).await.unwrap().into_inner();
    assert_eq!(by_metadata.job, by_rest["job"], "the name in the metadata");
    let done = ended(&doors, &by_grpc.job).await;
    assert_eq!(done["state"], "SUCCEEDED", "{done}");

    let early = vec![message(Content::Chunk(vec![1, 2, 3]))];
    let refused = client.create(stream::iter(early)).await.unwrap_err();
    assert!(refused.message().contains("bytes before the part"), "{refused}");
    let mut long = file("rover", &[]);
    long.push(message(Content::Chunk(vec![0; 600_000])));
    let refused = client.create(stream::iter(long)).await.unwrap_err();
    assert_eq!(graphfix::grpc::code_of(&refused).as_deref(), Some("PIECE_TOO_LARGE"), "{refused}");
    let without = vec![message(Content::Options(v1::JobOptions::default()))];
    let refused = client.create(stream::iter(without)).await.unwrap_err();
    assert_eq!(refused.code(), tonic::Code::InvalidArgument, "{refused}");
    assert_eq!(doors.service.budget().used(), 0);
}

#[tokio::test]
async fn inputs_are_told_by_their_content() {
    let doors = doors(|_| {}).await;
    let gzip = |content: &[u8]| {
        let mut packer = flate2::write::GzEncoder::new(Vec::new(), Default::default());
        packer.write_all(content).unwrap();
        packer.finish().unwrap()
    };
    let (rover, navigation) = (gzip(&MINUTE.rover), gzip(&MINUTE.navigation));
    let packed = body(&[("options", b"{}"), ("navigation", &navigation), ("rover", &rover)]);
    let packed = created(&doors, packed).await;
    // The default mode without a base.
    let plain = created(&doors, MINUTE.body(&json!({"mode": "fgo"}))).await;
    for job in [&packed, &plain] {
        assert_eq!(ended(&doors, job).await["state"], "SUCCEEDED");
    }
    let result = async |job: &str| bytes_of(&doors, &format!("/v1/jobs/{job}/result")).await.1;
    assert_eq!(result(&packed).await, result(&plain).await);
}

#[tokio::test]
async fn a_repeated_request_is_the_same_job() {
    let doors = doors(|_| {}).await;
    let named = [("idempotency-key", "tuesday")];
    let (status, first) = post(&doors, MINUTE.body(&json!({})), &named).await;
    assert_eq!(status, StatusCode::CREATED, "{first}");
    let (status, again) = post(&doors, MINUTE.body(&json!({})), &named).await;
    assert_eq!((status, &again["job"]), (StatusCode::OK, &first["job"]));
    let (status, refused) = post(&doors, MINUTE.body(&json!({"mode": "ekf"})), &named).await;
    assert_eq!((status, code(&refused)), (StatusCode::CONFLICT, "IDEMPOTENCY_CONFLICT"));
    let (_, list) = doors.get("/v1/jobs").await;
    assert_eq!(list["jobs"].as_array().unwrap().len(), 1, "{list}");
}

#[tokio::test]
async fn what_is_no_job_is_refused_and_leaves_nothing() {
    let doors = doors(|limits| {
        limits.file_bytes = 300_000;
        limits.files = 3;
    })
    .await;
    let (rover, navigation) = (&MINUTE.rover[..], &MINUTE.navigation[..]);
    let with = |options: &str| {
        body(&[("rover", rover), ("navigation", navigation), ("options", options.as_bytes())])
    };
    let large = vec![b'x'; 300_001];
    let mut cut = with("{}");
    cut.truncate(cut.len() / 2);
    let mut headless = format!("--{BOUNDARY}\r\nContent-Disposition: form-data; ").into_bytes();
    headless.resize(3 << 20, b'x');
    for (content, status, expected, field) in [
        (body(&[("navigation", navigation)]), 400, "INVALID_FIELD", Some("rover")),
        (body(&[("rover", rover), ("truth", rover)]), 400, "UNKNOWN_FIELD", Some("truth")),
        (
            body(&[("rover", rover), ("rover", rover), ("navigation", navigation)]),
            400,
            "INVALID_FIELD",
            Some("rover"),
        ),
        (
            body(&[("rover", b""), ("navigation", b""), ("base", b""), ("base", b"")]),
            413,
            "JOB_TOO_LARGE",
            Some("base"),
        ),
        (body(&[("rover", &large)]), 413, "JOB_TOO_LARGE", Some("rover")),
        (with("{\"mode\": \"ppp\"}"), 400, "UNKNOWN_MODE", Some("options.mode")),
        (
            with("{\"basePosition\": {\"xM\": 4e6, \"yM\": 5e5, \"zM\": 5e6}}"),
            400,
            "INVALID_FIELD",
            Some("options.basePosition"),
        ),
        (
            with("{\"basePositionFromHeader\": true}"),
            400,
            "INVALID_FIELD",
            Some("options.basePositionFromHeader"),
        ),
        (
            body(&[("rover", rover), ("navigation", navigation), ("base", b"")]),
            400,
            "INVALID_FIELD",
            Some("base"),
        ),
        (
            body(&[("rover", rover), ("navigation", navigation), ("base", rover)]),
            400,
            "INVALID_FIELD",
            Some("base"),
        ),
        (
            with("{\"near\": {\"week\": -5, \"nsOfWeek\": 0}}"),
            400,
            "INVALID_FIELD",
            Some("options.near"),
        ),
        (with("{\"format\": \"shp\"}"), 400, "INVALID_FIELD", Some("options.format")),
        (with("{\"mode\": \"spp\", \"batch\": true}"), 400, "INVALID_FIELD", Some("options.batch")),
        (
            with("{\"mode\": \"fgo\", \"batch\": true, \"smoothed\": true}"),
            400,
            "INVALID_FIELD",
            Some("options.batch"),
        ),
        (
            with("{\"overrides\": {\"window\": \"3\"}}"),
            400,
            "UNKNOWN_OPTION",
            Some("options.overrides.window"),
        ),
        (with("{\"modus\": \"fgo\"}"), 400, "UNKNOWN_FIELD", Some("options.modus")),
        (with("{"), 400, "MALFORMED_BODY", Some("options")),
        (with(&" ".repeat(70_000)), 413, "JOB_OPTIONS_TOO_LARGE", Some("options")),
        (cut, 400, "MALFORMED_BODY", None),
        (headless, 400, "MALFORMED_BODY", None),
        (b"no boundary".to_vec(), 400, "MALFORMED_BODY", None),
    ] {
        let (answered, problem) = post(&doors, content, &[]).await;
        let got = (answered.as_u16(), code(&problem), problem["field"].as_str());
        assert_eq!(got, (status, expected, field), "{problem}");
    }
    let (status, problem) = doors.post("/v1/jobs", json!({})).await;
    assert_eq!((status.as_u16(), code(&problem)), (415, "UNSUPPORTED_MEDIA_TYPE"));
    assert_eq!(doors.get("/v1/jobs").await.1["jobs"], json!([]));
    let job = format!("/v1/jobs/job_{}", "0".repeat(32));
    for path in [&job, &format!("{job}/result"), "/v1/jobs/ses_1"] {
        let (status, problem) = doors.get(path).await;
        assert_eq!((status.as_u16(), code(&problem)), (404, "JOB_NOT_FOUND"), "{path}");
    }
    doors.service.jobs().remove_expired().await.unwrap();
    // Files of refused uploads that were complete are removed once they are old, or at a restart.
    let doors = doors.restarted().await;
    assert_eq!(files(&doors), 0);
    assert_eq!(doors.service.budget().used(), 0);
}

#[tokio::test]
async fn a_failed_job_states_code_part_and_remedy() {
    let doors = doors(|limits| limits.unpacked_bytes = 50_000_000).await;
    let (rover, navigation) = (&MINUTE.rover[..], &MINUTE.navigation[..]);
    let lines = format!("{:80}\n", "").repeat(400_000);
    let bomb_after = |good: &[u8]| {
        let mut packer = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::best());
        packer.write_all(good).unwrap();
        packer.write_all(lines.as_bytes()).unwrap();
        let bomb = packer.finish().unwrap();
        assert!(bomb.len() < lines.len() / 200, "{} bytes", bomb.len());
        bomb
    };
    let cut = &rover[..rover.len() / 2];
    let header = &rover[..rover.windows(13).position(|w| w == b"END OF HEADER").unwrap() + 14];
    let (rover_bomb, navigation_bomb) = (bomb_after(header), bomb_after(navigation));
    for (parts, expected, field) in [
        (
            [("rover", &b"no observations"[..]), ("navigation", navigation)],
            "FILE_NOT_UNDERSTOOD",
            "rover",
        ),
        (
            [("rover", rover), ("navigation", b"no ephemerides")],
            "FILE_NOT_UNDERSTOOD",
            "navigation",
        ),
        ([("rover", &rover_bomb[..]), ("navigation", navigation)], "COMPRESSED_TOO_MUCH", "rover"),
        (
            [("rover", rover), ("navigation", &navigation_bomb[..])],
            "COMPRESSED_TOO_MUCH",
            "navigation",
        ),
        ([("rover", header), ("navigation", navigation)], "NO_EPOCHS", "rover"),
    ] {
        let job = created(&doors, body(&parts)).await;
        let ended = ended(&doors, &job).await;
        let failure = &ended["failure"];
        assert_eq!(ended["state"], "FAILED", "{ended}");
        assert_eq!((&failure["code"], &failure["field"]), (&json!(expected), &json!(field)));
        assert!(!failure["remedy"].as_str().unwrap().is_empty(), "{failure}");
        for call in ["result", "report"] {
            let (status, problem) = doors.get(&format!("/v1/jobs/{job}/{call}")).await;
            assert_eq!((status.as_u16(), code(&problem)), (409, "JOB_WITHOUT_RESULT"));
        }
    }
    // A file that is cut in half gives the epochs before the cut.
    let job = created(&doors, body(&[("rover", cut), ("navigation", navigation)])).await;
    let half = ended(&doors, &job).await;
    assert_eq!(half["state"], "SUCCEEDED", "{half}");
    assert!(half["progress"]["epochs"].as_u64().unwrap() < 61, "{half}");
}

#[tokio::test]
async fn space_and_number_of_jobs_are_limited() {
    let size = (MINUTE.rover.len() + MINUTE.navigation.len() + MINUTE.base.len()) as u64;
    let small = doors(|limits| limits.total_bytes = size + 100).await;
    let job = created(&small, MINUTE.body(&json!({}))).await;
    let failed = ended(&small, &job).await;
    assert_eq!(failed["failure"]["code"], "JOB_SPACE_EXHAUSTED", "{failed}");
    let content = body(&[("rover", &LONG.rover[..]), ("navigation", &LONG.navigation)]);
    let (status, refused) = post(&small, content, &[]).await;
    assert_eq!((status.as_u16(), code(&refused)), (429, "JOB_SPACE_EXHAUSTED"), "{refused}");
    assert!(refused["retryAfterMs"].is_u64(), "{refused}");

    let short = doors(|limits| limits.run_s = 0).await;
    let job = created(&short, MINUTE.body(&json!({}))).await;
    let failed = ended(&short, &job).await;
    assert_eq!(failed["failure"]["code"], "JOB_TOO_LONG", "{failed}");

    let full = doors(|limits| limits.waiting = 1).await;
    let turns = all_turns(&full).await;
    let first = created(&full, LONG.body(&json!({"mode": "rtk-fgo"}))).await;
    let (status, refused) = post(&full, MINUTE.body(&json!({})), &[]).await;
    assert_eq!((status.as_u16(), code(&refused)), (429, "TOO_MANY_JOBS"), "{refused}");
    full.send("DELETE", &format!("/v1/jobs/{first}"), json!({})).await;
    drop(turns);
    created(&full, MINUTE.body(&json!({}))).await;
}

#[tokio::test]
async fn a_cancelled_job_ends_and_makes_room() {
    let doors = doors(|_| {}).await;
    let long = created(&doors, LONG.body(&json!({"mode": "rtk-fgo"}))).await;
    let waiting = created(&doors, LONG.body(&json!({"mode": "rtk-ekf"}))).await;
    let last = created(&doors, MINUTE.body(&json!({}))).await;
    let (turns, running) = held_midway(&doors, &long).await;
    assert_eq!(running["state"], "RUNNING");
    assert!(running["progress"]["remainingS"].as_f64().is_some(), "{running}");
    assert!(running["progress"]["percent"].as_f64().unwrap() < 100.0, "{running}");
    let (status, problem) = doors.get(&format!("/v1/jobs/{long}/result")).await;
    assert_eq!((status.as_u16(), code(&problem)), (409, "JOB_NOT_ENDED"));
    for job in [&waiting, &long] {
        let (status, ended) = doors.send("DELETE", &format!("/v1/jobs/{job}"), json!({})).await;
        assert_eq!((status, &ended["state"]), (StatusCode::OK, &json!("CANCELLED")), "{ended}");
    }
    drop(turns);
    // The next job runs, so the cancelled ones have given up their turn.
    assert_eq!(ended(&doors, &last).await["state"], "SUCCEEDED");
    for job in [&waiting, &long] {
        assert_eq!(ended(&doors, job).await["state"], "CANCELLED");
    }
}

#[tokio::test]
async fn a_job_that_a_restart_interrupts_goes_on() {
    let first = doors(|_| {}).await;
    let job = created(&first, LONG.body(&json!({"mode": "rtk-ekf"}))).await;
    let (turns, running) = held_midway(&first, &job).await;
    assert_eq!(running["state"], "RUNNING");
    let second = restarted_midway(first, turns).await;
    let done = ended(&second, &job).await;
    assert_eq!((&done["state"], &done["progress"]["epochs"]), (&json!("SUCCEEDED"), &json!(301)));
    let (_, result) = bytes_of(&second, &format!("/v1/jobs/{job}/result")).await;
    assert_eq!(result, LONG.solved(&["--mode", "rtk-ekf"], "pos"));
    let kept = kept_answers(&second, &job).await;
    assert!((1..301).contains(&kept), "{kept}");
    assert_eq!(files(&second), 5, "the result of the first run, or its checkpoint, is left");
}

/// A job with the option `batch` answers all epochs together, so an interrupted run begins again.
#[tokio::test]
async fn a_batch_that_a_restart_interrupts_begins_again() {
    let first = doors(|_| {}).await;
    let options = json!({"mode": "fgo", "batch": true});
    let job = created(&first, LONG.body(&options)).await;
    let turns = all_turns(&first).await;
    let second = restarted_midway(first, turns).await;
    let done = ended(&second, &job).await;
    assert_eq!((&done["state"], &done["progress"]["epochs"]), (&json!("SUCCEEDED"), &json!(301)));
    assert_eq!(kept_answers(&second, &job).await, 0);
}

#[tokio::test]
async fn an_ended_job_expires_with_its_files() {
    let doors = doors(|limits| limits.keep_hours = 0).await;
    let job = created(&doors, MINUTE.body(&json!({}))).await;
    assert!(ended(&doors, &job).await["expiresUtc"].as_str().unwrap().ends_with('Z'));
    let expired = async || {
        doors.service.jobs().remove_expired().await.unwrap();
        doors.get(&format!("/v1/jobs/{job}")).await.0
    };
    crate::support::wait::until("expired", expired, |status| *status == StatusCode::NOT_FOUND)
        .await;
    let doors = doors.restarted().await;
    assert_eq!(files(&doors), 0);
}

#[tokio::test]
async fn an_expired_job_is_removed_at_the_start() {
    let doors = doors(|limits| limits.keep_hours = 0).await;
    let job = created(&doors, MINUTE.body(&json!({}))).await;
    ended(&doors, &job).await;
    let doors = doors.restarted().await;
    let status = async || doors.get(&format!("/v1/jobs/{job}")).await.0;
    crate::support::wait::until("removed", status, |status| *status == StatusCode::NOT_FOUND).await;
}

/// A Postgres database has no folder beside it, so jobs need a configured one.
#[tokio::test]
async fn without_a_folder_no_job_is_taken() {
    on_postgres(async |database| {
        let configuration =
            ServiceConfiguration { database: database.url, ..ServiceConfiguration::standard() };
        let app = app::open(&configuration, PATIENCE, BRISK).await.unwrap();
        let refused = app.service().jobs().upload().await.err().unwrap();
        assert_eq!(refused.code().name(), "JOBS_OFF", "{refused}");
        app.close().await;
    })
    .await;
}

pub(super) fn new_job(id: &str, key: Option<&str>) -> NewJob {
    NewJob {
        webhook_secret: None,
        is_unfetched: false,
        tenant: Tenant::operator(),
        id: id.to_owned(),
        request: "{}".to_owned(),
        request_hash: "c0ffee".to_owned(),
        idempotency_key: key.map(ToOwned::to_owned),
        created_unix_ms: 0,
    }
}

async fn a_queue_gives_each_job_once(database: Database) {
    let (store, tenant): (Store, _) = (database.store().await, Tenant::operator());
    for id in ["one", "two", "three"] {
        assert!(store.create_job(&new_job(id, None)).await.unwrap().1);
    }
    const LONG: Duration = Duration::from_secs(3600);
    let claim = async |silent| store.claim_job("node", silent).await.unwrap();
    let (a, b) = tokio::join!(claim(LONG), claim(LONG));
    let (first, second) = (a.unwrap(), b.unwrap());
    assert_ne!(first.id, second.id);
    let third = claim(LONG).await.unwrap();
    assert!(claim(LONG).await.is_none());
    let progress =
        JobProgress { epochs: 7, answered: 5, read_bytes: 11, resumed_epochs: 3, resumed_bytes: 4 };
    let beat = async |claim| store.beat_job(claim, progress, Duration::ZERO).await.unwrap();
    assert!(beat(first.claim()).await);
    assert_eq!(store.job(&tenant, &first.id).await.unwrap().unwrap().progress, progress);
    assert_eq!(store.waiting_jobs().await.unwrap(), 3);

    // The second and the third job have no heartbeat for two hours; the first has a recent one.
    let silent = "UPDATE jobs SET heartbeat_unix_ms = heartbeat_unix_ms - 7200000 WHERE fence = 1";
    database.execute(&format!("{silent} AND id <> '{}'", first.id)).await;
    let again = [claim(LONG).await.unwrap(), claim(LONG).await.unwrap()];
    assert!(claim(LONG).await.is_none());
    assert_eq!(again.each_ref().map(|row| (row.fence, row.lost_claims)), [(2, 1); 2]);
    assert!(!beat(second.claim()).await);
    let succeeded = JobEnd::Succeeded { result: "r".to_owned(), bytes: 3, report: "{}".to_owned() };
    for (row, is_ended) in [(&third, false), (&again[1], true), (&again[1], false)] {
        let ended = store.end_job(row.claim(), &succeeded, 1300).await.unwrap();
        assert_eq!(ended, is_ended, "{row:?}");
    }
    // The end of a run does not change a cancelled job.
    assert!(store.cancel_job(&tenant, &first.id, 1300).await.unwrap());
    assert!(!store.cancel_job(&tenant, &first.id, 1300).await.unwrap());
    assert!(!store.end_job(first.claim(), &succeeded, 1300).await.unwrap());
    assert_eq!(store.job(&tenant, &first.id).await.unwrap().unwrap().state, JobState::Cancelled);
    // A returned job waits again, and this does not count as a lost claim.
    assert!(store.return_job(again[0].claim()).await.unwrap());
    assert!(!store.return_job(again[0].claim()).await.unwrap());
    let returned = claim(LONG).await.unwrap();
    assert_eq!((returned.id == again[0].id, returned.fence, returned.lost_claims), (true, 4, 1));
    // A start ends all claims only on SQLite, where no other process runs jobs.
    let is_alone = database.url.starts_with("sqlite");
    assert_eq!(store.requeue_jobs().await.unwrap(), u64::from(is_alone));
    let page = store.jobs(&tenant, (None, false), 2, None).await.unwrap();
    assert_eq!(page.items.len(), 2);
    let rest =
        store.jobs(&tenant, (None, false), 2, page.next_page_token.as_deref()).await.unwrap();
    assert_eq!((rest.items.len(), rest.next_page_token), (1, None));
    assert_eq!(store.delete_jobs(1301).await.unwrap(), 2);
    let files = store.job_files().await.unwrap();
    let names: Vec<_> =
        files.iter().map(|row| (&*row.request, &row.result, row.is_ended)).collect();
    assert_eq!(names, [("{}", &None, false)]);
    store.close().await;
}

/// Queues jobs of tenants: name, number of jobs and duration of each. Runs one job after another,
/// until a tenant has no waiting job. Returns the tenants of the jobs in the order of their runs.
async fn runs(store: &Store, jobs: &[(&str, usize, u64)]) -> Vec<(String, u64)> {
    for (tenant, count, _) in jobs {
        for number in 0..*count {
            let tenant = Tenant::parse(tenant).unwrap();
            let id = format!("{}-{number}", tenant.name());
            store.create_job(&NewJob { tenant, ..new_job(&id, None) }).await.unwrap();
        }
    }
    let (mut left, mut runs) = (jobs.to_vec(), Vec::new());
    while left.iter().all(|(_, count, _)| 0 < *count) {
        let row = store.claim_job("node", Duration::from_secs(3600)).await.unwrap().unwrap();
        let of = left.iter_mut().find(|(name, ..)| *name == row.tenant.name()).unwrap();
        of.1 -= 1;
        for second in 1..=of.2 {
            let used = Duration::from_secs(second);
            assert!(store.beat_job(row.claim(), JobProgress::default(), used).await.unwrap());
        }
        let failed = JobEnd::Failed { failure: "{}".to_owned() };
        assert!(store.end_job(row.claim(), &failed, 0).await.unwrap());
        runs.push((of.0.to_owned(), of.2));
    }
    runs
}

/// Each of two tenants gets half of the time, whatever the length and number of its jobs.
async fn tenants_have_the_same_time(database: Database) {
    let store = database.store().await;
    let runs = runs(&store, &[("a", 16, 5), ("b", 80, 1)]).await;
    // This holds from the first minute on.
    let mut all = [0, 0];
    for (tenant, seconds) in &runs {
        all[usize::from(tenant == "b")] += seconds;
        let sum = (all[0] + all[1]) as f64;
        if 60.0 <= sum {
            let part = all[0] as f64 / sum;
            assert!((0.45..=0.55).contains(&part), "{part} of {sum} s: {runs:?}");
        }
    }
    assert!(120 <= all[0] + all[1], "{all:?}");
    store.close().await;
}

/// A tenant that comes later gets no compensation for the time before. While a job of one tenant
/// runs, the next job is one of the other tenant.
async fn a_tenant_that_comes_shares_from_then_on(database: Database) {
    let store = database.store().await;
    let queue = async |tenant: &str, ids: std::ops::Range<usize>| {
        for id in ids {
            let tenant = Tenant::parse(tenant).unwrap();
            let id = format!("{tenant}-{id}");
            store.create_job(&NewJob { tenant, ..new_job(&id, None) }).await.unwrap();
        }
    };
    let claim = async || store.claim_job("node", Duration::from_secs(3600)).await.unwrap().unwrap();
    let run = async || {
        let row = claim().await;
        let used = Duration::from_secs(10);
        store.beat_job(row.claim(), JobProgress::default(), used).await.unwrap();
        let failed = JobEnd::Failed { failure: "{}".to_owned() };
        assert!(store.end_job(row.claim(), &failed, 0).await.unwrap());
        row.tenant.name().to_owned()
    };
    queue("a", 0..30).await;
    for _ in 0..10 {
        assert_eq!(run().await, "a");
    }
    queue("b", 0..10).await;
    let mut served = Vec::new();
    for _ in 0..6 {
        served.push(run().await);
    }
    assert_eq!(served.iter().filter(|tenant| *tenant == "b").count(), 3, "{served:?}");
    let running = [claim().await, claim().await].map(|row| row.tenant.name().to_owned());
    assert_ne!(running[0], running[1]);
    store.close().await;
}

async fn a_request_that_is_repeated_is_one_job(database: Database) {
    let store = database.store().await;
    let create = async |id: &str| store.create_job(&new_job(id, Some("key"))).await.unwrap();
    let (a, b) = tokio::join!(create("one"), create("two"));
    assert_eq!((a.0.id == b.0.id, a.1 != b.1), (true, true), "{a:?} {b:?}");
    store.close().await;
}

/// Files whose gzip stream is cut off or damaged are used up to this point, and the report states
/// it.
#[tokio::test]
async fn files_that_are_cut_off_or_damaged_are_used_up_to_there() {
    let doors = doors(|_| {}).await;
    let cut = |file: &[u8]| {
        let packed = gzip(file);
        packed[..packed.len() * 3 / 4].to_vec()
    };
    // The base ends before the rover, so the base's file is read to its end.
    let (first, second) = MINUTE.base.split_at(MINUTE.base.len() / 3);
    let mut damaged = [gzip(first), gzip(second)].concat();
    damaged[gzip(first).len()] ^= 1;
    let (rover, navigation) = (cut(&MINUTE.rover), cut(&MINUTE.navigation));
    let parts = [
        ("rover", &rover[..]),
        ("navigation", &navigation),
        ("base", &damaged),
        ("options", b"{\"mode\": \"rtk-ekf\"}"),
    ];
    let job = created(&doors, body(&parts)).await;
    let done = ended(&doors, &job).await;
    assert_eq!(done["state"], "SUCCEEDED", "{done}");
    let (_, report) = doors.get(&format!("/v1/jobs/{job}/report")).await;
    let skipped = report["skipped"].as_array().unwrap();
    for (part, what) in [("rover", "cut off"), ("navigation", "cut off"), ("base", "damaged")] {
        let line = format!("{part}: the gzip stream is {what} after ");
        let is_said = skipped.iter().any(|said| said.as_str().unwrap().starts_with(&line));
        assert!(is_said, "{line}: {report}");
    }
}
