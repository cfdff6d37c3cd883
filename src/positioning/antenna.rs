//! Observations brought from an antenna's phase centres to its reference point.
//!
//! What an antenna adds depends on the direction of each satellite, and on nothing that an
//! estimator knows better than to some kilometres: it is taken off the observations before any
//! estimator sees them. Positions are then those of the antenna reference point.

use crate::gnss::constants::SPEED_OF_LIGHT;
use crate::gnss::{AntennaCalibration, Ecef, Epoch, LocalFrame, Navigation, Observation, Signal};
use crate::models::antenna::{pattern_of, phase_centre_correction_m};
use crate::models::{LookAngles, look_angles, select_ephemeris, state_at_transmission};

/// Takes off the observations of an epoch what the antenna adds to them, pseudoranges and carrier
/// phases alike. `position` is the receiver's, to some kilometres.
///
/// Left as they are: satellites without ephemeris or pseudorange, which have no direction (and are
/// not used), and signals whose frequency was not calibrated, nor one within 40 MHz; these are
/// added to `uncalibrated`, each once.
pub fn correct_for_antenna(
    epoch: &mut Epoch,
    antenna: &AntennaCalibration,
    position: Ecef,
    navigation: &Navigation,
    uncalibrated: &mut Vec<Signal>,
) {
    let frame = LocalFrame::at(position);
    let time = epoch.time;
    let same = |a: &Observation, b: &Observation| a.satellite == b.satellite;
    for group in epoch.observations.chunk_by_mut(same) {
        let Some(ephemeris) = select_ephemeris(navigation, group[0].satellite, time) else {
            continue;
        };
        let measured = |o: &Observation| o.pseudorange_m.filter(|range_m| range_m.is_finite());
        let Some(pseudorange_m) = group.iter().find_map(measured) else { continue };
        let state = state_at_transmission(ephemeris, time, pseudorange_m);
        let look = look_angles(&frame, state.position);
        for observation in group {
            let signal = observation.signal();
            let frequency_hz = signal.frequency_hz(ephemeris.glonass_channel());
            let Some(frequency_hz) = frequency_hz else { continue };
            if !correct(observation, antenna, frequency_hz, &look)
                && !uncalibrated.contains(&signal)
            {
                uncalibrated.push(signal);
            }
        }
    }
}

/// Whether the signal was calibrated.
fn correct(
    observation: &mut Observation,
    antenna: &AntennaCalibration,
    frequency_hz: f64,
    look: &LookAngles,
) -> bool {
    let Some(pattern) = pattern_of(antenna, observation.signal(), frequency_hz) else {
        return false;
    };
    let added_m = phase_centre_correction_m(pattern, look);
    if let Some(range_m) = &mut observation.pseudorange_m {
        *range_m -= added_m;
    }
    if let Some(phase) = &mut observation.carrier_phase {
        phase.0 -= added_m * frequency_hz / SPEED_OF_LIGHT;
    }
    true
}
