//! The pseudorange factor.

use crate::graph::Row;
use crate::snapshot::snapshot_fields;

use super::{CLOCK, Line, POSITION_AND_CLOCK, State};

/// Pseudorange factor on one state and, for a further constellation, its bias.
///
/// r = (ρ(s, p) + b + β − P) / σ
///
/// p local position (m), b receiver clock (m), β inter-system bias (m), zero for the reference
/// constellation. P is corrected for c·δtˢ, group delay, troposphere and ionosphere. ∂r/∂β = 1/σ.
///
/// Source: Wen & Hsu (2021), equations (9) and (10), which have one clock.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct PseudorangeFactor {
    /// P (m).
    pub(crate) corrected_range_m: f64,
    /// 1/σ (1/m).
    pub(crate) inverse_sigma: f64,
}

impl PseudorangeFactor {
    /// Whitened residual and its Jacobian on [p; b], the satellite seen from the state's position.
    #[inline]
    pub(crate) fn linearize(&self, (range_m, slope): &Line, state: &State, bias_m: f64) -> Row<4> {
        let w = self.inverse_sigma;
        Row {
            residual: (range_m + state[CLOCK] + bias_m - self.corrected_range_m) * w,
            columns: POSITION_AND_CLOCK,
            jacobian: [slope.x * w, slope.y * w, slope.z * w, w],
        }
    }
}

snapshot_fields!(PseudorangeFactor { corrected_range_m, inverse_sigma });

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gnss::{Ecef, LocalFrame};
    use crate::positioning::factors::sample::{SATELLITE, check_row, frame, state};
    use crate::positioning::factors::{Sight, position};

    const FACTOR: PseudorangeFactor =
        PseudorangeFactor { corrected_range_m: 2.1e7, inverse_sigma: 0.5 };

    fn row(state: &State, bias_m: f64) -> Row<4> {
        let line = Sight::new(&frame(), SATELLITE).range(&position(state));
        FACTOR.linearize(&line, state, bias_m)
    }

    /// The 3-4-5 line of `models::geometry`: 25 000 km minus 25.540 m; clock 30 m, bias 2 m.
    #[test]
    fn a_residual_worked_by_hand() {
        let frame = LocalFrame::at(Ecef::new(6e6, 1e6, 0.0));
        let sight = Sight::new(&frame, Ecef::new(21e6, 21e6, 0.0));
        let factor = PseudorangeFactor { corrected_range_m: 25e6, inverse_sigma: 0.5 };
        let mut state = State::zeros();
        state[CLOCK] = 30.0;
        let row = factor.linearize(&sight.range(&position(&state)), &state, 2.0);
        assert!((row.residual - (32.0 - 25.540_071_805) / 2.0).abs() < 1e-6, "{}", row.residual);
    }

    #[test]
    fn the_jacobian_is_the_derivative() {
        check_row(&state(), |state| row(state, 3.0));
        let slope = row(&state(), 4.0).residual - row(&state(), 2.0).residual;
        assert!((slope / 2.0 - FACTOR.inverse_sigma).abs() < 1e-6);
    }

    /// The Sagnac term is 1.4 m here, half of it over σ; a factor without it would be wrong by this
    /// much.
    #[test]
    fn the_earth_turns() {
        let frame = frame();
        let distance_m = (SATELLITE.0 - frame.origin.0).norm();
        let residual = row(&State::zeros(), 0.0).residual;
        assert!(0.5 < (residual - (distance_m - 2.1e7) * 0.5).abs());
    }
}
