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
use crate::gnss::{Constellation, Geodetic, GpsTime, KlobucharCoefficients, Navigation};

/// Coefficients that GPS broadcast on 1 January 2004, halfway between solar maximum and minimum;
/// `ionmodel` of RTKLIB 2.4 has the same, for the same purpose.
const TYPICAL: KlobucharCoefficients = KlobucharCoefficients {
    alpha: [0.1118e-7, -0.7451e-8, -0.5961e-7, 0.1192e-6],
    beta: [0.1167e6, -0.2294e6, -0.1311e6, 0.1049e7],
};

/// Broadcast Klobuchar delay of a signal (m), or `None` without broadcast coefficients.
///
/// BeiDou satellites take the model of BeiDou if its coefficients are known; all others take that
/// of GPS, or of QZSS or BeiDou if only these are known.
pub(crate) fn broadcast_delay_m(
    navigation: &Navigation,
    constellation: Constellation,
    frequency_hz: f64,
    receiver: &Geodetic,
    look: &LookAngles,
    time: GpsTime,
) -> Option<f64> {
    let of_gps = navigation.klobuchar_gps.as_ref().or(navigation.klobuchar_qzss.as_ref());
    let of_beidou = navigation.klobuchar_beidou.as_ref();
    match (of_beidou, of_gps) {
        (Some(own), of_gps) if constellation == Constellation::BeiDou || of_gps.is_none() => {
            Some(beidou_klobuchar_delay_m(own, frequency_hz, receiver, look, time))
        }
        (_, of_gps) => of_gps.map(|gps| klobuchar_delay_m(gps, frequency_hz, receiver, look, time)),
    }
}

/// Klobuchar delay of a day of medium solar activity (m).
pub(crate) fn typical_delay_m(
    frequency_hz: f64,
    receiver: &Geodetic,
    look: &LookAngles,
    time: GpsTime,
) -> f64 {
    klobuchar_delay_m(&TYPICAL, frequency_hz, receiver, look, time)
}

/// Variance of the typical delay (m²): the whole delay as its standard deviation, twice that of
/// coefficients of the day. The delay varies by a factor of three or more over a solar cycle.
pub(crate) fn typical_variance_m2(delay_m: f64) -> f64 {
    delay_m * delay_m
}

/// Variance of a Klobuchar delay (m²): half the delay as its standard deviation.
///
/// Klobuchar (1987), *Ionospheric time-delay algorithm for single-frequency GPS users*: the model
/// removes about half of the delay's rms.
pub(crate) fn klobuchar_variance_m2(delay_m: f64) -> f64 {
    0.25 * delay_m * delay_m
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gnss::constants::GPS_L1_HZ;

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
        navigation.klobuchar_beidou = Some(beidou);
        let own = beidou_klobuchar_delay_m(&beidou, GPS_L1_HZ, &receiver, &look, time);
        assert_eq!(delay(&navigation, Constellation::Gps), Some(own));
        navigation.klobuchar_beidou = None;
        navigation.klobuchar_qzss = Some(gps);
        let of_gps = klobuchar_delay_m(&gps, GPS_L1_HZ, &receiver, &look, time);
        for constellation in Constellation::ALL {
            assert_eq!(delay(&navigation, constellation), Some(of_gps));
        }
        navigation.klobuchar_gps = Some(gps);
        navigation.klobuchar_beidou = Some(beidou);
        assert_eq!(delay(&navigation, Constellation::BeiDou), Some(own));
        assert_eq!(delay(&navigation, Constellation::Galileo), Some(of_gps));
        assert!(1.5 < own / of_gps);
    }

    #[test]
    fn variances_worked_by_hand() {
        assert_eq!(klobuchar_variance_m2(6.0), 9.0);
        assert_eq!(typical_variance_m2(6.0), 36.0);
    }
}
