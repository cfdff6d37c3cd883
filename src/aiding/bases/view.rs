//! The part of a base that a session reads: its epochs around those of the rover.

use std::sync::Arc;

use crate::gnss::{AntennaCalibration, BaseSite, BaseStation, Epoch, GpsTime, Navigation};
use crate::positioning::{BASE_LATER_S, BaseAiding, correct_for_antenna};
use crate::store::{BaseKey, BaseName, BaseUse, StoredBaseEpoch};

/// The key of bases that are not stored: rows are numbered from 1.
const NOT_STORED: BaseKey = BaseKey::of_number(0);

/// A base and its epochs of a span of time. Later changes of the base do not change it.
#[derive(Clone, Debug)]
pub struct BaseView {
    pub(super) name: BaseName,
    /// Each site is valid from the base epoch of this number on.
    pub(super) sites: Arc<Vec<(u64, BaseSite)>>,
    /// In order of number and time, with consecutive numbers.
    pub(super) epochs: Vec<StoredBaseEpoch>,
}

/// The base epochs that an estimator receives with one epoch of the rover.
#[derive(Clone, Debug, PartialEq)]
pub struct BaseInput {
    /// The numbers of the epochs. Replay uses them to give the estimator the same epochs again.
    pub used: BaseUse,
    station: Option<BaseStation>,
    /// The calibration of the station's antenna.
    calibration: Option<Arc<AntennaCalibration>>,
    /// Whether the estimator received its last base epochs with another calibration.
    is_recalibrated: bool,
    epochs: Vec<Epoch>,
}

impl BaseView {
    /// A view without epochs and without a known position.
    pub(crate) fn empty(name: BaseName) -> Self {
        Self { name, sites: Arc::default(), epochs: Vec::new() }
    }

    /// The id and key of the base.
    pub(crate) const fn name(&self) -> &BaseName {
        &self.name
    }

    /// The base epochs that the estimator receives with a rover epoch at `time`: numbered above
    /// `after`, tagged up to `time`, and at most `span_s` old. The station is the site of the
    /// newest of them, because the rover's observations are differenced against that epoch.
    pub(crate) fn input_at(&self, time: GpsTime, after: u64, span_s: f64) -> BaseInput {
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
        self.input(BaseUse { base: self.name.key, after, through }, epochs)
    }

    /// The base epochs of an earlier solution, or `None` if some of them are no longer stored.
    pub fn replayed_input(&self, used: BaseUse) -> Option<BaseInput> {
        let above = |number: u64| self.epochs.partition_point(|epoch| epoch.number <= number);
        let epochs = &self.epochs[above(used.after)..above(used.through)];
        let is_whole = epochs.len() as u64 == used.through - used.after;
        let has_site = used.through == 0 || self.site_at(used.through).is_some();
        (is_whole && has_site).then(|| self.input(used, epochs))
    }

    /// The base epochs of an earlier solution that are still stored.
    pub(crate) fn remaining_input(&self, used: BaseUse) -> BaseInput {
        let above = |number: u64| self.epochs.partition_point(|epoch| epoch.number <= number);
        self.input(used, &self.epochs[above(used.after)..above(used.through)])
    }

    fn input(&self, used: BaseUse, epochs: &[StoredBaseEpoch]) -> BaseInput {
        let read = |stored: &StoredBaseEpoch| {
            stored.epoch().expect("it was encoded here, or read when the desk was opened")
        };
        let site = self.site_at(used.through);
        let before = self.site_at(used.after);
        let calibration = site.and_then(|site| site.calibration.clone());
        let is_recalibrated =
            before.is_some_and(|before| is_other(&before.calibration, &calibration));
        BaseInput {
            used,
            station: site.map(|site| site.station(self.name.id.to_string())),
            calibration,
            is_recalibrated,
            epochs: epochs.iter().map(read).collect(),
        }
    }

    /// The site of the base at its epoch `number`; none for number 0, which is before the first
    /// epoch.
    pub(super) fn site_at(&self, number: u64) -> Option<&BaseSite> {
        let sites = self.sites.iter().rev();
        sites.filter(|_| 0 < number).find(|(since, _)| *since <= number).map(|(_, site)| site)
    }
}

/// Whether two calibrations differ; usually both are the same object.
fn is_other(
    before: &Option<Arc<AntennaCalibration>>,
    now: &Option<Arc<AntennaCalibration>>,
) -> bool {
    match (before, now) {
        (Some(before), Some(now)) => !Arc::ptr_eq(before, now) && before != now,
        (None, None) => false,
        _ => true,
    }
}

impl BaseInput {
    /// The epochs of a base that is not stored, such as a base from a file.
    pub(crate) fn not_stored(aiding: BaseAiding<'_>) -> Self {
        Self {
            used: BaseUse { base: NOT_STORED, after: 0, through: 0 },
            station: Some(aiding.station.clone()),
            calibration: None,
            is_recalibrated: false,
            epochs: aiding.epochs.to_vec(),
        }
    }

    /// The input of the estimator; `None` while the base has no position or no epoch.
    pub fn aiding(&self) -> Option<BaseAiding<'_>> {
        let station = self.station.as_ref()?;
        Some(BaseAiding { station, epochs: &self.epochs })
    }

    /// Whether the estimator received its last base epochs with another calibration of the antenna.
    pub(crate) const fn is_recalibrated(&self) -> bool {
        self.is_recalibrated
    }

    /// Reduces the observations to the antenna reference point, if the antenna is calibrated.
    pub(crate) fn correct_for_antenna(&mut self, navigation: &Navigation) {
        let (Some(station), Some(calibration)) = (&self.station, &self.calibration) else { return };
        let (point, mut uncalibrated) = (station.antenna_reference_point, Vec::new());
        for epoch in &mut self.epochs {
            correct_for_antenna(epoch, calibration, point, navigation, &mut uncalibrated);
        }
    }
}
