//! Tests whether another position explains the differenced pseudoranges better.
//!
//! Phases propagate the error of a wrong start from epoch to epoch, and the prior of the
//! marginalised epochs outweighs the pseudoranges that contradict this start. So the residuals of
//! the last half minute are tested for other positions, as without a base ([`Watch`]). If another
//! position is clearly likelier, the solver starts again from there.

use nalgebra::Vector3;

use crate::gnss::GpsTime;
use crate::graph::shared_offset;
use crate::positioning::differencing::SingleDifferences;
use crate::positioning::pseudorange_error::{PseudorangeError, extra_path_m};
use crate::positioning::receiver::reflected_before_learning;
use crate::positioning::rivals::{POOL_S, Pooled, SPACING_S, Scope, Verdict, Watch};
use crate::positioning::setup::OFFSET_KERNEL;
use crate::snapshot::{snapshot_fields, state_fields};

use super::epoch::{RowScratch, RtkEpoch, State};

/// The residual of a satellite at an epoch.
#[derive(Clone, Debug)]
struct Seen {
    time: GpsTime,
    pooled: Pooled,
}

snapshot_fields!(Seen { time, pooled });

/// Repeated tests of a float position by its pseudoranges.
#[derive(Debug, Default)]
pub(crate) struct PseudorangeWatch {
    watch: Watch,
    /// The residuals of the last ten seconds, in order of time.
    seen: Vec<Seen>,
    last: Option<GpsTime>,
    is_proven: bool,
}

state_fields!(PseudorangeWatch { watch, seen, last, is_proven });

/// A float solution to judge.
pub(crate) struct Judged<'a> {
    pub(crate) epoch: &'a RtkEpoch,
    pub(crate) state: &'a State,
    pub(crate) differences: &'a SingleDifferences,
}

impl PseudorangeWatch {
    /// Adds a float solution; returns the move (m, local) to another position, if that is clearly
    /// likelier.
    pub(crate) fn reconsider(
        &mut self,
        judged: &Judged<'_>,
        scratch: &mut RowScratch,
    ) -> Option<Vector3<f64>> {
        let now = judged.epoch.time;
        let interval_s = self.last.map(|last| now - last);
        self.last = Some(now);
        if interval_s.is_none_or(|interval_s| POOL_S < interval_s) {
            self.seen.clear();
            self.is_proven = false;
        }
        if self.seen.last().is_none_or(|seen| SPACING_S <= now - seen.time) {
            self.take(judged, scratch);
        }
        self.watch.record_epoch(now, interval_s);
        if !self.watch.is_due(now) {
            return None;
        }
        let pool = self.pooled(now);
        let unproven_s = (!self.is_proven).then(|| self.watch.age_s(now));
        // A restart costs all ambiguities. The float follows pseudoranges to a near position
        // without one, and its offsets between receivers are those of each epoch.
        match self.watch.judge(now, &pool, unproven_s, Scope::Apart) {
            Verdict::Proven => self.is_proven = true,
            Verdict::Open => {}
            Verdict::Move(offset) => {
                *self = Self { last: Some(now), ..Self::default() };
                return Some(offset.position_m());
            }
        }
        None
    }

    /// Adds the residuals of an epoch: for each satellite, that of its most precise pseudorange.
    fn take(&mut self, judged: &Judged<'_>, scratch: &mut RowScratch) {
        let Judged { epoch, state, differences, .. } = *judged;
        self.seen.retain(|seen| epoch.time - seen.time <= POOL_S);
        let begin = self.seen.len();
        epoch.see(state, scratch);
        for group in epoch.groups.iter().filter(|group| !group.is_carrier) {
            epoch.linearize_group(group, &[], scratch);
            let RowScratch { rows, numbers, .. } = &mut *scratch;
            let offset_m = shared_offset(rows, &OFFSET_KERNEL, numbers);
            for (row, factor) in rows.iter().zip(&epoch.rows[group.begin..group.end]) {
                let satellite = &differences.satellites[factor.sight];
                let excess_m = -(row.row.residual / row.by_offset + offset_m);
                let slope = Vector3::from(row.row.jacobian) / row.by_offset;
                let error = PseudorangeError {
                    sigma_m: row.by_offset.recip(),
                    reflected: reflected_before_learning(satellite.cn0_db_hz),
                    extra_path_m: extra_path_m(-slope.z),
                };
                let pooled = Pooled {
                    satellite: satellite.satellite,
                    slope,
                    excess_m,
                    error,
                    before_learning: error,
                    independent: row.independent_share,
                };
                let of_satellite = |seen: &&mut Seen| seen.pooled.satellite == pooled.satellite;
                match self.seen[begin..].iter_mut().find(of_satellite) {
                    Some(known) if known.pooled.error.sigma_m <= pooled.error.sigma_m => {}
                    Some(known) => known.pooled = pooled,
                    None => self.seen.push(Seen { time: epoch.time, pooled }),
                }
            }
        }
    }

    /// The median residual of each satellite since the residuals were pooled last.
    fn pooled(&self, now: GpsTime) -> Vec<Pooled> {
        let span_s = self.watch.unpooled_s(now);
        let recent = self.seen.iter().filter(|seen| now - seen.time <= span_s);
        let mut all: Vec<Pooled> = recent.map(|seen| seen.pooled).collect();
        all.sort_by(|a, b| a.satellite.cmp(&b.satellite).then(a.excess_m.total_cmp(&b.excess_m)));
        let middle = |group: &[Pooled]| {
            let independent: f64 = group.iter().map(|pooled| pooled.independent).sum();
            Pooled { independent: independent.min(1.0), ..group[group.len() / 2] }
        };
        all.chunk_by(|a, b| a.satellite == b.satellite).map(middle).collect()
    }
}
