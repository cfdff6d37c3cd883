//! Disturbances that an estimator with memory must survive. Most are tested with each kind of
//! answer.
//!
//! The rover is simulated under open sky. So the truth is exact, and errors beyond those of
//! `nothing_happens` are caused by the disturbance.

use graphfix::config::{Mode, PositioningOptions, Profile};
use graphfix::gnss::constants::SPEED_OF_LIGHT;
use graphfix::gnss::{
    Constellation, Cycles, Ecef, Epoch, GpsTime, LocalFrame, Observation, Solution, Status,
};
use graphfix::positioning::{Aiding, Batch, Estimator};
use graphfix::simulation::{Scenario, Simulator};

/// A kind of answer.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Kind {
    Ekf,
    Causal,
    FixedLag,
    Batch,
}

const KINDS: [Kind; 4] = [Kind::Ekf, Kind::Causal, Kind::FixedLag, Kind::Batch];

/// A recording with its truth.
struct Drive {
    simulator: Simulator,
    epochs: Vec<Epoch>,
    truth: Vec<(GpsTime, Ecef)>,
}

impl Drive {
    /// Simulates three constellations whose wavelengths do not depend on a GLONASS channel.
    fn new(duration_s: f64) -> Self {
        let constellations =
            vec![Constellation::Gps, Constellation::Galileo, Constellation::BeiDou];
        let scenario = Scenario { duration_s, constellations, ..Scenario::open_sky() };
        let simulator = Simulator::new(scenario, 11);
        let (epochs, truth) =
            simulator.clone().map(|e| (e.rover.clone(), (e.rover.time, e.position))).unzip();
        Self { simulator, epochs, truth }
    }

    fn solve(&self, kind: Kind) -> Vec<Solution> {
        let aiding = Aiding::alone(self.simulator.navigation());
        let mode = if kind == Kind::Ekf { Mode::Ekf } else { Mode::Fgo };
        let options = PositioningOptions::new(mode, Profile::General);
        let mut estimator = match kind {
            Kind::Ekf | Kind::Causal => Estimator::new(options),
            Kind::FixedLag => Estimator::revising(options),
            Kind::Batch => {
                let mut batch = Batch::new(options);
                self.epochs.iter().for_each(|epoch| batch.push(epoch, &aiding));
                return batch.finish();
            }
        };
        let mut solutions = Vec::new();
        for epoch in &self.epochs {
            let solution = estimator.advance(epoch, &aiding);
            match kind {
                Kind::FixedLag => solutions.extend(estimator.take_revisions()),
                _ => solutions.push(solution),
            }
        }
        solutions.extend(estimator.finish());
        solutions
    }

    /// Error of a solution against the truth nearest to its time (m).
    fn error_m(&self, solution: &Solution) -> f64 {
        let away = |row: &&(GpsTime, Ecef)| (row.0 - solution.time).abs();
        let nearest = self.truth.iter().min_by(|a, b| away(a).total_cmp(&away(b))).unwrap();
        let estimate = solution.estimate.as_ref().expect("checked to be there");
        LocalFrame::at(nearest.1).to_enu(estimate.position).0.xy().norm()
    }

    /// Every epoch is answered by the filter or graph itself, and no error exceeds `limit_m`.
    fn assert_all(&self, limit_m: f64, what: &str) {
        for kind in KINDS {
            let solutions = self.solve(kind);
            assert_eq!(solutions.len(), self.epochs.len(), "{what}, {kind:?}");
            self.assert_each(&solutions, kind, limit_m, what);
        }
    }

    fn assert_each(&self, solutions: &[Solution], kind: Kind, limit_m: f64, what: &str) {
        let status = if kind == Kind::Ekf { Status::Ekf } else { Status::Fgo };
        for (index, solution) in solutions.iter().enumerate() {
            assert_eq!(solution.status, status, "{what}, {kind:?}, {index}: {solution:?}");
            let error_m = self.error_m(solution);
            assert!(error_m < limit_m, "{what}, {kind:?}, {index}: {error_m} m");
        }
    }

    fn each_observation(&mut self, from: usize, mut change: impl FnMut(&mut Observation)) {
        for epoch in self.epochs.iter_mut().skip(from) {
            epoch.observations.iter_mut().for_each(&mut change);
        }
    }
}

/// Without a disturbance errors are below 3 m: the reference for the limits of the other tests.
#[test]
fn nothing_happens() {
    Drive::new(120.0).assert_all(3.0, "nothing");
}

#[test]
fn satellites_appear_and_vanish() {
    let mut drive = Drive::new(150.0);
    for (second, epoch) in drive.epochs.iter_mut().enumerate() {
        // Satellites with odd and with even numbers take turns of seven seconds. At each change no
        // satellite of the previous epoch remains.
        let half = (second / 7 % 2) as u8;
        epoch.observations.retain(|o| o.satellite.number % 2 == half);
    }
    drive.assert_all(6.0, "half the sky at a time");
}

#[test]
fn minutes_without_epochs() {
    let mut drive = Drive::new(500.0);
    // One gap is shorter and one is longer than the gap that restarts an estimator.
    drive.epochs.drain(320..480);
    drive.epochs.drain(60..150);
    drive.assert_all(6.0, "gaps");
}

/// The car turns while there are no epochs for half a minute. So the next solve begins up to a
/// hundred metres off. The first position afterwards is as good as the next one.
#[test]
fn half_a_minute_without_epochs() {
    let mut drive = Drive::new(260.0);
    drive.epochs.drain(200..233);
    drive.epochs.drain(105..138);
    let solutions = drive.solve(Kind::Causal);
    for first in [105, 200 - 33] {
        assert_eq!(solutions[first].time - solutions[first - 1].time, 34.0);
        let [at_first, at_next] = [first, first + 1].map(|k| drive.error_m(&solutions[k]));
        assert!((at_first - at_next).abs() < 0.3, "{first}: {at_first} m, then {at_next} m");
    }
}

/// In each epoch the second band of one satellite is three kilometres off. It is left out, and does
/// not shift the delay between the bands that the other satellites show: in the mean of all of them
/// positions would move by 0.4 to 2 m.
#[test]
fn a_wild_pseudorange_of_a_second_band_moves_nothing() {
    let mut drive = Drive::new(120.0);
    let undisturbed = KINDS.map(|kind| drive.solve(kind));
    for (second, epoch) in drive.epochs.iter_mut().enumerate() {
        let satellites = epoch.by_satellite().count();
        let (wild, _) = epoch.by_satellite().nth(second % satellites).unwrap();
        let of_wild = epoch.observations.iter_mut().filter(|o| o.satellite == wild);
        let second_band = of_wild.skip(1).find_map(|o| o.pseudorange_m.as_mut()).unwrap();
        *second_band += 3_000.0;
    }
    for (kind, undisturbed) in KINDS.into_iter().zip(undisturbed) {
        let disturbed = drive.solve(kind);
        assert_eq!(disturbed.len(), undisturbed.len(), "{kind:?}");
        let position = |solution: &Solution| solution.estimate.as_ref().unwrap().position;
        let apart_m = |(a, b): (&Solution, &Solution)| position(a).distance_m(position(b));
        let most_m = undisturbed.iter().zip(&disturbed).map(apart_m).fold(0.0, f64::max);
        assert!(most_m < 0.3, "{kind:?}: {most_m} m");
    }
}

/// The clock steps by a millisecond in the time tag and the pseudoranges, with and without a step
/// of the phases.
#[test]
fn the_clock_steps_by_a_millisecond() {
    for (with_phase, steps_ms) in [(false, 1.0), (true, 1.0), (true, -1.0)] {
        let mut drive = Drive::new(120.0);
        let step_m = SPEED_OF_LIGHT * 1e-3 * steps_ms;
        drive.epochs.iter_mut().skip(60).for_each(|e| e.time = e.time + 1e-3 * steps_ms);
        drive.each_observation(60, |observation| {
            let frequency_hz = observation.signal().frequency_hz(None).unwrap();
            let moved = |phase: Cycles| Cycles(phase.0 + step_m * frequency_hz / SPEED_OF_LIGHT);
            observation.pseudorange_m = observation.pseudorange_m.map(|range| range + step_m);
            if with_phase {
                observation.carrier_phase = observation.carrier_phase.map(moved);
            }
        });
        drive.assert_all(3.0, "a millisecond");
    }
}

#[test]
fn three_satellites_or_none() {
    let mut drive = Drive::new(120.0);
    let three = |epoch: &mut Epoch| {
        let kept: Vec<_> = epoch.by_satellite().take(3).map(|(satellite, _)| satellite).collect();
        epoch.observations.retain(|observation| kept.contains(&observation.satellite));
    };
    three(&mut drive.epochs[50]);
    drive.epochs[80..85].iter_mut().for_each(three);
    drive.epochs[100].observations.clear();
    drive.assert_all(6.0, "three satellites");
    for kind in KINDS {
        let solutions = drive.solve(kind);
        for index in [50, 82, 100] {
            let codes: Vec<_> = solutions[index].reasons.iter().map(|r| r.code()).collect();
            assert!(codes.contains(&"TOO_FEW_SATELLITES"), "{kind:?}, {index}: {codes:?}");
        }
    }
}

#[test]
fn one_constellation_alone() {
    for constellation in [Constellation::Gps, Constellation::Galileo, Constellation::BeiDou] {
        let mut drive = Drive::new(90.0);
        for epoch in &mut drive.epochs {
            epoch.observations.retain(|o| o.satellite.constellation == constellation);
        }
        drive.assert_all(6.0, &format!("{constellation:?} alone"));
    }
    // The satellites change from one constellation to another, without an epoch that has both.
    let mut drive = Drive::new(120.0);
    for (second, epoch) in drive.epochs.iter_mut().enumerate() {
        let turn = match second / 40 {
            0 => Constellation::Galileo,
            1 => Constellation::Gps,
            _ => Constellation::BeiDou,
        };
        epoch.observations.retain(|o| o.satellite.constellation == turn);
    }
    drive.assert_all(8.0, "one constellation after the other");
}

/// Observations that an epoch contains twice change no bit.
#[test]
fn satellites_sent_twice() {
    let plain = Drive::new(60.0);
    let mut doubled = Drive::new(60.0);
    for epoch in &mut doubled.epochs {
        epoch.observations.extend_from_within(..);
    }
    for kind in KINDS {
        assert_eq!(doubled.solve(kind), plain.solve(kind), "{kind:?}");
    }
}

/// Epochs that are sent twice or late are answered by single-point positioning. The others are
/// answered as without them.
#[test]
fn epochs_sent_twice_or_late() {
    let plain = Drive::new(90.0);
    let mut drive = Drive::new(90.0);
    let (twice, late) = (drive.epochs[40].clone(), drive.epochs[70].clone());
    drive.epochs.insert(75, late);
    drive.epochs.insert(41, twice);
    for kind in KINDS {
        let (all, expected) = (drive.solve(kind), plain.solve(kind));
        let (single, own): (Vec<_>, Vec<_>) =
            all.into_iter().partition(|solution| solution.status == Status::Single);
        assert_eq!(own, expected, "{kind:?}");
        // An epoch that did not enter the window is not revised.
        assert_eq!(single.len(), if kind == Kind::FixedLag { 0 } else { 2 }, "{kind:?}");
        plain.assert_each(&own, kind, 3.0, "epochs twice or late");
    }
}
