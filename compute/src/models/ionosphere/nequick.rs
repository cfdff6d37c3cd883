//! The ionosphere of NeQuick-G: a three-dimensional electron density integrated along the ray.
//!
//! Model and tables are those of the `sidereon-core` library; this file converts to its degrees,
//! hours and months. Source: European GNSS (Galileo) Open Service (2016), *Ionospheric Correction
//! Algorithm for Galileo Single Frequency Users*, issue 1.2.

use sidereon_core::atmosphere::{GalileoNequickCoeffs, NequickGRayEval, nequick_g_delay_m};

use crate::gnss::constants::SECONDS_PER_HOUR;
use crate::gnss::{Ecef, Geodetic, GpsTime, LeapSeconds, NeQuickCoefficients, TimeScale};

/// Delay of a pseudorange on `frequency_hz` between `receiver` and `satellite` at `time` (m).
///
/// `None` where the model has no value: the ray meets the Earth, or a coordinate is not finite.
pub(crate) fn nequick_delay_m(
    coefficients: &NeQuickCoefficients,
    frequency_hz: f64,
    receiver: &Geodetic,
    satellite: Ecef,
    time: GpsTime,
    leap_seconds: &LeapSeconds,
) -> Option<f64> {
    let [ai0, ai1, ai2] = coefficients.ai;
    let utc = time.to_civil(TimeScale::Utc, leap_seconds);
    let seconds = f64::from(utc.second.min(59)) + f64::from(utc.nanosecond) * 1e-9;
    let above = satellite.to_geodetic();
    let ray = NequickGRayEval {
        month: utc.month,
        utc_hours: f64::from(utc.hour) + f64::from(utc.minute) / 60.0 + seconds / SECONDS_PER_HOUR,
        station_lon_deg: receiver.longitude_rad.to_degrees(),
        station_lat_deg: receiver.latitude_rad.to_degrees(),
        station_height_m: receiver.height_m,
        satellite_lon_deg: above.longitude_rad.to_degrees(),
        satellite_lat_deg: above.latitude_rad.to_degrees(),
        satellite_height_m: above.height_m,
    };
    nequick_g_delay_m(&GalileoNequickCoeffs { ai0, ai1, ai2 }, &ray, frequency_hz).ok()
}

/// Variance of a NeQuick-G delay (m²): 30 % of the delay as its standard deviation.
///
/// This 30 % is an assumption, not a published figure: less than Klobuchar's half, since the model
/// describes the ionosphere in three dimensions.
pub(crate) fn nequick_variance_m2(delay_m: f64) -> f64 {
    0.09 * delay_m * delay_m
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gnss::CivilTime;

    fn delay_tecu(ai: [f64; 3], hour: u8, receiver: Geodetic, satellite: Geodetic) -> f64 {
        let civil =
            CivilTime { year: 2015, month: 4, day: 15, hour, minute: 0, second: 0, nanosecond: 0 };
        let leap = LeapSeconds::table();
        let time = GpsTime::from_civil(&civil, TimeScale::Utc, &leap).unwrap();
        let frequency_hz = 1_575.42e6;
        let coefficients = NeQuickCoefficients { ai };
        let delay_m = nequick_delay_m(
            &coefficients,
            frequency_hz,
            &receiver,
            satellite.to_ecef(),
            time,
            &leap,
        );
        delay_m.unwrap() * frequency_hz * frequency_hz / 40.3e16
    }

    /// A ray of the verification data for high solar activity, as the library's own tests quote it:
    /// 00 h UT, receiver at 82.49° N 297.66° E, satellite at 54.29° N 8.23° E, 20.28 Mm:
    /// 20.40 TECU.
    #[test]
    fn a_ray_of_the_verification_data() {
        let tecu = delay_tecu(
            [236.831641, -0.39362878, 0.00402826613],
            0,
            Geodetic::from_degrees(82.49, 297.66, 78.11),
            Geodetic::from_degrees(54.29, 8.23, 20_281_546.18),
        );
        assert!((tecu - 20.40).abs() < 0.01, "{tecu}");
    }

    #[test]
    fn more_ionisation_delays_more() {
        let receiver = Geodetic::from_degrees(22.3, 114.2, 5.0);
        let satellite = Geodetic::from_degrees(25.0, 120.0, 2.02e7);
        let quiet = delay_tecu([60.0, 0.0, 0.0], 6, receiver, satellite);
        let active = delay_tecu([180.0, 0.0, 0.0], 6, receiver, satellite);
        assert!(2.0 < quiet && 1.3 * quiet < active, "{quiet} {active}");
    }
}
