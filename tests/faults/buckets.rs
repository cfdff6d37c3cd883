//! Files of jobs in a bucket of an S3 service. Tests that results are the same as from a folder,
//! that faults of the S3 service are survived or refused, and that workers need no common folder.

use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::time::Duration;

use axum::body::Body;
use axum::http::{Request, StatusCode};
use graphfix::config::JobsConfiguration;
use serde_json::{Value, json};
use tokio::time::sleep;

use crate::doors::jobs::{all_turns, bytes_of, created, ended, post};
use crate::support::buckets::{Buckets, Fault};
use crate::support::database::{Database, on_postgres};
use crate::support::doors::{Doors, code};
use crate::support::jobs::{HOUR, MINUTE, body, form, until_ended};
#[cfg(target_os = "linux")]
use crate::support::nodes::{Node, Setting};
use crate::support::server::{Server, free_port, program};
use crate::support::wait::until;

const SPP: &str = "{\"mode\": \"spp\"}";

fn options() -> Value {
    serde_json::from_str(SPP).unwrap()
}

fn expected() -> Vec<u8> {
    MINUTE.solved(&["--mode", "spp"], "pos")
}

/// A service on SQLite with a bucket.
async fn doors(buckets: &Buckets) -> Doors {
    let jobs = JobsConfiguration::standard();
    Doors::with_jobs(JobsConfiguration { s3: Some(buckets.configuration()), ..jobs }).await
}

/// Number of incoming files in the folder of a service.
fn left(folder: &Path) -> usize {
    std::fs::read_dir(folder.join("incoming")).unwrap().count()
}

/// Checks that each request has the signature that Amazon's own code computes: `moto` accepts any
/// signature.
fn check_signatures(buckets: &Buckets) {
    let (requests, right) = buckets.signed_with("a-secret");
    assert!(0 < requests && right == requests, "{right} of {requests}");
    assert_eq!(buckets.signed_with("another"), (requests, 0));
}

/// Files that are uploaded, computed, repeated, deleted and expired.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_job_has_its_files_in_a_bucket() {
    let Some(buckets) = Buckets::start().await else { return };
    let doors = doors(&buckets).await;
    let job = created(&doors, MINUTE.body(&options())).await;
    assert_eq!(ended(&doors, &job).await["state"], "SUCCEEDED");
    let result = format!("/v1/jobs/{job}/result");
    assert!(bytes_of(&doors, &result).await == (StatusCode::OK, expected()));
    let (inputs, results) = (buckets.names("of/us/inputs/"), buckets.names("of/us/results/"));
    assert_eq!((inputs.len(), results.len()), (3, 2), "the result and its figures");
    let key = format!("of/us/results/{}", results[0]);
    assert!(buckets.ask(&["get", &key]) == expected(), "for a client of others");
    let page = format!("/v1/jobs/{job}/report?format=html");
    let (status, page) = bytes_of(&doors, &page).await;
    assert_eq!(status, StatusCode::OK);
    assert!(String::from_utf8(page).unwrap().contains("Height over time"), "its figures");
    // No incoming file is left.
    let folder = doors.folder().join("test.db.jobs");
    assert_eq!((left(&folder), folder.join("inputs").exists()), (0, false));
    // Equal files are stored once.
    let again = created(&doors, MINUTE.body(&options())).await;
    assert_eq!(ended(&doors, &again).await["state"], "SUCCEEDED");
    assert_eq!(buckets.names("of/us/inputs/"), inputs);
    let doors = doors.restarted().await;
    assert!(bytes_of(&doors, &result).await == (StatusCode::OK, expected()));
    for job in [&job, &again] {
        let (status, gone) =
            doors.send("DELETE", &format!("/v1/jobs/{job}?purge=true"), Value::Null).await;
        assert_eq!(status, StatusCode::OK, "{gone}");
    }
    assert!(buckets.names("of/us/results/").is_empty());
    // Recent files stay, since the row of their job may not be stored yet.
    doors.service.jobs().remove_expired().await.unwrap();
    assert_eq!(buckets.names("of/us/inputs/"), inputs);
    buckets.set(Fault::Old);
    doors.service.jobs().remove_expired().await.unwrap();
    assert_eq!(buckets.names("of/us/"), ["folder.id"]);
    doors.close().await;
    check_signatures(&buckets);
}

/// Appends to an upload that may take several requests.
async fn appended(doors: &Doors, upload: &str, content: &[u8]) -> (StatusCode, Value) {
    let request = Request::patch(format!("/v1/uploads/{upload}")).header("upload-offset", "0");
    let request = request.header("tus-resumable", "1.0.0");
    let request = request.header("content-type", "application/offset+octet-stream");
    doors.ask(request.body(Body::from(content.to_vec())).unwrap()).await
}

/// Begins such an upload. Returns its id.
async fn begun(doors: &Doors, content: &[u8]) -> String {
    let request = Request::post("/v1/uploads").header("tus-resumable", "1.0.0");
    let request = request.header("upload-length", content.len().to_string());
    let (status, upload) = doors.ask(request.body(Body::empty()).unwrap()).await;
    assert_eq!(status, StatusCode::CREATED, "{upload}");
    upload["upload"].as_str().unwrap().to_owned()
}

/// A file that is sent to the bucket in three parts. The bucket refuses it at first. It is stored
/// later, although every third request fails, and it counts in the used space.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_large_file_goes_up_in_parts() {
    let Some(buckets) = Buckets::start().await else { return };
    let jobs = JobsConfiguration {
        s3: Some(buckets.configuration()),
        total_bytes: 30_000_000,
        ..JobsConfiguration::standard()
    };
    let doors = Doors::with_jobs(jobs).await;
    let mut seed = 1_u32;
    let content = std::iter::repeat_with(|| {
        seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (seed >> 24) as u8
    });
    let content: Vec<u8> = content.take(20_000_000).collect();
    let upload = begun(&doors, &content).await;
    buckets.set(Fault::Refuses(99, "403 Forbidden", "InvalidAccessKeyId"));
    let (status, problem) = appended(&doors, &upload, &content).await;
    assert_eq!((status.as_u16(), code(&problem)), (503, "BUCKET_REFUSES"), "{problem}");
    assert!(problem.to_string().contains("InvalidAccessKeyId"), "{problem}");
    // The service has all bytes of the upload. It stores them in the bucket when a job names the
    // upload.
    buckets.set(Fault::Flaky(2, 0));
    let uploads = json!({"uploads": [{"part": "rover", "upload": upload}]}).to_string();
    let parts = [("navigation", &MINUTE.navigation[..]), ("options", uploads.as_bytes())];
    let (status, job) = post(&doors, body(&parts), &[]).await;
    assert_eq!(status, StatusCode::CREATED, "{job}");
    let key = format!("of/us/inputs/{}", blake3_of(&content));
    assert!(buckets.ask(&["get", &key]) == content);
    assert_eq!(buckets.ask(&["parts"]), b"0\n");
    buckets.set(Fault::None);
    // After a restart, when the service counts the objects, the file still uses space.
    let doors = doors.restarted().await;
    let other = vec![b'x'; content.len()];
    let upload = begun(&doors, &other).await;
    let (status, problem) = appended(&doors, &upload, &other).await;
    assert_eq!((status.as_u16(), code(&problem)), (429, "JOB_SPACE_EXHAUSTED"), "{problem}");
    doors.close().await;
    check_signatures(&buckets); // Those of the parts, too.
}

fn blake3_of(content: &[u8]) -> String {
    blake3::hash(content).to_hex().to_string()
}

/// Answers that fail, break off or are wrong.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn faults_of_the_service_pass_or_are_refused() {
    let Some(buckets) = Buckets::start().await else { return };
    let doors = doors(&buckets).await;
    // Every third request is refused at first.
    buckets.set(Fault::Flaky(2, 2));
    let job = created(&doors, MINUTE.body(&options())).await;
    assert_eq!(ended(&doors, &job).await["state"], "SUCCEEDED");
    // A download of an input that breaks continues where it broke.
    buckets.set(Fault::Cuts(5, 10_000));
    let job = created(&doors, MINUTE.body(&options())).await;
    assert_eq!(ended(&doors, &job).await["state"], "SUCCEEDED");
    assert_eq!(buckets.fault(), Fault::None);
    let result = format!("/v1/jobs/{job}/result");
    buckets.set(Fault::Cuts(3, 1_000));
    assert!(bytes_of(&doors, &result).await == (StatusCode::OK, expected()));
    assert_eq!(buckets.fault(), Fault::None);
    // A fault that lasts refuses the job, and leaves no file.
    for (fault, code) in [
        (Fault::Away, "BUCKET_UNAVAILABLE"),
        (Fault::Refuses(99, "403 Forbidden", "SignatureDoesNotMatch"), "BUCKET_REFUSES"),
        (Fault::Refuses(99, "404 Not Found", "NoSuchBucket"), "BUCKET_REFUSES"),
        (Fault::Refuses(99, "503 Slow Down", "SlowDown"), "BUCKET_UNAVAILABLE"),
    ] {
        buckets.set(fault);
        let (status, problem) = post(&doors, MINUTE.body(&options()), &[]).await;
        assert_eq!((status.as_u16(), problem["code"].as_str()), (503, Some(code)), "{problem}");
        assert_eq!(left(&doors.folder().join("test.db.jobs")), 0);
        let (status, _) = bytes_of(&doors, &result).await;
        assert_eq!(status, StatusCode::SERVICE_UNAVAILABLE, "{fault:?}");
    }
    buckets.set(Fault::None);
    // Inputs that are missing, or have other content. The second job waits for the end of the
    // first.
    let folder = tempfile::tempdir().unwrap();
    let other = folder.path().join("other");
    std::fs::write(&other, vec![b'x'; MINUTE.rover.len()]).unwrap();
    let key = format!("of/us/inputs/{}", blake3_of(&MINUTE.rover));
    for arguments in [&["put", &key, other.to_str().unwrap()][..], &["delete", &key]] {
        let turns = all_turns(&doors).await;
        let first = created(&doors, MINUTE.body(&options())).await;
        let is_running = |job: &Value| job["state"] == "RUNNING";
        doors.until(&format!("/v1/jobs/{first}"), is_running).await;
        let second = created(&doors, MINUTE.body(&options())).await;
        sleep(Duration::from_secs(2)).await;
        buckets.ask(arguments);
        drop(turns);
        let failed = ended(&doors, &second).await;
        assert_eq!(failed["failure"]["code"], "JOB_FILES_FAILED", "{failed}");
        assert_eq!(ended(&doors, &first).await["state"], "SUCCEEDED");
    }
    doors.close().await;
}

/// A process that is killed when dropped.
struct Process(Child);

impl Drop for Process {
    fn drop(&mut self) {
        // Err: it has ended.
        self.0.kill().ok();
        self.0.wait().ok();
    }
}

/// A machine with a folder of its own, which also contains the configuration.
struct Machine(tempfile::TempDir);

impl Machine {
    fn new(buckets: &Buckets, prefix: &str, running: usize) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let jobs = folder.path().join("jobs").display().to_string();
        let jobs = format!("[jobs]\nfolder = \"{jobs}\"\nrunning = {running}\n");
        let jobs = jobs + "silent_s = 2\ncheckpoint_s = 1\n";
        let keys = folder.path().join("keys");
        let text = "[default]\naws_access_key_id = an-id\naws_secret_access_key = a-secret\n";
        std::fs::write(&keys, text).unwrap();
        let s3 = format!("{}credentials_file = \"{}\"\n", buckets.toml(prefix), keys.display());
        std::fs::write(folder.path().join("graphfix.toml"), jobs + &s3).unwrap();
        Self(folder)
    }

    fn command(&self, command: &str, database: &Database) -> Command {
        let mut worker = Command::new(program());
        worker.args([command, "--log", "warn", "--database", &database.url, "--config"]);
        worker.arg(self.0.path().join("graphfix.toml")).stdin(Stdio::null());
        worker
    }

    fn left(&self) -> usize {
        left(&self.0.path().join("jobs"))
    }
}

fn curl(port: u16, path: &str, arguments: &[&str]) -> Option<Vec<u8>> {
    let url = format!("http://127.0.0.1:{port}/v1/jobs{path}");
    let output = Command::new("curl").args(["--silent", "--fail", &url]).args(arguments).output();
    let output = output.expect("curl is installed");
    output.status.success().then_some(output.stdout)
}

fn refused(output: &Output) -> String {
    let text = String::from_utf8_lossy(&output.stderr);
    let code = text.split("error[").nth(1).and_then(|text| text.split(']').next());
    code.unwrap_or_else(|| panic!("{text}")).to_owned()
}

/// The service and its workers share a database and a bucket, but no folder. A worker is killed
/// while it runs a job. Another worker continues after the checkpoint.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn workers_elsewhere_need_the_bucket_only() {
    let Some(buckets) = Buckets::start().await else { return };
    let buckets = &buckets;
    on_postgres(async |database| {
        let [here, there, third] = [(); 3].map(|()| Machine::new(buckets, "fleet", 0));
        let configuration = here.0.path().join("graphfix.toml");
        let server = Server::start_with(&database.url, free_port(), |command| {
            command.arg("--config").arg(&configuration);
        });
        let port = server.port;
        until("served", async || curl(port, "", &[]), Option::is_some).await;
        let mut worker = Process(there.command("worker", &database).spawn().unwrap());
        let place = tempfile::tempdir().unwrap();
        let files = HOUR.write(place.path());
        let create = |options: &str| {
            let form = form(&files, options);
            let arguments: Vec<&str> = form.iter().map(String::as_str).collect();
            let job = curl(port, "", &arguments).expect("created");
            let job: Value = serde_json::from_slice(&job).unwrap();
            job["job"].as_str().unwrap().to_owned()
        };
        let get = |job: &str| -> Value {
            let answer = curl(port, &format!("/{job}"), &[]).unwrap_or_default();
            serde_json::from_slice(&answer).unwrap_or_default()
        };
        buckets.set(Fault::Holds("/results/")); // However fast the worker is, it does not end.
        let job = create("{\"mode\": \"fgo\"}");
        let checkpoints = async || buckets.names("fleet/checkpoints/").len();
        until("a checkpoint", checkpoints, |count| 0 < *count).await;
        worker.0.kill().unwrap();
        worker.0.wait().unwrap();
        buckets.set(Fault::None);
        assert_eq!(there.left(), 0, "a file of the killed worker");
        let other = Process(third.command("worker", &database).spawn().unwrap());
        let done = until_ended(async || get(&job)).await;
        assert_eq!(done["state"], "SUCCEEDED", "{done}");
        let result = curl(port, &format!("/{job}/result"), &[]).unwrap();
        assert!(result == HOUR.solved(&["--mode", "fgo"], "pos"));
        let report = get(&format!("{job}/report")).to_string();
        assert!(report.contains("answers are those of a run that was cut off"), "{report}");
        assert_eq!(buckets.names("fleet/results/").len(), 2, "with its figures");
        until("the checkpoints are removed", checkpoints, |count| *count == 0).await;
        assert_eq!((here.left(), third.left()), (0, 0));
        drop(other);
        // Another bucket is refused, and so is a bucket that cannot be read.
        let elsewhere = Machine::new(buckets, "elsewhere", 0);
        let answered = elsewhere.command("worker", &database).output().unwrap();
        assert_eq!(refused(&answered), "JOB_FOLDER_DIFFERS");
        buckets.set(Fault::Refuses(99, "403 Forbidden", "InvalidAccessKeyId"));
        let answered = there.command("worker", &database).output().unwrap();
        assert_eq!(refused(&answered), "BUCKET_REFUSES");
        buckets.set(Fault::None);
        std::fs::remove_file(there.0.path().join("keys")).unwrap();
        let answered = there.command("worker", &database).output().unwrap();
        assert_eq!(refused(&answered), "BUCKET_REFUSES");
        drop(server);
    })
    .await;
}

/// Two nodes of a cluster, each with a folder of its own. One node gives the result that the other
/// has computed.
#[cfg(target_os = "linux")]
#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn nodes_need_the_bucket_only() {
    let Some(buckets) = Buckets::start().await else { return };
    let buckets = &buckets;
    on_postgres(async |database| {
        // The second node runs no jobs.
        let machines = [1, 0].map(|running| Machine::new(buckets, "nodes", running));
        let mut nodes = Vec::new();
        for (name, machine) in ["first", "second"].into_iter().zip(&machines) {
            let configuration = machine.0.path().join("graphfix.toml");
            let setting = Setting::of(&["--config", configuration.to_str().unwrap()]);
            let node = Node::start(name, &database.url, &setting).await;
            node.is_ready().await;
            nodes.push(node);
        }
        let port = nodes[1].port;
        let place = tempfile::tempdir().unwrap();
        let form = form(&MINUTE.write(place.path()), SPP);
        let arguments: Vec<&str> = form.iter().map(String::as_str).collect();
        let job: Value =
            serde_json::from_slice(&curl(port, "", &arguments).expect("created")).unwrap();
        let path = format!("/{}/result", job["job"].as_str().unwrap());
        let result = until("a result", async || curl(port, &path, &[]), Option::is_some).await;
        assert!(result.unwrap() == expected());
        assert_eq!(buckets.names("nodes/node.").len(), 2);
        let answered = Machine::new(buckets, "others", 0);
        let port = free_port().to_string();
        let mut command = answered.command("serve", &database);
        command.args(["--node", "third", "--listen", &format!("127.0.0.1:{port}")]);
        let output = command.args(["--cluster", &format!("http://127.0.0.1:{port}")]).output();
        assert_eq!(refused(&output.unwrap()), "JOB_FOLDER_DIFFERS");
    })
    .await;
}
