//! Batch jobs that curl uploads, while `kill -9` ends the service: no job is lost, and none has two
//! results. The same if the database fails while jobs run.

use std::path::Path;
use std::process::Command;

use axum::http::StatusCode;
use serde_json::Value;

use crate::doors::jobs::{bytes_of, created, ended};
use crate::support::database::{Database, on_both_databases, on_postgres};
use crate::support::doors::Doors;
use crate::support::jobs::{LONG, MINUTE, until_ended};
use crate::support::proxy::{Mode, Proxy};
use crate::support::server::{Server, free_port, opened};
use crate::support::wait::until;

on_both_databases!(jobs_outlive_kill_9);

fn curl(arguments: &[&str]) -> Option<Vec<u8>> {
    let output = Command::new("curl").args(["--silent", "--fail"]).args(arguments).output();
    let output = output.expect("curl is installed");
    output.status.success().then_some(output.stdout)
}

fn json(arguments: &[&str]) -> Value {
    curl(arguments).and_then(|text| serde_json::from_slice(&text).ok()).unwrap_or_default()
}

/// Starts a service whose jobs are in `folder`, and waits until it answers.
async fn started(database: &Database, folder: &Path, port: u16) -> Server {
    let configuration = folder.join("graphfix.toml");
    let jobs = folder.join("jobs");
    std::fs::write(
        &configuration,
        format!("[jobs]\nfolder = \"{}\"\nsilent_s = 2\n", jobs.display()),
    )
    .unwrap();
    let server = Server::start_with(&database.url, port, |command| {
        command.arg("--config").arg(&configuration);
    });
    opened(&server.channel(), None).await;
    server
}

async fn jobs_outlive_kill_9(database: Database) {
    let folder = tempfile::tempdir().unwrap();
    let [rover, navigation, base] = LONG.write(folder.path());
    let port = free_port();
    let url = format!("http://127.0.0.1:{port}/v1/jobs");
    let mut server = started(&database, folder.path(), port).await;
    let file = |part: &str, path: &Path| format!("{part}=@{}", path.display());
    let parts = [file("rover", &rover), file("navigation", &navigation), file("base", &base)];
    let create = |mode: &str| {
        let options = format!("options={{\"mode\": \"{mode}\"}}");
        let [rover, navigation, base] = &parts;
        let job = json(&["-F", rover, "-F", navigation, "-F", base, "-F", &options, &url]);
        job["job"].as_str().unwrap_or_else(|| panic!("{job}")).to_owned()
    };
    let jobs = [create("rtk-ekf"), create("spp")];
    let first = format!("{url}/{}", jobs[0]);
    for kill in 0..2 {
        let runs = |job: &Value| job["progress"]["epochs"].as_u64().is_some_and(|e| 0 < e);
        until("running", async || json(&[&first]), runs).await;
        server.kill();
        eprintln!("kill {kill}");
        server = started(&database, folder.path(), port).await;
    }
    for (job, mode) in jobs.iter().zip(["rtk-ekf", "spp"]) {
        let path = format!("{url}/{job}");
        let ended = until_ended(async || json(&[&path])).await;
        assert_eq!(ended["state"], "SUCCEEDED", "{ended}");
        let result = curl(&[&format!("{path}/result")]).unwrap();
        assert_eq!(result, LONG.solved(&["--mode", mode], "pos"));
    }
    let results = std::fs::read_dir(folder.path().join("jobs/results")).unwrap().count();
    // Each of the two jobs has a result and its figures.
    assert_eq!(results, 4, "results of interrupted runs are left");
}

/// The database ends a job, and its answer is lost. The job keeps its result.
#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn a_lost_answer_of_the_database_loses_no_result() {
    on_postgres(async |database| {
        let proxy = Proxy::before(&database.url).await;
        let doors = Doors::on(&proxy.url(&database.url)).await;
        proxy.set(Mode::CutAfterEndOfJob);
        let options = serde_json::json!({"mode": "spp"});
        let mut jobs = Vec::new();
        for _ in 0..2 {
            jobs.push(created(&doors, MINUTE.body(&options)).await);
        }
        // The second job runs once the first one is over.
        for job in &jobs {
            assert_eq!(ended(&doors, job).await["state"], "SUCCEEDED");
        }
        assert_eq!(proxy.mode(), Mode::Pass, "no answer was lost");
        for job in &jobs {
            let (status, result) = bytes_of(&doors, &format!("/v1/jobs/{job}/result")).await;
            assert_eq!(status, StatusCode::OK, "{}", String::from_utf8_lossy(&result));
            assert_eq!(result, MINUTE.solved(&["--mode", "spp"], "pos"));
        }
        doors.close().await;
    })
    .await;
}
