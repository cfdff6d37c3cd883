//! Simulated drives with every mode relative to a base, and with RTKLIB: the share of fixes, the
//! share of wrong ones, the reliability of the stated probability, and positions without integers
//! against those of `fgo` without a base.
//!
//! `cargo run --release --example rtk_campaign -- [--scenario rtk-canyon] [--seeds 100] [--first 1]
//! [--set KEY=VALUE]… [--without-peer]`
//!
//! A fix is wrong if its horizontal error exceeds 10 cm. The peer is `rnx2rtkp` (Debian's package
//! `rtklib`) on the same drives, written as RINEX: kinematic, continuous resolution, its default
//! ratio of 3, the bands and constellations of the scenario. Options given by `--set` change the
//! profile of Graphfix.

use std::fs::File;
use std::io::BufWriter;
use std::path::Path;
use std::process::{Command, ExitCode};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use clap::Parser;
use graphfix::config::{Mode, PositioningOptions, Profile};
use graphfix::evaluation::ErrorStatistics;
use graphfix::formats::pos::{self, PosRow};
use graphfix::formats::rinex::{
    ObservationHeader, ObservationWriter, RinexVersion, write_navigation,
};
use graphfix::gnss::{
    BaseStation, Constellation, Ecef, Ephemeris, LocalFrame, Navigation, Solution, Status,
};
use graphfix::positioning::{Aiding, BaseAiding, Estimator};
use graphfix::simulation::{Scenario, SimulatedEpoch, Simulator, navigation};
use nalgebra::Matrix3;

/// Horizontal error above which a fix is wrong (m).
const WRONG_M: f64 = 0.1;
/// Squared distance that holds 95 % of a normal distribution in the plane: −2·ln 0.05.
const INSIDE: f64 = 5.991_464_5;
/// Lower bounds of the classes of stated probability.
const CLASSES: [f64; 6] = [0.0, 0.9, 0.99, 0.999, 0.9999, 0.999_99];

type Fault = Box<dyn std::error::Error + Send + Sync>;

#[derive(Debug, Parser)]
struct Arguments {
    /// Scenario simulated
    #[arg(long, default_value = "rtk-canyon")]
    scenario: String,
    /// Number of drives
    #[arg(long, default_value_t = 100)]
    seeds: u64,
    /// Seed of the first drive
    #[arg(long, default_value_t = 1)]
    first: u64,
    /// Profile under test
    #[arg(long, default_value = "general")]
    profile: String,
    /// Option of the profile under test
    #[arg(long = "set", value_name = "KEY=VALUE")]
    settings: Vec<String>,
    /// Leaves RTKLIB out
    #[arg(long)]
    without_peer: bool,
    /// Prints each run
    #[arg(long)]
    runs: bool,
}

/// One epoch with an answer.
#[derive(Clone, Copy)]
struct Judged {
    error_m: f64,
    /// Whether the horizontal error is inside the stated 95 % ellipse, if one is stated.
    is_inside: Option<bool>,
    is_fixed: bool,
    /// Stated probability of the fix.
    probability: Option<f64>,
}

impl Judged {
    /// The answer to an epoch whose true position is `truth`.
    fn of(answer: &Answer, truth: Ecef) -> Self {
        let frame = LocalFrame::at(truth);
        let error_m = frame.to_enu(answer.position).0.xy();
        let is_inside = answer.covariance.and_then(|covariance| {
            let local = frame.rotation * covariance * frame.rotation.transpose();
            let inverse = local.fixed_view::<2, 2>(0, 0).try_inverse()?;
            Some(error_m.dot(&(inverse * error_m)) <= INSIDE)
        });
        let Answer { is_fixed, probability, .. } = *answer;
        Self { error_m: error_m.norm(), is_inside, is_fixed, probability }
    }

    fn is_wrong(&self) -> bool {
        self.is_fixed && WRONG_M < self.error_m
    }
}

/// The answer of one method to an epoch.
struct Answer {
    position: Ecef,
    /// Of the position (m²), if it is stated.
    covariance: Option<Matrix3<f64>>,
    is_fixed: bool,
    /// Stated probability of the fix.
    probability: Option<f64>,
}

/// The results of one method on one drive.
struct Run {
    /// Of each epoch, if it was answered.
    epochs: Vec<Option<Judged>>,
}

impl Run {
    fn judged(&self) -> impl Iterator<Item = &Judged> {
        self.epochs.iter().flatten()
    }

    /// The epochs without integers, each with the same epoch of `alone`, if both are answered.
    fn floats<'a>(&'a self, alone: &'a Self) -> impl Iterator<Item = (&'a Judged, &'a Judged)> {
        let both = self.epochs.iter().zip(&alone.epochs);
        both.filter_map(|(own, alone)| Some((own.as_ref()?, alone.as_ref()?)))
            .filter(|(own, _)| !own.is_fixed)
    }
}

/// All modes relative to a base, and last the one without a base.
fn methods(arguments: &Arguments) -> Result<Vec<PositioningOptions>, Fault> {
    let profile = Profile::from_name(&arguments.profile).ok_or("no profile has that name")?;
    let relative = Mode::ALL.iter().copied().filter(|mode| mode.is_relative());
    let mut methods: Vec<_> =
        relative.chain([Mode::Fgo]).map(|mode| PositioningOptions::new(mode, profile)).collect();
    for setting in &arguments.settings {
        let (key, value) = setting.split_once('=').ok_or("--set needs KEY=VALUE")?;
        for options in &mut methods {
            options.set(key, value)?;
        }
    }
    Ok(methods)
}

/// A drive and the position of its base.
struct Drive {
    epochs: Vec<SimulatedEpoch>,
    station: BaseStation,
}

impl Drive {
    fn of(simulator: Simulator) -> Result<Self, Fault> {
        let antenna_reference_point =
            simulator.base_position().ok_or("the scenario has no base")?;
        let station = BaseStation { name: "base".to_owned(), antenna_reference_point };
        Ok(Self { epochs: simulator.collect(), station })
    }

    fn run(&self, answers: impl Iterator<Item = Option<Answer>>) -> Run {
        let judge = |(epoch, answer): (&SimulatedEpoch, Option<Answer>)| {
            answer.map(|answer| Judged::of(&answer, epoch.position))
        };
        Run { epochs: self.epochs.iter().zip(answers).map(judge).collect() }
    }
}

fn solve(options: &PositioningOptions, drive: &Drive, navigation: &Navigation) -> Run {
    let mut estimator = Estimator::new(options.clone());
    let answer = |epoch: &SimulatedEpoch| {
        let epochs = epoch.base.as_slice();
        let base = Some(BaseAiding { station: &drive.station, epochs });
        let solution = estimator.advance(&epoch.rover, &Aiding { navigation, base });
        outcome(&solution)
    };
    drive.run(drive.epochs.iter().map(answer))
}

fn outcome(solution: &Solution) -> Option<Answer> {
    let estimate = solution.estimate.as_ref()?;
    let probability = estimate.relative.as_ref().and_then(|relative| relative.fix_probability);
    let is_fixed = solution.status == Status::Fixed;
    let covariance = Some(estimate.covariance);
    Some(Answer { position: estimate.position, covariance, is_fixed, probability })
}

fn write_observations<'a>(
    path: &Path,
    scenario: &Scenario,
    navigation: &Navigation,
    position: Option<Ecef>,
    epochs: impl Iterator<Item = &'a graphfix::gnss::Epoch>,
) -> Result<(), Fault> {
    let mut codes = [const { Vec::new() }; Constellation::COUNT];
    for constellation in &scenario.constellations {
        codes[constellation.index()] = scenario.signals(*constellation).collect();
    }
    let channel = |list: &[Ephemeris]| {
        let first = list.first()?;
        Some((first.satellite().number, first.glonass_channel()?))
    };
    let header = ObservationHeader {
        approximate_position: position,
        interval_s: Some(scenario.interval_s),
        first_observation: Some(scenario.start),
        glonass_channels: navigation.satellites().filter_map(|(_, list)| channel(list)).collect(),
        codes,
        ..ObservationHeader::new(RinexVersion::new(3, 4))
    };
    let mut writer = ObservationWriter::new(BufWriter::new(File::create(path)?), &header)?;
    for epoch in epochs {
        writer.write_epoch(epoch)?;
    }
    writer.finish()?;
    Ok(())
}

/// Runs `rnx2rtkp` on the drive, written as RINEX.
fn peer(
    scenario: &Scenario,
    drive: &Drive,
    navigation: &Navigation,
    folder: &Path,
) -> Result<Run, Fault> {
    let path = |name: &str| folder.join(name);
    let rovers = drive.epochs.iter().map(|epoch| &epoch.rover);
    let bases = drive.epochs.iter().filter_map(|epoch| epoch.base.as_ref());
    let place = drive.station.antenna_reference_point;
    write_observations(&path("rover.obs"), scenario, navigation, None, rovers)?;
    write_observations(&path("base.obs"), scenario, navigation, Some(place), bases)?;
    write_navigation(File::create(path("navigation.rnx"))?, navigation)?;
    let letters: Vec<_> = scenario.constellations.iter().map(|c| c.letter().to_string()).collect();
    let status = Command::new("rnx2rtkp")
        .args(["-p", "2", "-m", "15", "-t", "-d", "4", "-sys", &letters.join(",")])
        .args(["-f", &scenario.frequencies.to_string()])
        .arg("-r")
        .args(place.0.iter().map(|value| format!("{value:.4}")))
        .arg("-o")
        .arg(path("peer.pos"))
        .args([path("rover.obs"), path("base.obs"), path("navigation.rnx")])
        .stderr(std::process::Stdio::null())
        .status()?;
    if !status.success() {
        return Err("rnx2rtkp failed".into());
    }
    let text = std::fs::read(path("peer.pos"))?;
    let rows = pos::read(text.as_slice())?.rows;
    let near = |epoch: &SimulatedEpoch| {
        let is_of = |row: &&PosRow| (row.time - epoch.rover.time).abs() < 0.01;
        let row = rows.iter().find(is_of)?;
        let is_fixed = row.quality == 1;
        Some(Answer { position: row.position, covariance: None, is_fixed, probability: None })
    };
    Ok(drive.run(drive.epochs.iter().map(near)))
}

/// Runs all methods on all drives, in the order of the seeds.
fn campaign(
    scenario: &Scenario,
    methods: &[PositioningOptions],
    arguments: &Arguments,
) -> Result<Vec<Vec<Run>>, Fault> {
    let sky = Arc::new(navigation(scenario));
    let (next, end) = (AtomicU64::new(arguments.first), arguments.first + arguments.seeds);
    let one = |seed: u64, folder: &Path| {
        let simulator = Simulator::with_navigation(scenario.clone(), seed, Arc::clone(&sky));
        let drive = Drive::of(simulator)?;
        let mut runs: Vec<_> = methods.iter().map(|options| solve(options, &drive, &sky)).collect();
        if !arguments.without_peer {
            runs.push(peer(scenario, &drive, &sky, folder)?);
        }
        Ok::<_, Fault>(runs)
    };
    let work = |thread: usize| {
        let name = format!("graphfix-campaign-{}-{thread}", std::process::id());
        let folder = std::env::temp_dir().join(name);
        std::fs::create_dir_all(&folder)?;
        let mut done = Vec::new();
        loop {
            let seed = next.fetch_add(1, Ordering::Relaxed);
            if end <= seed {
                std::fs::remove_dir_all(&folder)?;
                return Ok::<_, Fault>(done);
            }
            done.push((seed, one(seed, &folder)?));
        }
    };
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let mut results = Vec::new();
    std::thread::scope(|scope| {
        let workers: Vec<_> =
            (0..threads).map(|thread| scope.spawn(move || work(thread))).collect();
        for worker in workers {
            results.extend(worker.join().expect("no run panics")?);
        }
        Ok::<_, Fault>(())
    })?;
    results.sort_by_key(|(seed, _)| *seed);
    Ok(results.into_iter().map(|(_, runs)| runs).collect())
}

fn percent(part: usize, whole: usize) -> f64 {
    100.0 * part as f64 / whole.max(1) as f64
}

fn print_fixes(names: &[&str], results: &[Vec<Run>]) {
    println!("| mode | answered | fixed | wrong | of fixes | 2D 50 % | 95 % | drives with wrong |");
    println!("|---|---|---|---|---|---|---|---|");
    for (index, name) in names.iter().enumerate() {
        let runs: Vec<_> = results.iter().map(|runs| &runs[index]).collect();
        let all: Vec<Judged> = runs.iter().flat_map(|run| run.judged().copied()).collect();
        let epochs: usize = runs.iter().map(|run| run.epochs.len()).sum();
        let errors: Vec<_> = all.iter().map(|judged| judged.error_m).collect();
        let Some(errors) = ErrorStatistics::of(&errors) else {
            println!("| {name} | no position at all |");
            continue;
        };
        let fixed = all.iter().filter(|judged| judged.is_fixed).count();
        let wrong = all.iter().filter(|judged| judged.is_wrong()).count();
        let drives = runs.iter().filter(|run| run.judged().any(Judged::is_wrong)).count();
        println!(
            "| {name} | {:.1} % | {:.2} % | {wrong} | {:.2} % | {:.3} | {:.2} | {drives} |",
            percent(all.len(), epochs),
            percent(fixed, epochs),
            percent(wrong, fixed),
            errors.p50,
            errors.p95,
        );
    }
}

fn print_calibration(names: &[&str], results: &[Vec<Run>]) {
    println!("\n| mode | stated from | fixes | mean stated | right |\n|---|---|---|---|---|");
    for (index, name) in names.iter().enumerate() {
        let all = results.iter().flat_map(|runs| runs[index].judged());
        let stated: Vec<_> =
            all.filter_map(|judged| Some((judged.probability?, !judged.is_wrong()))).collect();
        let class = |low: f64, high: f64| {
            let inside: Vec<_> = stated.iter().filter(|(p, _)| (low..high).contains(p)).collect();
            let (n, right) = (inside.len(), inside.iter().filter(|(_, right)| *right).count());
            let mean = inside.iter().map(|(p, _)| p).sum::<f64>() / n.max(1) as f64;
            if 0 < n {
                let (mean, right) = (100.0 * mean, percent(right, n));
                println!("| {name} | {low} | {n} | {mean:.2} % | {right:.2} % |");
            }
        };
        let highs = CLASSES.iter().skip(1).copied().chain([f64::INFINITY]);
        CLASSES.iter().zip(highs).for_each(|(&low, high)| class(low, high));
        class(0.0, f64::INFINITY);
    }
}

/// Prints the horizontal errors without integers, and those of the method at `alone` on the same
/// epochs: mean and 95 % of all, the number of drives with larger errors, and the fraction inside
/// the 95 % ellipse.
fn print_floats(names: &[&str], alone: usize, results: &[Vec<Run>]) {
    let other = names[alone];
    println!("\n| mode | epochs without integers | 2D mean | {other} | 95 % | {other} |");
    println!("|---|---|---|---|---|---|");
    let statistics = |errors: &[f64]| ErrorStatistics::of(errors).map(|s| (s.mean, s.p95));
    let mut drives = Vec::new();
    for (index, name) in names.iter().enumerate().filter(|(index, _)| *index != alone) {
        let (mut own, mut others) = (Vec::new(), Vec::new());
        let (mut worse, mut inside, mut counted) = ((0, 0), [0, 0], 0);
        for runs in results {
            let both: Vec<_> = runs[index].floats(&runs[alone]).collect();
            let errors: Vec<_> = both.iter().map(|(float, _)| float.error_m).collect();
            let alone: Vec<_> = both.iter().map(|(_, alone)| alone.error_m).collect();
            if let Some((a, b)) = statistics(&errors).zip(statistics(&alone)) {
                worse.0 += usize::from(b.0 < a.0);
                worse.1 += usize::from(b.1 < a.1);
                counted += 1;
            }
            let are_inside = |judged: &Judged| usize::from(judged.is_inside == Some(true));
            inside[0] += both.iter().map(|(float, _)| are_inside(float)).sum::<usize>();
            inside[1] += both.iter().map(|(_, alone)| are_inside(alone)).sum::<usize>();
            own.extend(errors);
            others.extend(alone);
        }
        let Some((a, b)) = statistics(&own).zip(statistics(&others)) else { continue };
        println!("| {name} | {} | {:.2} | {:.2} | {:.2} | {:.2} |", own.len(), a.0, b.0, a.1, b.1);
        let share = inside.map(|inside| percent(inside, own.len()));
        drives.push((name, counted, worse, share));
    }
    println!("\n| mode | drives | worse than {other} in the mean | at 95 % | inside | {other} |");
    println!("|---|---|---|---|---|---|");
    for (name, counted, (mean, late), [own, others]) in drives {
        println!("| {name} | {counted} | {mean} | {late} | {own:.1} % | {others:.1} % |");
    }
}

fn run() -> Result<(), Fault> {
    let arguments = Arguments::parse();
    let methods = methods(&arguments)?;
    let scenario = Scenario::by_name(&arguments.scenario).ok_or("no scenario has that name")?;
    let results = campaign(&scenario, &methods, &arguments)?;
    let mut names: Vec<_> = methods.iter().map(|options| options.mode.name()).collect();
    if !arguments.without_peer {
        names.push("rnx2rtkp");
    }
    if arguments.runs {
        for (seed, runs) in (arguments.first..).zip(&results) {
            let fixed = |run: &Run| run.judged().filter(|judged| judged.is_fixed).count();
            let wrong = |run: &Run| run.judged().filter(|judged| judged.is_wrong()).count();
            let cells: Vec<_> =
                runs.iter().map(|run| format!("{:4} {:4}", fixed(run), wrong(run))).collect();
            println!("seed {seed:3} {}", cells.join(" |"));
        }
    }
    print_fixes(&names, &results);
    print_calibration(&names, &results);
    print_floats(&names, methods.len() - 1, &results);
    Ok(())
}

fn main() -> ExitCode {
    match run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(fault) => {
            eprintln!("{fault}");
            ExitCode::FAILURE
        }
    }
}
