//! Steps of the satellites' ranges between two ephemerides.
//!
//! Consecutive ephemerides of a satellite differ by decimetres in orbit and clock. The difference
//! of two carrier phases must not contain this step: it would count as a displacement.

use crate::gnss::{Ecef, EphemerisIssue, GpsTime, Navigation, SatelliteId};
use crate::models::state_at_transmission;

use super::{Measurement, Measurements};

impl Measurements {
    /// Sets the step of each phase whose ephemeris is another one than at the previous epoch.
    ///
    /// `before` gives the ephemeris of a satellite's phase at that epoch, if there was one. If it
    /// is no longer in `navigation`, the step is unknown, and the phase counts as lost.
    pub(in crate::positioning) fn follow_ephemerides(
        &mut self,
        before: impl Fn(SatelliteId) -> Option<EphemerisIssue>,
        receiver: Ecef,
        tag: GpsTime,
        navigation: &Navigation,
    ) {
        for measurement in &mut self.list {
            let before = before(measurement.satellite);
            let Some(before) = before.filter(|before| *before != measurement.ephemeris) else {
                continue;
            };
            let step_m = step_m(measurement, before, receiver, tag, navigation);
            if let Some(phase) = &mut measurement.phase {
                match step_m {
                    Some(step_m) => phase.ephemeris_step_m = step_m,
                    None => phase.loss_of_lock = true,
                }
            }
        }
    }
}

/// What the change from `before` to the measurement's ephemeris adds to the range of the orbit and
/// takes from the phase without satellite clock (m): u·(p − p′) − c·(δt − δt′), with those of
/// `before` primed and u the direction from the receiver to the satellite.
fn step_m(
    measurement: &Measurement,
    before: EphemerisIssue,
    receiver: Ecef,
    tag: GpsTime,
    navigation: &Navigation,
) -> Option<f64> {
    let mut known = navigation.of(measurement.satellite).iter();
    let before = known.find(|e| (e.toe(), e.issue()) == (before.toe, before.issue))?;
    let now = &measurement.state;
    let pseudorange_m = measurement.pseudorange_m - now.clock_m;
    let before = state_at_transmission(before, tag, pseudorange_m);
    let direction = (now.position.0 - receiver.0).normalize();
    let moved_m = direction.dot(&(now.position.0 - before.position.0));
    Some(moved_m - (now.clock_m - before.clock_m))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{Mode, PositioningOptions, Profile};
    use crate::gnss::{Constellation, Ephemeris, Epoch};
    use crate::models::geometric_range;
    use crate::positioning::measurements::ReceiverBands;
    use crate::simulation::{Scenario, Simulator};

    /// The phases of an epoch after a second ephemeris of each satellite, 1 ns and a few decimetres
    /// off, is known: satellite, ρ − phase, and step (m), or `None` if the phase is lost. Without
    /// `is_forgotten`, the first ephemerides are still known.
    fn phases(is_changed: bool, is_forgotten: bool) -> Vec<(SatelliteId, Option<(f64, f64)>)> {
        let constellations = vec![Constellation::Gps, Constellation::Galileo];
        let mut simulator = Simulator::new(Scenario { constellations, ..Scenario::open_sky() }, 1);
        let truth = simulator.nth(5).unwrap();
        let (epoch, receiver): (Epoch, Ecef) = (truth.rover, truth.position);
        let first = Navigation::clone(simulator.navigation());
        let options = PositioningOptions::new(Mode::Fgo, Profile::General);
        let gather = |navigation: &Navigation| {
            let mut measurements = Measurements::default();
            measurements.gather(&epoch, navigation, &options, ReceiverBands::AGREEING);
            measurements
        };
        let mut second = if is_forgotten { Navigation::default() } else { first.clone() };
        for (_, list) in first.satellites().filter(|_| is_changed) {
            second.insert_all(list.iter().map(|ephemeris| match ephemeris {
                Ephemeris::Keplerian(e) => {
                    let mut e = e.clone();
                    (e.iode, e.iodc) = (e.iode + 1, e.iodc + 1);
                    (e.af0_s, e.m0_rad, e.crc_m) = (e.af0_s + 1e-9, e.m0_rad + 1e-8, e.crc_m + 0.5);
                    Ephemeris::Keplerian(e)
                }
                Ephemeris::Glonass(e) => Ephemeris::Glonass(e.clone()),
            }));
        }
        let before = gather(&first).list;
        let before = |satellite| Some(before.iter().find(|m| m.satellite == satellite)?.ephemeris);
        let mut measurements = gather(&second);
        measurements.follow_ephemerides(before, receiver, epoch.time, &second);
        let of = |m: &Measurement| {
            let phase = m.phase.filter(|phase| !phase.loss_of_lock)?;
            let residual_m = geometric_range(m.state.position, receiver).0 - phase.range_m;
            Some((residual_m, phase.ephemeris_step_m))
        };
        measurements.list.iter().map(|m| (m.satellite, of(m))).collect()
    }

    /// Range minus phase less its step does not depend on the ephemeris. The steps are beyond the
    /// clock's 0.3 m for some satellites.
    #[test]
    fn a_step_is_what_range_and_clock_change_by() {
        let (old, new) = (phases(false, false), phases(true, false));
        assert!(5 < old.len());
        let mut largest_m = 0.0_f64;
        for ((satellite, old), (_, new)) in old.into_iter().zip(new) {
            let ((old_m, none_m), (new_m, step_m)) = (old.unwrap(), new.unwrap());
            assert_eq!(none_m, 0.0);
            assert!((new_m - step_m - old_m).abs() < 1e-4, "{satellite} {new_m} {step_m} {old_m}");
            largest_m = largest_m.max(step_m.abs());
        }
        assert!(0.4 < largest_m && largest_m < 2.0, "{largest_m}");
    }

    /// A service keeps ephemerides for a limited time.
    #[test]
    fn a_step_from_a_forgotten_ephemeris_is_a_loss_of_lock() {
        let lost = phases(true, true);
        assert!(5 < lost.len() && lost.iter().all(|(_, phase)| phase.is_none()));
    }
}
