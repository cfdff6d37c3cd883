//! The values that options choose from.

use std::fmt;

use crate::gnss::{Band, Constellation};

use super::ConfigError;

/// Declares an enumeration whose values have names in the configuration.
macro_rules! named_choice {
    ($(#[$meta:meta])* $name:ident {
        $($(#[doc = $doc:literal])+ $(#[cfg($cfg:meta)])? $variant:ident = $text:literal,)+
    }) => {
        $(#[$meta])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
        pub enum $name {
            $($(#[doc = $doc])+ $(#[cfg($cfg)])? $variant,)+
        }

        impl $name {
            /// Every value, in the order of declaration.
            pub const ALL: &[Self] = &[$($(#[cfg($cfg)])? Self::$variant,)+];

            /// The name in option values, on the command line and in the API.
            pub const fn name(self) -> &'static str {
                match self {
                    $($(#[cfg($cfg)])? Self::$variant => $text,)+
                }
            }

            /// The value with this name, or `None`.
            pub fn from_name(name: &str) -> Option<Self> {
                Self::ALL.iter().copied().find(|value| value.name() == name)
            }
        }
    };
}

named_choice! {
    /// An estimator, by the measurements that it uses and its solver.
    Mode {
        /// Single-point positioning: least squares on the pseudoranges of one epoch.
        Spp = "spp",
        /// Extended Kalman filter on the factors of the graph, for comparison.
        Ekf = "ekf",
        /// Factor graph over a sliding window: pseudoranges, Doppler, time-differenced phase,
        /// motion.
        Fgo = "fgo",
        /// Extended Kalman filter on differences against a base, for comparison with `rtk-fgo`.
        RtkEkf = "rtk-ekf",
        /// Factor graph on differences against a base, with integer ambiguities.
        RtkFgo = "rtk-fgo",
    }
}

named_choice! {
    /// The answer to a position whose protection level exceeds its limit.
    Beyond {
        /// It is answered, with the reason.
        Flag = "flag",
        /// The answer has the status `NONE`, with the reason.
        Withhold = "withhold",
    }
}

named_choice! {
    /// The frame of the positions that are given out.
    OutputFrame {
        /// As computed: relative to a base in the base's frame, others in WGS 84 as broadcast.
        Native = "native",
        /// The ETRS89, in its realisation ETRF2000.
        Etrs89 = "ETRS89",
    }
}

named_choice! {
    /// A robust kernel; formulas in `graph::kernel`.
    KernelLaw {
        /// No robust kernel: least squares.
        Quadratic = "quadratic",
        /// Huber's kernel: convex, with bounded pull.
        Huber = "huber",
        /// Cauchy's kernel: redescending, with unbounded loss.
        Cauchy = "cauchy",
        /// Geman and McClure's kernel: redescending, with bounded loss.
        GemanMcclure = "geman-mcclure",
        /// Mixture of direct signal, late reflection and fault; estimates the receiver's noise.
        Mixture = "mixture",
    }
}

named_choice! {
    /// How Doppler measurements enter the factor graph.
    DopplerUse {
        /// Doppler is not used.
        None = "none",
        /// One factor a satellite, on velocity and clock drift.
        Satellites = "satellites",
        /// One velocity an epoch, solved first: Wen & Hsu (2021), equations (11) and (12).
        Velocity = "velocity",
    }
}

named_choice! {
    /// A set of default values, chosen by the dynamics of the antenna.
    Profile {
        /// Pedestrian, car, boat or drone: any motion within the velocity walk.
        General = "general",
        /// A road vehicle among buildings.
        UrbanVehicle = "urban-vehicle",
        /// A receiver at rest under open sky.
        Static = "static",
        /// A smartphone: weak antenna, noisy pseudoranges and Doppler.
        Phone = "phone",
        /// The settings of Wen & Hsu (2021), whose single-point solution is RTKLIB's single mode.
        Paper = "paper",
    }
}

named_choice! {
    /// How the ionospheric delay is corrected.
    IonosphereModel {
        /// No correction.
        None = "none",
        /// The broadcast Klobuchar model, IS-GPS-200.
        Klobuchar = "klobuchar",
        /// Klobuchar's model with the coefficients of a day of medium solar activity.
        TypicalKlobuchar = "klobuchar-typical",
        /// The broadcast NeQuick-G model.
        #[cfg(feature = "nequick")]
        NequickG = "nequick-g",
        /// The ionosphere-free combination of two frequencies, which cancels the first-order delay.
        IonosphereFree = "ionosphere-free",
    }
}

named_choice! {
    /// How the tropospheric delay is corrected.
    TroposphereModel {
        /// No correction.
        None = "none",
        /// Saastamoinen's zenith delay in a standard atmosphere, mapped to the slant path.
        Saastamoinen = "saastamoinen",
    }
}

named_choice! {
    /// How the zenith delay of the troposphere is mapped to the slant path.
    TroposphereMapping {
        /// Niell's functions of elevation, latitude, height and season.
        Niell = "niell",
        /// 1/sin E, a flat atmosphere.
        Cosecant = "cosecant",
    }
}

named_choice! {
    /// How the variance of a pseudorange is modelled.
    WeightModel {
        /// From C/N0 and elevation, see `positioning::measurements`.
        Cn0Elevation = "cn0-elevation",
        /// From elevation alone, as RTKLIB 2.4 does.
        Rtklib = "rtklib",
        /// goGPS's function: 1/sin²E times a factor of C/N0.
        GoGps = "gogps",
    }
}

impl Mode {
    /// Whether the mode keeps past epochs and answers them again, smoothed or in batch.
    pub const fn has_window(self) -> bool {
        match self {
            Self::Spp | Self::Ekf | Self::RtkEkf => false,
            Self::Fgo | Self::RtkFgo => true,
        }
    }

    /// Whether the mode positions against a base.
    pub const fn is_relative(self) -> bool {
        matches!(self, Self::RtkEkf | Self::RtkFgo)
    }

    /// The mode of a recording for which none is asked: the best that its files allow.
    pub const fn of_recording(has_base: bool) -> Self {
        if has_base { Self::RtkFgo } else { Self::Fgo }
    }

    /// The mode with this name.
    ///
    /// # Errors
    /// [`ConfigError::UnknownMode`] lists the modes there are.
    pub fn parse(name: &str) -> Result<Self, ConfigError> {
        Self::from_name(name).ok_or_else(|| ConfigError::UnknownMode {
            name: name.to_owned(),
            allowed: Self::ALL.iter().map(|mode| mode.name()).collect::<Vec<_>>().join(", "),
        })
    }
}

impl Profile {
    /// The profile with this name.
    ///
    /// # Errors
    /// [`ConfigError::UnknownProfile`] lists the profiles there are.
    pub fn parse(name: &str) -> Result<Self, ConfigError> {
        Self::from_name(name).ok_or_else(|| ConfigError::UnknownProfile {
            name: name.to_owned(),
            allowed: Self::ALL.iter().map(|profile| profile.name()).collect::<Vec<_>>().join(", "),
        })
    }
}

/// A set of constellations; displays as `G,R,E`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ConstellationSet(u8);

impl ConstellationSet {
    /// All constellations.
    pub const ALL: Self = Self((1 << Constellation::COUNT) - 1);

    /// The set of the constellations given.
    pub fn of(constellations: &[Constellation]) -> Self {
        Self(constellations.iter().fold(0, |bits, c| bits | 1 << c.index()))
    }

    /// Parses RINEX letters separated by commas, at least one.
    pub fn parse(text: &str) -> Option<Self> {
        let letter = |item: &str| {
            let mut letters = item.trim().chars();
            let constellation = Constellation::from_letter(letters.next()?.to_ascii_uppercase())?;
            letters.next().is_none().then_some(constellation)
        };
        let list: Option<Vec<_>> = text.split(',').map(letter).collect();
        list.map(|list| Self::of(&list))
    }

    /// Whether the set holds `constellation`.
    pub const fn contains(self, constellation: Constellation) -> bool {
        self.0 & 1 << constellation.index() != 0
    }
}

impl fmt::Display for ConstellationSet {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let chosen = Constellation::ALL.into_iter().filter(|c| self.contains(*c));
        f.write_str(&chosen.map(|c| c.letter().to_string()).collect::<Vec<_>>().join(","))
    }
}

/// A set of bands; displays as `L1,L5`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BandSet(u8);

impl BandSet {
    /// The set of the bands given.
    pub fn of(bands: &[Band]) -> Self {
        Self(bands.iter().fold(0, |bits, band| bits | 1 << *band as u8))
    }

    /// Parses band names separated by commas, at least one.
    pub fn parse(text: &str) -> Option<Self> {
        let band = |item: &str| {
            Band::ALL.into_iter().find(|band| band.name().eq_ignore_ascii_case(item.trim()))
        };
        let list: Option<Vec<_>> = text.split(',').map(band).collect();
        list.map(|list| Self::of(&list))
    }

    /// Whether the set holds `band`.
    pub const fn contains(self, band: Band) -> bool {
        self.0 & 1 << band as u8 != 0
    }
}

impl fmt::Display for BandSet {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let chosen = Band::ALL.into_iter().filter(|band| self.contains(*band));
        f.write_str(&chosen.map(Band::name).collect::<Vec<_>>().join(","))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn modes_to_come_are_refused_by_name() {
        assert_eq!(Mode::parse("spp"), Ok(Mode::Spp));
        let error = Mode::parse("ppp").unwrap_err();
        let allowed = "spp, ekf, fgo, rtk-ekf, rtk-fgo";
        assert_eq!(error.to_string(), format!("mode \"ppp\" is not available; allowed: {allowed}"));
    }

    #[test]
    fn a_recording_with_a_base_is_positioned_relative_to_it() {
        assert_eq!([false, true].map(Mode::of_recording), [Mode::Fgo, Mode::RtkFgo]);
    }

    #[test]
    fn sets_round_trip_in_their_own_order() {
        assert_eq!(ConstellationSet::parse("c, g").unwrap().to_string(), "G,C");
        assert_eq!(ConstellationSet::ALL.to_string(), "G,R,E,C,J");
        assert_eq!(BandSet::parse("L5,l1").unwrap().to_string(), "L1,L5");
        for wrong in ["", "G,", "GPS", "X"] {
            assert_eq!(ConstellationSet::parse(wrong), None, "{wrong}");
        }
        assert_eq!(BandSet::parse("L1,L3"), None);
    }
}
