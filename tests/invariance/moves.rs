//! Receivers that are elsewhere after a pause, and how soon each mode is there, too.

use graphfix::config::{Mode, PositioningOptions, Profile};
use graphfix::gnss::{
    BaseStation, Constellation, Ecef, Enu, Epoch, LocalFrame, Navigation, Reason, Solution, Status,
};
use graphfix::positioning::{Aiding, BaseAiding, Batch, Estimator};
use graphfix::simulation::{Motion, Scenario, Simulator};
use nalgebra::Vector3;

/// An epoch of rover and base, and the rover's true position.
struct Seen {
    rover: Epoch,
    base: Option<Epoch>,
    truth: Ecef,
}

/// A rover that rests for a minute, is off for `pause_s`, and rests `away_m` to the east for
/// another minute. The base stays.
fn carried(scenario: &Scenario, pause_s: f64, away_m: f64) -> (Vec<Seen>, Navigation) {
    let scenario = Scenario { motion: Motion::Static, ..scenario.clone() };
    let (whole, seen) = (Scenario { duration_s: 600.0, ..scenario.clone() }, Vec::new());
    let navigation = Simulator::new(whole, 1).navigation().clone();
    let here = LocalFrame::at(scenario.origin.to_ecef());
    let there = here.to_ecef(Enu(Vector3::new(away_m, 0.0, 0.0)));
    let base = scenario.base.map(|base| here.to_ecef(base));
    let later = Scenario {
        start: scenario.start + (60.0 + pause_s),
        origin: there.to_geodetic(),
        base: base.map(|base| LocalFrame::at(there).to_enu(base)),
        ..scenario.clone()
    };
    let parts = [Scenario { duration_s: 60.0, ..scenario }, Scenario { duration_s: 60.0, ..later }];
    let seen = parts.into_iter().fold(seen, |mut seen, part| {
        let epochs = Simulator::with_navigation(part, 7, navigation.clone());
        seen.extend(epochs.map(|epoch| Seen {
            rover: epoch.rover,
            base: epoch.base,
            truth: epoch.position,
        }));
        seen
    });
    (seen, Navigation::clone(&navigation))
}

/// The true position of the base.
fn base_of(scenario: &Scenario) -> Ecef {
    LocalFrame::at(scenario.origin.to_ecef()).to_ecef(scenario.base.unwrap())
}

/// Each answer, and its distance from the truth (m), if it has a position.
fn answered(
    mode: Mode,
    antenna_reference_point: Ecef,
    seen: &[Seen],
    navigation: &Navigation,
) -> Vec<(Solution, Option<f64>)> {
    let mut estimator = Estimator::new(PositioningOptions::new(mode, Profile::General));
    let station = BaseStation { name: "base".into(), antenna_reference_point };
    let answer = |Seen { rover, base, truth }: &Seen| {
        let epochs = base.as_slice();
        let base = mode.is_relative().then_some(BaseAiding { station: &station, epochs });
        let solution = estimator.advance(rover, &Aiding { navigation, base });
        let off_m = solution.estimate.as_ref().map(|e| e.position.distance_m(*truth));
        (solution, off_m)
    };
    seen.iter().map(answer).collect()
}

/// Kilometres away, farther than any search for reflections reaches: at once with all modes.
#[test]
fn a_receiver_that_was_carried_away_is_found_again() {
    for (pause_s, away_m) in [(1.0, 3e3), (10.0, 20e3), (60.0, 8e3)] {
        let scenario = Scenario::open_sky();
        let (seen, navigation) = carried(&scenario, pause_s, away_m);
        for mode in [Mode::Fgo, Mode::Ekf] {
            let answers = answered(mode, base_of(&scenario), &seen, &navigation);
            let after = if mode == Mode::Fgo { 61 } else { 61 + 15 };
            for (second, (_, off_m)) in answers.iter().enumerate().skip(after) {
                let off_m = off_m.unwrap();
                assert!(off_m < 20.0, "{mode:?} {pause_s} {away_m}: {off_m} m at {second}");
            }
        }
    }
}

#[test]
fn a_rover_that_was_carried_away_is_fixed_again() {
    for (pause_s, away_m) in [(2.0, 4e3), (20.0, 3e3), (80.0, 2.5e3)] {
        let scenario = Scenario::rtk_open();
        let (seen, navigation) = carried(&scenario, pause_s, away_m);
        let answers = answered(Mode::RtkFgo, base_of(&scenario), &seen, &navigation);
        let fixed = |part: &[(Solution, Option<f64>)]| {
            let fixed = part.iter().filter(|(solution, _)| solution.status == Status::Fixed);
            assert!(fixed.clone().all(|(_, off_m)| off_m.unwrap() < 0.1), "{pause_s} {away_m}");
            fixed.count()
        };
        let (before, after) = answers.split_at(61);
        assert!(50 < fixed(before) && 50 < fixed(after), "{pause_s} {away_m}: {}", fixed(after));
    }
}

/// A rover of 140 s whose epochs of 20 s are missing. With `slips`, the phases after that differ by
/// whole cycles from satellite to satellite. No flag tells.
fn paused(mode: Mode, slips: bool) -> Vec<(Solution, Option<f64>)> {
    let scenario = Scenario { duration_s: 140.0, ..Scenario::rtk_open() };
    let base = base_of(&scenario);
    let simulator = Simulator::new(scenario, 5);
    let navigation = Navigation::clone(simulator.navigation());
    let mut seen: Vec<Seen> = simulator
        .map(|epoch| Seen { rover: epoch.rover, base: epoch.base, truth: epoch.position })
        .collect();
    for observation in seen[80..].iter_mut().flat_map(|seen| &mut seen.rover.observations) {
        observation.loss_of_lock = false;
        let cycles = f64::from(observation.satellite.number) * 37.0 % 97.0 - 48.0;
        if let (true, Some(phase)) = (slips, &mut observation.carrier_phase) {
            phase.0 += cycles;
        }
    }
    seen.drain(60..80);
    answered(mode, base, &seen, &navigation)
}

/// The phases after a pause agree, so their integers stay.
#[test]
fn integers_survive_a_pause_without_slips() {
    for mode in [Mode::RtkFgo, Mode::RtkEkf] {
        let answers = paused(mode, false);
        assert_eq!(answers[59].0.status, Status::Fixed);
        for (solution, off_m) in &answers[60..] {
            assert_eq!(solution.status, Status::Fixed);
            assert!(off_m.unwrap() < 0.1, "{mode:?}: {off_m:?}");
        }
    }
}

/// A receiver that lost all satellites in a pause: the arcs from before end, and new integers are
/// found at once. If the arcs went on, a few phases that agree by chance would hold a position 4 m
/// off for 45 s.
#[test]
fn phases_that_all_slip_in_a_pause_are_found_out() {
    for mode in [Mode::RtkFgo, Mode::RtkEkf] {
        let answers = paused(mode, true);
        assert_eq!(answers[59].0.status, Status::Fixed);
        let after = &answers[60..];
        for (second, (solution, off_m)) in after.iter().enumerate() {
            let (status, off_m) = (solution.status, off_m.unwrap());
            let least_m = if status == Status::Fixed { 0.1 } else { 1.5 };
            assert!(off_m < least_m, "{mode:?}: {status:?} {off_m} at {second}");
        }
        let fixed = after.iter().filter(|(solution, _)| solution.status == Status::Fixed).count();
        assert!(50 < fixed, "{mode:?}: {fixed}");
    }
}

/// Where no arc continues from epoch to epoch, each is fixed from itself. None is fixed elsewhere.
#[test]
fn sparse_epochs_are_fixed_where_the_rover_is() {
    let (mut fixed, mut count) = (0, 0);
    for (seed, interval_s) in [(1, 40.0), (2, 60.0), (3, 80.0), (4, 100.0)] {
        let scenario = Scenario {
            duration_s: 100.0 * interval_s,
            interval_s,
            constellations: vec![Constellation::Gps, Constellation::Galileo],
            ..Scenario::rtk_open().with_baseline(1_000.0)
        };
        let base = base_of(&scenario);
        let simulator = Simulator::new(scenario, seed);
        let navigation = Navigation::clone(simulator.navigation());
        let seen: Vec<Seen> = simulator
            .map(|epoch| Seen { rover: epoch.rover, base: epoch.base, truth: epoch.position })
            .collect();
        for (solution, off_m) in answered(Mode::RtkFgo, base, &seen, &navigation) {
            count += 1;
            if solution.status == Status::Fixed {
                fixed += 1;
                assert!(off_m.unwrap() < 0.5, "{interval_s}: {off_m:?}");
            }
        }
    }
    assert!(count < 4 * fixed, "{fixed} of {count}");
}

/// An even number of satellites at 10 Hz: the median of the changes of their clocks has no bias,
/// which would add up, so the pseudoranges are used.
#[test]
fn an_even_number_of_satellites_keeps_its_clock() {
    let scenario = Scenario { duration_s: 90.0, interval_s: 0.1, ..Scenario::open_sky() };
    let simulator = Simulator::new(scenario, 3);
    let navigation = Navigation::clone(simulator.navigation());
    let mut estimator = Estimator::new(PositioningOptions::new(Mode::Fgo, Profile::General));
    let mut rejecting = 0;
    for mut epoch in simulator {
        let mut satellites: Vec<_> = epoch.rover.observations.iter().map(|o| o.satellite).collect();
        satellites.dedup();
        satellites.truncate(12);
        assert_eq!(satellites.len(), 12);
        epoch.rover.observations.retain(|o| satellites.contains(&o.satellite));
        let solution = estimator.advance(&epoch.rover, &Aiding::alone(&navigation));
        let is_rejecting = |reason: &Reason| matches!(reason, Reason::ResidualsTooLarge { .. });
        rejecting += usize::from(solution.reasons.iter().any(is_rejecting));
    }
    assert!(rejecting < 9, "{rejecting} of 901 epochs");
}

/// The batch has a proven start where the window that precedes it has one.
#[test]
fn a_batch_under_open_sky_is_proven() {
    let simulator = Simulator::new(Scenario { duration_s: 60.0, ..Scenario::open_sky() }, 1);
    let navigation = Navigation::clone(simulator.navigation());
    let mut batch = Batch::new(PositioningOptions::new(Mode::Fgo, Profile::General));
    simulator.for_each(|epoch| batch.push(&epoch.rover, &Aiding::alone(&navigation)));
    for solution in batch.finish() {
        let is_unproven = |reason: &Reason| matches!(reason, Reason::StartUnproven { .. });
        assert!(!solution.reasons.iter().any(is_unproven), "{:?}", solution.reasons);
        assert!(solution.protection.unwrap().horizontal_m < 50.0);
    }
}

/// When the corrections end, the position that had integers goes on by its phases.
#[test]
fn a_lost_base_costs_no_position() {
    let scenario = Scenario { duration_s: 150.0, ..Scenario::rtk_open() };
    let base = base_of(&scenario);
    let simulator = Simulator::new(scenario, 2);
    let navigation = Navigation::clone(simulator.navigation());
    let mut seen: Vec<Seen> = simulator
        .map(|epoch| Seen { rover: epoch.rover, base: epoch.base, truth: epoch.position })
        .collect();
    seen[61..].iter_mut().for_each(|seen| seen.base = None);
    let answers = answered(Mode::RtkFgo, base, &seen, &navigation);
    assert_eq!(answers[85].0.status, Status::Fixed);
    for (second, (solution, off_m)) in answers.iter().enumerate().skip(92).take(50) {
        assert_eq!(solution.status, Status::Fgo);
        assert!(off_m.unwrap() < 0.6, "{off_m:?} at {second}");
        assert!(solution.protection.unwrap().horizontal_m < 50.0, "at {second}");
    }
}

/// A base whose stated position changes by 5 m moves the positions relative to it by as much. In the
/// profile `static` nothing of the earlier position is left at the next epoch with the base, also
/// if no epoch of the base is at hand when it moves. The move is reported once.
#[test]
fn a_base_that_is_stated_elsewhere_moves_a_rover_at_rest() {
    let scenario = Scenario { duration_s: 120.0, motion: Motion::Static, ..Scenario::rtk_open() };
    let stated = base_of(&scenario);
    let moved = LocalFrame::at(stated).to_ecef(Enu(Vector3::new(3.0, 4.0, 0.0)));
    for (mode, missing) in [(Mode::RtkFgo, 0..0), (Mode::RtkFgo, 50..70), (Mode::RtkEkf, 50..70)] {
        let simulator = Simulator::new(scenario.clone(), 2);
        let navigation = Navigation::clone(simulator.navigation());
        let mut options = PositioningOptions::new(mode, Profile::Static);
        options.rtk.base_age_max_s = 5.0;
        let mut estimator = Estimator::new(options);
        let mut reported = Vec::new();
        for (second, epoch) in simulator.enumerate() {
            let antenna_reference_point = if second < 60 { stated } else { moved };
            let station = BaseStation { name: "base".into(), antenna_reference_point };
            let epochs = if missing.contains(&second) { &[] } else { epoch.base.as_slice() };
            let base = Some(BaseAiding { station: &station, epochs });
            let aiding = Aiding { navigation: &navigation, base };
            let solution = estimator.advance(&epoch.rover, &aiding);
            let is_moved = |reason: &Reason| matches!(reason, Reason::BaseMoved { .. });
            reported.extend(solution.reasons.iter().any(is_moved).then_some(second));
            if solution.reasons.iter().any(|reason| matches!(reason, Reason::BaseStale { .. })) {
                continue;
            }
            let expected = epoch.position.0 + (antenna_reference_point.0 - stated.0);
            let off_m = solution.estimate.unwrap().position.distance_m(Ecef(expected));
            let least_m = if solution.status == Status::Fixed { 0.1 } else { 2.5 };
            assert!(off_m < least_m, "{mode:?} {:?}: {off_m} m at {second}", solution.status);
            assert!(second != 119 || solution.status == Status::Fixed);
        }
        assert_eq!(reported, [60]);
    }
}

/// Phases of epochs 5 s apart, without Doppler: the start of each solve is metres off, and exact
/// fits of a few phases are minima near it. The answers are about as good as those of each second.
#[test]
fn sparse_phases_without_doppler_find_the_position() {
    let mut off_m = Vec::new();
    for seed in 1..=3 {
        let scenario = Scenario { duration_s: 900.0, interval_s: 5.0, ..Scenario::open_sky() };
        let simulator = Simulator::new(scenario, seed);
        let navigation = Navigation::clone(simulator.navigation());
        let mut estimator = Estimator::new(PositioningOptions::new(Mode::Fgo, Profile::General));
        for mut epoch in simulator {
            epoch.rover.observations.iter_mut().for_each(|o| o.doppler_hz = None);
            let solution = estimator.advance(&epoch.rover, &Aiding::alone(&navigation));
            off_m.extend(solution.estimate.map(|e| e.position.distance_m(epoch.position)));
        }
    }
    off_m.sort_unstable_by(f64::total_cmp);
    assert_eq!(off_m.len(), 3 * 181);
    assert!(off_m[off_m.len() * 95 / 100] < 6.0 && off_m[off_m.len() - 1] < 12.0, "{off_m:?}");
}
