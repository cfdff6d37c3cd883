//! The table of positioning options: name, unit, meaning and accepted values of each.

use std::collections::BTreeMap;

use crate::gnss::SatelliteId;
use crate::gnss::constants::SECONDS_PER_HOUR;

use super::graph_table::GRAPH_TABLE;
use super::integrity_table::INTEGRITY_TABLE;
use super::option_specification::{OptionSpecification, number, switch, switch_text};
use super::output_table::OUTPUT_TABLE;
use super::rtk_table::RTK_TABLE;
use super::{
    BandSet, ConfigError, ConstellationSet, IonosphereModel, Mode, OutputOptions,
    PositioningOptions, Profile, TroposphereMapping, TroposphereModel, WeightModel,
};

/// One option with its value in force.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct OptionEntry {
    /// The name accepted by [`PositioningOptions::set`].
    pub name: &'static str,
    /// Unit of the value; empty if dimensionless.
    pub unit: &'static str,
    /// Default value in the profile.
    pub default: String,
    /// Value in force: the default, or an override.
    pub value: String,
    /// The effect of the option, in one sentence.
    pub meaning: &'static str,
    /// The accepted values.
    pub allowed: &'static str,
}

#[rustfmt::skip]
const TABLE: &[OptionSpecification] = &[
    OptionSpecification {
        name: "systems", unit: "",
        meaning: "constellations used, by RINEX letter",
        allowed: "letters of G,R,E,C,J between commas",
        get: |o| o.systems.to_string(),
        set: |o, text| ConstellationSet::parse(text).map(|v| o.systems = v),
    },
    OptionSpecification {
        name: "exclude_satellites", unit: "",
        meaning: "satellites never used",
        allowed: "satellites such as G05,C12 between commas, or nothing",
        get: |o| satellites_text(&o.excluded_satellites),
        set: |o, text| parse_satellites(text).map(|v| o.excluded_satellites = v),
    },
    OptionSpecification {
        name: "frequencies", unit: "",
        meaning: "bands used; the first one with a signal of a satellite carries its main signal",
        allowed: "bands of L1,L2,L5,L6 between commas",
        get: |o| o.frequencies.to_string(),
        set: |o, text| BandSet::parse(text).map(|v| o.frequencies = v),
    },
    OptionSpecification {
        name: "elevation_mask_deg", unit: "deg",
        meaning: "satellites below this elevation are not used",
        allowed: "a number from 0 to 60",
        get: |o| degrees_text(o.elevation_mask_rad),
        set: |o, text| number(text, 0.0, 60.0).map(|v| o.elevation_mask_rad = v.to_radians()),
    },
    OptionSpecification {
        name: "sparse_elevation_mask_deg", unit: "deg",
        meaning: "lower elevation mask, used while few satellites are above elevation_mask_deg",
        allowed: "a number from 0 to 60",
        get: |o| degrees_text(o.sparse_elevation_mask_rad),
        set: |o, text| {
            number(text, 0.0, 60.0).map(|v| o.sparse_elevation_mask_rad = v.to_radians())
        },
    },
    OptionSpecification {
        name: "sparse_below", unit: "",
        meaning: "use sparse_elevation_mask_deg below this number of satellites",
        allowed: "a whole number from 0 to 300",
        get: |o| o.sparse_below.to_string(),
        set: |o, text| {
            text.parse().ok().filter(|v| *v <= 300).map(|v| o.sparse_below = v)
        },
    },
    OptionSpecification {
        name: "cn0_mask_db_hz", unit: "dB-Hz",
        meaning: "signals with a lower C/N0 are not used; signals without C/N0 are",
        allowed: "a number from 0 to 60",
        get: |o| o.cn0_mask_db_hz.to_string(),
        set: |o, text| number(text, 0.0, 60.0).map(|v| o.cn0_mask_db_hz = v),
    },
    OptionSpecification {
        name: "ionosphere", unit: "",
        meaning: "model that corrects the ionospheric delay",
        allowed: "none, klobuchar, nequick-g (feature nequick), ionosphere-free",
        get: |o| o.ionosphere.name().to_owned(),
        set: |o, text| IonosphereModel::from_name(text).map(|v| o.ionosphere = v),
    },
    OptionSpecification {
        name: "dual_frequency", unit: "",
        meaning: "whether a second frequency improves the modelled ionospheric delay",
        allowed: "on, off",
        get: |o| switch_text(o.dual_frequency),
        set: |o, text| switch(text).map(|v| o.dual_frequency = v),
    },
    OptionSpecification {
        name: "klobuchar_beidou", unit: "",
        meaning: "whether BeiDou is corrected by its own Klobuchar coefficients, not by GPS's",
        allowed: "on, off",
        get: |o| switch_text(o.klobuchar_beidou),
        set: |o, text| switch(text).map(|v| o.klobuchar_beidou = v),
    },
    OptionSpecification {
        name: "group_delay_beidou", unit: "",
        meaning: "whether BeiDou pseudoranges are corrected by the broadcast group delays (TGD)",
        allowed: "on, off",
        get: |o| switch_text(o.group_delay_beidou),
        set: |o, text| switch(text).map(|v| o.group_delay_beidou = v),
    },
    OptionSpecification {
        name: "ephemeris_beidou_h", unit: "h",
        meaning: "largest age of a BeiDou ephemeris, before or after its time of ephemeris (toe)",
        allowed: "a number from 1 to 24",
        get: |o| (o.ephemeris_beidou_s / SECONDS_PER_HOUR).to_string(),
        set: |o, text| number(text, 1.0, 24.0).map(|v| o.ephemeris_beidou_s = v * SECONDS_PER_HOUR),
    },
    OptionSpecification {
        name: "troposphere", unit: "",
        meaning: "model that corrects the tropospheric delay",
        allowed: "none, saastamoinen",
        get: |o| o.troposphere.name().to_owned(),
        set: |o, text| TroposphereModel::from_name(text).map(|v| o.troposphere = v),
    },
    OptionSpecification {
        name: "troposphere_mapping", unit: "",
        meaning: "mapping of the tropospheric zenith delay to the slant path",
        allowed: "niell, cosecant",
        get: |o| o.troposphere_mapping.name().to_owned(),
        set: |o, text| TroposphereMapping::from_name(text).map(|v| o.troposphere_mapping = v),
    },
    OptionSpecification {
        name: "weighting", unit: "",
        meaning: "model of the pseudorange variance",
        allowed: "cn0-elevation, rtklib, gogps",
        get: |o| o.weighting.name().to_owned(),
        set: |o, text| WeightModel::from_name(text).map(|v| o.weighting = v),
    },
    OptionSpecification {
        name: "pseudorange_sigma_m", unit: "m",
        meaning: "standard deviation of a strong signal's pseudorange, divided by sin(elevation)",
        allowed: "a number from 0.01 to 100",
        get: |o| o.pseudorange_sigma_m.to_string(),
        set: |o, text| number(text, 0.01, 100.0).map(|v| o.pseudorange_sigma_m = v),
    },
    OptionSpecification {
        name: "cn0_sigma_m", unit: "m",
        meaning: "standard deviation added at 42 dB-Hz; ten times larger at 20 dB less",
        allowed: "a number from 0 to 100",
        get: |o| o.cn0_sigma_m.to_string(),
        set: |o, text| number(text, 0.0, 100.0).map(|v| o.cn0_sigma_m = v),
    },
    OptionSpecification {
        name: "doppler_sigma_m_s", unit: "m/s",
        meaning: "standard deviation of a strong signal's Doppler, as a range rate",
        allowed: "a number from 0.001 to 10",
        get: |o| o.doppler_sigma_m_s.to_string(),
        set: |o, text| number(text, 0.001, 10.0).map(|v| o.doppler_sigma_m_s = v),
    },
    OptionSpecification {
        name: "fault_exclusion", unit: "",
        meaning: "whether satellites that contradict the others are excluded",
        allowed: "on, off",
        get: |o| switch_text(o.fault_exclusion),
        set: |o, text| switch(text).map(|v| o.fault_exclusion = v),
    },
    OptionSpecification {
        name: "false_alarm_probability", unit: "",
        meaning: "probability that a residual test rejects fault-free measurements",
        allowed: "a number from 0.000001 to 0.5",
        get: |o| o.false_alarm_probability.to_string(),
        set: |o, text| number(text, 1e-6, 0.5).map(|v| o.false_alarm_probability = v),
    },
    OptionSpecification {
        name: "gdop_limit", unit: "",
        meaning: "largest geometric dilution of precision (GDOP) of a position",
        allowed: "a number from 1, or inf",
        get: |o| o.gdop_limit.to_string(),
        set: |o, text| number(text, 1.0, f64::INFINITY).map(|v| o.gdop_limit = v),
    },
    OptionSpecification {
        name: "velocity", unit: "",
        meaning: "whether the velocity is estimated from Doppler",
        allowed: "on, off",
        get: |o| switch_text(o.velocity),
        set: |o, text| switch(text).map(|v| o.velocity = v),
    },
];

impl PositioningOptions {
    /// Overrides one option by its name.
    ///
    /// # Errors
    /// An unknown name, or a value the option does not take; the options are then unchanged.
    pub fn set(&mut self, key: &str, value: &str) -> Result<(), ConfigError> {
        let option = named(key)?;
        (option.set)(self, value.trim()).ok_or_else(|| {
            let (key, value) = (option.name, value.trim().to_owned());
            match missing_feature(key, &value) {
                Some(feature) => ConfigError::FeatureNotBuilt { key, value, feature },
                None => ConfigError::InvalidValue { key, value, allowed: option.allowed },
            }
        })
    }

    /// Checks that an option of this name exists, of whichever mode.
    ///
    /// # Errors
    /// An unknown name.
    pub fn check_name(key: &str) -> Result<(), ConfigError> {
        named(key).map(drop)
    }

    /// The names of the options of all modes: those that [`Self::set`] takes.
    pub fn names() -> impl Iterator<Item = &'static str> {
        all().map(|option| option.name)
    }

    /// Every option of the mode, with default, value in force, unit and meaning.
    pub fn entries(&self) -> Vec<OptionEntry> {
        self.entries_of(&[self.estimation_tables().as_slice(), &[OUTPUT_TABLE]].concat())
    }

    /// The tables of the options that the mode's estimator reads.
    fn estimation_tables(&self) -> [&'static [OptionSpecification]; 4] {
        let (graph, rtk): (&[OptionSpecification], &[OptionSpecification]) = match self.mode {
            Mode::Spp => (&[], &[]),
            Mode::Ekf | Mode::Fgo => (GRAPH_TABLE, &[]),
            Mode::RtkEkf | Mode::RtkFgo => (GRAPH_TABLE, RTK_TABLE),
        };
        [TABLE, INTEGRITY_TABLE, graph, rtk]
    }

    fn entries_of(&self, tables: &[&'static [OptionSpecification]]) -> Vec<OptionEntry> {
        let defaults = Self::new(self.mode, self.profile);
        let entry = |option: &OptionSpecification| OptionEntry {
            name: option.name,
            unit: option.unit,
            default: (option.get)(&defaults),
            value: (option.get)(self),
            meaning: option.meaning,
            allowed: option.allowed,
        };
        tables.iter().flat_map(|table| table.iter()).map(entry).collect()
    }

    /// BLAKE3 hash of the mode and of every value in force that its estimator reads, in
    /// hexadecimal. Equal estimators have equal hashes, whichever profile and overrides led to
    /// them.
    pub fn configuration_hash(&self) -> String {
        let mut hasher = blake3::Hasher::new();
        hasher.update(format!("mode={}\n", self.mode.name()).as_bytes());
        for entry in self.entries_of(&self.estimation_tables()) {
            hasher.update(format!("{}={}\n", entry.name, entry.value).as_bytes());
        }
        hasher.finalize().to_hex().to_string()
    }
}

impl OutputOptions {
    /// The options among stored values of a configuration; those that are not among them are as
    /// computed.
    ///
    /// # Errors
    /// A value no longer exists.
    pub fn of_values(values: &BTreeMap<String, String>) -> Result<Self, ConfigError> {
        let mut options = PositioningOptions::new(Mode::Spp, Profile::General);
        for option in OUTPUT_TABLE {
            if let Some(value) = values.get(option.name) {
                options.set(option.name, value)?;
            }
        }
        Ok(options.output)
    }
}

/// The Cargo feature that a build needs for an option to accept this value.
fn missing_feature(key: &str, value: &str) -> Option<&'static str> {
    (key == "ionosphere" && value == "nequick-g" && cfg!(not(feature = "nequick")))
        .then_some("nequick")
}

/// The options of all modes, in the order they are listed.
fn all() -> impl Iterator<Item = &'static OptionSpecification> {
    let estimation = TABLE.iter().chain(INTEGRITY_TABLE).chain(GRAPH_TABLE).chain(RTK_TABLE);
    estimation.chain(OUTPUT_TABLE)
}

/// The option of this name.
fn named(key: &str) -> Result<&'static OptionSpecification, ConfigError> {
    all()
        .find(|option| option.name == key)
        .ok_or_else(|| ConfigError::UnknownKey { key: key.to_owned(), nearest: nearest_name(key) })
}

/// The option name with the smallest edit distance to `key`; the first of equals.
fn nearest_name(key: &str) -> &'static str {
    PositioningOptions::names()
        .min_by_key(|name| edit_distance(key, name))
        .expect("the table is not empty")
}

/// Levenshtein (1966) distance: insertions, deletions and substitutions from `a` to `b`.
fn edit_distance(a: &str, b: &str) -> usize {
    let mut row: Vec<usize> = (0..=b.len()).collect();
    // Names are short: the first letters of a longer key already differ from all of them.
    for (i, byte) in a.bytes().take(64).enumerate() {
        let mut diagonal = std::mem::replace(&mut row[0], i + 1);
        for (j, other) in b.bytes().enumerate() {
            let substituted = diagonal + usize::from(byte != other);
            diagonal = row[j + 1];
            row[j + 1] = substituted.min(diagonal + 1).min(row[j] + 1);
        }
    }
    row[b.len()]
}

/// Degrees as the user wrote them: rounding to a microdegree hides the conversion's error.
fn degrees_text(angle_rad: f64) -> String {
    ((angle_rad.to_degrees() * 1e6).round() / 1e6).to_string()
}

fn satellites_text(satellites: &[SatelliteId]) -> String {
    satellites.iter().map(SatelliteId::to_string).collect::<Vec<_>>().join(",")
}

fn parse_satellites(text: &str) -> Option<Vec<SatelliteId>> {
    let items = text.split(',').map(str::trim).filter(|item| !item.is_empty());
    let mut satellites: Vec<SatelliteId> = items.map(|i| i.parse().ok()).collect::<Option<_>>()?;
    satellites.sort_unstable();
    satellites.dedup();
    Some(satellites)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::refusal::Code;

    fn general() -> PositioningOptions {
        PositioningOptions::new(Mode::Spp, Profile::General)
    }

    #[test]
    fn every_value_shown_can_be_set_again() {
        for profile in Profile::ALL {
            let shown = PositioningOptions::new(Mode::RtkFgo, *profile);
            let mut set = PositioningOptions::new(Mode::RtkFgo, Profile::General);
            for entry in shown.entries() {
                assert_eq!(entry.default, entry.value, "{}", entry.name);
                set.set(entry.name, &entry.value).unwrap();
            }
            assert_eq!(set.configuration_hash(), shown.configuration_hash());
        }
    }

    #[test]
    fn a_misspelt_option_is_told_its_neighbour() {
        let error = general().set("elevation_mask", "10").unwrap_err();
        assert_eq!(
            error.to_string(),
            "no option is called \"elevation_mask\"; the nearest is \"elevation_mask_deg\"",
        );
        assert_eq!((edit_distance("", "abc"), edit_distance("kitten", "sitting")), (3, 3));
    }

    #[test]
    fn a_wrong_value_is_told_the_allowed_ones_and_changes_nothing() {
        let mut options = general();
        for (key, value) in [
            ("ionosphere", "off"),
            ("elevation_mask_deg", "-1"),
            ("elevation_mask_deg", "nan"),
            ("systems", ""),
            ("exclude_satellites", "G05,X1"),
            ("velocity", "yes"),
        ] {
            let error = options.set(key, value).unwrap_err();
            assert!(error.to_string().contains("allowed: "), "{error}");
        }
        assert_eq!(options, general());
    }

    /// Without its feature the model is refused by name, and the refusal names the feature.
    #[test]
    fn nequick_g_needs_its_feature() {
        let set = general().set("ionosphere", "nequick-g");
        match cfg!(feature = "nequick") {
            true => assert_eq!(set, Ok(())),
            false => {
                let error = set.unwrap_err();
                assert_eq!(error.code(), Code::FeatureNotBuilt);
                assert!(error.to_string().contains("feature \"nequick\""), "{error}");
            }
        }
    }

    #[test]
    fn satellites_are_sorted_and_single() {
        let mut options = general();
        options.set("exclude_satellites", "C12, G05,C12").unwrap();
        assert_eq!(satellites_text(&options.excluded_satellites), "G05,C12");
        options.set("exclude_satellites", "").unwrap();
        assert!(options.excluded_satellites.is_empty());
    }
}
