//! `kill -9` in the middle of a stream: nothing acknowledged is missing, nothing appears twice.

use std::collections::BTreeMap;
use std::net::TcpListener;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use graphfix::contract::v1;
use graphfix::grpc::v1::positioning_client::PositioningClient;
use graphfix::grpc::v1::sessions_client::SessionsClient;
use graphfix::grpc::v1::solutions_client::SolutionsClient;
use tonic::transport::{Channel, Endpoint};

use crate::doors::epoch;

const EPOCHS: u64 = 600;
const BATCH: usize = 20;

/// A `graphfix serve` of its own, killed when dropped.
pub(crate) struct Server {
    child: Child,
    pub(crate) port: u16,
}

impl Server {
    pub(crate) fn start(database: &Path, port: u16) -> Self {
        let child = Command::new(env!("CARGO_BIN_EXE_graphfix"))
            .args(["serve", "--log", "warn", "--listen", &format!("127.0.0.1:{port}")])
            .arg("--database")
            .arg(format!("sqlite://{}", database.display()))
            .stdin(Stdio::null())
            .spawn()
            .unwrap();
        Self { child, port }
    }

    /// SIGKILL, which no process can answer.
    pub(crate) fn kill(mut self) {
        self.child.kill().unwrap();
        self.child.wait().unwrap();
    }

    pub(crate) fn channel(&self) -> Channel {
        let address = format!("http://127.0.0.1:{}", self.port);
        Endpoint::from_shared(address).unwrap().connect_lazy()
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        // Err: it was killed before.
        self.child.kill().ok();
        self.child.wait().ok();
    }
}

pub(crate) fn free_port() -> u16 {
    TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port()
}

/// Asks until the service answers.
pub(crate) async fn opened(channel: &Channel, session: Option<&str>) -> v1::Session {
    let mut client = SessionsClient::new(channel.clone());
    let start = Instant::now();
    loop {
        let answer = match session {
            None => client.create(v1::CreateSessionRequest::default()).await,
            Some(id) => client.get(v1::GetSessionRequest { session: id.to_owned() }).await,
        };
        match answer {
            Ok(answer) => return answer.into_inner(),
            Err(status) => {
                assert!(start.elapsed() < Duration::from_secs(30), "{status}");
                tokio::time::sleep(Duration::from_millis(20)).await;
            }
        }
    }
}

/// Pushes from `next` on until the service dies or all is sent; what is acknowledged is kept.
async fn push_on(
    channel: &Channel,
    session: &str,
    next: u64,
    acknowledged: &mut BTreeMap<u64, v1::Solution>,
) {
    let mut client = PositioningClient::new(channel.clone());
    let all: Vec<u64> = (next..=EPOCHS).collect();
    for numbers in all.chunks(BATCH) {
        let epochs = numbers.iter().map(|n| serde_json::from_value(epoch(*n)).unwrap()).collect();
        let push = v1::PushEpochsRequest { session: session.to_owned(), epochs };
        let Ok(answer) = client.push_epochs(push).await else { return };
        for result in answer.into_inner().results {
            let solution = result.solution.unwrap_or_else(|| panic!("{:?}", result.refusal));
            if let Some(before) = acknowledged.insert(solution.seq, solution.clone()) {
                assert_eq!(before, solution, "a resend got another answer");
            }
        }
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_was_acknowledged_outlives_kill_9() {
    let folder = tempfile::tempdir().unwrap();
    let (database, port) = (folder.path().join("crash.db"), free_port());
    let mut server = Server::start(&database, port);
    let session = opened(&server.channel(), None).await.session;
    let mut acknowledged = BTreeMap::new();
    // Instants after the first push, spread over commit, answer and reading.
    for after_ms in [3, 11, 24, 47] {
        let channel = server.channel();
        let resumed = opened(&channel, Some(&session)).await.durable_through;
        let last = acknowledged.keys().next_back().copied();
        assert!(last <= resumed, "acknowledged {last:?}, durable {resumed:?}");
        // Some epochs are sent again that may have been stored without an answer.
        let next = last.map_or(1, |last| last + 1);
        let pushing = push_on(&channel, &session, next, &mut acknowledged);
        let kill = async {
            tokio::time::sleep(Duration::from_millis(after_ms)).await;
            server.kill();
        };
        tokio::join!(pushing, kill);
        server = Server::start(&database, port);
    }
    let channel = server.channel();
    opened(&channel, Some(&session)).await;
    let next = acknowledged.keys().next_back().map_or(1, |last| last + 1);
    push_on(&channel, &session, next, &mut acknowledged).await;

    let list = v1::ListSolutionsRequest { session, page_size: 10_000, ..Default::default() };
    let listed = SolutionsClient::new(channel).list(list).await.unwrap().into_inner().solutions;
    let numbers: Vec<u64> = listed.iter().map(|solution| solution.seq).collect();
    assert_eq!(numbers, (1..=EPOCHS).collect::<Vec<_>>(), "missing or doubled");
    let stored: BTreeMap<_, _> = listed.into_iter().map(|s| (s.seq, s)).collect();
    for (seq, solution) in &acknowledged {
        assert_eq!(Some(solution), stored.get(seq), "epoch {seq} is not as acknowledged");
    }
}
