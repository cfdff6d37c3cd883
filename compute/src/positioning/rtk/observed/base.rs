//! What is kept of the base between epochs of the rover.

use crate::gnss::{BaseStation, Ecef, Epoch, GpsTime, Reason};
use crate::positioning::aiding::BASE_LATER_S;
use crate::positioning::aiding::BASE_MOVED_M;
use crate::positioning::engine::EpochInputs;
use crate::positioning::measurements::ReceiverBands;
use crate::positioning::spp::SinglePoint;
use crate::positioning::{BasePositionCheck, BasePositionVerdict};
use crate::snapshot::state_fields;

use super::losses::{LockWatch, Tracked};

/// The newest base epoch, and the possible slips of the base since the rover's last epoch.
#[derive(Debug)]
pub(crate) struct BaseMemory {
    /// Name and last position of the base.
    station: Option<(String, Ecef)>,
    newest: Option<Epoch>,
    locks: LockWatch,
    /// Carriers that may have slipped.
    lost: Vec<Tracked>,
    /// Probability that the base has kept lock where its epochs are missing.
    survival: f64,
    /// Whether the base lost power.
    power_failed: bool,
    /// The stated position, and its check.
    check: Option<(Ecef, BasePositionCheck)>,
    /// Time of the last epoch that entered the check.
    checked: Option<GpsTime>,
}

state_fields!(BaseMemory { station, newest, locks, lost, survival, power_failed, check, checked });

impl Default for BaseMemory {
    fn default() -> Self {
        Self {
            station: None,
            newest: None,
            locks: LockWatch::default(),
            lost: Vec::new(),
            survival: 1.0,
            power_failed: false,
            check: None,
            checked: None,
        }
    }
}

/// Losses of lock of the base, reported or possible.
pub(crate) struct BaseLosses {
    pub(crate) power_failed: bool,
    /// Carriers that may have slipped.
    pub(crate) lost: Vec<Tracked>,
    /// Probability that the base has kept lock where its epochs are missing.
    pub(crate) survival: f64,
}

impl BaseMemory {
    /// Distance from the known base to this one (m), if this is another base.
    pub(crate) fn changed_m(&self, station: &BaseStation) -> Option<f64> {
        let (_, known) = self.station.as_ref().filter(|(name, _)| *name != station.name)?;
        Some(known.distance_m(station.antenna_reference_point))
    }

    /// Keeps the name and position of the base.
    pub(crate) fn know(&mut self, station: &BaseStation) {
        let position = station.antenna_reference_point;
        match &mut self.station {
            Some((name, known)) if *name == station.name => *known = position,
            other => *other = Some((station.name.clone(), position)),
        }
    }

    /// Takes in the epochs that are new and not later than the rover's epoch at `time`. Carriers
    /// without a phase for `gap_s` of observed time are forgotten.
    pub(crate) fn take(&mut self, epochs: &[Epoch], time: GpsTime, gap_s: f64) {
        for epoch in epochs {
            let is_new = self.newest.as_ref().is_none_or(|newest| newest.time < epoch.time);
            if !is_new || BASE_LATER_S < epoch.time - time {
                continue;
            }
            self.power_failed |= epoch.power_failure;
            self.survival *= self.locks.take(epoch, gap_s, &mut self.lost).survival;
            match &mut self.newest {
                Some(newest) => {
                    newest.time = epoch.time;
                    newest.power_failure = epoch.power_failure;
                    newest.observations.clone_from(&epoch.observations);
                }
                None => self.newest = Some(epoch.clone()),
            }
        }
    }

    /// Checks the stated position against the single-point positions of the base. The newest epoch
    /// enters their mean once, until the mean has enough epochs. If it then refuses the position,
    /// the next epoch begins another mean, since one wild epoch must not refuse a base for ever. A
    /// single point whose residuals are too large is left out.
    pub(crate) fn checked(
        &mut self,
        station: &BaseStation,
        single_point: &mut SinglePoint,
        inputs: &EpochInputs<'_>,
    ) -> BasePositionCheck {
        let stated = station.antenna_reference_point;
        let known = self.check.filter(|(position, _)| *position == stated);
        let mut check = known.map_or_else(BasePositionCheck::new, |(_, check)| check);
        let is_refused = check.is_done() && check.verdict() == BasePositionVerdict::Refused;
        if (is_refused || !check.is_done())
            && let Some(newest) = self.newest.as_ref().filter(|e| self.checked != Some(e.time))
        {
            self.checked = Some(newest.time);
            let bands = ReceiverBands::of(newest);
            let of_base = EpochInputs { epoch: newest, bands, ..*inputs };
            let alone = single_point.solve(&of_base, Some(stated));
            let is_wild = |reason: &Reason| matches!(reason, Reason::ResidualsTooLarge { .. });
            let sound = alone.estimate.filter(|_| !alone.reasons.iter().any(is_wild));
            if let Some(estimate) = sound {
                check = if is_refused { BasePositionCheck::new() } else { check };
                check.add(stated, estimate.position);
            }
        }
        self.check = Some((stated, check));
        check
    }

    /// Distance from the position that the base stated last to its present one (m); `None` if it
    /// has not moved. After a move its phases refer to another position, so no arc continues.
    pub(crate) fn moved_m(&self, station: &BaseStation) -> Option<f64> {
        let (_, known) = self.station.as_ref().filter(|(name, _)| *name == station.name)?;
        Some(known.distance_m(station.antenna_reference_point)).filter(|m| BASE_MOVED_M < *m)
    }

    /// The newest epoch.
    pub(crate) fn newest(&self) -> Option<&Epoch> {
        self.newest.as_ref()
    }

    /// The losses of lock since the last call.
    pub(crate) fn take_losses(&mut self) -> BaseLosses {
        BaseLosses {
            power_failed: std::mem::take(&mut self.power_failed),
            lost: std::mem::take(&mut self.lost),
            survival: std::mem::replace(&mut self.survival, 1.0),
        }
    }
}
