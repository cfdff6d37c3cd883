//! What a session sees of its base: the epochs around those it positions.

use std::sync::Arc;

use crate::gnss::{BaseSite, BaseStation, Epoch, GpsTime};
use crate::positioning::{BASE_LATER_S, BaseAiding};
use crate::store::{BaseName, BaseUse, StoredBaseEpoch};

/// A base at one moment, with its epochs of a span of time. It does not change under its reader.
#[derive(Clone, Debug)]
pub struct BaseView {
    pub(super) name: BaseName,
    /// From the epoch of that number on.
    pub(super) sites: Arc<Vec<(u64, BaseSite)>>,
    /// In order of number and time, without gaps.
    pub(super) epochs: Vec<StoredBaseEpoch>,
}

/// What an estimator is given of a base for one epoch of the rover.
#[derive(Clone, Debug, PartialEq)]
pub struct BaseGiven {
    /// Which epochs it is: with these numbers it is given again, bit by bit.
    pub used: BaseUse,
    station: Option<BaseStation>,
    epochs: Vec<Epoch>,
}

impl BaseView {
    /// A base of which nothing is held, nor its place known.
    pub fn empty(name: BaseName) -> Self {
        Self { name, sites: Arc::default(), epochs: Vec::new() }
    }

    /// The base.
    pub const fn name(&self) -> &BaseName {
        &self.name
    }

    /// What is new for a rover's epoch at `time`: epochs numbered above `after`, up to that time,
    /// and no older than `span_s`, for what came before no longer counts. The station is where the
    /// newest of them was observed, which is the one that the rover's is differenced against.
    pub fn new_at(&self, time: GpsTime, after: u64, span_s: f64) -> BaseGiven {
        let is_past = |epoch: &StoredBaseEpoch| epoch.time - time <= BASE_LATER_S;
        let end = self.epochs.partition_point(is_past);
        let is_old = |epoch: &StoredBaseEpoch| {
            epoch.number <= after || span_s + BASE_LATER_S < time - epoch.time
        };
        let start = self.epochs.partition_point(is_old).min(end);
        let epochs = &self.epochs[start..end];
        let (after, through) = match (epochs.first(), epochs.last()) {
            (Some(first), Some(last)) => (first.number - 1, last.number),
            _ => (after, after),
        };
        self.given(BaseUse { base: self.name.key, after, through }, epochs)
    }

    /// What was given before; `None` where some of it is held no more.
    pub fn again(&self, used: BaseUse) -> Option<BaseGiven> {
        let above = |number: u64| self.epochs.partition_point(|epoch| epoch.number <= number);
        let epochs = &self.epochs[above(used.after)..above(used.through)];
        let is_whole = epochs.len() as u64 == used.through - used.after;
        let is_placed = used.through == 0 || self.site_at(used.through).is_some();
        (is_whole && is_placed).then(|| self.given(used, epochs))
    }

    /// What of it is still held.
    pub fn rest(&self, used: BaseUse) -> BaseGiven {
        let above = |number: u64| self.epochs.partition_point(|epoch| epoch.number <= number);
        self.given(used, &self.epochs[above(used.after)..above(used.through)])
    }

    fn given(&self, used: BaseUse, epochs: &[StoredBaseEpoch]) -> BaseGiven {
        let read = |stored: &StoredBaseEpoch| {
            stored.epoch().expect("it was encoded here, or read when the desk was opened")
        };
        let site = self.site_at(used.through);
        let station = site.map(|site| site.station(self.name.id.to_string()));
        BaseGiven { used, station, epochs: epochs.iter().map(read).collect() }
    }

    /// Where the base stood when it observed an epoch; nowhere before the first.
    fn site_at(&self, number: u64) -> Option<&BaseSite> {
        let sites = self.sites.iter().rev();
        sites.filter(|_| 0 < number).find(|(since, _)| *since <= number).map(|(_, site)| site)
    }
}

impl BaseGiven {
    /// What an estimator takes; `None` before the base's first epoch.
    pub fn aiding(&self) -> Option<BaseAiding<'_>> {
        let station = self.station.as_ref()?;
        Some(BaseAiding { station, epochs: &self.epochs })
    }
}
