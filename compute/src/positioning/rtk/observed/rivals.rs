//! Tests whether another position explains the differenced pseudoranges better.
//!
//! Phases propagate the error of a wrong start from epoch to epoch, and the prior of the
//! marginalised epochs outweighs the pseudoranges that contradict this start. So the residuals of
//! the last half minute are tested for other positions, as without a base ([`Watch`]). If another
//! position is clearly likelier, the solver starts again from there.

use std::cmp::Reverse;

use nalgebra::Vector3;

use crate::gnss::{GpsTime, SatelliteId};
use crate::graph::shared_offset;
use crate::positioning::differencing::SingleDifferences;
use crate::positioning::pseudorange_error::{PseudorangeError, extra_path_m};
use crate::positioning::receiver::reflected_before_learning;
use crate::positioning::rivals::{Movable, POOL_S, Pooled, SPACING_S, Verdict, Watch};
use crate::positioning::setup::OFFSET_KERNEL;
use crate::snapshot::{snapshot_fields, state_fields};

use super::epoch::{Group, RowScratch, RtkEpoch, State};

/// The residual of a satellite at an epoch.
#[derive(Clone, Debug)]
struct Seen {
    time: GpsTime,
    pooled: Pooled,
}

snapshot_fields!(Seen { time, pooled });

/// The independent fraction of a satellite's pseudoranges since its last residual that was kept.
#[derive(Clone, Debug)]
struct Since {
    satellite: SatelliteId,
    independent: f64,
}

snapshot_fields!(Since { satellite, independent });

/// Repeated tests of a float position by its pseudoranges.
#[derive(Debug, Default)]
pub(crate) struct PseudorangeWatch {
    watch: Watch,
    /// The residuals of the last ten seconds, at least [`SPACING_S`] apart, in order of time.
    seen: Vec<Seen>,
    /// One for each satellite of the epochs since the last of these.
    since: Vec<Since>,
    last: Option<GpsTime>,
    is_proven: bool,
}

state_fields!(PseudorangeWatch { watch, seen, since, last, is_proven });

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
            self.since.clear();
            self.is_proven = false;
        }
        self.count(judged);
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
        match self.watch.judge(now, &pool, unproven_s, Movable::FarOnly) {
            Verdict::Proven => self.is_proven = true,
            Verdict::Open => {}
            Verdict::Move(offset) => {
                *self = Self::default();
                return Some(offset.position_m());
            }
        }
        None
    }

    /// Adds the independent fractions of an epoch: for each satellite, the largest of its signals.
    fn count(&mut self, judged: &Judged<'_>) {
        let begin = self.since.len();
        for factor in pseudoranges(judged.epoch).flat_map(|group| group.factors(judged.epoch)) {
            let satellite = judged.differences.satellites[factor.sight].satellite;
            let independent = factor.independent_share;
            let own = self.since[begin..].iter_mut().find(|since| since.satellite == satellite);
            match own {
                Some(own) => own.independent = own.independent.max(independent),
                None => self.since.push(Since { satellite, independent }),
            }
        }
    }

    /// Adds the residuals of an epoch. Of each constellation these are the pseudoranges of one
    /// signal, that of most satellites, because the signals have offsets of their own.
    fn take(&mut self, judged: &Judged<'_>, scratch: &mut RowScratch) {
        let Judged { epoch, state, differences } = *judged;
        self.seen.retain(|seen| epoch.time - seen.time <= POOL_S);
        epoch.see(state, scratch);
        let constellation = |group: &Group| {
            let sight = epoch.rows[group.begin].sight;
            differences.satellites[sight].satellite.constellation
        };
        let mut groups: Vec<_> = pseudoranges(epoch).collect();
        groups.sort_by_key(|group| (constellation(group), Reverse(group.factors(epoch).len())));
        groups.dedup_by_key(|group| constellation(group));
        // The offset of a single pseudorange leaves no residual.
        for group in groups.into_iter().filter(|group| 1 < group.factors(epoch).len()) {
            epoch.linearize_group(group, &[], scratch);
            let RowScratch { rows, numbers, .. } = &mut *scratch;
            let offset_m = shared_offset(rows, &OFFSET_KERNEL, numbers);
            for (row, factor) in rows.iter().zip(group.factors(epoch)) {
                let satellite = &differences.satellites[factor.sight];
                let slope = Vector3::from(row.row.jacobian) / row.by_offset;
                let error = PseudorangeError {
                    sigma_m: row.by_offset.recip(),
                    reflected: reflected_before_learning(satellite.cn0_db_hz),
                    extra_path_m: extra_path_m(-slope.z),
                };
                let own = self.since.iter().filter(|since| since.satellite == satellite.satellite);
                let independent: f64 = own.map(|since| since.independent).sum();
                let pooled = Pooled {
                    satellite: satellite.satellite,
                    slope,
                    excess_m: -(row.row.residual / row.by_offset + offset_m),
                    error,
                    before_learning: error,
                    independent: independent.min(1.0),
                };
                self.seen.push(Seen { time: epoch.time, pooled });
            }
        }
        self.since.clear();
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

fn pseudoranges(epoch: &RtkEpoch) -> impl Iterator<Item = &Group> {
    epoch.groups.iter().filter(|group| !group.is_carrier)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gnss::{Constellation, Ecef, EphemerisIssue, LocalFrame};
    use crate::models::{LookAngles, SatelliteState};
    use crate::positioning::differencing::CommonSatellite;
    use crate::positioning::factors::Sight;
    use crate::positioning::rtk::observed::DifferenceFactor;

    const SATELLITES: usize = 10;

    /// An epoch of pseudoranges without errors, `since_s` after the one before. The rover is at the
    /// origin.
    fn epoch(second: f64, since_s: f64) -> (RtkEpoch, SingleDifferences) {
        let frame = LocalFrame::at(Ecef(Vector3::new(4.0e6, 1.0e6, 4.85e6)));
        let mut epoch = RtkEpoch { time: GpsTime::EPOCH + second, ..RtkEpoch::default() };
        let mut differences = SingleDifferences::default();
        for k in 0..SATELLITES {
            let (azimuth_rad, elevation_rad) = (2.4 * k as f64, 0.3 + 0.12 * k as f64);
            let (up, level) = elevation_rad.sin_cos();
            let line = Vector3::new(level * azimuth_rad.sin(), level * azimuth_rad.cos(), up);
            let position = Ecef(frame.origin.0 + frame.rotation.transpose() * line * 2.2e7);
            let sight = Sight::new(&frame, position);
            epoch.sights.push(sight);
            epoch.rows.push(DifferenceFactor {
                sight: k,
                range_m: sight.range(&Vector3::zeros()).0 + 7.0,
                inverse_sigma: 1.0,
                independent_share: since_s / 30.0,
                ambiguity: None,
                bias: None,
            });
            let satellite = SatelliteId::new(Constellation::Gps, 1 + k as u8).unwrap();
            differences.satellites.push(CommonSatellite {
                satellite,
                state: SatelliteState {
                    position,
                    velocity_m_s: Vector3::zeros(),
                    clock_m: 0.0,
                    clock_drift_m_s: 0.0,
                    variance_m2: 0.0,
                },
                range_rate: None,
                look: LookAngles { azimuth_rad, elevation_rad },
                cn0_db_hz: Some(45.0),
                ephemeris: EphemerisIssue { satellite, toe: GpsTime::EPOCH, issue: 0 },
                rover_range_m: 0.0,
                base_offset_m: 0.0,
            });
        }
        epoch.groups.push(Group { begin: 0, end: SATELLITES, is_carrier: false });
        (epoch, differences)
    }

    /// Adds an epoch at a wrong position.
    fn reconsider(
        watch: &mut PseudorangeWatch,
        (second, since_s): (f64, f64),
        off_m: Vector3<f64>,
    ) -> Option<Vector3<f64>> {
        let (epoch, differences) = epoch(second, since_s);
        let mut state = State::zeros();
        state.fixed_rows_mut::<3>(0).copy_from(&off_m);
        let judged = Judged { epoch: &epoch, state: &state, differences: &differences };
        watch.reconsider(&judged, &mut RowScratch::default())
    }

    /// A float solution 60 m off is moved, and again if it is then 40 m off elsewhere.
    #[test]
    fn each_wrong_position_is_left() {
        let mut watch = PseudorangeWatch::default();
        let mut second = 0.0;
        for off_m in [Vector3::new(60.0, 0.0, 10.0), Vector3::new(0.0, -40.0, -10.0)] {
            let begin = second;
            let move_m = loop {
                assert!(second - begin < 30.0, "not left: {off_m:?}");
                second += 1.0;
                if let Some(move_m) = reconsider(&mut watch, (second, 1.0), off_m) {
                    break move_m;
                }
            };
            assert!((move_m + off_m).norm() < 1.0, "{move_m:?}");
        }
    }

    /// Ten epochs a second count as much as one.
    #[test]
    fn evidence_does_not_depend_on_the_rate() {
        let independent = |since_s: f64| {
            let mut watch = PseudorangeWatch::default();
            let epochs = (9.0 / since_s).round() as u32;
            for k in 0..=epochs {
                let at = (f64::from(k) * since_s, since_s);
                reconsider(&mut watch, at, Vector3::zeros());
            }
            watch.pooled(GpsTime::EPOCH + 9.0)[0].independent
        };
        let (slow, fast) = (independent(1.0), independent(0.1));
        assert!((slow - 10.0 / 30.0).abs() < 1e-9, "{slow}");
        assert!((fast / slow - 1.0).abs() < 0.1, "{fast} {slow}");
    }
}
