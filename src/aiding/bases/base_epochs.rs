//! The epochs and sites of one base in memory. They are the same as in the store.

use std::collections::VecDeque;
use std::sync::Arc;

use crate::gnss::{BaseSite, GpsTime};
use crate::positioning::BASE_LATER_S;
use crate::store::StoredBaseEpoch;

use super::check::PositionChecks;
use super::{BaseEpochRefusal, CommittedEpoch};

/// Tolerance of epoch tags to the nominal second (s).
const TAG_TOLERANCE_S: f64 = 0.5;

/// Whether all epochs of a span of time, which excludes its end, are stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Coverage {
    /// More epochs of the span may still arrive.
    Incomplete,
    /// Epochs are stored up to the end of the span.
    Complete,
    /// No epoch of the span is stored, and none can be added: the base already has newer epochs,
    /// and takes epochs in order of time only.
    Missed,
}

/// The epochs and sites of one base.
#[derive(Clone, Debug)]
pub(super) struct BaseEpochs {
    /// Each site is valid from the base epoch of this number on.
    pub(super) sites: Arc<Vec<(u64, BaseSite)>>,
    /// In order of number and time, with consecutive numbers.
    pub(super) epochs: VecDeque<StoredBaseEpoch>,
    /// Encoded size of the epochs.
    pub(super) bytes: usize,
    pub(super) checks: PositionChecks,
    /// Numbers of the navigation push and of the newest epoch at the last check on request.
    pub(super) check_tried: Option<(u64, u64)>,
    /// Number of satellites in the newest epoch.
    pub(super) satellites: usize,
    /// When the newest epoch was stored (ms since 1970-01-01 UTC).
    pub(super) stored_unix_ms: Option<i64>,
    /// A commit has begun and was not confirmed, so the store may differ and must be read again.
    pub(super) outdated: bool,
}

impl BaseEpochs {
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
            checks: PositionChecks::new(),
            check_tried: None,
            satellites: newest.map_or(0, |epoch| epoch.by_satellite().count()),
            stored_unix_ms,
            outdated: false,
        }
    }

    /// The number of the next epoch.
    pub(super) fn next_number(&self) -> u64 {
        self.epochs.back().map_or(1, |newest| newest.number + 1)
    }

    /// The site at the newest epoch.
    pub(super) fn site(&self) -> Option<&BaseSite> {
        self.sites.last().map(|(_, site)| site)
    }

    /// `site` with the number of its first epoch, if it differs from the present site.
    pub(super) fn new_site<'a>(&self, site: Option<&'a BaseSite>) -> Option<(u64, &'a BaseSite)> {
        let site = site.filter(|site| self.site() != Some(site))?;
        Some((self.next_number(), site))
    }

    /// Adds a site that is now stored.
    pub(super) fn add_site(&mut self, since: u64, site: BaseSite) {
        let sites = Arc::make_mut(&mut self.sites);
        sites.retain(|(other, _)| *other < since);
        sites.push((since, site));
        (self.checks, self.check_tried) = (PositionChecks::new(), None);
    }

    /// Replaces the sites by those that are stored.
    pub(super) fn replace_sites(&mut self, sites: Vec<(u64, BaseSite)>) {
        self.sites = Arc::new(sites);
        (self.checks, self.check_tried) = (PositionChecks::new(), None);
    }

    /// Decides whether `epoch` is new, a repetition, or refused. A new epoch is appended to `new`,
    /// the epochs of the same push that are not stored yet.
    pub(super) fn accept(
        &self,
        new: &mut Vec<StoredBaseEpoch>,
        epoch: &StoredBaseEpoch,
    ) -> Result<CommittedEpoch, BaseEpochRefusal> {
        let time = epoch.time;
        let last = new.last().or_else(|| self.epochs.back());
        let Some(last) = last.filter(|last| time <= last.time) else {
            let number = last.map_or(1, |last| last.number + 1);
            new.push(epoch.numbered(number));
            return Ok(CommittedEpoch { number, resent: false });
        };
        let among_new = new.binary_search_by_key(&time, |stored| stored.time);
        let known = match among_new {
            Ok(index) => Some(&new[index]),
            Err(_) => {
                let index = self.epochs.binary_search_by_key(&time, |stored| stored.time);
                index.ok().map(|index| &self.epochs[index])
            }
        };
        match known {
            Some(known) if known.is(epoch) => {
                Ok(CommittedEpoch { number: known.number, resent: true })
            }
            Some(_) => Err(BaseEpochRefusal::Conflict { time }),
            None => Err(BaseEpochRefusal::OutOfOrder { time, last: last.time }),
        }
    }

    /// The number of the first epoch to keep so that the stored epochs and `new` fit within the
    /// limits; `None` if `new` alone exceeds them.
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

    /// Adds epochs that are now stored, and drops those numbered below `first_kept`.
    pub(super) fn add(&mut self, new: Vec<StoredBaseEpoch>, first_kept: u64, unix_ms: i64) {
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

    /// Time (s) before `time` during which base epochs arrived without a gap of more than `gap_s`;
    /// the search stops at `limit_s`. `None` if the newest epoch is older than `gap_s`.
    pub(super) fn uninterrupted_s(&self, time: GpsTime, gap_s: f64, limit_s: f64) -> Option<f64> {
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

    /// The epochs tagged from `from` until `until`, both included.
    pub(super) fn between_times(&self, from: GpsTime, until: GpsTime) -> Vec<StoredBaseEpoch> {
        let start = self.epochs.partition_point(|epoch| epoch.time < from);
        let end = self.epochs.partition_point(|epoch| epoch.time <= until);
        self.epochs.range(start..end.max(start)).cloned().collect()
    }

    /// Whether the epochs of a span are stored. The span is complete if the next epoch, one
    /// interval after the newest, would lie beyond its end.
    pub(super) fn coverage(&self, from: GpsTime, until: GpsTime) -> Coverage {
        let mut newest = self.epochs.iter().rev().map(|epoch| epoch.time);
        let (Some(last), before) = (newest.next(), newest.next()) else {
            return Coverage::Incomplete;
        };
        let interval_s = before.map_or(0.0, |before| last - before);
        if last < from || last + interval_s < until - TAG_TOLERANCE_S {
            return Coverage::Incomplete;
        }
        let first = self.epochs.partition_point(|epoch| epoch.time < from - TAG_TOLERANCE_S);
        let is_within = self.epochs.get(first).is_some_and(|epoch| epoch.time < until);
        if is_within { Coverage::Complete } else { Coverage::Missed }
    }

    /// The epochs numbered above `after`, up to `through`.
    pub(super) fn between_numbers(&self, after: u64, through: u64) -> Vec<StoredBaseEpoch> {
        let start = self.epochs.partition_point(|epoch| epoch.number <= after);
        let end = self.epochs.partition_point(|epoch| epoch.number <= through);
        self.epochs.range(start..end.max(start)).cloned().collect()
    }
}
