//! Forged ephemerides replace, contradict and evict no data of higher trust. Forged ephemerides of
//! a device affect the session of this device only.

use axum::body::Body;
use axum::http::Request;
use bytes::Bytes;
use graphfix::aiding::{AGREED, AidingDesk, AidingLimits, NavigationPush, UPLOAD, device};
use graphfix::contract::v1;
use graphfix::gnss::{
    Constellation, Ephemeris, KlobucharCoefficients, Navigation, Solution, Status,
};
use graphfix::session::{
    RawChunk, Recomputation, SequencedEpoch, SessionId, SessionLimits, Sessions,
};
use graphfix::simulation::{Scenario, Simulator};
use graphfix::tenant::Tenant;
use prost::Message;
use serde_json::{Value, json};
use tower::ServiceExt;

use crate::support::database::{Database, on_both_databases};
use crate::support::doors::Doors;
use crate::support::drive::DRIVE;
use crate::support::sessions::created;
use crate::support::streams::ephemeris_frame;

on_both_databases!(
    forged_ephemerides_move_nobody,
    forged_ephemerides_evict_nothing,
    the_operators_data_end_forged_ones,
    what_one_device_decodes_serves_it_alone,
    what_two_devices_decode_serves_all,
    what_two_devices_decode_ends_forged_uploads,
    coefficients_of_one_device_serve_it_alone,
    nothing_of_a_device_ends_for_another,
);

const OPERATOR: &str = "https://archive.example/brdc.rnx";
const BASE: &str = "base ntrip://caster.example/BASE";

/// GPS ephemerides of the drive, one for each satellite.
fn real() -> Navigation {
    let mut real = DRIVE.navigation.clone();
    let mut seen = std::collections::BTreeSet::new();
    real.retain(|ephemeris| {
        let satellite = ephemeris.satellite();
        satellite.constellation == Constellation::Gps && seen.insert(satellite)
    });
    real
}

/// [`real`] ephemerides with orbits 2.7 km off and reference times `shift_s` later.
fn forged(shift_s: f64) -> Navigation {
    let mut forged = Navigation::default();
    for ephemeris in real().satellites().flat_map(|(_, list)| list) {
        let Ephemeris::Keplerian(mut orbit) = ephemeris.clone() else { continue };
        orbit.m0_rad += 1e-4;
        (orbit.toe, orbit.toc) = (orbit.toe + shift_s, orbit.toc + shift_s);
        forged.insert(Ephemeris::Keplerian(orbit));
    }
    forged
}

async fn desk(database: &Database) -> AidingDesk {
    AidingDesk::open(database.store().await, AidingLimits::service()).await.unwrap()
}

async fn pushed(desk: &AidingDesk, navigation: Navigation, source: &str) -> NavigationPush {
    desk.navigation.push(navigation, source).await.unwrap()
}

async fn forged_ephemerides_move_nobody(database: Database) {
    let aiding = desk(&database).await;
    let first = pushed(&aiding, real(), OPERATOR).await;
    assert!(8 < first.new, "{first:?}");
    let device = device("A");
    for source in [UPLOAD, &device, "base ntrip://caster.example/BASE"] {
        // The same reference time, and later ones that would be nearer to some epochs.
        for shift_s in [0.0, 16.0, 1800.0] {
            let refused = pushed(&aiding, forged(shift_s), source).await;
            assert_eq!((refused.new, refused.dropped), (0, 0), "{source} {shift_s}");
        }
    }
    let push = aiding.navigation.current().push;
    assert_eq!((push, &*aiding.navigation.current().navigation), (1, &real()));
    // The sources of ephemerides are known after a restart.
    let again = desk(&database).await;
    assert_eq!(pushed(&again, forged(16.0), UPLOAD).await.new, 0);
}

async fn forged_ephemerides_evict_nothing(database: Database) {
    let aiding = desk(&database).await;
    pushed(&aiding, real(), UPLOAD).await;
    let mut many = Navigation::default();
    for index in 1..480 {
        many.merge(forged(f64::from(index) * 20_000.0));
    }
    // The stream of a base fills the free room. A device takes none of this room.
    pushed(&aiding, many.clone(), BASE).await;
    let more = pushed(&aiding, forged(480.0 * 20_000.0), BASE).await;
    assert_eq!((more.new, more.dropped), (0, 0));
    let in_force = aiding.navigation.current().navigation;
    pushed(&aiding, many, &device("A")).await;
    assert_eq!(aiding.navigation.current().navigation, in_force);
    let current = aiding.navigation.current().navigation;
    let is_there = |ephemeris: &Ephemeris| current.of(ephemeris.satellite()).contains(ephemeris);
    assert!(real().satellites().flat_map(|(_, list)| list).all(is_there));
    // The operator's data are still accepted: forged ephemerides are dropped for them.
    let mut later = real();
    later.merge(forged(500.0 * 20_000.0));
    let taken = pushed(&aiding, later, OPERATOR).await;
    // The uploaded ephemerides become the operator's, and each satellite gets one more.
    assert!(taken.new == 2 * taken.dropped && 8 < taken.dropped, "{taken:?}");
    let current = aiding.navigation.current().navigation;
    assert!(
        real()
            .satellites()
            .flat_map(|(_, list)| list)
            .all(|real| { current.of(real.satellite()).contains(real) })
    );
}

async fn the_operators_data_end_forged_ones(database: Database) {
    let aiding = desk(&database).await;
    let offered = pushed(&aiding, forged(16.0), UPLOAD).await;
    let taken = pushed(&aiding, real(), OPERATOR).await;
    assert_eq!((taken.new, taken.dropped), (offered.new, offered.new));
    assert_eq!(*aiding.navigation.current().navigation, real());
    // The data with which earlier solutions were computed are known.
    let before = aiding.navigation.after(1, &device("A")).await.unwrap();
    assert_eq!(*before.navigation, forged(16.0));
    assert_eq!(*desk(&database).await.navigation.current().navigation, real());
}

/// The navigation data that serve the session of a device.
fn of_device(aiding: &AidingDesk, name: &str) -> Navigation {
    Navigation::clone(&aiding.navigation.current_for(&device(name)).navigation)
}

async fn what_one_device_decodes_serves_it_alone(database: Database) {
    let aiding = desk(&database).await;
    let count = pushed(&aiding, real(), &device("A")).await.new;
    assert!(8 < count);
    let again = pushed(&aiding, real(), &device("A")).await;
    assert_eq!((again.new, again.dropped), (0, 0));
    assert_eq!(pushed(&aiding, forged(0.0), &device("B")).await.new, count);
    for aiding in [&aiding, &desk(&database).await] {
        assert!(aiding.navigation.current().navigation.is_empty());
        assert_eq!(of_device(aiding, "A"), real());
        assert_eq!(of_device(aiding, "B"), forged(0.0));
        assert!(of_device(aiding, "C").is_empty());
        // The data that were in force for each device after each push.
        let after = async |push, name: &str| {
            let known = aiding.navigation.after(push, &device(name)).await.unwrap();
            (*known.navigation).clone()
        };
        assert_eq!((after(1, "A").await, after(1, "B").await), (real(), Navigation::default()));
        assert_eq!((after(2, "A").await, after(2, "B").await), (real(), forged(0.0)));
    }
    // A device's own ephemerides come before uploads, but not before the operator's.
    pushed(&aiding, forged(16.0), UPLOAD).await;
    assert_eq!((of_device(&aiding, "A"), of_device(&aiding, "C")), (real(), forged(16.0)));
    pushed(&aiding, real(), OPERATOR).await;
    for name in ["A", "B", "C"] {
        assert_eq!(of_device(&aiding, name), real());
    }
    assert_eq!(of_device(&desk(&database).await, "B"), real());
}

async fn what_two_devices_decode_serves_all(database: Database) {
    let aiding = desk(&database).await;
    let count = pushed(&aiding, real(), &device("A")).await.new;
    pushed(&aiding, forged(16.0), &device("B")).await;
    assert_eq!(pushed(&aiding, real(), &device("C")).await.new, count);
    for aiding in [&aiding, &desk(&database).await] {
        for name in ["A", "B", "C", "D"] {
            assert_eq!(of_device(aiding, name), real(), "{name}");
        }
        let status = aiding.navigation.status();
        assert!(status.satellites.iter().all(|satellite| satellite.source == AGREED));
        // Forged ephemerides that come later are refused from every source.
        for source in [&*device("B"), &*device("E"), UPLOAD] {
            assert_eq!(pushed(aiding, forged(16.0), source).await.new, 0, "{source}");
        }
    }
    assert_eq!(of_device(&aiding, "B"), real());
    let before = aiding.navigation.after(2, &device("B")).await.unwrap();
    assert_eq!(*before.navigation, forged(16.0));
}

async fn what_two_devices_decode_ends_forged_uploads(database: Database) {
    let aiding = desk(&database).await;
    let count = pushed(&aiding, forged(0.0), UPLOAD).await.new;
    pushed(&aiding, real(), &device("A")).await;
    assert_eq!((of_device(&aiding, "A"), of_device(&aiding, "B")), (real(), forged(0.0)));
    let agreed = pushed(&aiding, real(), &device("B")).await;
    assert_eq!(agreed.new, count);
    for aiding in [&aiding, &desk(&database).await] {
        assert_eq!((of_device(aiding, "A"), of_device(aiding, "C")), (real(), real()));
    }
    // An upload confirms the data of a device, as another device does.
    let later = |shift_s| {
        let mut later = forged(shift_s);
        later.retain(|ephemeris| ephemeris.satellite().number < 16);
        later
    };
    pushed(&aiding, later(20_000.0), &device("A")).await;
    pushed(&aiding, later(20_000.0), UPLOAD).await;
    assert_eq!(pushed(&aiding, later(20_016.0), &device("B")).await.new, 0);
}

async fn coefficients_of_one_device_serve_it_alone(database: Database) {
    let aiding = desk(&database).await;
    let with = |first: f64| {
        let mut navigation = Navigation::default();
        let (alpha, beta) = ([first, 0.0, 0.0, 0.0], [9e4, 0.0, 0.0, 0.0]);
        navigation.klobuchar_gps = Some(KlobucharCoefficients { alpha, beta });
        navigation
    };
    pushed(&aiding, with(1e-8), &device("A")).await;
    pushed(&aiding, with(1e-6), &device("B")).await;
    for aiding in [&aiding, &desk(&database).await] {
        let known = ["A", "B", "C"].map(|name| of_device(aiding, name));
        assert_eq!(known, [with(1e-8), with(1e-6), Navigation::default()]);
    }
    pushed(&aiding, with(1e-8), &device("C")).await;
    // The coefficients of the next day serve all once two devices have sent them.
    pushed(&aiding, with(2e-8), &device("A")).await;
    assert_eq!(of_device(&aiding, "D"), with(1e-8));
    pushed(&aiding, with(2e-8), &device("C")).await;
    for aiding in [&aiding, &desk(&database).await] {
        for name in ["A", "B", "D"] {
            assert_eq!(of_device(aiding, name), with(2e-8), "{name}");
        }
    }
    let before = aiding.navigation.after(1, &device("A")).await.unwrap();
    assert_eq!(*before.navigation, with(1e-8));
}

async fn nothing_of_a_device_ends_for_another(database: Database) {
    let aiding = desk(&database).await;
    pushed(&aiding, real(), &device("A")).await;
    for index in 0..40 {
        pushed(&aiding, forged(f64::from(index) * 20_000.0), &device("B")).await;
    }
    for aiding in [&aiding, &desk(&database).await] {
        assert_eq!(of_device(aiding, "A"), real());
        assert!(of_device(aiding, "B").len() <= 256, "{}", of_device(aiding, "B").len());
    }
}

/// Epochs of 20 s under an open sky with GPS alone, its ephemerides as a receiver sends them, and
/// forged ones in the same form.
fn open_sky() -> (Vec<SequencedEpoch>, Vec<u8>, Vec<u8>) {
    let constellations = vec![Constellation::Gps];
    let sky = Scenario { duration_s: 20.0, constellations, ..Scenario::open_sky() };
    let simulator = Simulator::new(sky, 5);
    let (mut frames, mut forged) = (Vec::new(), Vec::new());
    for ephemeris in simulator.navigation().satellites().flat_map(|(_, list)| list) {
        let Ephemeris::Keplerian(mut orbit) = ephemeris.clone() else { continue };
        frames.extend(ephemeris_frame(&orbit));
        orbit.m0_rad += 1e-4;
        forged.extend(ephemeris_frame(&orbit));
    }
    let number = |(seq, epoch)| SequencedEpoch { seq, epoch };
    ((1..).zip(simulator.map(|epoch| epoch.rover)).map(number).collect(), frames, forged)
}

/// Sends the frames of a device to its session.
async fn sent(sessions: &Sessions, id: &SessionId, frames: &[u8], near: &SequencedEpoch) {
    let content = Bytes::copy_from_slice(frames);
    let chunk = RawChunk { offset: 0, content, is_end: true, near: Some(near.epoch.time) };
    let received = sessions.receive(id, chunk).await.unwrap().received;
    assert!(8 < received.navigation.len(), "{received:?}");
}

async fn positions(
    sessions: &Sessions,
    id: &SessionId,
    epochs: &[SequencedEpoch],
) -> Vec<Solution> {
    let outcomes = sessions.submit(id, epochs.to_vec()).await.unwrap().outcomes;
    outcomes.into_iter().map(|outcome| outcome.result.unwrap().solution.solution).collect()
}

/// Positions of sessions before and after forged ephemerides, after a restart and in a replay.
#[tokio::test]
async fn a_device_moves_its_own_session_only() {
    let database = Database::sqlite();
    let store = database.store().await;
    let open = async || {
        let aiding = AidingDesk::open(store.clone(), AidingLimits::service()).await.unwrap();
        Sessions::open(store.clone(), aiding, SessionLimits::service())
    };
    let sessions = open().await;
    let (epochs, frames, forged) = open_sky();
    let (honest, liar, none) =
        (created(&sessions).await, created(&sessions).await, created(&sessions).await);
    sent(&sessions, &honest, &frames, &epochs[0]).await;
    let first = positions(&sessions, &honest, &epochs[..5]).await;
    assert!(first.iter().all(|solution| solution.status == Status::Single));
    sent(&sessions, &liar, &forged, &epochs[0]).await;
    let lied = positions(&sessions, &liar, &epochs[..5]).await;
    let far_m = |a: &Solution, b: &Solution| {
        let position = |s: &Solution| s.estimate.as_ref().map(|estimate| estimate.position);
        position(a).zip(position(b)).map(|(a, b)| a.distance_m(b))
    };
    assert!(far_m(&lied[0], &first[0]).is_none_or(|far| 20.0 < far), "the forgery must matter");
    let without = positions(&sessions, &none, &epochs[..5]).await;
    assert!(without.iter().all(|solution| solution.status == Status::None));
    drop(sessions);

    // After a restart another device confirms the honest ephemerides, so that all sessions get
    // them.
    let sessions = open().await;
    let (alone, second) = (created(&sessions).await, created(&sessions).await);
    sent(&sessions, &alone, &frames, &epochs[0]).await;
    let confirmed = positions(&sessions, &second, &epochs[..10]).await;
    let honest_then = positions(&sessions, &honest, &epochs[5..10]).await;
    // Each session begins its iteration at its own last position, so the last bits may differ.
    let is_same = |positions: &[Solution]| {
        let pairs = positions.iter().zip(&honest_then);
        pairs.map(|(one, other)| far_m(one, other)).all(|far| far.is_some_and(|far| far < 1e-3))
    };
    assert!(is_same(&confirmed[5..]));
    assert!(is_same(&positions(&sessions, &liar, &epochs[5..10]).await));
    assert!(is_same(&positions(&sessions, &none, &epochs[5..10]).await));
    drop(sessions);

    let aiding = AidingDesk::open(store.clone(), AidingLimits::service()).await.unwrap();
    for id in [&honest, &liar, &none, &second] {
        let again = Recomputation::open(store.clone(), aiding.clone(), id, None).await.unwrap();
        let check = again.check().await.unwrap();
        assert!(check.is_same() && check.compared == 10, "{check:?}");
    }
}

/// All devices of a tenant are one source. Their data serve the tenant, and only devices of another
/// tenant confirm them.
#[tokio::test]
async fn the_devices_of_a_tenant_serve_the_tenant_alone() {
    let database = Database::sqlite();
    let store = database.store().await;
    let tenants = ["a", "b"].map(|name| Tenant::parse(name).unwrap());
    let open = async || {
        let aiding = AidingDesk::open(store.clone(), AidingLimits::service()).await.unwrap();
        let operator = Sessions::open(store.clone(), aiding, SessionLimits::service());
        (operator.of(&tenants[0]), operator.of(&tenants[1]), operator)
    };
    let (epochs, frames, _) = open_sky();
    let positioned = async |sessions: &Sessions| {
        let id = created(sessions).await;
        let answers = positions(sessions, &id, &epochs[..5]).await;
        (id, answers.iter().all(|solution| solution.status == Status::Single))
    };
    let (a, b, operator) = open().await;
    for _ in 0..2 {
        sent(&a, &created(&a).await, &frames, &epochs[0]).await;
        for (sessions, is_served) in [(&a, true), (&b, false), (&operator, false)] {
            assert_eq!(positioned(sessions).await.1, is_served);
        }
    }
    drop((a, b, operator));

    let (a, b, operator) = open().await;
    let served = positioned(&a).await.0;
    let without = positioned(&b).await.0;
    sent(&b, &created(&b).await, &frames, &epochs[0]).await;
    for sessions in [&a, &b, &operator] {
        assert!(positioned(sessions).await.1);
    }
    drop((a, b, operator));
    let aiding = AidingDesk::open(store.clone(), AidingLimits::service()).await.unwrap();
    for id in [&served, &without] {
        let again = Recomputation::open(store.clone(), aiding.clone(), id, None).await.unwrap();
        let check = again.check().await.unwrap();
        assert!(check.is_same() && check.compared == 5, "{check:?}");
    }
}

fn is_single(answer: &Value) -> bool {
    answer["results"][0]["solution"]["status"] == "SINGLE"
}

/// Through both doors the ephemerides of a device serve its own session only, until another device
/// sends the same.
#[tokio::test]
async fn through_the_doors_a_device_serves_itself_alone() {
    let doors = Doors::open().await;
    let (epochs, frames, _) = open_sky();
    let message = graphfix::contract::convert::epoch_message(1, &epochs[0].epoch);
    let time = message.time.unwrap();
    let push = json!({"epochs": [serde_json::to_value(&message).unwrap()]});
    let near = format!("{}:{}", time.week, time.ns_of_week as f64 / 1e9);
    let raw = |session: &str| format!("/v1/sessions/{session}/raw?end=true&near={near}");
    let (one, other, third) = (doors.session().await, doors.session().await, doors.session().await);
    let positioned = async |session: &str| {
        let path = format!("/v1/sessions/{session}/epochs");
        is_single(&doors.post(&path, push.clone()).await.1)
    };
    let (status, sent) = doors.upload(&raw(&one), frames.clone()).await;
    assert!(status.is_success() && sent["ephemerides"].as_u64().unwrap() > 8, "{sent}");
    assert!(positioned(&one).await && !positioned(&other).await);
    // The second device sends the same ephemerides through gRPC.
    let request = v1::PushRawRequest {
        session: third.clone(),
        offset: 0,
        content: frames.into(),
        end: true,
        near: Some(time),
    };
    let content = request.encode_to_vec();
    let framed = [&[0][..], &(content.len() as u32).to_be_bytes(), &content].concat();
    let request = Request::post("/graphfix.v1.Positioning/PushRaw");
    let request = request.header("content-type", "application/grpc").body(Body::from(framed));
    let response = doors.router.clone().oneshot(request.unwrap()).await.unwrap();
    assert!(response.status().is_success(), "{response:?}");
    axum::body::to_bytes(response.into_body(), usize::MAX).await.unwrap();
    assert!(positioned(&doors.session().await).await);
}
