//! Goldens of single-point positioning: real and simulated recordings against surveyed, measured
//! or simulated truth, by the same path as `graphfix solve`.

use graphfix::config::{Mode, PositioningOptions, Profile};
use graphfix::gnss::{Ecef, Reason};
use graphfix::positioning::{Aiding, Estimator};

use super::measured::{self, near};
use crate::support::data;
use crate::support::reading::{epochs, navigation};
use crate::support::recording::{Errors, Recording, canyon};

/// Wen & Hsu (2021), table 1, row WLS, which is RTKLIB's single mode: 17.39, 16.01, 94.43 m.
#[test]
fn the_paper_profile_gives_the_papers_row() {
    let Some(recording) = canyon() else { return };
    let errors = Errors::in_the_canyon(&recording.causal(Mode::Spp, Profile::Paper));
    near(&[
        ("mean (m)", errors.mean_m, 17.39, 0.05),
        ("deviation (m)", errors.deviation_m, 16.01, 0.05),
        ("maximum (m)", errors.greatest_m, 94.43, 0.2),
    ]);
}

#[test]
fn the_default_profile_is_better_in_the_canyon() {
    let Some(recording) = canyon() else { return };
    let solutions = recording.causal(Mode::Spp, Profile::General);
    measured::SPP_CANYON.holds(&Errors::in_the_canyon(&solutions));
}

const SPIRENT_NAVIGATION: [&str; 2] = ["RINEX_GN_Spirent.23N", "RINEX_EN_Spirent.23L"];

/// The 3D error at 95 % is at most 35 mm over 601 epochs. What remains comes from the simulator's
/// own troposphere mapping.
#[test]
fn simulated_receivers_are_placed_within_centimetres() {
    let Some(folder) = data::set("spirent-rtk") else { return };
    let solved = |file: &str| {
        let recording = Recording::read(&folder, file, &SPIRENT_NAVIGATION);
        recording.causal(Mode::Spp, Profile::General)
    };
    let moving = solved("Rover-dynamic_MO_Spirent.obs");
    let standing = solved("Rover-static-2km-east_MO_Spirent.obs");
    let truth = Ecef::new(4_156_857.119_592_9, 673_209.028_774_142, 4_774_767.031_055_44);
    assert_eq!(standing.len(), 601);
    for errors in [Errors::on_the_simulator(&folder, &moving), Errors::of(&standing, |_| truth)] {
        assert!(errors.spatial_95_m <= 0.035, "{}", errors.spatial_95_m);
    }
}

/// The truth is IGS coordinates. RTKLIB's single mode has 0.90 m in the horizontal mean and 1.83 m
/// at 95 %.
#[test]
fn a_day_of_a_reference_station() {
    let Some(folder) = data::set("hers-hert") else { return };
    let recording = Recording::read(&folder, "hers0010.18O", &["brdc0010.18n"]);
    let solutions = recording.causal(Mode::Spp, Profile::General);
    assert_eq!(solutions.len(), 2_880);
    let truth = Ecef::new(4_033_469.933_7, 23_673.103_1, 4_924_301.443_3);
    measured::SPP_STATION.holds(&Errors::of(&solutions, |_| truth));
}

/// An estimator that has seen earlier epochs and a new one give the same position to 0.1 mm, if the
/// epoch has redundancy. Epochs without redundancy are left out: they use differences between the
/// clocks that are known from earlier epochs.
#[test]
fn the_previous_position_decides_nothing() {
    let Some(folder) = data::set("tst-2019") else { return };
    let navigation = navigation(&folder, &["hksc1180.19n", "hksc1180.19b"]);
    let aiding = Aiding::alone(&navigation);
    let options = PositioningOptions::new(Mode::Spp, Profile::General);
    let mut running = Estimator::new(options.clone());
    let mut moved = Vec::new();
    for epoch in epochs(&folder.join("COM3_190428_124409.obs")).iter().take(600) {
        let solution = running.advance(epoch, &aiding);
        let cold = Estimator::new(options.clone()).advance(epoch, &aiding);
        if cold.estimate.is_none() || cold.reasons.contains(&Reason::NoRedundancy) {
            continue;
        }
        match (&cold.estimate, &solution.estimate) {
            (Some(cold), Some(warm)) => moved.push(cold.position.distance_m(warm.position)),
            _ => panic!("{}: answered from one start only", epoch.time),
        }
    }
    let greatest_m = moved.iter().copied().fold(0.0, f64::max);
    assert!(500 < moved.len() && greatest_m < 1e-4, "{} epochs, {greatest_m} m", moved.len());
}

/// Counts the epochs that have a position in a walk and three drives. They have a wrong ephemeris,
/// receiver clocks that differ by a kilometre between constellations, and few satellites. Epochs
/// without a position have fewer than four satellites with known clocks.
#[test]
fn epochs_with_sound_satellites_are_answered() {
    let answered = |set: &str, rover: &str, navigation: &[&str]| {
        let folder = data::set(set)?;
        let recording = Recording::read(&folder, rover, navigation);
        let solutions = recording.causal(Mode::Spp, Profile::General);
        Some((solutions.iter().filter(|s| s.estimate.is_some()).count(), solutions.len()))
    };
    let walk = answered("shanghai-walk", "rover-convbin.obs.gz", &["rover.nav"]);
    assert!(walk.is_none_or(|counts| counts == (1_206, 1_206)), "{walk:?}");
    let navigation = ["21c", "21g", "21l", "21n", "21q"].map(|kind| format!("hkqt137c.{kind}"));
    let navigation = navigation.each_ref().map(String::as_str);
    for (rover, least) in [("google.pixel4", 780), ("huawei.p40pro", 670), ("xiaomi.mi8", 750)] {
        let drive = answered("urbannav-tst", &format!("{rover}.obs.gz"), &navigation);
        assert!(drive.is_none_or(|(count, _)| least <= count), "{rover}: {drive:?}");
    }
}
