//! Antennas and their phase centres.
//!
//! The *antenna reference point* (ARP) is a point of the antenna's body, usually the bottom of its
//! mount. A *marker* is a point in the ground below the antenna. The mean phase centre has an
//! offset (PCO) from the ARP. The phase exceeds the range to the mean phase centre by a variation
//! (PCV) that depends on the direction. Both depend on the frequency.

use nalgebra::Vector3;

use super::Constellation;

/// Phase centre of an antenna on one frequency.
#[derive(Clone, Debug, PartialEq)]
pub struct PhaseCentrePattern {
    /// Constellation whose frequency this is.
    pub constellation: Constellation,
    /// Band: the first digit of RINEX 3 observation codes.
    pub band_digit: u8,
    /// Mean phase centre (m). Of a receiver antenna: from the ARP towards north, east and up. Of a
    /// satellite: from the centre of mass along the body axes x, y and z.
    pub offset_m: Vector3<f64>,
    /// First zenith angle of the grid (rad); of a satellite the nadir angle.
    pub first_zenith_rad: f64,
    /// Step between zenith angles (rad).
    pub zenith_step_rad: f64,
    /// Variations by zenith angle, averaged over azimuth (m).
    pub variations_m: Vec<f64>,
    /// Variations by azimuth, then by zenith angle (m). Azimuths are clockwise from north in equal
    /// steps from 0 to 360°, both included; empty where only the mean over azimuth is known.
    pub azimuth_variations_m: Vec<Vec<f64>>,
}

/// The calibration of a receiver antenna.
#[derive(Clone, Debug, PartialEq)]
pub struct AntennaCalibration {
    /// Antenna type in the IGS's notation, such as `TRM59800.00`.
    pub antenna: String,
    /// Radome code, `NONE` without a radome.
    pub radome: String,
    /// Serial number of the calibrated antenna; empty for the mean of its type.
    pub serial: String,
    /// One pattern for each frequency.
    pub patterns: Vec<PhaseCentrePattern>,
}

/// A catalogue of calibrated receiver antennas.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct AntennaCatalogue {
    /// The calibrations.
    pub receivers: Vec<AntennaCalibration>,
}

impl AntennaCatalogue {
    /// The calibration of a receiver antenna, named as in RINEX headers: type and radome in 16 and
    /// 4 columns, or separated by blanks; without a radome code it is `NONE`. The calibration of
    /// the serial number comes before that of the type. `None` unless type and radome are both
    /// found: another radome moves the phase centre by millimetres.
    pub fn receiver(&self, name: &str, serial: &str) -> Option<&AntennaCalibration> {
        let (antenna, radome) = split_antenna_name(name);
        let mut same = self.receivers.iter().filter(|one| {
            one.antenna.eq_ignore_ascii_case(antenna) && one.radome.eq_ignore_ascii_case(radome)
        });
        let own = same.clone().find(|one| !serial.is_empty() && one.serial == serial);
        own.or_else(|| same.find(|one| one.serial.is_empty()))
    }
}

/// Antenna type and radome code of a name of 20 columns.
pub(crate) fn split_antenna_name(name: &str) -> (&str, &str) {
    const TYPE_COLUMNS: usize = 16;
    let in_columns = name.split_at_checked(TYPE_COLUMNS);
    let (antenna, radome) = match in_columns {
        // A type of 16 columns without a blank touches the radome only if the columns are not kept.
        Some((antenna, radome)) if !radome.trim().contains(' ') => (antenna.trim(), radome.trim()),
        _ => (name.trim(), ""),
    };
    let (antenna, radome) = match antenna.split_once(' ') {
        Some((antenna, rest)) if radome.is_empty() => (antenna, rest.trim()),
        _ => (antenna, radome),
    };
    (antenna, if radome.is_empty() { "NONE" } else { radome })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn calibration(antenna: &str, radome: &str, serial: &str) -> AntennaCalibration {
        AntennaCalibration {
            antenna: antenna.to_owned(),
            radome: radome.to_owned(),
            serial: serial.to_owned(),
            patterns: Vec::new(),
        }
    }

    #[test]
    fn names_of_headers() {
        for (name, parts) in [
            ("TRM59800.00     SCIS", ("TRM59800.00", "SCIS")),
            ("TRM57971.00     NONE", ("TRM57971.00", "NONE")),
            ("TRM55971.00", ("TRM55971.00", "NONE")),
            ("LEIAR25.R3 LEIT", ("LEIAR25.R3", "LEIT")),
            ("ASH701945C_M    SNOW", ("ASH701945C_M", "SNOW")),
            ("", ("", "NONE")),
        ] {
            assert_eq!(split_antenna_name(name), parts, "{name:?}");
        }
    }

    #[test]
    fn its_own_calibration_comes_first_and_another_radome_never() {
        let receivers = vec![
            calibration("TRM59800.00", "SCIS", ""),
            calibration("TRM59800.00", "SCIS", "1234"),
            calibration("TRM59800.00", "NONE", ""),
        ];
        let catalogue = AntennaCatalogue { receivers };
        let serial = |name: &str, serial: &str| {
            catalogue.receiver(name, serial).map(|one| (one.radome.clone(), one.serial.clone()))
        };
        let found = |radome: &str, serial: &str| Some((radome.to_owned(), serial.to_owned()));
        assert_eq!(serial("TRM59800.00     SCIS", "1234"), found("SCIS", "1234"));
        assert_eq!(serial("TRM59800.00     SCIS", "77"), found("SCIS", ""));
        assert_eq!(serial("TRM59800.00", ""), found("NONE", ""));
        assert_eq!(serial("TRM59800.00     LEIT", ""), None);
    }
}
