//! Epochs older than their session's retention are removed. The others can still be listed, resent
//! and replayed.

use axum::http::StatusCode;
use graphfix::aiding::{AidingDesk, AidingLimits};
use graphfix::clock::Clock;
use graphfix::gnss::Navigation;
use graphfix::session::{
    EpochOutcome, NewSession, Recomputation, SequencedEpoch, SessionId, SessionLimits, Sessions,
};
use graphfix::simulation::{Scenario, Simulator};
use graphfix::store::Store;
use serde_json::json;
use sqlx::{Connection, PgConnection};

use crate::support::database::{Database, on_both_databases, on_postgres, whole_session};
use crate::support::doors::{Doors, code};
use crate::support::sessions::{epoch, new_session};
use crate::support::wait::until;

on_both_databases!(
    a_store_with_retention_stays_flat,
    a_session_has_its_own_retention,
    a_closed_session_expires,
    closed_sessions_of_which_nothing_is_left_are_noted_once,
    a_session_that_cannot_be_removed_delays_no_other,
    a_step_of_the_clock_removes_nothing,
    what_a_slow_clock_closes_is_kept,
    a_replay_needs_a_readable_snapshot,
    a_restore_finds_epochs_of_earlier_days,
    a_restore_finds_epochs_after_a_change_of_the_retention,
    days_of_sessions_begin_at_different_times,
    a_parked_session_keeps_a_snapshot_a_day,
);

const MS_PER_DAY: i64 = 86_400_000;
/// 2026-01-01 12:00 UTC.
const START: i64 = (20_454 * 2 + 1) * MS_PER_DAY / 2;
/// Epochs of a device on a day: one every two minutes.
const PER_DAY: u64 = 720;
const DAYS: u64 = 6;
const RETENTION: u32 = 2;

async fn desk(store: &Store, clock: &Clock) -> Sessions {
    desk_for(store, clock, RETENTION).await
}

async fn desk_for(store: &Store, clock: &Clock, retention_days: u32) -> Sessions {
    let aiding = AidingDesk::open(store.clone(), AidingLimits::service()).await.unwrap();
    let limits = SessionLimits { retention_days, ..SessionLimits::service() };
    Sessions::open_at(store.clone(), aiding, limits, clock.clone())
}

/// Pushes the epochs of a day, in four pushes, and sets the clock to the noon of this day.
async fn live_a_day(sessions: &Sessions, clock: &Clock, id: &SessionId, day: u64) {
    clock.set(START + day as i64 * MS_PER_DAY);
    let seqs: Vec<u64> = (day * PER_DAY + 1..=(day + 1) * PER_DAY).collect();
    for seqs in seqs.chunks(PER_DAY as usize / 4) {
        let epochs = seqs.iter().map(|seq| epoch(*seq, *seq as f64)).collect();
        let submitted = sessions.submit(id, epochs).await.unwrap();
        assert!(submitted.outcomes.iter().all(|outcome| outcome.result.is_ok()));
    }
}

async fn outcome(sessions: &Sessions, id: &SessionId, epoch: SequencedEpoch) -> EpochOutcome {
    sessions.submit(id, vec![epoch]).await.unwrap().outcomes.remove(0)
}

fn refusal(outcome: &EpochOutcome) -> &'static str {
    outcome.result.as_ref().unwrap_err().code().name()
}

/// Three devices for six days, with a retention of two days. After the third day as many epochs are
/// removed as arrive. The remaining ones can be listed and replayed, also after a restart.
async fn a_store_with_retention_stays_flat(database: Database) {
    let (store, clock) = (database.store().await, Clock::at(START));
    let sessions = desk(&store, &clock).await;
    let mut devices = Vec::new();
    for _ in 0..3 {
        devices.push(sessions.create(new_session()).await.unwrap().id);
    }
    let (mut rows, mut sizes) = (Vec::new(), Vec::new());
    for day in 0..DAYS {
        for id in &devices {
            live_a_day(&sessions, &clock, id, day).await;
        }
        sessions.remove_expired().await.unwrap();
        rows.push(database.count("epochs").await + database.count("revisions").await);
        sizes.push(database.bytes().await);
    }
    println!("rows {rows:?}, bytes {sizes:?}");
    let per_day = 3 * PER_DAY as i64;
    // Epochs from a snapshot of the previous day on are kept, so that the oldest day can be
    // replayed.
    let kept = (i64::from(RETENTION) + 2) * per_day;
    assert!(per_day * i64::from(RETENTION) < rows[5] && rows[5] < kept, "{rows:?}");
    assert_eq!(rows[4], rows[5], "{rows:?}");
    // A server frees the space of rows when it vacuums.
    if database.url.starts_with("sqlite") {
        let ((used, _), (used_after, file_after)) = (sizes[4], sizes[5]);
        assert!(used_after < used * 11 / 10, "{sizes:?}");
        assert!(file_after * 3 <= used_after * 4, "at most a quarter is free: {sizes:?}");
    }

    let id = &devices[0];
    let oldest = sessions.get(id).await.unwrap().oldest_available.unwrap();
    assert!(1 < oldest && oldest <= (DAYS - u64::from(RETENTION)) * PER_DAY, "{oldest}");
    let restarted = desk(&store, &clock).await;
    for sessions in [&sessions, &restarted] {
        let listed = sessions.solutions(id, &whole_session()).await.unwrap();
        assert_eq!(listed.oldest_available, Some(oldest));
        assert_eq!(listed.page.items[0].seq, oldest);
        let solution = listed.page.items[0].clone();

        let removed = outcome(sessions, id, epoch(oldest - 1, (oldest - 1) as f64)).await;
        assert_eq!(refusal(&removed), "ALREADY_ACKNOWLEDGED");
        let other = outcome(sessions, id, epoch(1, 7e5)).await;
        assert_eq!(refusal(&other), "ALREADY_ACKNOWLEDGED", "a number is never used again");
        for seq in [oldest, oldest + 1, DAYS * PER_DAY] {
            let resent = outcome(sessions, id, epoch(seq, seq as f64)).await.result.unwrap();
            assert!(resent.resent && resent.solution.seq == seq);
            assert!(seq != oldest || resent.solution == solution);
        }
        let conflict = outcome(sessions, id, epoch(oldest + 1, 7e5)).await;
        assert_eq!(refusal(&conflict), "SEQUENCE_CONFLICT");
    }
    let aiding = AidingDesk::open(store.clone(), AidingLimits::service()).await.unwrap();
    let again = Recomputation::open(store, aiding, id, None).await.unwrap();
    assert_eq!(again.began_after(), Some(oldest - 1));
    let check = again.check().await.unwrap();
    assert!(check.is_same(), "{check:?}");
    assert_eq!(check.compared as u64, DAYS * PER_DAY + 1 - oldest);
    assert_eq!(check.began_after, Some(oldest - 1));
    let next = DAYS * PER_DAY + 1;
    assert!(outcome(&restarted, id, epoch(next, next as f64)).await.result.is_ok());

    for id in &devices {
        restarted.close(id).await.unwrap();
    }
    clock.set(START + 30 * MS_PER_DAY);
    restarted.remove_expired().await.unwrap();
    assert_eq!(database.count("epochs").await, 0);
    if database.url.starts_with("sqlite") {
        let (used, file) = database.bytes().await;
        assert!(file * 3 <= used * 4, "{file} bytes, of which {used} are used");
    }
}

/// Days of the log in the partitions of `table`.
async fn days(database: &Database, table: &str) -> i64 {
    let partitions = "pg_inherits JOIN pg_class c ON c.oid = inhrelid \
                      WHERE relname ~ '_[0-9]{8}$' AND relnamespace = current_schema()::regnamespace";
    database.count(&format!("{partitions} AND inhparent = '{table}'::regclass")).await
}

/// A day is older than the service's retention. Epochs of a session that keeps them for longer are
/// moved, and the partition is dropped.
#[tokio::test]
async fn days_are_dropped_and_what_is_kept_is_moved() {
    on_postgres(async |database| {
        let (store, clock) = (database.store().await, Clock::at(START));
        let sessions = desk(&store, &clock).await;
        let short = sessions.create(new_session()).await.unwrap().id;
        let for_ever = NewSession { retention_days: Some(0), ..new_session() };
        let long = sessions.create(for_ever).await.unwrap().id;
        let mut counts = Vec::new();
        for day in 0..9 {
            live_a_day(&sessions, &clock, &short, day).await;
            live_a_day(&sessions, &clock, &long, day).await;
            if day == 0 {
                // Imitates a revision that was stored on two days.
                for (day, seq) in [("NULL", 3), ("DATE '2026-01-01'", 3), ("NULL", 4)] {
                    let revision = format!(
                        "INSERT INTO revisions (session, seq, revision, gps_time_ns, day, status, \
                         origin, content) SELECT session, seq, 1, gps_time_ns, {day}, status, \
                         origin, solution FROM epochs WHERE seq = {seq} AND session = 2"
                    );
                    database.execute(&revision).await;
                }
            }
            sessions.remove_expired().await.unwrap();
            counts.push(days(&database, "epochs").await);
        }
        // Two days of retention, one that a snapshot may reach back, a margin of two, and today.
        assert_eq!(counts, [1, 2, 3, 4, 5, 5, 5, 5, 5]);
        let kept = database.count("epochs_kept").await;
        assert_eq!(kept, 4 * PER_DAY as i64, "only what is kept for ever is moved");
        assert_eq!(database.count("revisions_kept").await, 2);
        let listed = sessions.solutions(&long, &whole_session()).await.unwrap().page.items;
        let keys = listed.iter().map(|solution| (solution.seq, solution.revision));
        let first = [(1, 0), (2, 0), (3, 0), (3, 1), (4, 0), (4, 1), (5, 0)];
        assert_eq!(keys.take(first.len()).collect::<Vec<_>>(), first);
        assert_eq!(listed.len() as u64, 9 * PER_DAY + 2);
        database.execute("DELETE FROM revisions").await;
        for id in [&long, &short] {
            let aiding = AidingDesk::open(store.clone(), AidingLimits::service()).await.unwrap();
            let again = Recomputation::open(store.clone(), aiding, id, None).await.unwrap();
            let check = again.check().await.unwrap();
            assert!(check.is_same() && 0 < check.compared, "{check:?}");
        }
        for id in [&long, &short] {
            sessions.close(id).await.unwrap();
        }
        let update = "UPDATE sessions SET retention_days = NULL";
        database.execute(update).await;
        clock.set(START + 60 * MS_PER_DAY);
        sessions.remove_expired().await.unwrap();
        sessions.remove_expired().await.unwrap();
        assert_eq!(days(&database, "epochs").await + days(&database, "revisions").await, 0);
    })
    .await;
}

/// With a retention of 90 days three days have a partition. It is dropped once all of them are
/// older, and what is kept longer is then moved.
#[tokio::test]
async fn a_long_retention_has_partitions_of_several_days() {
    on_postgres(async |database| {
        let (store, clock) = (database.store().await, Clock::at(START));
        let sessions = desk_for(&store, &clock, 90).await;
        let id = sessions.create(new_session()).await.unwrap().id;
        let mut counts = Vec::new();
        for day in 0..6 {
            live_a_day(&sessions, &clock, &id, day).await;
            counts.push(days(&database, "epochs").await);
        }
        assert_eq!(counts, [1, 1, 1, 2, 2, 2]);
        // The session's oldest snapshots expire, and with them all before the last day's first.
        for (day, partitions, moved) in
            [(89, 2, false), (96, 1, false), (97, 1, false), (98, 0, true)]
        {
            clock.set(START + day * MS_PER_DAY);
            sessions.remove_expired().await.unwrap();
            assert_eq!(days(&database, "epochs").await, partitions, "day {day}");
            assert_eq!(0 < database.count("epochs_kept").await, moved, "day {day}");
        }
        let listed = sessions.solutions(&id, &whole_session()).await.unwrap().page.items;
        assert!(!listed.is_empty() && listed.iter().all(|solution| 5 * PER_DAY < solution.seq));
    })
    .await;
}

/// A session's own retention replaces the service's, also after a change.
async fn a_session_has_its_own_retention(database: Database) {
    let (store, clock) = (database.store().await, Clock::at(START));
    let sessions = desk(&store, &clock).await;
    let mut devices = Vec::new();
    for retention_days in [Some(0), Some(1), Some(4)] {
        let new = NewSession { retention_days, ..new_session() };
        devices.push(sessions.create(new).await.unwrap().id);
    }
    let oldest = async |id: &SessionId| sessions.get(id).await.unwrap().oldest_available;
    for day in 0..4 {
        for id in &devices {
            live_a_day(&sessions, &clock, id, day).await;
        }
    }
    sessions.remove_expired().await.unwrap();
    assert_eq!(oldest(&devices[0]).await, None);
    assert!(PER_DAY < oldest(&devices[1]).await.unwrap());
    assert_eq!(oldest(&devices[2]).await, None);
    let update = |days| graphfix::session::SessionUpdate {
        retention_days: Some(days),
        ..Default::default()
    };
    assert_eq!(sessions.update(&devices[2], update(1)).await.unwrap().retention_days, 1);
    sessions.remove_expired().await.unwrap();
    assert_eq!(oldest(&devices[2]).await, oldest(&devices[1]).await);
    let refused = sessions.update(&devices[2], update(36_501)).await.unwrap_err();
    assert_eq!(refused.code().name(), "INVALID_FIELD");
}

/// A closed session need not be replayed, so all its epochs expire.
async fn a_closed_session_expires(database: Database) {
    let (store, clock) = (database.store().await, Clock::at(START));
    let sessions = desk(&store, &clock).await;
    let id = sessions.create(new_session()).await.unwrap().id;
    let epochs = (1..=40).map(|seq| epoch(seq, seq as f64)).collect();
    sessions.submit(&id, epochs).await.unwrap();
    sessions.close(&id).await.unwrap();
    for (days, left) in [(2, 40), (3, 0)] {
        clock.set(START + days * MS_PER_DAY);
        sessions.remove_expired().await.unwrap();
        assert_eq!(database.count("epochs").await, left, "after {days} days");
    }
    let emptied = database.count("sessions WHERE emptied = 1").await;
    assert_eq!(emptied, 1, "the next removal looks at it again");
    let listed = sessions.solutions(&id, &whole_session()).await.unwrap();
    assert_eq!((listed.page.items.len(), listed.oldest_available), (0, Some(41)));
    for table in ["revisions", "snapshots", "kept_snapshots"] {
        assert_eq!(database.count(table).await, 0, "{table}");
    }
    let aiding = AidingDesk::open(store.clone(), AidingLimits::service()).await.unwrap();
    let check = Recomputation::open(store, aiding, &id, None).await.unwrap().check().await.unwrap();
    assert!(check.is_same() && check.compared == 0, "{check:?}");
}

/// After an upgrade no session is noted as emptied. The removal finds a hundred at once, and ends.
async fn closed_sessions_of_which_nothing_is_left_are_noted_once(database: Database) {
    const CLOSED: i64 = 230;
    let (store, clock) = (database.store().await, Clock::at(START));
    let sessions = desk(&store, &clock).await;
    for number in 0..CLOSED {
        let retention_days = (number % 2 == 0).then_some(1);
        let new = NewSession { retention_days, ..new_session() };
        let id = sessions.create(new).await.unwrap().id;
        if number % 10 == 0 {
            sessions.submit(&id, vec![epoch(1, 1.0)]).await.unwrap();
        }
        sessions.close(&id).await.unwrap();
    }
    let emptied = async || database.count("sessions WHERE emptied = 1").await;
    clock.set(START + MS_PER_DAY);
    sessions.remove_expired().await.unwrap();
    assert_eq!((emptied().await, database.count("epochs").await), (0, 23), "too early");
    clock.set(START + 3 * MS_PER_DAY);
    for _ in 0..2 {
        sessions.remove_expired().await.unwrap();
        assert_eq!(emptied().await, CLOSED);
        for table in ["epochs", "snapshots", "kept_snapshots"] {
            assert_eq!(database.count(table).await, 0, "{table}");
        }
        database.execute("UPDATE sessions SET emptied = 0").await;
    }
}

/// The removal of one session fails; that of others, and of the history, goes on.
async fn a_session_that_cannot_be_removed_delays_no_other(database: Database) {
    let (store, clock) = (database.store().await, Clock::at(START));
    let aiding = AidingDesk::open(store.clone(), AidingLimits::service()).await.unwrap();
    let limits =
        SessionLimits { retention_days: RETENTION, history_days: 1, ..SessionLimits::service() };
    let sessions = Sessions::open_at(store, aiding, limits, clock.clone());
    for _ in 0..3 {
        let id = sessions.create(new_session()).await.unwrap().id;
        sessions.submit(&id, vec![epoch(1, 1.0)]).await.unwrap();
        sessions.close(&id).await.unwrap();
    }
    let failing = match database.url.starts_with("sqlite") {
        true => "BEGIN SELECT RAISE(ABORT, 'on purpose'); END",
        false => {
            let function = "CREATE FUNCTION refuse() RETURNS trigger LANGUAGE plpgsql AS \
                            $$ BEGIN RAISE 'on purpose'; END $$";
            database.execute(function).await;
            "EXECUTE FUNCTION refuse()"
        }
    };
    let condition = "FOR EACH ROW WHEN (NEW.key = 1)";
    let trigger = "CREATE TRIGGER failing BEFORE UPDATE OF emptied ON sessions";
    database.execute(&format!("{trigger} {condition} {failing}")).await;
    clock.set(START + 3 * MS_PER_DAY);
    let error = sessions.remove_expired().await.unwrap_err();
    assert_eq!(error.code().name(), "DATABASE_FAILED");
    assert_eq!(database.count("sessions WHERE emptied = 1").await, 2);
    assert_eq!(database.count("rollups WHERE seconds = 3600").await, 0);
}

/// A minute gets epochs beyond the retention while it is removed, and stays.
#[tokio::test]
async fn a_minute_that_goes_on_is_not_removed() {
    on_postgres(async |database| {
        let (store, clock) = (database.store().await, Clock::at(START));
        let sessions = desk(&store, &clock).await;
        let id = sessions.create(new_session()).await.unwrap().id;
        sessions.submit(&id, vec![epoch(1, 1.0)]).await.unwrap();
        sessions.close(&id).await.unwrap();
        clock.set(START + 3 * MS_PER_DAY);
        let mut other = PgConnection::connect(&database.url).await.unwrap();
        let mut commit = other.begin().await.unwrap();
        let later = sqlx::query("UPDATE rollups SET last_seq = 2 WHERE seconds = 60");
        assert_eq!(later.execute(&mut *commit).await.unwrap().rows_affected(), 1);
        let blocked = async || {
            let waiting = "pg_stat_activity WHERE wait_event_type = 'Lock' \
                           AND starts_with(query, 'DELETE FROM rollups')";
            database.count(waiting).await
        };
        let committing = async {
            until("the removal waits", blocked, |count| 0 < *count).await;
            commit.commit().await.unwrap();
        };
        let (removed, ()) = tokio::join!(sessions.remove_expired(), committing);
        removed.unwrap();
        assert_eq!(database.count("rollups WHERE seconds = 60").await, 1);
    })
    .await;
}

/// A snapshot of another version cannot be read. A replay then begins at the snapshot of the next
/// day. Without a readable snapshot it is refused with its code.
async fn a_replay_needs_a_readable_snapshot(database: Database) {
    let (store, clock) = (database.store().await, Clock::at(START));
    let sessions = desk(&store, &clock).await;
    let id = sessions.create(new_session()).await.unwrap().id;
    for day in 0..5 {
        live_a_day(&sessions, &clock, &id, day).await;
    }
    sessions.remove_expired().await.unwrap();
    let oldest = sessions.get(&id).await.unwrap().oldest_available.unwrap();
    let aiding = AidingDesk::open(store.clone(), AidingLimits::service()).await.unwrap();
    let open = async || Recomputation::open(store.clone(), aiding.clone(), &id, None).await;
    assert_eq!(open().await.unwrap().began_after(), Some(oldest - 1));
    let byte = if database.url.starts_with("sqlite") { "x'ff'" } else { "'\\xff'" };
    let damage = format!("UPDATE kept_snapshots SET content = {byte}");
    database.execute(&format!("{damage} WHERE seq < {oldest}")).await;
    let later = open().await.unwrap();
    assert!(Some(oldest) < later.began_after());
    let check = later.check().await.unwrap();
    assert!(check.is_same() && 0 < check.compared, "{check:?}");
    database.execute(&damage).await;
    let refused = open().await.map(|_| ()).unwrap_err();
    assert_eq!(refused.code().name(), "REPLAY_START_MISSING");
}

/// The REST door accepts the option, checks it, and shows the retention in force.
#[tokio::test]
async fn retention_is_an_option_of_a_session() {
    let doors = Doors::open().await;
    let (status, session) = doors.post("/v1/sessions", json!({"retentionDays": 3})).await;
    assert_eq!((status, &session["retentionDays"]), (StatusCode::CREATED, &json!(3)));
    assert_eq!(session["oldestAvailableSeq"], json!(null));
    let path = format!("/v1/sessions/{}", session["session"].as_str().unwrap());
    let (status, session) = doors.send("PATCH", &path, json!({"retentionDays": 0})).await;
    assert_eq!((status, &session["retentionDays"]), (StatusCode::OK, &json!(0)));
    let (status, refused) = doors.post("/v1/sessions", json!({"retentionDays": 36_501})).await;
    assert_eq!((status, code(&refused)), (StatusCode::BAD_REQUEST, "INVALID_FIELD"));
    assert_eq!(refused["field"], json!("retentionDays"));
}

/// A clock that is set years ahead removes nothing, neither at once nor at a restart, until a
/// device sends an epoch of that time. Time that really passes is still counted.
async fn a_step_of_the_clock_removes_nothing(database: Database) {
    let (store, clock) = (database.store().await, Clock::at(START));
    let sessions = desk(&store, &clock).await;
    let id = sessions.create(new_session()).await.unwrap().id;
    for day in 0..3 {
        live_a_day(&sessions, &clock, &id, day).await;
        sessions.remove_expired().await.unwrap();
    }
    assert_eq!(sessions.clock_ahead(), None);
    let kept = database.count("epochs").await;
    let wrong = START + 1_000 * MS_PER_DAY;
    clock.step(wrong);
    let restarted = desk(&store, &clock).await;
    for sessions in [&sessions, &restarted] {
        sessions.remove_expired().await.unwrap();
        assert_eq!(database.count("epochs").await, kept);
        let ahead_days = sessions.clock_ahead().unwrap().as_secs_f64() / 86_400.0;
        assert!((997.9..998.1).contains(&ahead_days), "{ahead_days}");
    }
    let oldest = async || sessions.get(&id).await.unwrap().oldest_available;
    assert_eq!(oldest().await, None);
    // The first snapshot that is kept is of the second day.
    let later = wrong + 2 * MS_PER_DAY;
    clock.set(later);
    restarted.remove_expired().await.unwrap();
    let after_two_days = oldest().await.unwrap();
    assert!((2..2 * PER_DAY).contains(&after_two_days), "{after_two_days}");

    let present = sessions.create(new_session()).await.unwrap().id;
    let since_week_2051_s = later / 1_000 - 315_964_800 - 2_051 * 604_800;
    let live = outcome(&sessions, &present, epoch(1, since_week_2051_s as f64)).await;
    assert!(live.result.is_ok(), "{live:?}");
    restarted.remove_expired().await.unwrap();
    assert_eq!(restarted.clock_ahead(), None);
    assert!(2 * PER_DAY < oldest().await.unwrap());
}

/// A clock that is half a year behind for a while, as of a machine without a battery, costs nothing
/// of a session that is closed meanwhile.
async fn what_a_slow_clock_closes_is_kept(database: Database) {
    let (store, clock) = (database.store().await, Clock::at(START));
    let sessions = desk(&store, &clock).await;
    let [before, meanwhile] = [sessions.create(new_session()), sessions.create(new_session())];
    let (before, meanwhile) = (before.await.unwrap().id, meanwhile.await.unwrap().id);
    let epochs = || (1..=40).map(|seq| epoch(seq, seq as f64)).collect();
    sessions.submit(&before, epochs()).await.unwrap();
    sessions.remove_expired().await.unwrap();
    store.close().await;
    clock.step(START - 180 * MS_PER_DAY);
    let store = database.store().await;
    let sessions = desk(&store, &clock).await;
    sessions.submit(&meanwhile, epochs()).await.unwrap();
    for id in [&before, &meanwhile] {
        sessions.close(id).await.unwrap();
    }
    sessions.remove_expired().await.unwrap();
    for (days, left) in [(0, 80), (2, 80), (3, 0)] {
        clock.set(START + days * MS_PER_DAY);
        sessions.remove_expired().await.unwrap();
        assert_eq!(database.count("epochs").await, left, "after {days} days");
    }
}

/// A session's state is stored on one day, and the clock is then set three days back. What arrives
/// then is of the day by which ages are counted, so that it is not removed three days too early.
/// On Postgres a restore reads only the partitions since the state was stored, and finds all.
async fn a_restore_finds_epochs_of_earlier_days(database: Database) {
    // Ten days after the epochs, which may not be of the future.
    let now = START + 10 * MS_PER_DAY;
    let (store, clock) = (database.store().await, Clock::at(now));
    let scenario = Scenario { base: None, duration_s: 340.0, ..Scenario::open_sky() };
    let simulator = Simulator::new(scenario, 3);
    let aiding = AidingDesk::open(store.clone(), AidingLimits::service()).await.unwrap();
    let navigation = Navigation::clone(simulator.navigation());
    aiding.navigation.push(navigation, "simulation").await.unwrap();
    let rover = simulator.enumerate();
    let mut epochs =
        rover.map(|(k, epoch)| SequencedEpoch { seq: k as u64 + 1, epoch: epoch.rover });
    let desk = || {
        let limits = SessionLimits::service();
        Sessions::open_at(store.clone(), aiding.clone(), limits, clock.clone())
    };
    let sessions = desk();
    sessions.remove_expired().await.unwrap();
    // With a retention, a state is stored on each new day anyway.
    let retention_days = Some(0);
    let session = NewSession { mode: "ekf".to_owned(), retention_days, ..new_session() };
    let id = sessions.create(session).await.unwrap().id;
    // With a retention of 90 days, three days have a partition.
    let since = |day: i64| format!("snapshots WHERE since_day = {}", day - day % 3);
    let today = now / MS_PER_DAY;
    for (days_back, count, stored_back) in [(0, 300, 0), (3, 2, 0), (3, 2, 0), (0, 2, 0)] {
        clock.step(now - days_back * MS_PER_DAY);
        let pushed = epochs.by_ref().take(count).collect();
        let submitted = sessions.submit(&id, pushed).await.unwrap();
        let refused = submitted.outcomes.iter().find(|outcome| outcome.result.is_err());
        assert!(refused.is_none(), "{refused:?}");
        let through = submitted.durable_through;
        assert_eq!(database.count(&since(today - stored_back)).await, 1, "{through:?}");
    }
    // As after a crash: the first desk stores nothing more.
    let next = outcome(&desk(), &id, epochs.next().unwrap()).await.result.unwrap();
    assert_eq!(next.solution.seq, 307);
    let check = Recomputation::open(store, aiding, &id, None).await.unwrap().check().await.unwrap();
    assert!(check.is_same() && 307 <= check.compared, "{check:?}");
}

/// Epochs that are kept for ever are in partitions of thirty days, others in partitions of fewer. A
/// state is stored with the first day of the shorter ones. When the service's retention becomes
/// longer, it is stored again, so that a restore finds the epochs since.
async fn a_restore_finds_epochs_after_a_change_of_the_retention(database: Database) {
    let (store, clock) = (database.store().await, Clock::at(START + 10 * MS_PER_DAY));
    let sessions = desk_for(&store, &clock, 90).await;
    let id = sessions.create(new_session()).await.unwrap().id;
    let push = async |sessions: &Sessions, seqs: std::ops::RangeInclusive<u64>| {
        let epochs = seqs.map(|seq| epoch(seq, seq as f64)).collect();
        let submitted = sessions.submit(&id, epochs).await.unwrap();
        assert!(submitted.outcomes.iter().all(|outcome| outcome.result.is_ok()));
    };
    push(&sessions, 1..=300).await;
    // Day 20,464 is the second of three, and the fifth of thirty.
    for (retention, seq, first_day) in [(90, 301, 20_463), (0, 302, 20_460), (90, 303, 20_460)] {
        let sessions = desk_for(&store, &clock, retention).await;
        push(&sessions, seq..=seq).await;
        let stored = database.count(&format!("snapshots WHERE since_day = {first_day}")).await;
        assert_eq!(stored, 1, "after epoch {seq}");
    }
    let sessions = desk_for(&store, &clock, 90).await;
    push(&sessions, 304..=304).await;
    let aiding = AidingDesk::open(store.clone(), AidingLimits::service()).await.unwrap();
    let check = Recomputation::open(store, aiding, &id, None).await.unwrap().check().await.unwrap();
    assert!(check.is_same() && 304 <= check.compared, "{check:?}");
}

/// Forty devices send an epoch an hour. Each keeps a snapshot a day, and not all keep it after
/// midnight.
async fn days_of_sessions_begin_at_different_times(database: Database) {
    let (store, clock) = (database.store().await, Clock::at(START));
    let sessions = desk(&store, &clock).await;
    let mut ids = Vec::new();
    for _ in 0..40 {
        let id = sessions.create(new_session()).await.unwrap().id;
        // As many as a session sends before it stores its state.
        let epochs = (1..=256).map(|seq| epoch(seq, seq as f64)).collect();
        sessions.submit(&id, epochs).await.unwrap();
        ids.push(id);
    }
    let mut kept = vec![database.count("kept_snapshots").await];
    // All of a new session can be replayed from its beginning.
    assert_eq!(kept, [0]);
    for hour in 1..=24 {
        clock.set(START + hour * MS_PER_DAY / 24);
        for id in &ids {
            let seq = 256 + hour as u64;
            assert!(outcome(&sessions, id, epoch(seq, seq as f64)).await.result.is_ok());
        }
        kept.push(database.count("kept_snapshots").await);
    }
    let most = kept.windows(2).map(|counts| counts[1] - counts[0]).max();
    assert!(most <= Some(10), "{kept:?}");
    assert_eq!(kept.last(), Some(&40), "{kept:?}");
}

/// A session is parked after each push. It knows afterwards for which day it has kept a snapshot.
async fn a_parked_session_keeps_a_snapshot_a_day(database: Database) {
    let (store, clock) = (database.store().await, Clock::at(START));
    let aiding = AidingDesk::open(store.clone(), AidingLimits::service()).await.unwrap();
    let limits =
        SessionLimits { retention_days: RETENTION, active_sessions: 1, ..SessionLimits::service() };
    let sessions = Sessions::open_at(store, aiding, limits, clock.clone());
    let id = sessions.create(new_session()).await.unwrap().id;
    let other = sessions.create(new_session()).await.unwrap().id;
    for push in 0..4 {
        // As many as a session sends before it stores its state.
        let epochs = (1..=256).map(|seq| 256 * push + seq).map(|seq| epoch(seq, seq as f64));
        sessions.submit(&id, epochs.collect()).await.unwrap();
        assert!(outcome(&sessions, &other, epoch(push + 1, push as f64)).await.result.is_ok());
    }
    // All of a new session can be replayed from its beginning.
    assert_eq!(database.count("kept_snapshots").await, 0);
}
