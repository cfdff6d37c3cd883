//! A `graphfix serve` whose disk, clock and descriptors fail on demand.
//!
//! `failing.c` is preloaded, so that system calls of the service fail as a file states.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

use graphfix::contract::convert::epoch_message;
use graphfix::contract::v1;
use graphfix::grpc::code_of;
use graphfix::grpc::v1::navigation_client::NavigationClient;
use graphfix::grpc::v1::positioning_client::PositioningClient;
use graphfix::grpc::v1::sessions_client::SessionsClient;
use graphfix::grpc::v1::solutions_client::SolutionsClient;
use tonic::Streaming;
use tonic::transport::Channel;

use super::doors::epoch;
use super::drive::DRIVE;
use super::server::{Server, free_port, opened, replayed, status_of};
use super::wait::until;

/// After a deadline of 5 s.
const REFUSED_WITHIN: Duration = Duration::from_secs(7);
const SERVED_WITHIN: Duration = Duration::from_secs(5);

/// Compiles `failing.c`.
pub(crate) fn library(folder: &Path) -> PathBuf {
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/support/failing.c");
    let library = folder.join("failing.so");
    let mut command = Command::new("cc");
    command.args(["-shared", "-fPIC", "-O1", "-Wall", "-Werror", "-o"]).arg(&library).arg(source);
    assert!(command.arg("-ldl").status().expect("cc is installed").success());
    library
}

/// A service with one session that fails on demand.
pub(crate) struct Failing {
    pub(crate) server: Server,
    channel: Channel,
    session: String,
    control: PathBuf,
    database: String,
    acknowledged: BTreeMap<u64, v1::Solution>,
    /// Whether the epochs are those of the simulated drive.
    drives: bool,
    _folder: tempfile::TempDir,
}

impl Failing {
    /// A service on the database of this URL. If the database is a file, its disk can fail.
    pub(crate) async fn start(database: &str) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let (library, control) = (library(folder.path()), folder.path().join("fault"));
        std::fs::write(&control, "none").unwrap();
        let server = Server::start_with(database, free_port(), |command| {
            command.env("LD_PRELOAD", &library).env("GRAPHFIX_FAULT", &control);
            command.env("GRAPHFIX_FAULT_FILES", database.trim_start_matches("sqlite://"));
        });
        let channel = server.channel();
        let session = opened(&channel, None).await.session;
        let (database, acknowledged) = (database.to_owned(), BTreeMap::new());
        let drives = false;
        Self { server, channel, session, control, database, acknowledged, drives, _folder: folder }
    }

    /// Like [`Self::start`], with the epochs and the navigation data of the simulated drive.
    pub(crate) async fn start_drive(database: &str) -> Self {
        let service = Self::start(database).await;
        let file = DRIVE.navigation_file();
        let mut navigation = NavigationClient::new(service.channel.clone());
        navigation.push(v1::PushNavigationRequest { content: file.into() }).await.unwrap();
        let mut sessions = SessionsClient::new(service.channel.clone());
        let mode = Some("ekf".to_owned());
        let session = service.session.clone();
        let update = v1::UpdateSessionRequest { session, mode, ..Default::default() };
        sessions.update(update).await.unwrap();
        Self { drives: true, ..service }
    }

    /// Sets the fault, in the words of `failing.c`.
    pub(crate) fn set(&self, fault: &str) {
        std::fs::write(&self.control, fault).unwrap();
    }

    /// Pushes an epoch, and records an acknowledged answer.
    pub(crate) async fn push(&mut self, seq: u64) -> Result<(), String> {
        let epochs = vec![match self.drives {
            true => epoch_message(seq, &DRIVE.epochs[seq as usize - 1].epoch),
            false => serde_json::from_value(epoch(seq)).unwrap(),
        }];
        let push = v1::PushEpochsRequest { session: self.session.clone(), epochs };
        let answer = PositioningClient::new(self.channel.clone()).push_epochs(push).await;
        let answer = answer.map_err(|status| code_of(&status).unwrap_or(status.to_string()))?;
        let result = answer.into_inner().results.remove(0);
        if let Some(refusal) = result.refusal {
            return Err(refusal.code);
        }
        let solution = result.solution.unwrap();
        if let Some(before) = self.acknowledged.insert(seq, solution.clone()) {
            assert_eq!(before, solution, "a resend got another answer");
        }
        Ok(())
    }

    /// Begins a new arc of the session.
    pub(crate) async fn reset(&self) -> Result<v1::Session, String> {
        let mut sessions = SessionsClient::new(self.channel.clone());
        let reset = v1::ResetSessionRequest { session: self.session.clone() };
        let answer = sessions.reset(reset).await.map(tonic::Response::into_inner);
        answer.map_err(|status| code_of(&status).unwrap_or(status.to_string()))
    }

    /// Closes the session.
    pub(crate) async fn close(&self) -> Result<v1::Session, String> {
        let mut sessions = SessionsClient::new(self.channel.clone());
        let close = v1::CloseSessionRequest { session: self.session.clone() };
        let answer = sessions.close(close).await.map(tonic::Response::into_inner);
        answer.map_err(|status| code_of(&status).unwrap_or(status.to_string()))
    }

    /// A watch of the session's solutions.
    pub(crate) async fn watch(&self) -> Streaming<v1::WatchSolutionsResponse> {
        let mut solutions = SolutionsClient::new(self.channel.clone());
        let session = self.session.clone();
        let watch = v1::WatchSolutionsRequest { session, ..Default::default() };
        solutions.watch(watch).await.unwrap().into_inner()
    }

    /// An epoch is refused in time.
    pub(crate) async fn refuses(&mut self, fault: &str, seq: u64) {
        let began = Instant::now();
        assert_eq!(self.push(seq).await, Err("DATABASE_FAILED".to_owned()), "{fault}");
        let took = began.elapsed();
        assert!(took < REFUSED_WITHIN, "{fault}: refused after {took:?}");
        eprintln!("{fault}: refused after {took:.1?}");
    }

    /// The epoch that was refused, which may have been stored, is acknowledged in time.
    pub(crate) async fn serves_again(&mut self, fault: &str, seq: u64) {
        let ended = Instant::now();
        while let Err(code) = self.push(seq).await {
            assert_eq!(code, "DATABASE_FAILED");
            assert!(ended.elapsed() < SERVED_WITHIN, "{fault}: not served again");
        }
        eprintln!("{fault}: served {:.1?} after its end", ended.elapsed());
        self.is_ready(200).await;
    }

    /// Waits until `/readyz` answers with this status.
    pub(crate) async fn is_ready(&self, expected: u16) {
        let port = self.server.port;
        let ready = async || status_of(port, "/readyz");
        until("as ready as expected", ready, |status| *status == expected).await;
    }

    /// Checks that an epoch is refused in time during the fault and that the service is not ready.
    /// After the fault the service serves the epoch and is ready again, without a restart.
    pub(crate) async fn fails_and_recovers(&mut self, fault: &str, seq: u64) {
        self.push(seq).await.unwrap();
        self.set(fault);
        self.refuses(fault, seq + 1).await;
        self.is_ready(503).await;
        self.set("none");
        self.serves_again(fault, seq + 1).await;
    }

    /// Everything acknowledged is stored once, and a replay gives the same bits.
    pub(crate) async fn finish(self) {
        let list = v1::ListSolutionsRequest {
            session: self.session.clone(),
            page_size: 10_000,
            ..Default::default()
        };
        let mut client = SolutionsClient::new(self.channel);
        let listed = client.list(list).await.unwrap().into_inner().solutions;
        let count = listed.len();
        let stored: BTreeMap<_, _> = listed.into_iter().map(|s| (s.seq, s)).collect();
        assert_eq!(stored, self.acknowledged);
        assert_eq!(stored.len(), count, "doubled");
        let (is_same, text, errors) = replayed(&self.database, &self.session, &[]);
        assert!(is_same, "{text}{errors}");
    }
}
