//! Nodes of a cluster, each in a process of its own, with a connection to the database that can be
//! cut, and devices that send to them.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use graphfix::contract::{convert, v1};
use graphfix::grpc::v1::positioning_client::PositioningClient;
use graphfix::grpc::v1::sessions_client::SessionsClient;
use tonic::Request;
use tonic::transport::{Channel, Endpoint};

use super::drive::DRIVE;
use super::proxy::{Mode, Proxy};
use super::server::{Server, free_port, get_with};
use super::wait::until;

/// Longest time that a device waits for an answer.
const ANSWER: Duration = Duration::from_secs(2);
const PAUSE: Duration = Duration::from_millis(100);

/// A node, which is started again when it has ended.
pub(crate) struct Node {
    pub(crate) name: String,
    pub(crate) port: u16,
    url: String,
    proxy: Proxy,
    server: Option<Server>,
    /// Number of starts.
    pub(crate) starts: usize,
}

impl Node {
    /// A node on the database of this URL.
    pub(crate) async fn start(name: &str, url: &str) -> Self {
        let proxy = Proxy::before(url).await;
        let url = proxy.url(url);
        let port = free_port();
        let mut node = Self { name: name.to_owned(), port, url, proxy, server: None, starts: 0 };
        node.serve();
        node
    }

    /// Starts its process.
    pub(crate) fn serve(&mut self) {
        let address = format!("http://127.0.0.1:{}", self.port);
        let server = Server::start_with(&self.url, self.port, |command| {
            command.args(["--cluster", &address, "--node", &self.name]);
            command.env("GRAPHFIX_LOG", "error");
        });
        self.server = Some(server);
        self.starts += 1;
    }

    /// Starts its process again if that has ended.
    pub(crate) fn supervise(&mut self) {
        if self.server.as_mut().is_none_or(|server| server.ended().is_some()) {
            self.serve();
        }
    }

    /// Whether its process has ended by itself.
    pub(crate) fn has_ended(&mut self) -> bool {
        self.server.as_mut().is_some_and(|server| server.ended().is_some())
    }

    /// SIGKILL.
    pub(crate) fn kill(&mut self) {
        if let Some(server) = self.server.take() {
            server.kill();
        }
    }

    pub(crate) fn signal(&self, name: &str) {
        self.server.as_ref().unwrap().signal(name);
    }

    /// Cuts its connections to the database, or restores them.
    pub(crate) fn cut(&self, is_cut: bool) {
        self.proxy.set(if is_cut { Mode::Frozen } else { Mode::Pass });
    }

    pub(crate) fn channel(&self) -> Channel {
        channel(self.port)
    }

    /// What `/readyz` answers.
    pub(crate) fn readiness(&self) -> serde_json::Value {
        let answer = get_with(self.port, "/readyz", "").map(|(_, body)| body);
        serde_json::from_str(&answer.unwrap_or_default()).unwrap_or_default()
    }

    /// Waits until it is ready.
    pub(crate) async fn is_ready(&self) {
        let ask = async || self.readiness()["ready"].as_bool();
        until("ready", ask, |ready| *ready == Some(true)).await;
    }
}

pub(crate) fn channel(port: u16) -> Channel {
    let address = format!("http://127.0.0.1:{port}");
    Endpoint::from_shared(address).unwrap().connect_timeout(ANSWER).connect_lazy()
}

/// A request with the header of its session, as every client sends it.
pub(crate) fn of_session<T>(session: &str, message: T) -> Request<T> {
    let mut request = Request::new(message);
    request.metadata_mut().insert("x-graphfix-session", session.parse().unwrap());
    request.set_timeout(ANSWER);
    request
}

pub(crate) async fn created(channel: &Channel, mode: &str) -> String {
    let begun = Instant::now();
    loop {
        let request = v1::CreateSessionRequest { mode: mode.to_owned(), ..Default::default() };
        match SessionsClient::new(channel.clone()).create(request).await {
            Ok(answer) => return answer.into_inner().session,
            Err(status) => assert!(begun.elapsed() < Duration::from_secs(60), "{status}"),
        }
        tokio::time::sleep(PAUSE).await;
    }
}

/// A push of one epoch of the drive; the epoch's index is `seq` − 1.
pub(crate) fn push_of(session: &str, seq: u64) -> v1::PushEpochsRequest {
    let epoch = &DRIVE.epochs[seq as usize - 1].epoch;
    let epochs = vec![convert::epoch_message(seq, epoch)];
    v1::PushEpochsRequest { session: session.to_owned(), epochs }
}

/// What a device was answered.
#[derive(Debug, Default)]
pub(crate) struct Answered {
    pub(crate) session: String,
    pub(crate) solutions: BTreeMap<u64, v1::Solution>,
    /// When each epoch was answered first, and how long it took since it was first sent.
    pub(crate) acks: Vec<(Instant, Duration)>,
}

/// A device sends epoch after epoch until it is stopped or the drive ends, each until it is
/// acknowledged.
pub(crate) async fn drive(port: u16, stop: Arc<AtomicBool>) -> Answered {
    let channel = channel(port);
    let session = created(&channel, "fgo").await;
    let mut client = PositioningClient::new(channel);
    let mut answered = Answered { session: session.clone(), ..Default::default() };
    for seq in 1..=DRIVE.epochs.len() as u64 {
        let sent = Instant::now();
        loop {
            if stop.load(Ordering::Acquire) {
                return answered;
            }
            let push = of_session(&session, push_of(&session, seq));
            if let Ok(Ok(answer)) = tokio::time::timeout(ANSWER, client.push_epochs(push)).await {
                let result = answer.into_inner().results.remove(0);
                let solution = result.solution.unwrap_or_else(|| panic!("{:?}", result.refusal));
                answered.acks.push((Instant::now(), sent.elapsed()));
                answered.solutions.insert(seq, solution);
                break;
            }
            tokio::time::sleep(PAUSE).await;
        }
        tokio::time::sleep(PAUSE).await;
    }
    answered
}
