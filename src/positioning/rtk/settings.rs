//! What the options mean to the graph: kernels, schedules, walks.

use crate::config::PositioningOptions;
use crate::graph::{AnnealedKernel, Kernel, OptimizerOptions, Phase, Schedule};
use crate::positioning::factors::MotionWalk;

/// Huber's constant: 95 % efficiency under normal errors.
const HUBER: f64 = 1.345;
/// Steps shorter than this many standard deviations of the answer end a solve.
const TOLERANCE: f64 = 1e-2;

/// By which the offset of a group is found.
pub(super) const OFFSET_KERNEL: Kernel = Kernel::huber(HUBER);
/// What carriers' kernel becomes.
pub(super) const CARRIER_KERNEL: Kernel = Kernel::geman_mcclure(4.0);

/// Robust kernels of the measurements.
#[derive(Clone, Copy, Debug)]
pub(super) struct Kernels {
    pseudorange: AnnealedKernel,
    carrier: AnnealedKernel,
    doppler: Kernel,
}

impl Kernels {
    /// The kernels of one phase: pseudoranges', carriers' and Doppler shifts'.
    pub(super) fn at(&self, phase: Phase) -> [Kernel; 3] {
        [self.pseudorange.at(phase), self.carrier.at(phase), self.doppler]
    }
}

/// Everything the window takes from the options.
#[derive(Clone, Debug)]
pub(super) struct Settings {
    pub(super) kernels: Kernels,
    pub(super) motion: MotionWalk,
    /// For an epoch more.
    pub(super) update: OptimizerOptions,
    /// For a window whose start is coarse.
    pub(super) whole: OptimizerOptions,
}

impl Settings {
    pub(super) fn new(options: &PositioningOptions) -> Self {
        let annealed = |target| AnnealedKernel { convex: Kernel::huber(HUBER), target };
        let solve = |schedule| OptimizerOptions { schedule, tolerance: TOLERANCE, damping: 0.0 };
        let (horizontal, up) = (options.graph.horizontal_walk_m_s, options.graph.vertical_walk_m_s);
        Self {
            kernels: Kernels {
                pseudorange: annealed(Kernel::geman_mcclure(3.0)),
                carrier: annealed(CARRIER_KERNEL),
                doppler: Kernel::cauchy(options.graph.doppler_width),
            },
            motion: MotionWalk { velocity_m_s: [horizontal, horizontal, up] },
            update: solve(Schedule::graduated(1, 1.0, 2.0, 1, 3)),
            whole: solve(Schedule::graduated(4, 8.0, 2.0, 1, 4)),
        }
    }
}
