//! Depth-first search for the integers closest in the metric of a decorrelated covariance.
//!
//! ‖ẑ − z‖² = Σ_k (z̄_k − z_k)²/d_k, z̄_k = ẑ_k + Σ_{j>k} (z_j − z̄_j) l_jk
//!
//! The search goes from the last entry to the first and tries the nearest integers first. The
//! ellipsoid shrinks to the norm of the worst stored candidate.
//!
//! Source: Chang, Yang & Zhou (2005), whose search is Schnorr & Euchner's enumeration.

use crate::lambda::nearest;
use crate::lambda::reduction::Reduction;

/// Limits of a search.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct SearchLimits {
    /// Number of best integer vectors to store.
    pub candidates: usize,
    /// Number of integers tried before the search stops.
    pub nodes: usize,
}

/// How a search ended, with the number of integers tried.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum SearchOutcome {
    /// The candidates are the best of all integers.
    Complete {
        /// Number of integers tried.
        nodes: usize,
    },
    /// The limit was reached: better candidates may exist.
    LimitReached {
        /// Number of integers tried.
        nodes: usize,
    },
}

impl SearchOutcome {
    /// Number of integers tried.
    pub(crate) fn nodes(self) -> usize {
        match self {
            Self::Complete { nodes } | Self::LimitReached { nodes } => nodes,
        }
    }
}

/// Workspace of the search, and the candidates of the last one, best first.
#[derive(Clone, Debug)]
pub(crate) struct Search {
    length: usize,
    levels: Vec<Level>,
    shifts: Vec<f64>,
    norms: Vec<f64>,
    candidates: Vec<f64>,
}

/// State of one level: conditional centre, integer tried, next step, norm so far.
#[derive(Clone, Copy, Debug)]
struct Level {
    center: f64,
    integer: f64,
    step: f64,
    norm: f64,
}

impl Level {
    /// The nearest integer first, then outwards on alternating sides.
    fn around(center: f64, norm: f64) -> Self {
        let integer = nearest(center);
        Self { center, integer, step: if center < integer { -1.0 } else { 1.0 }, norm }
    }

    fn advance(&mut self) {
        self.integer += self.step;
        self.step = -self.step - self.step.signum();
    }
}

impl Search {
    /// A workspace with room for `size` entries.
    pub(crate) fn with_capacity(size: usize) -> Self {
        Self {
            length: 0,
            levels: Vec::with_capacity(size),
            shifts: Vec::with_capacity(size * size),
            norms: Vec::new(),
            candidates: Vec::new(),
        }
    }

    /// Finds the best integers for the decorrelated entries.
    ///
    /// # Panics
    /// If there is no entry, or no candidate is requested.
    pub(crate) fn run(&mut self, reduction: &Reduction, limits: SearchLimits) -> SearchOutcome {
        let (n, float) = (reduction.size(), reduction.floats());
        assert!(0 < n && 0 < limits.candidates, "nothing to search");
        self.prepare(n);
        let mut k = n - 1;
        self.levels[k] = Level::around(float[k], 0.0);
        let mut radius = f64::INFINITY;
        for nodes in 1..=limits.nodes {
            let level = self.levels[k];
            let off = level.center - level.integer;
            let norm = level.norm + off * off / reduction.variances()[k];
            if norm < radius && k != 0 {
                self.descend(reduction, float, k);
                k -= 1;
                self.levels[k].norm = norm;
            } else if norm < radius {
                self.keep(norm, limits.candidates);
                if self.norms.len() == limits.candidates {
                    radius = self.norms[limits.candidates - 1];
                }
                self.levels[k].advance();
            } else if k == n - 1 {
                return SearchOutcome::Complete { nodes };
            } else {
                k += 1;
                self.levels[k].advance();
            }
        }
        SearchOutcome::LimitReached { nodes: limits.nodes }
    }

    /// Squared norms ‖ẑ − z‖² of the candidates found, ascending.
    pub(crate) fn norms(&self) -> &[f64] {
        &self.norms
    }

    /// The integers of candidate `i`, as integral values.
    pub(crate) fn candidate(&self, i: usize) -> &[f64] {
        &self.candidates[i * self.length..(i + 1) * self.length]
    }

    fn prepare(&mut self, n: usize) {
        self.length = n;
        self.levels.clear();
        self.levels.resize(n, Level::around(0.0, 0.0));
        self.shifts.clear();
        self.shifts.resize(n * n, 0.0);
        self.norms.clear();
        self.candidates.clear();
    }

    /// Conditions all entries below `k` on the integer at `k` and opens level k−1.
    fn descend(&mut self, reduction: &Reduction, float: &[f64], k: usize) {
        let n = float.len();
        let off = self.levels[k].integer - self.levels[k].center;
        let (below, above) = self.shifts.split_at_mut(k * n);
        let target = &mut below[(k - 1) * n..(k - 1) * n + k];
        let factor = &reduction.factor_row(k)[..k];
        for ((shift, before), l) in target.iter_mut().zip(&above[..k]).zip(factor) {
            *shift = before + off * l;
        }
        let center = float[k - 1] + self.shifts[(k - 1) * n + k - 1];
        self.levels[k - 1] = Level::around(center, 0.0);
    }

    /// Inserts the present integers by norm, dropping the worst beyond `most`.
    fn keep(&mut self, norm: f64, most: usize) {
        let at = self.norms.partition_point(|&other| other <= norm);
        if self.norms.len() == most {
            self.norms.pop();
            self.candidates.truncate((most - 1) * self.length);
        }
        self.norms.insert(at, norm);
        self.candidates.extend(self.levels.iter().map(|level| level.integer));
        self.candidates[at * self.length..].rotate_right(self.length);
    }
}
