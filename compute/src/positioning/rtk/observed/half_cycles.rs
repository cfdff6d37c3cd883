//! Half cycles between the ambiguities of two arcs of one carrier.
//!
//! A receiver that does not know the polarity of the navigation message tracks the carrier with an
//! ambiguity of half a cycle, and reports this. When it finds the polarity, the phase stays or
//! steps by half a cycle. Until then the ambiguity is not an integer, so an arc ends where the
//! report changes. If the loop did not lose lock meanwhile, the ambiguities before and after differ
//! by −½, 0 or ½ cycle. The other phases show which step it is, and the new arc continues the
//! ambiguity of the old one.

use super::slips::SLIP_SIGMAS;

/// The step between two ambiguities whose estimates differ by `difference` (cycles) with this
/// variance (cycles²): −½, 0 or ½ cycle; `None` if the estimates fit none of them, or if the
/// probability of the best one is below `probability_min`.
///
/// P = e^(−(d − k)²/2σ²) / Σ e^(−(d − k′)²/2σ²) over the three steps, which are equally likely a
/// priori.
pub(crate) fn half_cycle_step(difference: f64, variance: f64, probability_min: f64) -> Option<f64> {
    let density = |step: f64| (-0.5 * (difference - step).powi(2) / variance).exp();
    let steps = [-0.5, 0.0, 0.5];
    let best = steps.into_iter().max_by(|a, b| density(*a).total_cmp(&density(*b)))?;
    let probability = density(best) / steps.map(density).iter().sum::<f64>();
    let fits = (difference - best).powi(2) <= SLIP_SIGMAS.powi(2) * variance;
    (fits && probability_min <= probability).then_some(best)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// σ = 0.1: at 0.52 the density of ½ is e^(−0.02), that of 0 e^(−13.52), so P = 1 − 1.4·10⁻⁶.
    /// At 0.3 they are e^(−2) and e^(−4.5), P = 0.924.
    #[test]
    fn a_step_worked_by_hand() {
        assert_eq!(half_cycle_step(0.52, 0.01, 0.999_998), Some(0.5));
        assert_eq!(half_cycle_step(0.52, 0.01, 0.999_999), None);
        assert_eq!(half_cycle_step(-0.03, 0.01, 0.997), Some(0.0));
        assert_eq!(half_cycle_step(0.3, 0.01, 0.92), Some(0.5));
        assert_eq!(half_cycle_step(0.3, 0.01, 0.93), None);
    }

    /// With σ = 0.05 a step of 0.8 cycles is 6σ from ½: the carrier slipped. No step is certain
    /// with σ = 0.5, nor with an invalid variance.
    #[test]
    fn slips_and_uncertain_steps_are_none() {
        assert_eq!(half_cycle_step(0.8, 0.0025, 0.997), None);
        assert_eq!(half_cycle_step(0.0, 0.25, 0.997), None);
        assert_eq!(half_cycle_step(0.0, f64::NAN, 0.0), None);
    }
}
