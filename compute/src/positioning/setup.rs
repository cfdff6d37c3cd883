//! Settings of the estimators that follow from the options, computed once and shared by all copies
//! of a state.

use crate::config::{GraphOptions, KernelLaw, Mode, PositioningOptions};
use crate::graph::{
    AnnealedKernel, HUBER_WIDTH, Kernel, Law, OptimizerOptions, Schedule, Widening,
};

use super::chi_square::ChiSquareLimits;
use super::factors::{ClockWalk, MotionWalk};

/// A solve ends after a step shorter than this many standard deviations of the estimate.
const TOLERANCE: f64 = 1e-2;
/// The same for redescending kernels, which ignore the outliers that need more steps.
const ANNEALED_TOLERANCE: f64 = 5e-2;

/// Further iterations where a window's start is far from the minimum, as after a pause.
const FURTHER: usize = 12;

/// Kernel of the estimate of a group's offset.
pub(super) const OFFSET_KERNEL: Kernel = Kernel::huber(HUBER_WIDTH);
/// Final kernel of carrier phases against a base, after annealing: 4σ.
pub(super) const CARRIER_KERNEL: Kernel = Kernel::geman_mcclure(4.0);

/// Options, with the tests and models that follow from them.
#[derive(Debug)]
pub(super) struct Setup {
    pub(super) options: PositioningOptions,
    /// Limits of the residual test of single points.
    pub(super) residual_limits: ChiSquareLimits,
    /// Limit of the filters' innovation test r²/S; infinite without the test.
    pub(super) innovation_limit: f64,
    pub(super) motion: MotionWalk,
    pub(super) clock: ClockWalk,
    /// The graph of a receiver without a base.
    pub(super) alone: GraphSettings,
    /// Whether the noise and the clocks of the receiver are estimated. Pseudoranges then have the
    /// mixture as error model.
    pub(super) learns: bool,
    /// The graph of differences against a base.
    pub(super) relative: GraphSettings,
    /// The setup of a receiver whose pseudoranges a base corrects; only in modes relative to a
    /// base.
    pub(super) corrected: Option<Box<Setup>>,
    /// Whether epochs are answered only at the end, from the whole recording.
    pub(super) is_batch: bool,
}

impl Setup {
    /// For epochs that are answered one by one.
    pub(super) fn new(options: PositioningOptions) -> Self {
        let residual_limits = ChiSquareLimits::new(options.false_alarm_probability);
        let learns = options.graph.motion && options.graph.pseudorange_kernel == KernelLaw::Mixture;
        Self {
            innovation_limit: match options.fault_exclusion {
                true => residual_limits.at(1),
                false => f64::INFINITY,
            },
            residual_limits,
            motion: MotionWalk::of(&options.graph),
            clock: ClockWalk::of(&options.graph),
            alone: match learns {
                true => GraphSettings::learning(),
                false => GraphSettings::alone(&options.graph),
            },
            learns,
            relative: GraphSettings::relative(&options.graph),
            corrected: options.mode.is_relative().then(|| Box::new(Self::corrected(&options))),
            is_batch: false,
            options,
        }
    }

    /// The setup of such a receiver: errors of orbits and clocks cancel, as the base has the same
    /// ones.
    fn corrected(options: &PositioningOptions) -> Self {
        let mut options = PositioningOptions { mode: Mode::Fgo, ..options.clone() };
        options.graph.orbit_clock_sigma_m = 0.0;
        Self::new(options)
    }

    /// For a recording that is smoothed as a whole.
    pub(super) fn batch(options: PositioningOptions) -> Self {
        Self { is_batch: true, ..Self::new(options) }
    }
}

/// Robust kernels by kind of measurement, as a stage of the solve uses them.
#[derive(Clone, Copy, Debug)]
pub(super) struct Kernels {
    pub(super) pseudorange: Kernel,
    pub(super) doppler: Kernel,
    pub(super) phase: Kernel,
    /// Whether Doppler is weighted by the probability that the pseudorange is direct, and a phase
    /// difference by the smaller one of both epochs instead of the later one's.
    pub(super) weighted_by_pseudorange: bool,
}

/// Robust kernels by kind of measurement, with the convex ones of the first stage.
#[derive(Clone, Copy, Debug)]
pub(super) struct AnnealedKernels {
    pub(super) pseudorange: AnnealedKernel,
    doppler: Kernel,
    phase: AnnealedKernel,
    weighted_by_pseudorange: bool,
}

impl AnnealedKernels {
    /// The kernels at a widening.
    pub(super) fn at(&self, widening: Widening) -> Kernels {
        Kernels {
            pseudorange: self.pseudorange.at(widening),
            doppler: self.doppler,
            phase: self.phase.at(widening),
            weighted_by_pseudorange: self.weighted_by_pseudorange,
        }
    }

    /// The kernels at the end of a solve.
    pub(super) fn last(&self) -> Kernels {
        self.at(Widening::Final(1.0))
    }
}

/// How a graph is solved.
#[derive(Clone, Debug)]
pub(super) struct GraphSettings {
    pub(super) kernels: AnnealedKernels,
    /// For a window after one new epoch.
    pub(super) update: OptimizerOptions,
    /// For a window or chain with a coarse start.
    pub(super) whole: OptimizerOptions,
}

impl GraphSettings {
    fn alone(options: &GraphOptions) -> Self {
        let law = match options.pseudorange_kernel {
            KernelLaw::Quadratic => Law::Quadratic,
            KernelLaw::Huber => Law::Huber,
            KernelLaw::Cauchy => Law::Cauchy,
            KernelLaw::GemanMcclure | KernelLaw::Mixture => Law::GemanMcClure,
        };
        // A late signal is longer than modelled: its residual (model − measured) is negative.
        let target = Kernel::new(law, options.early_width)
            .one_sided(options.early_width, options.late_width);
        let kernels = |convex| AnnealedKernels {
            pseudorange: AnnealedKernel { convex, target },
            doppler: Kernel::cauchy(options.doppler_width),
            phase: annealed(Kernel::geman_mcclure(options.phase_width)),
            weighted_by_pseudorange: false,
        };
        let solve = |schedule, tolerance| OptimizerOptions { schedule, tolerance, damping: 0.0 };
        // Redescending kernels have many minima: the solve is annealed.
        match law {
            Law::Cauchy | Law::GemanMcClure => Self {
                kernels: kernels(Kernel::huber(HUBER_WIDTH)),
                update: solve(Schedule::graduated(1, 2.0, 2.0, 1, 1), ANNEALED_TOLERANCE),
                whole: solve(Schedule::graduated(2, 15.0, 2.0, 1, 10), ANNEALED_TOLERANCE),
            },
            Law::Quadratic | Law::Huber => Self {
                kernels: kernels(target),
                update: solve(Schedule::direct(2), TOLERANCE),
                whole: solve(Schedule::direct(30), TOLERANCE),
            },
        }
    }

    /// The mixture gives pseudoranges their weights; they need a kernel only in the convex first
    /// stage of a solve. Doppler and phase have the distribution that their noise scale is
    /// estimated with.
    fn learning() -> Self {
        let opening = Kernel::huber(HUBER_WIDTH);
        let solve =
            |schedule| OptimizerOptions { schedule, tolerance: ANNEALED_TOLERANCE, damping: 0.0 };
        Self {
            kernels: AnnealedKernels {
                pseudorange: AnnealedKernel { convex: opening, target: Kernel::QUADRATIC },
                doppler: student(),
                phase: AnnealedKernel { convex: opening, target: student() },
                weighted_by_pseudorange: true,
            },
            update: solve(Schedule::direct(3).while_far(FURTHER)),
            whole: solve(Schedule::graduated(2, 1.0, 2.0, 1, 12)),
        }
    }

    fn relative(options: &GraphOptions) -> Self {
        let solve = |schedule| OptimizerOptions { schedule, tolerance: TOLERANCE, damping: 0.0 };
        Self {
            kernels: AnnealedKernels {
                pseudorange: annealed(Kernel::geman_mcclure(3.0)),
                doppler: Kernel::cauchy(options.doppler_width),
                phase: annealed(CARRIER_KERNEL),
                weighted_by_pseudorange: false,
            },
            update: solve(Schedule::graduated(1, 1.0, 2.0, 1, 3)),
            whole: solve(Schedule::graduated(4, 8.0, 2.0, 1, 4)),
        }
    }
}

/// Cauchy's kernel of width √3: Student's t of three degrees of freedom, except for a factor of 4/3
/// on the weights.
pub(super) fn student() -> Kernel {
    Kernel::cauchy(3_f64.sqrt())
}

/// A redescending kernel with Huber's kernel in the first stage.
fn annealed(target: Kernel) -> AnnealedKernel {
    AnnealedKernel { convex: Kernel::huber(HUBER_WIDTH), target }
}
