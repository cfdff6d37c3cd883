//! A disk that fails under a running service: full, broken, not synchronising, slow.
//!
//! `disk.c` is preloaded into `graphfix serve`; a file controls which writes fail.

#![cfg(target_os = "linux")]

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

use graphfix::contract::v1;
use graphfix::grpc::code_of;
use graphfix::grpc::v1::positioning_client::PositioningClient;
use graphfix::grpc::v1::solutions_client::SolutionsClient;
use tonic::transport::Channel;

use crate::support::doors::epoch;
use crate::support::server::{Server, free_port, opened, replayed, status_of};
use crate::support::wait::until;

const REFUSED_WITHIN: Duration = Duration::from_secs(7);
const SERVED_WITHIN: Duration = Duration::from_secs(5);

/// Compiles `disk.c`.
fn library(folder: &Path) -> PathBuf {
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/faults/disk.c");
    let library = folder.join("disk.so");
    let mut command = Command::new("cc");
    command.args(["-shared", "-fPIC", "-O1", "-Wall", "-Werror", "-o"]).arg(&library).arg(source);
    assert!(command.arg("-ldl").status().expect("cc is installed").success());
    library
}

/// A service whose disk fails on demand.
struct Failing {
    server: Server,
    session: String,
    control: PathBuf,
    database: PathBuf,
    acknowledged: BTreeMap<u64, v1::Solution>,
    _folder: tempfile::TempDir,
}

impl Failing {
    async fn start() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let (database, control) = (folder.path().join("disk.db"), folder.path().join("fault"));
        let library = library(folder.path());
        let server = Server::start_with(&database, free_port(), |command| {
            command.env("LD_PRELOAD", &library).env("GRAPHFIX_FAULT", &control);
            command.env("GRAPHFIX_FAULT_FILES", &database);
        });
        let session = opened(&server.channel(), None).await.session;
        let acknowledged = BTreeMap::new();
        Self { server, session, control, database, acknowledged, _folder: folder }
    }

    fn set(&self, fault: &str) {
        std::fs::write(&self.control, fault).unwrap();
    }

    /// Pushes an epoch, and records it if it is acknowledged.
    async fn push(&mut self, seq: u64) -> Result<(), String> {
        let channel: Channel = self.server.channel();
        let epochs = vec![serde_json::from_value(epoch(seq)).unwrap()];
        let push = v1::PushEpochsRequest { session: self.session.clone(), epochs };
        let answer = PositioningClient::new(channel).push_epochs(push).await;
        let answer = answer.map_err(|status| code_of(&status).unwrap_or(status.to_string()))?;
        let solution = answer.into_inner().results.remove(0).solution.unwrap();
        if let Some(before) = self.acknowledged.insert(seq, solution.clone()) {
            assert_eq!(before, solution, "a resend got another answer");
        }
        Ok(())
    }

    /// During the fault an epoch is refused in time and the service is not ready; afterwards both
    /// end without a restart.
    async fn fails_and_recovers(&mut self, fault: &str, seq: u64) {
        self.push(seq).await.unwrap();
        self.set(fault);
        let began = Instant::now();
        assert_eq!(self.push(seq + 1).await, Err("DATABASE_FAILED".to_owned()), "{fault}");
        assert!(began.elapsed() < REFUSED_WITHIN, "{fault}: refused after {:?}", began.elapsed());
        let port = self.server.port;
        let ready = async || status_of(port, "/readyz");
        until("not ready", ready, |status| *status == 503).await;
        self.set("none");
        let ended = Instant::now();
        // The refused epoch may have been stored: it is resent.
        while let Err(code) = self.push(seq + 1).await {
            assert_eq!(code, "DATABASE_FAILED");
            assert!(ended.elapsed() < SERVED_WITHIN, "{fault}: not served again");
        }
        until("ready", ready, |status| *status == 200).await;
    }

    /// Everything acknowledged is stored once, and a replay gives the same bits.
    async fn finish(self) {
        let list = v1::ListSolutionsRequest {
            session: self.session.clone(),
            page_size: 10_000,
            ..Default::default()
        };
        let mut client = SolutionsClient::new(self.server.channel());
        let listed = client.list(list).await.unwrap().into_inner().solutions;
        let count = listed.len();
        let stored: BTreeMap<_, _> = listed.into_iter().map(|s| (s.seq, s)).collect();
        assert_eq!(stored, self.acknowledged);
        assert_eq!(stored.len(), count, "doubled");
        let (is_same, text, errors) = replayed(&self.database, &self.session, &[]);
        assert!(is_same, "{text}{errors}");
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_disk_that_fails_is_refused_and_served_again() {
    let mut service = Failing::start().await;
    for (index, fault) in ["full", "broken", "unsynced", "full"].into_iter().enumerate() {
        service.fails_and_recovers(fault, 10 * index as u64 + 1).await;
    }
    service.finish().await;
}

/// A commit that takes longer than its deadline is refused. It still ends, and the epoch is then
/// answered from the store.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_slow_disk_is_refused_and_served_again() {
    let mut service = Failing::start().await;
    service.fails_and_recovers("slow 7", 1).await;
    service.finish().await;
}
