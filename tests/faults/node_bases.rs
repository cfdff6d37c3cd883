//! RTK in a cluster: the leader fills the bases, and sessions at every node use them.

#![cfg(target_os = "linux")]

use std::sync::atomic::Ordering;
use std::time::Duration;

use graphfix::aiding::bases::BaseId;
use graphfix::aiding::{AidingDesk, AidingLimits};
use graphfix::cluster::Cluster;
use graphfix::contract::{convert, v1};
use graphfix::formats::antex;
use graphfix::formats::rinex::write_navigation;
use graphfix::gnss::Navigation;
use graphfix::grpc::v1::bases_client::BasesClient;
use graphfix::grpc::v1::navigation_client::NavigationClient;
use graphfix::grpc::v1::positioning_client::PositioningClient;
use graphfix::grpc::v1::sessions_client::SessionsClient;
use graphfix::store::Store;
use serde_json::Value;
use tokio::io::AsyncWriteExt;
use tonic::transport::Channel;

use crate::support::antex::antex as antex_file;
use crate::support::casters::{HostileCaster, keep};
use crate::support::database::{Database, on_postgres};
use crate::support::device::{NEAR, fixed, logs, relative};
use crate::support::nodes::{Node, Setting, node_of, of_session, two};
use crate::support::pair::PAIR;
use crate::support::server::{get_with, replayed};
use crate::support::wait::until;

/// Time between epochs of the base and the rover. They come ten times as fast as real ones.
const PACE: Duration = Duration::from_millis(100);

async fn navigate(channel: &Channel, navigation: &Navigation) {
    let mut file = Vec::new();
    write_navigation(&mut file, navigation).unwrap();
    let push = v1::PushNavigationRequest { content: file.into() };
    NavigationClient::new(channel.clone()).push(push).await.unwrap();
}

/// A base at the position of the pair's, and the node that has created it.
async fn base_at(node: &Node) -> (String, String) {
    let [x_m, y_m, z_m]: [f64; 3] = PAIR.position.0.into();
    let marker = Some(v1::Ecef { x_m, y_m, z_m });
    let create = v1::CreateBaseRequest { marker, ..Default::default() };
    let answer = BasesClient::new(node.channel()).create(create).await.unwrap();
    let by = node_of(&answer);
    (answer.into_inner().base, by)
}

/// A session relative to a base, at a node.
async fn session_at(node: &Node, mode: &str, profile: &str, base: &str) -> String {
    let new = v1::CreateSessionRequest {
        mode: mode.to_owned(),
        profile: profile.to_owned(),
        base: base.to_owned(),
        ..Default::default()
    };
    let answer = SessionsClient::new(node.channel()).create(new).await.unwrap();
    assert_eq!(node_of(&answer), node.name);
    answer.into_inner().session
}

/// Pushes an epoch of the pair to a base through a node, until the push is accepted.
async fn push_base(node: &Node, base: &str, index: usize) {
    let epochs = vec![convert::epoch_message(0, &PAIR.base[index])];
    let push = v1::PushBaseEpochsRequest { base: base.to_owned(), epochs };
    let push = async || BasesClient::new(node.channel()).push_epochs(push.clone()).await;
    let answer = until("pushed to the base", push, Result::is_ok).await.unwrap().into_inner();
    assert!(answer.results[0].refusal.is_none(), "{answer:?}");
}

/// Pushes an epoch of the pair's rover through a node, until it is answered. Returns the answer and
/// the node that gave it.
async fn push_rover(node: &Node, session: &str, index: usize) -> (v1::Solution, String) {
    let rover = &PAIR.rover[index];
    let epochs = vec![convert::epoch_message(rover.seq, &rover.epoch)];
    let push = async || {
        let push = v1::PushEpochsRequest { session: session.to_owned(), epochs: epochs.clone() };
        PositioningClient::new(node.channel()).push_epochs(of_session(session, push)).await
    };
    let answer = until("answered", push, Result::is_ok).await.unwrap();
    let node = node_of(&answer);
    (answer.into_inner().results.remove(0).solution.unwrap(), node)
}

fn is_replayed(database: &Database, session: &str) {
    let (is_equal, text, error) = replayed(&database.url, session, &[]);
    assert!(is_equal, "{session}: {text}{error}");
}

/// The age of a solution's base epoch (s), if the solution is relative to a base.
fn base_age_s(solution: &v1::Solution) -> Option<f64> {
    solution.relative.as_ref().map(|relative| relative.age_s)
}

/// A base whose epochs are pushed through either node, and sessions at the node that does not lead.
/// Each of the nodes is killed in turn.
#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn sessions_elsewhere_are_fixed_and_move() {
    on_postgres(async |database| {
        let [mut first, mut second] = two(&database.url, &Setting::default()).await;
        navigate(&second.channel(), &PAIR.navigation).await;
        let (base, by) = base_at(&second).await;
        assert_eq!(by, "first");
        let mut sessions = Vec::new();
        for mode in ["rtk-ekf", "rtk-fgo"] {
            sessions.push(session_at(&second, mode, "general", &base).await);
        }
        let mut all: Vec<Vec<v1::Solution>> = vec![Vec::new(); sessions.len()];
        let mut advance = async |through: [&Node; 2], owner: &str, index: usize| {
            push_base(through[index % 2], &base, index).await;
            for (session, solutions) in sessions.iter().zip(&mut all) {
                let (solution, node) = push_rover(through[index % 2], session, index).await;
                assert_eq!(node, owner, "epoch {index}");
                solutions.push(solution);
            }
            tokio::time::sleep(PACE).await;
        };
        // The node that gets the first push of a session claims the session.
        for index in 0..60 {
            advance([&second, &first], "second", index).await;
        }
        first.kill();
        // The second node leads once the lease of the first has ended, and then accepts base
        // epochs.
        for index in 60..90 {
            advance([&second, &second], "second", index).await;
        }
        first.serve();
        first.is_ready().await;
        second.kill();
        for index in 90..130 {
            advance([&first, &first], "first", index).await;
        }
        for (session, solutions) in sessions.iter().zip(&all) {
            let spans = [0..60, 60..90, 90..130].map(|span| fixed(&solutions[span]));
            let ages = solutions.iter().filter_map(base_age_s);
            let oldest_s = ages.fold(0.0, f64::max);
            eprintln!("{spans:?} fixed of 60, 30 and 40; oldest base epoch {oldest_s} s");
            // A minute is enough for the first fix, and a session that is restored keeps its fix.
            assert!(20 < spans[0] && spans[1] == 30 && spans[2] == 40, "{spans:?}");
            is_replayed(&database, session);
        }
    })
    .await;
}

/// A file of a base is uploaded through the node that does not lead. Sessions at both nodes have
/// all epochs of the file.
#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn a_file_of_a_base_is_known_everywhere() {
    on_postgres(async |database| {
        let [first, second] = two(&database.url, &Setting::default()).await;
        navigate(&first.channel(), &PAIR.navigation).await;
        let mut base = BasesClient::new(second.channel());
        let id = base.create(v1::CreateBaseRequest::default()).await.unwrap().into_inner().base;
        let session = session_at(&second, "rtk-ekf", "general", &id).await;
        let content = PAIR.base_file(Some(PAIR.position)).into();
        let upload = v1::UploadBaseRequest { base: id.clone(), content };
        let answer = base.upload(upload).await.unwrap();
        assert_eq!(node_of(&answer), "first");
        assert_eq!(answer.into_inner().new_epochs, PAIR.base.len() as u64);
        let other = session_at(&second, "rtk-ekf", "general", &id).await;
        let at_owner = session_at(&first, "rtk-ekf", "general", &id).await;
        let mut positions = Vec::new();
        for (session, node) in [(&session, &second), (&other, &second), (&at_owner, &first)] {
            let mut solutions = Vec::new();
            for index in 0..40 {
                solutions.push(push_rover(node, session, index).await.0);
            }
            assert!(20 < fixed(&solutions), "{}", fixed(&solutions));
            let ages_s: Vec<f64> = solutions.iter().filter_map(base_age_s).collect();
            assert!(ages_s.iter().all(|age_s| *age_s == 0.0), "{ages_s:?}");
            positions.push(solutions.last().unwrap().position.clone());
            is_replayed(&database, session);
        }
        assert!(positions.iter().all(|position| *position == positions[0]), "{positions:?}");
    })
    .await;
}

/// Bytes that the feed of a base has received at the present leader, and the state of the feed.
fn feed(node: &Node, base: &str) -> (u64, String) {
    let answer = get_with(node.port, &format!("/v1/bases/{base}"), "").map(|(_, body)| body);
    let base: Value = serde_json::from_str(&answer.unwrap_or_default()).unwrap_or_default();
    let feed = &base["feed"];
    (feed["bytes"].as_u64().unwrap_or(0), feed["state"].as_str().unwrap_or_default().to_owned())
}

/// Pushes the bytes of a receiver through a node.
async fn push_raw(node: &Node, session: &str, from: usize, bytes: &[u8]) -> Vec<v1::Solution> {
    let mut solutions = Vec::new();
    for (index, content) in bytes.chunks(20_000).enumerate() {
        let push = v1::PushRawRequest {
            session: session.to_owned(),
            offset: (from + index * 20_000) as u64,
            content: content.to_vec().into(),
            end: false,
            near: None,
        };
        let ask = async || {
            let mut request = of_session(session, push.clone());
            request.set_timeout(Duration::from_secs(60));
            PositioningClient::new(node.channel()).push_raw(request).await
        };
        let answer = until("answered", ask, Result::is_ok).await.unwrap();
        assert_eq!(node_of(&answer), "second");
        let results = answer.into_inner().results;
        solutions.extend(results.into_iter().map(|result| result.solution.unwrap()));
    }
    solutions
}

/// A caster fills the base at the leader. When the leader is killed, the other node connects to the
/// caster, and its session continues.
#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn a_caster_is_asked_by_the_next_leader() {
    let Some((rover, base_log)) = logs() else { return };
    on_postgres(async |database| {
        let halves = base_log.split_at(base_log.len() / 2);
        let (first_half, second_half) = (halves.0.to_vec(), halves.1.to_vec());
        let lengths = [first_half.len() as u64, second_half.len() as u64];
        let caster = HostileCaster::start(move |number, mut stream, _| {
            let log = if number == 0 { first_half.clone() } else { second_half.clone() };
            async move {
                stream.write_all(b"ICY 200 OK\r\n").await.ok();
                // Err: the node was killed.
                for piece in log.chunks(4_000) {
                    if stream.write_all(piece).await.is_err() {
                        return;
                    }
                }
                keep(stream).await;
            }
        })
        .await;
        let hosts = ["--fetch-host", "127.0.0.1", "--fetch-private"];
        let [mut first, second] = two(&database.url, &Setting::of(&hosts)).await;
        let ntrip = v1::NtripSource {
            caster: format!("ntrip://127.0.0.1:{}", caster.port),
            mountpoint: "BASE".to_owned(),
            near: Some(NEAR.into()),
            ..Default::default()
        };
        let create = v1::CreateBaseRequest { ntrip: Some(ntrip), ..Default::default() };
        let answer = BasesClient::new(second.channel()).create(create).await.unwrap();
        assert_eq!(node_of(&answer), "first");
        let base = answer.into_inner().base;
        let has = |length: u64| move |(bytes, _): &(u64, String)| length <= *bytes;
        until("filled", async || feed(&second, &base), has(lengths[0])).await;
        assert_eq!(caster.connections.load(Ordering::SeqCst), 1, "only the leader asks");

        // A session gets the epochs that the base has when the session is created, and later ones.
        let session = session_at(&second, "rtk-fgo", "static", &base).await;
        let (begin, half) = (rover.len() / 20, rover.len() / 2);
        let mut before = push_raw(&second, &session, 0, &rover[..begin]).await;
        before.extend(push_raw(&first, &session, begin, &rover[begin..half]).await);
        first.kill();
        until("filled again", async || feed(&second, &base), has(lengths[1])).await;
        assert_eq!(caster.connections.load(Ordering::SeqCst), 2);
        let after = push_raw(&second, &session, half, &rover[half..]).await;
        let counts = [&before, &after].map(|part| (fixed(part), relative(part), part.len()));
        eprintln!("fixed, relative and all before and after: {counts:?}");
        assert!(counts.iter().all(|(fixed, _, all)| all / 2 < *fixed), "{counts:?}");
        is_replayed(&database, &session);
    })
    .await;
}

/// A node that does not lead changes no base, also if it has another calibration of the antenna.
#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn only_the_leader_writes_to_bases() {
    on_postgres(async |database| {
        let open = async |name: &str| {
            let store = Store::open_in_cluster(&database.url, name, "http://127.0.0.1:1").await;
            store.unwrap()
        };
        let (leading, following) = (open("leading").await, open("following").await);
        let aiding = AidingDesk::open(leading.clone(), AidingLimits::service()).await.unwrap();
        let _cluster = Cluster::open(&leading, &aiding).await.unwrap().unwrap();
        let mut new = PAIR.new_base(0.0);
        new.site.as_mut().unwrap().antenna = format!("{:<16}NONE", "BASE1");
        let id = BaseId::parse(&aiding.bases.create(new).await.unwrap().name.id).unwrap();
        aiding.bases.push(&id, vec![PAIR.base[0].clone()]).await.unwrap();
        let file = antex_file(&[("BASE1", "     -5.00      0.00     60.00")]);
        let catalogue = antex::read(file.as_bytes()).unwrap();
        let limits = AidingLimits::service();
        let other = AidingDesk::open_with(following.clone(), limits, catalogue).await.unwrap();
        let site = other.bases.site(&id).unwrap().unwrap();
        let error = other.bases.set_site(&id, &site).await.unwrap_err();
        assert_eq!(error.code().name(), "WRITTEN_ELSEWHERE");
        let error = other.bases.push(&id, vec![PAIR.base[1].clone()]).await.unwrap_err();
        assert_eq!(error.code().name(), "WRITTEN_ELSEWHERE");
        assert_eq!(
            (database.count("base_sites").await, database.count("base_epochs").await),
            (1, 1)
        );
        for store in [leading, following] {
            store.close().await;
        }
    })
    .await;
}

/// A base moves with each epoch. A node that follows sees no epoch before the position of the base
/// at this epoch, or a later position.
#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn no_epoch_is_seen_without_its_position() {
    on_postgres(async |database| {
        let opened = async |name: &str| {
            let store = Store::open_in_cluster(&database.url, name, "http://127.0.0.1:1").await;
            let store = store.unwrap();
            let aiding = AidingDesk::open(store.clone(), AidingLimits::service()).await.unwrap();
            let cluster = Cluster::open(&store, &aiding).await.unwrap().unwrap();
            (store, aiding, cluster)
        };
        let leading = opened("leading").await;
        let following = opened("following").await;
        let origin = PAIR.new_base(0.0).site.unwrap();
        for _ in 0..4 {
            let base = leading.1.bases.create(PAIR.new_base(0.0)).await.unwrap();
            let id = BaseId::parse(&base.name.id).unwrap();
            let moving = async {
                for (index, epoch) in PAIR.base.iter().enumerate() {
                    let mut site = origin.clone();
                    site.marker.0.x += index as f64;
                    leading.1.bases.set_site(&id, &site).await.unwrap();
                    leading.1.bases.push(&id, vec![epoch.clone()]).await.unwrap();
                }
            };
            let watching = async {
                let mut epochs = 0;
                while epochs < PAIR.base.len() {
                    if let Ok(seen) = following.1.bases.get(&id).await {
                        epochs = seen.epochs;
                        let moved_m = seen.site.unwrap().marker.0.x - origin.marker.0.x;
                        assert!(epochs as f64 <= moved_m + 1.5, "epoch {epochs}: {moved_m} m");
                    }
                    tokio::time::sleep(Duration::from_millis(1)).await;
                }
            };
            tokio::join!(moving, watching);
        }
        for (store, _, _) in [leading, following] {
            store.close().await;
        }
    })
    .await;
}
