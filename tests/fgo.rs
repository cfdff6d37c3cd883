//! Goldens of the factor graph on real and simulated recordings, and what must not break it.

use std::fs::File;
use std::io::BufReader;
use std::path::Path;

use graphfix::config::{Mode, PositioningOptions, Profile};
use graphfix::formats::rinex::{ObservationReader, read_navigation};
use graphfix::formats::{decompress, truth};
use graphfix::gnss::constants::SPEED_OF_LIGHT;
use graphfix::gnss::{Constellation, Cycles, Ecef, Epoch, GpsTime, LocalFrame, Navigation};
use graphfix::gnss::{Solution, Status};
use graphfix::positioning::{Aiding, Batch, Estimator};

use crate::data;

fn open(path: &Path) -> impl std::io::BufRead + use<> {
    decompress(BufReader::new(File::open(path).unwrap()))
}

/// A recording with its navigation data.
struct Recording {
    navigation: Navigation,
    epochs: Vec<Epoch>,
}

impl Recording {
    fn read(folder: &Path, rover: &str, navigation_files: &[&str]) -> Self {
        let mut navigation = Navigation::default();
        for file in navigation_files {
            navigation.merge(read_navigation(open(&folder.join(file))).unwrap().0);
        }
        let mut reader = ObservationReader::new(open(&folder.join(rover))).unwrap();
        let mut epoch = Epoch::new(GpsTime::from_ns(0));
        let mut epochs = Vec::new();
        while reader.read_epoch(&mut epoch).unwrap() {
            epochs.push(epoch.clone());
        }
        Self { navigation, epochs }
    }

    fn aiding(&self) -> Aiding<'_> {
        Aiding { navigation: &self.navigation }
    }

    fn causal(&self, profile: Profile) -> Vec<Solution> {
        let mut estimator = Estimator::new(PositioningOptions::new(Mode::Fgo, profile));
        self.epochs.iter().map(|epoch| estimator.advance(epoch, &self.aiding())).collect()
    }

    fn batch(&self, profile: Profile) -> Vec<Solution> {
        let mut batch = Batch::new(PositioningOptions::new(Mode::Fgo, profile));
        self.epochs.iter().for_each(|epoch| batch.push(epoch, &self.aiding()));
        batch.finish()
    }
}

fn canyon() -> Option<Recording> {
    let folder = data::set("tst-2019")?;
    let files = ["hksc1180.19n", "hksc1180.19b"];
    let mut recording = Recording::read(&folder, "COM3_190428_124409.obs", &files);
    let scored = 46_701.0..=47_185.5;
    recording.epochs.retain(|epoch| scored.contains(&epoch.time.seconds_of_week()));
    Some(recording)
}

/// Horizontal mean, deviation and maximum, mean of the height's error, share inside the ellipse.
struct Errors {
    mean_m: f64,
    deviation_m: f64,
    greatest_m: f64,
    up_m: f64,
    inside: f64,
}

impl Errors {
    fn of(solutions: &[Solution], truth: impl Fn(GpsTime) -> Ecef) -> Self {
        let (mut horizontal_m, mut up_m, mut inside) = (Vec::new(), 0.0, 0);
        for solution in solutions {
            let estimate = solution.estimate.as_ref().expect("every epoch is answered");
            let frame = LocalFrame::at(truth(solution.time));
            let error = frame.to_enu(estimate.position).0;
            let covariance = frame.covariance_to_enu(&estimate.covariance);
            let plane = covariance.fixed_view::<2, 2>(0, 0).try_inverse().unwrap();
            // 5.991: chi-square limit of two degrees of freedom at 95 %.
            inside += usize::from((error.xy().transpose() * plane * error.xy()).x < 5.991);
            horizontal_m.push(error.xy().norm());
            up_m += error.z;
        }
        let count = horizontal_m.len() as f64;
        let mean_m = horizontal_m.iter().sum::<f64>() / count;
        let squares: f64 = horizontal_m.iter().map(|error| (error - mean_m).powi(2)).sum();
        Self {
            mean_m,
            deviation_m: (squares / (count - 1.0)).sqrt(),
            greatest_m: horizontal_m.iter().copied().fold(0.0, f64::max),
            up_m: up_m / count,
            inside: inside as f64 / count,
        }
    }

    fn in_the_canyon(solutions: &[Solution]) -> Self {
        assert_eq!(solutions.len(), 485);
        let folder = data::set("tst-2019").unwrap();
        let rows = truth::read(open(&folder.join("truth.csv")), 2051).unwrap();
        Self::of(solutions, |time| {
            let row = rows.iter().find(|row| (row.time - time).abs() < 0.02);
            row.expect("truth is given on whole seconds").position
        })
    }
}

/// Wen & Hsu (2021), table 1, row FGO: 9.45, 8.06, 31.94 m. The maximum hangs on one epoch.
#[test]
fn the_paper_profile_gives_the_papers_row() {
    let Some(recording) = canyon() else { return };
    let errors = Errors::in_the_canyon(&recording.batch(Profile::Paper));
    assert!((9.3..=9.5).contains(&errors.mean_m), "{}", errors.mean_m);
    assert!((8.0..=8.1).contains(&errors.deviation_m), "{}", errors.deviation_m);
    assert!((30.0..=32.1).contains(&errors.greatest_m), "{}", errors.greatest_m);
}

#[test]
fn a_car_in_the_canyon_at_once() {
    let Some(recording) = canyon() else { return };
    let errors = Errors::in_the_canyon(&recording.causal(Profile::UrbanVehicle));
    assert!(errors.mean_m <= 2.9, "{}", errors.mean_m);
    assert!(errors.deviation_m <= 1.7, "{}", errors.deviation_m);
    assert!(errors.greatest_m <= 8.5, "{}", errors.greatest_m);
    assert!(0.9 <= errors.inside, "{}", errors.inside);
}

#[test]
fn a_car_in_the_canyon_smoothed() {
    let Some(recording) = canyon() else { return };
    let errors = Errors::in_the_canyon(&recording.batch(Profile::UrbanVehicle));
    assert!(errors.mean_m <= 2.4, "{}", errors.mean_m);
    assert!(errors.deviation_m <= 1.2, "{}", errors.deviation_m);
    assert!(errors.greatest_m <= 5.5, "{}", errors.greatest_m);
    assert!(errors.up_m.abs() < 7.0, "{}", errors.up_m);
    assert!(0.85 <= errors.inside, "{}", errors.inside);
}

/// No Doppler, an epoch every 30 s. Single points have 0.78 m.
#[test]
fn a_day_of_a_reference_station_smoothed() {
    let Some(folder) = data::set("hers-hert") else { return };
    let recording = Recording::read(&folder, "hers0010.18O", &["brdc0010.18n"]);
    let solutions = recording.batch(Profile::General);
    assert_eq!(solutions.len(), 2_880);
    let truth = Ecef::new(4_033_469.933_7, 23_673.103_1, 4_924_301.443_3);
    let errors = Errors::of(&solutions, |_| truth);
    assert!(errors.mean_m <= 0.6, "{}", errors.mean_m);
    assert!(0.9 <= errors.inside, "{}", errors.inside);
}

/// Revisions are one for each epoch, in order, and the same whatever cuts the stream into calls.
#[test]
fn every_epoch_is_revised_once() {
    let Some(mut recording) = canyon() else { return };
    recording.epochs.truncate(60);
    let options = PositioningOptions::new(Mode::Fgo, Profile::UrbanVehicle);
    let mut estimator = Estimator::revising(options);
    let mut revised = Vec::new();
    for epoch in &recording.epochs {
        estimator.advance(epoch, &recording.aiding());
        revised.extend(estimator.take_revisions());
    }
    revised.extend(estimator.finish());
    let times: Vec<_> = recording.epochs.iter().map(|epoch| epoch.time).collect();
    assert_eq!(revised.iter().map(|solution| solution.time).collect::<Vec<_>>(), times);
}

/// A clone goes on with the same bits; so does one copied into another's storage.
#[test]
fn clones_answer_alike() {
    let Some(recording) = canyon() else { return };
    let options = PositioningOptions::new(Mode::Fgo, Profile::UrbanVehicle);
    let mut estimator = Estimator::new(options);
    let mut spare = estimator.clone();
    for (index, epoch) in recording.epochs.iter().take(80).enumerate() {
        spare.clone_from(&estimator);
        let mut fresh = estimator.clone();
        let solution = estimator.advance(epoch, &recording.aiding());
        assert_eq!(spare.advance(epoch, &recording.aiding()), solution, "epoch {index}");
        assert_eq!(fresh.advance(epoch, &recording.aiding()), solution, "epoch {index}");
    }
}

/// Distances between two runs at the epochs from `from` on that both answered.
fn apart_m(a: &[Solution], b: &[Solution], from: usize) -> f64 {
    let pairs = a.iter().zip(b).skip(from);
    let distances = pairs.filter_map(|(a, b)| {
        Some(a.estimate.as_ref()?.position.distance_m(b.estimate.as_ref()?.position))
    });
    distances.fold(0.0, f64::max)
}

/// The receiver steps its clock by a millisecond: tag, pseudoranges and phases with it.
#[test]
fn a_clock_jump_moves_no_position() {
    let Some(mut recording) = canyon() else { return };
    recording.epochs.truncate(120);
    let plain = recording.causal(Profile::UrbanVehicle);
    let step_m = SPEED_OF_LIGHT * 1e-3;
    for epoch in recording.epochs.iter_mut().skip(60) {
        epoch.time = epoch.time + 1e-3;
        for observation in &mut epoch.observations {
            observation.pseudorange_m = observation.pseudorange_m.map(|range| range + step_m);
        }
    }
    let jumped = recording.causal(Profile::UrbanVehicle);
    assert!(jumped.iter().all(|solution| solution.status == Status::Fgo));
    // Phases keep their clock; the tag's millisecond moves satellites and car by centimetres.
    let apart_m = apart_m(&plain, &jumped, 0);
    assert!(apart_m < 1.0, "{apart_m}");
}

#[test]
fn gaps_and_duplicates_are_survived() {
    let Some(mut recording) = canyon() else { return };
    let duplicate = recording.epochs[50].clone();
    recording.epochs.insert(51, duplicate);
    recording.epochs.drain(100..300);
    let solutions = recording.causal(Profile::UrbanVehicle);
    assert_eq!(solutions[51].status, Status::Single);
    let graph = solutions.iter().filter(|solution| solution.status == Status::Fgo).count();
    assert_eq!(graph, solutions.len() - 1);
}

#[test]
fn few_satellites_are_coasted_with_a_reason() {
    let Some(mut recording) = canyon() else { return };
    recording.epochs.truncate(100);
    for epoch in &mut recording.epochs[50..55] {
        let kept: Vec<_> = epoch.by_satellite().take(3).map(|(satellite, _)| satellite).collect();
        epoch.observations.retain(|observation| kept.contains(&observation.satellite));
    }
    recording.epochs[56].observations.clear();
    let solutions = recording.causal(Profile::UrbanVehicle);
    assert!(solutions.iter().all(|solution| solution.status == Status::Fgo));
    for weak in solutions[50..55].iter().chain([&solutions[56]]) {
        let codes: Vec<_> = weak.reasons.iter().map(|reason| reason.code()).collect();
        assert!(codes.contains(&"TOO_FEW_SATELLITES"), "{codes:?}");
    }
}

#[test]
fn one_constellation_alone_is_enough() {
    let Some(recording) = canyon() else { return };
    for constellation in [Constellation::Gps, Constellation::BeiDou] {
        let mut options = PositioningOptions::new(Mode::Fgo, Profile::UrbanVehicle);
        options.set("systems", &constellation.letter().to_string()).unwrap();
        let mut estimator = Estimator::new(options);
        let solutions: Vec<_> = recording.epochs[..120]
            .iter()
            .map(|epoch| estimator.advance(epoch, &recording.aiding()))
            .collect();
        let graph = solutions.iter().filter(|solution| solution.status == Status::Fgo).count();
        assert!(60 < graph, "{constellation:?}: {graph}");
    }
}

/// A satellite's slip of a thousand cycles, unflagged, is judged by the kernel.
#[test]
fn an_unflagged_slip_moves_nothing_far() {
    let Some(mut recording) = canyon() else { return };
    recording.epochs.truncate(100);
    let plain = recording.causal(Profile::UrbanVehicle);
    let slipped = recording.epochs[60].observations[0].satellite;
    for epoch in recording.epochs.iter_mut().skip(60) {
        for observation in epoch.observations.iter_mut().filter(|o| o.satellite == slipped) {
            let slip = |phase: Cycles| Cycles(phase.0 + 1_000.0);
            observation.carrier_phase = observation.carrier_phase.map(slip);
        }
    }
    let apart_m = apart_m(&plain, &recording.causal(Profile::UrbanVehicle), 0);
    assert!(apart_m < 2.0, "{apart_m}");
}
