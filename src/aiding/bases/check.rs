//! Checks the stated position of a base with stored or pushed epochs.

use crate::config::{Mode, PositioningOptions, Profile};
use crate::gnss::{BaseSite, Epoch, GpsTime, Navigation};
use crate::positioning::{Aiding, BasePositionCheck, Estimator};

/// Interval of checks (s).
const INTERVAL_S: f64 = 3600.0;

/// Repeated checks of a base's position: a base may move, and the ephemerides of an earlier check
/// may have been wrong.
#[derive(Clone, Copy, Debug)]
pub(super) struct PositionChecks {
    /// The last completed check. Before the first is completed, it is the first check.
    pub(super) present: BasePositionCheck,
    /// The check to continue.
    next: BasePositionCheck,
    /// Time of the epoch that completed `present`.
    ended: Option<GpsTime>,
}

impl PositionChecks {
    /// A check without epochs.
    pub(super) fn new() -> Self {
        let none = BasePositionCheck::new();
        Self { present: none, next: none, ended: None }
    }

    /// Whether epochs at `time` belong to a check.
    pub(super) fn is_due(&self, time: GpsTime) -> bool {
        self.ended.is_none_or(|ended| INTERVAL_S <= time - ended)
    }

    /// Continues the check with these epochs.
    pub(super) fn advance(
        mut self,
        site: &BaseSite,
        epochs: impl IntoIterator<Item = Epoch>,
        navigation: &Navigation,
    ) -> Self {
        let mut last = None;
        let epochs = epochs.into_iter().inspect(|epoch| last = Some(epoch.time));
        let check = continue_check(self.next, site, epochs, navigation);
        // Only the first check is reported before it is complete.
        if self.ended.is_none() || check.is_done() {
            self.present = check;
        }
        self.next = check;
        if check.is_done() {
            (self.next, self.ended) = (BasePositionCheck::new(), last);
        }
        self
    }
}

/// Continues a check with epochs until there are enough.
fn continue_check(
    mut check: BasePositionCheck,
    site: &BaseSite,
    epochs: impl IntoIterator<Item = Epoch>,
    navigation: &Navigation,
) -> BasePositionCheck {
    let stated = site.antenna_reference_point();
    let options = PositioningOptions::new(Mode::Spp, Profile::General);
    let mut single_point = Estimator::new(options);
    for epoch in epochs {
        if check.is_done() {
            break;
        }
        let solution = single_point.advance(&epoch, &Aiding::alone(navigation));
        if let Some(estimate) = solution.estimate {
            check.add(stated, estimate.position);
        }
    }
    check
}
