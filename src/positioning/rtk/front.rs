//! What comes before the estimate: the base, whether it can be used, and the differences against
//! it.
//!
//! Shared by the graph and the filter, so that both see the same measurements and refuse the same
//! epochs.

use crate::gnss::{BaseStation, Ecef, GpsTime, Reason, SatelliteId, Solution};
use crate::positioning::differencing::{BaseSide, SingleDifferences};
use crate::positioning::engine::EpochInputs;
use crate::positioning::spp::SinglePoint;
use crate::snapshot::state_fields;

use super::arcs::{Arc, Arcs};
use super::base::BaseMemory;

/// Differences of tags within this of a limit are within the limit (s).
const TAG_SLACK_S: f64 = 1e-3;
/// A base whose stated position is off by more is doubted (m).
const DOUBTED_M: f64 = 10.0;
/// A base whose stated position is off by more is refused (m).
const REFUSED_M: f64 = 100.0;

/// A base that can be used.
#[derive(Clone, Debug)]
pub(super) struct UsableBase<'a> {
    pub(super) station: &'a BaseStation,
    /// Of its newest epoch (s).
    pub(super) age_s: f64,
    /// Why its position is doubted, if it is.
    pub(super) doubt: Option<Reason>,
}

/// What is remembered of base and time between epochs.
#[derive(Debug, Default)]
pub(super) struct Front {
    base: BaseMemory,
    /// Time of the newest epoch answered.
    last: Option<GpsTime>,
}

state_fields!(Front { base, last });

/// What the epoch at hand came with, and memory to take it in.
#[derive(Debug, Default)]
pub(super) struct FrontScratch {
    pub(super) single_point: SinglePoint,
    pub(super) differences: SingleDifferences,
    /// Satellites whose arcs ended at this epoch.
    pub(super) slipped: Vec<SatelliteId>,
    /// How far the base moved before this epoch (m).
    base_moved_m: Option<f64>,
    /// How far this epoch's base is from the one before, where it is another (m).
    base_changed_m: Option<f64>,
}

impl Front {
    /// Whether an epoch at `time` comes with another base than those before: what is remembered of
    /// that one is then forgotten, and the caller forgets what it knows relative to it. An epoch
    /// that is not after the last one changes nothing.
    pub(super) fn changes_base(
        &mut self,
        inputs: &EpochInputs<'_>,
        scratch: &mut FrontScratch,
    ) -> bool {
        if self.last.is_some_and(|last| inputs.epoch.time <= last) {
            return false;
        }
        let base = inputs.base.as_ref();
        scratch.base_changed_m = base.and_then(|base| self.base.changed_m(base.station));
        if scratch.base_changed_m.is_some() {
            self.base = BaseMemory::default();
        }
        scratch.base_changed_m.is_some()
    }

    /// Takes an epoch and what is new of the base, and ends the arcs that either receiver says it
    /// lost, those not seen for long, and all where the base has moved.
    ///
    /// An epoch that is not after the last one changes nothing: its own solution is returned.
    pub(super) fn receive(
        &mut self,
        inputs: &EpochInputs<'_>,
        arcs: &mut Arcs,
        scratch: &mut FrontScratch,
    ) -> Option<Solution> {
        let (epoch, base, options) = (inputs.epoch, inputs.base.as_ref(), inputs.options());
        if self.last.is_some_and(|last| epoch.time <= last) {
            return Some(scratch.single_point.solve(inputs, None));
        }
        self.last = Some(epoch.time);
        if let Some(base) = base {
            self.base.take(base.epochs, epoch.time);
            self.base.know(base.station);
        }
        scratch.slipped.clear();
        scratch.base_moved_m = base.and_then(|base| self.base.moved_m(base.station));
        let lost = epoch.observations.iter().filter(|observation| observation.loss_of_lock);
        let lost: Vec<_> = lost.map(|lost| (lost.satellite, lost.code)).collect();
        let base = &self.base;
        let failed = epoch.power_failure
            || base.power_failed
            || scratch.base_moved_m.is_some()
            || options.rtk.single_epoch;
        arcs.end(
            |arc| {
                failed
                    || options.rtk.arc_gap_s < epoch.time - arc.last
                    || lost.contains(&(arc.satellite, arc.codes[0]))
                    || base.lost.contains(&(arc.satellite, arc.codes[1]))
            },
            &mut scratch.slipped,
        );
        self.base.settle();
        None
    }

    /// The base, or why it cannot be used.
    pub(super) fn usable_base<'a>(
        &mut self,
        inputs: &EpochInputs<'a>,
        scratch: &mut FrontScratch,
    ) -> Result<UsableBase<'a>, Reason> {
        let station = inputs.base.map(|base| base.station).ok_or(Reason::BaseMissing)?;
        let newest = self.base.newest().ok_or(Reason::BaseMissing)?;
        let age_s = inputs.epoch.time - newest.time;
        if inputs.options().rtk.base_age_max_s + TAG_SLACK_S < age_s {
            return Err(Reason::BaseStale { age_s });
        }
        let error_m = self.base.position_error_m(station, &mut scratch.single_point, inputs);
        let doubt = error_m
            .filter(|error_m| DOUBTED_M < *error_m)
            .map(|distance_m| Reason::BasePositionDoubtful { distance_m });
        if let (Some(doubt), true) = (&doubt, error_m.is_some_and(|m| REFUSED_M < m)) {
            return Err(doubt.clone());
        }
        Ok(UsableBase { station, age_s, doubt })
    }

    /// Differences an epoch of a rover about at `place`, and ends the arcs whose half-cycle flag
    /// changed.
    pub(super) fn difference(
        &self,
        inputs: &EpochInputs<'_>,
        place: Ecef,
        station: &BaseStation,
        arcs: &mut Arcs,
        scratch: &mut FrontScratch,
    ) -> Result<(), Reason> {
        let EpochInputs { epoch, navigation, .. } = *inputs;
        let (options, differences) = (inputs.options(), &mut scratch.differences);
        let length_m = place.distance_m(station.antenna_reference_point);
        if options.rtk.baseline_max_m < length_m {
            return Err(Reason::BaselineTooLong { length_m });
        }
        let newest = self.base.newest().ok_or(Reason::BaseMissing)?;
        let side = BaseSide { station, epoch: newest };
        let gathered = differences.gather(epoch, place, &side, navigation, options);
        gathered.ok_or(Reason::NotConverged)?;
        let (used, needed) = differences.used_and_needed();
        if used < needed {
            return Err(Reason::TooFewCommonSatellites { used, needed });
        }
        scratch.end_flipped_arcs(arcs);
        Ok(())
    }
}

impl FrontScratch {
    /// Why an answer without the base is no better.
    pub(super) fn reasons_alone(&self, why: Reason) -> impl Iterator<Item = Reason> + use<> {
        let changed = self.base_changed_m.map(|distance_m| Reason::BaseChanged { distance_m });
        changed.into_iter().chain([why])
    }

    /// Ends arcs whose half-cycle flag changed: the phase may have moved by half a cycle.
    fn end_flipped_arcs(&mut self, arcs: &mut Arcs) {
        let list = &self.differences.list;
        let flipped = |satellite, codes, half_cycle| {
            list.iter().any(|d| {
                d.satellite == satellite
                    && d.codes == codes
                    && d.carrier.is_some()
                    && d.half_cycle != half_cycle
            })
        };
        let is_over = |arc: &Arc| flipped(arc.satellite, arc.codes, arc.half_cycle);
        arcs.end(is_over, &mut self.slipped);
    }

    /// What the epoch at `time` lacked.
    pub(super) fn reasons(&mut self, time: GpsTime, arcs: &Arcs) -> Vec<Reason> {
        let mut reasons = Vec::new();
        if !self.differences.without_ephemeris.is_empty() {
            let satellites = self.differences.without_ephemeris.clone();
            reasons.push(Reason::EphemerisMissing { satellites });
        }
        reasons.extend(self.base_changed_m.map(|distance_m| Reason::BaseChanged { distance_m }));
        reasons.extend(self.base_moved_m.map(|distance_m| Reason::BaseMoved { distance_m }));
        if !self.slipped.is_empty() {
            self.slipped.sort_unstable();
            self.slipped.dedup();
            reasons.push(Reason::CycleSlips { satellites: self.slipped.clone() });
        }
        let halves = arcs.list.iter().filter(|arc| arc.half_cycle && arc.last == time);
        let mut halves: Vec<_> = halves.map(|arc| arc.satellite).collect();
        if !halves.is_empty() {
            halves.sort_unstable();
            halves.dedup();
            reasons.push(Reason::HalfCycleUnresolved { satellites: halves });
        }
        reasons
    }
}
