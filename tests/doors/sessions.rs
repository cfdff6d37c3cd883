//! The rules of a session, on both databases.

use std::collections::BTreeMap;
use std::num::NonZeroUsize;
use std::slice;
use std::time::Duration;

use graphfix::aiding::bases::BaseChoice;
use graphfix::aiding::{AidingDesk, AidingLimits};
use graphfix::gnss::{GpsTime, Status};
use graphfix::refusal::Code;
use graphfix::session::{
    Burst, EpochOutcome, EpochRefusal, NewSession, Recomputation, SequencedEpoch, SessionError,
    SessionId, SessionLimits, SessionUpdate, Sessions, SolveRequest,
};
use graphfix::store::{Revisions, SessionFilter, SolutionQuery, Store, StoredSolution};

use crate::support::data;
use crate::support::database::{Database, on_both_databases, whole_session};
use crate::support::reading;
use crate::support::sessions::{created, desk_with, epoch, new_session};
use crate::support::wait::until;

on_both_databases!(
    what_is_acknowledged_survives,
    a_resend_gets_the_stored_answer,
    a_resend_within_one_batch_gets_its_answer,
    other_content_under_a_number_is_a_conflict,
    gaps_are_fine_and_the_past_is_refused,
    an_epoch_not_later_in_time_is_refused,
    an_epoch_beyond_the_limits_is_refused,
    an_epoch_of_the_future_does_no_harm,
    a_reset_session_takes_epochs_of_any_time,
    resets_are_bounded,
    a_closed_session_is_readable,
    a_deleted_session_leaves_nothing,
    an_update_holds_for_the_epochs_that_follow,
    a_full_mailbox_asks_to_wait,
    all_mailboxes_together_are_bounded,
    parked_sessions_go_on,
    active_sessions_are_bounded,
    many_sessions_at_once,
    pipelined_batches_keep_their_order,
    a_client_that_hangs_up_stops_nothing,
    draining_answers_what_was_accepted,
    a_store_that_fails_acknowledges_nothing,
    another_writer_is_noticed,
    corrupt_rows_are_errors,
    sessions_are_listed_in_pages,
    sessions_with_options_of_another_version_are_listed,
    configurations_that_do_not_exist_are_refused,
    only_configurations_with_epochs_are_stored,
    requests_are_solved_without_a_trace,
);

fn limits() -> SessionLimits {
    SessionLimits {
        mailbox_epochs: 64,
        waiting_epochs: 4_096,
        epochs_per_push: 32,
        raw_chunk_bytes: 256 << 10,
        observations_per_epoch: 8,
        future_s: 86_400,
        retention_days: 0,
        audit_days: 400,
        history_days: 400,
        active_sessions: 64,
        parked_bytes: 1 << 20,
        candidate_bases: 2,
        live_solutions: 64,
        label_characters: 20,
        solve_window_epochs: 300,
        solve_time: Duration::from_secs(60),
        solver_threads: NonZeroUsize::new(2).unwrap(),
        retry_after: Duration::from_millis(50),
    }
}

async fn desk(store: &Store) -> Sessions {
    desk_with(store, limits()).await
}

fn batch(seqs: impl IntoIterator<Item = u64>) -> Vec<SequencedEpoch> {
    seqs.into_iter().map(|seq| epoch(seq, seq as f64)).collect()
}

async fn stored(sessions: &Sessions, id: &SessionId) -> Vec<StoredSolution> {
    let page = sessions.solutions(id, &whole_session()).await.unwrap().page;
    assert_eq!(page.next_page_token, None);
    page.items
}

async fn stored_numbers(sessions: &Sessions, id: &SessionId) -> Vec<u64> {
    stored(sessions, id).await.iter().map(|solution| solution.seq).collect()
}

fn refusal(outcome: &EpochOutcome) -> &EpochRefusal {
    outcome.result.as_ref().unwrap_err()
}

async fn what_is_acknowledged_survives(database: Database) {
    let id;
    let first;
    {
        let sessions = desk(&database.store().await).await;
        id = created(&sessions).await;
        first = sessions.submit(&id, batch(1..=5)).await.unwrap();
        assert_eq!(first.durable_through, Some(5));
        // Neither drained nor closed: everything in memory is lost here.
    }
    let sessions = desk(&database.store().await).await;
    let info = sessions.get(&id).await.unwrap();
    assert_eq!((info.durable_through, info.closed_unix_ms), (Some(5), None));
    let acknowledged: Vec<_> =
        first.outcomes.into_iter().map(|outcome| outcome.result.unwrap().solution).collect();
    assert_eq!(stored(&sessions, &id).await, acknowledged);
    assert_eq!(acknowledged[0].solution.reasons[0].code(), "EPHEMERIS_MISSING");
    assert_eq!(acknowledged[0].configuration_hash, info.configuration_hash);
    let next = sessions.submit(&id, batch([6])).await.unwrap();
    assert!(!next.outcomes[0].result.as_ref().unwrap().resent);
    assert_eq!(next.durable_through, Some(6));
}

async fn a_resend_gets_the_stored_answer(database: Database) {
    let store = database.store().await;
    let sessions = desk(&store).await;
    let id = created(&sessions).await;
    let first = sessions.submit(&id, batch(1..=5)).await.unwrap();
    let restarted = desk(&store).await;
    for desk in [&sessions, &restarted] {
        let again = desk.submit(&id, batch(3..=6)).await.unwrap();
        for (outcome, before) in again.outcomes.iter().zip(&first.outcomes[2..]) {
            let (now, before) = (outcome.result.as_ref().unwrap(), before.result.as_ref().unwrap());
            assert!(now.resent && !before.resent);
            assert_eq!(now.solution, before.solution);
        }
        assert_eq!(again.durable_through, Some(6));
    }
    assert_eq!(stored_numbers(&sessions, &id).await, [1, 2, 3, 4, 5, 6]);
}

async fn a_resend_within_one_batch_gets_its_answer(database: Database) {
    let sessions = desk(&database.store().await).await;
    let id = created(&sessions).await;
    let changed = epoch(2, 2.5);
    let epochs = [batch([1, 2, 2]), vec![changed], batch([3, 1])].concat();
    let outcomes = sessions.submit(&id, epochs).await.unwrap().outcomes;
    let resent: Vec<_> =
        outcomes.iter().map(|o| o.result.as_ref().ok().map(|answer| answer.resent)).collect();
    let expected = [Some(false), Some(false), Some(true), None, Some(false), Some(true)];
    assert_eq!(resent, expected);
    assert_eq!(*refusal(&outcomes[3]), EpochRefusal::Conflict { seq: 2 });
    assert_eq!(stored_numbers(&sessions, &id).await, [1, 2, 3]);
}

async fn other_content_under_a_number_is_a_conflict(database: Database) {
    let sessions = desk(&database.store().await).await;
    let id = created(&sessions).await;
    sessions.submit(&id, batch(1..=3)).await.unwrap();
    let mut changed = epoch(2, 2.0);
    changed.epoch.observations[0].half_cycle = true;
    let outcomes = sessions.submit(&id, vec![changed, epoch(4, 4.0)]).await.unwrap().outcomes;
    assert_eq!(refusal(&outcomes[0]).code().name(), "SEQUENCE_CONFLICT");
    assert!(outcomes[1].result.is_ok(), "one refusal stops no other epoch");
}

async fn gaps_are_fine_and_the_past_is_refused(database: Database) {
    let sessions = desk(&database.store().await).await;
    let id = created(&sessions).await;
    sessions.submit(&id, batch([5, 10, 20])).await.unwrap();
    let outcomes = sessions.submit(&id, batch([15, 30, 25, 40])).await.unwrap().outcomes;
    assert_eq!(*refusal(&outcomes[0]), EpochRefusal::Superseded { seq: 15, last: 40 });
    assert_eq!(*refusal(&outcomes[2]), EpochRefusal::Superseded { seq: 25, last: 40 });
    assert_eq!(stored_numbers(&sessions, &id).await, [5, 10, 20, 30, 40]);
}

async fn an_epoch_not_later_in_time_is_refused(database: Database) {
    let store = database.store().await;
    let sessions = desk(&store).await;
    let id = created(&sessions).await;
    sessions.submit(&id, vec![epoch(1, 100.0)]).await.unwrap();
    for desk in [&sessions, &desk(&store).await] {
        let epochs = vec![epoch(2, 100.0), epoch(3, 99.0)];
        let outcomes = desk.submit(&id, epochs).await.unwrap().outcomes;
        assert_eq!(refusal(&outcomes[0]).code().name(), "OUT_OF_ORDER");
        assert_eq!(refusal(&outcomes[1]).field(), "time");
    }
    let later = sessions.submit(&id, vec![epoch(2, 101.0)]).await.unwrap();
    assert!(later.outcomes[0].result.is_ok(), "the session goes on");
}

async fn an_epoch_beyond_the_limits_is_refused(database: Database) {
    let sessions = desk(&database.store().await).await;
    let id = created(&sessions).await;
    let mut crowded = epoch(1, 1.0);
    crowded.epoch.observations = vec![crowded.epoch.observations[0]; 9];
    let epochs = vec![crowded, epoch(2, 2.0), epoch(u64::MAX, 3.0)];
    let outcomes = sessions.submit(&id, epochs).await.unwrap().outcomes;
    let expected = EpochRefusal::TooManyObservations { seq: 1, observations: 9, limit: 8 };
    assert_eq!(*refusal(&outcomes[0]), expected);
    assert!(outcomes[1].result.is_ok());
    assert_eq!(refusal(&outcomes[2]).code().name(), "INVALID_SEQUENCE");
    let code = |answer: Result<_, SessionError>| answer.map(drop).unwrap_err().code().name();
    assert_eq!(code(sessions.submit(&id, batch(10..43)).await), "TOO_MANY_EPOCHS");
    assert_eq!(code(sessions.submit(&id, vec![]).await), "NO_EPOCHS");
    let unknown = SessionId::parse(&format!("ses_{}", "0".repeat(32))).unwrap();
    assert_eq!(code(sessions.submit(&unknown, batch([1])).await), "SESSION_NOT_FOUND");
}

/// A receiver with a wrong week number: its epoch is refused, and the right ones are accepted.
async fn an_epoch_of_the_future_does_no_harm(database: Database) {
    let sessions = desk(&database.store().await).await;
    let id = created(&sessions).await;
    sessions.submit(&id, batch([1])).await.unwrap();
    let mut wrong = epoch(2, 2.0);
    wrong.epoch.time = GpsTime::from_week_seconds(14_999, 2.0);
    let outcomes = sessions.submit(&id, vec![wrong, epoch(3, 3.0)]).await.unwrap().outcomes;
    assert_eq!(refusal(&outcomes[0]).code().name(), "TIME_IMPLAUSIBLE");
    assert_eq!(refusal(&outcomes[0]).field(), "time");
    assert!(outcomes[1].result.is_ok(), "the session goes on");
    assert_eq!(stored_numbers(&sessions, &id).await, [1, 3]);
}

/// A new arc after a wrong clock of the receiver. Stored epochs stay, and a restart and a replay
/// respect the arc.
async fn a_reset_session_takes_epochs_of_any_time(database: Database) {
    let store = database.store().await;
    let sessions = desk(&store).await;
    let fgo = NewSession { mode: "fgo".to_owned(), ..new_session() };
    let id = sessions.create(fgo).await.unwrap().id;
    assert_eq!(sessions.reset(&id).await.unwrap().durable_through, None, "nothing to reset");
    sessions.submit(&id, vec![epoch(1, 1000.0), epoch(2, 1001.0)]).await.unwrap();
    let reset = sessions.reset(&id).await.unwrap();
    assert_eq!(reset.durable_through, Some(2));
    sessions.reset(&id).await.unwrap();
    let restarted = desk(&store).await;
    let outcomes = restarted.submit(&id, vec![epoch(3, 10.0), epoch(4, 11.0)]).await.unwrap();
    assert!(outcomes.outcomes.iter().all(|outcome| outcome.result.is_ok()), "{outcomes:?}");
    let late = restarted.submit(&id, vec![epoch(5, 11.0)]).await.unwrap().outcomes;
    assert_eq!(refusal(&late[0]).code().name(), "OUT_OF_ORDER", "order holds within the arc");
    let resent = restarted.submit(&id, vec![epoch(2, 1001.0)]).await.unwrap().outcomes;
    assert!(resent[0].result.as_ref().unwrap().resent);

    let time = |second: f64| Some(GpsTime::from_week_seconds(2051, second));
    let span = async |from, to| {
        let query = SolutionQuery { revisions: Revisions::First, from, to, ..whole_session() };
        let page = restarted.solutions(&id, &query).await.unwrap().page;
        page.items.iter().map(|solution| solution.seq).collect::<Vec<_>>()
    };
    assert_eq!(span(time(500.0), None).await, [1, 2]);
    assert_eq!(span(None, time(500.0)).await, [3, 4]);
    assert_eq!(span(time(11.0), time(1000.0)).await, [1, 4]);

    restarted.reset(&id).await.unwrap();
    let aiding = AidingDesk::open(store.clone(), AidingLimits::service()).await.unwrap();
    let again = Recomputation::open(store, aiding, &id, None).await.unwrap();
    let check = again.check().await.unwrap();
    assert!(check.is_same() && 4 <= check.compared, "{check:?}");
    restarted.close(&id).await.unwrap();
    assert_eq!(restarted.reset(&id).await.unwrap_err().code().name(), "SESSION_CLOSED");
}

async fn a_closed_session_is_readable(database: Database) {
    let sessions = desk(&database.store().await).await;
    let id = created(&sessions).await;
    sessions.submit(&id, batch(1..=3)).await.unwrap();
    let closed = sessions.close(&id).await.unwrap();
    assert!(closed.created_unix_ms <= closed.closed_unix_ms.unwrap());
    assert_eq!(sessions.submit(&id, batch([4])).await.unwrap_err().code().name(), "SESSION_CLOSED");
    let update = sessions.update(&id, SessionUpdate::default()).await;
    assert_eq!(update.unwrap_err().code().name(), "SESSION_CLOSED");
    assert_eq!(sessions.close(&id).await.unwrap().closed_unix_ms, closed.closed_unix_ms);
    assert_eq!(stored_numbers(&sessions, &id).await, [1, 2, 3]);
}

/// A session is deleted while epochs wait. Its rows are removed, if necessary by the next service.
async fn a_deleted_session_leaves_nothing(database: Database) {
    let store = database.store().await;
    let sessions = desk(&store).await;
    let (id, other) = (created(&sessions).await, created(&sessions).await);
    for first in (1..=1_200).step_by(30) {
        sessions.submit(&id, batch(first..first + 30)).await.unwrap();
    }
    sessions.submit(&other, batch(1..=3)).await.unwrap();
    let pending = sessions.enqueue(&id, batch([1_300])).await.unwrap();
    let deleted = sessions.delete(&id).await.unwrap();
    assert!(pending.answer().await.unwrap().outcomes[0].result.is_ok());
    assert_eq!((deleted.durable_through, deleted.closed_unix_ms.is_some()), (Some(1_300), true));
    let codes = [
        sessions.get(&id).await.unwrap_err().code(),
        sessions.submit(&id, batch([1_301])).await.unwrap_err().code(),
        sessions.delete(&id).await.unwrap_err().code(),
        sessions.solutions(&id, &whole_session()).await.unwrap_err().code(),
    ];
    assert_eq!(codes, [Code::SessionNotFound; 4]);
    let listed = sessions.list(&SessionFilter::default(), 10, None).await.unwrap().items;
    assert_eq!(listed.into_iter().map(|info| info.id).collect::<Vec<_>>(), slice::from_ref(&other));
    sessions.drain().await;
    let restarted = desk(&store).await;
    let count = async |table: &str| database.count(table).await;
    until("removed", async || count("epochs").await, |epochs| *epochs == 3).await;
    until("removed", async || count("session_heads").await, |heads| *heads == 1).await;
    assert_eq!((count("epochs").await, count("sessions").await), (3, 2));
    assert_eq!(stored_numbers(&restarted, &other).await, [1, 2, 3]);
}

async fn an_update_holds_for_the_epochs_that_follow(database: Database) {
    let sessions = desk(&database.store().await).await;
    let before = sessions.create(new_session()).await.unwrap();
    sessions.submit(&before.id, batch([1])).await.unwrap();
    let mask = BTreeMap::from([("elevation_mask_deg".to_owned(), "5".to_owned())]);
    let update = SessionUpdate {
        label: Some("boat".to_owned()),
        profile: Some("phone".to_owned()),
        overrides: mask.clone(),
        ..SessionUpdate::default()
    };
    let after = sessions.update(&before.id, update).await.unwrap();
    assert_eq!((&*after.label, &*after.profile, &after.overrides), ("boat", "phone", &mask));
    let entry = after.configuration.iter().find(|e| e.name == "elevation_mask_deg").unwrap();
    assert_eq!((&*entry.value, &*entry.default), ("5", "15"));
    sessions.submit(&before.id, batch([2])).await.unwrap();
    let clear = vec!["elevation_mask_deg".to_owned()];
    let update = SessionUpdate {
        clear_overrides: clear,
        profile: Some("general".to_owned()),
        ..SessionUpdate::default()
    };
    assert_eq!(sessions.update(&before.id, update).await.unwrap().overrides, BTreeMap::new());
    sessions.submit(&before.id, batch([3])).await.unwrap();
    let hashes: Vec<_> =
        stored(&sessions, &before.id).await.into_iter().map(|s| s.configuration_hash).collect();
    let expected = [&before.configuration_hash, &after.configuration_hash];
    assert_eq!(hashes.iter().collect::<Vec<_>>(), [expected[0], expected[1], expected[0]]);
    assert_ne!(expected[0], expected[1]);
}

/// The test has one thread, so the session's task does not run between calls that do not wait.
async fn a_full_mailbox_asks_to_wait(database: Database) {
    let sessions = desk(&database.store().await).await;
    let id = created(&sessions).await;
    sessions.submit(&id, batch([1])).await.unwrap();
    let first = sessions.enqueue(&id, batch(2..34)).await.unwrap();
    let second = sessions.enqueue(&id, batch(34..66)).await.unwrap();
    let error = sessions.enqueue(&id, batch([66])).await.unwrap_err();
    assert!(matches!(error, SessionError::MailboxFull { waiting: 64, limit: 64, .. }), "{error}");
    assert_eq!(error.code().name(), "MAILBOX_FULL");
    assert_waits(&error);
    assert_eq!(first.answer().await.unwrap().outcomes.len(), 32);
    second.answer().await.unwrap();
    let retried = sessions.submit(&id, batch([66])).await.unwrap();
    assert_eq!(retried.durable_through, Some(66));
    assert_eq!(stored_numbers(&sessions, &id).await, (1..=66).collect::<Vec<_>>());
}

/// The delay is between the base delay and twice the base delay, and it varies.
fn assert_waits(error: &SessionError) {
    let delays: Vec<_> = (0..20).map(|_| error.retry_after().unwrap()).collect();
    let base = limits().retry_after;
    assert!(delays.iter().all(|delay| (base..=2 * base).contains(delay)), "{delays:?}");
    assert!(delays.iter().any(|delay| *delay != delays[0]), "{delays:?}");
}

async fn active_sessions_are_bounded(database: Database) {
    let none = SessionLimits { active_sessions: 0, ..limits() };
    let sessions = desk_with(&database.store().await, none).await;
    let id = created(&sessions).await;
    let error = sessions.submit(&id, batch([1])).await.unwrap_err();
    assert_eq!(error.code().name(), "TOO_MANY_ACTIVE_SESSIONS", "{error}");
    assert_waits(&error);
    // A session with a full mailbox can still be closed.
    assert!(sessions.close(&id).await.unwrap().closed_unix_ms.is_some());
}

async fn all_mailboxes_together_are_bounded(database: Database) {
    let few = SessionLimits { waiting_epochs: 40, ..limits() };
    let sessions = desk_with(&database.store().await, few).await;
    let (one, other) = (created(&sessions).await, created(&sessions).await);
    for id in [&one, &other] {
        sessions.submit(id, batch([1])).await.unwrap();
    }
    let waiting = sessions.enqueue(&one, batch(2..34)).await.unwrap();
    let error = sessions.enqueue(&other, batch(2..11)).await.unwrap_err();
    assert!(matches!(error, SessionError::Overloaded { waiting: 32, limit: 40, .. }), "{error}");
    assert_eq!(error.code().name(), "OVERLOADED");
    waiting.answer().await.unwrap();
    sessions.submit(&other, batch(2..11)).await.unwrap();
}

/// Parked sessions continue from memory, or from the store if there is no room.
async fn parked_sessions_go_on(database: Database) {
    for (parked_bytes, is_kept) in [(0, false), (1 << 20, true)] {
        let few = SessionLimits { active_sessions: 2, parked_bytes, ..limits() };
        let sessions = desk_with(&database.store().await, few).await;
        let mut ids = Vec::new();
        for _ in 0..5 {
            ids.push(created(&sessions).await);
        }
        for seq in 1..=4 {
            for id in &ids {
                let answer = sessions.submit(id, batch([seq])).await.unwrap();
                assert_eq!(answer.durable_through, Some(seq));
            }
        }
        for id in &ids {
            assert_eq!(stored_numbers(&sessions, id).await, [1, 2, 3, 4]);
        }
        // A task may start before the previous task has left its state in memory.
        let restores = sessions.counts().restores();
        assert_eq!(restores < 3 * 5, is_kept, "{restores} restores");
    }
    let few = SessionLimits { active_sessions: 2, ..limits() };
    let sessions = desk_with(&database.store().await, few).await;
    let mut ids = Vec::new();
    for _ in 0..5 {
        ids.push(created(&sessions).await);
        sessions.submit(ids.last().unwrap(), batch(1..5)).await.unwrap();
    }
    // A change while a session is parked is in force when the session continues.
    let update = SessionUpdate { mode: Some("ekf".to_owned()), ..SessionUpdate::default() };
    sessions.update(&ids[0], update).await.unwrap();
    sessions.submit(&ids[0], batch([5])).await.unwrap();
    let solutions = stored(&sessions, &ids[0]).await;
    assert_ne!(solutions[3].configuration_hash, solutions[4].configuration_hash);
    // Another writer's epochs are not overwritten.
    let other = desk_with(&database.store().await, limits()).await;
    other.submit(&ids[1], batch([5])).await.unwrap();
    let next = match sessions.submit(&ids[1], batch([6])).await {
        // The parked state is outdated, and is dropped.
        Err(refused) => {
            assert_eq!(refused.code().name(), "WRITTEN_ELSEWHERE");
            sessions.submit(&ids[1], batch([6])).await
        }
        restored => restored,
    };
    assert_eq!(next.unwrap().durable_through, Some(6));
    assert_eq!(stored_numbers(&sessions, &ids[1]).await, [1, 2, 3, 4, 5, 6]);
    let busy_one = sessions.enqueue(&ids[3], batch([5])).await.unwrap();
    let busy_other = sessions.enqueue(&ids[4], batch([5])).await.unwrap();
    busy_one.answer().await.unwrap();
    busy_other.answer().await.unwrap();
}

async fn many_sessions_at_once(database: Database) {
    let sessions = desk(&database.store().await).await;
    let devices = (0..40).map(|_| {
        let sessions = sessions.clone();
        tokio::spawn(async move {
            let id = created(&sessions).await;
            for first in (1..=100).step_by(10) {
                let answer = sessions.submit(&id, batch(first..first + 10)).await.unwrap();
                assert!(answer.outcomes.iter().all(|outcome| outcome.result.is_ok()));
            }
            id
        })
    });
    for device in devices.collect::<Vec<_>>() {
        let id = device.await.unwrap();
        assert_eq!(stored_numbers(&sessions, &id).await, (1..=100).collect::<Vec<_>>());
    }
}

async fn pipelined_batches_keep_their_order(database: Database) {
    let sessions = desk(&database.store().await).await;
    let id = created(&sessions).await;
    let mut answers = Vec::new();
    for seq in 1..=60 {
        answers.push(sessions.enqueue(&id, batch([seq])).await.unwrap());
    }
    for (seq, answer) in (1..=60).zip(answers) {
        let answer = answer.answer().await.unwrap();
        assert_eq!(answer.outcomes[0].seq, seq);
        assert!(answer.outcomes[0].result.is_ok() && Some(seq) <= answer.durable_through);
    }
}

async fn a_client_that_hangs_up_stops_nothing(database: Database) {
    let sessions = desk(&database.store().await).await;
    let id = created(&sessions).await;
    drop(sessions.enqueue(&id, batch(1..=3)).await.unwrap());
    sessions.submit(&id, batch([4])).await.unwrap();
    assert_eq!(stored_numbers(&sessions, &id).await, [1, 2, 3, 4]);
}

async fn draining_answers_what_was_accepted(database: Database) {
    let store = database.store().await;
    let sessions = desk(&store).await;
    let id = created(&sessions).await;
    let accepted = sessions.enqueue(&id, batch(1..=3)).await.unwrap();
    sessions.drain().await;
    assert!(sessions.is_draining());
    assert_eq!(accepted.answer().await.unwrap().durable_through, Some(3));
    assert_eq!(sessions.submit(&id, batch([4])).await.unwrap_err().code().name(), "DRAINING");
    store.close().await;
    let sessions = desk(&database.store().await).await;
    assert_eq!(stored_numbers(&sessions, &id).await, [1, 2, 3]);
}

async fn a_store_that_fails_acknowledges_nothing(database: Database) {
    let store = database.store().await;
    let sessions = desk(&store).await;
    let id = created(&sessions).await;
    sessions.submit(&id, batch([1])).await.unwrap();
    store.close().await;
    let error = sessions.submit(&id, batch([2])).await.unwrap_err();
    assert!(matches!(error, SessionError::Store(_)), "{error:?}");
    let sessions = desk(&database.store().await).await;
    assert_eq!(stored_numbers(&sessions, &id).await, [1]);
}

async fn another_writer_is_noticed(database: Database) {
    let one = desk(&database.store().await).await;
    let other = desk_with(&database.store().await, limits()).await;
    let id = created(&one).await;
    one.submit(&id, batch([1])).await.unwrap();
    other.submit(&id, batch([2])).await.unwrap();
    // `one` learns of epoch 2 only when the store refuses its commit.
    let error = one.submit(&id, batch([2])).await.unwrap_err();
    assert_eq!(error.code().name(), "WRITTEN_ELSEWHERE");
    let again = one.submit(&id, batch([2, 3])).await.unwrap();
    assert!(again.outcomes[0].result.as_ref().unwrap().resent);
    assert_eq!(again.durable_through, Some(3));
    assert_eq!(stored_numbers(&one, &id).await, [1, 2, 3]);
}

async fn corrupt_rows_are_errors(database: Database) {
    let sessions = desk(&database.store().await).await;
    let id = created(&sessions).await;
    sessions.submit(&id, batch(1..=3)).await.unwrap();
    database.execute("UPDATE epochs SET content = '\\x' WHERE seq = 2").await;
    let error = sessions.submit(&id, batch([2])).await.unwrap_err();
    assert_eq!(error.code().name(), "STORED_DATA_CORRUPT");
    database.execute("UPDATE epochs SET solution = '\\x' WHERE seq = 3").await;
    let error = sessions.solutions(&id, &whole_session()).await.unwrap_err();
    assert_eq!(error.code().name(), "STORED_DATA_CORRUPT");
}

async fn sessions_are_listed_in_pages(database: Database) {
    let sessions = desk(&database.store().await).await;
    let mut newest_first = Vec::new();
    for _ in 0..5 {
        newest_first.insert(0, created(&sessions).await);
    }
    let mut listed = Vec::new();
    let mut token = None;
    loop {
        let page = sessions.list(&SessionFilter::default(), 2, token.as_deref()).await.unwrap();
        assert!(page.items.len() <= 2);
        listed.extend(page.items.into_iter().map(|info| info.id));
        token = page.next_page_token;
        if token.is_none() {
            break;
        }
    }
    assert_eq!(listed, newest_first);
    let code = |error: SessionError| error.code().name();
    assert_eq!(
        sessions.list(&SessionFilter::default(), 2, Some("x")).await.map_err(code),
        Err("PAGE_TOKEN_INVALID")
    );
    assert_eq!(
        sessions.list(&SessionFilter::default(), 0, None).await.map_err(code),
        Err("PAGE_SIZE_INVALID")
    );
}

async fn configurations_that_do_not_exist_are_refused(database: Database) {
    let sessions = desk(&database.store().await).await;
    let refused = async |change: fn(&mut NewSession)| {
        let mut new = new_session();
        change(&mut new);
        sessions.create(new).await.unwrap_err().code().name()
    };
    assert_eq!(refused(|new| new.mode = "teleport".to_owned()).await, "UNKNOWN_MODE");
    assert_eq!(refused(|new| new.profile = "x".to_owned()).await, "UNKNOWN_PROFILE");
    assert_eq!(refused(|new| new.label = "x".repeat(21)).await, "LABEL_TOO_LONG");
    let unknown = |new: &mut NewSession| {
        new.overrides.insert("elevation".to_owned(), "5".to_owned());
    };
    assert_eq!(refused(unknown).await, "UNKNOWN_OPTION");
}

async fn requests_are_solved_without_a_trace(database: Database) {
    let sessions = desk(&database.store().await).await;
    let id = created(&sessions).await;
    let request = SolveRequest::default();
    assert_eq!(sessions.solve(&id, &request).await.unwrap_err().code().name(), "SESSION_EMPTY");
    sessions.submit(&id, batch(1..=3)).await.unwrap();
    let solved = sessions.solve(&id, &request).await.unwrap();
    let last = stored(&sessions, &id).await.pop().unwrap();
    assert_eq!((solved.seq, solved.solution), (3, last.solution));
    assert_eq!(solved.configuration_hash, last.configuration_hash);

    let phone = SolveRequest { profile: Some("phone".to_owned()), ..request };
    let solved = sessions.solve(&id, &phone).await.unwrap();
    assert_ne!(solved.configuration_hash, last.configuration_hash);

    let NewSession { mode, profile, overrides, .. } = new_session();
    let burst = Burst {
        mode,
        profile,
        overrides,
        epochs: batch(1..=3),
        navigation: None,
        base: BaseChoice::None,
        antenna: String::new(),
    };
    let answers = sessions.solve_once(burst.clone()).await.unwrap();
    assert_eq!(answers.iter().map(|a| a.seq).collect::<Vec<_>>(), [1, 2, 3]);
    assert!(answers.iter().all(|answer| answer.solution.status == Status::None));
    let disordered = Burst { epochs: batch([2, 1]), ..burst };
    let error = sessions.solve_once(disordered).await.unwrap_err();
    assert!(matches!(error, SessionError::BurstOutOfOrder { index: 1 }), "{error}");
    assert_eq!(stored_numbers(&sessions, &id).await, [1, 2, 3]);
}

/// A session interrupted after every 100 epochs and restored from the store gives the same bits as
/// one without interruptions; so does a session that is parked after every batch.
#[tokio::test]
async fn real_epochs_give_the_same_bits_after_restarts() {
    let Some(folder) = data::set("tst-2019") else { return };
    let epochs = reading::epochs(&folder.join("COM3_190428_124409.obs"));
    let numbered = (1..=600).zip(epochs).map(|(seq, epoch)| SequencedEpoch { seq, epoch });
    let epochs: Vec<_> = numbered.collect();
    let database = Database::sqlite();
    let store = database.store().await;
    let aiding = AidingDesk::open(store.clone(), AidingLimits::service()).await.unwrap();
    for name in ["hksc1180.19n", "hksc1180.19b"] {
        let navigation = reading::navigation(&folder, &[name]);
        aiding.navigation.push(navigation, name).await.unwrap();
    }
    let limits = SessionLimits {
        observations_per_epoch: 256,
        epochs_per_push: 100,
        active_sessions: 1,
        ..limits()
    };
    let sessions = Sessions::open(store, aiding, limits.clone());
    let (whole, parked, restarted) =
        (created(&sessions).await, created(&sessions).await, created(&sessions).await);
    for batch in epochs.chunks(100) {
        sessions.submit(&whole, batch.to_vec()).await.unwrap();
    }
    for batch in epochs.chunks(7) {
        sessions.submit(&parked, batch.to_vec()).await.unwrap();
        sessions.submit(&whole, batch[..1].to_vec()).await.unwrap();
        let restarted_desk = desk_with(&database.store().await, limits.clone()).await;
        restarted_desk.submit(&restarted, batch.to_vec()).await.unwrap();
    }
    let expected = stored(&sessions, &whole).await;
    assert_eq!(expected.len(), epochs.len());
    let positions = expected.iter().filter(|s| s.solution.status == Status::Single).count();
    // The receiver starts among buildings: its first epochs have too few satellites.
    assert!(epochs.len() * 9 < positions * 10, "{positions} positions");
    assert_eq!(stored(&sessions, &parked).await, expected);
    assert_eq!(stored(&sessions, &restarted).await, expected);
    let solved = sessions.solve(&whole, &SolveRequest::default()).await.unwrap();
    assert_eq!(solved.solution, expected.last().unwrap().solution);
}

async fn resets_are_bounded(database: Database) {
    let sessions = desk(&database.store().await).await;
    let id = created(&sessions).await;
    sessions.submit(&id, vec![epoch(1, 1.0)]).await.unwrap();
    let arcs = "INSERT INTO session_arcs (session, after_seq, created_unix_ms) \
                WITH RECURSIVE n(i) AS (SELECT -998 UNION ALL SELECT i + 1 FROM n WHERE i < 0) \
                SELECT 1, i, 0 FROM n";
    database.execute(arcs).await;
    sessions.reset(&id).await.unwrap();
    sessions.submit(&id, vec![epoch(2, 1.0)]).await.unwrap();
    let refused = sessions.reset(&id).await.unwrap_err();
    assert_eq!(refused.code().name(), "TOO_MANY_ARCS", "{refused}");
    assert!(sessions.submit(&id, vec![epoch(3, 2.0)]).await.unwrap().outcomes[0].result.is_ok());
}

/// The options that this version knows are listed. Stored options of another version do no harm.
async fn sessions_with_options_of_another_version_are_listed(database: Database) {
    let sessions = desk(&database.store().await).await;
    let (id, other) = (created(&sessions).await, created(&sessions).await);
    let known = sessions.get(&id).await.unwrap();
    let update = r#"UPDATE sessions SET configuration = '{"elevation_mask_deg":"17","of_later":"1"}'
                    WHERE key = 1"#;
    database.execute(update).await;
    let listed = sessions.list(&SessionFilter::default(), 10, None).await.unwrap().items;
    let ids: Vec<_> = listed.iter().map(|session| session.id.clone()).collect();
    assert_eq!(ids, [other, id]);
    let names = |session: &graphfix::session::SessionInfo| {
        session.configuration.iter().map(|entry| entry.name).collect::<Vec<_>>()
    };
    assert_eq!(names(&listed[1]), names(&known));
    let mask = listed[1].configuration.iter().find(|entry| entry.name == "elevation_mask_deg");
    assert_eq!(mask.map(|entry| &*entry.value), Some("17"));
}

/// Changes of settings take no space, however many there are. Each session with an epoch can be
/// replayed, so its configuration is stored.
async fn only_configurations_with_epochs_are_stored(database: Database) {
    let sessions = desk_with(&database.store().await, SessionLimits::service()).await;
    let id = created(&sessions).await;
    let set = async |value: &str| {
        let overrides = [("elevation_mask_deg".to_owned(), value.to_owned())].into();
        let update = SessionUpdate { overrides, ..SessionUpdate::default() };
        sessions.update(&id, update).await.unwrap();
    };
    let before = database.count("configurations").await;
    for value in ["11", "12", "13"] {
        set(value).await;
    }
    assert_eq!(database.count("configurations").await, before);
    for (seq, value) in [(1, "14"), (2, "15")] {
        set(value).await;
        sessions.submit(&id, vec![epoch(seq, seq as f64)]).await.unwrap();
    }
    assert_eq!(database.count("configurations").await, before + 2);
}
