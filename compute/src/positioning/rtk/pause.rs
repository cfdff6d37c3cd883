//! Whether arcs have kept their ambiguities over a pause, in which a receiver's epochs are missing.
//!
//! A receiver flags a loss of lock at its next epoch. If that epoch is missing, so is the flag. An
//! arc that has more likely slipped than not ends at the pause ([`super::observed::Losses`]). The
//! others go on, but the receiver may also have lost all satellites at once, as under a bridge. The
//! phases after the pause decide: phases that have slipped do not fit one position and one clock.
//!
//! `kept` is the probability that the arcs that go on have not slipped. Below one half they end,
//! and the solver starts again. Held integers are not more probable than it. The chain without
//! ambiguities uses the rover's phases over the pause only if it is nearly certain.

use crate::positioning::setup::CARRIER_KERNEL;
use crate::snapshot::snapshot_fields;

use super::ambiguity::scale_odds;
use super::observed::{
    Arcs, CarrierArc, DifferenceFactor, EpochAmbiguity, Losses, MORE_LIKELY, RowScratch, RtkEpoch,
    State, whitened,
};

/// Unknowns of the phases after a pause: the position and one clock.
const UNKNOWNS: usize = 4;
/// Density of Student's t₃ at zero: 2/(π√3).
const STUDENT_AT_ZERO: f64 = 0.367_552_596_947_861_4;

/// The time before an epoch in which epochs of rover or base are missing.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pause {
    /// Probability that both receivers have kept lock, before the phases are seen.
    survival: f64,
    /// Whether epochs of the rover are missing.
    is_of_rover: bool,
    /// Whether arcs may go on over it.
    has_arcs: bool,
    /// Probability that the arcs that go on have not slipped.
    pub(crate) kept: f64,
    is_judged: bool,
}

snapshot_fields!(Pause { survival, is_of_rover, has_arcs, kept, is_judged });

impl Pause {
    /// No epoch is missing.
    pub(crate) const NONE: Self =
        Self { survival: 1.0, is_of_rover: false, has_arcs: false, kept: 1.0, is_judged: true };

    /// The pause before an epoch, with the one `before` if no epoch was solved since. `arcs` have
    /// not ended at it.
    pub(crate) fn of(losses: &Losses, before: &Self, arcs: &Arcs) -> Self {
        let open = if before.is_judged { Self::NONE } else { *before };
        let survival = losses.survival * open.survival;
        let is_of_rover = 0.0 < losses.unobserved_s || open.is_of_rover;
        let (has_arcs, is_judged) = (!arcs.list().is_empty(), survival == 1.0);
        Self { survival, is_of_rover, has_arcs, kept: survival, is_judged }
    }

    /// Whether the arcs that go on have more likely slipped than not.
    pub(crate) fn is_refuted(&self) -> bool {
        self.has_arcs && self.kept < MORE_LIKELY
    }

    /// Records that all arcs have ended.
    pub(crate) fn end(&mut self) {
        self.has_arcs = false;
    }

    /// Whether the rover's phases may have slipped in the pause with a probability of more than
    /// 1 − `probability_min`.
    pub(crate) fn may_hide_slips(&self, probability_min: f64) -> bool {
        self.is_of_rover && self.kept < probability_min
    }

    /// Judges the arcs by the phases of an epoch that was solved.
    ///
    /// A phase that goes on has a residual r with the density of Student's t₃, scaled by its σ. One
    /// that has slipped is uniform within its wavelength. Four phases fit in any case, so of n the
    /// ratio of both densities counts with the power (n − 4)/n. The odds of the survival are
    /// multiplied by these ratios. They are divided by the number of choices of n arcs among those
    /// with a phase at this epoch, since the test for slips has chosen the phases that fit.
    pub(crate) fn judge(
        &mut self,
        solved: &SolvedPhases<'_>,
        arcs: &Arcs,
        scratch: &mut RowScratch,
    ) {
        if self.is_judged {
            return;
        }
        self.is_judged = true;
        let SolvedPhases { epoch, state, border, cut } = *solved;
        epoch.see(state, scratch);
        epoch.linearize_carriers(border, scratch);
        let RowScratch { rows, numbers, .. } = &mut *scratch;
        let ratio = |(index, residual): (usize, f64)| {
            let factor: &DifferenceFactor = &epoch.rows[index];
            let EpochAmbiguity { variable, wavelength_m } = factor.ambiguity?;
            let goes_on = |arc: &CarrierArc| arc.variable == variable && 1 < arc.epochs;
            let is_continued = arcs.present(epoch.time).any(goes_on);
            is_continued.then(|| wavelength_m * factor.inverse_sigma * student_density(residual))
        };
        let residuals = epoch.carriers().zip(whitened(rows, &CARRIER_KERNEL, numbers));
        let ratios: Vec<f64> = residuals.filter_map(ratio).collect();
        self.kept = given_phases(self.survival, &ratios, ratios.len() + cut);
    }
}

/// The phases of an epoch that was solved.
#[derive(Clone, Copy)]
pub(crate) struct SolvedPhases<'a> {
    pub(crate) epoch: &'a RtkEpoch,
    pub(crate) state: &'a State,
    /// Ambiguities by variable (cycles).
    pub(crate) border: &'a [f64],
    /// Number of arcs that the test for slips has ended at this epoch.
    pub(crate) cut: usize,
}

/// Density of Student's t with three degrees of freedom.
fn student_density(residual: f64) -> f64 {
    STUDENT_AT_ZERO / (1.0 + residual * residual / 3.0).powi(2)
}

/// The probability `survival` given phases with these ratios of densities, of `arcs` in all.
fn given_phases(survival: f64, ratios: &[f64], arcs: usize) -> f64 {
    let count = ratios.len();
    let mean_log = ratios.iter().map(|ratio| ratio.ln()).sum::<f64>() / count.max(1) as f64;
    let redundant = count.saturating_sub(UNKNOWNS) as f64;
    let choices = (1..=arcs.saturating_sub(count)).map(|k| (count + k) as f64 / k as f64);
    scale_odds((redundant * mean_log).exp() / choices.product::<f64>(), survival)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Survival 0.8 has odds of 4. Six phases with the ratio 5 have two to spare: odds 4·5² = 100.
    /// If a seventh does not fit, there are seven choices of six: 100/7. Four phases always fit,
    /// and of five the choice of four lowers the odds: 4/5. None prove nothing.
    #[test]
    fn agreement_counts_beyond_four_phases() {
        let odds = |count: usize, arcs: usize| {
            let kept = given_phases(0.8, &vec![5.0; count], arcs);
            kept / (1.0 - kept)
        };
        assert!((odds(6, 6) - 100.0).abs() < 1e-9);
        assert!((odds(6, 7) - 100.0 / 7.0).abs() < 1e-9);
        assert!((odds(4, 4) - 4.0).abs() < 1e-9);
        assert!((odds(4, 5) - 0.8).abs() < 1e-9);
        assert!((odds(0, 0) - 4.0).abs() < 1e-9);
        // Residuals that are no likelier without slips prove nothing.
        assert!((given_phases(0.8, &[1.0; 12], 12) - 0.8).abs() < 1e-9);
    }

    /// Student's t₃ at one scale: 6√3/(π(3 + 1)²) = 0.206748.
    #[test]
    fn a_density_from_the_formula() {
        assert!((student_density(1.0) - 0.206_748).abs() < 1e-6);
        assert_eq!(student_density(-2.0), student_density(2.0));
    }
}
