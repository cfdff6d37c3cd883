//! Options of the estimators.

use crate::gnss::{Band, Constellation, SatelliteId};

use super::option_table::{self, OptionEntry};
use super::{
    BandSet, ConfigError, ConstellationSet, IonosphereModel, Mode, Profile, TroposphereModel,
    WeightModel,
};

/// What an estimator is told: a profile's values with overrides.
///
/// The fields are in the units the estimator computes with; [`Self::entries`] shows them under
/// the names and in the units users write.
#[derive(Clone, Debug, PartialEq)]
pub struct PositioningOptions {
    /// The estimator.
    pub mode: Mode,
    /// Where the values came from before overrides.
    pub profile: Profile,
    /// Constellations used.
    pub systems: ConstellationSet,
    /// Satellites never used, sorted.
    pub excluded_satellites: Vec<SatelliteId>,
    /// Bands used.
    pub frequencies: BandSet,
    /// Satellites lower than this are not used (rad).
    pub elevation_mask_rad: f64,
    /// Signals weaker than this are not used (dB-Hz); those without C/N0 are.
    pub cn0_mask_db_hz: f64,
    /// Ionosphere model.
    pub ionosphere: IonosphereModel,
    /// Whether a second frequency improves the modelled ionosphere.
    pub dual_frequency: bool,
    /// Troposphere model.
    pub troposphere: TroposphereModel,
    /// Variance model.
    pub weighting: WeightModel,
    /// Standard deviation of a strong signal's pseudorange at zenith (m).
    pub pseudorange_sigma_m: f64,
    /// Standard deviation that C/N0 adds to a pseudorange at 42 dB-Hz (m).
    pub cn0_sigma_m: f64,
    /// Standard deviation of a strong signal's Doppler as range rate (m/s).
    pub doppler_sigma_m_s: f64,
    /// Whether satellites that disagree with the others are left out.
    pub fault_exclusion: bool,
    /// Probability that the residual test rejects an epoch without a fault.
    pub false_alarm_probability: f64,
    /// Geometric dilution of precision above which no position is given.
    pub gdop_limit: f64,
    /// Whether the velocity is estimated.
    pub velocity: bool,
}

impl PositioningOptions {
    /// The defaults of `profile` for `mode`.
    pub fn new(mode: Mode, profile: Profile) -> Self {
        let general = Self::general(mode);
        match profile {
            Profile::General => general,
            Profile::UrbanVehicle => Self { profile, ..general },
            Profile::Static => Self { profile, elevation_mask_rad: 10_f64.to_radians(), ..general },
            Profile::Phone => Self {
                profile,
                pseudorange_sigma_m: 2.0,
                cn0_sigma_m: 3.0,
                doppler_sigma_m_s: 0.2,
                ..general
            },
            Profile::Paper => Self {
                profile,
                systems: ConstellationSet::of(&[Constellation::Gps, Constellation::BeiDou]),
                frequencies: BandSet::of(&[Band::L1]),
                dual_frequency: false,
                weighting: WeightModel::Rtklib,
                fault_exclusion: false,
                gdop_limit: f64::INFINITY,
                ..general
            },
        }
    }

    fn general(mode: Mode) -> Self {
        Self {
            mode,
            profile: Profile::General,
            systems: ConstellationSet::ALL,
            excluded_satellites: Vec::new(),
            frequencies: BandSet::of(&[Band::L1, Band::L2, Band::L5]),
            elevation_mask_rad: 15_f64.to_radians(),
            cn0_mask_db_hz: 0.0,
            ionosphere: IonosphereModel::Klobuchar,
            dual_frequency: true,
            troposphere: TroposphereModel::Saastamoinen,
            weighting: WeightModel::Cn0Elevation,
            pseudorange_sigma_m: 1.0,
            cn0_sigma_m: 1.5,
            doppler_sigma_m_s: 0.05,
            fault_exclusion: true,
            false_alarm_probability: 1e-3,
            gdop_limit: 100.0,
            velocity: true,
        }
    }

    /// Overrides one option by its name.
    ///
    /// # Errors
    /// An unknown name, or a value the option does not take; the options are then unchanged.
    pub fn set(&mut self, key: &str, value: &str) -> Result<(), ConfigError> {
        option_table::set(self, key, value)
    }

    /// Every option: its name, unit, default in this profile, value in force and meaning.
    pub fn entries(&self) -> Vec<OptionEntry> {
        option_table::entries(self)
    }

    /// BLAKE3 of the mode and every value in force, in hexadecimal: equal for equal estimators,
    /// whichever profile and overrides led to them.
    pub fn configuration_hash(&self) -> String {
        let mut hasher = blake3::Hasher::new();
        hasher.update(format!("mode={}\n", self.mode.name()).as_bytes());
        for entry in self.entries() {
            hasher.update(format!("{}={}\n", entry.name, entry.value).as_bytes());
        }
        hasher.finalize().to_hex().to_string()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_values_have_equal_hashes_whatever_led_to_them() {
        let general = PositioningOptions::new(Mode::Spp, Profile::General);
        let mut fixed = PositioningOptions::new(Mode::Spp, Profile::Static);
        assert_ne!(general.configuration_hash(), fixed.configuration_hash());
        fixed.set("elevation_mask_deg", "15").unwrap();
        assert_eq!(general.configuration_hash(), fixed.configuration_hash());
    }

    #[test]
    fn the_paper_profile_is_gps_and_beidou_without_exclusion() {
        let paper = PositioningOptions::new(Mode::Spp, Profile::Paper);
        let value =
            |name| paper.entries().into_iter().find(|e| e.name == name).map(|e| e.value).unwrap();
        assert_eq!(value("systems"), "G,C");
        assert_eq!(value("elevation_mask_deg"), "15");
        assert_eq!(value("fault_exclusion"), "off");
        assert_eq!(value("gdop_limit"), "inf");
    }
}
