//! Simulated drives with every mode without a base: errors, wins and consistency of covariances.
//!
//! `cargo run --release --example canyon_campaign -- [--scenario urban-canyon] [--seeds 100]
//! [--set KEY=VALUE]…`
//!
//! Options given by `--set` change the profile under test, not the comparators. Errors are
//! horizontal (m). `inside` is the share of epochs inside the stated 95 % ellipse. `silent` counts
//! epochs whose error exceeds twice the axes of the 99.9 % ellipse without a reason that announces
//! it. The run with the smaller mean error wins.

use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use clap::Parser;
use graphfix::config::{Mode, PositioningOptions, Profile};
use graphfix::evaluation::ErrorStatistics;
use graphfix::gnss::{LocalFrame, Reason, Solution};
use graphfix::positioning::{Aiding, Batch, Estimator};
use graphfix::simulation::{Scenario, SimulatedEpoch, Simulator, navigation};

/// χ² quantiles of two degrees of freedom at 95 % and at 99.9 %.
const INSIDE_95: f64 = 5.991;
const INSIDE_999: f64 = 13.816;
/// Factor on the 99.9 % ellipse beyond which an error counts as far.
const FAR: f64 = 2.0;

#[derive(Debug, Parser)]
struct Arguments {
    /// Scenario simulated
    #[arg(long, default_value = "urban-canyon")]
    scenario: String,
    /// Seeds 1 to this
    #[arg(long, default_value_t = 100)]
    seeds: u64,
    /// Profile under test
    #[arg(long, default_value = "urban-vehicle")]
    profile: String,
    /// Option of the profile under test
    #[arg(long = "set", value_name = "KEY=VALUE")]
    settings: Vec<String>,
    /// Prints each run
    #[arg(long)]
    runs: bool,
}

/// The kind of answer.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Way {
    Causal,
    Smoothed,
    Batch,
}

/// An estimator in the comparison.
struct Method {
    name: &'static str,
    way: Way,
    options: PositioningOptions,
}

/// The results of one method on one drive.
#[derive(Clone)]
struct Run {
    errors_m: Vec<f64>,
    up_m: f64,
    epochs: usize,
    inside: usize,
    silent: usize,
    flagged: usize,
}

fn methods(arguments: &Arguments) -> Result<Vec<Method>, String> {
    let profile = Profile::from_name(&arguments.profile).ok_or("unknown profile")?;
    let method = |name, mode, profile, way| {
        let options = PositioningOptions::new(mode, profile);
        Method { name, way, options }
    };
    let mut methods = vec![
        method("spp", Mode::Spp, profile, Way::Causal),
        method("ekf", Mode::Ekf, profile, Way::Causal),
        method("paper causal", Mode::Fgo, Profile::Paper, Way::Causal),
        method("paper batch", Mode::Fgo, Profile::Paper, Way::Batch),
    ];
    for (name, way) in
        [("fgo causal", Way::Causal), ("fgo smoothed", Way::Smoothed), ("fgo batch", Way::Batch)]
    {
        let mut method = method(name, Mode::Fgo, profile, way);
        for setting in &arguments.settings {
            let (key, value) = setting.split_once('=').ok_or("--set needs KEY=VALUE")?;
            method.options.set(key, value).map_err(|error| error.to_string())?;
        }
        methods.push(method);
    }
    Ok(methods)
}

fn solve(method: &Method, drive: &[SimulatedEpoch], aiding: &Aiding<'_>) -> Vec<Solution> {
    let options = method.options.clone();
    let rovers = drive.iter().map(|epoch| &epoch.rover);
    match method.way {
        Way::Causal => {
            let mut estimator = Estimator::new(options);
            rovers.map(|rover| estimator.advance(rover, aiding)).collect()
        }
        Way::Smoothed => {
            let mut estimator = Estimator::revising(options);
            let mut solutions = Vec::new();
            for rover in rovers {
                estimator.advance(rover, aiding);
                solutions.append(&mut estimator.take_revisions());
            }
            solutions.append(&mut estimator.finish());
            solutions
        }
        Way::Batch => {
            let mut batch = Batch::new(options);
            rovers.for_each(|rover| batch.push(rover, aiding));
            batch.finish()
        }
    }
}

fn judge(solutions: &[Solution], drive: &[SimulatedEpoch]) -> Run {
    let (mut errors_m, mut ups_m) = (Vec::new(), Vec::new());
    let (mut inside, mut silent, mut flagged) = (0, 0, 0);
    for epoch in drive {
        let at = solutions.partition_point(|solution| solution.time < epoch.rover.time);
        let Some(solution) = solutions.get(at).filter(|s| s.time == epoch.rover.time) else {
            continue;
        };
        let Some(estimate) = &solution.estimate else { continue };
        let frame = LocalFrame::at(epoch.position);
        let error = frame.to_enu(estimate.position).0;
        let plane =
            frame.covariance_to_enu(&estimate.covariance).fixed_view::<2, 2>(0, 0).into_owned();
        let inverse = plane.try_inverse().expect("the ellipse has an area");
        let square = (error.xy().transpose() * inverse * error.xy()).x;
        let is_flagged = solution.reasons.iter().any(|reason| {
            matches!(
                reason,
                Reason::StartUnproven { .. }
                    | Reason::ResidualsTooLarge { .. }
                    | Reason::TooFewSatellites { .. }
                    | Reason::NoRedundancy
            )
        });
        inside += usize::from(square < INSIDE_95);
        flagged += usize::from(is_flagged);
        silent += usize::from(FAR * FAR * INSIDE_999 < square && !is_flagged);
        errors_m.push(error.xy().norm());
        ups_m.push(error.z);
    }
    let up_m = ups_m.iter().sum::<f64>() / ups_m.len() as f64;
    Run { errors_m, up_m, epochs: drive.len(), inside, silent, flagged }
}

fn mean_m(run: &Run) -> f64 {
    run.errors_m.iter().sum::<f64>() / run.errors_m.len() as f64
}

/// Runs all methods on the drives of seeds 1 to `seeds`, in that order.
fn campaign(scenario: &Scenario, methods: &[Method], seeds: u64) -> Vec<Vec<Run>> {
    let sky = Arc::new(navigation(scenario));
    let next = AtomicU64::new(1);
    let work = || {
        let mut done = Vec::new();
        loop {
            let seed = next.fetch_add(1, Ordering::Relaxed);
            if seeds < seed {
                return done;
            }
            let simulator = Simulator::with_navigation(scenario.clone(), seed, Arc::clone(&sky));
            let drive: Vec<_> = simulator.collect();
            let aiding = Aiding { navigation: &sky, base: None };
            let judged = |method| judge(&solve(method, &drive, &aiding), &drive);
            done.push((seed, methods.iter().map(judged).collect::<Vec<_>>()));
        }
    };
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let mut results = std::thread::scope(|scope| {
        let workers: Vec<_> = (0..threads).map(|_| scope.spawn(work)).collect();
        let join = |worker: std::thread::ScopedJoinHandle<'_, Vec<_>>| worker.join();
        workers.into_iter().flat_map(|w| join(w).expect("no run panics")).collect::<Vec<_>>()
    });
    results.sort_by_key(|(seed, _)| *seed);
    results.into_iter().map(|(_, runs)| runs).collect()
}

fn print_errors(methods: &[Method], results: &[Vec<Run>]) {
    println!(
        "| mode | mean | 95 % | max | worst mean | up | available | inside | silent | flagged |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|");
    for (index, method) in methods.iter().enumerate() {
        let runs: Vec<_> = results.iter().map(|runs| &runs[index]).collect();
        let errors_m: Vec<_> = runs.iter().flat_map(|run| run.errors_m.iter().copied()).collect();
        let Some(errors) = ErrorStatistics::of(&errors_m) else {
            println!("| {} | no position at all |", method.name);
            continue;
        };
        let epochs: usize = runs.iter().map(|run| run.epochs).sum();
        let sum = |part: fn(&Run) -> usize| runs.iter().map(|run| part(run)).sum::<usize>();
        let percent = |count: usize| 100.0 * count as f64 / errors.n as f64;
        println!(
            "| {} | {:.2} | {:.2} | {:.1} | {:.2} | {:.1} | {:.2} % | {:.1} % | {} | {:.1} % |",
            method.name,
            errors.mean,
            errors.p95,
            errors.max,
            runs.iter().map(|run| mean_m(run)).fold(0.0, f64::max),
            runs.iter().map(|run| run.up_m).sum::<f64>() / runs.len() as f64,
            100.0 * errors.n as f64 / epochs as f64,
            percent(sum(|run| run.inside)),
            sum(|run| run.silent),
            percent(sum(|run| run.flagged)),
        );
    }
}

fn print_wins(methods: &[Method], results: &[Vec<Run>]) {
    let (ours, others): (Vec<_>, Vec<_>) =
        (0..methods.len()).partition(|index| methods[*index].name.starts_with("fgo"));
    println!(
        "\n| won by | {} |",
        others.iter().map(|i| methods[*i].name).collect::<Vec<_>>().join(" | ")
    );
    println!("|---|{}", "---|".repeat(others.len()));
    for own in ours {
        let wins = others.iter().map(|other| {
            let won = results.iter().filter(|runs| mean_m(&runs[own]) < mean_m(&runs[*other]));
            won.count().to_string()
        });
        println!("| {} | {} |", methods[own].name, wins.collect::<Vec<_>>().join(" | "));
    }
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    let methods = match methods(&arguments) {
        Ok(methods) => methods,
        Err(message) => {
            eprintln!("{message}");
            return ExitCode::FAILURE;
        }
    };
    let Some(scenario) = Scenario::by_name(&arguments.scenario) else {
        eprintln!("no scenario {:?}", arguments.scenario);
        return ExitCode::FAILURE;
    };
    let scenario = Scenario { base: None, ..scenario };
    let results = campaign(&scenario, &methods, arguments.seeds);
    if arguments.runs {
        for (index, runs) in results.iter().enumerate() {
            let means: Vec<_> =
                runs.iter().map(|run| format!("{:7.2} {:4}", mean_m(run), run.silent)).collect();
            println!("seed {:3} {}", index + 1, means.join(" |"));
        }
    }
    print_errors(&methods, &results);
    print_wins(&methods, &results);
    ExitCode::SUCCESS
}
