//! The Klobuchar model, as GPS and as BeiDou define it.

use std::f64::consts::{PI, TAU};

use crate::gnss::constants::{GPS_L1_HZ, SECONDS_PER_DAY, SPEED_OF_LIGHT};
use crate::gnss::{Geodetic, GpsTime, KlobucharCoefficients};
use crate::models::LookAngles;

/// Local time of the greatest delay: 14 h (s).
const PEAK_S: f64 = 50_400.0;
/// Delay at night (s).
const NIGHT_S: f64 = 5e-9;
/// BeiDou B1I (Hz).
const B1I_HZ: f64 = 1_561.098e6;

/// Klobuchar delay with GPS coefficients (m) at `frequency_hz`; IS-GPS-200N, 20.3.3.5.2.5.
pub fn klobuchar_delay_m(
    coefficients: &KlobucharCoefficients,
    frequency_hz: f64,
    receiver: &Geodetic,
    look: &LookAngles,
    time: GpsTime,
) -> f64 {
    // From here on angles are in semicircles, as in the document.
    let elevation = look.elevation_rad / PI;
    let (azimuth_sin, azimuth_cos) = look.azimuth_rad.sin_cos();
    let earth_angle = 0.0137 / (elevation + 0.11) - 0.022;
    let latitude = (receiver.latitude_rad / PI + earth_angle * azimuth_cos).clamp(-0.416, 0.416);
    let longitude = receiver.longitude_rad / PI + earth_angle * azimuth_sin / (latitude * PI).cos();
    let geomagnetic = latitude + 0.064 * ((longitude - 1.617) * PI).cos();
    let local_s = 0.5 * SECONDS_PER_DAY * longitude + time.seconds_of_week();
    let obliquity = 1.0 + 16.0 * (0.53 - elevation).powi(3);

    let amplitude_s = cubic(&coefficients.alpha, geomagnetic).max(0.0);
    let period_s = cubic(&coefficients.beta, geomagnetic).max(72_000.0);
    let x = TAU * (local_s.rem_euclid(SECONDS_PER_DAY) - PEAK_S) / period_s;
    let vertical_s = if x.abs() < 1.57 {
        let x2 = x * x;
        NIGHT_S + amplitude_s * (1.0 - x2 / 2.0 + x2 * x2 / 24.0)
    } else {
        NIGHT_S
    };
    SPEED_OF_LIGHT * obliquity * vertical_s * (GPS_L1_HZ / frequency_hz).powi(2)
}

/// Earth's radius and height of the ionosphere's shell (km); BDS-SIS-ICD-B1I-3.0, 5.2.4.7.
const BEIDOU_EARTH_KM: f64 = 6_378.0;
const BEIDOU_SHELL_KM: f64 = 375.0;

/// Klobuchar delay with BeiDou coefficients (m) at `frequency_hz`; BDS-SIS-ICD-B1I-3.0, 5.2.4.7.
///
/// Unlike GPS's: the pierce point by spherical trigonometry in geographic latitude, a shell at
/// 375 km, an exact cosine, a bounded period, delays on B1I, and BeiDou time.
pub(crate) fn beidou_klobuchar_delay_m(
    coefficients: &KlobucharCoefficients,
    frequency_hz: f64,
    receiver: &Geodetic,
    look: &LookAngles,
    time: GpsTime,
) -> f64 {
    let (azimuth_sin, azimuth_cos) = look.azimuth_rad.sin_cos();
    let (latitude_sin, latitude_cos) = receiver.latitude_rad.sin_cos();
    let squeeze = BEIDOU_EARTH_KM / (BEIDOU_EARTH_KM + BEIDOU_SHELL_KM) * look.elevation_rad.cos();
    let earth_angle = 0.5 * PI - look.elevation_rad - squeeze.asin();
    let (angle_sin, angle_cos) = earth_angle.sin_cos();
    let pierce_sin = latitude_sin * angle_cos + latitude_cos * angle_sin * azimuth_cos;
    let pierce_cos = (1.0 - pierce_sin * pierce_sin).max(0.0).sqrt();
    let pierce_longitude = receiver.longitude_rad
        + (angle_sin * azimuth_sin / pierce_cos.max(1e-12)).clamp(-1.0, 1.0).asin();

    let semicircles = (pierce_sin.asin() / PI).abs();
    let amplitude_s = cubic(&coefficients.alpha, semicircles).max(0.0);
    let period_s = cubic(&coefficients.beta, semicircles).clamp(72_000.0, 172_800.0);
    let local_s = time.to_beidou().1 + pierce_longitude * 0.5 * SECONDS_PER_DAY / PI;
    let from_peak = local_s.rem_euclid(SECONDS_PER_DAY) - PEAK_S;
    let vertical_s = if from_peak.abs() < 0.25 * period_s {
        NIGHT_S + amplitude_s * (TAU * from_peak / period_s).cos()
    } else {
        NIGHT_S
    };
    let slant = 1.0 / (1.0 - squeeze * squeeze).sqrt();
    SPEED_OF_LIGHT * slant * vertical_s * (B1I_HZ / frequency_hz).powi(2)
}

fn cubic(coefficients: &[f64; 4], x: f64) -> f64 {
    let [c0, c1, c2, c3] = *coefficients;
    c0 + x * (c1 + x * (c2 + x * c3))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Invented, of the usual magnitudes.
    const COEFFICIENTS: KlobucharCoefficients =
        KlobucharCoefficients { alpha: [2e-8, 1e-8, -6e-8, -1e-7], beta: [9e4, 5e4, -2e5, -1e5] };

    fn look(azimuth: f64, elevation: f64) -> LookAngles {
        LookAngles { azimuth_rad: azimuth.to_radians(), elevation_rad: elevation.to_radians() }
    }

    fn near(value: f64, expected: f64) {
        assert!((value - expected).abs() < 1e-9, "{value}, not {expected}");
    }

    /// Expected values: the formulas of both documents computed in Python, term by term as printed.
    #[test]
    fn delays_worked_apart() {
        let hong_kong = Geodetic::from_degrees(22.3, 114.2, 0.0);
        let sky = look(210.0, 40.0);
        let at = |seconds| GpsTime::from_week_seconds(2244, seconds);
        let gps = |time| klobuchar_delay_m(&COEFFICIENTS, GPS_L1_HZ, &hong_kong, &sky, time);
        near(gps(at(27_000.0)), 10.863_182_210_415_653);
        near(gps(at(200_000.0)), 10.832_804_819_501_68);
        let sydney = Geodetic::from_degrees(-33.0, 151.0, 0.0);
        let low =
            klobuchar_delay_m(&COEFFICIENTS, GPS_L1_HZ, &sydney, &look(10.0, 15.0), at(10_000.0));
        near(low, 15.230_522_525_681_154);
        let beidou = |time| beidou_klobuchar_delay_m(&COEFFICIENTS, B1I_HZ, &hong_kong, &sky, time);
        near(beidou(at(27_000.0)), 10.722_786_055_827_108);
        near(beidou(at(200_000.0)), 10.693_873_388_105_029);
    }

    /// At night 5 ns remain; towards the zenith the obliquity of GPS's model is 1.0004.
    #[test]
    fn nights_leave_five_nanoseconds() {
        let place = Geodetic::from_degrees(0.0, 0.0, 0.0);
        let midnight = GpsTime::from_week_seconds(2244, 0.0);
        let zenith = look(0.0, 90.0);
        let delay = klobuchar_delay_m(&COEFFICIENTS, GPS_L1_HZ, &place, &zenith, midnight);
        near(delay, SPEED_OF_LIGHT * 5e-9 * (1.0 + 16.0 * 0.03_f64.powi(3)));
        let delay = beidou_klobuchar_delay_m(&COEFFICIENTS, B1I_HZ, &place, &zenith, midnight);
        near(delay, SPEED_OF_LIGHT * 5e-9);
    }

    /// L2 sees (77/60)² of L1's delay; B3I (1561.098/1268.52)² of B1I's.
    #[test]
    fn delays_fall_with_the_square_of_frequency() {
        let place = Geodetic::from_degrees(22.3, 114.2, 0.0);
        let time = GpsTime::from_week_seconds(2244, 27_000.0);
        let sky = look(210.0, 40.0);
        let gps = |hz| klobuchar_delay_m(&COEFFICIENTS, hz, &place, &sky, time);
        near(gps(1_227.6e6) / gps(GPS_L1_HZ), (77.0_f64 / 60.0).powi(2));
        let beidou = |hz| beidou_klobuchar_delay_m(&COEFFICIENTS, hz, &place, &sky, time);
        near(beidou(1_268.52e6) / beidou(B1I_HZ), (1_561.098_f64 / 1_268.52).powi(2));
    }
}
