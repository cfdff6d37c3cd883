//! Cost of the factor graph: `cargo bench --bench fgo`.
//!
//! Measures one causal update, from observations to solution, of a warm window of 30 epochs on an
//! urban drive; the same in the first and in the tenth hour of a simulated drive; and the batch.
//! The time of an epoch is its minimum over several passes, which excludes other load of the
//! machine. Asserts that a warm window allocates only its answer, the epoch that it adds, and what
//! the receiver model learns.
//!
//! The drive is `tst-2019` of the data folder (`GRAPHFIX_DATA`, else `../shared/data`); without it
//! only the simulated drives are measured.

use std::fs::File;
use std::hint::black_box;
use std::io::BufReader;
use std::path::{Path, PathBuf};
use std::time::Instant;

use allocation_counter::measure;
use graphfix::config::{Mode, PositioningOptions, Profile};
use graphfix::formats::decompress;
use graphfix::formats::rinex::{ObservationReader, read_navigation};
use graphfix::gnss::{Constellation, Epoch, GpsTime, Navigation, Observation};
use graphfix::positioning::{Aiding, Batch, Estimator, EstimatorState, Scratch};
use graphfix::simulation::{Scenario, Simulator};

/// Number of epochs until the storage has its final size.
const WARM: usize = 200;
const PASSES: usize = 15;
/// Number of lists of an epoch in the window, including their shared owner.
const EPOCH_LISTS: u64 = 9;
/// Most lists that the receiver model allocates for an epoch without a comparison of hypotheses.
const LEARNT_LISTS: u64 = 20;
/// The same with the comparison of hypotheses, which is due every two seconds.
const COMPARED_LISTS: u64 = 85;
/// Largest difference in memory between the epochs of two windows (bytes).
const KEPT_MAX: i64 = 100_000;
/// The part of the recording that the paper evaluates (seconds of week).
const SCORED_S: std::ops::RangeInclusive<f64> = 46_701.0..=47_185.5;

struct Drive {
    navigation: Navigation,
    epochs: Vec<Epoch>,
}

impl Drive {
    /// Mean number of satellites observed in an epoch.
    fn satellites(&self) -> f64 {
        let seen: usize = self.epochs.iter().map(|epoch| epoch.by_satellite().count()).sum();
        seen as f64 / self.epochs.len() as f64
    }

    /// The first epochs of the drive, with some constellations only.
    fn of(&self, constellations: &[Constellation], count: usize) -> Self {
        let mut epochs = self.epochs[..count].to_vec();
        let is_kept = |o: &Observation| constellations.contains(&o.satellite.constellation);
        epochs.iter_mut().for_each(|epoch| epoch.observations.retain(is_kept));
        Self { navigation: self.navigation.clone(), epochs }
    }
}

fn open(path: &Path) -> Option<impl std::io::BufRead + use<>> {
    Some(decompress(BufReader::new(File::open(path).ok()?)))
}

fn recording() -> Option<Drive> {
    let root = std::env::var_os("GRAPHFIX_DATA").map_or_else(
        || Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data"),
        PathBuf::from,
    );
    let folder = root.join("tst-2019");
    let mut navigation = Navigation::default();
    for file in ["hksc1180.19n", "hksc1180.19b"] {
        navigation.merge(read_navigation(open(&folder.join(file))?).ok()?.0);
    }
    let path = folder.join("COM3_190428_124409.obs");
    let mut reader = ObservationReader::new(open(&path)?).ok()?;
    let mut epoch = Epoch::new(GpsTime::from_ns(0));
    let mut epochs = Vec::new();
    while reader.read_epoch(&mut epoch).ok()? {
        epochs.push(epoch.clone());
    }
    Some(Drive { navigation, epochs })
}

fn simulated(hours: f64) -> Drive {
    let scenario = Scenario::by_name("urban-canyon").expect("the scenario exists");
    let scenario = Scenario { base: None, duration_s: 3_600.0 * hours, ..scenario };
    let simulator = Simulator::new(scenario, 1);
    let navigation = Navigation::clone(simulator.navigation());
    Drive { navigation, epochs: simulator.map(|at| at.rover).collect() }
}

fn options(settings: &[(&str, &str)]) -> PositioningOptions {
    let mut options = PositioningOptions::new(Mode::Fgo, Profile::UrbanVehicle);
    for (key, value) in settings {
        options.set(key, value).expect("the options exist");
    }
    options
}

const HUBER: [(&str, &str); 3] =
    [("pseudorange_kernel", "huber"), ("phase", "off"), ("window_s", "30")];
const ANNEALED: [(&str, &str); 1] = [("window_s", "30")];
/// Two constellations, with about ten satellites in view of the simulated car.
const TWO: [Constellation; 2] = [Constellation::Gps, Constellation::Galileo];

/// The minimum time of each epoch (µs), from a fresh estimator on.
fn update_times_us(drive: &Drive, settings: &[(&str, &str)], passes: usize) -> Vec<f64> {
    let aiding = Aiding::alone(&drive.navigation);
    let mut least = vec![f64::INFINITY; drive.epochs.len()];
    for _ in 0..passes {
        let mut estimator = Estimator::new(options(settings));
        for (epoch, least) in drive.epochs.iter().zip(&mut least) {
            let begin = Instant::now();
            black_box(estimator.advance(epoch, &aiding));
            *least = least.min(begin.elapsed().as_secs_f64() * 1e6);
        }
    }
    least
}

fn quantile(times: &[f64], share: f64) -> f64 {
    let mut sorted = times.to_vec();
    sorted.sort_unstable_by(f64::total_cmp);
    sorted[((sorted.len() - 1) as f64 * share).round() as usize]
}

fn print_updates(name: &str, times_us: &[f64]) {
    let (median, late) = (quantile(times_us, 0.5), quantile(times_us, 0.999));
    println!("| {name} | {median:.1} | {late:.1} | {:.2} |", late / median);
}

/// A warm update allocates the lists of its answer, of the epoch that it adds and of what it learns
/// only, and keeps nothing more over half an hour.
///
/// As in a session, a spare copy of the state advances in shared memory and replaces it.
fn assert_few_allocations(drive: &Drive, settings: &[(&str, &str)], [usual, most]: [u64; 2]) {
    let aiding = Aiding::alone(&drive.navigation);
    let mut state = EstimatorState::new(options(settings), false);
    let (mut spare, mut scratch) = (state.clone(), Scratch::default());
    let (mut solution, mut kept, mut lists) = (None, 0, Vec::new());
    for (index, epoch) in drive.epochs.iter().enumerate() {
        let advanced = measure(|| {
            spare.clone_from(&state);
            solution = Some(spare.advance(epoch, &aiding, &mut scratch));
            std::mem::swap(&mut spare, &mut state);
        });
        let copied = measure(|| drop(black_box(solution.clone())));
        let dropped = measure(|| drop(solution.take()));
        if drive.epochs.len() / 2 <= index {
            let own = advanced.count_total.saturating_sub(copied.count_total);
            assert!(own <= EPOCH_LISTS + most, "epoch {index}: {own}");
            lists.push(own);
            kept += advanced.bytes_current + dropped.bytes_current;
        }
    }
    lists.sort_unstable();
    // Hypotheses are compared in every second epoch. These epochs allocate the most lists.
    let without = lists[2 * lists.len() / 5];
    assert!(without <= EPOCH_LISTS + usual, "{without} lists in two of five epochs");
    assert!(kept < KEPT_MAX, "{kept} bytes");
}

/// Memory of an estimator at rest (bytes), and the mean number of satellites in its epochs.
fn held(drive: &Drive) -> (i64, f64) {
    let aiding = Aiding::alone(&drive.navigation);
    let mut scratch = Scratch::default();
    let epochs = &drive.epochs[..2 * WARM];
    let mut state = None;
    let held = measure(|| {
        let fresh = state.insert(EstimatorState::new(options(&ANNEALED), false));
        epochs.iter().for_each(|epoch| drop(fresh.advance(epoch, &aiding, &mut scratch)));
    });
    let grown = measure(|| drop(std::mem::take(&mut scratch)));
    let held = held.bytes_current + grown.bytes_current;
    let seen: usize = epochs[WARM..].iter().map(|epoch| epoch.by_satellite().count()).sum();
    (held, seen as f64 / WARM as f64)
}

/// Time of the whole batch, and of its part after the last epoch: solution and answers (ms).
fn batch_ms(epochs: &[Epoch], navigation: &Navigation, passes: usize) -> [f64; 2] {
    let aiding = Aiding::alone(navigation);
    let mut least = [f64::INFINITY; 2];
    for _ in 0..passes {
        let begin = Instant::now();
        let mut batch = Batch::new(options(&[]));
        epochs.iter().for_each(|epoch| batch.push(epoch, &aiding));
        let pushed = Instant::now();
        black_box(batch.finish());
        for (least, since) in least.iter_mut().zip([begin, pushed]) {
            *least = least.min(since.elapsed().as_secs_f64() * 1e3);
        }
    }
    least
}

fn main() {
    println!("| one update of 30 epochs | median (µs) | 99.9 % (µs) | ratio |\n|---|---|---|---|");
    let recorded = recording();
    if let Some(drive) = &recorded {
        let mean = drive.satellites();
        println!("| `tst-2019`, {} epochs, {mean:.1} satellites each | | | |", drive.epochs.len());
        print_updates("Huber", &update_times_us(drive, &HUBER, PASSES)[WARM..]);
        print_updates("annealed", &update_times_us(drive, &ANNEALED, PASSES)[WARM..]);
    }
    let hours = simulated(10.0);
    let ten = hours.of(&TWO, 3_600);
    let mean = ten.satellites();
    println!("| simulated, {mean:.1} satellites each | | | |");
    print_updates("Huber", &update_times_us(&ten, &HUBER, 5)[WARM..]);
    print_updates("annealed", &update_times_us(&ten, &ANNEALED, 5)[WARM..]);
    println!("| simulated, {:.1} satellites each | | | |", hours.satellites());
    let times_us = update_times_us(&hours, &ANNEALED, 3);
    for hour in [0, 4, 9] {
        let end = 3_600 * (hour + 1);
        let name = format!("annealed, simulated, hour {}", hour + 1);
        print_updates(&name, &times_us[(3_600 * hour).max(WARM)..end]);
    }
    for drive in recorded.iter().chain([&hours]) {
        let (bytes, satellites) = held(drive);
        println!("\nheld at rest: {bytes} bytes, {satellites:.1} satellites an epoch");
    }
    println!("\n| batch | (ms) | solved and answered (ms) | an epoch (µs) |\n|---|---|---|---|");
    let print = |name: &str, epochs: &[Epoch], navigation: &Navigation, passes| {
        let [whole, solved] = batch_ms(epochs, navigation, passes);
        let (count, each) = (epochs.len(), 1e3 * whole / epochs.len() as f64);
        println!("| {name}, {count} epochs | {whole:.1} | {solved:.1} | {each:.1} |");
    };
    if let Some(Drive { navigation, epochs }) = &recorded {
        let scored = |epoch: &&Epoch| SCORED_S.contains(&epoch.time.seconds_of_week());
        let scored: Vec<_> = epochs.iter().filter(scored).cloned().collect();
        print("`tst-2019`", &scored, navigation, PASSES);
    }
    for count in [3_600, 36_000] {
        print("simulated", &hours.epochs[..count], &hours.navigation, 2);
    }
    let hour = Drive { epochs: hours.epochs[..3_600].to_vec(), ..hours };
    assert_few_allocations(&hour, &HUBER, [0, 0]);
    assert_few_allocations(&hour, &ANNEALED, [LEARNT_LISTS, COMPARED_LISTS]);
}
