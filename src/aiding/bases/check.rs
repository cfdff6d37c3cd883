//! Checks the stated position of a base with stored or pushed epochs.

use crate::config::{Mode, PositioningOptions, Profile};
use crate::gnss::{BaseSite, Epoch, Navigation};
use crate::positioning::{Aiding, BasePositionCheck, Estimator};

/// Continues a check with epochs until there are enough.
pub(super) fn continue_check<'a>(
    mut check: BasePositionCheck,
    site: &BaseSite,
    epochs: impl IntoIterator<Item = &'a Epoch>,
    navigation: &Navigation,
) -> BasePositionCheck {
    let stated = site.antenna_reference_point();
    let options = PositioningOptions::new(Mode::Spp, Profile::General);
    let mut single_point = Estimator::new(options);
    for epoch in epochs {
        if check.is_done() {
            break;
        }
        let solution = single_point.advance(epoch, &Aiding::alone(navigation));
        if let Some(estimate) = solution.estimate {
            check.add(stated, estimate.position);
        }
    }
    check
}
