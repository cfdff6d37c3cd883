//! Options of the estimators and their defaults; `option_table` names and explains them.

use crate::gnss::constants::SECONDS_PER_HOUR;
use crate::gnss::{Band, Constellation, SatelliteId};

use super::{
    BandSet, ConstellationSet, GraphOptions, IntegrityOptions, IonosphereModel, Mode,
    OutputOptions, Profile, RtkOptions, TroposphereMapping, TroposphereModel, WeightModel,
};

/// C/N0 to which the options' standard deviations refer (dB-Hz): at 22 dB-Hz they are tenfold.
pub(crate) const REFERENCE_CN0_DB_HZ: f64 = 42.0;

/// The options of an estimator: a profile's values with overrides.
///
/// The fields are in the units that the estimator computes with; [`Self::entries`] shows them under
/// the names and in the units that users write.
#[derive(Clone, Debug, PartialEq)]
pub struct PositioningOptions {
    /// The estimator that the options configure.
    pub mode: Mode,
    /// The profile that gave the default values.
    pub profile: Profile,
    /// Constellations whose satellites are used.
    pub systems: ConstellationSet,
    /// Satellites never used, sorted.
    pub excluded_satellites: Vec<SatelliteId>,
    /// Bands whose signals are used.
    pub frequencies: BandSet,
    /// Satellites below this elevation are not used (rad).
    pub elevation_mask_rad: f64,
    /// Elevation mask used in its place while few satellites are above it (rad).
    pub sparse_elevation_mask_rad: f64,
    /// Number of satellites above `elevation_mask_rad` below which the sparse mask is used.
    pub sparse_below: usize,
    /// Signals with a lower C/N0 are not used (dB-Hz); signals without C/N0 are.
    pub cn0_mask_db_hz: f64,
    /// Model of the ionospheric delay.
    pub ionosphere: IonosphereModel,
    /// Whether a second frequency improves the modelled ionospheric delay.
    pub dual_frequency: bool,
    /// Whether BeiDou is corrected by its own Klobuchar coefficients, not by GPS's.
    pub klobuchar_beidou: bool,
    /// Whether BeiDou pseudoranges are corrected by the broadcast group delays (TGD).
    pub group_delay_beidou: bool,
    /// Largest time between an epoch and the toe of its BeiDou ephemeris (s).
    pub ephemeris_beidou_s: f64,
    /// Model of the tropospheric delay.
    pub troposphere: TroposphereModel,
    /// Mapping of the tropospheric zenith delay to the slant path.
    pub troposphere_mapping: TroposphereMapping,
    /// Model of the pseudorange variance.
    pub weighting: WeightModel,
    /// Standard deviation of a strong signal's pseudorange, divided by sin(elevation) (m).
    pub pseudorange_sigma_m: f64,
    /// Standard deviation added to a pseudorange at 42 dB-Hz (m); ten times larger at 20 dB less.
    pub cn0_sigma_m: f64,
    /// Standard deviation of a strong signal's Doppler, as a range rate (m/s).
    pub doppler_sigma_m_s: f64,
    /// Whether satellites that contradict the others are excluded.
    pub fault_exclusion: bool,
    /// Probability that a residual test rejects fault-free measurements.
    pub false_alarm_probability: f64,
    /// Largest geometric dilution of precision (GDOP) of a position.
    pub gdop_limit: f64,
    /// Whether the velocity is estimated from Doppler.
    pub velocity: bool,
    /// Options of the modes with a factor graph.
    pub graph: GraphOptions,
    /// Options of the modes that difference against a base.
    pub rtk: RtkOptions,
    /// Options of protection levels.
    pub integrity: IntegrityOptions,
    /// Options of what is given out, which no estimator reads.
    pub output: OutputOptions,
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
                ephemeris_beidou_s: 6.0 * SECONDS_PER_HOUR,
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
            ephemeris_beidou_s: 2.0 * SECONDS_PER_HOUR,
            troposphere: TroposphereModel::Saastamoinen,
            troposphere_mapping: match mode {
                Mode::Fgo | Mode::Ekf => TroposphereMapping::Niell,
                Mode::Spp | Mode::RtkFgo | Mode::RtkEkf => TroposphereMapping::Cosecant,
            },
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
            integrity: IntegrityOptions::new(),
            output: OutputOptions::as_computed(),
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

    /// What is given out changes nothing that is computed, so it has no part in the hash.
    #[test]
    fn what_is_given_out_is_not_hashed() {
        let plain = PositioningOptions::new(Mode::RtkFgo, Profile::General);
        let mut options = plain.clone();
        for (name, value) in
            [("frame", "ETRS89"), ("base_frame", "ETRF2014@2020.5"), ("geoid", "on")]
        {
            options.set(name, value).unwrap();
            assert!(options.entries().iter().any(|e| e.name == name && e.value == value));
        }
        assert_ne!(options, plain);
        assert_eq!(options.configuration_hash(), plain.configuration_hash());
        for (name, value) in [("frame", "WGS84"), ("base_frame", "LOCAL"), ("geoid", "yes")] {
            assert!(options.set(name, value).is_err(), "{name}={value}");
        }
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
