//! Cost and memory of `rtk-fgo`: `cargo bench --bench rtk`.
//!
//! A rover is simulated under open sky, with all constellations on two frequencies, a base 8 km
//! away and an epoch each 30 s for 24 h. Measures the time of an epoch in the first and in the last
//! hours, each the minimum of several passes, and the memory of the estimator of a session at rest
//! that revises its answers.

use std::hint::black_box;
use std::time::Instant;

use allocation_counter::measure;
use graphfix::config::{Mode, PositioningOptions, Profile};
use graphfix::gnss::{BaseStation, Constellation, Navigation, Status};
use graphfix::positioning::{Aiding, BaseAiding, EstimatorState, Scratch};
use graphfix::simulation::{Scenario, SimulatedEpoch, Simulator};

const PASSES: usize = 3;
const HOURS: usize = 24;
const EPOCHS_AN_HOUR: usize = 120;

struct Recording {
    navigation: Navigation,
    station: BaseStation,
    epochs: Vec<SimulatedEpoch>,
}

fn simulated() -> Recording {
    let open = Scenario::by_name("rtk-open").expect("the scenario exists");
    let scenario = Scenario {
        duration_s: 3_600.0 * HOURS as f64,
        interval_s: 3_600.0 / EPOCHS_AN_HOUR as f64,
        constellations: Constellation::ALL.to_vec(),
        ..open
    };
    let simulator = Simulator::new(scenario, 1);
    let navigation = Navigation::clone(simulator.navigation());
    let antenna_reference_point = simulator.base_position().expect("the scenario has a base");
    let station = BaseStation { name: "base".to_owned(), antenna_reference_point };
    Recording { navigation, station, epochs: simulator.collect() }
}

fn main() {
    let recording = simulated();
    let options = PositioningOptions::new(Mode::RtkFgo, Profile::General);
    let mut least_us = vec![f64::INFINITY; recording.epochs.len()];
    let (mut fixed, mut held, mut seen) = (0, 0, 0);
    for pass in 0..PASSES {
        let mut state = EstimatorState::new(options.clone(), true);
        let mut scratch = Scratch::default();
        for (epoch, least_us) in recording.epochs.iter().zip(&mut least_us) {
            let base = BaseAiding { station: &recording.station, epochs: epoch.base.as_slice() };
            let aiding = Aiding { navigation: &recording.navigation, base: Some(base) };
            let begin = Instant::now();
            let solution = black_box(state.advance(&epoch.rover, &aiding, &mut scratch));
            black_box(state.take_revisions());
            *least_us = least_us.min(begin.elapsed().as_secs_f64() * 1e6);
            if pass == 0 {
                fixed += usize::from(solution.status == Status::Fixed);
                seen += epoch.rover.by_satellite().count();
                let mut copy = None;
                held = held.max(measure(|| copy = Some(state.clone())).bytes_current);
            }
        }
    }
    let count = recording.epochs.len();
    println!("{count} epochs, {fixed} fixed, {:.1} satellites each", seen as f64 / count as f64);
    println!("held at rest at the most: {held} bytes\n");
    println!("| hour | median of an epoch (µs) | 99 % |\n|---|---|---|");
    for hour in [0, 1, 5, 11, 17, 22, HOURS - 1] {
        let mut times = least_us[EPOCHS_AN_HOUR * hour..EPOCHS_AN_HOUR * (hour + 1)].to_vec();
        times.sort_unstable_by(f64::total_cmp);
        let (middle, late) = (times[times.len() / 2], times[times.len() * 99 / 100]);
        println!("| {} | {middle:.0} | {late:.0} |", hour + 1);
    }
}
