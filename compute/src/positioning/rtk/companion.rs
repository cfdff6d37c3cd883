//! A chain without ambiguities, for the epochs without integers.
//!
//! Among houses a window with ambiguities is often worse than an estimator without a base. A new or
//! biased arc, and the multipath of its pseudoranges, act on the position as a constant. So epochs
//! without integers are also given to the estimator of a receiver without a base. Its pseudoranges
//! are corrected by those of the base, so its position is relative to the base, too. The chain
//! begins at the last epoch with integers, at its fixed position. The chain does not change the
//! window with ambiguities.

use nalgebra::Matrix3;

use crate::gnss::{Ecef, Epoch, GpsTime, LocalFrame, Observation, Solution};
use crate::positioning::differencing::{BaseClock, SingleDifferences};
use crate::positioning::engine::{Engine, EpochInputs};
use crate::positioning::fgo::{KnownPosition, SlidingWindow, WindowScratch};
use crate::positioning::measurements::CorrectedRanges;
use crate::positioning::setup::Setup;
use crate::snapshot::{snapshot_fields, state_fields};

use super::answer::horizontal_m2;
use super::observed::Tracked;

/// Largest standard deviation of a position that is not compared with rival positions (m). A rival
/// at 8 m then has odds of e⁻¹⁰; at lower odds the comparison does not move a settled chain either.
const TIED_M: f64 = 1.8;

/// Standard deviation of the difference between the frame of a base and that of broadcast
/// ephemerides, for each axis (m). Frames that are tied to a continent move with it: the ETRS89
/// by 2.5 cm a year, 0.9 m since 1989.
const FRAME_M: f64 = 1.0;

/// The last epoch with integers.
#[derive(Debug)]
struct Anchor {
    epoch: Epoch,
    position: Ecef,
    /// ECEF (m²).
    covariance: Matrix3<f64>,
}

snapshot_fields!(Anchor { epoch, position, covariance });

impl Clone for Anchor {
    fn clone(&self) -> Self {
        Self { epoch: self.epoch.clone(), ..*self }
    }
}

/// A chain for the epochs without integers.
#[derive(Debug)]
pub(crate) struct Companion {
    window: SlidingWindow,
    anchor: Option<Anchor>,
    clock: BaseClock,
    /// When the chain began at a fixed position, if its position has been certain since
    /// ([`TIED_M`]).
    tied_since: Option<GpsTime>,
    /// Carriers that may have slipped at the rover since the last epoch of the chain or the anchor.
    lost: Vec<Tracked>,
}

state_fields!(Companion { window, anchor, clock, tied_since, lost });

/// Scratch of the companion.
#[derive(Debug, Default)]
pub(crate) struct CompanionScratch {
    window: WindowScratch,
    corrected: CorrectedRanges,
    numbers: Vec<f64>,
    marked: MarkedEpoch,
}

/// An epoch of the rover in which all carriers that may have slipped have a loss of lock.
#[derive(Debug)]
struct MarkedEpoch(Epoch);

impl Default for MarkedEpoch {
    fn default() -> Self {
        Self(Epoch::new(GpsTime::EPOCH))
    }
}

impl MarkedEpoch {
    /// `epoch`, with a loss of lock at all carriers in `lost`.
    fn of<'a>(&'a mut self, epoch: &'a Epoch, lost: &[Tracked]) -> &'a Epoch {
        let may_have_slipped = |o: &Observation| lost.contains(&(o.satellite, o.code));
        if !epoch.observations.iter().any(|o| !o.loss_of_lock && may_have_slipped(o)) {
            return epoch;
        }
        self.0.clone_from(epoch);
        for observation in &mut self.0.observations {
            observation.loss_of_lock |= may_have_slipped(observation);
        }
        &self.0
    }
}

impl Companion {
    /// The companion before the first epoch.
    pub(crate) fn new(setup: &Setup) -> Self {
        let (window, clock) = (SlidingWindow::new(setup, false), BaseClock::default());
        Self { window, anchor: None, clock, tied_since: None, lost: Vec::new() }
    }

    /// Whether a state that was read from a snapshot fits the options.
    pub(crate) fn fits(&self, setup: &Setup) -> bool {
        self.window.fits(setup)
    }

    /// Keeps an epoch with integers and its answer as the new anchor, and lets the chain rest.
    pub(crate) fn rest_at(&mut self, epoch: &Epoch, fixed: &Solution) {
        self.window.rest();
        self.lost.clear();
        let Some(estimate) = &fixed.estimate else { return };
        let (position, covariance) = (estimate.position, estimate.covariance);
        match &mut self.anchor {
            Some(anchor) => {
                anchor.epoch.clone_from(epoch);
                (anchor.position, anchor.covariance) = (position, covariance);
            }
            None => self.anchor = Some(Anchor { epoch: epoch.clone(), position, covariance }),
        }
    }

    /// The last epoch with integers, if no epoch without integers followed it, and its position in
    /// the frame of broadcast ephemerides.
    pub(crate) fn last_fixed(&self) -> Option<(&Epoch, KnownPosition)> {
        let anchor = self.anchor.as_ref()?;
        let known = anchor.known();
        let sigma_m = known.sigma_m.map(|sigma_m| sigma_m.hypot(FRAME_M));
        Some((&anchor.epoch, KnownPosition { sigma_m, ..known }))
    }

    /// Notes carriers that may have slipped at the rover since its last epoch.
    pub(crate) fn note_lost(&mut self, carriers: impl IntoIterator<Item = Tracked>) {
        for carrier in carriers {
            if !self.lost.contains(&carrier) {
                self.lost.push(carrier);
            }
        }
    }

    /// Forgets every position, because the base is another one or has moved.
    pub(crate) fn forget(&mut self) {
        self.window.rest();
        self.anchor = None;
    }

    /// Solves an epoch without integers, that was differenced against the base.
    ///
    /// `difference_at` differences an epoch against the base, for a rover at a position; false
    /// where that is impossible. The anchor's epoch is differenced by it when the chain begins
    /// there.
    pub(crate) fn advance(
        &mut self,
        inputs: &EpochInputs<'_>,
        differences: &mut SingleDifferences,
        difference_at: impl FnOnce(&EpochInputs<'_>, Ecef, &mut SingleDifferences) -> bool,
        scratch: &mut CompanionScratch,
    ) -> Solution {
        let CompanionScratch { window, corrected, numbers, marked } = scratch;
        self.clock.follow(differences, numbers);
        let anchor = self.anchor.take();
        let mut now = std::mem::take(corrected);
        self.clock.correct(differences, &mut now);
        if let Some(anchor) = anchor.filter(|_| self.window.is_empty()) {
            let of_anchor = EpochInputs { epoch: &anchor.epoch, ..*inputs };
            if difference_at(&of_anchor, anchor.position, differences) {
                self.clock.correct(differences, corrected);
                let of_anchor = EpochInputs { corrected: Some(corrected), ..of_anchor };
                self.window.begin_at(&anchor.known(), &of_anchor, window);
                self.tied_since = self.window.started();
            }
        }
        // The chain may have begun again elsewhere.
        self.tied_since = self.tied_since.filter(|since| self.window.started() == Some(*since));
        if self.tied_since.is_some() {
            self.window.settle(inputs.epoch.time);
        }
        *corrected = now;
        let epoch = marked.of(inputs.epoch, &self.lost);
        let inputs = EpochInputs { epoch, corrected: Some(corrected), ..*inputs };
        let solution = self.window.advance(&inputs, window, &mut Vec::new());
        self.lost.clear();
        let is_certain = solution.estimate.as_ref().is_some_and(|estimate| {
            horizontal_m2(estimate.position, &estimate.covariance) < TIED_M * TIED_M
        });
        self.tied_since = self.tied_since.filter(|_| is_certain);
        solution
    }
}

impl Anchor {
    fn known(&self) -> KnownPosition {
        let rotation = LocalFrame::at(self.position).rotation;
        let covariance = rotation * self.covariance * rotation.transpose();
        let sigma_m = covariance.diagonal().map(f64::sqrt);
        KnownPosition { position: self.position, sigma_m }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gnss::{Constellation, ObservationCode, SatelliteId};

    /// Only carriers that may have slipped are marked; without any the epoch is not copied.
    #[test]
    fn carriers_that_may_have_slipped_are_marked() {
        let code = ObservationCode::parse("1C").unwrap();
        let satellite = |number| SatelliteId::new(Constellation::Gps, number).unwrap();
        let mut epoch = Epoch::new(GpsTime::EPOCH);
        epoch.observations.extend((1..=3).map(|n| Observation::empty(satellite(n), code)));
        epoch.observations[2].loss_of_lock = true;
        let mut marked = MarkedEpoch::default();
        let lost = |epoch: &Epoch| -> Vec<bool> {
            epoch.observations.iter().map(|o| o.loss_of_lock).collect()
        };
        let with = lost(marked.of(&epoch, &[(satellite(1), code)]));
        assert_eq!([with, lost(&epoch)], [vec![true, false, true], vec![false, false, true]]);
        assert!(std::ptr::eq(marked.of(&epoch, &[(satellite(3), code)]), &epoch));
    }
}
