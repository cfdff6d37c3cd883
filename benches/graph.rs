//! Cost of the factor-graph core: `cargo bench --bench graph`.
//!
//! The problem has the form of a receiver's window: states of 8 (position, velocity, offset,
//! drift), each with ten ranges to distant anchors and ten range rates, linked to the next by eight
//! rows. Ranges are nonlinear and linearised in every iteration; one in seven is late by 30 to 60
//! sigma.

use std::hint::black_box;

use divan::{Bencher, counter::ItemsCount};
use graphfix::graph::{
    AnnealedKernel, BorderLife, Covariances, Elimination, Estimate, Kernel, Link, OptimizerOptions,
    Prior, Problem, Row, Schedule, System, Widening, Workspace, optimize,
};
use nalgebra::{SMatrix, SVector, Vector3};

fn main() {
    divan::main();
}

const S: usize = 8;
const WINDOW: usize = 30;
const ANCHORS: usize = 10;
const STREAM: usize = 2000;
const START: [f64; S] = [100.0, 0.0, 0.0, 0.0, 10.0, 0.0, 0.0, 0.5];

/// Range and range rate to one anchor at one instant.
#[derive(Clone, Copy)]
struct Reading {
    anchor: Vector3<f64>,
    range: f64,
    rate: f64,
}

type Epoch = [Reading; ANCHORS];

/// Numbers in [−1, 1) from a linear congruential generator.
struct Numbers(u64);

impl Numbers {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963);
        (self.0 >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    }
}

/// Measurements of a receiver on a circle of 100 m, with an offset drift of 0.5 a step.
fn stream(length: usize) -> Vec<Epoch> {
    let mut numbers = Numbers(1);
    let anchors = [0.0; ANCHORS].map(|_| {
        let (x, y, z) = (numbers.next(), numbers.next(), 0.3 + numbers.next().abs());
        Vector3::new(x, y, z).normalize() * 2.2e7
    });
    let mut reading = |k: usize, anchor: Vector3<f64>| {
        let angle = k as f64 * 0.1;
        let position = Vector3::new(100.0 * angle.cos(), 100.0 * angle.sin(), 0.0);
        let velocity = Vector3::new(-10.0 * angle.sin(), 10.0 * angle.cos(), 0.0);
        let sight = (position - anchor).normalize();
        let late = if numbers.next() < -0.7 { 45.0 + 15.0 * numbers.next() } else { 0.0 };
        let range = (position - anchor).norm() + 0.5 * k as f64 + late + numbers.next();
        Reading { anchor, range, rate: sight.dot(&velocity) + 0.5 + 0.1 * numbers.next() }
    };
    (0..length).map(|k| anchors.map(|anchor| reading(k, anchor))).collect()
}

/// A window over a stream: the measurements of its states, the prior, the kernel of ranges.
struct Window {
    epochs: Vec<Epoch>,
    prior: Prior<S>,
    kernel: AnnealedKernel,
}

impl Window {
    fn new(kernel: AnnealedKernel) -> Self {
        let information = SMatrix::<f64, S, S>::identity() * 1e-4;
        Self { epochs: Vec::new(), prior: Prior::on_state(START.into(), information), kernel }
    }

    fn add_readings(&self, k: usize, x: &SVector<f64, S>, range: &Kernel, system: &mut System<S>) {
        let position = x.fixed_rows::<3>(0).into_owned();
        let velocity = x.fixed_rows::<3>(3).into_owned();
        for reading in &self.epochs[k] {
            let line = position - reading.anchor;
            let distance = line.norm();
            let sight = line * distance.recip();
            let residual = distance + x[6] - reading.range;
            let jacobian = [sight.x, sight.y, sight.z, 1.0];
            system.add(k, &Row { residual, columns: [0, 1, 2, 6], jacobian }, range);
            let residual = (sight.dot(&velocity) + x[7] - reading.rate) * 10.0;
            let jacobian = jacobian.map(|entry| entry * 10.0);
            let row = Row { residual, columns: [3, 4, 5, 7], jacobian };
            system.add(k, &row, &Kernel::QUADRATIC);
        }
    }

    /// Trapezoid motion, velocity and drift random walks, offset by drift.
    fn add_links(k: usize, x: &[SVector<f64, S>], system: &mut System<S>) {
        let (a, b) = (&x[k], &x[k + 1]);
        for (i, rate, sigma) in [(0, 3, 0.4), (1, 4, 0.4), (2, 5, 0.1), (6, 7, 0.3)] {
            let link = Link {
                residual: (b[i] - a[i] - 0.5 * (a[rate] + b[rate])) / sigma,
                columns: [i, rate],
                jacobian: [-1.0 / sigma, -0.5 / sigma],
                next_columns: [i, rate],
                next_jacobian: [1.0 / sigma, -0.5 / sigma],
            };
            system.add_link(k, &link, &Kernel::QUADRATIC);
        }
        for (i, sigma) in [(3, 1.5), (4, 1.5), (5, 0.3), (7, 0.3)] {
            let link = Link {
                residual: (b[i] - a[i]) / sigma,
                columns: [i],
                jacobian: [-1.0 / sigma],
                next_columns: [i],
                next_jacobian: [1.0 / sigma],
            };
            system.add_link(k, &link, &Kernel::QUADRATIC);
        }
    }
}

impl Problem<S> for Window {
    fn linearize(&mut self, estimate: &Estimate<S>, widening: Widening, system: &mut System<S>) {
        let kernel = self.kernel.at(widening);
        self.prior.add_to(0, estimate, system);
        for (k, state) in estimate.states.iter().enumerate() {
            self.add_readings(k, state, &kernel, system);
            if k + 1 < estimate.states.len() {
                Self::add_links(k, &estimate.states, system);
            }
        }
    }
}

/// A causal estimator: takes one epoch and returns the newest state with its covariance.
struct Causal {
    window: Window,
    estimate: Estimate<S>,
    workspace: Workspace<S>,
    covariances: Covariances<S>,
    oldest: (System<S>, Elimination<S>),
    options: OptimizerOptions,
    iterations: usize,
}

impl Causal {
    fn new(kernel: AnnealedKernel, schedule: Schedule) -> Self {
        let life = BorderLife::WholeChain;
        Self {
            window: Window::new(kernel),
            estimate: Estimate::new(),
            workspace: Workspace::new(life),
            covariances: Covariances::new(),
            oldest: (System::new(life), Elimination::new()),
            options: OptimizerOptions { schedule, tolerance: 1e-2, damping: 0.0 },
            iterations: 0,
        }
    }

    fn forget_oldest(&mut self) {
        let Self { window, estimate, oldest: (system, elimination), .. } = self;
        system.reset(2, 0);
        let kernel = window.kernel.at(Widening::Final(1.0));
        window.prior.add_to(0, estimate, system);
        window.add_readings(0, &estimate.states[0], &kernel, system);
        Window::add_links(0, &estimate.states, system);
        let prior = &mut window.prior;
        prior.marginalize(system, estimate, |_| false, elimination).expect("rows are finite");
        estimate.states.remove(0);
        window.epochs.remove(0);
    }

    fn advance(&mut self, epoch: &Epoch) -> f64 {
        let mut next = SVector::from(START);
        if let Some(last) = self.estimate.states.last() {
            next = *last;
            for (i, rate) in [(0, 3), (1, 4), (2, 5), (6, 7)] {
                next[i] += last[rate];
            }
        }
        self.estimate.states.push(next);
        self.window.epochs.push(*epoch);
        if WINDOW < self.estimate.states.len() {
            self.forget_oldest();
        }
        let Self { window, estimate, options, workspace, .. } = self;
        let summary = optimize(window, estimate, options, workspace);
        self.iterations += summary.expect("determined").iterations;
        self.covariances.newest(&self.workspace.elimination);
        self.covariances.state()[(0, 0)]
    }
}

/// Updates of a warm window along a long stream, one a sample.
fn bench_causal(bencher: Bencher, kernel: AnnealedKernel, schedule: Schedule) {
    let epochs = stream(STREAM);
    let mut causal = Causal::new(kernel, schedule);
    let mut source = epochs.iter();
    for epoch in source.by_ref().take(2 * WINDOW) {
        causal.advance(epoch);
    }
    causal.iterations = 0;
    let mut updates = 0;
    bencher.bench_local(|| {
        updates += 1;
        causal.advance(source.next().expect("fewer samples than epochs"))
    });
    println!("{:.2} linearisations an update", causal.iterations as f64 / f64::from(updates));
}

/// One causal update of a 30-state window with Huber's kernel. Goal: 100 µs median.
#[divan::bench(sample_count = 1000, sample_size = 1)]
fn causal_update_huber(bencher: Bencher) {
    let kernel = AnnealedKernel::constant(Kernel::huber(1.345));
    bench_causal(bencher, kernel, Schedule::direct(10));
}

/// One causal update, annealed from Huber to Geman–McClure. Goal: 200 µs median.
#[divan::bench(sample_count = 1000, sample_size = 1)]
fn causal_update_annealed(bencher: Bencher) {
    let target = Kernel::geman_mcclure(4.0).one_sided(4.0, 2.0);
    let kernel = AnnealedKernel { convex: Kernel::huber(1.345), target };
    bench_causal(bencher, kernel, Schedule::graduated(2, 4.0, 2.0, 1, 4));
}

/// A window filled with `length` states.
fn filled(length: usize) -> (Window, Estimate<S>) {
    let mut window = Window::new(AnnealedKernel::constant(Kernel::huber(1.345)));
    window.epochs = stream(length);
    (window, Estimate { states: vec![START.into(); length], border: Vec::new() })
}

/// One linearisation of every row of the window.
#[divan::bench]
fn linearize_window(bencher: Bencher) {
    let (mut window, estimate) = filled(WINDOW);
    let mut system = System::new(BorderLife::WholeChain);
    bencher.bench_local(|| {
        system.reset(WINDOW, 0);
        window.linearize(black_box(&estimate), Widening::Convex, &mut system);
    });
}

/// Factor and solve one window of 30 × 8 without a border.
#[divan::bench]
fn factor_and_solve_window(bencher: Bencher) {
    let (mut window, mut estimate) = filled(WINDOW);
    let mut system = System::new(BorderLife::WholeChain);
    let mut elimination = Elimination::new();
    system.reset(WINDOW, 0);
    window.linearize(&estimate, Widening::Convex, &mut system);
    bencher.bench_local(|| {
        elimination.factor(black_box(&system), 0.0).expect("determined");
        elimination.solve(&mut estimate);
    });
}

/// Covariance of the newest state, or of all.
#[divan::bench(args = ["newest", "all"])]
fn covariances(bencher: Bencher, which: &str) {
    let (mut window, estimate) = filled(WINDOW);
    let mut system = System::new(BorderLife::WholeChain);
    let (mut elimination, mut covariances) = (Elimination::new(), Covariances::new());
    system.reset(WINDOW, 0);
    window.linearize(&estimate, Widening::Convex, &mut system);
    elimination.factor(&system, 0.0).expect("determined");
    let mut states = Vec::new();
    bencher.bench_local(|| match which {
        "all" => covariances.all_states(black_box(&elimination), &mut states),
        _ => covariances.newest(black_box(&elimination)),
    });
}

/// Batch with Huber's kernel and every state's covariance; the cost per state must not grow.
#[divan::bench(args = [485, 4850, 36_000], sample_count = 5, sample_size = 1)]
fn batch(bencher: Bencher, length: usize) {
    let (mut window, mut start) = filled(length);
    for (k, state) in start.states.iter_mut().enumerate() {
        state[6] = 0.5 * k as f64;
    }
    let schedule = Schedule::direct(10);
    let options = OptimizerOptions { schedule, tolerance: 1e-2, damping: 0.0 };
    let mut workspace = Workspace::new(BorderLife::WhileTouched);
    let (mut covariances, mut states) = (Covariances::new(), Vec::new());
    let (mut estimate, mut iterations) = (start.clone(), 0);
    bencher.counter(ItemsCount::new(length)).bench_local(|| {
        estimate.clone_from(&start);
        let summary = optimize(&mut window, &mut estimate, &options, &mut workspace);
        covariances.all_states(&workspace.elimination, &mut states);
        iterations = summary.expect("determined").iterations;
    });
    println!("{iterations} linearisations");
}

/// A chain with a border: `alive` variables at any time, each measured at every state of its life.
fn bordered(states: usize, alive: usize, life: usize, border_life: BorderLife) -> System<S> {
    let mut system = System::new(border_life);
    let (window, estimate) = filled(states);
    system.reset(states, (states / life + 2) * alive);
    window.prior.add_to(0, &estimate, &mut system);
    for (k, state) in estimate.states.iter().enumerate() {
        window.add_readings(k, state, &Kernel::QUADRATIC, &mut system);
        if k + 1 < states {
            Window::add_links(k, &estimate.states, &mut system);
        }
        for i in 0..alive {
            let variable = (k + i * life / alive) / life * alive + i;
            let sight = window.epochs[k][i % ANCHORS].anchor.normalize();
            let jacobian = [sight.x, sight.y, sight.z, 1.0].map(|entry| 100.0 * entry);
            let row = Row { residual: 0.1, columns: [0, 1, 2, 6], jacobian };
            system.add_with_border(k, &row, &[(variable, 20.0)], &Kernel::QUADRATIC);
            let weak = Row { residual: 0.1, columns: [], jacobian: [] };
            system.add_with_border(k, &weak, &[(variable, 0.1)], &Kernel::QUADRATIC);
        }
    }
    system
}

/// Factor and solve 30 × 8 with a border that lives for the whole chain.
#[divan::bench(args = [8, 24, 40, 80])]
fn window_with_border(bencher: Bencher, alive: usize) {
    let system = bordered(WINDOW, alive, 1000, BorderLife::WholeChain);
    let (mut elimination, mut delta) = (Elimination::new(), Estimate::new());
    bencher.bench_local(|| {
        elimination.factor(black_box(&system), 0.0).expect("determined");
        elimination.solve(&mut delta);
    });
}

/// Factor, solve and border covariance of a chain of two states, as long as the window of RTK.
#[divan::bench(args = [20, 40, 60, 80, 100, 120, 160, 240, 320, 500, 1000])]
fn border_at_once(bencher: Bencher, border: usize) {
    let system = bordered(2, border, 10_000, BorderLife::WholeChain);
    let (mut elimination, mut covariances) = (Elimination::new(), Covariances::new());
    let mut delta = Estimate::new();
    bencher.bench_local(|| {
        elimination.factor(black_box(&system), 0.0).expect("determined");
        elimination.solve(&mut delta);
        covariances.newest(&elimination);
    });
    assert_eq!(covariances.variables().len(), border);
}

/// Factor and solve a day at 30 s. 24 border variables are alive at a time, each for the given
/// number of states: 120, 312 or 984 in all. Each is eliminated after its last state, or all of
/// them at the end.
#[divan::bench(
    args = [
        (720, BorderLife::WhileTouched), (720, BorderLife::WholeChain),
        (240, BorderLife::WhileTouched), (240, BorderLife::WholeChain),
        (72, BorderLife::WhileTouched), (72, BorderLife::WholeChain),
    ],
    sample_count = 3, sample_size = 1
)]
fn arcs_of_a_day(bencher: Bencher, (life, border_life): (usize, BorderLife)) {
    const STATES: usize = 2880;
    let system = bordered(STATES, 24, life, border_life);
    let (mut elimination, mut delta) = (Elimination::new(), Estimate::new());
    bencher.counter(ItemsCount::new(STATES)).bench_local(|| {
        elimination.factor(black_box(&system), 0.0).expect("determined");
        elimination.solve(&mut delta);
    });
}

/// Factor and solve chains of 8 with 24 variables alive, each for 100 states, hundreds to thousands
/// in all.
#[divan::bench(args = [1000, 10_000], sample_count = 3, sample_size = 1)]
fn batch_with_arcs(bencher: Bencher, states: usize) {
    let system = bordered(states, 24, 100, BorderLife::WhileTouched);
    let (mut elimination, mut delta) = (Elimination::new(), Estimate::new());
    bencher.counter(ItemsCount::new(states)).bench_local(|| {
        elimination.factor(black_box(&system), 0.0).expect("determined");
        elimination.solve(&mut delta);
    });
}
