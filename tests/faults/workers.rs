//! Workers are processes beside the service that run jobs. `kill -9`, frozen processes and too
//! little memory lose no job, and no job has two results.

use std::path::PathBuf;
use std::process::{Child, Command, Output, Stdio};

use serde_json::Value;

use crate::support::database::{Database, on_postgres};
use crate::support::jobs::{HOUR, MINUTE, form, until_ended};
use crate::support::server::{Server, free_port};
use crate::support::wait::until;

/// A service that runs no jobs, and its folder.
struct World {
    database: Database,
    folder: tempfile::TempDir,
    port: u16,
    keys: Vec<String>,
}

/// A process that is killed when dropped.
struct Worker(Child);

impl Drop for Worker {
    fn drop(&mut self) {
        // Err: it has ended.
        self.0.kill().ok();
        self.0.wait().ok();
    }
}

impl Worker {
    /// Sends its process a signal by name.
    fn signal(&self, name: &str) {
        let id = self.0.id().to_string();
        assert!(Command::new("kill").args([&format!("-{name}"), &id]).status().unwrap().success());
    }
}

fn graphfix(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_graphfix")).args(arguments).output().unwrap()
}

impl World {
    /// Two tenants with a key each.
    fn new(database: Database) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let jobs = folder.path().join("jobs");
        let limits = "running = 0\nsilent_s = 2\ncheckpoint_s = 1\n";
        let text = format!("[jobs]\nfolder = \"{}\"\n{limits}", jobs.display());
        std::fs::write(folder.path().join("graphfix.toml"), text).unwrap();
        let key = |tenant: &str| {
            let rights = ["--right", "read,operate", "--tenant", tenant];
            let created =
                graphfix(&[&["keys", "create", "--database", &database.url], &rights[..]].concat());
            let text = String::from_utf8(created.stdout).unwrap();
            let secret = text.split_whitespace().find(|word| word.starts_with("gfx_"));
            secret.unwrap_or_else(|| panic!("{text}")).to_owned()
        };
        let keys = ["a", "b"].map(key).into();
        Self { folder, port: free_port(), keys, database }
    }

    fn configuration(&self) -> PathBuf {
        self.folder.path().join("graphfix.toml")
    }

    /// Starts the service, and waits until it answers.
    async fn served(&self) -> Server {
        let server = Server::start_with(&self.database.url, self.port, |command| {
            command.arg("--config").arg(self.configuration());
        });
        until("served", async || self.get(0, ""), |answer| !answer.is_null()).await;
        server
    }

    fn worker(&self, arguments: &[&str]) -> Worker {
        let mut command = Command::new(env!("CARGO_BIN_EXE_graphfix"));
        command.args(["worker", "--log", "warn", "--database", &self.database.url, "--config"]);
        command.arg(self.configuration()).args(arguments).stdin(Stdio::null());
        Worker(command.spawn().unwrap())
    }

    fn curl(&self, tenant: usize, path: &str, arguments: &[&str]) -> Option<Vec<u8>> {
        let key = format!("Authorization: Bearer {}", self.keys[tenant]);
        let url = format!("http://127.0.0.1:{}/v1/jobs{path}", self.port);
        let output = Command::new("curl")
            .args(["--silent", "--fail", "-H", &key, &url])
            .args(arguments)
            .output();
        let output = output.expect("curl is installed");
        output.status.success().then_some(output.stdout)
    }

    fn get(&self, tenant: usize, path: &str) -> Value {
        let text = self.curl(tenant, path, &[]);
        text.and_then(|text| serde_json::from_slice(&text).ok()).unwrap_or_default()
    }

    fn create(&self, tenant: usize, files: &[PathBuf; 3], options: &str) -> String {
        let form = form(files, options);
        let sent = self.curl(tenant, "", &form.iter().map(String::as_str).collect::<Vec<_>>());
        let job: Value = serde_json::from_slice(&sent.expect("created")).unwrap();
        job["job"].as_str().unwrap().to_owned()
    }

    async fn until_it(&self, job: &str, what: &str, is_so: impl Fn(&Value) -> bool) -> Value {
        until(what, async || self.get(0, &format!("/{job}")), is_so).await
    }

    async fn until_ended(&self, job: &str) -> Value {
        until_ended(async || self.get(0, &format!("/{job}"))).await
    }

    fn results(&self) -> usize {
        self.files("results")
    }

    /// Number of files in a folder of the jobs.
    fn files(&self, inside: &str) -> usize {
        let folder = self.folder.path().join("jobs").join(inside);
        std::fs::read_dir(folder).unwrap().count()
    }
}

fn runs(job: &Value) -> bool {
    job["progress"]["epochs"].as_u64().is_some_and(|epochs| 0 < epochs)
}

/// Twelve jobs of two tenants, with the service and both workers killed at arbitrary times.
#[tokio::test]
async fn kill_9_of_service_and_workers_loses_no_job() {
    on_postgres(async |database| {
        let world = World::new(database);
        let files = MINUTE.write(world.folder.path());
        let mut server = world.served().await;
        let jobs: Vec<(usize, String)> = (0..12)
            .map(|index| (index % 2, world.create(index % 2, &files, "{\"mode\": \"rtk-ekf\"}")))
            .collect();
        let done = || {
            let states = jobs.iter().map(|(tenant, job)| world.get(*tenant, &format!("/{job}")));
            states.filter(|job| job["state"] == "SUCCEEDED").count()
        };
        let mut workers = vec![world.worker(&[]), world.worker(&["--running", "2"])];
        for kill in 0..3 {
            until("some are done", async || done(), |done| 2 * kill < *done).await;
            workers[kill % 2] = world.worker(&[]); // Drops, and so kills, the previous one.
            server.kill();
            server = world.served().await;
        }
        until("all are done", async || done(), |done| *done == jobs.len()).await;
        let expected = MINUTE.solved(&["--mode", "rtk-ekf"], "pos");
        for (tenant, job) in &jobs {
            let result = world.curl(*tenant, &format!("/{job}/result"), &[]).unwrap();
            assert_eq!(result, expected, "{job}");
        }
        assert_eq!(world.results(), 2 * jobs.len(), "results of interrupted runs are left");
        drop((workers, server));
    })
    .await;
}

/// A job whose worker is killed continues after its last checkpoint, even if the service is killed
/// at the same time.
#[tokio::test]
async fn a_killed_run_goes_on_after_its_checkpoint() {
    on_postgres(async |database| {
        let world = World::new(database);
        let files = HOUR.write(world.folder.path());
        let mut server = world.served().await;
        let worker = world.worker(&[]);
        let options = "{\"mode\": \"rtk-fgo\", \"smoothed\": true, \"format\": \"geojson\"}";
        let job = world.create(0, &files, options);
        until("a checkpoint", async || world.files("checkpoints"), |files| 0 < *files).await;
        drop(worker); // Killed.
        server.kill();
        server = world.served().await;
        let worker = world.worker(&[]);
        let done = world.until_ended(&job).await;
        assert_eq!(done["state"], "SUCCEEDED", "{done}");
        let report = world.get(0, &format!("/{job}/report")).to_string();
        assert!(report.contains("answers are those of a run that was cut off"), "{report}");
        let result = world.curl(0, &format!("/{job}/result"), &[]).unwrap();
        assert!(result == HOUR.solved(&["--mode", "rtk-fgo", "--smoothed"], "geojson"));
        let removed = async || world.files("checkpoints");
        until("the checkpoints are removed", removed, |files| *files == 0).await;
        drop((worker, server));
    })
    .await;
}

/// A frozen worker loses its job to another, and publishes no result when it runs again.
#[tokio::test]
async fn a_frozen_worker_loses_its_job() {
    on_postgres(async |database| {
        let world = World::new(database);
        let files = HOUR.write(world.folder.path());
        let server = world.served().await;
        let frozen = world.worker(&["--node", "frozen"]);
        let job = world.create(0, &files, "{\"mode\": \"rtk-fgo\"}");
        world.until_it(&job, "running", runs).await;
        frozen.signal("STOP");
        let other = world.worker(&["--node", "other"]);
        let done = world.until_ended(&job).await;
        assert_eq!(done["state"], "SUCCEEDED", "{done}");
        let result = || world.curl(0, &format!("/{job}/result"), &[]).unwrap();
        let (first, report) = (result(), world.get(0, &format!("/{job}/report")));
        assert_eq!(first, HOUR.solved(&["--mode", "rtk-fgo"], "pos"));
        frozen.signal("CONT");
        // Once the worker takes another job, it has noticed that it lost the first.
        drop(other);
        let next = world.create(0, &files, "{\"mode\": \"spp\"}");
        assert_eq!(world.until_ended(&next).await["state"], "SUCCEEDED");
        assert_eq!((world.get(0, &format!("/{job}/report")), result()), (report, first));
        assert_eq!(world.results(), 4, "the frozen worker has left a result");
        drop(server);
    })
    .await;
}

/// A cancellation stops the run of a worker within seconds, and an interrupted worker returns its
/// job.
#[tokio::test]
async fn a_worker_is_told_to_stop() {
    on_postgres(async |database| {
        let world = World::new(database);
        let files = HOUR.write(world.folder.path());
        let server = world.served().await;
        let mut worker = world.worker(&[]);
        let job = world.create(0, &files, "{\"mode\": \"rtk-fgo\"}");
        let running = world.until_it(&job, "running", runs).await;
        assert!(0.0 < running["progress"]["percent"].as_f64().unwrap(), "{running}");
        world.curl(0, &format!("/{job}"), &["-X", "DELETE"]).unwrap();
        assert_eq!(world.get(0, &format!("/{job}"))["state"], "CANCELLED");
        let next = world.create(0, &files, "{\"mode\": \"rtk-fgo\"}");
        world.until_it(&next, "running", runs).await;
        worker.signal("TERM");
        assert!(worker.0.wait().unwrap().success());
        let queued = world.get(0, &format!("/{next}"));
        assert_eq!(queued["state"], "QUEUED", "{queued}");
        assert_eq!(world.results(), 0);
        drop(server);
    })
    .await;
}

/// The memory of a worker is limited. A job that has ended several workers fails.
#[tokio::test]
async fn a_job_that_ends_its_workers_fails() {
    on_postgres(async |database| {
        let world = World::new(database);
        let files = HOUR.write(world.folder.path());
        let server = world.served().await;
        let job = world.create(0, &files, "{\"mode\": \"rtk-fgo\"}");
        let small = world.worker(&["--memory", "100"]);
        world.until_it(&job, "running", runs).await;
        if cfg!(target_os = "linux") {
            let limits = std::fs::read_to_string(format!("/proc/{}/limits", small.0.id())).unwrap();
            let data = limits.lines().find(|line| line.starts_with("Max data size")).unwrap();
            assert_eq!(data.matches(&(100 << 20).to_string()).count(), 2, "{data}");
        }
        drop(small); // Kills the worker, as a failed allocation would.
        world.database.execute("UPDATE jobs SET lost_claims = 4").await;
        let worker = world.worker(&[]);
        let failed = world.until_ended(&job).await;
        assert_eq!(failed["failure"]["code"], "JOB_LOST", "{failed}");
        assert_eq!(world.results(), 0, "{failed}");
        drop((worker, server));
    })
    .await;
}

/// A worker needs Postgres and the service's folder.
#[tokio::test]
async fn a_worker_that_cannot_work_says_so() {
    fn code(output: &Output) -> String {
        assert!(!output.status.success());
        let text = String::from_utf8_lossy(&output.stderr);
        let code = text.split("error[").nth(1).and_then(|text| text.split(']').next());
        code.unwrap_or_else(|| panic!("{text}")).to_owned()
    }
    let sqlite = Database::sqlite();
    let folder = tempfile::tempdir().unwrap();
    let elsewhere = folder.path().to_str().unwrap();
    let on_sqlite = graphfix(&["worker", "--database", &sqlite.url, "--folder", elsewhere]);
    assert_eq!(code(&on_sqlite), "WORKER_NEEDS_POSTGRES");
    on_postgres(async |database| {
        let world = World::new(database);
        let server = world.served().await;
        let database = ["worker", "--database", &world.database.url];
        for folder in [elsewhere, "/nowhere"] {
            let other = graphfix(&[&database[..], &["--folder", folder]].concat());
            assert_eq!(code(&other), "JOB_FOLDER_DIFFERS");
        }
        assert_eq!(code(&graphfix(&database)), "JOBS_OFF");
        drop(server);
    })
    .await;
}
