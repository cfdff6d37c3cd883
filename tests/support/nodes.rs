//! Nodes of a cluster, each in a process of its own, with a connection to the database that can be
//! cut, and devices that send to them.

use std::collections::BTreeMap;
use std::process::Command;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use graphfix::contract::{convert, v1};
use graphfix::grpc::v1::positioning_client::PositioningClient;
use graphfix::grpc::v1::sessions_client::SessionsClient;
use tokio_rustls::TlsConnector;
use tonic::Request;
use tonic::transport::{Channel, Endpoint};
use tonic_health::pb::HealthCheckRequest;
use tonic_health::pb::health_check_response::ServingStatus;
use tonic_health::pb::health_client::HealthClient;

use super::drive::DRIVE;
use super::proxy::{Mode, Proxy};
use super::server::{Server, free_port, get_with, program};
use super::tls;
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
    setting: Setting,
}

/// How a node is started, beside its name and database.
#[derive(Clone, Default)]
pub(crate) struct Setting {
    /// Arguments of its command.
    pub(crate) arguments: Vec<String>,
    /// The TLS of its clients, if its port has TLS.
    pub(crate) client: Option<TlsConnector>,
}

impl Setting {
    pub(crate) fn of(arguments: &[&str]) -> Self {
        let arguments = arguments.iter().map(|argument| (*argument).to_owned()).collect();
        Self { arguments, client: None }
    }
}

/// Nodes of these names on a database, one after another, so that the first leads.
pub(crate) async fn nodes(names: &[&str], url: &str, setting: &Setting) -> Vec<Node> {
    let mut nodes = Vec::new();
    for name in names {
        let node = Node::start(name, url, setting).await;
        node.is_ready().await;
        nodes.push(node);
    }
    nodes
}

/// Two nodes, of which the first leads.
pub(crate) async fn two(url: &str, setting: &Setting) -> [Node; 2] {
    nodes(&["first", "second"], url, setting).await.try_into().ok().unwrap()
}

impl Node {
    /// A node on the database of this URL.
    pub(crate) async fn start(name: &str, url: &str, setting: &Setting) -> Self {
        let proxy = Proxy::before(url).await;
        let url = proxy.url(url);
        let (name, port, setting) = (name.to_owned(), free_port(), setting.clone());
        let mut node = Self { name, port, url, proxy, server: None, starts: 0, setting };
        node.serve();
        node
    }

    /// Starts its process.
    pub(crate) fn serve(&mut self) {
        let Setting { arguments, client } = &self.setting;
        let scheme = if client.is_some() { "https" } else { "http" };
        let address = format!("{scheme}://127.0.0.1:{}", self.port);
        let server = Server::start_with(&self.url, self.port, |command| {
            command.args(["--cluster", &address, "--node", &self.name]).args(arguments);
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
        match &self.setting.client {
            None => channel(self.port),
            Some(client) => tls::channel(self.port, client),
        }
    }

    /// What `/readyz` answers.
    pub(crate) fn readiness(&self) -> serde_json::Value {
        let answer = get_with(self.port, "/readyz", "").map(|(_, body)| body);
        serde_json::from_str(&answer.unwrap_or_default()).unwrap_or_default()
    }

    /// Waits until it is ready.
    pub(crate) async fn is_ready(&self) {
        let ask = async || match &self.setting.client {
            None => self.readiness()["ready"].as_bool(),
            Some(_) => Some(self.answers_health().await),
        };
        until("ready", ask, |ready| *ready == Some(true)).await;
    }

    /// Whether its health on gRPC is good.
    async fn answers_health(&self) -> bool {
        let request = HealthCheckRequest { service: String::new() };
        let checked = HealthClient::new(self.channel()).check(request).await;
        checked.is_ok_and(|answer| answer.into_inner().status() == ServingStatus::Serving)
    }
}

/// A request with a key.
pub(crate) fn bearing<T>(key: &str, mut request: Request<T>) -> Request<T> {
    let value = format!("Bearer {key}").parse().unwrap();
    request.metadata_mut().insert("authorization", value);
    request
}

/// The node that has answered.
pub(crate) fn node_of<T>(answer: &tonic::Response<T>) -> String {
    answer.metadata().get("x-graphfix-node").unwrap().to_str().unwrap().to_owned()
}

/// The secret of a new key, which the command line makes.
pub(crate) fn key_of(url: &str, arguments: &[&str]) -> String {
    let mut command = Command::new(program());
    let output = command.args(["keys", "create", "--database", url]).args(arguments).output();
    let text = String::from_utf8(output.unwrap().stdout).unwrap();
    let secret = text.split_whitespace().find(|word| word.starts_with("gfx_"));
    secret.unwrap_or_else(|| panic!("{text}")).to_owned()
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

/// The answers that a device got.
#[derive(Debug, Default)]
pub(crate) struct Answered {
    pub(crate) session: String,
    pub(crate) solutions: BTreeMap<u64, v1::Solution>,
    /// The first answer to each epoch.
    pub(crate) acks: Vec<Ack>,
}

/// The first answer to an epoch.
#[derive(Debug)]
pub(crate) struct Ack {
    pub(crate) at: Instant,
    /// Since the epoch was first sent.
    pub(crate) took: Duration,
    /// Name of the node that has answered.
    pub(crate) node: String,
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
                let node = node_of(&answer);
                let result = answer.into_inner().results.remove(0);
                let solution = result.solution.unwrap_or_else(|| panic!("{:?}", result.refusal));
                answered.acks.push(Ack { at: Instant::now(), took: sent.elapsed(), node });
                answered.solutions.insert(seq, solution);
                break;
            }
            tokio::time::sleep(PAUSE).await;
        }
        tokio::time::sleep(PAUSE).await;
    }
    answered
}
