//! Antennas: where their phase centres are.
//!
//! The *antenna reference point* (ARP) is a place on the antenna's body, most often the bottom of
//! its mount; a *marker* is what stands in the ground below it. The mean phase centre is off the
//! ARP by an offset, and a phase is longer than the range from that centre by a variation that
//! depends on direction, both per frequency.

use nalgebra::Vector3;

use super::{Constellation, GpsTime, SatelliteId};

/// Phase centre of an antenna on one frequency.
#[derive(Clone, Debug, PartialEq)]
pub struct PhaseCentrePattern {
    /// Whose frequency.
    pub constellation: Constellation,
    /// Its band, the first digit of RINEX 3 codes.
    pub band_digit: u8,
    /// Mean phase centre (m): from the ARP towards north, east and up; of a satellite from its
    /// centre of mass along its body's x, y and z.
    pub offset_m: Vector3<f64>,
    /// First zenith angle of the grid (rad); nadir angle of a satellite.
    pub first_zenith_rad: f64,
    /// Between zenith angles (rad).
    pub zenith_step_rad: f64,
    /// Variations by zenith angle, whatever the azimuth (m).
    pub variations_m: Vec<f64>,
    /// Variations by azimuth, clockwise from north in equal steps from 0 to 360° inclusive, each by
    /// zenith angle (m); empty where only the mean over azimuth is known.
    pub azimuth_variations_m: Vec<Vec<f64>>,
}

/// A receiver's antenna that was calibrated.
#[derive(Clone, Debug, PartialEq)]
pub struct AntennaCalibration {
    /// Type, as the IGS names it: `TRM59800.00`.
    pub antenna: String,
    /// Radome, `NONE` where there is none.
    pub radome: String,
    /// Serial number of this one antenna; empty for the mean of its type.
    pub serial: String,
    /// One for each frequency.
    pub patterns: Vec<PhaseCentrePattern>,
}

/// A satellite's antenna.
#[derive(Clone, Debug, PartialEq)]
pub struct SatelliteAntenna {
    /// The satellite that had the number at the time.
    pub satellite: SatelliteId,
    /// Its type, such as `BLOCK IIF`.
    pub kind: String,
    /// From when it had that number.
    pub valid_from: Option<GpsTime>,
    /// Until when.
    pub valid_until: Option<GpsTime>,
    /// One for each frequency.
    pub patterns: Vec<PhaseCentrePattern>,
}

/// Calibrated antennas.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct AntennaCatalogue {
    /// Of receivers.
    pub receivers: Vec<AntennaCalibration>,
    /// Of satellites.
    pub satellites: Vec<SatelliteAntenna>,
}

impl AntennaCatalogue {
    /// The calibration of a receiver's antenna, named as in RINEX headers: type and radome in 16
    /// and 4 columns, or apart by blanks; no radome is `NONE`. The antenna's own calibration comes
    /// before that of its type. `None` where type and radome are not known together: another
    /// radome moves the phase centre by millimetres.
    pub fn receiver(&self, name: &str, serial: &str) -> Option<&AntennaCalibration> {
        let (antenna, radome) = split_antenna_name(name);
        let mut same = self.receivers.iter().filter(|one| {
            one.antenna.eq_ignore_ascii_case(antenna) && one.radome.eq_ignore_ascii_case(radome)
        });
        let own = same.clone().find(|one| !serial.is_empty() && one.serial == serial);
        own.or_else(|| same.find(|one| one.serial.is_empty()))
    }

    /// The antenna of the satellite that had a number at a time.
    pub fn satellite(&self, satellite: SatelliteId, time: GpsTime) -> Option<&SatelliteAntenna> {
        self.satellites.iter().find(|one| {
            one.satellite == satellite
                && one.valid_from.is_none_or(|from| from <= time)
                && one.valid_until.is_none_or(|until| time <= until)
        })
    }
}

/// Type and radome of an antenna's name of 20 columns.
pub fn split_antenna_name(name: &str) -> (&str, &str) {
    const TYPE_COLUMNS: usize = 16;
    let in_columns = name.split_at_checked(TYPE_COLUMNS);
    let (antenna, radome) = match in_columns {
        // A type of 16 columns without a blank runs on only if the columns were not kept.
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
        let catalogue = AntennaCatalogue { receivers, satellites: Vec::new() };
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
