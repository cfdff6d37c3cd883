//! Options of the estimators and their defaults; `option_table` names and explains them.

use crate::gnss::{Band, Constellation, SatelliteId};

use super::{
    BandSet, ConstellationSet, GraphOptions, IonosphereModel, Mode, Profile, RtkOptions,
    TroposphereMapping, TroposphereModel, WeightModel,
};

const HOUR_S: f64 = 3_600.0;

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
    /// Elevation mask in its place where few satellites stand above that (rad).
    pub sparse_elevation_mask_rad: f64,
    /// How many satellites above `elevation_mask_rad` are enough for it.
    pub sparse_below: usize,
    /// Signals weaker than this are not used (dB-Hz); those without C/N0 are.
    pub cn0_mask_db_hz: f64,
    /// Ionosphere model.
    pub ionosphere: IonosphereModel,
    /// Whether a second frequency improves the modelled ionosphere.
    pub dual_frequency: bool,
    /// Whether BeiDou's own Klobuchar coefficients correct BeiDou, rather than GPS's.
    pub klobuchar_beidou: bool,
    /// Whether BeiDou's pseudoranges are corrected by the group delays it broadcasts.
    pub group_delay_beidou: bool,
    /// How far from toe an ephemeris of BeiDou is used (s).
    pub ephemeris_beidou_s: f64,
    /// Troposphere model.
    pub troposphere: TroposphereModel,
    /// How the zenith delay of the troposphere is mapped to the elevation.
    pub troposphere_mapping: TroposphereMapping,
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
    /// Options of the modes with a factor graph.
    pub graph: GraphOptions,
    /// Options of the modes that difference against a base.
    pub rtk: RtkOptions,
}

impl PositioningOptions {
    /// The defaults of `profile` for `mode`.
    pub fn new(mode: Mode, profile: Profile) -> Self {
        let general = Self {
            graph: GraphOptions::new(profile),
            rtk: RtkOptions::new(profile),
            ..Self::general(mode)
        };
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
                sparse_below: 0,
                systems: ConstellationSet::of(&[Constellation::Gps, Constellation::BeiDou]),
                frequencies: BandSet::of(&[Band::L1]),
                dual_frequency: false,
                klobuchar_beidou: false,
                // As RTKLIB 2.4.2 has it, with which the paper models its measurements.
                group_delay_beidou: false,
                ephemeris_beidou_s: 6.0 * HOUR_S,
                troposphere_mapping: TroposphereMapping::Cosecant,
                // Its WLS is RTKLIB's; its graph has the weights of goGPS.
                weighting: match mode {
                    Mode::Spp => WeightModel::Rtklib,
                    _ => WeightModel::GoGps,
                },
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
            sparse_elevation_mask_rad: 10_f64.to_radians(),
            sparse_below: 10,
            cn0_mask_db_hz: 0.0,
            ionosphere: IonosphereModel::Klobuchar,
            dual_frequency: true,
            klobuchar_beidou: true,
            group_delay_beidou: true,
            ephemeris_beidou_s: 2.0 * HOUR_S,
            troposphere: TroposphereModel::Saastamoinen,
            troposphere_mapping: TroposphereMapping::Cosecant,
            weighting: WeightModel::Cn0Elevation,
            pseudorange_sigma_m: 0.3,
            cn0_sigma_m: 1.5,
            doppler_sigma_m_s: 0.05,
            fault_exclusion: true,
            false_alarm_probability: 1e-3,
            gdop_limit: 100.0,
            velocity: true,
            graph: GraphOptions::new(Profile::General),
            rtk: RtkOptions::new(Profile::General),
        }
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
