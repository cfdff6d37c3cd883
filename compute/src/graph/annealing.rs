//! Graduated non-convexity: a solve begins with convex kernels and narrows them to the final ones.
//!
//! The cost of a redescending kernel has many minima. Yang et al. solve a family of losses ρ_μ
//! instead: for Geman–McClure ρ_μ(s) = μc²s²/2(μc² + s²), which for large μ is convex at all
//! residuals that occur, and at μ = 1 is the kernel itself. That is the kernel with its width
//! multiplied by √μ, here called the *widening*, and the same rule serves every law. Each stage
//! starts at the estimate of the stage before.
//!
//! Source: Yang, Antonante, Tzoumas & Carlone (2020), *Graduated non-convexity for robust spatial
//! perception*, IEEE RA-L 5(2), section IV.

use crate::graph::kernel::Kernel;

/// How far the kernels of a stage are widened.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Widening {
    /// The first stage: a row uses its convex kernel.
    Convex,
    /// A row uses its final kernel with its widths multiplied by this number, one at the end.
    Final(f64),
}

/// A kernel, and the convex one that a solve begins with.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AnnealedKernel {
    /// Used in [`Widening::Convex`].
    pub convex: Kernel,
    /// Used in [`Widening::Final`], widened.
    pub target: Kernel,
}

impl AnnealedKernel {
    /// The same kernel at the start and at the end.
    pub fn constant(kernel: Kernel) -> Self {
        Self { convex: kernel, target: kernel }
    }

    /// The kernel at a widening.
    #[inline]
    pub fn at(&self, widening: Widening) -> Kernel {
        match widening {
            Widening::Convex => self.convex,
            Widening::Final(widening) => self.target.widened(widening),
        }
    }
}

/// A widening and its number of iterations.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stage {
    /// The widening.
    pub widening: Widening,
    /// Maximum number of iterations; convergence ends the stage earlier.
    pub iterations: usize,
    /// Maximum number beyond that, as long as a step is longer than one standard deviation.
    pub further: usize,
}

impl Stage {
    fn new(widening: Widening, iterations: usize) -> Self {
        Self { widening, iterations, further: 0 }
    }
}

/// The stages of a solve, in order.
#[derive(Clone, Debug, PartialEq)]
pub struct Schedule(Vec<Stage>);

impl Schedule {
    /// One stage with the final kernels: for convex kernels, or where the start is good.
    pub fn direct(iterations: usize) -> Self {
        Self(vec![Stage::new(Widening::Final(1.0), iterations)])
    }

    /// `convex` iterations with the convex kernels; then `each` iterations at each of the widenings
    /// `widest`, `widest`/`ratio`, … above one; then `last` iterations with the final kernels.
    ///
    /// `ratio` is above one.
    pub fn graduated(convex: usize, widest: f64, ratio: f64, each: usize, last: usize) -> Self {
        let mut stages = Vec::new();
        if 0 < convex {
            stages.push(Stage::new(Widening::Convex, convex));
        }
        let mut widening = widest;
        while 1.0 < widening && 1.0 < ratio {
            stages.push(Stage::new(Widening::Final(widening), each));
            widening /= ratio;
        }
        stages.push(Stage::new(Widening::Final(1.0), last));
        Self(stages)
    }

    /// The same, with up to `further` iterations of the last stage as long as a step is longer than
    /// one standard deviation: for a start that is usually near the minimum, but not always.
    pub fn while_far(mut self, further: usize) -> Self {
        if let Some(last) = self.0.last_mut() {
            last.further = further;
        }
        self
    }

    /// The stages.
    pub(crate) fn stages(&self) -> &[Stage] {
        &self.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 15 → 1 by 1.4: ln 15/ln 1.4 = 8.05, so nine wide stages, one convex, one final.
    #[test]
    fn graduated_narrows_to_the_kernel_itself() {
        let schedule = Schedule::graduated(6, 15.0, 1.4, 2, 10);
        let stages = schedule.stages();
        assert_eq!(stages.len(), 11);
        assert_eq!(stages[0], Stage::new(Widening::Convex, 6));
        assert_eq!(stages[10], Stage::new(Widening::Final(1.0), 10));
        let widenings = stages[1..].iter().map(|stage| match stage.widening {
            Widening::Final(widening) => widening,
            Widening::Convex => panic!("convex stage after the first"),
        });
        assert!(widenings.clone().zip(widenings.skip(1)).all(|(wide, narrow)| narrow < wide));
    }

    /// Yang et al. (2020), example 2: w = (μc²/(s² + μc²))², with μ = widening².
    #[test]
    fn widening_is_the_square_root_of_mu() {
        let kernel =
            AnnealedKernel { convex: Kernel::huber(1.345), target: Kernel::geman_mcclure(2.0) };
        let (mu, c2, s): (f64, f64, f64) = (9.0, 4.0, 5.0);
        let published = (mu * c2 / (s * s + mu * c2)).powi(2);
        assert!((kernel.at(Widening::Final(mu.sqrt())).weight(s) - published).abs() < 1e-15);
        assert_eq!(kernel.at(Widening::Convex), Kernel::huber(1.345));
        assert_eq!(kernel.at(Widening::Final(1.0)), kernel.target);
    }
}
