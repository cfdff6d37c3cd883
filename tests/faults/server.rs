//! A Postgres server that freezes, restarts, or loses the connection during a commit.

use std::time::{Duration, Instant};

use axum::body::Body;
use axum::http::{Request, StatusCode};
use graphfix::aiding::bases::{BaseId, NewBase};
use graphfix::aiding::{AidingDesk, AidingLimits};
use graphfix::clock::Clock;
use graphfix::session::{SessionId, SessionLimits, SessionUpdate, Sessions};
use graphfix::store::{CommitterState, Store};
use serde_json::json;
use tokio::time::timeout;

use crate::support::database::{on_postgres, whole_session};
use crate::support::doors::Doors;
use crate::support::proxy::{Mode, Proxy};
#[cfg(target_os = "linux")]
use crate::support::server::{Server, free_port, get_with};
use crate::support::sessions::{created, desk, epoch};
use crate::support::wait::until;

/// After a deadline of 5 s.
const REFUSED_WITHIN: Duration = Duration::from_secs(7);
/// Short compared with the deadline, with room for a busy machine.
const REFUSED_AT_ONCE_WITHIN: Duration = Duration::from_secs(2);
const SERVED_WITHIN: Duration = Duration::from_secs(5);
/// After deadlines of up to 30 s: that of the drop, and those of the other removals, which go on.
const DROPPED_WITHIN: Duration = Duration::from_secs(200);

/// A session with one epoch on a server behind a proxy.
struct Service {
    proxy: Proxy,
    store: Store,
    sessions: Sessions,
    id: SessionId,
}

impl Service {
    async fn start(url: &str) -> Self {
        let proxy = Proxy::before(url).await;
        let store = Store::open(&proxy.url(url)).await.unwrap();
        let sessions = desk(&store).await;
        let id = created(&sessions).await;
        sessions.submit(&id, vec![epoch(1, 1.0)]).await.unwrap();
        Self { proxy, store, sessions, id }
    }

    /// Checks that an epoch is refused with the code of a failed database. Returns the delay of the
    /// refusal.
    async fn refused(&self, seq: u64) -> Duration {
        let began = Instant::now();
        let refused = self.sessions.submit(&self.id, vec![epoch(seq, seq as f64)]).await;
        let error = refused.unwrap_err();
        assert_eq!(error.code().name(), "DATABASE_FAILED", "{error}");
        began.elapsed()
    }

    /// Submits until acknowledged. Returns whether the epoch was stored before.
    async fn acknowledged(&self, seq: u64) -> bool {
        let epoch = || vec![epoch(seq, seq as f64)];
        let submit = async || self.sessions.submit(&self.id, epoch()).await;
        let answer = until("acknowledged", submit, Result::is_ok).await.unwrap();
        answer.outcomes[0].result.as_ref().unwrap().resent
    }

    async fn numbers(&self) -> Vec<u64> {
        let page = self.sessions.solutions(&self.id, &whole_session()).await.unwrap().page;
        page.items.iter().map(|solution| solution.seq).collect()
    }
}

#[tokio::test]
async fn a_frozen_server_is_refused_and_served_again() {
    on_postgres(async |database| {
        let service = Service::start(&database.url).await;
        let parked = created(&service.sessions).await;
        service.proxy.set(Mode::Frozen);
        let first = service.refused(2).await;
        assert!(first < REFUSED_WITHIN, "refused after {first:?}");
        for _ in 0..10 {
            let next = service.refused(2).await;
            assert!(next < REFUSED_AT_ONCE_WITHIN, "refused after {next:?}");
            let began = Instant::now();
            let refused = service.sessions.submit(&parked, vec![epoch(1, 1.0)]).await;
            assert_eq!(refused.unwrap_err().code().name(), "DATABASE_FAILED");
            assert!(began.elapsed() < REFUSED_AT_ONCE_WITHIN, "{:?}", began.elapsed());
        }
        let health = service.store.committer_health();
        assert!(matches!(health.state, CommitterState::Failed { .. }), "{health:?}");
        service.proxy.set(Mode::Pass);
        let thawed = Instant::now();
        service.acknowledged(2).await;
        assert!(thawed.elapsed() < SERVED_WITHIN, "served after {:?}", thawed.elapsed());
        eprintln!("frozen: served {:.1?} after its end", thawed.elapsed());
        service.acknowledged(3).await;
        assert_eq!(service.numbers().await, [1, 2, 3]);
        assert_eq!(service.sessions.counts().restores(), 0, "the state in memory was dropped");
    })
    .await;
}

#[tokio::test]
async fn a_server_that_restarts_is_waited_for() {
    on_postgres(async |database| {
        let service = Service::start(&database.url).await;
        service.proxy.set(Mode::Refuse);
        let took = service.refused(2).await;
        assert!(took < REFUSED_WITHIN, "refused after {took:?}");
        service.proxy.set(Mode::Pass);
        let restarted = Instant::now();
        service.acknowledged(2).await;
        assert!(restarted.elapsed() < SERVED_WITHIN, "served after {:?}", restarted.elapsed());
        eprintln!("restarted: served {:.1?} after its end", restarted.elapsed());
        assert_eq!(service.numbers().await, [1, 2]);
        assert_eq!(service.sessions.counts().restores(), 0, "the state in memory was dropped");
    })
    .await;
}

/// The commit is not confirmed. The store shows which of the two states is valid, and the session
/// continues from this state without a restore.
#[tokio::test]
async fn a_commit_that_is_cut_off_is_resolved() {
    on_postgres(async |database| {
        let service = Service::start(&database.url).await;
        let cuts = [Mode::CutBeforeCommit, Mode::CutAfterCommit];
        for (seq, mode) in (2..).zip(cuts.into_iter().cycle().take(8)) {
            service.proxy.set(mode);
            service.refused(seq).await;
            assert_eq!(service.proxy.mode(), Mode::Pass, "nothing was cut");
            let was_stored = service.acknowledged(seq).await;
            assert_eq!(was_stored, mode == Mode::CutAfterCommit, "epoch {seq}");
        }
        assert_eq!(service.numbers().await, (1..=9).collect::<Vec<_>>());
        assert_eq!(service.sessions.counts().restores(), 0, "the state in memory was dropped");
    })
    .await;
}

/// The answer to the commit of new settings is lost, and the update is repeated: it changes nothing
/// any more, and the next epochs are positioned with these settings.
#[tokio::test]
async fn settings_whose_commit_is_cut_off_are_in_force() {
    on_postgres(async |database| {
        let service = Service::start(&database.url).await;
        let update = || SessionUpdate { mode: Some("fgo".to_owned()), ..SessionUpdate::default() };
        service.proxy.set(Mode::CutAfterCommit);
        let cut = service.sessions.update(&service.id, update()).await.unwrap_err();
        assert_eq!(cut.code().name(), "DATABASE_FAILED", "{cut}");
        assert_eq!(service.proxy.mode(), Mode::Pass, "nothing was cut");
        let info = service.sessions.update(&service.id, update()).await.unwrap();
        let answer = service.sessions.submit(&service.id, vec![epoch(2, 2.0)]).await.unwrap();
        let solution = &answer.outcomes[0].result.as_ref().unwrap().solution;
        assert_eq!(*solution.configuration_hash, *info.configuration_hash);
    })
    .await;
}

/// The settings are committed after the update has failed, and after epochs have been positioned
/// with the previous ones. They are in force soon, without another update.
#[tokio::test]
async fn settings_whose_commit_is_late_are_in_force() {
    on_postgres(async |database| {
        let service = Service::start(&database.url).await;
        let update = SessionUpdate { mode: Some("fgo".to_owned()), ..SessionUpdate::default() };
        service.proxy.set(Mode::CommitLate);
        let cut = service.sessions.update(&service.id, update).await.unwrap_err();
        assert_eq!(cut.code().name(), "DATABASE_FAILED", "{cut}");
        assert!(!service.acknowledged(2).await);
        let get = async || service.sessions.get(&service.id).await.unwrap();
        assert_ne!(get().await.mode, "fgo", "the commit came too early for this test");
        let committed = until("committed", get, |info| info.mode == "fgo").await;
        let mut seq = 2;
        let push = async || {
            seq += 1;
            let answer = service.sessions.submit(&service.id, vec![epoch(seq, seq as f64)]).await;
            let result = answer.unwrap().outcomes.remove(0).result;
            result.unwrap().solution.configuration_hash
        };
        let is_new = |hash: &std::sync::Arc<str>| *hash == committed.configuration_hash;
        until("the settings are in force", push, is_new).await;
    })
    .await;
}

/// The connection is cut while a base is stored. A stored base is in memory, and other bases can be
/// created afterwards.
#[tokio::test]
async fn a_base_whose_commit_is_cut_off_is_known() {
    on_postgres(async |database| {
        let proxy = Proxy::before(&database.url).await;
        let store = Store::open(&proxy.url(&database.url)).await.unwrap();
        let aiding = AidingDesk::open(store, AidingLimits::service()).await.unwrap();
        for (mode, count) in [(Mode::CutAfterCommit, 1), (Mode::CutBeforeCommit, 1)] {
            proxy.set(mode);
            let created = aiding.bases.create(NewBase::default()).await;
            assert_eq!(proxy.mode(), Mode::Pass, "nothing was cut");
            assert_eq!(created.is_ok(), mode == Mode::CutAfterCommit, "{created:?}");
            assert_eq!(aiding.bases.list().await.len(), count, "{mode:?}");
        }
        aiding.bases.create(NewBase::default()).await.unwrap();
        assert_eq!(aiding.bases.list().await.len(), 2);
    })
    .await;
}

/// The connection is cut while a base is deleted. A base that the server has deleted takes no more
/// epochs, which would be removed.
#[tokio::test]
async fn a_base_whose_deletion_is_cut_off_is_known() {
    on_postgres(async |database| {
        let proxy = Proxy::before(&database.url).await;
        let store = Store::open(&proxy.url(&database.url)).await.unwrap();
        let aiding = AidingDesk::open(store, AidingLimits::service()).await.unwrap();
        let created = aiding.bases.create(NewBase::default()).await.unwrap();
        let id = BaseId::parse(&created.name.id).unwrap();
        for (mode, count) in [(Mode::CutBeforeCommit, 1), (Mode::CutAfterCommit, 0)] {
            proxy.set(mode);
            let deleted = aiding.bases.delete(&id).await;
            assert_eq!(proxy.mode(), Mode::Pass, "nothing was cut");
            assert_eq!(deleted.is_ok(), mode == Mode::CutAfterCommit, "{deleted:?}");
            assert_eq!(aiding.bases.list().await.len(), count, "{mode:?}");
        }
        let refused = aiding.bases.push(&id, Vec::new()).await.unwrap_err();
        assert_eq!(refused.code().name(), "BASE_NOT_FOUND", "{refused}");
    })
    .await;
}

/// The server freezes while a day of the log is dropped. The removal ends, its connection closes,
/// and the next removal drops the day.
#[tokio::test]
async fn a_drop_of_a_day_does_not_wait_for_ever() {
    on_postgres(async |database| {
        let proxy = Proxy::before(&database.url).await;
        let store = Store::open(&proxy.url(&database.url)).await.unwrap();
        let clock = Clock::at(1_767_268_800_000); // 2026-01-01 12:00 UTC.
        let aiding = AidingDesk::open(store.clone(), AidingLimits::service()).await.unwrap();
        let limits = SessionLimits { retention_days: 1, ..SessionLimits::service() };
        let sessions = Sessions::open_at(store, aiding, limits, clock.clone());
        let id = created(&sessions).await;
        for day in 0..8 {
            clock.set(clock.unix_ms() + 86_400_000);
            sessions.submit(&id, vec![epoch(day + 1, day as f64)]).await.unwrap();
        }
        let days = "(SELECT 1 FROM pg_inherits WHERE inhparent = 'epochs'::regclass) AS days";
        let before = database.count(days).await;
        proxy.set(Mode::FrozenAtLock);
        let removal = timeout(DROPPED_WITHIN, sessions.remove_expired()).await;
        removal.expect("it waits for ever").unwrap_err();
        assert_eq!(proxy.mode(), Mode::Frozen, "no day was dropped");
        proxy.set(Mode::Pass);
        let remove = async || {
            sessions.remove_expired().await.ok();
            database.count(days).await
        };
        until("dropped", remove, |count| *count < before).await;
    })
    .await;
}

/// While the server is frozen, calls that need no key and calls that do not exist are answered at
/// once, even to a key that is not known: those who watch the service do not take it for dead.
#[tokio::test]
async fn a_service_without_its_database_is_alive() {
    on_postgres(async |database| {
        let proxy = Proxy::before(&database.url).await;
        let doors = Doors::on(&proxy.url(&database.url)).await;
        let (status, key) = doors.post("/v1/keys", json!({"rights": ["admin"]})).await;
        assert_eq!(status, StatusCode::CREATED, "{key}");
        proxy.set(Mode::Frozen);
        for (path, host, expected) in [
            ("/healthz", "localhost", StatusCode::OK),
            ("/docs/errors", "localhost", StatusCode::OK),
            ("/v1/nothing", "localhost", StatusCode::NOT_FOUND),
            ("/v1/sessions", "example.com", StatusCode::FORBIDDEN),
        ] {
            let key = format!("Bearer gfx_{}", "A".repeat(43));
            let request = Request::get(path).header("host", host).header("authorization", key);
            let begun = Instant::now();
            let (status, answer) = doors.ask(request.body(Body::empty()).unwrap()).await;
            assert_eq!(status, expected, "{path}: {answer}");
            assert!(begun.elapsed() < Duration::from_secs(2), "{path}: {:?}", begun.elapsed());
        }
        proxy.set(Mode::Pass);
    })
    .await;
}

/// Standard error on a full disk: the failures of the database cannot be logged, and the service
/// serves again after them. While the server is frozen, the readiness says so soon.
#[cfg(target_os = "linux")]
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_log_that_cannot_be_written_stops_nothing() {
    on_postgres(async |database| {
        let proxy = Proxy::before(&database.url).await;
        let full = std::fs::OpenOptions::new().write(true).open("/dev/full").unwrap();
        let server = Server::start_with(&proxy.url(&database.url), free_port(), |command| {
            command.stderr(full);
        });
        let ready = async |expected: u16| {
            let status = async || get_with(server.port, "/readyz", "").map(|(status, _)| status);
            let is_expected =
                |status: &std::io::Result<u16>| status.as_ref().ok() == Some(&expected);
            until("readiness", status, is_expected).await.unwrap();
        };
        ready(200).await;
        proxy.set(Mode::Refuse);
        ready(503).await;
        proxy.set(Mode::Pass);
        let passes = Instant::now();
        ready(200).await;
        assert!(passes.elapsed() < SERVED_WITHIN, "ready after {:?}", passes.elapsed());
        // Those who ask wait for some seconds.
        proxy.set(Mode::Frozen);
        let frozen = Instant::now();
        let (status, answer) = get_with(server.port, "/readyz", "").unwrap();
        assert_eq!(status, 503, "{answer}");
        assert!(frozen.elapsed() < Duration::from_secs(4), "answered {:?}", frozen.elapsed());
        proxy.set(Mode::Pass);
        ready(200).await;
    })
    .await;
}
