//! Tests whether another position than the window's is clearly likelier.
//!
//! After a wrong start, or multipath on many satellites, carrier phase and Doppler carry the error
//! along, and it is marginalised into the prior; the right pseudoranges are then outliers. So the
//! residuals of the last half minute are tested repeatedly against other positions
//! ([`hypotheses`]): the residuals of the present window, and of the two windows before it.
//!
//! The window moves to another position if that position's log odds exceed a threshold. After a
//! start or an outage the threshold rises within half a minute from 1 nat to 10 nats, 1 : 22,000,
//! because a search every two seconds makes about 1,800 decisions an hour.

use crate::gnss::{Constellation, GpsTime};
use crate::snapshot::state_fields;

use super::hypotheses::{self, Knowledge, Offset, Pooled, Rivalry};

/// Interval between two searches (s).
const SEARCH_S: f64 = 2.0;
/// Length of a pool, over which multipath is one error (s).
pub(crate) const POOL_S: f64 = 10.0;
/// Pause after which the position counts as a start (s).
const OUTAGE_S: f64 = 10.0;
/// Time after which a position counts as settled (s).
const SETTLING_S: f64 = 30.0;
/// Bars at the start and of a settled position (nats).
const BARS: (f64, f64) = (1.0, 10.0);
/// What inter-system biases of a settled window may be off by (m).
const BIAS_SIGMA_M: f64 = 6.0;
/// Odds of 99 : 1 against the likeliest rival prove a position.
const PROVEN: f64 = 4.6;

/// What a search found.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Verdict {
    /// No rival comes near.
    Proven,
    /// A rival is possible, or nothing can be said.
    Open,
    /// This one is clearly likelier.
    Move(Offset),
}

/// Residuals of earlier windows, and when they were taken.
#[derive(Debug, Default)]
pub(crate) struct Watch {
    /// Of the two windows before this one, the newer first.
    earlier: [Vec<Pooled>; 2],
    /// When the newer of them was taken.
    pooled: Option<GpsTime>,
    /// When the last search was.
    searched: Option<GpsTime>,
    /// Since when the position has settled.
    settling: Option<GpsTime>,
}

state_fields!(Watch { earlier, pooled, searched, settling });

impl Watch {
    /// Takes note of an epoch at `now`, `interval_s` after the one before; whether a search is due.
    pub(crate) fn is_due(&mut self, now: GpsTime, interval_s: Option<f64>) -> bool {
        if interval_s.is_none_or(|interval_s| OUTAGE_S < interval_s) {
            self.earlier.iter_mut().for_each(Vec::clear);
            (self.settling, self.pooled, self.searched) = (Some(now), Some(now), None);
        }
        self.searched.is_none_or(|searched| SEARCH_S <= now - searched + 1e-3)
    }

    /// What inter-system biases may be off by at `now` (m).
    pub(crate) fn bias_sigma_m(&self, now: GpsTime) -> f64 {
        if self.settled(now) < 1.0 { f64::INFINITY } else { BIAS_SIGMA_M }
    }

    /// How far a position has settled, 0 … 1.
    fn settled(&self, now: GpsTime) -> f64 {
        let age_s = self.settling.map_or(0.0, |settling| now - settling);
        (age_s / SETTLING_S).min(1.0)
    }

    /// How far the window's residuals are not yet among the earlier ones (s).
    pub(crate) fn unpooled_s(&self, now: GpsTime) -> f64 {
        self.pooled.map_or(0.0, |pooled| now - pooled).min(POOL_S)
    }

    /// Judges the position from the window's residuals, pooled over [`Self::unpooled_s`]. One that
    /// is proven stays so until it moves.
    pub(crate) fn judge(&mut self, now: GpsTime, window: &[Pooled], is_proven: bool) -> Verdict {
        self.searched = Some(now);
        let mut pool = window.to_vec();
        if POOL_S <= self.unpooled_s(now) {
            self.earlier.swap(0, 1);
            self.earlier[0].clear();
            self.earlier[0].extend_from_slice(window);
            self.pooled = Some(now);
        } else {
            pool.extend_from_slice(&self.earlier[0]);
        }
        pool.extend_from_slice(&self.earlier[1]);
        let age_s = self.settling.map_or(0.0, |settling| now - settling);
        let settled = self.settled(now);
        let knowledge = Knowledge { bias_sigma_m: self.bias_sigma_m(now), settled };
        let seed = now.as_ns() as u64;
        let bar = BARS.0 + (BARS.1 - BARS.0) * settled;
        let least = if is_proven { bar } else { -PROVEN };
        match hypotheses::rivalry(&pool, knowledge, least, seed) {
            Rivalry::Rival { offset, log_odds } if bar < log_odds => Verdict::Move(offset),
            Rivalry::Rival { log_odds, .. } if -PROVEN <= log_odds => Verdict::Open,
            Rivalry::Rival { .. } | Rivalry::Unrivalled if POOL_S <= age_s => Verdict::Proven,
            _ => Verdict::Open,
        }
    }

    /// Moves the residuals along with a position that was moved.
    pub(crate) fn follow(&mut self, offset: &Offset) {
        for pooled in self.earlier.iter_mut().flatten() {
            let constellation: Constellation = pooled.satellite.constellation;
            let along_m = pooled.slope.dot(&offset.position_m());
            pooled.residual_m -= along_m + offset.clock_m(constellation);
        }
    }
}
