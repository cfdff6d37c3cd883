//! Observations referred from an antenna's phase centres to its reference point.
//!
//! The correction depends on the direction of each satellite, for which an approximate position,
//! wrong by some kilometres, is enough. So it is subtracted from the observations before any
//! estimator. Positions then refer to the antenna reference point.

use crate::gnss::constants::SPEED_OF_LIGHT;
use crate::gnss::{AntennaCalibration, Ecef, Epoch, LocalFrame, Navigation, Observation, Signal};
use crate::models::antenna::{pattern_of, phase_centre_correction_m};
use crate::models::{LookAngles, look_angles, select_ephemeris, state_at_transmission};

/// Subtracts the antenna's phase-centre correction from pseudoranges and carrier phases. `position`
/// is the receiver's approximate position, good to some kilometres.
///
/// Two kinds of observations stay unchanged: those of satellites without ephemeris or pseudorange,
/// whose direction is unknown (they are not used), and those of signals without a calibrated
/// frequency within 40 MHz. The latter signals are added to `uncalibrated`, each once.
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

/// Corrects one observation; returns whether its signal is calibrated.
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
