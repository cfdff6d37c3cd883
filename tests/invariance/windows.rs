//! Sessions whose estimator has a window, on both databases: restarts, revisions, replay.

use std::collections::BTreeMap;

use graphfix::aiding::bases::BaseChoice;
use graphfix::aiding::{AidingDesk, AidingLimits};
use graphfix::config::Mode;
use graphfix::gnss::Status;
use graphfix::session::{
    Check, NewSession, Recomputation, SequencedEpoch, SessionId, SessionLimits, SessionUpdate,
    Sessions, SolveRequest,
};
use graphfix::store::{Revisions, SolutionQuery, Store, StoredSolution};

use crate::support::database::{Database, on_both_databases};
use crate::support::drive::DRIVE;

on_both_databases!(
    every_mode_gives_the_same_bits_after_restarts,
    each_epoch_is_revised_once,
    another_configuration_begins_anew,
    a_window_is_solved_on_request,
    a_state_that_cannot_be_read_is_rebuilt,
    a_stop_stores_the_state,
    forgotten_navigation_data_is_said,
);

fn limits() -> SessionLimits {
    SessionLimits { active_sessions: 1, ..SessionLimits::service() }
}

async fn broker(store: &Store) -> AidingDesk {
    AidingDesk::open(store.clone(), AidingLimits::service()).await.unwrap()
}

/// A desk as a service opens it at its start.
async fn desk(database: &Database) -> Sessions {
    let store = database.store().await;
    Sessions::open(store.clone(), broker(&store).await, limits())
}

async fn created(sessions: &Sessions, mode: &str) -> SessionId {
    let new = NewSession {
        label: mode.to_owned(),
        mode: mode.to_owned(),
        profile: "urban-vehicle".to_owned(),
        overrides: BTreeMap::new(),
        base: BaseChoice::None,
        antenna: String::new(),
        retention_days: None,
    };
    sessions.create(new).await.unwrap().id
}

async fn listed(sessions: &Sessions, id: &SessionId, which: Revisions) -> Vec<StoredSolution> {
    let query = SolutionQuery {
        from: None,
        to: None,
        status: None,
        revisions: which,
        page_size: 10_000,
        page_token: None,
    };
    sessions.solutions(id, &query).await.unwrap().page.items
}

async fn checked(database: &Database, id: &SessionId) -> Check {
    let store = database.store().await;
    let aiding = broker(&store).await;
    Recomputation::open(store, aiding, id, None).await.unwrap().check().await.unwrap()
}

async fn submit(sessions: &Sessions, id: &SessionId, epochs: &[SequencedEpoch]) {
    let answer = sessions.submit(id, epochs.to_vec()).await.unwrap();
    assert!(answer.outcomes.iter().all(|outcome| outcome.result.is_ok()));
}

/// Three sessions give the same solutions and revisions: one in large batches, one that is parked
/// after each small batch, and one whose service is killed after each. New navigation data arrive
/// in the middle.
async fn every_mode_gives_the_same_bits_after_restarts(database: Database) {
    let store = database.store().await;
    let aiding = broker(&store).await;
    let sessions = Sessions::open(store, aiding.clone(), limits());
    let (before, after) = DRIVE.epochs.split_at(290);
    for mode in Mode::ALL.iter().filter(|mode| !mode.is_relative()) {
        let mut ids = Vec::new();
        for _ in 0..3 {
            ids.push(created(&sessions, mode.name()).await);
        }
        let [whole, parked, restarted] = &ids[..] else { unreachable!() };
        for part in [before, after] {
            match part.len() == before.len() {
                true => {
                    aiding.navigation.push(DRIVE.navigation_without_galileo(), "a").await.unwrap()
                }
                false => aiding.navigation.push(DRIVE.navigation.clone(), "b").await.unwrap(),
            };
            for batch in part.chunks(100) {
                submit(&sessions, whole, batch).await;
            }
            for batch in part.chunks(23) {
                submit(&sessions, parked, batch).await;
                submit(&sessions, whole, &batch[..1]).await;
                submit(&desk(&database).await, restarted, batch).await;
            }
        }
        for id in &ids {
            desk(&database).await.close(id).await.unwrap();
        }
        let expected = listed(&sessions, whole, Revisions::All).await;
        assert!(DRIVE.epochs.len() <= expected.len());
        let positions = expected.iter().filter(|s| s.solution.status != Status::None).count();
        assert!(expected.len() * 9 < positions * 10, "{mode:?}: {positions} positions");
        for id in [parked, restarted] {
            let other = listed(&sessions, id, Revisions::All).await;
            assert_eq!(other.len(), expected.len(), "{mode:?}");
            for (a, b) in other.iter().zip(&expected) {
                assert_eq!(format!("{a:?}"), format!("{b:?}"), "{mode:?}");
            }
        }
        for id in &ids {
            let same = Check { compared: expected.len(), ..Check::default() };
            assert_eq!(checked(&database, id).await, same, "{mode:?}");
        }
    }
}

/// An epoch is revised when it leaves the window, or when the session is closed. It is revised
/// once, also if it is resent.
async fn each_epoch_is_revised_once(database: Database) {
    let sessions = desk(&database).await;
    let store = database.store().await;
    broker(&store).await.navigation.push(DRIVE.navigation.clone(), "all").await.unwrap();
    let sessions_of = desk(&database).await;
    let id = created(&sessions, "fgo").await;
    let epochs = &DRIVE.epochs[..60];
    submit(&sessions_of, &id, epochs).await;
    let open = listed(&sessions, &id, Revisions::All).await;
    let revised: Vec<u64> = open.iter().filter(|s| s.revision == 1).map(|s| s.seq).collect();
    assert_eq!(revised, (1..=revised.len() as u64).collect::<Vec<_>>());
    assert!((20..60).contains(&revised.len()), "{} revised", revised.len());
    submit(&sessions_of, &id, epochs).await; // A resend.
    assert_eq!(listed(&sessions, &id, Revisions::All).await, open);
    for _ in 0..2 {
        let info = desk(&database).await.close(&id).await.unwrap();
        assert!(info.closed_unix_ms.is_some());
    }
    let all = listed(&sessions, &id, Revisions::All).await;
    let keys: Vec<_> = all.iter().map(|s| (s.seq, s.revision)).collect();
    let expected: Vec<_> = (1..=60).flat_map(|seq| [(seq, 0), (seq, 1)]).collect();
    assert_eq!(keys, expected);
    for (which, revision) in [(Revisions::First, 0), (Revisions::Last, 1)] {
        let list = listed(&sessions, &id, which).await;
        assert_eq!(list.len(), 60);
        assert!(list.iter().all(|solution| solution.revision == revision));
    }
    let moved = |pair: &[StoredSolution]| pair[0].solution.estimate != pair[1].solution.estimate;
    assert!(30 < all.chunks(2).filter(|pair| moved(pair)).count(), "smoothing moves positions");

    // A changed stored solution is detected.
    let swap = "UPDATE epochs SET solution = (SELECT solution FROM epochs WHERE seq = 59) \
                WHERE seq = 60";
    database.execute(swap).await;
    let check = checked(&database, &id).await;
    assert_eq!((check.compared, check.different, check.first), (120, 1, Some((60, 0))));
    database.execute("DELETE FROM revisions WHERE seq = 9").await;
    assert_eq!(checked(&database, &id).await.not_stored, 1);
}

/// The first epoch under another configuration begins a new window, and the epochs of the old
/// window are revised. Restarts in between change nothing.
async fn another_configuration_begins_anew(database: Database) {
    let store = database.store().await;
    broker(&store).await.navigation.push(DRIVE.navigation.clone(), "all").await.unwrap();
    let sessions = desk(&database).await;
    let (steady, restarted) = (created(&sessions, "fgo").await, created(&sessions, "fgo").await);
    let changes = [("fgo", "urban-vehicle"), ("spp", "general"), ("fgo", "general")];
    for (part, (mode, profile)) in DRIVE.epochs[..90].chunks(30).zip(changes) {
        for id in [&steady, &restarted] {
            let update = SessionUpdate {
                mode: Some(mode.to_owned()),
                profile: Some(profile.to_owned()),
                ..SessionUpdate::default()
            };
            sessions.update(id, update).await.unwrap();
            let (first, second) = part.split_at(17);
            submit(&sessions, id, first).await;
            let other = if *id == restarted { desk(&database).await } else { sessions.clone() };
            submit(&other, id, second).await;
        }
    }
    for id in [&steady, &restarted] {
        desk(&database).await.close(id).await.unwrap();
    }
    let expected = listed(&sessions, &steady, Revisions::All).await;
    assert_eq!(listed(&sessions, &restarted, Revisions::All).await, expected);
    let revised: Vec<_> = expected.iter().filter(|s| s.revision == 1).map(|s| s.seq).collect();
    assert_eq!(revised, (1..=30).chain(61..=90).collect::<Vec<_>>());
    let hash = |seq: u64, revision: u32| {
        let found = expected.iter().find(|s| (s.seq, s.revision) == (seq, revision));
        found.unwrap().configuration_hash.clone()
    };
    assert_eq!(hash(30, 1), hash(30, 0), "revised by the configuration that solved it");
    assert_ne!(hash(30, 0), hash(61, 0));
    for id in [&steady, &restarted] {
        assert!(checked(&database, id).await.is_same());
    }
}

async fn a_window_is_solved_on_request(database: Database) {
    let store = database.store().await;
    broker(&store).await.navigation.push(DRIVE.navigation.clone(), "all").await.unwrap();
    let sessions = desk(&database).await;
    let (points, window) = (created(&sessions, "spp").await, created(&sessions, "fgo").await);
    for id in [&points, &window] {
        submit(&sessions, id, &DRIVE.epochs[..60]).await;
    }
    let own = sessions.solve(&window, &SolveRequest::default()).await.unwrap();
    let last = listed(&sessions, &window, Revisions::First).await.pop().unwrap();
    assert_eq!((own.seq, &own.solution), (60, &last.solution));
    // A window over the same epochs of the other session. It begins without a prior from earlier
    // epochs, so the positions are only nearly the same.
    let mode = Some("fgo".to_owned());
    let profile = Some("urban-vehicle".to_owned());
    let request = SolveRequest { mode, profile, ..SolveRequest::default() };
    let other = sessions.solve(&points, &request).await.unwrap();
    assert_eq!((other.seq, other.solution.status), (60, Status::Fgo));
    let place = |solution: &graphfix::gnss::Solution| solution.estimate.as_ref().unwrap().position;
    let apart_m = place(&other.solution).distance_m(place(&last.solution));
    assert!(0.0 < apart_m && apart_m < 3.0, "{apart_m}");
    for id in [&points, &window] {
        assert_eq!(listed(&sessions, id, Revisions::First).await.len(), 60, "nothing is stored");
    }
}

async fn a_state_that_cannot_be_read_is_rebuilt(database: Database) {
    let store = database.store().await;
    broker(&store).await.navigation.push(DRIVE.navigation.clone(), "all").await.unwrap();
    let sessions = desk(&database).await;
    let id = created(&sessions, "fgo").await;
    submit(&sessions, &id, &DRIVE.epochs[..300]).await;
    assert!(store.snapshot(sessions_key(&store, &id).await).await.unwrap().is_some());
    database.execute("UPDATE snapshots SET content = '\\x'").await;
    submit(&desk(&database).await, &id, &DRIVE.epochs[300..310]).await;
    // A rebuild replays a limited number of epochs. The session has fewer, so the bits are the
    // same.
    assert!(checked(&database, &id).await.is_same());
}

/// A desk that stops stores the state of a session if a replay of its epochs would take long.
async fn a_stop_stores_the_state(database: Database) {
    let store = database.store().await;
    broker(&store).await.navigation.push(DRIVE.navigation.clone(), "all").await.unwrap();
    let sessions = desk(&database).await;
    let id = created(&sessions, "fgo").await;
    submit(&sessions, &id, &DRIVE.epochs[..40]).await;
    sessions.drain().await;
    let key = sessions_key(&store, &id).await;
    let stored = store.snapshot(key).await.unwrap().expect("40 epochs take more than 1 ms");
    assert_eq!(stored.seq, DRIVE.epochs[39].seq);
    submit(&desk(&database).await, &id, &DRIVE.epochs[40..45]).await;
    assert!(checked(&database, &id).await.is_same());
}

async fn sessions_key(store: &Store, id: &SessionId) -> graphfix::store::SessionKey {
    store.session_of_any(id.as_str()).await.unwrap().unwrap().key
}

/// Old navigation data are kept up to a limit. A replay that needs older ones is refused, but a
/// session whose state was stored later continues.
async fn forgotten_navigation_data_is_said(database: Database) {
    let store = database.store().await;
    let few = AidingLimits {
        ephemerides_per_satellite: 1,
        superseded_ephemerides: 3,
        ..AidingLimits::service()
    };
    let aiding = AidingDesk::open(store.clone(), few).await.unwrap();
    aiding.navigation.push(DRIVE.navigation_without_galileo(), "a").await.unwrap_err();
    let sessions = desk(&database).await;
    let id = created(&sessions, "spp").await;
    submit(&sessions, &id, &DRIVE.epochs[..5]).await;
    let kept = |toe: usize| {
        let mut navigation = DRIVE.navigation.clone();
        let mut seen = BTreeMap::new();
        navigation.retain(|ephemeris| {
            let count = seen.entry(ephemeris.satellite()).or_insert(0);
            *count += 1;
            *count == toe + 1
        });
        navigation
    };
    aiding.navigation.push(kept(0), "first").await.unwrap();
    assert!(checked(&database, &id).await.is_same(), "nothing was in force, and is known to be");
    let pushed = aiding.navigation.push(kept(1), "second").await.unwrap();
    assert!(3 < pushed.dropped, "{pushed:?}");
    let again = Recomputation::open(store.clone(), broker(&store).await, &id, None).await.unwrap();
    assert_eq!(again.check().await.unwrap_err().code().name(), "NAVIGATION_FORGOTTEN");
    submit(&desk(&database).await, &id, &DRIVE.epochs[5..10]).await;
}
