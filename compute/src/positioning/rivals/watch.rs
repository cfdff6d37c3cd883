//! Tests whether another position than the window's is clearly likelier.
//!
//! After a wrong start, or multipath on many satellites, carrier phase and Doppler propagate the
//! error from epoch to epoch, and marginalisation puts it into the prior. The correct pseudoranges
//! are then outliers. So the residuals of the last half minute are tested repeatedly against other
//! positions ([`hypotheses`]): the residuals of the present window, and of two pools before it.
//!
//! The window moves to another hypothesis, of position or clocks, if its log odds exceed a
//! threshold. After a start or an outage this is 1 nat. Once the pools are full, each search
//! without a possible rival raises it, up to 10 nats after half a minute of such searches. These
//! are odds of 22,000 : 1, because a search every two seconds makes about 1,800 decisions an hour.

use crate::gnss::{Constellation, GpsTime};
use crate::snapshot::{snapshot_fields, state_fields};

use super::evidence::{Knowledge, Offset, Pooled};
use super::hypotheses::{self, Rivalry};

/// Interval between two searches (s).
const SEARCH_S: f64 = 2.0;
/// Length of a pool (s). Multipath is nearly constant over this time, so a satellite has one
/// residual in it.
pub(crate) const POOL_S: f64 = 10.0;
/// Shortest time between two epochs whose residuals are both pooled (s): errors of closer ones are
/// the same. So a pool has as many residuals at 1 Hz as at 50 Hz.
pub(crate) const SPACING_S: f64 = 0.9;
/// Time without an epoch after which the position counts as a new start (s).
const OUTAGE_S: f64 = 10.0;
/// Time after a start in which the position does not settle (s): some of the three pools are then
/// still empty.
const FILLING_S: f64 = 3.0 * POOL_S;
/// Time for which no other position may be possible, from then on, until the position counts as
/// settled (s).
const SETTLING_S: f64 = 30.0;
/// Number of independent errors of a satellite in one pool, if the errors of successive pools have
/// the correlation 1/e and there are three pools: 1/(1 + 2·(⅔·e⁻¹ + ⅓·e⁻²)) (Bartlett 1946).
/// Multipath that is nearly constant in a pool does not end with it.
const OF_ONE_POOL: f64 = 0.633;
/// Log odds above which the window moves at a start (nats).
const MOVE_LOG_ODDS_START: f64 = 1.0;
/// Log odds above which the window moves from a settled position (nats).
const MOVE_LOG_ODDS_SETTLED: f64 = 10.0;
/// Scale of the errors of the inter-system biases of a settled window (m).
const BIAS_SCALE_M: f64 = 6.0;
/// Log odds against the likeliest rival that prove a position: 99 : 1 (nats).
const PROVEN_LOG_ODDS: f64 = 4.6;

/// The verdict on the window's position.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Verdict {
    /// Every other position is far less likely.
    Proven,
    /// Another position is possible, or the residuals do not decide.
    Open,
    /// The hypothesis at this offset, of position or clocks, is clearly likelier.
    Move(Offset),
}

/// The rivals to which a position can be moved. Each of them keeps it from being proven.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Movable {
    /// All.
    Anywhere,
    /// Those at another position only.
    FarOnly,
}

/// The residuals of an epoch that has left the window.
#[derive(Clone, Debug)]
pub(crate) struct Departed {
    pub(crate) time: GpsTime,
    /// Independent fraction of the information of this epoch, and of those since the one before.
    pub(crate) share: f64,
    pub(crate) residuals: Vec<Pooled>,
}

snapshot_fields!(Departed { time, share, residuals });

/// Residuals of earlier windows, and the times of the last search and the last start.
#[derive(Debug, Default)]
pub(crate) struct Watch {
    /// Epochs that have left the window less than a pool ago, in order of time. There are none if
    /// the window has the length of a pool.
    departed: Vec<Departed>,
    /// Sum of the independent fractions of the epochs that left after the last one of these.
    departing_share: f64,
    /// The two pools before the present window, the newer one first.
    earlier: [Vec<Pooled>; 2],
    /// Time of the newer pool.
    pooled: Option<GpsTime>,
    /// Time of the last search.
    searched: Option<GpsTime>,
    /// Time of the last start.
    started: Option<GpsTime>,
    /// a: how settled the position is, 0 at a start … 1.
    settled: f64,
}

state_fields!(Watch { departed, departing_share, earlier, pooled, searched, started, settled });

impl Watch {
    /// Records an epoch at `now`, `interval_s` after the previous one. After an outage all earlier
    /// residuals are forgotten.
    pub(crate) fn record_epoch(&mut self, now: GpsTime, interval_s: Option<f64>) {
        if interval_s.is_none_or(|interval_s| OUTAGE_S < interval_s) {
            self.forget();
            (self.started, self.pooled, self.searched) = (Some(now), Some(now), None);
            self.settled = 0.0;
        }
    }

    /// Whether a search is due at `now`.
    pub(crate) fn is_due(&self, now: GpsTime) -> bool {
        self.searched.is_none_or(|searched| SEARCH_S <= now - searched + 1e-3)
    }

    /// Lets an epoch of `time` leave the window at `now`. `residuals` is called if they are kept
    /// for the pool.
    pub(crate) fn let_leave(
        &mut self,
        now: GpsTime,
        (time, share): (GpsTime, f64),
        residuals: impl FnOnce() -> Vec<Pooled>,
    ) {
        self.departed.retain(|departed| now - departed.time < POOL_S);
        if POOL_S <= now - time {
            self.departing_share = 0.0;
            return;
        }
        self.departing_share += share;
        if self.departed.last().is_none_or(|departed| SPACING_S <= time - departed.time) {
            let share = std::mem::take(&mut self.departing_share);
            self.departed.push(Departed { time, share, residuals: residuals() });
        }
    }

    /// Epochs that have left the window less than a pool ago, in order of time.
    pub(crate) fn departed(&self) -> &[Departed] {
        &self.departed
    }

    /// Starts at a position that is known: as settled as one accepted for a minute.
    pub(crate) fn settle(&mut self, now: GpsTime) {
        self.forget();
        self.started = Some(now - (FILLING_S + SETTLING_S));
        (self.pooled, self.searched) = (Some(now), Some(now));
        self.settled = 1.0;
    }

    /// Forgets all residuals.
    fn forget(&mut self) {
        self.departed.clear();
        self.departing_share = 0.0;
        self.earlier.iter_mut().for_each(Vec::clear);
    }

    /// Scale of the errors of inter-system biases at `now` (m); infinite in the first minute.
    pub(crate) fn bias_scale_m(&self, now: GpsTime) -> f64 {
        if self.age_s(now) < FILLING_S + SETTLING_S { f64::INFINITY } else { BIAS_SCALE_M }
    }

    /// Time since the last start or outage (s).
    pub(crate) fn age_s(&self, now: GpsTime) -> f64 {
        self.started.map_or(0.0, |started| now - started)
    }

    /// Length of the window's residuals that are in no pool yet (s).
    pub(crate) fn unpooled_s(&self, now: GpsTime) -> f64 {
        self.pooled.map_or(0.0, |pooled| now - pooled).min(POOL_S)
    }

    /// Judges the position by the earlier pools and by the window's residuals, pooled over
    /// [`Self::unpooled_s`]. `unproven_s` is the age of a start that is not proven yet. If there is
    /// none and the position is settled, the search is only for a position to move to.
    pub(crate) fn judge(
        &mut self,
        now: GpsTime,
        window: &[Pooled],
        unproven_s: Option<f64>,
        movable: Movable,
    ) -> Verdict {
        let since_s = self.searched.map_or(0.0, |searched| now - searched);
        self.searched = Some(now);
        let mut pool = self.pool_with(now, window);
        pool.iter_mut().for_each(|pooled| pooled.independent *= OF_ONE_POOL);
        let settled = self.settled;
        let knowledge = Knowledge { bias_scale_m: self.bias_scale_m(now), settled };
        let threshold =
            MOVE_LOG_ODDS_START + (MOVE_LOG_ODDS_SETTLED - MOVE_LOG_ODDS_START) * settled;
        let needs_rival = settled < 1.0 || unproven_s.is_some();
        let wanted = if needs_rival { -PROVEN_LOG_ODDS } else { threshold };
        let Rivalry::Rivals(rivals) =
            hypotheses::rivalry(&pool, knowledge, wanted, now.as_ns() as u64)
        else {
            return Verdict::Open;
        };
        let likeliest = rivals.likeliest();
        let candidate = match movable {
            Movable::Anywhere => likeliest,
            Movable::FarOnly => rivals.far,
        };
        if let Some(candidate) = candidate.filter(|candidate| threshold < candidate.log_odds) {
            return Verdict::Move(candidate.offset);
        }
        if likeliest.is_some_and(|rival| -PROVEN_LOG_ODDS <= rival.log_odds) {
            return Verdict::Open;
        }
        if FILLING_S <= self.age_s(now) {
            self.settled = (settled + since_s / SETTLING_S).min(1.0);
        }
        let is_early = unproven_s.is_some_and(|age_s| age_s < POOL_S);
        if is_early { Verdict::Open } else { Verdict::Proven }
    }

    /// The residuals of the window and of the two pools before it. A window of a pool's length
    /// becomes the newer of these pools.
    fn pool_with(&mut self, now: GpsTime, window: &[Pooled]) -> Vec<Pooled> {
        let [newer, older] = &self.earlier;
        let pool = [window, newer, older].concat();
        if POOL_S <= self.unpooled_s(now) {
            self.earlier.swap(0, 1);
            self.earlier[0].clear();
            self.earlier[0].extend_from_slice(window);
            self.pooled = Some(now);
        }
        pool
    }

    /// Corrects the pooled residuals for a move of the position.
    pub(crate) fn follow(&mut self, offset: &Offset) {
        let departed = self.departed.iter_mut().map(|departed| &mut departed.residuals);
        for pooled in self.earlier.iter_mut().chain(departed).flatten() {
            let constellation: Constellation = pooled.satellite.constellation;
            let along_m = pooled.slope.dot(&offset.position_m());
            pooled.excess_m -= along_m + offset.clock_m(constellation);
        }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;
    use crate::positioning::pseudorange_error::PseudorangeError;

    fn pooled(excess_m: f64) -> Pooled {
        let error = PseudorangeError { sigma_m: 2.0, reflected: 0.3, extra_path_m: 40.0 };
        Pooled {
            satellite: "G01".parse().unwrap(),
            slope: Vector3::z(),
            excess_m,
            error,
            before_learning: error,
            independent: 1.0,
        }
    }

    /// Six satellites are direct at the trajectory, and their mirror images at a position 60 m to
    /// the east. At the other position each is 36 m late. As long as both are as likely, the
    /// trajectory does not settle.
    #[test]
    fn a_position_settles_only_while_no_other_is_possible() {
        let error = PseudorangeError { sigma_m: 2.0, reflected: 0.3, extra_path_m: 40.0 };
        let off = Vector3::new(60.0, 0.0, 0.0);
        let pool = |is_ambiguous: bool| {
            let pooled = |index: u32| {
                let (pair, is_of_other) = (f64::from(index / 2), index.is_multiple_of(2));
                let east = if is_of_other { 0.6 } else { -0.6 };
                let slope = Vector3::new(east, 0.7 * (2.4 * pair).cos(), -0.4 - 0.1 * pair);
                let excess_m = if is_ambiguous && is_of_other { slope.dot(&off) } else { 0.0 };
                let satellite = format!("G{:02}", index + 1).parse().unwrap();
                Pooled { satellite, slope, excess_m, error, ..pooled(0.0) }
            };
            (0..12).map(pooled).collect::<Vec<_>>()
        };
        let settled_after = |is_ambiguous: bool| {
            let (mut watch, pool) = (Watch::default(), pool(is_ambiguous));
            for second in (0..90).step_by(2) {
                let now = GpsTime::EPOCH + f64::from(second);
                let interval_s = (second != 0).then_some(2.0);
                watch.record_epoch(now, interval_s);
                assert!(watch.is_due(now));
                watch.judge(now, &pool, None, Movable::Anywhere);
            }
            watch.settled
        };
        assert_eq!((settled_after(false), settled_after(true)), (1.0, 0.0));
    }

    /// Every two seconds a search, every ten a pool: each search has the window and the last two
    /// pools, also the one at which a pool is full.
    #[test]
    fn each_search_has_the_residuals_of_three_pools() {
        let mut watch = Watch::default();
        let now = |s: f64| GpsTime::EPOCH + s;
        watch.record_epoch(now(0.0), None);
        assert!(watch.is_due(now(0.0)));
        let mut seen = Vec::new();
        for search in 1..=16 {
            let time = now(2.0 * f64::from(search));
            let pool = watch.pool_with(time, &[pooled(f64::from(search))]);
            seen.push(pool.iter().map(|pooled| pooled.excess_m).collect::<Vec<_>>());
        }
        assert_eq!(seen[3..6], [vec![4.0], vec![5.0], vec![6.0, 5.0]]);
        assert_eq!(
            seen[13..],
            [vec![14.0, 10.0, 5.0], vec![15.0, 10.0, 5.0], vec![16.0, 15.0, 10.0]]
        );
    }

    /// A window of a second and a half at 20 Hz: of the epochs that left it, one in each second is
    /// kept, and these have the information of all.
    #[test]
    fn epochs_that_left_a_short_window_are_kept_a_second_apart() {
        let mut watch = Watch::default();
        let time = |k: i32| GpsTime::EPOCH + 0.05 * f64::from(k);
        for k in 0..400 {
            watch.let_leave(time(k + 30), (time(k), 0.005), || vec![pooled(f64::from(k))]);
        }
        let (kept, now) = (watch.departed(), time(429));
        assert!((8..=10).contains(&kept.len()), "{}", kept.len());
        assert!(kept.iter().all(|departed| now - departed.time < POOL_S + 1e-6));
        for pair in kept.windows(2) {
            let apart_s = pair[1].time - pair[0].time;
            assert!((SPACING_S..SPACING_S + 0.06).contains(&apart_s), "{apart_s}");
            assert!((pair[1].share - 0.1 * apart_s).abs() < 1e-9, "{}", pair[1].share);
        }
        // A window of a pool's length lets no residual go before its pool is full.
        watch.let_leave(time(800), (time(600), 0.005), || unreachable!());
        assert!(watch.departed().is_empty());
    }
}
