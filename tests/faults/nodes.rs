//! Several nodes on one Postgres: a session has one node at a time, whatever happens to the nodes,
//! their database and the calls on their way. `scripts/nodes` runs more rounds.

#![cfg(target_os = "linux")]

use std::collections::BTreeMap;
use std::fmt;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use graphfix::contract::v1;
use graphfix::grpc::code_of;
use graphfix::grpc::v1::bases_client::BasesClient;
use graphfix::grpc::v1::navigation_client::NavigationClient;
use graphfix::grpc::v1::positioning_client::PositioningClient;
use graphfix::grpc::v1::sessions_client::SessionsClient;
use graphfix::grpc::v1::solutions_client::SolutionsClient;
use graphfix::store::Store;
use tonic::transport::Channel;

use crate::support::balancer::Balancer;
use crate::support::database::{Database, on_postgres};
use crate::support::drive::DRIVE;
use crate::support::nodes::{
    self, Ack, Answered, Node, Setting, channel, created, drive, node_of, of_session, push_of,
};
use crate::support::pair::PAIR;
use crate::support::server::{get_with, replayed};
use crate::support::streams::Random;
use crate::support::wait::until;

/// A session that moves to another node is acknowledged again within this time.
const MOVED: Duration = Duration::from_secs(15);
/// 99 % of the acknowledgements come within this time outside faults, on a machine that does
/// nothing else. `scripts/nodes` checks this.
const QUIET: Duration = Duration::from_secs(1);
/// The same beside other tests.
const BUSY: Duration = Duration::from_secs(5);

async fn two(database: &Database) -> [Node; 2] {
    nodes::two(&database.url, &Setting::default()).await
}

async fn navigate(channel: &Channel) {
    let push = v1::PushNavigationRequest { content: DRIVE.navigation_file().into() };
    NavigationClient::new(channel.clone()).push(push).await.unwrap();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn a_call_reaches_the_node_of_its_session() {
    on_postgres(async |database| {
        let [first, second] = two(&database).await;
        // The follower forwards the push to the leader, which tells the follower of the new data.
        navigate(&second.channel()).await;
        let status = NavigationClient::new(second.channel());
        let status = status.clone().status(v1::NavigationStatusRequest {}).await.unwrap();
        assert_eq!(node_of(&status), "first");
        let session = created(&second.channel(), "fgo").await;
        for (seq, node) in [(1, &second), (2, &first), (3, &second), (4, &first)] {
            let push = of_session(&session, push_of(&session, seq));
            let answer = PositioningClient::new(node.channel()).push_epochs(push).await.unwrap();
            assert_eq!(node_of(&answer), "second", "epoch {seq}");
            assert!(answer.into_inner().results[0].solution.is_some());
        }
        // A stream, through the wrong node.
        let opening = v1::StreamOpening { session: session.clone(), ..Default::default() };
        let messages = vec![
            v1::StreamRequest { opening: Some(opening), epochs: Vec::new() },
            v1::StreamRequest { opening: None, epochs: push_of(&session, 5).epochs },
        ];
        let request = of_session(&session, futures::stream::iter(messages));
        let answer = PositioningClient::new(first.channel()).stream(request).await.unwrap();
        assert_eq!(node_of(&answer), "second");
        let mut answers = answer.into_inner();
        let mut durable = None;
        while let Some(message) = answers.message().await.unwrap() {
            durable = durable.max(message.durable_through);
        }
        assert_eq!(durable, Some(5));
        // A REST request names the session in its path.
        let path = format!("/v1/sessions/{session}/solutions");
        let (status, body) = get_with(first.port, &path, "").unwrap();
        assert_eq!((status, body.matches("\"seq\"").count()), (200, 5), "{body}");
        // Without the header a gRPC request names no session until its message is read.
        let push = push_of(&session, 6);
        let refused = PositioningClient::new(first.channel()).push_epochs(push).await.unwrap_err();
        assert_eq!(refused.code(), tonic::Code::Unavailable);
        assert_eq!(code_of(&refused).as_deref(), Some("SESSION_ELSEWHERE"));
        assert!(refused.message().contains("second"), "{refused}");
        let close = v1::CloseSessionRequest { session: session.clone() };
        let close = of_session(&session, close);
        let answer = SessionsClient::new(first.channel()).close(close).await.unwrap();
        assert_eq!(node_of(&answer), "second");
        let (is_equal, text, error) = replayed(&database.url, &session, &[]);
        assert!(is_equal, "{text}{error}");
    })
    .await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn bases_are_the_leaders_and_all_nodes_know_them() {
    on_postgres(async |database| {
        let [first, second] = two(&database).await;
        navigate(&first.channel()).await;
        let pair = &*PAIR;
        let [x_m, y_m, z_m]: [f64; 3] = pair.position.0.into();
        let marker = Some(v1::Ecef { x_m, y_m, z_m });
        let create = v1::CreateBaseRequest { marker, ..Default::default() };
        let answer = BasesClient::new(second.channel()).create(create).await.unwrap();
        assert_eq!(node_of(&answer), "first");
        let base = answer.into_inner().base;
        // The follower knows the base at once.
        let request = v1::CreateSessionRequest {
            mode: "rtk-ekf".to_owned(),
            base: base.clone(),
            ..Default::default()
        };
        let answer = SessionsClient::new(second.channel()).create(request).await.unwrap();
        assert_eq!(node_of(&answer), "second");
    })
    .await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn a_cluster_and_a_single_service_exclude_each_other() {
    on_postgres(async |database| {
        let node = |name| Store::open_in_cluster(&database.url, name, "http://127.0.0.1:1");
        let one = node("one").await.unwrap();
        let other = node("other").await.unwrap();
        let refused = Store::open_alone(&database.url, "single").await.unwrap_err();
        assert_eq!(refused.code().name(), "DATABASE_IN_USE");
        assert!(refused.to_string().contains("a node of a cluster"), "{refused}");
        let refused = node("one").await.unwrap_err();
        assert_eq!(refused.code().name(), "DATABASE_IN_USE");
        assert!(refused.to_string().contains("one"), "{refused}");
        one.close().await;
        other.close().await;
        let single = Store::open_alone(&database.url, "single").await.unwrap();
        let refused = node("one").await.unwrap_err();
        assert!(refused.to_string().contains("single"), "{refused}");
        single.close().await;
        let refused = Store::open_in_cluster("sqlite://x.db", "one", "http://127.0.0.1:1").await;
        assert_eq!(refused.unwrap_err().code().name(), "CLUSTER_NEEDS_POSTGRES");
    })
    .await;
}

/// A node is frozen while it has a push. When it runs again, its lease has ended and the other node
/// has the session. So it acknowledges nothing any more, and stops.
#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn a_frozen_node_acknowledges_nothing_after_its_lease() {
    on_postgres(async |database| {
        let [mut first, second] = two(&database).await;
        navigate(&first.channel()).await;
        let session = created(&first.channel(), "fgo").await;
        let push = |channel: Channel, seq| {
            let request = of_session(&session, push_of(&session, seq));
            async move { PositioningClient::new(channel).push_epochs(request).await }
        };
        assert_eq!(node_of(&push(first.channel(), 1).await.unwrap()), "first");
        let (direct, frozen) = (first.channel(), Instant::now());
        push(direct.clone(), 2).await.unwrap();
        first.signal("STOP");
        let mut late = tonic::Request::new(push_of(&session, 3));
        late.metadata_mut().insert("x-graphfix-session", session.parse().unwrap());
        let mut client = PositioningClient::new(direct);
        let late = tokio::spawn(async move { client.push_epochs(late).await });
        // A node that answers no ping counts as unreachable before its lease ends.
        let mut early = tonic::Request::new(push_of(&session, 4));
        early.metadata_mut().insert("x-graphfix-session", session.parse().unwrap());
        let refused =
            PositioningClient::new(second.channel()).push_epochs(early).await.unwrap_err();
        assert_eq!(code_of(&refused).as_deref(), Some("NODE_UNREACHABLE"));
        let moved = async || push(second.channel(), 4).await;
        let answer = until("moved", moved, Result::is_ok).await.unwrap();
        assert_eq!(node_of(&answer), "second");
        assert!(frozen.elapsed() < MOVED, "{:?}", frozen.elapsed());
        first.signal("CONT");
        let late = late.await.unwrap();
        assert!(late.is_err(), "{late:?}");
        until("ended", async || first.has_ended(), |ended| *ended).await;
        let (numbers, _) = stored(&second.channel(), &session).await;
        assert_eq!(numbers, [1, 2, 4]);
        // The second node leads now, so it accepts navigation data.
        navigate(&second.channel()).await;
        first.serve();
        first.is_ready().await;
        let answer = push(first.channel(), 5).await.unwrap();
        assert_eq!(node_of(&answer), "second");
    })
    .await;
}

/// The numbers of a session's stored epochs, and the answers by number.
async fn stored(channel: &Channel, session: &str) -> (Vec<u64>, BTreeMap<u64, v1::Solution>) {
    let (session, page_size) = (session.to_owned(), 10_000);
    let revisions = v1::Revisions::First.into();
    let list = v1::ListSolutionsRequest { session, page_size, revisions, ..Default::default() };
    let answer = SolutionsClient::new(channel.clone()).list(list).await.unwrap().into_inner();
    let numbers = answer.solutions.iter().map(|solution| solution.seq).collect();
    (numbers, answer.solutions.into_iter().map(|solution| (solution.seq, solution)).collect())
}

/// The variable with the seed of a campaign.
const SEED: &str = "GRAPHFIX_NODES_SEED";

#[derive(Clone, Copy, Debug, PartialEq)]
enum Fault {
    Kill,
    Freeze,
    Cut,
}

/// How long acknowledgements took in rounds.
#[derive(Default)]
struct Times {
    /// Outside faults.
    calm: Vec<Duration>,
    /// During a fault, of sessions at nodes without the fault.
    others: Vec<Duration>,
    /// During a fault, the longest of each session that was at the node with the fault.
    moved: Vec<Duration>,
}

impl Times {
    fn take(&mut self, acks: &[Ack], victim: &str, [begun, quiet]: [Instant; 2]) {
        let before = acks.iter().rev().find(|ack| ack.at < begun);
        let is_moved = before.is_none_or(|ack| ack.node == victim);
        let is_calm = |ack: &&Ack| ack.at < begun || quiet < ack.at - ack.took;
        let took = |ack: &Ack| ack.took;
        self.calm.extend(acks.iter().filter(is_calm).map(took));
        let during = acks.iter().filter(|ack| !is_calm(ack)).map(took);
        match is_moved {
            true => self.moved.extend(during.max()),
            false => self.others.extend(during),
        }
    }

    fn add(&mut self, other: Self) {
        self.calm.extend(other.calm);
        self.others.extend(other.others);
        self.moved.extend(other.moved);
    }
}

/// The 99th percentile.
fn p99(times: &[Duration]) -> Duration {
    let mut times = times.to_owned();
    times.sort();
    times.get(times.len() * 99 / 100).copied().unwrap_or_default()
}

impl fmt::Display for Times {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { calm, others, moved } = self;
        let longest = moved.iter().max().copied().unwrap_or_default();
        write!(f, "p99 {:?} of {} outside faults, ", p99(calm), calm.len())?;
        write!(f, "{:?} of {} of others during them, ", p99(others), others.len())?;
        write!(f, "longest of {} moved sessions {longest:?}", moved.len())
    }
}

/// One round. Devices send through a balancer, while one node has a fault and recovers. Everything
/// that was acknowledged is stored once, and a replay gives the same answers.
async fn round(
    database: &Database,
    nodes: &mut [Node],
    port: u16,
    (fault, victim, lasting): (Fault, usize, Duration),
) -> Times {
    let stop = Arc::new(AtomicBool::new(false));
    let devices: Vec<_> = (0..6).map(|_| tokio::spawn(drive(port, stop.clone()))).collect();
    tokio::time::sleep(Duration::from_secs(3)).await;
    let begun = Instant::now();
    match fault {
        Fault::Kill => nodes[victim].kill(),
        Fault::Freeze => nodes[victim].signal("STOP"),
        Fault::Cut => nodes[victim].cut(true),
    }
    tokio::time::sleep(lasting).await;
    match fault {
        Fault::Kill => {}
        Fault::Freeze => nodes[victim].signal("CONT"),
        Fault::Cut => nodes[victim].cut(false),
    }
    let until_quiet = Instant::now() + MOVED;
    while Instant::now() < until_quiet {
        nodes[victim].supervise();
        tokio::time::sleep(Duration::from_millis(200)).await;
    }
    let quiet = Instant::now();
    tokio::time::sleep(Duration::from_secs(3)).await;
    stop.store(true, Ordering::Release);
    for node in nodes.iter() {
        node.is_ready().await;
    }
    let (mut times, name) = (Times::default(), nodes[victim].name.clone());
    for device in devices {
        let answered = device.await.unwrap();
        check(database, &nodes[(victim + 1) % nodes.len()], &answered).await;
        times.take(&answered.acks, &name, [begun, quiet]);
    }
    let starts: Vec<usize> = nodes.iter().map(|node| node.starts).collect();
    eprintln!("{fault:?} of {name} for {lasting:?}: {times}, starts {starts:?}");
    for took in times.moved.iter().chain(&times.others) {
        assert!(*took < MOVED, "{fault:?}: an acknowledgement took {took:?}");
    }
    let limit = if std::env::var_os(SEED).is_some() { QUIET } else { BUSY };
    let p99 = p99(&times.calm);
    assert!(p99 < limit, "{fault:?}: p99 {p99:?} outside the fault");
    times
}

async fn check(database: &Database, node: &Node, answered: &Answered) {
    let session = &answered.session;
    let last = answered.solutions.keys().next_back().copied().unwrap_or(0);
    assert!(5 < last, "the device of {session} got {last} answers");
    let (numbers, stored) = stored(&node.channel(), session).await;
    // The last epoch may be stored without an answer.
    let through = numbers.len() as u64;
    assert!(last <= through && through <= last + 1, "{last} acknowledged, {through} stored");
    assert_eq!(numbers, (1..=through).collect::<Vec<_>>(), "missing or doubled");
    for (seq, solution) in &answered.solutions {
        let is_same = stored.get(seq) == Some(solution);
        assert!(is_same, "epoch {seq} of {session} is not as acknowledged");
    }
    let (is_equal, text, error) = replayed(&database.url, session, &[]);
    assert!(is_equal, "{session}: {text}{error}");
}

/// Each fault once, at the leader and at the follower in turns. `GRAPHFIX_NODES_ROUNDS` sets the
/// number of rounds and `GRAPHFIX_NODES` the number of nodes. With `GRAPHFIX_NODES_SEED` faults and
/// nodes are random, and a frozen node stays frozen for 30 s.
#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn nothing_acknowledged_is_lost_behind_haproxy() {
    on_postgres(async |database| {
        let variable = |name| std::env::var(name).ok().and_then(|text| text.parse::<u64>().ok());
        let names = ["first", "second", "third", "fourth"];
        let count = variable("GRAPHFIX_NODES").unwrap_or(2) as usize;
        let mut nodes = nodes::nodes(&names[..count], &database.url, &Setting::default()).await;
        let ports: Vec<u16> = nodes.iter().map(|node| node.port).collect();
        let Some(balancer) = Balancer::haproxy(&ports) else { return };
        navigate(&channel(nodes[0].port)).await;
        let rounds = variable("GRAPHFIX_NODES_ROUNDS").unwrap_or(3);
        let (seed, mut all) = (variable(SEED), Times::default());
        let mut random = Random::new(1 + seed.unwrap_or(0));
        for index in 0..rounds as usize {
            let faults = [Fault::Kill, Fault::Freeze, Fault::Cut];
            let (fault, victim, extra_ms) = match seed {
                None => (faults[index % 3], index % count, 0),
                Some(_) => (faults[random.below(3)], random.below(count), random.below(8_000)),
            };
            let lasting = match (fault, seed) {
                (Fault::Kill, _) => Duration::from_millis(500 + extra_ms as u64),
                (Fault::Freeze, Some(_)) => Duration::from_secs(30),
                _ => Duration::from_millis(9_000 + extra_ms as u64),
            };
            all.add(round(&database, &mut nodes, balancer.port, (fault, victim, lasting)).await);
            eprintln!("{} rounds: {all}; nothing lost or doubled, replays equal", index + 1);
        }
    })
    .await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn nginx_hashes_the_session_too() {
    on_postgres(async |database| {
        let nodes = two(&database).await;
        let ports = [nodes[0].port, nodes[1].port];
        let Some(balancer) = Balancer::nginx(&ports) else { return };
        navigate(&channel(nodes[0].port)).await;
        let stop = Arc::new(AtomicBool::new(false));
        let devices: Vec<_> =
            (0..6).map(|_| tokio::spawn(drive(balancer.port, stop.clone()))).collect();
        tokio::time::sleep(Duration::from_secs(6)).await;
        stop.store(true, Ordering::Release);
        for device in devices {
            check(&database, &nodes[0], &device.await.unwrap()).await;
        }
    })
    .await;
}
