//! Recordings with truth: their solutions and the errors of these.

use std::path::Path;

use graphfix::config::{Mode, PositioningOptions, Profile};
use graphfix::formats::truth;
use graphfix::gnss::{Ecef, Epoch, GpsTime, LocalFrame, Navigation, Solution};
use graphfix::positioning::{Aiding, Batch, Estimator};

use super::data;
use super::reading::{epochs, navigation, open};

/// A recording with its navigation data.
pub(crate) struct Recording {
    pub(crate) navigation: Navigation,
    pub(crate) epochs: Vec<Epoch>,
}

impl Recording {
    pub(crate) fn read(folder: &Path, rover: &str, navigation_files: &[&str]) -> Self {
        let navigation = navigation(folder, navigation_files);
        Self { navigation, epochs: epochs(&folder.join(rover)) }
    }

    pub(crate) fn aiding(&self) -> Aiding<'_> {
        Aiding::alone(&self.navigation)
    }

    pub(crate) fn causal(&self, mode: Mode, profile: Profile) -> Vec<Solution> {
        let mut estimator = Estimator::new(PositioningOptions::new(mode, profile));
        self.epochs.iter().map(|epoch| estimator.advance(epoch, &self.aiding())).collect()
    }

    /// Each epoch's answer when it has left the window.
    pub(crate) fn smoothed(&self, profile: Profile) -> Vec<Solution> {
        let mut estimator = Estimator::revising(PositioningOptions::new(Mode::Fgo, profile));
        let mut revisions = Vec::new();
        for epoch in &self.epochs {
            estimator.advance(epoch, &self.aiding());
            revisions.extend(estimator.take_revisions());
        }
        revisions.extend(estimator.finish());
        revisions
    }

    pub(crate) fn batch(&self, profile: Profile) -> Vec<Solution> {
        let mut batch = Batch::new(PositioningOptions::new(Mode::Fgo, profile));
        self.epochs.iter().for_each(|epoch| batch.push(epoch, &self.aiding()));
        batch.finish()
    }
}

/// The scored part of `tst-2019`.
pub(crate) fn canyon() -> Option<Recording> {
    let folder = data::set("tst-2019")?;
    let files = ["hksc1180.19n", "hksc1180.19b"];
    let mut recording = Recording::read(&folder, "COM3_190428_124409.obs", &files);
    let scored = 46_701.0..=47_185.5;
    recording.epochs.retain(|epoch| scored.contains(&epoch.time.seconds_of_week()));
    Some(recording)
}

/// Mean, standard deviation and maximum of the horizontal errors, mean height error, 95 % of the 3D
/// errors, and fraction inside the stated 95 % ellipse.
pub(crate) struct Errors {
    pub(crate) mean_m: f64,
    pub(crate) deviation_m: f64,
    pub(crate) greatest_m: f64,
    pub(crate) up_m: f64,
    pub(crate) spatial_95_m: f64,
    pub(crate) inside: f64,
}

impl Errors {
    pub(crate) fn of(solutions: &[Solution], truth: impl Fn(GpsTime) -> Ecef) -> Self {
        let (mut horizontal_m, mut spatial_m) = (Vec::new(), Vec::new());
        let (mut up_m, mut inside) = (0.0, 0);
        for solution in solutions {
            let estimate = solution.estimate.as_ref().expect("every epoch is answered");
            let frame = LocalFrame::at(truth(solution.time));
            let error = frame.to_enu(estimate.position).0;
            let covariance = frame.covariance_to_enu(&estimate.covariance);
            let plane = covariance.fixed_view::<2, 2>(0, 0).try_inverse().unwrap();
            // 5.991: chi-square limit of two degrees of freedom at 95 %.
            inside += usize::from((error.xy().transpose() * plane * error.xy()).x < 5.991);
            horizontal_m.push(error.xy().norm());
            spatial_m.push(error.norm());
            up_m += error.z;
        }
        let count = horizontal_m.len() as f64;
        let mean_m = horizontal_m.iter().sum::<f64>() / count;
        spatial_m.sort_by(f64::total_cmp);
        let squares: f64 = horizontal_m.iter().map(|error| (error - mean_m).powi(2)).sum();
        Self {
            mean_m,
            deviation_m: (squares / (count - 1.0)).sqrt(),
            greatest_m: horizontal_m.iter().copied().fold(0.0, f64::max),
            up_m: up_m / count,
            spatial_95_m: spatial_m[(spatial_m.len() - 1) * 95 / 100],
            inside: inside as f64 / count,
        }
    }

    pub(crate) fn in_the_canyon(solutions: &[Solution]) -> Self {
        assert_eq!(solutions.len(), 485);
        let folder = data::set("tst-2019").unwrap();
        let rows = truth::read(open(&folder.join("truth.csv")), 2051).unwrap();
        Self::of(solutions, |time| {
            let row = rows.iter().find(|row| (row.time - time).abs() < 0.02);
            row.expect("truth is given on whole seconds").position
        })
    }

    /// Errors of the moving receiver of `spirent-rtk`.
    pub(crate) fn on_the_simulator(folder: &Path, solutions: &[Solution]) -> Self {
        let rows = truth::read(open(&folder.join("truth-dynamic.csv")), 2244).unwrap();
        assert_eq!(solutions.len(), 601);
        Self::of(solutions, |time| {
            let row = rows.iter().find(|row| (row.time - time).abs() < 1e-3);
            row.expect("truth at every epoch").position
        })
    }
}
