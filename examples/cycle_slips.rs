//! What each cycle-slip detector finds, misses and invents.
//!
//! Run: `cargo run --release --example cycle_slips [SEEDS]`. First come simulations, which know every
//! slip: of the slips that the receiver did not announce, the share that each detector found, by
//! size; of the phases that went on, how many each detector doubted. Then real recordings of the
//! data folder (`GRAPHFIX_DATA`, else `../shared/data`), where only counts can be given.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};

use graphfix::config::{Mode, PositioningOptions, Profile};
use graphfix::formats::decompress;
use graphfix::formats::rinex::{ObservationReader, read_navigation};
use graphfix::gnss::{Ecef, Epoch, GpsTime, Navigation, Observation};
use graphfix::positioning::{
    Aiding, AntennaMotion, AntennaPosition, Estimator, KnownSatellite, PhaseArc, SlipCause,
    SlipTracker,
};
use graphfix::simulation::{Motion, PhaseTruth, ReceiverErrors, Scenario, Simulator};

/// A receiver that slips often and never says so.
fn slipping(errors: ReceiverErrors, cycles: (f64, f64), together: bool) -> ReceiverErrors {
    ReceiverErrors {
        slips_per_hour: 6.0,
        slips_reported: 0.0,
        slip_cycles: cycles,
        slips_together: together,
        half_cycle_s: 0.0,
        ..errors
    }
}

fn main() {
    let seeds = std::env::args().nth(1).map_or(4, |text| text.parse().expect("a count of seeds"));
    let open = || Scenario { duration_s: 1_800.0, base: None, ..Scenario::open_sky() };
    let canyon = || Scenario { base: None, ..Scenario::urban_canyon() };
    let with = |scenario: Scenario, errors: ReceiverErrors, frequencies: usize| Scenario {
        rover_errors: Some(errors),
        frequencies,
        ..scenario
    };
    let (good, urban) = (ReceiverErrors::open_sky(), ReceiverErrors::urban());
    let still = Scenario { motion: Motion::Static, ..open() };
    let half_minute = Scenario { interval_s: 30.0, duration_s: 21_600.0, ..still.clone() };
    let one = |errors| slipping(errors, (1.0, 1.0), false);
    let moving = AntennaMotion::Moving;
    for (title, scenario, motion) in [
        ("open sky, 1 Hz, one frequency, one cycle", with(open(), one(good), 1), moving),
        ("open sky, 1 Hz, two frequencies, one cycle on one", with(open(), one(good), 2), moving),
        (
            "open sky, 1 Hz, two frequencies, one cycle on both",
            with(open(), slipping(good, (1.0, 1.0), true), 2),
            moving,
        ),
        (
            "static, 30 s, two frequencies, one cycle on one",
            with(half_minute.clone(), one(ReceiverErrors { slips_per_hour: 1.0, ..good }), 2),
            AntennaMotion::Static,
        ),
        (
            "static, 30 s, one frequency, one cycle",
            with(half_minute, one(ReceiverErrors { slips_per_hour: 1.0, ..good }), 1),
            AntennaMotion::Static,
        ),
        ("canyon, 1 Hz, one frequency, one cycle", with(canyon(), one(urban), 1), moving),
        (
            "canyon, 1 Hz, two frequencies, 1 to 5 cycles on one",
            with(canyon(), slipping(urban, (1.0, 5.0), false), 2),
            moving,
        ),
        (
            "canyon, 1 Hz, two frequencies, half cycles after each loss of lock",
            with(canyon(), ReceiverErrors { half_cycle_s: 3.0, ..urban }, 2),
            moving,
        ),
    ] {
        simulate(title, &scenario, motion, seeds);
    }
    real();
}

/// What happened to one kind of phases.
#[derive(Default)]
struct Counts {
    phases: u64,
    /// Found by each detector.
    found: [u64; SlipCause::ALL.len()],
    /// Arcs begun.
    begun: u64,
}

impl Counts {
    fn add(&mut self, arc: &PhaseArc) {
        self.phases += 1;
        self.begun += u64::from(arc.begins);
        for (index, cause) in SlipCause::ALL.into_iter().enumerate() {
            self.found[index] += u64::from(arc.causes.contains(cause));
        }
    }

    fn print(&self, name: &str, scale: f64) {
        print!("  {name:<34}{:>9}", self.phases);
        let share = |count: u64| scale * count as f64 / self.phases.max(1) as f64;
        self.found.iter().for_each(|count| print!("{:>9.1}", share(*count)));
        println!("{:>9.1}", share(self.begun));
    }
}

fn heading(title: &str, unit: &str) {
    print!("{title}\n  {unit:<34}{:>9}", "phases");
    for name in ["power", "lock", "half", "gap", "geo-free", "mel-wueb", "doppler", "time-dif"] {
        print!("{name:>9}");
    }
    println!("{:>9}", "new arc");
}

/// What a phase was when it was last seen.
struct Before {
    truth: PhaseTruth,
    half_cycle: bool,
}

fn simulate(title: &str, scenario: &Scenario, motion: AntennaMotion, seeds: u64) {
    let mut kinds: BTreeMap<(u8, &str), Counts> = BTreeMap::new();
    for seed in 0..seeds {
        let simulator = Simulator::new(scenario.clone(), seed);
        let navigation = simulator.navigation().clone();
        let mut follower = Follower::new(motion);
        let mut before: BTreeMap<_, Before> = BTreeMap::new();
        for epoch in simulator {
            follower.advance(&epoch.rover, &navigation);
            for (observation, truth) in epoch.rover.observations.iter().zip(epoch.rover_phases) {
                let key = (observation.satellite, observation.code);
                let half_cycle = observation.half_cycle;
                let last = before.insert(key, Before { truth, half_cycle });
                let arc = follower.tracker.arc(key.0, key.1);
                if let (Some(last), Some(arc)) = (last, arc) {
                    kinds.entry(kind(&last, observation, &truth)).or_default().add(arc);
                }
            }
        }
    }
    heading(title, "% of the slips found");
    let is_slip = |(rank, _): &(u8, &str)| *rank < 10;
    for (kind, counts) in kinds.iter().filter(|(kind, _)| is_slip(kind)) {
        counts.print(kind.1, 100.0);
    }
    println!("  doubted per million that went on");
    for (kind, counts) in kinds.iter().filter(|(kind, _)| !is_slip(kind)) {
        counts.print(kind.1, 1e6);
    }
    println!();
}

/// The row to which a phase belongs; slips below ten.
fn kind(last: &Before, observation: &Observation, truth: &PhaseTruth) -> (u8, &'static str) {
    let cycles = (truth.ambiguity_cycles - last.truth.ambiguity_cycles).abs();
    let is_announced = observation.loss_of_lock || observation.half_cycle != last.half_cycle;
    let is_reflected = truth.is_reflected || last.truth.is_reflected;
    let elevation_deg = truth.elevation_rad.to_degrees();
    match (cycles, is_announced, is_reflected) {
        (_, true, _) if 1e-6 < cycles => (5, "announced"),
        (_, true, _) => (12, "announced, no slip"),
        (_, _, true) if 1e-6 < cycles => (4, "of reflections"),
        (_, _, true) => (11, "reflections"),
        _ if cycles < 1e-6 => (10, "direct"),
        _ if elevation_deg < 15.0 => (0, "below 15 degrees"),
        _ if elevation_deg < 30.0 => (1, "15 to 30 degrees"),
        _ => (2, "above 30 degrees"),
    }
}

/// A tracker that gets its positions from single points, their mean where the antenna stands.
struct Follower {
    tracker: SlipTracker,
    estimator: Estimator,
    antenna: Option<AntennaPosition>,
    motion: AntennaMotion,
    averaged: f64,
}

impl Follower {
    /// The mean with one position more; its error is that of atmosphere and orbits.
    fn averaged(&mut self, mean: AntennaPosition, next: Ecef) -> AntennaPosition {
        self.averaged += 1.0;
        let moved = (next.0 - mean.position.0) / self.averaged;
        AntennaPosition { position: Ecef(mean.position.0 + moved), sigma_m: 2.0 }
    }

    fn new(motion: AntennaMotion) -> Self {
        let options = PositioningOptions::new(Mode::Spp, Profile::General);
        Self {
            tracker: SlipTracker::new(motion),
            estimator: Estimator::new(options),
            antenna: None,
            motion,
            averaged: 1.0,
        }
    }

    fn advance(&mut self, epoch: &Epoch, navigation: &Navigation) {
        let solution = self.estimator.advance(epoch, &Aiding::alone(navigation));
        if let Some(estimate) = solution.estimate {
            self.antenna = Some(match (self.motion, self.antenna) {
                (AntennaMotion::Static, Some(mean)) => self.averaged(mean, estimate.position),
                _ => AntennaPosition {
                    position: estimate.position,
                    sigma_m: estimate.covariance.trace().sqrt(),
                },
            });
        }
        let satellites = KnownSatellite::of_epoch(epoch, navigation);
        self.tracker.advance(epoch, &satellites, self.antenna);
    }
}

const REAL: [(&str, &str, &[&str], AntennaMotion); 12] = [
    (
        "tst-2019",
        "COM3_190428_124409.obs",
        &["hksc1180.19n", "hksc1180.19b"],
        AntennaMotion::Moving,
    ),
    ("galway-static", "rover-20181004-1237.obs.gz", GALWAY_STATIC, AntennaMotion::Static),
    ("galway-static", "base-20181004-1236.obs.gz", GALWAY_STATIC, AntennaMotion::Static),
    ("hers-hert", "hers0010.18O", &["brdc0010.18n"], AntennaMotion::Moving),
    ("hers-hert", "hert0010.18O", &["brdc0010.18n"], AntennaMotion::Static),
    ("geonet", "07590920.05o", &["30400920.05n"], AntennaMotion::Static),
    ("meijo-static", "rover.obs", &["base.nav"], AntennaMotion::Moving),
    ("meijo-static", "base.obs", &["base.nav"], AntennaMotion::Static),
    ("fujisawa-kinematic", "SEPT265G.21O", &["SEPT2650.21P"], AntennaMotion::Moving),
    ("klt-2021", "20210610.klt1.ublox.f9p.obs", &["hksc1610.nav"], AntennaMotion::Moving),
    ("klt-2021", "hksc1610.obs", &["hksc1610.nav"], AntennaMotion::Static),
    ("spirent-rtk", "Rover-dynamic_MO_Spirent.obs", SPIRENT, AntennaMotion::Moving),
];
const GALWAY_STATIC: &[&str] = &["rover-20181004-1237.ubx.nav"];
const SPIRENT: &[&str] = &["RINEX_GN_Spirent.23N", "RINEX_EN_Spirent.23L"];

fn real() {
    let root = std::env::var_os("GRAPHFIX_DATA").map_or_else(
        || Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data"),
        PathBuf::from,
    );
    heading("real recordings", "found per thousand phases");
    for (set, rover, files, motion) in REAL {
        match recording(&root.join(set), rover, files, motion) {
            Some(counts) => counts.print(&format!("{set} {rover:.12}"), 1e3),
            None => println!("  {set} is not there"),
        }
    }
}

fn open(path: &Path) -> Option<impl BufRead + use<>> {
    Some(decompress(BufReader::new(File::open(path).ok()?)))
}

fn recording(folder: &Path, rover: &str, files: &[&str], motion: AntennaMotion) -> Option<Counts> {
    let mut navigation = Navigation::default();
    for file in files {
        navigation.merge(read_navigation(open(&folder.join(file))?).ok()?.0);
    }
    let mut reader = ObservationReader::new(open(&folder.join(rover))?).ok()?;
    let mut follower = Follower::new(motion);
    let (mut epoch, mut counts) = (Epoch::new(GpsTime::EPOCH), Counts::default());
    while reader.read_epoch(&mut epoch).ok()? {
        follower.advance(&epoch, &navigation);
        follower.tracker.arcs().iter().for_each(|arc| counts.add(arc));
    }
    Some(counts)
}
