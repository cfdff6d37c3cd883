//! The residual test, the exclusion of an outlier, and the robust solution if there are several.
//!
//! Global test: the sum of squared whitened residuals against its chi-square limit. If it fails and
//! enough redundancy remains for a second test, the satellite is excluded whose removal lowers the
//! sum most, w·r²/(1 − w·aᵀQa): Baarda's (1968) w-test, which is the generalised likelihood ratio
//! of an error in that satellite alone. Only one satellite is excluded: with several reflections,
//! repeated exclusion soon leaves a set that agrees on a wrong position.
//!
//! If one exclusion does not lead to a set that agrees, all satellites stay and Huber's (1964)
//! weights min(1, c/|s|) bound the influence of each: c = 1.345 for late signals, twice that for
//! early ones, because a reflected path is always longer than the direct one.

use crate::gnss::Ecef;
use crate::graph::HUBER_WIDTH;

use super::least_squares::{Row, Step};
use super::{EpochInputs, Fit, LAST_STEP_M, SinglePoint};

/// Smallest fraction of an error that its residual must show; a satellite with less cannot be
/// tested.
pub(super) const REDUNDANCY_MIN: f64 = 1e-6;
/// Degrees of freedom that must remain after an exclusion. With fewer, a subset that agrees can
/// always be found among satellites that share a reflection.
const DEGREES_LEFT_MIN: usize = 3;
/// Huber's constant for late signals (residual negative): 95 % efficiency under normal errors.
const HUBER_LATE: f64 = HUBER_WIDTH;
/// Huber's constant for early signals.
const HUBER_EARLY: f64 = 2.0 * HUBER_LATE;
/// Maximum number of reweighted solutions.
const REWEIGHTINGS_MAX: usize = 500;
/// Distance within which rows stay linearised until their weights have converged (m): the range's
/// curvature is less than a millimetre.
const STRAIGHT_M: f64 = 100.0;
/// Change of position below which the weights have converged (m).
const CONVERGED_M: f64 = 1e-6;

impl SinglePoint {
    /// The fit itself if its residuals agree; otherwise a fit with the outlier excluded or with
    /// bounded influence.
    pub(super) fn validated(&mut self, inputs: &EpochInputs<'_>, all: Fit) -> Fit {
        if all.test_ratio.is_none() || all.is_valid() {
            return all;
        }
        let one_less = match DEGREES_LEFT_MIN < all.degrees && !all.step.is_tied() {
            true => self.without_worst(inputs, &all),
            false => None,
        };
        match one_less {
            Some(fit) if fit.is_valid() => fit,
            _ => self.bounded(inputs, all),
        }
    }

    /// The fit of all satellites with bounded influence; `all` itself if that fit fails.
    fn bounded(&mut self, inputs: &EpochInputs<'_>, all: Fit) -> Fit {
        self.measurements.list.iter_mut().for_each(|measurement| measurement.is_excluded = false);
        self.linearize(all.origin);
        let (mut origin, Ok(mut step)) = (all.origin, self.determined_step()) else { return all };
        for _ in 0..REWEIGHTINGS_MAX {
            self.reweigh(&step);
            let Some(mut next) = self.step_of(&self.rows) else { return all };
            let has_settled = (next.position_m - step.position_m).norm() < CONVERGED_M;
            let moved_m = next.position_m.norm();
            if has_settled && moved_m <= LAST_STEP_M {
                step = next;
                break;
            }
            if has_settled || STRAIGHT_M < moved_m {
                // The weights carry over to rows at the new position.
                origin.0 += next.position_m;
                let Some(moved) = self.replaced(inputs, origin, &next) else { return all };
                next = moved;
            }
            step = next;
        }
        Fit { test_ratio: all.test_ratio, ..self.judge(inputs, origin, step) }
    }

    /// Rows corrected and linearised at `origin`, with the weights that their residuals had before.
    fn replaced(&mut self, inputs: &EpochInputs<'_>, origin: Ecef, before: &Step) -> Option<Step> {
        let (time, options) = (inputs.epoch.time, inputs.options());
        self.reweigh(before);
        let kernels: Vec<(usize, f64)> =
            self.rows.iter().map(|row| (row.index, self.kernel(row))).collect();
        self.measurements.place(origin, time, inputs.navigation, options)?;
        self.linearize(origin);
        self.determined_step().ok()?;
        for row in &mut self.rows {
            let known = kernels.iter().find(|(index, _)| *index == row.index);
            row.weight *= known.map_or(1.0, |(_, kernel)| *kernel);
        }
        self.step_of(&self.rows)
    }

    /// The kernel weight of a row.
    fn kernel(&self, row: &Row) -> f64 {
        row.weight * self.measurements.list[row.index].variance_m2
    }

    /// Sets the weight of every row by its residual after `step`.
    fn reweigh(&mut self, step: &Step) {
        for row in &mut self.rows {
            let stated = self.measurements.list[row.index].variance_m2.recip();
            let whitened = step.residual_after_m(row) * stated.sqrt();
            let bound = if whitened < 0.0 { HUBER_LATE } else { HUBER_EARLY };
            row.weight = stated * (bound / whitened.abs()).min(1.0);
        }
    }

    /// The fit of the rows in use.
    pub(super) fn judge(&self, inputs: &EpochInputs<'_>, origin: Ecef, step: Step) -> Fit {
        let degrees = step.degrees();
        let squares = step.squares(&self.rows);
        let redundant = 0 < degrees;
        Fit {
            origin,
            step,
            degrees,
            test_ratio: redundant.then(|| squares / inputs.setup.residual_limits.at(degrees)),
            variance_factor: if redundant { (squares / degrees as f64).max(1.0) } else { 1.0 },
        }
    }

    /// The fit without the satellite that contradicts the others most; `None` if there is not
    /// enough redundancy.
    fn without_worst(&mut self, inputs: &EpochInputs<'_>, fit: &Fit) -> Option<Fit> {
        let gain = |row: &Row| {
            let redundancy = 1.0 - row.weight * fit.step.variance_of(row);
            let judged = row.is_used && REDUNDANCY_MIN < redundancy;
            let square = row.weight * fit.step.residual_after_m(row).powi(2);
            if judged { square / redundancy } else { 0.0 }
        };
        let worst = self.rows.iter().max_by(|a, b| gain(a).total_cmp(&gain(b)))?.index;
        self.measurements.list[worst].is_excluded = true;
        self.refit(inputs, fit.origin)
    }

    /// Solves again without the excluded satellites, from rows at `origin` if that step is short.
    fn refit(&mut self, inputs: &EpochInputs<'_>, origin: Ecef) -> Option<Fit> {
        self.linearize(origin);
        let step = self.determined_step().ok()?;
        if step.position_m.norm() < LAST_STEP_M {
            return Some(self.judge(inputs, origin, step));
        }
        let (origin, step) = self.converge(inputs, Ecef(origin.0 + step.position_m)).ok()?;
        Some(self.judge(inputs, origin, step))
    }
}
