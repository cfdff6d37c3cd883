//! Phase-centre corrections of antennas.
//!
//! A phase (in metres) is the range from the mean phase centre plus the variation in its direction
//! (ANTEX 1.4, section 3). Seen from the antenna reference point, with e the unit vector towards
//! the satellite in north, east and up, o the phase-centre offset and z = 90° − elevation:
//!
//! λφ − ρ_ARP = −eᵀo + v(azimuth, z).
//!
//! Broadcast ephemerides describe the satellites' phase centres, so satellite antennas need no
//! correction.

use std::f64::consts::{FRAC_PI_2, TAU};

use nalgebra::Vector3;

use super::LookAngles;
use crate::gnss::{AntennaCalibration, ObservationCode, PhaseCentrePattern, Signal};

/// Largest difference to a calibrated frequency that is used for a missing one (Hz): B1I and G1
/// take the calibration of GPS L1, E5b that of L2. L5 has no such neighbour.
const NEAREST_HZ: f64 = 40e6;

/// Phase-centre correction of a range from the antenna reference point (m).
///
/// Directions below the lowest elevation of the grid take its value.
pub(crate) fn phase_centre_correction_m(pattern: &PhaseCentrePattern, look: &LookAngles) -> f64 {
    let (sin_azimuth, cos_azimuth) = look.azimuth_rad.sin_cos();
    let (sin, cos) = look.elevation_rad.sin_cos();
    let direction = Vector3::new(cos * cos_azimuth, cos * sin_azimuth, sin);
    variation_m(pattern, look.azimuth_rad, FRAC_PI_2 - look.elevation_rad)
        - direction.dot(&pattern.offset_m)
}

/// Phase-centre variation in a direction (m), linear between grid points in zenith angle and
/// azimuth.
fn variation_m(pattern: &PhaseCentrePattern, azimuth_rad: f64, zenith_rad: f64) -> f64 {
    let along = |row: &[f64]| {
        interpolated(row, (zenith_rad - pattern.first_zenith_rad) / pattern.zenith_step_rad)
    };
    let Some(steps) = pattern.azimuth_variations_m.len().checked_sub(1).filter(|n| 0 < *n) else {
        return along(&pattern.variations_m);
    };
    let position = azimuth_rad.rem_euclid(TAU) / TAU * steps as f64;
    let before = (position.floor() as usize).min(steps - 1);
    let share = position - before as f64;
    let rows = &pattern.azimuth_variations_m;
    (1.0 - share) * along(&rows[before]) + share * along(&rows[before + 1])
}

/// Linear interpolation of a row at a fractional index, constant beyond its ends.
fn interpolated(row: &[f64], position: f64) -> f64 {
    let Some(last) = row.len().checked_sub(1) else { return 0.0 };
    let position = position.clamp(0.0, last as f64);
    let before = (position.floor() as usize).min(last.saturating_sub(1));
    let after = (before + 1).min(last);
    let share = position - before as f64;
    (1.0 - share) * row[before] + share * row[after]
}

/// The pattern of a signal's frequency, or the nearest one within 40 MHz.
pub(crate) fn pattern_of(
    antenna: &AntennaCalibration,
    signal: Signal,
    frequency_hz: f64,
) -> Option<&PhaseCentrePattern> {
    let digit = signal.code.band_digit();
    let own = antenna.patterns.iter().find(|pattern| {
        pattern.constellation == signal.constellation && pattern.band_digit == digit
    });
    own.or_else(|| {
        let distance = |pattern: &PhaseCentrePattern| {
            Some((pattern_frequency_hz(pattern)? - frequency_hz).abs())
        };
        let near = antenna.patterns.iter().filter_map(|p| Some((distance(p)?, p)));
        near.filter(|(distance_hz, _)| *distance_hz <= NEAREST_HZ)
            .min_by(|a, b| a.0.total_cmp(&b.0))
            .map(|(_, pattern)| pattern)
    })
}

/// Carrier frequency of a pattern (Hz); for GLONASS that of channel 0.
fn pattern_frequency_hz(pattern: &PhaseCentrePattern) -> Option<f64> {
    let code = ObservationCode::new(b'0' + pattern.band_digit, b'C')?;
    Signal { constellation: pattern.constellation, code }.frequency_hz(Some(0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gnss::Constellation;

    /// Offset 10 cm up and 1 cm north; variation of 1 mm per 10° from the zenith, which depends on
    /// the azimuth if `with_azimuth`.
    fn pattern(with_azimuth: bool) -> PhaseCentrePattern {
        let row = |scale: f64| (0..=9).map(|step| scale * f64::from(step) * 1e-3).collect();
        let turned = (0..=4).map(|quarter| row(if quarter == 1 { 2.0 } else { 1.0 })).collect();
        PhaseCentrePattern {
            constellation: Constellation::Gps,
            band_digit: 1,
            offset_m: Vector3::new(0.01, 0.0, 0.1),
            first_zenith_rad: 0.0,
            zenith_step_rad: 10_f64.to_radians(),
            variations_m: row(1.0),
            azimuth_variations_m: if with_azimuth { turned } else { Vec::new() },
        }
    }

    fn at(with_azimuth: bool, azimuth_deg: f64, elevation_deg: f64) -> f64 {
        let (azimuth_rad, elevation_rad) = (azimuth_deg.to_radians(), elevation_deg.to_radians());
        phase_centre_correction_m(
            &pattern(with_azimuth),
            &LookAngles { azimuth_rad, elevation_rad },
        )
    }

    /// In the zenith the phase centre is 10 cm nearer. At 30° in the north it is
    /// 0.5·10 + 0.866·1 cm nearer, and the variation is 6 mm; in the south 0.5·10 − 0.866·1 cm.
    #[test]
    fn offsets_shorten_and_variations_lengthen() {
        assert!((at(false, 0.0, 90.0) + 0.1).abs() < 1e-12);
        let half = 3_f64.sqrt() / 2.0;
        assert!((at(false, 0.0, 30.0) - (0.006 - 0.05 - 0.01 * half)).abs() < 1e-12);
        assert!((at(false, 180.0, 30.0) - (0.006 - 0.05 + 0.01 * half)).abs() < 1e-12);
        // Halfway between grid points; below the horizon the last value.
        assert!(
            (at(false, 90.0, 55.0) - (0.003_5 - 0.1 * 55_f64.to_radians().sin())).abs() < 1e-12
        );
        let below = at(false, 90.0, -10.0) - 0.1 * 10_f64.to_radians().sin();
        assert!((below - 0.009).abs() < 1e-12);
    }

    /// Twice the variation in the east (90°), one and a half times at 45° and 135°, once at 300°.
    #[test]
    fn azimuth_turns_the_variation() {
        let variation =
            |azimuth_deg: f64| at(true, azimuth_deg, 30.0) - at(false, azimuth_deg, 30.0);
        for (azimuth_deg, extra_m) in [(90.0, 0.006), (45.0, 0.003), (135.0, 0.003), (300.0, 0.0)] {
            assert!((variation(azimuth_deg) - extra_m).abs() < 1e-12, "{azimuth_deg}");
        }
        assert!((variation(360.0) - variation(0.0)).abs() < 1e-12);
    }

    #[test]
    fn the_nearest_calibrated_frequency_serves() {
        let second = PhaseCentrePattern { band_digit: 2, ..pattern(false) };
        let antenna = AntennaCalibration {
            antenna: "A".to_owned(),
            radome: "NONE".to_owned(),
            serial: String::new(),
            patterns: vec![pattern(false), second],
        };
        let digit = |constellation, code: &str, channel| {
            let signal = Signal { constellation, code: ObservationCode::parse(code).unwrap() };
            let frequency_hz = signal.frequency_hz(channel).unwrap();
            pattern_of(&antenna, signal, frequency_hz).map(|pattern| pattern.band_digit)
        };
        assert_eq!(digit(Constellation::Gps, "2W", None), Some(2));
        assert_eq!(digit(Constellation::BeiDou, "2I", None), Some(1));
        assert_eq!(digit(Constellation::Glonass, "1C", Some(5)), Some(1));
        assert_eq!(digit(Constellation::Galileo, "7Q", None), Some(2));
        assert_eq!(digit(Constellation::Galileo, "5Q", None), None);
    }
}
