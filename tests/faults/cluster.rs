//! A Postgres server of its own whose disk fails, or that is killed.

#![cfg(target_os = "linux")]

use std::fs;
use std::os::unix::fs::MetadataExt;
use std::path::PathBuf;
use std::process::{Command, Stdio};

use sqlx::{Connection, PgConnection};
use tempfile::TempDir;

use crate::support::data;
use crate::support::failing::{Failing, library};
use crate::support::server::free_port;
use crate::support::wait::until;

/// A server in a folder, with `failing.c` preloaded.
struct Cluster {
    folder: TempDir,
    programs: PathBuf,
    port: u16,
}

impl Cluster {
    /// `None` (noted) where no server is installed.
    #[track_caller]
    fn start() -> Option<Self> {
        let versions = fs::read_dir("/usr/lib/postgresql").ok();
        let newest =
            versions.and_then(|found| found.filter_map(Result::ok).map(|v| v.path()).max());
        let Some(newest) = newest else {
            data::note_missing("PostgreSQL of its own");
            return None;
        };
        let folder = tempfile::tempdir().unwrap();
        library(folder.path());
        let cluster = Self { folder, programs: newest.join("bin"), port: free_port() };
        cluster.set("none");
        let owned = Command::new("chown").arg("postgres").arg(cluster.folder.path()).status();
        assert!(owned.unwrap().success());
        let made = cluster.run("initdb", &["-U", "postgres", "-A", "trust", "--no-sync", "data"]);
        assert!(made, "initdb");
        cluster.serve();
        Some(cluster)
    }

    /// Runs a program of Postgres in the folder, as the user of Postgres: it refuses to run as
    /// root.
    fn run(&self, program: &str, arguments: &[&str]) -> bool {
        let folder = self.folder.path();
        let is_root = fs::metadata("/proc/self").unwrap().uid() == 0;
        let mut command = Command::new(if is_root { "runuser" } else { "env" });
        if is_root {
            command.args(["-u", "postgres", "--", "env"]);
        }
        command.arg(format!("LD_PRELOAD={}", folder.join("failing.so").display()));
        command.arg(format!("GRAPHFIX_FAULT={}", folder.join("fault").display()));
        command.arg(format!("GRAPHFIX_FAULT_FILES={}", folder.join("data").display()));
        command.arg(self.programs.join(program)).args(arguments).current_dir(folder);
        command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
        command.status().unwrap().success()
    }

    fn set(&self, fault: &str) {
        fs::write(self.folder.path().join("fault"), fault).unwrap();
    }

    fn url(&self) -> String {
        format!("postgres://postgres@127.0.0.1:{}/postgres", self.port)
    }

    fn serve(&self) {
        let folder = self.folder.path().display();
        let options = format!(
            "-p {} -c listen_addresses=127.0.0.1 -c unix_socket_directories={folder}",
            self.port
        );
        let start = ["start", "-D", "data", "-w", "-l", "log", "-o", &options];
        assert!(self.run("pg_ctl", &start), "{}", self.log());
    }

    fn log(&self) -> String {
        fs::read_to_string(self.folder.path().join("log")).unwrap_or_default()
    }

    /// Waits until the server answers, and starts it if it has ended.
    async fn answers(&self) {
        let answers = async || {
            if PgConnection::connect(&self.url()).await.is_ok() {
                return true;
            }
            if !self.run("pg_ctl", &["status", "-D", "data"]) {
                self.serve();
            }
            false
        };
        until("answered by the server", answers, |answers| *answers).await;
    }
}

impl Drop for Cluster {
    fn drop(&mut self) {
        self.run("pg_ctl", &["stop", "-D", "data", "-m", "immediate"]);
    }
}

/// A disk that fails ends the processes of the server, and perhaps the server itself. Once the
/// server answers again, the service does, too.
#[tokio::test]
async fn the_disk_of_the_server_fails() {
    let Some(cluster) = Cluster::start() else { return };
    let mut service = Failing::start(&cluster.url()).await;
    for (index, fault) in ["full", "broken", "unsynced", "slow 7"].into_iter().enumerate() {
        let seq = 10 * index as u64 + 1;
        service.push(seq).await.unwrap();
        cluster.set(fault);
        service.refuses(fault, seq + 1).await;
        service.is_ready(503).await;
        cluster.set("none");
        cluster.answers().await;
        service.serves_again(fault, seq + 1).await;
    }
    service.finish().await;
}

/// The server is killed. This is like a power failure, except that the disk loses nothing of its
/// own cache.
#[tokio::test]
async fn a_server_that_is_killed_loses_nothing() {
    let Some(cluster) = Cluster::start() else { return };
    let mut service = Failing::start(&cluster.url()).await;
    for round in 0..3 {
        for seq in 10 * round + 1..10 * round + 6 {
            service.push(seq).await.unwrap();
        }
        cluster.run("pg_ctl", &["stop", "-D", "data", "-m", "immediate"]);
        service.refuses("killed", 10 * round + 6).await;
        service.is_ready(503).await;
        cluster.answers().await;
        service.serves_again("killed", 10 * round + 6).await;
    }
    service.finish().await;
}
