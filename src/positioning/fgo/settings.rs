//! What the options mean to the graph: kernels, schedules, walks.

use crate::config::{GraphOptions, KernelLaw};
use crate::graph::{AnnealedKernel, Kernel, Law, OptimizerOptions, Phase, Schedule};

use crate::positioning::factors::{ClockWalk, MotionWalk};
use crate::positioning::standstill::StandstillTest;

/// Huber's constant: 95 % efficiency under normal errors.
const HUBER: f64 = 1.345;
/// Steps shorter than this many standard deviations of the answer end a solve.
const TOLERANCE: f64 = 1e-2;
/// The same of kernels that redescend: they reject what would hold a solve up, and converge soon.
const ANNEALED_TOLERANCE: f64 = 5e-2;

/// Robust kernels of the measurements.
#[derive(Clone, Copy, Debug)]
pub(super) struct Kernels {
    pub(super) pseudorange: AnnealedKernel,
    pub(super) doppler: AnnealedKernel,
    pub(super) phase: AnnealedKernel,
}

impl Kernels {
    fn new(options: &GraphOptions) -> Self {
        let law = match options.pseudorange_kernel {
            KernelLaw::Quadratic => Law::Quadratic,
            KernelLaw::Huber => Law::Huber,
            KernelLaw::Cauchy => Law::Cauchy,
            KernelLaw::GemanMcclure => Law::GemanMcClure,
        };
        // A late signal is longer than the model: its residual (model − measured) is negative.
        let target = Kernel::new(law, options.early_width)
            .one_sided(options.early_width, options.late_width);
        let phase = Kernel::geman_mcclure(options.phase_width);
        let convex = match law {
            Law::Cauchy | Law::GemanMcClure => Kernel::huber(HUBER),
            Law::Quadratic | Law::Huber => target,
        };
        Self {
            pseudorange: AnnealedKernel { convex, target },
            doppler: AnnealedKernel::constant(Kernel::cauchy(options.doppler_width)),
            phase: AnnealedKernel { convex: Kernel::huber(HUBER), target: phase },
        }
    }

    /// The kernels of one phase, pseudoranges tempered by their epoch later.
    pub(super) fn at(&self, phase: Phase) -> [Kernel; 3] {
        [self.pseudorange.at(phase), self.doppler.convex, self.phase.at(phase)]
    }

    /// Whether the kernels have many minima, so that a solve must be annealed.
    fn is_redescending(&self) -> bool {
        matches!(self.pseudorange.target.law, Law::Cauchy | Law::GemanMcClure)
    }
}

/// Everything the graph takes from the options.
#[derive(Clone, Debug)]
pub(super) struct Settings {
    pub(super) kernels: Kernels,
    pub(super) motion: MotionWalk,
    pub(super) clock: ClockWalk,
    /// Variance of what orbits and clocks broadcast put into a range (m²).
    pub(super) orbit_clock_m2: f64,
    /// The test for standstill, where it is made.
    pub(super) standstill: Option<StandstillTest>,
    /// For an epoch more.
    pub(super) update: OptimizerOptions,
    /// For a whole chain whose start is coarse.
    pub(super) whole: OptimizerOptions,
}

impl Settings {
    pub(super) fn new(options: &GraphOptions) -> Self {
        let kernels = Kernels::new(options);
        let (update, whole) = match kernels.is_redescending() {
            true => {
                (Schedule::graduated(1, 2.0, 2.0, 1, 1), Schedule::graduated(2, 15.0, 2.0, 1, 10))
            }
            false => (Schedule::direct(2), Schedule::direct(30)),
        };
        let tolerance = if kernels.is_redescending() { ANNEALED_TOLERANCE } else { TOLERANCE };
        let solve = |schedule| OptimizerOptions { schedule, tolerance, damping: 0.0 };
        Self {
            kernels,
            motion: MotionWalk::of(options),
            clock: ClockWalk::of(options),
            orbit_clock_m2: options.orbit_clock_sigma_m.powi(2),
            standstill: options.zero_velocity.then(StandstillTest::new),
            update: solve(update),
            whole: solve(whole),
        }
    }
}
