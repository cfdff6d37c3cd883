//! Sessions that take the nearest of several bases: a rover on a figure of eight between two, on
//! both databases and through both doors.

use std::collections::BTreeMap;
use std::sync::LazyLock;

use axum::http::StatusCode;
use graphfix::aiding::bases::{BaseChoice, BaseId, NewBase};
use graphfix::aiding::{AidingDesk, AidingLimits};
use graphfix::contract::{calls, convert, v1};
use graphfix::formats::rinex::write_navigation;
use graphfix::gnss::{
    BaseSite, Ecef, Enu, Epoch, Navigation, PositionSource, Reason, Solution, Status,
};
use graphfix::session::{
    Burst, Check, NewSession, Recomputation, SequencedEpoch, SessionId, SessionLimits,
    SessionUpdate, Sessions, SolveRequest,
};
use graphfix::simulation::{Motion, Scenario, Simulator};
use graphfix::store::{SessionFilter, StoredSolution};
use serde_json::{Value, json};

use crate::support::database::{Database, on_both_databases, whole_session};
use crate::support::doors::{Doors, code};

on_both_databases!(
    a_rover_between_two_bases_changes_twice,
    restarts_and_parking_change_no_bit,
    a_base_that_falls_silent_is_left,
    far_and_unknown_bases_are_not_used,
    who_has_no_position_has_no_base,
    a_choice_serves_positions_on_request,
    candidates_in_use_stay,
);

/// Distances of the bases from the rover's start (m), west and east.
const FROM_START_M: f64 = 3_000.0;

struct Between {
    /// Numbered from 1.
    rover: Vec<SequencedEpoch>,
    truth: Vec<Ecef>,
    /// West and east of the rover, with their observations of the same times.
    bases: [(Ecef, Vec<Epoch>); 2],
    navigation: Navigation,
}

/// Four minutes with an epoch a second at 30 m/s. The rover comes 1.5 km east and west of its
/// start.
static BETWEEN: LazyLock<Between> = LazyLock::new(|| {
    let simulated = |east_m: f64| {
        let scenario = Scenario {
            duration_s: 239.0,
            motion: Motion::Loop { half_length_m: 1_500.0, speed_m_s: 30.0 },
            base: Some(Enu(nalgebra::Vector3::new(east_m, 0.0, 20.0))),
            ..Scenario::by_name("open-sky").unwrap()
        };
        Simulator::new(scenario, 5)
    };
    let simulators = [-FROM_START_M, FROM_START_M].map(simulated);
    let navigation = Navigation::clone(simulators[0].navigation());
    let truth = simulators[0].clone().map(|epoch| epoch.position).collect();
    let number = |(index, epoch)| SequencedEpoch { seq: index as u64 + 1, epoch };
    let rover = |simulator: &Simulator| simulator.clone().map(|epoch| epoch.rover).enumerate();
    let numbered: Vec<SequencedEpoch> = rover(&simulators[0]).map(number).collect();
    assert!(rover(&simulators[1]).map(number).eq(numbered.iter().cloned()), "one rover");
    let bases = simulators.map(|simulator| {
        let place = simulator.base_position().unwrap();
        (place, simulator.map(|epoch| epoch.base.unwrap()).collect())
    });
    Between { rover: numbered, truth, bases, navigation }
});

fn site(marker: Ecef) -> BaseSite {
    BaseSite {
        marker,
        antenna_delta_hen_m: [0.0; 3],
        antenna: String::new(),
        calibration: None,
        source: PositionSource::Given,
    }
}

struct Desk {
    aiding: AidingDesk,
    sessions: Sessions,
}

async fn desk(database: &Database) -> Desk {
    let store = database.store().await;
    let aiding = AidingDesk::open(store.clone(), AidingLimits::service()).await.unwrap();
    let limits = SessionLimits { active_sessions: 1, ..SessionLimits::service() };
    Desk { sessions: Sessions::open(store, aiding.clone(), limits), aiding }
}

impl Desk {
    /// The two bases without epochs, and the navigation data.
    async fn bases(&self) -> [BaseId; 2] {
        self.aiding.navigation.push(BETWEEN.navigation.clone(), "test").await.unwrap();
        let [west, east] = BETWEEN.bases.each_ref().map(|(place, _)| *place);
        [self.base(Some(west)).await, self.base(Some(east)).await]
    }

    async fn base(&self, place: Option<Ecef>) -> BaseId {
        let new = NewBase { site: place.map(site), ..NewBase::default() };
        BaseId::parse(&self.aiding.bases.create(new).await.unwrap().name.id).unwrap()
    }

    async fn push(&self, base: &BaseId, epochs: &[Epoch]) {
        let push = self.aiding.bases.push(base, epochs.to_vec()).await.unwrap();
        assert!(push.outcomes.iter().all(Result::is_ok));
    }

    async fn session(&self, base: BaseChoice<BaseId>) -> SessionId {
        self.sessions.create(new_session(base)).await.unwrap().id
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

fn new_session(base: BaseChoice<BaseId>) -> NewSession {
    NewSession {
        label: String::new(),
        mode: "rtk-fgo".to_owned(),
        profile: "general".to_owned(),
        overrides: BTreeMap::new(),
        base,
        antenna: String::new(),
        retention_days: None,
    }
}

async fn checked(database: &Database, id: &SessionId) -> Check {
    let store = database.store().await;
    let aiding = AidingDesk::open(store.clone(), AidingLimits::service()).await.unwrap();
    Recomputation::open(store, aiding, id, None).await.unwrap().check().await.unwrap()
}

fn base_of(solution: &Solution) -> Option<&str> {
    solution.provenance.base.as_ref().map(|used| used.base.as_str())
}

/// The used bases, each with the index of the first epoch that used it.
fn courses(answers: &[Solution]) -> Vec<(usize, Option<String>)> {
    let mut courses: Vec<(usize, Option<String>)> = Vec::new();
    for (index, solution) in answers.iter().enumerate() {
        let base = base_of(solution).map(str::to_owned);
        if courses.last().is_none_or(|(_, last)| *last != base) {
            courses.push((index, base));
        }
    }
    courses
}

/// Indices of the epochs that report a change of the base, with the distance (m).
fn changes(answers: &[Solution]) -> Vec<(usize, f64)> {
    let said = |solution: &Solution| {
        solution.reasons.iter().find_map(|reason| match reason {
            Reason::BaseChanged { distance_m } => Some(*distance_m),
            _ => None,
        })
    };
    answers.iter().enumerate().filter_map(|(index, s)| Some((index, said(s)?))).collect()
}

/// The west base is used first, when both are at the same distance. The east base is used once it
/// was received for a minute: the rover is then nearer to it by more than a fifth and by a
/// kilometre. The west base is used again once the rover is 500 m west of the start. After each
/// change the rover is fixed again, at the right position, in both modes.
async fn a_rover_between_two_bases_changes_twice(database: Database) {
    let desk = desk(&database).await;
    let [west, east] = desk.bases().await;
    for (base, (_, epochs)) in [&west, &east].into_iter().zip(&BETWEEN.bases) {
        desk.push(base, epochs).await;
    }
    for mode in ["rtk-fgo", "rtk-ekf"] {
        for choice in [BaseChoice::NearestOf(vec![west.clone(), east.clone()]), BaseChoice::Nearest]
        {
            let new = NewSession { mode: mode.to_owned(), ..new_session(choice.clone()) };
            let info = desk.sessions.create(new).await.unwrap();
            let named = info.base.try_map(|id| BaseId::parse(&id).ok_or(())).unwrap();
            assert_eq!(named, choice);
            let mut answers = Vec::new();
            for batch in BETWEEN.rover.chunks(50) {
                answers.extend(desk.submit(&info.id, batch).await);
            }
            let courses = courses(&answers);
            let bases: Vec<_> = courses.iter().map(|(_, base)| base.as_deref()).collect();
            let [_, last_two @ ..] = &bases[..] else { panic!("{courses:?}") };
            let (w, e) = (Some(west.as_str()), Some(east.as_str()));
            // If both are at the same distance, noise or the order of the list decides.
            match bases[0] == w {
                true => assert_eq!(last_two, [e, w], "{courses:?}"),
                false => assert_eq!(last_two, [w], "{courses:?}"),
            }
            let starts: Vec<usize> = courses.iter().skip(1).map(|(start, _)| *start).collect();
            assert!(starts.first().is_none_or(|start| bases[0] != w || *start == 60), "{starts:?}");
            assert!((168..=171).contains(starts.last().unwrap()), "{starts:?}");
            let (said, distances_m): (Vec<_>, Vec<_>) = changes(&answers).into_iter().unzip();
            assert_eq!(said, starts);
            assert!(distances_m.iter().all(|m| (m - 2.0 * FROM_START_M).abs() < 1.0));
            let is_right = |(solution, truth): (&Solution, &Ecef)| {
                let estimate = solution.estimate.as_ref().unwrap();
                let off_m = estimate.position.distance_m(*truth);
                assert!(solution.status != Status::Fixed || off_m < 0.15, "{off_m} m");
                solution.status == Status::Fixed
            };
            let fixed: Vec<bool> = answers.iter().zip(&BETWEEN.truth).map(is_right).collect();
            for part in starts.windows(2).map(|w| w[0]..w[1]).chain(std::iter::once(170..240)) {
                let count = fixed[part.clone()].iter().filter(|fixed| **fixed).count();
                assert!(30 < count, "{mode}: {count} fixed in {part:?}");
            }
        }
    }
}

/// Base epochs arrive together with rover epochs. There are three sessions: one in a service that
/// keeps running, one whose service is killed after each batch, and one whose service stops
/// regularly and stores its state.
async fn restarts_and_parking_change_no_bit(database: Database) {
    let steady = desk(&database).await;
    let [west, east] = steady.bases().await;
    let choice = BaseChoice::NearestOf(vec![west.clone(), east.clone()]);
    let whole = steady.session(choice.clone()).await;
    let (restarted, parked) = (steady.session(choice.clone()).await, steady.session(choice).await);
    let mut first = 0;
    for batch in BETWEEN.rover.chunks(40) {
        let span = first..first + batch.len();
        first = span.end;
        for (base, (_, epochs)) in [&west, &east].into_iter().zip(&BETWEEN.bases) {
            steady.push(base, &epochs[span.clone()]).await;
        }
        steady.submit(&whole, batch).await;
        desk(&database).await.submit(&restarted, batch).await;
        let orderly = desk(&database).await;
        orderly.submit(&parked, batch).await;
        orderly.sessions.drain().await;
    }
    let request = SolveRequest::default();
    let solved = steady.sessions.solve(&whole, &request).await.unwrap();
    for id in [&whole, &restarted, &parked] {
        desk(&database).await.sessions.close(id).await.unwrap();
    }
    let expected = steady.listed(&whole).await;
    for other in [&restarted, &parked] {
        assert_eq!(format!("{expected:?}"), format!("{:?}", steady.listed(other).await));
    }
    let (answers, revised): (Vec<_>, Vec<_>) = expected.iter().partition(|s| s.revision == 0);
    assert_eq!((answers.len(), revised.len()), (BETWEEN.rover.len(), BETWEEN.rover.len()));
    assert_eq!(solved.solution, answers.last().unwrap().solution);
    let answers: Vec<Solution> = answers.into_iter().map(|s| s.solution.clone()).collect();
    let changed = changes(&answers);
    assert!(!changed.is_empty());
    // Revisions contain the base and the reason too.
    for (index, _) in &changed {
        let again = revised.iter().find(|s| s.seq == *index as u64 + 1).unwrap();
        assert_eq!(base_of(&again.solution), base_of(&answers[*index]));
        assert_eq!(changes(std::slice::from_ref(&again.solution)).len(), 1);
    }
    // With all data that are stored now, another base would be chosen. A replay uses the base that
    // the session used.
    for id in [&whole, &restarted, &parked] {
        let same = Check { compared: expected.len(), ..Check::default() };
        assert_eq!(checked(&database, id).await, same);
    }
}

/// The nearer base stops sending. After the age limit the other base is used, which still sends.
/// The nearer base is used again only after it was received for a minute.
async fn a_base_that_falls_silent_is_left(database: Database) {
    let desk = desk(&database).await;
    let [west, _] = desk.bases().await;
    let near = desk.base(Some(BETWEEN.bases[1].0)).await;
    let (_, far_epochs) = &BETWEEN.bases[0];
    let (_, near_epochs) = &BETWEEN.bases[1];
    desk.push(&west, far_epochs).await;
    // No data from second 70 to 120; at second 10 the rover is 300 m east of the start.
    desk.push(&near, &near_epochs[..70]).await;
    desk.push(&near, &near_epochs[120..]).await;
    let session = desk.session(BaseChoice::NearestOf(vec![west.clone(), near.clone()])).await;
    let answers = desk.submit(&session, &BETWEEN.rover[10..160]).await;
    let expected = [(0, Some(near.to_string())), (90, Some(west.to_string()))];
    assert_eq!(courses(&answers), expected);
    assert_eq!(changes(&answers).len(), 1);
    assert!(checked(&database, &session).await.is_same());
}

async fn far_and_unknown_bases_are_not_used(database: Database) {
    let desk = desk(&database).await;
    let [west, east] = desk.bases().await;
    let unplaced = desk.base(None).await;
    // No base was received: the nearest one is named, with its problem.
    let session = desk.session(BaseChoice::Nearest).await;
    let silent = desk.submit(&session, &BETWEEN.rover[..5]).await;
    let last = |solution: &Solution| solution.reasons.last().map(Reason::code);
    assert!(silent.iter().all(|solution| last(solution) == Some("BASE_MISSING")), "{silent:?}");
    for (base, (_, epochs)) in [&west, &east].into_iter().zip(&BETWEEN.bases) {
        desk.push(base, epochs).await;
    }
    // No base beyond the longest baseline is used.
    let mut new = new_session(BaseChoice::NearestOf(vec![west.clone(), unplaced.clone()]));
    new.overrides.insert("differencing.baseline_max_km".to_owned(), "2".to_owned());
    let session = desk.sessions.create(new).await.unwrap().id;
    let far = desk.submit(&session, &BETWEEN.rover[..5]).await;
    for solution in &far {
        let Some(Reason::BaselineTooLong { length_m }) = solution.reasons.last() else {
            panic!("{solution:?}")
        };
        assert!((2_900.0..3_300.0).contains(length_m), "{length_m}");
        assert_eq!((base_of(solution), solution.status), (None, Status::Fgo));
    }
    // No base of unknown position is chosen.
    let session = desk.session(BaseChoice::NearestOf(vec![unplaced])).await;
    let unknown = desk.submit(&session, &BETWEEN.rover[..5]).await;
    assert!(unknown.iter().all(|solution| last(solution) == Some("BASE_MISSING")));
    assert!(checked(&database, &session).await.is_same());
}

/// Without ephemerides the rover's position is unknown, and so is the nearest base. With
/// ephemerides the epoch's own single-point position decides.
async fn who_has_no_position_has_no_base(database: Database) {
    let desk = desk(&database).await;
    for (place, epochs) in &BETWEEN.bases {
        let base = desk.base(Some(*place)).await;
        desk.push(&base, epochs).await;
    }
    let session = desk.session(BaseChoice::Nearest).await;
    let lost = desk.submit(&session, &BETWEEN.rover[20..25]).await;
    assert!(lost.iter().all(|solution| solution.status == Status::None));
    assert!(lost.iter().all(|solution| base_of(solution).is_none()));
    desk.aiding.navigation.push(BETWEEN.navigation.clone(), "test").await.unwrap();
    let found = desk.submit(&session, &BETWEEN.rover[25..60]).await;
    let info = desk.aiding.bases.list().await;
    let of = |place: Ecef| info.iter().find(|i| i.site.as_ref().unwrap().marker == place).unwrap();
    let east = &*of(BETWEEN.bases[1].0).name.id;
    assert!(found.iter().all(|solution| base_of(solution) == Some(east)));
    assert_eq!(changes(&found), [], "there was none before");
    assert_eq!(found.last().unwrap().status, Status::Fixed);
    assert!(checked(&database, &session).await.is_same());
}

async fn a_choice_serves_positions_on_request(database: Database) {
    let desk = desk(&database).await;
    let [west, east] = desk.bases().await;
    for (base, (_, epochs)) in [&west, &east].into_iter().zip(&BETWEEN.bases) {
        desk.push(base, epochs).await;
    }
    // The rover is 1.4 km east of the start.
    let burst = Burst {
        mode: "rtk-fgo".to_owned(),
        profile: "general".to_owned(),
        overrides: BTreeMap::new(),
        epochs: BETWEEN.rover[60..100].to_vec(),
        navigation: None,
        base: BaseChoice::Nearest,
        antenna: String::new(),
    };
    let answers = desk.sessions.solve_once(burst).await.unwrap();
    assert!(answers.iter().all(|answer| base_of(&answer.solution) == Some(east.as_str())));
    let points = NewSession { mode: "spp".to_owned(), ..new_session(BaseChoice::None) };
    let points = desk.sessions.create(points).await.unwrap().id;
    desk.submit(&points, &BETWEEN.rover[60..100]).await;
    let request = SolveRequest {
        mode: Some("rtk-fgo".to_owned()),
        base: BaseChoice::NearestOf(vec![west.clone(), east.clone()]),
        ..SolveRequest::default()
    };
    let solved = desk.sessions.solve(&points, &request).await.unwrap();
    assert_eq!(base_of(&solved.solution), Some(east.as_str()));
    assert_eq!(solved.solution.status, Status::Fixed);
    // A recomputation gives the result of another choice of bases.
    let session = desk.session(BaseChoice::One(west.clone())).await;
    desk.submit(&session, &BETWEEN.rover[..100]).await;
    let store = database.store().await;
    let aiding = AidingDesk::open(store.clone(), AidingLimits::service()).await.unwrap();
    let change = SolveRequest { base: BaseChoice::Nearest, ..SolveRequest::default() };
    let mut again = Recomputation::open(store, aiding, &session, Some(&change)).await.unwrap();
    let answers = again.next().await.unwrap().unwrap();
    let answers: Vec<Solution> =
        answers.into_iter().filter(|a| a.revision == 0).map(|a| a.solution).collect();
    assert_eq!(base_of(&answers[99]), Some(east.as_str()));
}

async fn candidates_in_use_stay(database: Database) {
    let desk = desk(&database).await;
    let [west, east] = desk.bases().await;
    let both = BaseChoice::NearestOf(vec![east.clone(), west.clone()]);
    let session = desk.session(both.clone()).await;
    let refused = async |base: &BaseId| {
        desk.aiding.bases.delete(base).await.err().map(|error| error.code().name())
    };
    assert_eq!(refused(&west).await, Some("BASE_IN_USE"));
    // The order of the named bases is kept, also if other settings change.
    let label = SessionUpdate { label: Some("x".to_owned()), ..SessionUpdate::default() };
    let info = desk.sessions.update(&session, label).await.unwrap();
    assert_eq!(info.base.try_map(|id| BaseId::parse(&id).ok_or(())).unwrap(), both);
    assert_eq!(
        desk.sessions.list(&SessionFilter::default(), 10, None).await.unwrap().items.len(),
        1
    );
    let change = |base| SessionUpdate { base: Some(base), ..SessionUpdate::default() };
    let one = change(BaseChoice::One(east.clone()));
    desk.sessions.update(&session, one).await.unwrap();
    let list = desk.sessions.list(&SessionFilter::default(), 10, None).await.unwrap().items;
    assert_eq!(list[0].base, BaseChoice::One(east.as_str().into()));
    assert_eq!(refused(&west).await, None);
    assert_eq!(refused(&east).await, Some("BASE_IN_USE"));
    desk.sessions.update(&session, change(BaseChoice::Nearest)).await.unwrap();
    assert_eq!(refused(&east).await, None, "nobody names it");
    let error = desk.sessions.update(&session, change(both)).await.unwrap_err();
    assert_eq!(error.code().name(), "BASE_NOT_FOUND");
    let error = desk.sessions.update(&session, change(BaseChoice::NearestOf(vec![]))).await;
    assert_eq!(error.unwrap_err().code().name(), "BASE_REQUIRED");
}

/// Doors of a service with the two bases, filled.
async fn between() -> (Doors, [String; 2]) {
    let doors = Doors::open().await;
    let mut file = Vec::new();
    write_navigation(&mut file, &BETWEEN.navigation).unwrap();
    let (status, answer) = doors.upload("/v1/navigation", file).await;
    assert_eq!(status, StatusCode::OK, "{answer}");
    let mut ids = [String::new(), String::new()];
    for (id, (place, epochs)) in ids.iter_mut().zip(&BETWEEN.bases) {
        let marker = json!({"xM": place.0.x, "yM": place.0.y, "zM": place.0.z});
        let (status, base) = doors.post("/v1/bases", json!({"marker": marker})).await;
        assert_eq!(status, StatusCode::CREATED, "{base}");
        *id = base["base"].as_str().unwrap().to_owned();
        let epochs = epochs.iter().map(|epoch| convert::epoch_message(0, epoch)).collect();
        let push = v1::PushBaseEpochsRequest { base: id.clone(), epochs };
        calls::bases::push_epochs(&doors.caller(), push).await.unwrap();
    }
    (doors, ids)
}

/// A list of bases through REST and the word `nearest` through gRPC give the same answers.
#[tokio::test]
async fn both_doors_take_the_nearest_base() {
    let (doors, [west, east]) = between().await;
    let rover = || -> Vec<v1::Epoch> {
        BETWEEN.rover[..110].iter().map(|e| convert::epoch_message(e.seq, &e.epoch)).collect()
    };
    let new = json!({"mode": "rtk-fgo", "bases": [west, east]});
    let (status, session) = doors.post("/v1/sessions", new).await;
    assert_eq!(status, StatusCode::CREATED, "{session}");
    assert_eq!((&session["base"], &session["bases"]), (&json!(""), &json!([west, east])));
    let option = |name: &str| -> Value {
        let options = session["configuration"].as_array().unwrap();
        options.iter().find(|option| option["name"] == name).unwrap()["value"].clone()
    };
    assert_eq!(option("differencing.nearer_percent"), "20");
    assert_eq!(option("differencing.nearer_km"), "1");
    assert_eq!(option("differencing.steady_s"), "60");
    let path = format!("/v1/sessions/{}", session["session"].as_str().unwrap());
    let (status, pushed) = doors.post(&format!("{path}/epochs"), json!({"epochs": rover()})).await;
    assert_eq!(status, StatusCode::OK, "{pushed}");
    let last = &pushed["results"][109]["solution"];
    assert_eq!(
        (&last["status"], &last["provenance"]["base"]["base"]),
        (&json!("FIXED"), &json!(east))
    );
    let said = |result: &&Value| {
        let reasons = result["solution"]["reasons"].as_array().unwrap();
        reasons.iter().any(|reason| reason["code"] == "BASE_CHANGED")
    };
    let results = pushed["results"].as_array().unwrap();
    assert!(results.iter().filter(said).count() <= 1);

    let base = "nearest".to_owned();
    let new = v1::CreateSessionRequest { mode: "rtk-fgo".into(), base, ..Default::default() };
    let session = calls::sessions::create(&doors.caller(), new).await.unwrap().0;
    assert_eq!((session.base.as_str(), session.bases.len()), ("nearest", 0));
    let push = v1::PushEpochsRequest { session: session.session, epochs: rover() };
    let answer = calls::positioning::push_epochs(&doors.caller(), push).await.unwrap();
    let solution = answer.results[109].solution.as_ref().unwrap();
    assert_eq!(solution.provenance.as_ref().unwrap().base.as_ref().unwrap().base, east);

    let (_, changed) = doors.send("PATCH", &path, json!({"base": "nearest"})).await;
    assert_eq!((&changed["base"], &changed["bases"]), (&json!("nearest"), &json!([])));
    let (_, changed) = doors.send("PATCH", &path, json!({"bases": [east]})).await;
    assert_eq!((&changed["base"], &changed["bases"]), (&json!(""), &json!([east])));
    let (_, changed) = doors.send("PATCH", &path, json!({"base": west})).await;
    assert_eq!((&changed["base"], &changed["bases"]), (&json!(west), &json!([])));
}

#[tokio::test]
async fn choices_that_are_none_are_refused() {
    let (doors, [west, east]) = between().await;
    let unknown = "bas_00000000000000000000000000000000";
    for (request, expected, field) in [
        (json!({"bases": [west, unknown]}), "BASE_NOT_FOUND", "bases[1]"),
        (json!({"bases": ["nearest"]}), "BASE_NOT_FOUND", "bases[0]"),
        (json!({"bases": [west, east, west]}), "INVALID_FIELD", "bases"),
        (json!({"base": west, "bases": [east]}), "INVALID_FIELD", "bases"),
        (json!({"base": "nearest", "bases": [east]}), "INVALID_FIELD", "bases"),
        (json!({"bases": vec![&west; 33]}), "INVALID_FIELD", "bases"),
        (json!({"bases": []}), "BASE_REQUIRED", "base"),
        (json!({"base": "nearer"}), "BASE_NOT_FOUND", "base"),
    ] {
        let mut new = request.clone();
        new["mode"] = json!("rtk-fgo");
        let (status, answer) = doors.post("/v1/sessions", new).await;
        assert!(status.is_client_error(), "{request}: {answer}");
        assert_eq!((code(&answer), &answer["field"]), (expected, &json!(field)), "{request}");
    }
}
