//! Bases and the sessions that name them, on both databases.

use std::collections::BTreeMap;

use graphfix::aiding::bases::{BaseChoice, BaseId, BaseInfo, BasePositionVerdict, NewBase};
use graphfix::aiding::{AidingDesk, AidingLimits};
use graphfix::config::Mode;
use graphfix::contract::{calls, v1};
use graphfix::gnss::{BaseSite, Epoch, PositionSource, Reason, Solution, Status};
use graphfix::session::{
    Burst, Check, NewSession, Recomputation, SequencedEpoch, SessionId, SessionLimits,
    SessionUpdate, Sessions, SolveRequest,
};
use graphfix::store::StoredSolution;
use sqlx::{Connection, PgConnection};

use crate::support::database::{Database, on_both_databases, on_postgres, whole_session};
use crate::support::doors::Doors;
use crate::support::pair::PAIR;
use crate::support::sessions::epoch;
use crate::support::wait::until;

on_both_databases!(
    a_session_answers_as_solve_does,
    a_base_in_step_gives_the_same_bits_after_restarts,
    without_its_base_a_session_says_why,
    a_base_in_the_wrong_place_is_refused_or_doubted,
    a_bases_epochs_keep_their_order,
    a_long_push_is_stored_in_steps,
    the_epochs_of_a_deleted_base_are_removed_in_the_background,
    what_a_base_holds_is_bounded,
    a_base_in_use_stays,
    a_base_that_is_deleted_meanwhile_is_not_found,
    a_session_may_change_its_base,
    a_base_may_move,
    a_base_serves_positions_on_request,
    forgotten_base_epochs_are_said,
);

/// The desks of a service, as it opens them at its start.
struct Desk {
    aiding: AidingDesk,
    sessions: Sessions,
}

async fn desk(database: &Database) -> Desk {
    desk_with(database, AidingLimits::service()).await
}

async fn desk_with(database: &Database, limits: AidingLimits) -> Desk {
    let store = database.store().await;
    let aiding = AidingDesk::open(store.clone(), limits).await.unwrap();
    let limits = SessionLimits { active_sessions: 1, ..SessionLimits::service() };
    Desk { sessions: Sessions::open(store, aiding.clone(), limits), aiding }
}

fn id_of(info: &BaseInfo) -> BaseId {
    BaseId::parse(&info.name.id).unwrap()
}

impl Desk {
    async fn navigate(&self) {
        self.aiding.navigation.push(PAIR.navigation.clone(), "test").await.unwrap();
    }

    async fn base(&self) -> BaseId {
        id_of(&self.aiding.bases.create(PAIR.new_base(0.0)).await.unwrap())
    }

    async fn push(&self, base: &BaseId, epochs: &[Epoch]) {
        let push = self.aiding.bases.push(base, epochs.to_vec()).await.unwrap();
        assert!(push.outcomes.iter().all(Result::is_ok));
    }

    async fn session(&self, base: &BaseId) -> SessionId {
        self.sessions.create(new_session("rtk-fgo", Some(base))).await.unwrap().id
    }

    async fn submit(&self, id: &SessionId, epochs: &[SequencedEpoch]) -> Vec<Solution> {
        let answer = self.sessions.submit(id, epochs.to_vec()).await.unwrap();
        let solution =
            |outcome: graphfix::session::EpochOutcome| outcome.result.unwrap().solution.solution;
        answer.outcomes.into_iter().map(solution).collect()
    }

    async fn listed(&self, id: &SessionId) -> Vec<StoredSolution> {
        self.sessions.solutions(id, &whole_session()).await.unwrap().page.items
    }
}

fn new_session(mode: &str, base: Option<&BaseId>) -> NewSession {
    NewSession {
        label: String::new(),
        mode: mode.to_owned(),
        profile: "general".to_owned(),
        overrides: BTreeMap::new(),
        base: base.cloned().into(),
        antenna: String::new(),
        retention_days: None,
    }
}

async fn checked(database: &Database, id: &SessionId) -> Result<Check, String> {
    let store = database.store().await;
    let aiding = AidingDesk::open(store.clone(), AidingLimits::service()).await.unwrap();
    let again = Recomputation::open(store, aiding, id, None).await.unwrap();
    again.check().await.map_err(|error| error.code().name().to_owned())
}

fn codes(solution: &Solution) -> Vec<&'static str> {
    solution.reasons.iter().map(Reason::code).collect()
}

/// In every mode that is relative to a base: all base epochs of a file first, then the rover's.
async fn a_session_answers_as_solve_does(database: Database) {
    let desk = desk(&database).await;
    desk.navigate().await;
    let base = desk.base().await;
    desk.push(&base, &PAIR.base).await;
    for mode in Mode::ALL.iter().filter(|mode| mode.is_relative()) {
        let new = new_session(mode.name(), Some(&base));
        let session = desk.sessions.create(new).await.unwrap().id;
        let mut answers = Vec::new();
        for batch in PAIR.rover.chunks(40) {
            answers.extend(desk.submit(&session, batch).await);
        }
        let expected = PAIR.solved(*mode, &base);
        assert_eq!(answers, expected, "{mode:?}");
        let fixed = answers.iter().filter(|s| s.status == Status::Fixed).count();
        assert!(100 < fixed, "{mode:?}: {fixed} of {} fixed", answers.len());
        let used = answers[100].provenance.base.as_ref().unwrap();
        assert_eq!((&*used.base, used.time), (base.as_str(), PAIR.base[100].time));
    }
    let info = desk.aiding.bases.get(&base).await.unwrap();
    let (first, last) = (PAIR.base[0].time, PAIR.base.last().unwrap().time);
    assert_eq!((info.epochs, info.span), (PAIR.base.len(), Some((first, last))));
    assert_eq!((info.check.verdict(), info.check.epochs), (BasePositionVerdict::Agrees, 10));
    assert!(info.check.distance_m().unwrap() < 10.0 && 10 < info.satellites);
}

/// Base epochs arrive in bursts, some early, some late; each rover epoch is solved with the
/// received ones. Restarts after each batch change nothing, and replay gives the same bits.
async fn a_base_in_step_gives_the_same_bits_after_restarts(database: Database) {
    let steady = desk(&database).await;
    steady.navigate().await;
    let base = steady.base().await;
    let (whole, restarted) = (steady.session(&base).await, steady.session(&base).await);
    let mut base_epochs = PAIR.base.iter();
    for (index, batch) in PAIR.rover.chunks(7).enumerate() {
        let burst: Vec<Epoch> =
            base_epochs.by_ref().take([3, 11, 0, 14][index % 4]).cloned().collect();
        steady.push(&base, &burst).await;
        steady.submit(&whole, batch).await;
        desk(&database).await.submit(&restarted, batch).await;
    }
    let (expected, other) = (steady.listed(&whole).await, steady.listed(&restarted).await);
    let (first, revised): (Vec<_>, Vec<_>) = expected.iter().partition(|s| s.revision == 0);
    assert_eq!(first.len(), PAIR.rover.len());
    assert!(120 < revised.len() && revised.len() < first.len(), "{} revised", revised.len());
    assert_eq!(format!("{expected:?}"), format!("{other:?}"));
    let ages =
        |s: &StoredSolution| s.solution.estimate.as_ref()?.relative.as_ref().map(|r| r.age_s);
    let late = first.iter().copied().filter_map(ages).filter(|age_s| 1.0 < *age_s).count();
    assert!(10 < late && late < 140, "{late} with an old base epoch");
    // Early epochs were also solved with the base epochs received by then, although more are stored
    // now.
    for id in [&whole, &restarted] {
        let same = Check { compared: expected.len(), ..Check::default() };
        assert_eq!(checked(&database, id).await, Ok(same));
    }
}

/// Without a usable base the answers are those of a window without a base, each with its reason and
/// remedy.
async fn without_its_base_a_session_says_why(database: Database) {
    let desk = desk(&database).await;
    desk.navigate().await;
    let base = desk.base().await;
    let session = desk.session(&base).await;
    let missing = desk.submit(&session, &PAIR.rover[..10]).await;
    for solution in &missing {
        assert_eq!(codes(solution).last(), Some(&"BASE_MISSING"));
        assert_eq!(solution.provenance.base, None);
    }
    assert_eq!(missing[9].status, Status::Fgo);
    desk.push(&base, &PAIR.base[..60]).await;
    let found = desk.submit(&session, &PAIR.rover[10..60]).await;
    assert!(found.iter().all(|solution| solution.provenance.base.is_some()));
    assert_eq!(found[49].status, Status::Fixed);
    // 30 s later the last base epoch is too old.
    let stale = desk.submit(&session, &PAIR.rover[60..100]).await;
    assert_eq!(stale.iter().filter(|s| s.provenance.base.is_some()).count(), 30);
    let Some(Reason::BaseStale { age_s }) = stale[39].reasons.last() else { panic!("{stale:?}") };
    assert_eq!((stale[39].status, age_s.round()), (Status::Fgo, 40.0));
    desk.push(&base, &PAIR.base[60..]).await;
    let back = desk.submit(&session, &PAIR.rover[100..]).await;
    assert!(back.iter().all(|solution| solution.provenance.base.is_some()));
}

async fn a_base_in_the_wrong_place_is_refused_or_doubted(database: Database) {
    let desk = desk(&database).await;
    let create =
        async |off_m: f64| id_of(&desk.aiding.bases.create(PAIR.new_base(off_m)).await.unwrap());
    // Without navigation data the position cannot be checked …
    let (early, unplaced) = (create(500.0).await, NewBase::default());
    desk.push(&early, &PAIR.base).await;
    let verdict = async |base: &BaseId| desk.aiding.bases.get(base).await.unwrap().check.verdict();
    assert_eq!(verdict(&early).await, BasePositionVerdict::Unchecked);
    desk.navigate().await;
    // … and it is checked when they arrive. Sessions refuse such a base themselves.
    assert_eq!(verdict(&early).await, BasePositionVerdict::Refused);
    let session = desk.session(&early).await;
    let answer = desk.submit(&session, &PAIR.rover[..5]).await.pop().unwrap();
    let Some(Reason::BasePositionDoubtful { distance_m }) = answer.reasons.last() else {
        panic!("{answer:?}")
    };
    assert!((690.0..725.0).contains(distance_m), "{distance_m}");
    assert_eq!((answer.status, answer.provenance.base), (Status::Fgo, None));
    let error = desk.aiding.bases.push(&create(500.0).await, PAIR.base.clone()).await.unwrap_err();
    assert_eq!(error.code().name(), "BASE_POSITION_REFUSED");
    let doubtful = create(40.0).await;
    let push = desk.aiding.bases.push(&doubtful, PAIR.base.clone()).await.unwrap();
    assert!((45.0..70.0).contains(&push.check.distance_m().unwrap()), "{push:?}");
    assert_eq!(verdict(&doubtful).await, BasePositionVerdict::Doubtful);
    let session = desk.session(&doubtful).await;
    let answer = desk.submit(&session, &PAIR.rover[..5]).await.pop().unwrap();
    assert!(codes(&answer).contains(&"BASE_POSITION_DOUBTFUL") && answer.provenance.base.is_some());
    let unplaced = id_of(&desk.aiding.bases.create(unplaced).await.unwrap());
    let error = desk.aiding.bases.push(&unplaced, PAIR.base.clone()).await.unwrap_err();
    assert_eq!(error.code().name(), "BASE_POSITION_MISSING");
}

async fn a_bases_epochs_keep_their_order(database: Database) {
    let steady = desk(&database).await;
    let base = steady.base().await;
    steady.push(&base, &PAIR.base[5..20]).await;
    let restarted = desk(&database).await;
    for desk in [&steady, &restarted] {
        let mut other = PAIR.base[7].clone();
        other.observations.pop();
        let sent = vec![PAIR.base[6].clone(), other, PAIR.base[3].clone()];
        let outcomes = desk.aiding.bases.push(&base, sent).await.unwrap().outcomes;
        let held = outcomes[0].as_ref().unwrap();
        assert_eq!((held.number, held.resent), (2, true));
        assert_eq!(outcomes[1].as_ref().unwrap_err().code().name(), "BASE_EPOCH_CONFLICT");
        assert_eq!(outcomes[2].as_ref().unwrap_err().code().name(), "BASE_OUT_OF_ORDER");
        assert_eq!(desk.aiding.bases.get(&base).await.unwrap().epochs, 15);
    }
    // Also within one push.
    let twice = vec![PAIR.base[20].clone(), PAIR.base[20].clone()];
    let outcomes = restarted.aiding.bases.push(&base, twice).await.unwrap().outcomes;
    assert_eq!(outcomes[0].as_ref().unwrap().number, 16);
    assert!(outcomes[1].as_ref().unwrap().resent);
    let all = desk(&database).await.aiding.bases.list().await;
    let restarted = restarted.aiding.bases.get(&base).await.unwrap();
    assert_eq!(all, [restarted]);
}

async fn what_a_base_holds_is_bounded(database: Database) {
    let most = PAIR.base.iter().map(|epoch| epoch.observations.len()).max();
    let limits = AidingLimits {
        bases: 2,
        epochs_per_base: 10,
        observations_per_epoch: most.unwrap(),
        label_characters: 5,
        ..AidingLimits::service()
    };
    let desk = desk_with(&database, limits.clone()).await;
    let base = desk.base().await;
    desk.push(&base, &PAIR.base[..6]).await;
    desk.push(&base, &PAIR.base[6..13]).await;
    let info = desk.aiding.bases.get(&base).await.unwrap();
    assert_eq!((info.epochs, info.span.unwrap().0), (10, PAIR.base[3].time));
    let error = desk.aiding.bases.push(&base, PAIR.base[20..31].to_vec()).await.unwrap_err();
    assert_eq!(error.code().name(), "BASE_TOO_LARGE");
    let mut rich = PAIR.base[40].clone();
    rich.observations.extend(PAIR.base[41].observations.clone());
    let push = desk.aiding.bases.push(&base, vec![rich]).await.unwrap();
    assert_eq!(push.outcomes[0].as_ref().unwrap_err().code().name(), "TOO_MANY_OBSERVATIONS");
    let long = NewBase { label: "a base".to_owned(), ..NewBase::default() };
    assert_eq!(desk.aiding.bases.create(long).await.unwrap_err().code().name(), "LABEL_TOO_LONG");
    desk.base().await;
    let error = desk.aiding.bases.create(PAIR.new_base(0.0)).await.unwrap_err();
    assert_eq!(error.code().name(), "TOO_MANY_BASES");
    // The limit of bytes applies to stored epochs and to those in memory.
    let few = AidingLimits { bytes_per_base: 10_000, epochs_per_base: 1_000, ..limits };
    let desk = desk_with(&database, few.clone()).await;
    desk.push(&base, &PAIR.base[13..15]).await;
    let held = desk.aiding.bases.get(&base).await.unwrap();
    assert!((2..10).contains(&held.epochs), "{}", held.epochs);
    assert_eq!(held.span.unwrap().1, PAIR.base[14].time);
    let restarted = desk_with(&database, few).await.aiding.bases.get(&base).await.unwrap();
    assert_eq!((restarted.epochs, restarted.span), (held.epochs, held.span));
}

/// A base is deleted between the check of its name and the commit of the session that names it.
async fn a_base_that_is_deleted_meanwhile_is_not_found(database: Database) {
    let desk = desk(&database).await;
    let (deleted, other) = (desk.base().await, desk.base().await);
    let session = desk.session(&other).await;
    database.execute("UPDATE bases SET deleted_unix_ms = 1 WHERE key = 1").await;
    let bases = [BaseChoice::One(deleted.clone()), BaseChoice::NearestOf(vec![other, deleted])];
    for base in bases {
        let new = NewSession { base: base.clone(), ..new_session("rtk-fgo", None) };
        let error = desk.sessions.create(new).await.unwrap_err();
        assert_eq!(error.code().name(), "BASE_NOT_FOUND");
        let update = SessionUpdate { base: Some(base), ..SessionUpdate::default() };
        let error = desk.sessions.update(&session, update).await.unwrap_err();
        assert_eq!(error.code().name(), "BASE_NOT_FOUND");
    }
    assert_eq!(database.count("sessions").await, 1);
    assert_eq!(database.count("sessions WHERE base = 2").await, 1);
}

/// The transaction that stores a session commits while the base that it names is deleted.
#[tokio::test]
async fn a_base_of_a_session_that_is_just_stored_stays() {
    on_postgres(async |database| {
        let desk = desk(&database).await;
        let base = desk.base().await;
        desk.sessions.create(new_session("spp", None)).await.unwrap();
        let mut other = PgConnection::connect(&database.url).await.unwrap();
        let mut storing = other.begin().await.unwrap();
        for sql in ["UPDATE sessions SET base = 1", "SELECT key FROM bases FOR SHARE"] {
            sqlx::query(sql).execute(&mut *storing).await.unwrap();
        }
        let blocked = async || {
            let waiting = "pg_stat_activity WHERE wait_event_type = 'Lock' \
                           AND query LIKE '%bases%'";
            database.count(waiting).await
        };
        let storing = async {
            until("the deletion waits", blocked, |count| 0 < *count).await;
            storing.commit().await.unwrap();
        };
        let (deleted, ()) = tokio::join!(desk.aiding.bases.delete(&base), storing);
        assert_eq!(deleted.unwrap_err().code().name(), "BASE_IN_USE");
    })
    .await;
}

async fn a_base_in_use_stays(database: Database) {
    let desk = desk(&database).await;
    desk.navigate().await;
    let base = desk.base().await;
    desk.push(&base, &PAIR.base[..20]).await;
    let session = desk.session(&base).await;
    desk.submit(&session, &PAIR.rover[..20]).await;
    let error = desk.aiding.bases.delete(&base).await.unwrap_err();
    assert_eq!(error.code().name(), "BASE_IN_USE");
    desk.sessions.close(&session).await.unwrap();
    assert_eq!(checked(&database, &session).await.unwrap().compared, 40);
    desk.aiding.bases.delete(&base).await.unwrap();
    for error in [
        desk.aiding.bases.get(&base).await.unwrap_err(),
        desk.aiding.bases.push(&base, Vec::new()).await.unwrap_err(),
        desk.aiding.bases.delete(&base).await.unwrap_err(),
    ] {
        assert_eq!(error.code().name(), "BASE_NOT_FOUND");
    }
    let info = desk.sessions.get(&session).await.unwrap();
    assert_eq!(info.base, BaseChoice::One(base.as_str().into()));
    assert_eq!(desk.listed(&session).await.len(), 40, "what is stored stays readable");
    assert_eq!(checked(&database, &session).await.unwrap_err(), "BASE_FORGOTTEN");
    let error = desk.sessions.create(new_session("rtk-fgo", Some(&base))).await.unwrap_err();
    assert_eq!(error.code().name(), "BASE_NOT_FOUND");
}

/// A virtual base moves while the rover sends nothing. Each base epoch keeps its position,
/// ambiguities start again with a reason, and are fixed again at the same positions. Replay gives
/// the same bits.
async fn a_base_may_move(database: Database) {
    let desk = desk(&database).await;
    desk.navigate().await;
    let (elsewhere, place) = PAIR.base_elsewhere(7_800.0);
    let moved_m = place.distance_m(PAIR.position);
    assert!((100.0..500.0).contains(&moved_m), "{moved_m}");
    let site = PAIR.new_base(0.0).site.unwrap();
    let site = BaseSite { source: PositionSource::Message, ..site };
    let new = NewBase { site: Some(site.clone()), ..PAIR.new_base(0.0) };
    let base = id_of(&desk.aiding.bases.create(new).await.unwrap());
    desk.push(&base, &PAIR.base[..70]).await;
    desk.aiding.bases.set_site(&base, &BaseSite { marker: place, ..site }).await.unwrap();
    desk.push(&base, &elsewhere[70..]).await;
    let session = desk.session(&base).await;
    let rover = [&PAIR.rover[..68], &PAIR.rover[72..]].concat();
    let mut answers = Vec::new();
    for batch in rover.chunks(40) {
        answers.extend(desk.submit(&session, batch).await);
    }
    let said: Vec<usize> =
        (0..answers.len()).filter(|at| codes(&answers[*at]).contains(&"BASE_MOVED")).collect();
    assert_eq!(said, [68]);
    let of_move = |reason: &Reason| match reason {
        Reason::BaseMoved { distance_m } => Some(*distance_m),
        _ => None,
    };
    let told_m = answers[68].reasons.iter().find_map(of_move).unwrap();
    assert!((told_m - moved_m).abs() < 1e-6, "{told_m}");
    assert_eq!(answers[68].provenance.base.as_ref().unwrap().time, PAIR.rover[72].epoch.time);
    let still = PAIR.solved(Mode::RtkFgo, &base);
    let still = [&still[..68], &still[72..]].concat();
    let both = |(a, b): &(&Solution, &Solution)| [a, b].iter().all(|s| s.status == Status::Fixed);
    let pairs: Vec<_> = answers.iter().zip(&still).skip(68).filter(both).collect();
    assert!(40 < pairs.len(), "{} fixed after the move", pairs.len());
    for (moved, still) in pairs {
        let place = |s: &Solution| s.estimate.as_ref().unwrap().position;
        let off_m = place(moved).distance_m(place(still));
        assert!(off_m < 0.05, "{off_m} m at {}", moved.time);
    }
    desk.sessions.close(&session).await.unwrap();
    assert!(checked(&database, &session).await.unwrap().is_same());
}

/// Another base restarts the estimator, like another configuration, and this is reported.
async fn a_session_may_change_its_base(database: Database) {
    let desk = desk(&database).await;
    desk.navigate().await;
    let (one, other) = (desk.base().await, desk.base().await);
    desk.push(&one, &PAIR.base).await;
    desk.push(&other, &PAIR.base).await;
    for mode in ["rtk-fgo", "fgo"] {
        let without = desk.sessions.create(new_session(mode, None)).await;
        assert_eq!(
            without.err().map(|error| error.code().name()),
            match mode {
                "fgo" => None,
                _ => Some("BASE_REQUIRED"),
            }
        );
    }
    let session = desk.session(&one).await;
    let first = desk.submit(&session, &PAIR.rover[..60]).await;
    let update =
        |base: Option<BaseId>| SessionUpdate { base: Some(base.into()), ..Default::default() };
    let error = desk.sessions.update(&session, update(None)).await.unwrap_err();
    assert_eq!(error.code().name(), "BASE_REQUIRED");
    let info = desk.sessions.update(&session, update(Some(other.clone()))).await.unwrap();
    assert_eq!(info.base, BaseChoice::One(other.as_str().into()));
    let mut second = desk.submit(&session, &PAIR.rover[60..100]).await;
    let said = second[0].reasons.iter().position(|r| matches!(r, Reason::BaseChanged { .. }));
    second[0].reasons.remove(said.unwrap());
    let fresh = desk.session(&other).await;
    assert_eq!(desk.submit(&fresh, &PAIR.rover[60..100]).await, second);
    assert_ne!(first[59].provenance.base, second[0].provenance.base);
    assert_eq!(second[0].provenance.base.as_ref().unwrap().base, other.as_str());
    let spp = SessionUpdate { mode: Some("spp".to_owned()), ..update(None) };
    desk.sessions.update(&session, spp).await.unwrap();
    desk.submit(&session, &PAIR.rover[100..]).await;
    assert!(checked(&database, &session).await.unwrap().is_same());
}

async fn a_base_serves_positions_on_request(database: Database) {
    let desk = desk(&database).await;
    desk.navigate().await;
    let base = desk.base().await;
    desk.push(&base, &PAIR.base).await;
    let points = desk.sessions.create(new_session("spp", None)).await.unwrap().id;
    desk.submit(&points, &PAIR.rover[..60]).await;
    let mode = Some("rtk-fgo".to_owned());
    let request =
        SolveRequest { mode, base: BaseChoice::One(base.clone()), ..SolveRequest::default() };
    let solved = desk.sessions.solve(&points, &request).await.unwrap();
    assert_eq!((solved.seq, solved.solution.status), (60, Status::Fixed));
    let without = SolveRequest { base: BaseChoice::None, ..request };
    let error = desk.sessions.solve(&points, &without).await.unwrap_err();
    assert_eq!(error.code().name(), "BASE_REQUIRED");
    let burst = Burst {
        mode: "rtk-fgo".to_owned(),
        profile: "general".to_owned(),
        overrides: BTreeMap::new(),
        epochs: PAIR.rover[..60].to_vec(),
        navigation: None,
        base: BaseChoice::One(base.clone()),
        antenna: String::new(),
    };
    let burst = desk.sessions.solve_once(burst).await.unwrap();
    let solutions: Vec<Solution> = burst.into_iter().map(|computed| computed.solution).collect();
    assert_eq!(solutions[..], PAIR.solved(Mode::RtkFgo, &base)[..60]);
    // The result of another configuration.
    let store = database.store().await;
    let aiding = AidingDesk::open(store.clone(), AidingLimits::service()).await.unwrap();
    let change = SolveRequest {
        mode: Some("rtk-fgo".to_owned()),
        base: Some(base).into(),
        ..Default::default()
    };
    let again = Recomputation::open(store, aiding, &points, Some(&change)).await;
    let answers = again.unwrap().next().await.unwrap().unwrap();
    let first = answers.into_iter().filter(|answer| answer.revision == 0);
    assert_eq!(first.map(|answer| answer.solution).collect::<Vec<_>>(), solutions);
}

/// Replay reports base epochs that were deleted because of the limit. A session whose state is
/// restored continues.
async fn forgotten_base_epochs_are_said(database: Database) {
    let limits = AidingLimits { epochs_per_base: 40, ..AidingLimits::service() };
    let desk = desk_with(&database, limits.clone()).await;
    desk.navigate().await;
    let base = desk.base().await;
    let session = desk.session(&base).await;
    desk.push(&base, &PAIR.base[..40]).await;
    desk.submit(&session, &PAIR.rover[..40]).await;
    assert!(checked(&database, &session).await.unwrap().is_same());
    desk.push(&base, &PAIR.base[40..70]).await;
    assert_eq!(checked(&database, &session).await.unwrap_err(), "BASE_FORGOTTEN");
    let restarted = desk_with(&database, limits).await;
    let answers = restarted.submit(&session, &PAIR.rover[40..70]).await;
    assert!(answers.iter().all(|solution| solution.provenance.base.is_some()));
}

/// A caller that disconnects while a base is created leaves no base that is stored and unknown.
#[tokio::test]
async fn a_base_is_created_although_the_caller_has_gone() {
    let doors = Doors::open().await;
    let request = || v1::CreateBaseRequest { request_id: "roof".to_owned(), ..Default::default() };
    let caller = doors.caller();
    let mut call = Box::pin(calls::bases::create(&caller, request()));
    assert!(futures::poll!(&mut call).is_pending());
    drop(call);
    let list = async || doors.get("/v1/bases").await.1["bases"].as_array().map(Vec::len);
    until("created", list, |count| *count == Some(1)).await;
    let (_, is_new) = calls::bases::create(&caller, request()).await.unwrap();
    assert!(!is_new);
}

/// Epochs of 20 minutes.
fn long_push() -> Vec<Epoch> {
    (1..=1_200).map(|seq| epoch(seq, seq as f64).epoch).collect()
}

/// The database fails at epoch 700: what is stored before is visible, and the same push goes on
/// behind it.
async fn a_long_push_is_stored_in_steps(database: Database) {
    let desk = desk(&database).await;
    let base = desk.base().await;
    let (fail, works) = match database.url.starts_with("sqlite") {
        true => (
            "CREATE TRIGGER fails BEFORE INSERT ON base_epochs WHEN NEW.number = 700 \
             BEGIN SELECT RAISE(ABORT, 'on purpose'); END",
            "DROP TRIGGER fails",
        ),
        false => (
            "ALTER TABLE base_epochs ADD CONSTRAINT fails CHECK (number <> 700)",
            "ALTER TABLE base_epochs DROP CONSTRAINT fails",
        ),
    };
    database.execute(fail).await;
    let error = desk.aiding.bases.push(&base, long_push()).await.unwrap_err();
    assert_eq!(error.code().name(), "DATABASE_FAILED", "{error}");
    let kept = async || desk.aiding.bases.get(&base).await.unwrap().epochs;
    assert_eq!((kept().await, database.count("base_epochs").await), (500, 500));
    database.execute(works).await;
    let push = desk.aiding.bases.push(&base, long_push()).await.unwrap();
    let outcomes: Vec<_> = push.outcomes.into_iter().map(Result::unwrap).collect();
    assert_eq!(outcomes.iter().filter(|epoch| epoch.resent).count(), 500);
    assert!((1..).zip(&outcomes).all(|(number, epoch)| epoch.number == number));
    assert_eq!((kept().await, database.count("base_epochs").await), (1_200, 1_200));
}

/// The deletion itself is short, however many epochs the base has.
async fn the_epochs_of_a_deleted_base_are_removed_in_the_background(database: Database) {
    let store = database.store().await;
    let aiding = AidingDesk::open(store.clone(), AidingLimits::service()).await.unwrap();
    let base = id_of(&aiding.bases.create(PAIR.new_base(0.0)).await.unwrap());
    aiding.bases.push(&base, long_push()).await.unwrap();
    aiding.bases.delete(&base).await.unwrap();
    assert_eq!(database.count("base_epochs").await, 1_200);
    let _sessions = Sessions::open(store, aiding, SessionLimits::service());
    for table in ["base_epochs", "base_sites"] {
        let left = async || database.count(table).await;
        until("removed", left, |count| *count == 0).await;
    }
}
