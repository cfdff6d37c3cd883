//! Batch jobs in a cluster: every node takes, runs and answers them, in one folder.

#![cfg(target_os = "linux")]

use std::path::{Path, PathBuf};
use std::process::Command;

use graphfix::contract::v1;
use graphfix::grpc::v1::navigation_client::NavigationClient;
use graphfix::grpc::v1::positioning_client::PositioningClient;
use serde_json::{Value, json};

use crate::support::database::{Database, on_postgres};
use crate::support::drive::DRIVE;
use crate::support::jobs::{HOUR, MINUTE, form, until_ended};
use crate::support::nodes::{Node, Setting, created, of_session, push_of, two};
use crate::support::server::{ask, free_port, get_with, program};
use crate::support::wait::until;

/// A configuration with a folder of jobs.
struct Place(tempfile::TempDir);

impl Place {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let jobs = folder.path().join("jobs");
        let text = format!("[jobs]\nfolder = \"{}\"\nsilent_s = 2\n", jobs.display());
        std::fs::write(folder.path().join("graphfix.toml"), text).unwrap();
        Self(folder)
    }

    fn configuration(&self) -> PathBuf {
        self.0.path().join("graphfix.toml")
    }

    fn setting(&self) -> Setting {
        Setting::of(&["--config", self.configuration().to_str().unwrap()])
    }

    fn count(&self, folder: &str) -> usize {
        std::fs::read_dir(self.0.path().join("jobs").join(folder)).unwrap().count()
    }
}

fn curl(node: &Node, path: &str, arguments: &[&str]) -> Option<Vec<u8>> {
    let url = format!("http://127.0.0.1:{}/v1/{path}", node.port);
    let output = Command::new("curl").args(["--silent", "--fail", &url]).args(arguments).output();
    let output = output.expect("curl is installed");
    output.status.success().then_some(output.stdout)
}

/// Creates a job of these files.
fn create(node: &Node, files: &[PathBuf; 3], options: &Value) -> String {
    let form = form(files, &options.to_string());
    let arguments: Vec<&str> = form.iter().map(String::as_str).collect();
    let sent = curl(node, "jobs", &arguments).expect("created");
    let job: Value = serde_json::from_slice(&sent).unwrap();
    job["job"].as_str().unwrap().to_owned()
}

fn job(node: &Node, id: &str) -> Value {
    let answer = get_with(node.port, &format!("/v1/jobs/{id}"), "").map(|(_, body)| body);
    serde_json::from_str(&answer.unwrap_or_default()).unwrap_or_default()
}

async fn ended(node: &Node, id: &str) -> Value {
    until_ended(async || job(node, id)).await
}

fn result(node: &Node, id: &str) -> Vec<u8> {
    curl(node, &format!("jobs/{id}/result"), &[]).expect("a result")
}

fn runs(job: &Value) -> bool {
    job["progress"]["epochs"].as_u64().is_some_and(|epochs| 0 < epochs)
}

/// Jobs are created at both nodes, and one node is killed while it runs a job.
#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn jobs_outlive_their_node() {
    on_postgres(async |database| {
        let place = Place::new();
        let (minute, hour) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let (minute, hour) = (MINUTE.write(minute.path()), HOUR.write(hour.path()));
        let [mut first, second] = two(&database.url, &place.setting()).await;
        let options = json!({"mode": "rtk-ekf"});
        let small: Vec<String> =
            [&first, &second, &first, &second].map(|node| create(node, &minute, &options)).into();
        let expected = MINUTE.solved(&["--mode", "rtk-ekf"], "pos");
        for (index, id) in small.iter().enumerate() {
            let [reading, other] =
                if index % 2 == 0 { [&second, &first] } else { [&first, &second] };
            assert_eq!(ended(reading, id).await["state"], "SUCCEEDED");
            assert!(result(reading, id) == expected && result(other, id) == expected, "{id}");
        }
        // One job for each node.
        let long: Vec<String> =
            [&first, &second].map(|node| create(node, &hour, &json!({"mode": "rtk-fgo"}))).into();
        for id in &long {
            until("running", async || job(&second, id), runs).await;
        }
        first.kill();
        let expected = HOUR.solved(&["--mode", "rtk-fgo"], "pos");
        for id in &long {
            assert_eq!(ended(&second, id).await["state"], "SUCCEEDED");
            assert!(result(&second, id) == expected, "{id}");
        }
        first.serve();
        first.is_ready().await;
        assert!(result(&first, &long[0]) == expected);
        // Each result has its figures.
        let expected = 2 * (small.len() + long.len());
        assert_eq!(place.count("results"), expected, "of lost claims");
        // A cancellation at one node stops the run at the other.
        let last: Vec<String> =
            [&first, &second].map(|node| create(node, &hour, &json!({"mode": "rtk-fgo"}))).into();
        for id in &last {
            until("running", async || job(&first, id), runs).await;
            curl(&first, &format!("jobs/{id}"), &["-X", "DELETE"]).unwrap();
            assert_eq!(job(&second, id)["state"], "CANCELLED");
        }
        let next: Vec<String> =
            [&first, &second].map(|node| create(node, &minute, &options)).into();
        for id in &next {
            assert_eq!(ended(&first, id).await["state"], "SUCCEEDED");
        }
        // A run that was stopped removes what it has written.
        let expected = 2 * (small.len() + long.len() + next.len());
        until("no results of stopped runs", async || place.count("results"), |n| *n == expected)
            .await;
    })
    .await;
}

/// Each node receives a part of one upload.
#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn an_upload_goes_on_at_another_node() {
    on_postgres(async |database| {
        let place = Place::new();
        let [first, second] = two(&database.url, &place.setting()).await;
        let folder = tempfile::tempdir().unwrap();
        let [rover, navigation, base] = MINUTE.write(folder.path());
        let whole = std::fs::read(&rover).unwrap();
        let half = whole.len() / 2;
        let version = ("Tus-Resumable", "1.0.0");
        let length = whole.len().to_string();
        let headers = [version, ("Upload-Length", &length)];
        let begun = ask(first.port, ("POST", "/v1/uploads"), &headers, "").unwrap();
        assert_eq!(begun.status, 201, "{begun:?}");
        let path = begun.header("location").to_owned();
        for (node, bytes, offset) in [(&first, &whole[..half], 0), (&second, &whole[half..], half)]
        {
            let at = ask(second.port, ("HEAD", &path), &[version], "").unwrap();
            assert_eq!(at.header("upload-offset"), offset.to_string(), "{at:?}");
            let part = folder.path().join("part");
            std::fs::write(&part, bytes).unwrap();
            let (data, offset) =
                (format!("@{}", part.display()), format!("Upload-Offset: {offset}"));
            let kind = "Content-Type: application/offset+octet-stream";
            let arguments = ["-X", "PATCH", "-H", "Tus-Resumable: 1.0.0", "-H", &offset];
            let more = ["-H", kind, "--data-binary", &data];
            let path = path.trim_start_matches("/v1/");
            curl(node, path, &[&arguments[..], &more[..]].concat()).expect("appended");
        }
        let upload = path.rsplit('/').next().unwrap();
        let options = json!({
            "mode": "rtk-ekf", "uploads": [{"part": "rover", "upload": upload}]
        });
        let parts = [
            format!("navigation=@{}", navigation.display()),
            format!("base=@{}", base.display()),
            format!("options={options}"),
        ];
        let arguments: Vec<&str> = parts.iter().flat_map(|part| ["-F", part]).collect();
        let sent = curl(&first, "jobs", &arguments).expect("created");
        let created: Value = serde_json::from_slice(&sent).unwrap();
        let id = created["job"].as_str().unwrap();
        assert_eq!(ended(&second, id).await["state"], "SUCCEEDED");
        assert!(result(&second, id) == MINUTE.solved(&["--mode", "rtk-ekf"], "pos"));
    })
    .await;
}

/// A job over a session of another node, created as soon as the epochs are acknowledged.
#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn a_job_takes_a_session_of_another_node() {
    on_postgres(async |database| {
        let place = Place::new();
        let [first, second] = two(&database.url, &place.setting()).await;
        let push = v1::PushNavigationRequest { content: DRIVE.navigation_file().into() };
        NavigationClient::new(second.channel()).push(push).await.unwrap();
        let session = created(&second.channel(), "ekf").await;
        for seq in 1..=40 {
            let push = of_session(&session, push_of(&session, seq));
            PositioningClient::new(second.channel()).push_epochs(push).await.unwrap();
        }
        let options = json!({"session": session, "format": "csv"});
        let part = format!("options={options}");
        let sent = curl(&first, "jobs", &["-F", &part]).expect("created");
        let job: Value = serde_json::from_slice(&sent).unwrap();
        let id = job["job"].as_str().unwrap();
        let done = ended(&first, id).await;
        assert_eq!(done["state"], "SUCCEEDED", "{done}");
        let rows = |csv: &[u8], columns: usize| -> Vec<String> {
            let text = String::from_utf8(csv.to_vec()).unwrap();
            let row = |line: &str| line.splitn(columns + 1, ',').last().unwrap().to_owned();
            text.lines().skip(1).map(row).collect()
        };
        // Rows of a session begin with number and revision.
        let stored = curl(&second, &format!("sessions/{session}/track.csv"), &[]).unwrap();
        let (stored, computed) = (rows(&stored, 2), rows(&result(&second, id), 0));
        assert_eq!((stored.len(), &stored), (40, &computed));
    })
    .await;
}

/// The code with which a node with this configuration ends.
fn refused(database: &Database, configuration: &Path) -> String {
    let port = free_port();
    let mut command = Command::new("timeout");
    command.arg("60").arg(program()).args([
        "serve",
        "--database",
        &database.url,
        "--node",
        "third",
    ]);
    command.args(["--cluster", &format!("http://127.0.0.1:{port}")]);
    command.args(["--listen", &format!("127.0.0.1:{port}"), "--log", "error", "--config"]);
    let output = command.arg(configuration).output().unwrap();
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    let code = text.split("error[").nth(1).and_then(|text| text.split(']').next());
    code.unwrap_or_else(|| panic!("{text}")).to_owned()
}

/// A node with another folder, or with a copy of the folder, is refused. It gives up its name at
/// once, so that a node of the same name can start.
#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn all_nodes_have_one_folder() {
    on_postgres(async |database| {
        let place = Place::new();
        let nodes = two(&database.url, &place.setting()).await;
        let other = Place::new();
        assert_eq!(refused(&database, &other.configuration()), "JOB_FOLDER_DIFFERS");
        let own = place.0.path().join("jobs/folder.id");
        std::fs::copy(own, other.0.path().join("jobs/folder.id")).unwrap();
        assert_eq!(refused(&database, &other.configuration()), "JOB_FOLDER_DIFFERS");
        let third = Node::start("third", &database.url, &place.setting()).await;
        third.is_ready().await;
        let marks = |place: &Place| {
            let names = std::fs::read_dir(place.0.path().join("jobs")).unwrap();
            let names = names.map(|entry| entry.unwrap().file_name().into_string().unwrap());
            names.filter(|name| name.starts_with("node.")).count()
        };
        assert_eq!(marks(&place), 3);
        drop((nodes, third));
    })
    .await;
}
