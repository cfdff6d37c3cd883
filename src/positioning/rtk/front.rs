//! What comes before the estimate: the base, whether it can be used, and the differences against
//! it.
//!
//! Shared by the graph and the filter, so that both see the same measurements and refuse the same
//! epochs.

use crate::config::PositioningOptions;
use crate::gnss::{BaseStation, SatelliteId};
use crate::gnss::{Ecef, Epoch, GpsTime, Navigation, Reason, Solution};
use crate::positioning::base::BaseAiding;
use crate::positioning::differencing::{BaseSide, SingleDifferences};
use crate::positioning::spp::SinglePoint;
use crate::snapshot::{Snapshot, SnapshotError, SnapshotReader, SnapshotWriter};

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

/// Receives rover and base; what it remembers is the base and the time.
#[derive(Debug)]
pub(super) struct Front {
    base: BaseMemory,
    /// Time of the newest epoch answered.
    last: Option<GpsTime>,
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
    /// One that has seen nothing.
    pub(super) fn new(options: &PositioningOptions) -> Self {
        Self {
            base: BaseMemory::new(),
            last: None,
            single_point: SinglePoint::new(options),
            differences: SingleDifferences::default(),
            slipped: Vec::new(),
            base_moved_m: None,
            base_changed_m: None,
        }
    }

    /// Whether an epoch at `time` comes with another base than those before: what is remembered of
    /// that one is then forgotten, and the caller forgets what it knows relative to it. An epoch
    /// that is not after the last one changes nothing.
    pub(super) fn changes_base(&mut self, time: GpsTime, base: Option<&BaseAiding<'_>>) -> bool {
        if self.last.is_some_and(|last| time <= last) {
            return false;
        }
        self.base_changed_m = base.and_then(|base| self.base.changed_m(base.station));
        if self.base_changed_m.is_some() {
            self.base = BaseMemory::new();
        }
        self.base_changed_m.is_some()
    }

    /// Why an answer without the base is no better.
    pub(super) fn reasons_alone(&self, why: Reason) -> impl Iterator<Item = Reason> + use<> {
        let changed = self.base_changed_m.map(|distance_m| Reason::BaseChanged { distance_m });
        changed.into_iter().chain([why])
    }

    /// Takes an epoch and what is new of the base, and ends the arcs that either receiver says it
    /// lost, those not seen for long, and all where the base has moved.
    ///
    /// An epoch that is not after the last one changes nothing: its own solution is returned.
    pub(super) fn receive(
        &mut self,
        epoch: &Epoch,
        navigation: &Navigation,
        base: Option<&BaseAiding<'_>>,
        arcs: &mut Arcs,
        options: &PositioningOptions,
    ) -> Option<Solution> {
        if self.last.is_some_and(|last| epoch.time <= last) {
            return Some(self.single_point.solve(epoch, navigation, options, None));
        }
        self.last = Some(epoch.time);
        if let Some(base) = base {
            self.base.take(base.epochs, epoch.time);
            self.base.know(base.station);
        }
        self.slipped.clear();
        self.base_moved_m = base.and_then(|base| self.base.moved_m(base.station));
        let lost = epoch.observations.iter().filter(|observation| observation.loss_of_lock);
        let lost: Vec<_> = lost.map(|lost| (lost.satellite, lost.code)).collect();
        let base = &self.base;
        let failed = epoch.power_failure
            || base.power_failed
            || self.base_moved_m.is_some()
            || options.rtk.single_epoch;
        arcs.end(
            |arc| {
                failed
                    || options.rtk.arc_gap_s < epoch.time - arc.last
                    || lost.contains(&(arc.satellite, arc.codes[0]))
                    || base.lost.contains(&(arc.satellite, arc.codes[1]))
            },
            &mut self.slipped,
        );
        self.base.settle();
        None
    }

    /// The base, or why it cannot be used.
    pub(super) fn usable_base<'a>(
        &mut self,
        time: GpsTime,
        navigation: &Navigation,
        base: Option<&BaseAiding<'a>>,
        options: &PositioningOptions,
    ) -> Result<UsableBase<'a>, Reason> {
        let station = base.map(|base| base.station).ok_or(Reason::BaseMissing)?;
        let newest = self.base.newest().ok_or(Reason::BaseMissing)?;
        let age_s = time - newest.time;
        if options.rtk.base_age_max_s + TAG_SLACK_S < age_s {
            return Err(Reason::BaseStale { age_s });
        }
        let single_point = &mut self.single_point;
        let error_m = self.base.position_error_m(station, single_point, navigation, options);
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
        &mut self,
        epoch: &Epoch,
        place: Ecef,
        station: &BaseStation,
        navigation: &Navigation,
        arcs: &mut Arcs,
        options: &PositioningOptions,
    ) -> Result<(), Reason> {
        let length_m = place.distance_m(station.antenna_reference_point);
        if options.rtk.baseline_max_m < length_m {
            return Err(Reason::BaselineTooLong { length_m });
        }
        let newest = self.base.newest().ok_or(Reason::BaseMissing)?;
        let side = BaseSide { station, epoch: newest };
        let gathered = self.differences.gather(epoch, place, &side, navigation, options);
        gathered.ok_or(Reason::NotConverged)?;
        let (used, needed) = self.differences.used_and_needed();
        if used < needed {
            return Err(Reason::TooFewCommonSatellites { used, needed });
        }
        self.end_flipped_arcs(arcs);
        Ok(())
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

    /// Writes what the next answers depend on.
    pub(super) fn save(&self, writer: &mut SnapshotWriter) {
        self.base.save(writer);
        self.last.save(writer);
    }

    /// The one that was written.
    pub(super) fn load(
        options: &PositioningOptions,
        reader: &mut SnapshotReader<'_>,
    ) -> Result<Self, SnapshotError> {
        let (base, last) = (Snapshot::load(reader)?, Snapshot::load(reader)?);
        Ok(Self { base, last, ..Self::new(options) })
    }

    /// Swaps the memory both work in.
    pub(super) fn exchange_memory(&mut self, other: &mut Self) {
        #[rustfmt::skip]
        let Self {
            base: _, last: _, single_point, differences, slipped, base_moved_m: _,
            base_changed_m: _,
        } = self;
        single_point.exchange_memory(&mut other.single_point);
        std::mem::swap(differences, &mut other.differences);
        std::mem::swap(slipped, &mut other.slipped);
    }
}

/// Copies what the next answers depend on; scratch memory stays where it is.
impl Clone for Front {
    fn clone(&self) -> Self {
        Self {
            base: self.base.clone(),
            last: self.last,
            single_point: self.single_point.with_fresh_memory(),
            differences: SingleDifferences::default(),
            slipped: Vec::new(),
            base_moved_m: None,
            base_changed_m: None,
        }
    }

    fn clone_from(&mut self, source: &Self) {
        self.base.clone_from(&source.base);
        self.last = source.last;
        self.single_point.answer_like(&source.single_point);
    }
}
