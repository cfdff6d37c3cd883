//! The time-differenced carrier phase of one satellite.

use crate::graph::Link;
use crate::snapshot::snapshot_fields;

use super::{CLOCK, Line, POSITION_AND_CLOCK, State};

/// Phase-difference factor between two states.
///
/// r = (ρ(s₊, p₊) − ρ(s, p) + b₊ − b − Δφ) / σ
///
/// Δφ is the change of the carrier phase between the two epochs (m), corrected for satellite clock,
/// troposphere and ionosphere. Without a cycle slip the ambiguity cancels, and so does an
/// inter-system bias.
///
/// Source: van Graas & Soloviev (2004), *Precise velocity estimation using a stand-alone GPS
/// receiver*, Navigation 51(4).
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct PhaseDifferenceFactor {
    /// Index of the satellite among the sights of the earlier epoch.
    pub(crate) before: u16,
    /// Its index among those of the later epoch.
    pub(crate) after: u16,
    /// Δφ (m).
    pub(crate) change_m: f64,
    /// 1/σ (1/m).
    pub(crate) inverse_sigma: f64,
}

impl PhaseDifferenceFactor {
    /// Whitened residual and its Jacobian on [p; b] and [p₊; b₊], with the satellite seen from both
    /// positions.
    #[inline]
    pub(crate) fn linearize(
        &self,
        ((from_m, old), state): (&Line, &State),
        ((to_m, new), next): (&Line, &State),
    ) -> Link<4, 4> {
        let w = self.inverse_sigma;
        let moved = to_m - from_m + next[CLOCK] - state[CLOCK];
        Link {
            residual: (moved - self.change_m) * w,
            columns: POSITION_AND_CLOCK,
            jacobian: [-old.x * w, -old.y * w, -old.z * w, -w],
            next_columns: POSITION_AND_CLOCK,
            next_jacobian: [new.x * w, new.y * w, new.z * w, w],
        }
    }
}

snapshot_fields!(PhaseDifferenceFactor { before, after, change_m, inverse_sigma });

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gnss::{Ecef, LocalFrame};
    use crate::positioning::factors::sample::{LATER, SATELLITE, check_link, frame};
    use crate::positioning::factors::{Sight, position};

    /// The first satellite of either epoch.
    fn link(
        factor: &PhaseDifferenceFactor,
        [before, after]: &[Sight; 2],
        state: &State,
        next: &State,
    ) -> Link<4, 4> {
        let (from, to) = (before.range(&position(state)), after.range(&position(next)));
        factor.linearize((&from, state), (&to, next))
    }

    /// Towards a satellite at rest in the zenith: 5 m nearer, clock 8 m later, phase 2.9 m longer.
    #[test]
    fn a_residual_worked_by_hand() {
        let frame = LocalFrame::at(Ecef::new(6_378_137.0, 0.0, 0.0));
        let overhead = Sight::new(&frame, Ecef::new(26_378_137.0, 0.0, 0.0));
        let factor =
            PhaseDifferenceFactor { before: 0, after: 0, change_m: 2.9, inverse_sigma: 20.0 };
        let next = State::from([0.0, 0.0, 5.0, 0.0, 0.0, 0.0, 8.0, 0.0]);
        let residual = link(&factor, &[overhead, overhead], &State::zeros(), &next).residual;
        assert!((residual - 0.1 * 20.0).abs() < 1e-6, "{residual}");
    }

    #[test]
    fn the_jacobian_is_the_derivative() {
        let frame = frame();
        let sights = [Sight::new(&frame, SATELLITE), Sight::new(&frame, LATER)];
        let factor =
            PhaseDifferenceFactor { before: 0, after: 0, change_m: 700.0, inverse_sigma: 1.0 };
        check_link(|a, b| link(&factor, &sights, a, b));
    }
}
