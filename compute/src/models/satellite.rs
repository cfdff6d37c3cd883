//! Satellite states from broadcast ephemerides of any constellation.

use nalgebra::Vector3;

use super::orbit::{Clock, Orbit};
use super::{glonass, kepler, weights};
use crate::gnss::constants::SPEED_OF_LIGHT;
use crate::gnss::{Ecef, Ephemeris, GpsTime};

/// Position, velocity and clock of a satellite at one instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SatelliteState {
    /// Antenna phase centre, ECEF at that instant (m).
    pub position: Ecef,
    /// Velocity in ECEF (m/s).
    pub velocity_m_s: Vector3<f64>,
    /// Clock offset from system time c·δtˢ (m), with relativity, without group delays.
    pub clock_m: f64,
    /// Clock drift c·δṫˢ (m/s), with relativity.
    pub clock_drift_m_s: f64,
    /// Variance of the range due to orbit and clock errors (m²).
    pub variance_m2: f64,
}

/// State of the satellite at `time`, in the Earth-fixed frame of that instant.
pub fn satellite_state(ephemeris: &Ephemeris, time: GpsTime) -> SatelliteState {
    match ephemeris {
        Ephemeris::Keplerian(e) => {
            let (orbit, clock) = kepler::state(e, time);
            assemble(orbit, clock, weights::ephemeris_variance_m2(ephemeris))
        }
        Ephemeris::Glonass(e) => {
            let orbit = glonass::orbit(e, time);
            assemble(orbit, glonass::clock(e, time), weights::ephemeris_variance_m2(ephemeris))
        }
    }
}

/// State of the satellite at the transmission of a signal received at `tag` with that pseudorange.
///
/// t = tag − P/c − δtˢ: the receiver's clock error is in tag and P alike and cancels. The result is
/// in the Earth-fixed frame of the time of transmission;
/// [`geometric_range`](super::geometric_range) applies the Earth's rotation during the signal's
/// travel. The group delay (some 10 ns, 0.04 mm of orbit) is neglected in t.
pub fn state_at_transmission(
    ephemeris: &Ephemeris,
    tag: GpsTime,
    pseudorange_m: f64,
) -> SatelliteState {
    let sent = tag - pseudorange_m / SPEED_OF_LIGHT;
    let polynomial_s = match ephemeris {
        Ephemeris::Keplerian(e) => kepler::clock_polynomial(e, sent).bias_s,
        Ephemeris::Glonass(e) => glonass::clock(e, sent).bias_s,
    };
    let mut state = satellite_state(ephemeris, sent - polynomial_s);
    // Relativity (below 0.1 µs) is known only now; over that time the orbit is a straight line.
    let relativity_s = state.clock_m / SPEED_OF_LIGHT - polynomial_s;
    state.position.0 -= state.velocity_m_s * relativity_s;
    state
}

fn assemble(orbit: Orbit, clock: Clock, variance_m2: f64) -> SatelliteState {
    SatelliteState {
        position: Ecef(orbit.position_m),
        velocity_m_s: orbit.velocity_m_s,
        clock_m: clock.bias_s * SPEED_OF_LIGHT,
        clock_drift_m_s: clock.drift * SPEED_OF_LIGHT,
        variance_m2,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::models::sample;

    #[test]
    fn velocity_and_drift_are_the_derivatives() {
        for ephemeris in sample::all() {
            for minutes in [-25.0, 0.0, 10.5] {
                let time = sample::toe() + minutes * 60.0;
                let state = satellite_state(&ephemeris, time);
                let ahead = satellite_state(&ephemeris, time + 0.5);
                let behind = satellite_state(&ephemeris, time - 0.5);
                let velocity = ahead.position.0 - behind.position.0;
                let error = (velocity - state.velocity_m_s).norm();
                // The third derivative of the motion, v·ω²/24, is 3 µm/s; a GLONASS orbit is
                // integrated in another number of steps on the other side of a whole minute.
                assert!(error < 2e-4, "{}: {error} m/s", ephemeris.satellite());
                let drift = ahead.clock_m - behind.clock_m;
                assert!((drift - state.clock_drift_m_s).abs() < 1e-9);
            }
        }
    }

    /// The transmission time solves t + δtˢ(t) = tag − P/c.
    #[test]
    fn transmission_is_where_the_satellite_clock_says() {
        let tag = sample::toe() + 120.0;
        let pseudorange_m = 2.3e7;
        for ephemeris in sample::all() {
            let mut sent = tag;
            for _ in 0..5 {
                let clock_m = satellite_state(&ephemeris, sent).clock_m;
                sent = tag - (pseudorange_m + clock_m) / SPEED_OF_LIGHT;
            }
            let expected = satellite_state(&ephemeris, sent);
            let state = state_at_transmission(&ephemeris, tag, pseudorange_m);
            // Instants are whole nanoseconds: 4 µm of orbit.
            let error = state.position.distance_m(expected.position);
            assert!(error < 1e-5, "{}: {error} m", ephemeris.satellite());
            assert!((state.clock_m - expected.clock_m).abs() < 1e-8);
        }
    }

    /// The signal's travel time and the satellite's clock each change the satellite's position.
    #[test]
    fn flight_and_clock_matter() {
        let ephemeris = Ephemeris::Keplerian(sample::gps());
        let tag = sample::toe();
        let at_tag = satellite_state(&ephemeris, tag);
        let sent = state_at_transmission(&ephemeris, tag, 2.3e7);
        assert!(200.0 < at_tag.position.distance_m(sent.position));
        let without_clock = satellite_state(&ephemeris, tag - 2.3e7 / SPEED_OF_LIGHT);
        assert!(0.5 < without_clock.position.distance_m(sent.position));
        let mut circular = sample::gps();
        circular.eccentricity = 0.0;
        let relativity_m =
            at_tag.clock_m - satellite_state(&Ephemeris::Keplerian(circular), tag).clock_m;
        assert!(1.0 < relativity_m.abs());
    }
}
