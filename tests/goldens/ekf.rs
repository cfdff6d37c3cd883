//! Goldens of the Kalman filter on real recordings.

use graphfix::config::{Mode, PositioningOptions, Profile};
use graphfix::gnss::{Ecef, Status};
use graphfix::positioning::Estimator;

use super::measured;
use crate::support::data;
use crate::support::recording::{Errors, Recording, canyon};

/// Wen & Hsu (2021), table 1, row EKF: 13.61, 15.19, 88.97 m, with settings that are not published.
#[test]
fn the_paper_profile_errs_like_the_papers_filter() {
    let Some(recording) = canyon() else { return };
    let solutions = recording.causal(Mode::Ekf, Profile::Paper);
    measured::EKF_CANYON_PAPER.holds(&Errors::in_the_canyon(&solutions));
}

#[test]
fn in_the_canyon_the_filter_beats_single_points_and_is_honest() {
    let Some(recording) = canyon() else { return };
    for (profile, measured) in [
        (Profile::UrbanVehicle, measured::EKF_CANYON_VEHICLE),
        (Profile::General, measured::EKF_CANYON_GENERAL),
    ] {
        let solutions = recording.causal(Mode::Ekf, profile);
        assert!(solutions.iter().all(|solution| solution.status == Status::Ekf));
        measured.holds(&Errors::in_the_canyon(&solutions));
    }
}

/// No Doppler, an epoch every 30 s. [`measured::SPP_STATION`] has the single-point errors.
#[test]
fn a_day_of_a_reference_station() {
    let Some(folder) = data::set("hers-hert") else { return };
    let recording = Recording::read(&folder, "hers0010.18O", &["brdc0010.18n"]);
    let solutions = recording.causal(Mode::Ekf, Profile::General);
    assert_eq!(solutions.len(), 2_880);
    let truth = Ecef::new(4_033_469.933_7, 23_673.103_1, 4_924_301.443_3);
    measured::EKF_STATION.holds(&Errors::of(&solutions, |_| truth));
}

/// A clone continues with the same bits, also one that `clone_from` copies into an older estimator.
#[test]
fn clones_answer_alike() {
    let Some(recording) = canyon() else { return };
    let mut estimator = Estimator::new(PositioningOptions::new(Mode::Ekf, Profile::UrbanVehicle));
    let mut spare = estimator.clone();
    for (index, epoch) in recording.epochs.iter().take(80).enumerate() {
        spare.clone_from(&estimator);
        let mut fresh = estimator.clone();
        let solution = estimator.advance(epoch, &recording.aiding());
        assert_eq!(spare.advance(epoch, &recording.aiding()), solution, "epoch {index}");
        assert_eq!(fresh.advance(epoch, &recording.aiding()), solution, "epoch {index}");
    }
}

/// Observations in reverse order move no position by 1 µm, and as many satellites are used.
#[test]
fn the_order_of_satellites_changes_nothing() {
    let Some(mut recording) = canyon() else { return };
    recording.epochs.truncate(60);
    let expected = recording.causal(Mode::Ekf, Profile::UrbanVehicle);
    for epoch in &mut recording.epochs {
        epoch.observations.reverse();
    }
    let reversed = recording.causal(Mode::Ekf, Profile::UrbanVehicle);
    assert_eq!((expected.len(), reversed.len()), (60, 60));
    for (a, b) in expected.iter().zip(&reversed) {
        let (a, b) = (a.estimate.as_ref().unwrap(), b.estimate.as_ref().unwrap());
        assert!(a.position.distance_m(b.position) < 1e-6);
        assert_eq!(a.satellites_used, b.satellites_used);
    }
}
