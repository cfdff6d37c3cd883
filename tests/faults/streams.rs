//! Streams that break: the service is killed, or a commit fails. Nothing acknowledged is missing,
//! nothing appears twice, and no epoch is skipped.

use std::collections::BTreeMap;
use std::time::Duration;

use graphfix::app;
use graphfix::config::ServiceConfiguration;
use graphfix::contract::v1;
use graphfix::grpc::v1::solutions_client::SolutionsClient;
use tonic::Status;
use tonic::transport::Channel;

use crate::support::casters::{BRISK, PATIENCE};
use crate::support::database::{Database, on_both_databases, on_postgres};
use crate::support::doors::epoch;
use crate::support::flow;
use crate::support::proxy::{Mode, Proxy};
use crate::support::server::{Server, free_port, opened};
use crate::support::wait::{interrupted, until};

on_both_databases!(a_stream_goes_on_after_kill_9);

const EPOCHS: u64 = 600;
/// Delays of the kills after the first answer of a stream (ms).
const KILLS_MS: [u64; 4] = [4, 15, 30, 60];

fn message(seq: u64) -> v1::Epoch {
    serde_json::from_value(epoch(seq)).unwrap()
}

fn opening(session: &str, last_acknowledged: Option<u64>) -> v1::StreamOpening {
    let answers = v1::Answers::Full.into();
    v1::StreamOpening { session: session.to_owned(), last_acknowledged, answers }
}

/// Streams one epoch a message, until the service is killed or all epochs are acknowledged. As many
/// epochs are unanswered as the credit allows. Records the answers.
async fn stream_on(
    channel: &Channel,
    session: &str,
    acknowledged: &mut BTreeMap<u64, v1::Solution>,
) -> Option<()> {
    let last = Some(acknowledged.keys().next_back().copied().unwrap_or(0));
    let mut flow = flow::try_epochs(channel.clone(), opening(session, last)).await.ok()?;
    let first = flow.next().await.ok()??;
    let mut next = first.opened?.durable_through.unwrap_or(0) + 1;
    let (begun, mut credit, mut durable) = (next, first.credit?.epochs, first.durable_through);
    loop {
        while next <= EPOCHS && next - begun < credit {
            flow.push(vec![message(next)]).await;
            next += 1;
        }
        if durable == Some(EPOCHS) && acknowledged.len() as u64 == EPOCHS {
            return Some(());
        }
        let answer = flow.next().await.ok()??;
        (credit, durable) = (answer.credit?.epochs, answer.durable_through);
        for result in answer.results {
            let solution = result.solution.unwrap_or_else(|| panic!("{:?}", result.refusal));
            let before = acknowledged.insert(solution.seq, solution);
            assert_eq!(before, None, "an answer came twice");
        }
    }
}

async fn a_stream_goes_on_after_kill_9(database: Database) {
    let port = free_port();
    let mut server = Server::start(&database.url, port);
    let session = opened(&server.channel(), None).await.session;
    let (mut acknowledged, mut killed_within) = (BTreeMap::new(), 0);
    for delay in KILLS_MS {
        let channel = server.channel();
        opened(&channel, Some(&session)).await;
        let streaming = stream_on(&channel, &session, &mut acknowledged);
        let all = interrupted(streaming, Duration::from_millis(delay), || server.kill()).await;
        killed_within += usize::from(all.is_none());
        server = Server::start(&database.url, port);
    }
    eprintln!("{killed_within} of 4 kills fell into a stream");
    assert!(0 < killed_within, "every stream was done before the kill");
    let channel = server.channel();
    opened(&channel, Some(&session)).await;
    stream_on(&channel, &session, &mut acknowledged).await.unwrap();
    let listed = listed(&channel, &session).await;
    assert_eq!(listed, acknowledged.into_values().collect::<Vec<_>>(), "lost or doubled");
}

async fn listed(channel: &Channel, session: &str) -> Vec<v1::Solution> {
    let session = session.to_owned();
    let list = v1::ListSolutionsRequest { session, page_size: 10_000, ..Default::default() };
    SolutionsClient::new(channel.clone()).list(list).await.unwrap().into_inner().solutions
}

/// A commit fails, and the device has already sent later epochs. These are not stored without the
/// epochs of the failed commit: the store would have a gap, and the device would not fill it.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn no_epoch_is_stored_behind_a_commit_that_failed() {
    on_postgres(async |database| {
        let proxy = Proxy::before(&database.url).await;
        let configuration = ServiceConfiguration {
            database: proxy.url(&database.url),
            ..ServiceConfiguration::standard()
        };
        let app = app::open(&configuration, PATIENCE, BRISK).await.unwrap();
        let router = graphfix::http::router(app.service());
        let create = v1::CreateSessionRequest::default();
        let session = graphfix::contract::calls::sessions::create(
            &app.service().without_key().unwrap(),
            create,
        )
        .await;
        let session = session.unwrap().0.session;
        let mut seq = 0;
        for mode in [Mode::CutBeforeCommit, Mode::CutAfterCommit].into_iter().cycle().take(4) {
            // Epochs are refused until the committer is connected again.
            let resume = async || {
                let mut flow = flow::epochs(router.clone(), opening(&session, None)).await;
                let opened = flow.next().await?.unwrap().opened.unwrap();
                let durable = opened.durable_through.unwrap_or(0);
                assert!(durable <= seq);
                flow.push(vec![message(durable + 1)]).await;
                while flow.next().await?.unwrap().durable_through <= Some(durable) {}
                Ok::<_, Status>((flow, durable + 1))
            };
            let (mut flow, first) = until("resumed", resume, Result::is_ok).await.unwrap();
            seq = first;
            proxy.set(mode);
            for next in seq + 1..=seq + 30 {
                flow.push(vec![message(next)]).await;
                tokio::task::yield_now().await;
            }
            let status = flow.refusal().await;
            assert_eq!(graphfix::grpc::code_of(&status).as_deref(), Some("DATABASE_FAILED"));
            seq += 30;
        }
        let list = v1::ListSolutionsRequest { session, page_size: 10_000, ..Default::default() };
        let list = async || {
            graphfix::contract::calls::solutions::list(
                &app.service().without_key().unwrap(),
                list.clone(),
            )
            .await
        };
        let listed = until("listed", list, Result::is_ok).await.unwrap().solutions;
        let numbers: Vec<u64> = listed.iter().map(|solution| solution.seq).collect();
        assert_eq!(numbers, (1..=numbers.len() as u64).collect::<Vec<_>>(), "a hole");
        assert!(4 <= numbers.len());
        drop(router);
        app.close().await;
    })
    .await;
}
