//! Random lives of sessions against a plain model: epochs are pushed, sent again, changed and late;
//! sessions are reset, closed and deleted; the service restarts.

use std::collections::BTreeMap;

use graphfix::aiding::{AidingDesk, AidingLimits};
use graphfix::gnss::{GpsTime, Solution};
use graphfix::session::{HistoryQuery, Recomputation, SequencedEpoch, SessionId, Sessions};
use graphfix::store::{SessionFilter, Store};
use proptest::prelude::*;
use proptest::test_runner::{Config, TestRunner};
use tokio::runtime::Runtime;

use crate::support::database::{Database, on_postgres, whole_session};
use crate::support::sessions::{created, desk, epoch};

/// A step of a life. `session` and `which` select among what there is.
#[derive(Clone, Copy, Debug)]
enum Step {
    Create,
    /// Epochs after the last one, each `gap` numbers and seconds later.
    Push {
        session: usize,
        epochs: u64,
        gap: u64,
    },
    Resend {
        session: usize,
        which: usize,
    },
    Conflict {
        session: usize,
        which: usize,
    },
    /// A number below the last one that was never used.
    Stale {
        session: usize,
    },
    /// A number above the last one at the last one's time.
    Late {
        session: usize,
    },
    Reset {
        session: usize,
    },
    Close {
        session: usize,
    },
    Delete {
        session: usize,
    },
    Restart,
}

fn step() -> impl Strategy<Value = Step> {
    let session = 0..4_usize;
    let which = 0..1_000_usize;
    prop_oneof![
        2 => Just(Step::Create),
        8 => (session.clone(), 1..24_u64, 1..4_u64)
            .prop_map(|(session, epochs, gap)| Step::Push { session, epochs, gap }),
        4 => (session.clone(), which.clone())
            .prop_map(|(session, which)| Step::Resend { session, which }),
        3 => (session.clone(), which)
            .prop_map(|(session, which)| Step::Conflict { session, which }),
        2 => session.clone().prop_map(|session| Step::Stale { session }),
        2 => session.clone().prop_map(|session| Step::Late { session }),
        2 => session.clone().prop_map(|session| Step::Reset { session }),
        1 => session.clone().prop_map(|session| Step::Close { session }),
        1 => session.prop_map(|session| Step::Delete { session }),
        2 => Just(Step::Restart),
    ]
}

/// A session as the model knows it.
#[derive(Debug)]
struct Life {
    id: SessionId,
    /// Second and answer of each stored epoch by its number.
    epochs: BTreeMap<u64, (f64, Solution)>,
    /// The next epoch begins an arc, so it may have any time.
    begins_arc: bool,
    closed: bool,
    deleted: bool,
}

impl Life {
    /// The code with which every push is refused.
    const fn refusal(&self) -> Option<&'static str> {
        match (self.deleted, self.closed) {
            (true, _) => Some("SESSION_NOT_FOUND"),
            (false, true) => Some("SESSION_CLOSED"),
            (false, false) => None,
        }
    }

    fn last(&self) -> Option<(u64, f64)> {
        self.epochs.last_key_value().map(|(seq, (second, _))| (*seq, *second))
    }

    fn which(&self, which: usize) -> Option<SequencedEpoch> {
        let index = which % self.epochs.len().max(1);
        self.epochs.iter().nth(index).map(|(seq, (second, _))| epoch(*seq, *second))
    }

    /// The highest number below the last one that no epoch has.
    fn unused(&self) -> Option<u64> {
        let (last, _) = self.last()?;
        (1..last).rev().find(|seq| !self.epochs.contains_key(seq))
    }
}

struct World {
    store: Store,
    sessions: Sessions,
    lives: Vec<Life>,
}

impl World {
    async fn open(database: &Database) -> Self {
        let store = database.store().await;
        let sessions = desk(&store).await;
        Self { store, sessions, lives: Vec::new() }
    }

    async fn stop(&self) {
        self.sessions.drain().await;
        self.store.close().await;
    }

    async fn take(&mut self, step: Step, database: &Database) {
        match step {
            Step::Create => self.create().await,
            Step::Restart => {
                self.stop().await;
                let lives = std::mem::take(&mut self.lives);
                *self = Self { lives, ..Self::open(database).await };
            }
            Step::Push { session, epochs, gap } => self.push(session, epochs, gap).await,
            Step::Resend { session, which } => self.resend(session, which).await,
            Step::Conflict { session, which } => {
                let Some(life) = self.life(session) else { return };
                let Some(mut changed) = life.which(which) else { return };
                changed.epoch.observations[0].pseudorange_m = Some(2.5e7);
                self.refused(session, changed, "SEQUENCE_CONFLICT").await;
            }
            Step::Stale { session } => {
                let Some(seq) = self.life(session).and_then(Life::unused) else { return };
                self.refused(session, epoch(seq, 0.5), "SEQUENCE_SUPERSEDED").await;
            }
            Step::Late { session } => {
                let Some(life) = self.life(session) else { return };
                let Some((seq, second)) = life.last().filter(|_| !life.begins_arc) else { return };
                self.refused(session, epoch(seq + 1, second), "OUT_OF_ORDER").await;
            }
            Step::Reset { session } => {
                let Some(life) = self.life(session) else { return };
                let reset = self.sessions.reset(&life.id).await;
                assert_eq!(reset.err().map(|error| error.code().name()), life.refusal());
                let life = self.life_mut(session);
                life.begins_arc |= life.refusal().is_none() && !life.epochs.is_empty();
            }
            Step::Close { session } => {
                let Some(life) = self.life(session) else { return };
                let closed = self.sessions.close(&life.id).await;
                assert_eq!(closed.is_err(), life.deleted, "{closed:?}");
                self.life_mut(session).closed = true;
            }
            Step::Delete { session } => {
                let Some(life) = self.life(session) else { return };
                let deleted = self.sessions.delete(&life.id).await;
                assert_eq!(deleted.is_err(), life.deleted, "{deleted:?}");
                let life = self.life_mut(session);
                (life.closed, life.deleted) = (true, true);
            }
        }
    }

    /// The session that a step selects.
    fn life(&self, session: usize) -> Option<&Life> {
        self.lives.get(session % self.lives.len().max(1))
    }

    fn life_mut(&mut self, session: usize) -> &mut Life {
        let count = self.lives.len();
        &mut self.lives[session % count]
    }

    async fn create(&mut self) {
        let id = created(&self.sessions).await;
        assert!(self.lives.iter().all(|life| life.id != id));
        let (epochs, begins_arc) = (BTreeMap::new(), true);
        self.lives.push(Life { id, epochs, begins_arc, closed: false, deleted: false });
    }

    async fn push(&mut self, session: usize, epochs: u64, gap: u64) {
        let Some(life) = self.life(session) else { return };
        let (seq, second) = life.last().unwrap_or((0, 0.0));
        let second = if life.begins_arc { 0.0 } else { second };
        let steps = (1..=epochs).map(|index| index * gap);
        let pushed: Vec<(u64, f64)> =
            steps.map(|step| (seq + step, second + step as f64)).collect();
        let batch = pushed.iter().map(|(seq, second)| epoch(*seq, *second)).collect();
        let submitted = self.sessions.submit(&life.id, batch).await;
        if let Some(code) = life.refusal() {
            assert_eq!(submitted.unwrap_err().code().name(), code);
            return;
        }
        let submitted = submitted.unwrap();
        assert_eq!(submitted.durable_through, pushed.last().map(|(seq, _)| *seq));
        let life = self.life_mut(session);
        for ((seq, second), outcome) in pushed.into_iter().zip(submitted.outcomes) {
            let acknowledged = outcome.result.unwrap();
            assert!(outcome.seq == seq && !acknowledged.resent);
            life.epochs.insert(seq, (second, acknowledged.solution.solution));
        }
        life.begins_arc = false;
    }

    async fn resend(&self, session: usize, which: usize) {
        let Some(life) = self.life(session) else { return };
        let Some(again) = life.which(which) else { return };
        let seq = again.seq;
        let submitted = self.sessions.submit(&life.id, vec![again]).await;
        if let Some(code) = life.refusal() {
            assert_eq!(submitted.unwrap_err().code().name(), code);
            return;
        }
        let acknowledged = submitted.unwrap().outcomes.remove(0).result.unwrap();
        assert!(acknowledged.resent);
        assert_eq!(acknowledged.solution.solution, life.epochs[&seq].1, "the same answer");
    }

    async fn refused(&self, session: usize, epoch: SequencedEpoch, code: &str) {
        let Some(life) = self.life(session) else { return };
        match self.sessions.submit(&life.id, vec![epoch]).await {
            Ok(mut submitted) => {
                assert_eq!(life.refusal(), None);
                let refusal = submitted.outcomes.remove(0).result.unwrap_err();
                assert_eq!(refusal.code().name(), code);
            }
            Err(error) => assert_eq!(Some(error.code().name()), life.refusal()),
        }
    }

    /// Compares what is stored with the model.
    async fn check(&self) {
        let listed =
            self.sessions.list(&SessionFilter::default(), 1_000, None).await.unwrap().items;
        let listed: Vec<&SessionId> = listed.iter().rev().map(|info| &info.id).collect();
        let live: Vec<&Life> = self.lives.iter().filter(|life| !life.deleted).collect();
        assert_eq!(listed, live.iter().map(|life| &life.id).collect::<Vec<_>>());
        for life in live {
            let info = self.sessions.get(&life.id).await.unwrap();
            assert_eq!(info.closed_unix_ms.is_some(), life.closed);
            assert_eq!(info.durable_through, life.last().map(|(seq, _)| seq));
            let page = self.sessions.solutions(&life.id, &whole_session()).await.unwrap().page;
            let stored = page.items.into_iter().map(|stored| (stored.seq, stored.solution));
            let modelled = life.epochs.iter().map(|(seq, (_, answer))| (*seq, answer.clone()));
            assert!(stored.eq(modelled), "{life:?}");
            let aiding = AidingDesk::open(self.store.clone(), AidingLimits::service()).await;
            let store = self.store.clone();
            let again = Recomputation::open(store, aiding.unwrap(), &life.id, None).await.unwrap();
            let check = again.check().await.unwrap();
            assert!(check.is_same() && check.compared == life.epochs.len(), "{check:?}");
            let [from, to] = [2051, 2053].map(|week| Some(GpsTime::from_week_seconds(week, 0.0)));
            let query = HistoryQuery { from, to, points: 1 };
            let history = self.sessions.history(&life.id, &query).await.unwrap();
            assert_eq!(history.statuses.total(), life.epochs.len() as u64);
        }
        for life in self.lives.iter().filter(|life| life.deleted) {
            let missing = self.sessions.get(&life.id).await.unwrap_err();
            assert_eq!(missing.code().name(), "SESSION_NOT_FOUND");
        }
    }
}

/// Takes all steps, and compares with the model before and after a last restart.
async fn live(database: Database, steps: Vec<Step>) {
    let mut world = World::open(&database).await;
    world.create().await;
    for step in steps {
        world.take(step, &database).await;
    }
    world.check().await;
    world.take(Step::Restart, &database).await;
    world.check().await;
    world.stop().await;
}

fn run(cases: u32, case: impl Fn(Vec<Step>, &Runtime)) {
    let runtime = Runtime::new().unwrap();
    // No file of failures: the steps are printed.
    let config = Config { cases, failure_persistence: None, ..Config::default() };
    let steps = prop::collection::vec(step(), 1..40);
    let ran = TestRunner::new(config).run(&steps, |steps| {
        case(steps, &runtime);
        Ok(())
    });
    ran.unwrap();
}

#[test]
fn sessions_live_as_the_model_on_sqlite() {
    run(24, |steps, runtime| runtime.block_on(live(Database::sqlite(), steps)));
}

#[test]
fn sessions_live_as_the_model_on_postgres() {
    run(6, |steps, runtime| runtime.block_on(on_postgres(|database| live(database, steps))));
}
