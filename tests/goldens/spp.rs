//! Goldens of single-point positioning: real and simulated recordings against surveyed, measured
//! or simulated truth, by the same path as `graphfix solve`.

use graphfix::config::{Mode, PositioningOptions, Profile};
use graphfix::formats::truth;
use graphfix::gnss::{Ecef, Epoch, GpsTime, LocalFrame, Navigation, Solution};
use graphfix::positioning::{Aiding, Estimator};

use crate::support::data;
use crate::support::reading::{epochs, navigation, open};

fn options(profile: Profile, overrides: &[(&str, &str)]) -> PositioningOptions {
    let mut options = PositioningOptions::new(Mode::Spp, profile);
    for (key, value) in overrides {
        options.set(key, value).unwrap();
    }
    options
}

fn solve(epochs: &[Epoch], navigation: &Navigation, options: PositioningOptions) -> Vec<Solution> {
    let mut estimator = Estimator::new(options);
    epochs.iter().map(|epoch| estimator.advance(epoch, &Aiding::alone(navigation))).collect()
}

/// Errors of the epochs answered.
struct Errors {
    horizontal_m: Vec<f64>,
    spatial_m: Vec<f64>,
    /// Share of horizontal errors inside the stated 95 % ellipse.
    inside: f64,
}

impl Errors {
    fn of(solutions: &[Solution], truth: impl Fn(GpsTime) -> Ecef) -> Self {
        let (mut horizontal_m, mut spatial_m, mut inside) = (Vec::new(), Vec::new(), 0);
        for solution in solutions {
            let Some(estimate) = &solution.estimate else { continue };
            let frame = LocalFrame::at(truth(solution.time));
            let error = frame.to_enu(estimate.position).0;
            let covariance = frame.covariance_to_enu(&estimate.covariance);
            let plane = covariance.fixed_view::<2, 2>(0, 0).try_inverse().unwrap();
            // 5.991: chi-square limit of two degrees of freedom at 95 %.
            inside += usize::from((error.xy().transpose() * plane * error.xy()).x < 5.991);
            horizontal_m.push(error.xy().norm());
            spatial_m.push(error.norm());
        }
        horizontal_m.sort_by(f64::total_cmp);
        spatial_m.sort_by(f64::total_cmp);
        let inside = inside as f64 / horizontal_m.len() as f64;
        Self { horizontal_m, spatial_m, inside }
    }
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

fn deviation(values: &[f64]) -> f64 {
    let mean = mean(values);
    let squares: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
    (squares / (values.len() - 1) as f64).sqrt()
}

fn percentile_95(sorted: &[f64]) -> f64 {
    sorted[(sorted.len() - 1) * 95 / 100]
}

/// Mean, standard deviation and greatest horizontal error on the paper's scored span, and coverage.
fn urban(profile: Profile) -> Option<([f64; 3], f64)> {
    let folder = data::set("tst-2019")?;
    let navigation = navigation(&folder, &["hksc1180.19n", "hksc1180.19b"]);
    let mut epochs = epochs(&folder.join("COM3_190428_124409.obs"));
    epochs.retain(|epoch| (46_701.0..=47_185.5).contains(&epoch.time.seconds_of_week()));
    let rows = truth::read(open(&folder.join("truth.csv")), 2051).unwrap();
    let solutions = solve(&epochs, &navigation, options(profile, &[]));
    let errors = Errors::of(&solutions, |time| {
        let second = rows.iter().filter(|row| (row.time - time).abs() < 0.02);
        second.map(|row| row.position).next().expect("truth is given on whole seconds")
    });
    assert_eq!(errors.horizontal_m.len(), 485, "every epoch is answered");
    let horizontal = &errors.horizontal_m;
    Some(([mean(horizontal), deviation(horizontal), horizontal[484]], errors.inside))
}

/// Wen & Hsu (2021), table 1, row WLS, which is RTKLIB's single mode: 17.39, 16.01, 94.43 m.
#[test]
fn the_paper_profile_gives_the_papers_row() {
    let Some(([mean, deviation, greatest], _)) = urban(Profile::Paper) else { return };
    assert!((mean - 17.39).abs() <= 0.05, "{mean}");
    assert!((deviation - 16.01).abs() <= 0.05, "{deviation}");
    assert!((greatest - 94.43).abs() <= 0.2, "{greatest}");
}

/// 11.2/14.6/87.6 m when written; a tenth more fails.
#[test]
fn the_default_profile_is_better_in_the_canyon() {
    let Some(([mean, deviation, greatest], inside)) = urban(Profile::General) else { return };
    assert!(mean < 12.3 && deviation < 15.6 && greatest < 93.0, "{mean} {deviation} {greatest}");
    assert!(0.70 < inside, "{inside} of the errors are inside the stated ellipse");
}

const SPIRENT_NAVIGATION: [&str; 2] = ["RINEX_GN_Spirent.23N", "RINEX_EN_Spirent.23L"];

/// 3D 95 % of at most 35 mm, 601 of 601: what is left is the simulator's own troposphere mapping.
#[test]
fn simulated_receivers_are_placed_within_centimetres() {
    let Some(folder) = data::set("spirent-rtk") else { return };
    let navigation = navigation(&folder, &SPIRENT_NAVIGATION);
    let rows = truth::read(open(&folder.join("truth-dynamic.csv")), 2244).unwrap();
    let moving = |time: GpsTime| {
        let row = rows.iter().find(|row| (row.time - time).abs() < 1e-3);
        row.expect("truth at every epoch").position
    };
    let standing = |_| Ecef::new(4_156_857.119_592_9, 673_209.028_774_142, 4_774_767.031_055_44);
    let judge = |file: &str, truth: &dyn Fn(GpsTime) -> Ecef| {
        let epochs = epochs(&folder.join(file));
        let solutions = solve(&epochs, &navigation, options(Profile::General, &[]));
        let errors = Errors::of(&solutions, truth);
        assert_eq!(errors.spatial_m.len(), 601);
        let error_m = percentile_95(&errors.spatial_m);
        assert!(error_m <= 0.035, "{file}: {error_m}");
    };
    judge("Rover-dynamic_MO_Spirent.obs", &moving);
    judge("Rover-static-2km-east_MO_Spirent.obs", &standing);
}

/// IGS coordinates; RTKLIB's single mode has 0.90 and 1.83 m.
#[test]
fn a_day_of_a_reference_station() {
    let Some(folder) = data::set("hers-hert") else { return };
    let navigation = navigation(&folder, &["brdc0010.18n"]);
    let epochs = epochs(&folder.join("hers0010.18O"));
    let solutions = solve(&epochs, &navigation, options(Profile::General, &[]));
    let truth = Ecef::new(4_033_469.933_7, 23_673.103_1, 4_924_301.443_3);
    let errors = Errors::of(&solutions, |_| truth);
    assert_eq!(errors.horizontal_m.len(), 2_880);
    let (mean, late) = (mean(&errors.horizontal_m), percentile_95(&errors.horizontal_m));
    assert!(mean <= 0.80 && late <= 1.60, "{mean} {late}");
    assert!(0.90 < errors.inside, "{} of the errors are inside the ellipse", errors.inside);
}

/// The start moves no answer by more than 0.1 mm.
#[test]
fn the_previous_position_decides_nothing() {
    let Some(folder) = data::set("tst-2019") else { return };
    let navigation = navigation(&folder, &["hksc1180.19n", "hksc1180.19b"]);
    let aiding = Aiding::alone(&navigation);
    let options = options(Profile::General, &[]);
    let mut running = Estimator::new(options.clone());
    let mut moved = Vec::new();
    for epoch in epochs(&folder.join("COM3_190428_124409.obs")).iter().take(600) {
        let solution = running.advance(epoch, &aiding);
        let cold = Estimator::new(options.clone()).advance(epoch, &aiding);
        match (&cold.estimate, &solution.estimate) {
            (Some(cold), Some(warm)) => moved.push(cold.position.distance_m(warm.position)),
            (None, None) => {}
            _ => panic!("{}: answered from one start only", epoch.time),
        }
    }
    let greatest_m = moved.iter().copied().fold(0.0, f64::max);
    assert!(500 < moved.len() && greatest_m < 1e-4, "{} epochs, {greatest_m} m", moved.len());
}
