//! What is held of one base in memory: all that is stored of it.

use std::collections::VecDeque;
use std::sync::Arc;

use crate::gnss::{BaseSite, Epoch, GpsTime};
use crate::positioning::BASE_LATER_S;
use crate::store::StoredBaseEpoch;

use super::check::PositionCheck;
use super::{BaseEpochRefusal, HeldEpoch};

/// Receivers tag epochs so near to the second that they mean (s).
const TOLERANCE_S: f64 = 0.5;

/// How much of a span of time is held, whose end does not belong to it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reach {
    /// Epochs of it may still be taken.
    Open,
    /// It is held to its end.
    Whole,
    /// Nothing of it is held, nor can be: epochs behind it are.
    Passed,
}

/// What is held of one base.
#[derive(Clone, Debug)]
pub(super) struct Held {
    /// From the epoch of that number on.
    pub(super) sites: Arc<Vec<(u64, BaseSite)>>,
    /// In order of number and time, without gaps.
    pub(super) epochs: VecDeque<StoredBaseEpoch>,
    /// Bytes of the epochs.
    pub(super) bytes: usize,
    pub(super) check: PositionCheck,
    /// Satellites of the newest epoch.
    pub(super) satellites: usize,
    /// When the newest epoch was stored (ms since 1970-01-01 UTC).
    pub(super) stored_unix_ms: Option<i64>,
    /// A write failed, and what is stored is not known.
    pub(super) outdated: bool,
}

impl Held {
    pub(super) fn new(
        sites: Vec<(u64, BaseSite)>,
        epochs: Vec<StoredBaseEpoch>,
        stored_unix_ms: Option<i64>,
    ) -> Self {
        let bytes = epochs.iter().map(StoredBaseEpoch::size).sum();
        let newest = epochs.last().and_then(|stored| stored.epoch().ok());
        Self {
            sites: Arc::new(sites),
            epochs: epochs.into(),
            bytes,
            check: PositionCheck::new(),
            satellites: newest.map_or(0, |epoch| epoch.by_satellite().count()),
            stored_unix_ms,
            outdated: false,
        }
    }

    /// The number of the next epoch.
    pub(super) fn next_number(&self) -> u64 {
        self.epochs.back().map_or(1, |newest| newest.number + 1)
    }

    /// Where the base stands now.
    pub(super) fn site(&self) -> Option<&BaseSite> {
        self.sites.last().map(|(_, site)| site)
    }

    /// The site to store, if `site` is news.
    pub(super) fn new_site<'a>(&self, site: Option<&'a BaseSite>) -> Option<(u64, &'a BaseSite)> {
        let site = site.filter(|site| self.site() != Some(site))?;
        Some((self.next_number(), site))
    }

    /// Takes over a site that is stored.
    pub(super) fn take_site(&mut self, since: u64, site: BaseSite) {
        let sites = Arc::make_mut(&mut self.sites);
        sites.retain(|(other, _)| *other < since);
        sites.push((since, site));
        self.check = PositionCheck::new();
    }

    /// What becomes of an epoch behind those held and `new`; a new one is added to these.
    pub(super) fn place(
        &self,
        new: &mut Vec<StoredBaseEpoch>,
        epoch: &Epoch,
    ) -> Result<HeldEpoch, BaseEpochRefusal> {
        let time = epoch.time;
        let last = new.last().or_else(|| self.epochs.back());
        let Some(last) = last.filter(|last| time <= last.time) else {
            let number = last.map_or(1, |last| last.number + 1);
            new.push(StoredBaseEpoch::new(number, epoch));
            return Ok(HeldEpoch { number, resent: false });
        };
        let among_new = new.binary_search_by_key(&time, |stored| stored.time);
        let known = match among_new {
            Ok(place) => Some(&new[place]),
            Err(_) => {
                let place = self.epochs.binary_search_by_key(&time, |stored| stored.time);
                place.ok().map(|place| &self.epochs[place])
            }
        };
        match known {
            Some(known) if known.is(epoch) => Ok(HeldEpoch { number: known.number, resent: true }),
            Some(_) => Err(BaseEpochRefusal::Conflict { time }),
            None => Err(BaseEpochRefusal::OutOfOrder { time, last: last.time }),
        }
    }

    /// Numbers below this must go for `new` to fit within the limits; `None` if it alone does not.
    pub(super) fn first_kept(
        &self,
        new: &[StoredBaseEpoch],
        epochs_max: usize,
        bytes_max: usize,
    ) -> Option<u64> {
        let mut count = self.epochs.len() + new.len();
        let mut bytes = self.bytes + new.iter().map(StoredBaseEpoch::size).sum::<usize>();
        let mut oldest = self.epochs.iter();
        let mut first = self.epochs.front().or(new.first()).map_or(1, |epoch| epoch.number);
        while epochs_max < count || bytes_max < bytes {
            let dropped = oldest.next()?;
            count -= 1;
            bytes -= dropped.size();
            first = dropped.number + 1;
        }
        Some(first)
    }

    /// Takes over epochs that are stored.
    pub(super) fn take(&mut self, new: Vec<StoredBaseEpoch>, first_kept: u64, unix_ms: i64) {
        if let Some(newest) = new.last().and_then(|stored| stored.epoch().ok()) {
            self.satellites = newest.by_satellite().count();
            self.stored_unix_ms = Some(unix_ms);
        }
        self.bytes += new.iter().map(StoredBaseEpoch::size).sum::<usize>();
        self.epochs.extend(new);
        while let Some(oldest) = self.epochs.front().filter(|epoch| epoch.number < first_kept) {
            self.bytes -= oldest.size();
            self.epochs.pop_front();
        }
    }

    /// For how long at `time` the base had been heard without a gap of more than `gap_s`, looked
    /// for no further back than `limit_s` (s); `None` where its newest epoch was older than a gap.
    pub(super) fn heard_s(&self, time: GpsTime, gap_s: f64, limit_s: f64) -> Option<f64> {
        let end = self.epochs.partition_point(|epoch| epoch.time - time <= BASE_LATER_S);
        let mut since = None;
        for epoch in self.epochs.range(..end).rev() {
            let is_late = limit_s <= since.map_or(f64::NEG_INFINITY, |since| time - since);
            if is_late || gap_s < since.unwrap_or(time) - epoch.time {
                break;
            }
            since = Some(epoch.time);
        }
        since.map(|since| (time - since).max(0.0))
    }

    /// The epochs tagged from `from` until `until`.
    pub(super) fn between_times(&self, from: GpsTime, until: GpsTime) -> Vec<StoredBaseEpoch> {
        let start = self.epochs.partition_point(|epoch| epoch.time < from);
        let end = self.epochs.partition_point(|epoch| epoch.time <= until);
        self.epochs.range(start..end.max(start)).cloned().collect()
    }

    /// How much of a span is held; to its end if another epoch would lie behind it.
    pub(super) fn reach(&self, from: GpsTime, until: GpsTime) -> Reach {
        let mut newest = self.epochs.iter().rev().map(|epoch| epoch.time);
        let (Some(last), before) = (newest.next(), newest.next()) else { return Reach::Open };
        let interval_s = before.map_or(0.0, |before| last - before);
        if last < from || last + interval_s < until - TOLERANCE_S {
            return Reach::Open;
        }
        let first = self.epochs.partition_point(|epoch| epoch.time < from - TOLERANCE_S);
        let is_within = self.epochs.get(first).is_some_and(|epoch| epoch.time < until);
        if is_within { Reach::Whole } else { Reach::Passed }
    }

    /// The epochs numbered above `after`, up to `through`.
    pub(super) fn between_numbers(&self, after: u64, through: u64) -> Vec<StoredBaseEpoch> {
        let start = self.epochs.partition_point(|epoch| epoch.number <= after);
        let end = self.epochs.partition_point(|epoch| epoch.number <= through);
        self.epochs.range(start..end.max(start)).cloned().collect()
    }
}
