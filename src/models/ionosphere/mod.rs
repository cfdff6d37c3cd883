//! Ionospheric delay.
//!
//! The first-order delay is inverse to the square of the frequency, I(f) = I(f_0)·(f_0/f)². Every
//! model here gives the delay of a pseudorange on the requested frequency; a carrier phase is
//! advanced by the same amount.

mod klobuchar;
#[cfg(feature = "nequick")]
mod nequick;

pub(crate) use klobuchar::beidou_klobuchar_delay_m;
pub use klobuchar::klobuchar_delay_m;
#[cfg(feature = "nequick")]
pub(crate) use nequick::{nequick_delay_m, nequick_variance_m2};

use super::LookAngles;
use crate::gnss::constants::GPS_L1_HZ;
use crate::gnss::{Constellation, Geodetic, GpsTime, Navigation};

/// Broadcast Klobuchar delay of a signal (m), or `None` without broadcast coefficients.
///
/// BeiDou satellites take the model of BeiDou if its coefficients are known; all others take that
/// of GPS.
pub(crate) fn broadcast_delay_m(
    navigation: &Navigation,
    constellation: Constellation,
    frequency_hz: f64,
    receiver: &Geodetic,
    look: &LookAngles,
    time: GpsTime,
) -> Option<f64> {
    match (constellation, &navigation.klobuchar_beidou, &navigation.klobuchar_gps) {
        (Constellation::BeiDou, Some(own), _) => {
            Some(beidou_klobuchar_delay_m(own, frequency_hz, receiver, look, time))
        }
        (_, _, Some(gps)) => Some(klobuchar_delay_m(gps, frequency_hz, receiver, look, time)),
        _ => None,
    }
}

/// Variance of a Klobuchar delay (m²): half the delay as its standard deviation.
///
/// Klobuchar (1987), *Ionospheric time-delay algorithm for single-frequency GPS users*: the model
/// removes about half of the delay's rms.
pub(crate) fn klobuchar_variance_m2(delay_m: f64) -> f64 {
    0.25 * delay_m * delay_m
}

/// Variance of the delay without an ionosphere model (m²): 5 m on L1, scaled by frequency.
///
/// RTKLIB manual 2.4.2, constant `ERR_ION`.
pub(crate) fn unmodelled_variance_m2(frequency_hz: f64) -> f64 {
    let scale = (GPS_L1_HZ / frequency_hz).powi(2);
    25.0 * scale * scale
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gnss::KlobucharCoefficients;

    #[test]
    fn each_system_has_its_coefficients() {
        let gps =
            KlobucharCoefficients { alpha: [2e-8, 0.0, 0.0, 0.0], beta: [9e4, 0.0, 0.0, 0.0] };
        let beidou = KlobucharCoefficients { alpha: [4e-8, 0.0, 0.0, 0.0], ..gps };
        let receiver = Geodetic::from_degrees(22.3, 114.2, 0.0);
        let look = LookAngles { azimuth_rad: 3.0, elevation_rad: 0.7 };
        let time = GpsTime::from_week_seconds(2244, 27_000.0);
        let delay = |navigation: &Navigation, constellation| {
            broadcast_delay_m(navigation, constellation, GPS_L1_HZ, &receiver, &look, time)
        };
        let mut navigation = Navigation::default();
        assert_eq!(delay(&navigation, Constellation::Gps), None);
        navigation.klobuchar_gps = Some(gps);
        let of_gps = klobuchar_delay_m(&gps, GPS_L1_HZ, &receiver, &look, time);
        for constellation in Constellation::ALL {
            assert_eq!(delay(&navigation, constellation), Some(of_gps));
        }
        navigation.klobuchar_beidou = Some(beidou);
        let own = beidou_klobuchar_delay_m(&beidou, GPS_L1_HZ, &receiver, &look, time);
        assert_eq!(delay(&navigation, Constellation::BeiDou), Some(own));
        assert_eq!(delay(&navigation, Constellation::Galileo), Some(of_gps));
        assert!(1.5 < own / of_gps);
    }

    #[test]
    fn variances_worked_by_hand() {
        assert_eq!(klobuchar_variance_m2(6.0), 9.0);
        assert!((unmodelled_variance_m2(GPS_L1_HZ / 2.0) - 400.0).abs() < 1e-9);
    }
}
