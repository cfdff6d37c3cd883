//! Another sensor's displacements: their effect on positions, and their way through the service.

use graphfix::config::{Mode, PositioningOptions, Profile};
use graphfix::contract::v1;
use graphfix::formats::rinex::{read_navigation, write_navigation};
use graphfix::gnss::{Epoch, Odometry, OdometryFrame};
use graphfix::grpc::v1::positioning_client::PositioningClient;
use graphfix::positioning::{Aiding, Batch, Estimator};
use graphfix::simulation::{Scenario, SimulatedEpoch, Simulator};
use serde_json::{Value, json};

use crate::support::doors::{Doors, code};

/// A drive through the canyon, with or without the wheels' odometry.
fn drive(seed: u64, duration_s: f64) -> (Simulator, Vec<SimulatedEpoch>) {
    let simulator = Simulator::new(Scenario { duration_s, ..Scenario::urban_canyon() }, seed);
    let mut epochs: Vec<_> = simulator.clone().collect();
    epochs.iter_mut().for_each(|epoch| epoch.rover.odometry = epoch.odometry);
    (simulator, epochs)
}

fn without_odometry(epochs: &[SimulatedEpoch]) -> Vec<SimulatedEpoch> {
    let mut bare = epochs.to_vec();
    bare.iter_mut().for_each(|epoch| epoch.rover.odometry = None);
    bare
}

/// Horizontal errors of causal answers or of the batch (m).
fn errors_m(
    simulator: &Simulator,
    epochs: &[SimulatedEpoch],
    options: &PositioningOptions,
    batch: bool,
) -> Vec<f64> {
    let options = options.clone();
    let aiding = Aiding::alone(simulator.navigation());
    let solutions: Vec<_> = if batch {
        let mut batch = Batch::new(options);
        epochs.iter().for_each(|epoch| batch.push(&epoch.rover, &aiding));
        batch.finish()
    } else {
        let mut estimator = Estimator::new(options);
        epochs.iter().map(|epoch| estimator.advance(&epoch.rover, &aiding)).collect()
    };
    let error = |(solution, epoch): (&graphfix::gnss::Solution, &SimulatedEpoch)| {
        let frame = graphfix::gnss::LocalFrame::at(epoch.position);
        let estimate = solution.estimate.as_ref().expect("every epoch is answered");
        frame.to_enu(estimate.position).0.xy().norm()
    };
    solutions.iter().zip(epochs).map(error).collect()
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

/// A minute without satellites: with odometry of the wheels the errors stay small, and without it
/// they do not.
#[test]
fn wheels_lead_through_a_tunnel() {
    let tunnel = 100..160;
    let drives = [1, 2].map(|seed| {
        let (simulator, mut epochs) = drive(seed, 180.0);
        epochs[tunnel.clone()].iter_mut().for_each(|e| e.rover.observations.clear());
        let bare = without_odometry(&epochs);
        (simulator, epochs, bare)
    });
    for (mode, batch) in [(Mode::Ekf, false), (Mode::Fgo, false), (Mode::Fgo, true)] {
        let options = PositioningOptions::new(mode, Profile::General);
        let (mut with_m, mut bare_m) = (Vec::new(), Vec::new());
        for (simulator, epochs, bare) in &drives {
            with_m.extend_from_slice(&errors_m(simulator, epochs, &options, batch)[tunnel.clone()]);
            bare_m.extend_from_slice(&errors_m(simulator, bare, &options, batch)[tunnel.clone()]);
        }
        let worst_m = with_m.iter().copied().fold(0.0, f64::max);
        // The limit allows for errors of 1 % in scale and 1° in heading over about 500 m, and for
        // the error at the entrance of the tunnel.
        assert!(worst_m < 30.0, "{mode:?} {batch}: {worst_m}");
        let (with_m, bare_m) = (mean(&with_m), mean(&bare_m));
        assert!(with_m < 0.5 * bare_m, "{mode:?} {batch}: {with_m} with, {bare_m} without");
    }
}

/// A receiver with pseudoranges only: its wheels average the canyon's multipath.
#[test]
fn wheels_improve_the_canyon() {
    let mut options = PositioningOptions::new(Mode::Ekf, Profile::General);
    options.set("doppler", "none").unwrap();
    options.set("phase", "off").unwrap();
    let drives = [1, 2, 3].map(|seed| drive(seed, 300.0));
    for mode in [Mode::Ekf, Mode::Fgo] {
        let options = PositioningOptions { mode, ..options.clone() };
        let (mut with_m, mut bare_m) = (Vec::new(), Vec::new());
        for (simulator, epochs) in &drives {
            with_m.extend(errors_m(simulator, epochs, &options, false));
            bare_m.extend(errors_m(simulator, &without_odometry(epochs), &options, false));
        }
        let (with_m, bare_m) = (mean(&with_m), mean(&bare_m));
        assert!(with_m < 0.7 * bare_m, "{mode:?}: {with_m} with, {bare_m} without");
    }
}

/// A displacement over another interval is not used, and the solution reports it.
#[test]
fn a_displacement_over_another_interval_is_left_out() {
    let (simulator, mut epochs) = drive(1, 20.0);
    for epoch in &mut epochs {
        epoch.rover.odometry = epoch.odometry.map(|o| Odometry { interval_s: 2.0, ..o });
    }
    let bare = without_odometry(&epochs);
    for mode in [Mode::Ekf, Mode::Fgo] {
        let answers = |epochs: &[SimulatedEpoch]| {
            let mut estimator = Estimator::new(PositioningOptions::new(mode, Profile::General));
            let aiding = Aiding::alone(simulator.navigation());
            let advance = |epoch: &SimulatedEpoch| estimator.advance(&epoch.rover, &aiding);
            epochs.iter().map(advance).collect::<Vec<_>>()
        };
        for (odd, plain) in answers(&epochs).iter().zip(answers(&bare)).skip(1) {
            assert_eq!(odd.estimate, plain.estimate);
            let codes: Vec<_> = odd.reasons.iter().map(|reason| reason.code()).collect();
            assert!(codes.contains(&"ODOMETRY_UNUSED"), "{mode:?}: {codes:?}");
        }
    }
}

/// A restart between two epochs changes no bit of later answers.
#[test]
fn a_snapshot_keeps_what_odometry_did() {
    let (simulator, epochs) = drive(2, 30.0);
    let aiding = Aiding::alone(simulator.navigation());
    for mode in [Mode::Ekf, Mode::Fgo] {
        let options = PositioningOptions::new(mode, Profile::UrbanVehicle);
        let mut whole = Estimator::new(options.clone());
        let mut restarted = Estimator::new(options.clone());
        for epoch in &epochs {
            restarted = Estimator::restore(options.clone(), &restarted.snapshot()).unwrap();
            let expected = whole.advance(&epoch.rover, &aiding);
            assert_eq!(restarted.advance(&epoch.rover, &aiding), expected, "{mode:?}");
        }
    }
}

/// The displacement as JSON. Unit tests cover the heading, because degrees change bits.
fn message(odometry: &Odometry) -> Value {
    let c = &odometry.covariance;
    json!({
        "intervalS": odometry.interval_s,
        "frame": odometry.frame.name(),
        "displacementM": odometry.displacement_m.as_slice(),
        "covarianceM2": [c[(0, 0)], c[(1, 1)], c[(2, 2)], c[(0, 1)], c[(0, 2)], c[(1, 2)]],
    })
}

fn epoch_message(seq: u64, epoch: &Epoch) -> Value {
    let mut value =
        serde_json::to_value(graphfix::contract::convert::epoch_message(seq, epoch)).unwrap();
    if let Some(odometry) = &epoch.odometry {
        value["odometry"] = message(odometry);
    }
    value
}

/// Both doors give the bits of the estimator, and both accept odometry.
#[tokio::test]
async fn both_doors_carry_odometry() {
    let (simulator, mut epochs) = drive(2, 9.0);
    for epoch in &mut epochs {
        let enu = |odometry| Odometry { frame: OdometryFrame::Enu, ..odometry };
        epoch.rover.odometry = epoch.odometry.map(enu);
    }
    let mut rinex = Vec::new();
    write_navigation(&mut rinex, simulator.navigation()).unwrap();
    let (navigation, _) = read_navigation(&rinex[..]).unwrap();
    let doors = Doors::open().await;
    assert!(doors.upload("/v1/navigation", rinex).await.0.is_success());
    for mode in [Mode::Ekf, Mode::Fgo] {
        let mut estimator = Estimator::new(PositioningOptions::new(mode, Profile::General));
        let aiding = Aiding::alone(&navigation);
        let own = epochs.iter().map(|epoch| estimator.advance(&epoch.rover, &aiding)).last();
        let own = own.unwrap().estimate.unwrap().position.0;
        let messages: Vec<_> = epochs.iter().map(|e| epoch_message(0, &e.rover)).collect();
        let body = json!({"mode": mode.name(), "epochs": messages});
        let (status, rest) = doors.post("/v1/solve", body.clone()).await;
        assert!(status.is_success(), "{rest}");
        let ecef = &rest["solutions"][9]["position"]["ecef"];
        let x = [&ecef["xM"], &ecef["yM"], &ecef["zM"]].map(|value| value.as_f64().unwrap());
        assert_eq!(x, [own.x, own.y, own.z], "{mode:?}");
        let request: v1::SolveOnceRequest = serde_json::from_value(body).unwrap();
        let mut client = PositioningClient::new(doors.router.clone());
        let grpc = client.solve_once(request).await.unwrap().into_inner();
        let grpc = grpc.solutions[9].position.clone().unwrap().ecef.unwrap();
        assert_eq!([grpc.x_m, grpc.y_m, grpc.z_m], [own.x, own.y, own.z], "{mode:?}");
    }
}

/// Odometry is stored with its epoch. A resent epoch with the same odometry has the same content;
/// without odometry it has other content.
#[tokio::test]
async fn odometry_is_part_of_an_epochs_content() {
    let doors = Doors::open().await;
    let path = format!("/v1/sessions/{}/epochs", doors.session().await);
    let mut epoch = crate::support::doors::epoch(1);
    epoch["odometry"] = json!({
        "intervalS": 1.0, "frame": "body", "displacementM": [8.0, 0.0, 0.0],
        "covarianceM2": [0.04, 0.01, 0.01, 0.0, 0.0, 0.0],
        "headingDeg": 90.0, "headingSigmaDeg": 2.0,
    });
    let (status, first) = doors.post(&path, json!({"epochs": [epoch.clone()]})).await;
    assert!(status.is_success(), "{first}");
    let (_, again) = doors.post(&path, json!({"epochs": [epoch.clone()]})).await;
    assert_eq!(again, first);
    epoch["odometry"]["displacementM"][0] = json!(9.0);
    let (_, other) = doors.post(&path, json!({"epochs": [epoch.clone()]})).await;
    assert_eq!(code(&other), "SEQUENCE_CONFLICT");
    epoch["seq"] = json!(2);
    epoch["odometry"]["frame"] = json!("ned");
    let (_, refused) = doors.post(&path, json!({"epochs": [epoch]})).await;
    assert_eq!(code(&refused), "INVALID_ODOMETRY");
    assert_eq!(refused["field"], "epochs[0].odometry.frame");
}
