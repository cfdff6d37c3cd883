//! How each satellite of an epoch relates to its answer: direction, residual, and why it was not
//! used. For people who look at an answer; no estimator uses it.

use std::collections::BTreeMap;

use crate::config::PositioningOptions;
use crate::gnss::{Constellation, Ecef, Epoch, LocalFrame, Navigation, Reason};
use crate::gnss::{SatelliteId, Solution};
use crate::models::{LookAngles, geometric_range, look_angles, satellite_state};
use crate::models::{select_ephemeris, select_ephemeris_within};

use super::measurements::ReceiverBands;
use super::{Measurement, Measurements};

/// Minimum number of satellites of one constellation for a median that represents its clock.
const MEDIAN_MIN: usize = 3;

/// Whether a satellite determines the position, or why not.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SatelliteRole {
    /// Its measurements determine the position.
    Used,
    /// It contradicts the others.
    Excluded,
    /// There is no valid healthy ephemeris.
    NoEphemeris,
    /// It is below the elevation mask.
    BelowMask,
    /// The configuration does not use its constellation, or excludes it.
    SwitchedOff,
    /// Another cause: no usable pseudorange, a weak signal, or no common signal with the base.
    Unused,
}

/// One satellite of an epoch as seen from the answered position.
#[derive(Clone, Debug, PartialEq)]
pub struct SatelliteView {
    /// The observed satellite.
    pub satellite: SatelliteId,
    /// Whether it determines the position, or why not.
    pub role: SatelliteRole,
    /// Its direction; `None` without ephemeris or position.
    pub look: Option<LookAngles>,
    /// Pseudorange minus model at the answered position, against the median of its constellation
    /// (m). The median takes the place of the receiver's clock.
    pub residual_m: Option<f64>,
    /// Standard deviation of the pseudorange by the weights of single-point positioning (m).
    pub sigma_m: Option<f64>,
    /// A cycle slip was reported by the receiver or found.
    pub is_slipped: bool,
    /// A phase may be off by half a cycle.
    pub has_half_cycle: bool,
}

/// The observed satellites of `epoch`, in its order, as seen from its answer `solution`.
pub fn satellite_views(
    epoch: &Epoch,
    solution: &Solution,
    navigation: &Navigation,
    options: &PositioningOptions,
) -> Vec<SatelliteView> {
    let position = solution.estimate.as_ref().map(|estimate| estimate.position);
    let mut measurements = Measurements::default();
    measurements.gather(epoch, navigation, options, ReceiverBands::AGREEING);
    // `place` has no result for a position where no receiver can be: there are no residuals either.
    let residuals = position
        .filter(|position| measurements.place(*position, epoch.time, navigation, options).is_some())
        .map(|position| residuals(&measurements.list, position))
        .unwrap_or_default();
    let view = |satellite: SatelliteId| {
        let measured = measurements.list.iter().find(|m| m.satellite == satellite);
        SatelliteView {
            satellite,
            role: role(satellite, measured, solution, navigation, options),
            look: position.and_then(|position| look(satellite, epoch, position, navigation)),
            residual_m: residuals.get(&satellite).copied(),
            sigma_m: measured
                .map(|measured| measured.variance_m2.sqrt())
                .filter(|sigma_m| sigma_m.is_finite()),
            is_slipped: is_named(solution, satellite, |reason| {
                matches!(reason, Reason::CycleSlips { .. })
            }),
            has_half_cycle: is_named(solution, satellite, |reason| {
                matches!(reason, Reason::HalfCycleUnresolved { .. })
            }),
        }
    };
    let flagged = |(satellite, observations): (SatelliteId, &[crate::gnss::Observation])| {
        let mut view = view(satellite);
        view.is_slipped |= observations.iter().any(|observation| observation.loss_of_lock);
        view.has_half_cycle |= observations.iter().any(|observation| observation.half_cycle);
        view
    };
    epoch.by_satellite().map(flagged).collect()
}

/// Direction of a satellite at the epoch's time; the travel time of its signal is neglected.
fn look(
    satellite: SatelliteId,
    epoch: &Epoch,
    position: Ecef,
    navigation: &Navigation,
) -> Option<LookAngles> {
    let ephemeris = select_ephemeris(navigation, satellite, epoch.time)?;
    let state = satellite_state(ephemeris, epoch.time);
    Some(look_angles(&LocalFrame::at(position), state.position))
}

/// Pseudorange minus geometric range of each measurement (m), minus the median of its
/// constellation.
fn residuals(list: &[Measurement], position: Ecef) -> BTreeMap<SatelliteId, f64> {
    let mut by_constellation: BTreeMap<Constellation, Vec<(SatelliteId, f64)>> = BTreeMap::new();
    for measurement in list.iter().filter(|measurement| measurement.is_above_mask) {
        let (range_m, _) = geometric_range(measurement.state.position, position);
        let offset_m = measurement.corrected_range_m - range_m;
        let offsets = by_constellation.entry(measurement.satellite.constellation).or_default();
        offsets.push((measurement.satellite, offset_m));
    }
    by_constellation.retain(|_, offsets| MEDIAN_MIN <= offsets.len());
    let mut residuals = BTreeMap::new();
    for offsets in by_constellation.values_mut() {
        offsets.sort_by(|(_, a), (_, b)| a.total_cmp(b));
        let (_, median_m) = offsets[offsets.len() / 2];
        residuals
            .extend(offsets.iter().map(|(satellite, offset_m)| (*satellite, offset_m - median_m)));
    }
    residuals
}

fn role(
    satellite: SatelliteId,
    measured: Option<&Measurement>,
    solution: &Solution,
    navigation: &Navigation,
    options: &PositioningOptions,
) -> SatelliteRole {
    let used = solution.estimate.iter().flat_map(|estimate| &estimate.satellites_used);
    let is_excluded = |reason: &Reason| matches!(reason, Reason::SatellitesExcluded { .. });
    let is_wanted = options.systems.contains(satellite.constellation)
        && options.excluded_satellites.binary_search(&satellite).is_err();
    let reach_s = options.ephemeris_beidou_s;
    if used.into_iter().any(|used| *used == satellite) {
        SatelliteRole::Used
    } else if is_named(solution, satellite, is_excluded) {
        SatelliteRole::Excluded
    } else if !is_wanted {
        SatelliteRole::SwitchedOff
    } else if select_ephemeris_within(navigation, satellite, solution.time, reach_s).is_none() {
        SatelliteRole::NoEphemeris
    } else if measured.is_some_and(|measured| !measured.is_above_mask)
        && solution.estimate.is_some()
    {
        SatelliteRole::BelowMask
    } else {
        SatelliteRole::Unused
    }
}

/// Whether a reason of this kind names the satellite.
fn is_named(solution: &Solution, satellite: SatelliteId, kind: impl Fn(&Reason) -> bool) -> bool {
    solution.reasons.iter().filter(|reason| kind(reason)).any(|reason| match reason {
        Reason::EphemerisMissing { satellites }
        | Reason::SatellitesExcluded { satellites }
        | Reason::HalfCycleUnresolved { satellites }
        | Reason::CycleSlips { satellites } => satellites.contains(&satellite),
        _ => false,
    })
}
