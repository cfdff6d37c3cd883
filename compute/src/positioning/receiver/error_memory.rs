//! Correlation of the pseudorange errors of successive epochs.
//!
//! Errors of one satellite are modelled as a first-order Gauss–Markov process: their correlation
//! over Δt is ρ = r^Δt, with the correlation r over one second. The mean of many epochs then has κ
//! = (1 − ρ)/(1 + ρ) of the information of independent ones (Bartlett 1946), and each pseudorange
//! enters the graph with this fraction. So the information per second does not depend on the rate
//! of epochs.
//!
//! r is estimated from products of whitened residuals of the same satellite in successive epochs.
//! Its start and upper bound is the correlation of multipath of a vehicle in a street, with a
//! correlation time of five seconds. The bound is needed because residuals also contain the slow
//! errors of the estimate itself, which must not increase the weight of the pseudoranges.

use crate::gnss::SatelliteId;
use crate::snapshot::snapshot_fields;

use super::kept;
use super::pseudorange_noise::PseudorangeExcess;

/// Correlation time of multipath in a street (s).
const CORRELATION_S: f64 = 5.0;
/// Weight of the prior, as a number of products of residuals.
const PRIOR_PRODUCTS: f64 = 200.0;
/// Epochs further apart than this are not compared (s).
const INTERVAL_MAX_S: f64 = 5.0;
/// Bound of whitened residuals, so that single reflections do not dominate.
const CUT_OFF: f64 = 3.0;
/// Lower bound of κ, reached at 100 epochs a second.
const SHARE_MIN: f64 = 1e-3;

/// Whitened residuals of the newest epoch, and the sums that give r.
#[derive(Clone, Debug, Default)]
pub(super) struct ErrorMemory {
    newest: Vec<(SatelliteId, f64)>,
    /// Sum of products of successive residuals, scaled to an interval of one second.
    products: f64,
    /// Sum of their squares.
    squares: f64,
}

snapshot_fields!(ErrorMemory { newest, products, squares });

impl ErrorMemory {
    /// κ of a pseudorange `spacing_s` after the last one.
    pub(super) fn independent_share(&self, spacing_s: f64) -> f64 {
        let prior = (-CORRELATION_S.recip()).exp();
        let learnt = (self.products + PRIOR_PRODUCTS * prior) / (self.squares + PRIOR_PRODUCTS);
        let correlation = learnt.clamp(0.0, prior).powf(spacing_s);
        ((1.0 - correlation) / (1.0 + correlation)).max(SHARE_MIN)
    }

    /// Updates with the residuals of an epoch.
    pub(super) fn learn(&mut self, interval_s: f64, residuals: &[PseudorangeExcess]) {
        let whitened = |r: &PseudorangeExcess| (r.excess_m / r.sigma_m).clamp(-CUT_OFF, CUT_OFF);
        let keep = kept(interval_s);
        self.products *= keep;
        self.squares *= keep;
        if interval_s <= INTERVAL_MAX_S {
            let (mut products, mut squares) = (0.0, 0.0);
            for residual in residuals {
                let same = |(satellite, _): &&(SatelliteId, f64)| *satellite == residual.satellite;
                let Some((_, before)) = self.newest.iter().find(same) else { continue };
                let now = whitened(residual);
                products += now * before;
                squares += 0.5 * (now * now + before * before);
            }
            if 0.0 < squares {
                let correlation = (products / squares).clamp(0.0, 1.0).powf(interval_s.recip());
                let weight = squares * interval_s.min(1.0);
                self.products += weight * correlation;
                self.squares += weight;
            }
        }
        self.newest.clear();
        self.newest.extend(residuals.iter().map(|r| (r.satellite, whitened(r))));
    }
}

#[cfg(test)]
mod tests {
    use super::super::Signal;
    use super::*;

    fn residual(excess_m: f64) -> PseudorangeExcess {
        PseudorangeExcess {
            satellite: "G01".parse().unwrap(),
            signal: Signal { cn0_db_hz: None, elevation_rad: 1.0, model_m: 0.0 },
            sigma_m: 1.0,
            excess_m,
        }
    }

    /// ρ = e^(−1/5) = 0.8187: κ = 0.1813/1.8187. A tenth of the interval, ρ = 0.9802, a tenth of κ.
    #[test]
    fn the_share_worked_by_hand() {
        let memory = ErrorMemory::default();
        assert!((memory.independent_share(1.0) - 0.099_67).abs() < 1e-4);
        assert!((memory.independent_share(0.1) - 0.010_0).abs() < 1e-4);
        assert!((memory.independent_share(60.0) - 1.0).abs() < 1e-4);
    }

    /// Errors of alternating sign are independent; constant errors leave κ at its start.
    #[test]
    fn the_share_follows_the_residuals() {
        let learnt = |sign: f64| {
            let mut memory = ErrorMemory::default();
            (0..2_000).for_each(|k| memory.learn(1.0, &[residual(2.0 * sign.powi(k))]));
            memory.independent_share(1.0)
        };
        assert!(0.5 < learnt(-1.0) && (learnt(1.0) - 0.099_67).abs() < 1e-4);
    }
}
