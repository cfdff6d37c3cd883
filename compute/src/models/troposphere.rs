//! Tropospheric delay.
//!
//! T(E) = m_h(E)·Z_h + m_w(E)·Z_w: zenith delays of Saastamoinen (1972), *Atmospheric correction
//! for the troposphere and stratosphere in radio ranging of satellites*, with the gravity term of
//! Davis et al. (1985), *Geodesy by radio interferometry*, in a standard atmosphere; mapped by
//! Niell (1996), *Global mapping functions for the atmosphere delay at radio wavelengths*, or by
//! the cosecant 1/sin E. Niell's is the one to use: at 5° the cosecant is 13 % too long. The
//! cosecant is there to reproduce published results that used it.

use std::f64::consts::{PI, TAU};

use crate::gnss::constants::SECONDS_PER_DAY;
use crate::gnss::{Geodetic, GpsTime};

/// Mapping of a zenith delay to the slant path.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mapping {
    /// Niell's functions of elevation, latitude, height and season.
    Niell,
    /// 1/sin E, the mapping of a flat atmosphere.
    Cosecant,
}

/// Pressure, temperature and water vapour at the receiver.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Weather {
    /// Pressure (hPa).
    pub pressure_hpa: f64,
    /// Temperature (K).
    pub temperature_k: f64,
    /// Partial pressure of water vapour (hPa).
    pub vapour_hpa: f64,
}

impl Weather {
    /// The standard atmosphere at a height above the sea (m): 1013.25 hPa and 15 °C at sea level,
    /// 6.5 K less per kilometre; ISO 2533:1975. The vapour pressure follows from relative humidity
    /// (0 … 1) by the Magnus-type formula of RTKLIB's manual 2.4.2, (E.5.1)–(E.5.3).
    ///
    /// Heights below zero count as zero.
    pub(crate) fn standard(height_m: f64, relative_humidity: f64) -> Self {
        let height_m = height_m.max(0.0);
        let temperature_k = 288.15 - 6.5e-3 * height_m;
        let saturation_hpa =
            6.108 * ((17.15 * temperature_k - 4_684.0) / (temperature_k - 38.45)).exp();
        Self {
            pressure_hpa: 1013.25 * (1.0 - 2.2557e-5 * height_m).powf(5.2568),
            temperature_k,
            vapour_hpa: saturation_hpa * relative_humidity,
        }
    }
}

/// The troposphere above one receiver at one time, for slant delays at any elevation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Troposphere {
    hydrostatic_m: f64,
    wet_m: f64,
    mapping: PreparedMapping,
}

/// Range of heights with a standard atmosphere (m).
const HEIGHTS_M: std::ops::RangeInclusive<f64> = -1_000.0..=20_000.0;

impl Troposphere {
    /// Saastamoinen's delays at `receiver` in a standard atmosphere with this relative humidity.
    ///
    /// `None` for heights below −1 km or above 20 km.
    pub fn saastamoinen(
        receiver: &Geodetic,
        time: GpsTime,
        relative_humidity: f64,
        mapping: Mapping,
    ) -> Option<Self> {
        HEIGHTS_M.contains(&receiver.height_m).then(|| {
            let weather = Weather::standard(receiver.height_m, relative_humidity);
            let (hydrostatic_m, wet_m) = zenith_delays_m(receiver, &weather);
            let mapping = match mapping {
                Mapping::Niell => PreparedMapping::niell(receiver, time),
                Mapping::Cosecant => PreparedMapping::Cosecant,
            };
            Self { hydrostatic_m, wet_m, mapping }
        })
    }

    /// Zenith delay, hydrostatic plus wet (m).
    pub(crate) fn zenith_delay_m(&self) -> f64 {
        self.hydrostatic_m + self.wet_m
    }

    /// Slant delay at an elevation (rad) above the horizon (m).
    ///
    /// Elevations below 2° count as 2°: no mapping function holds there.
    pub fn slant_delay_m(&self, elevation_rad: f64) -> f64 {
        let sin = elevation_rad.max(2.0_f64.to_radians()).sin();
        match &self.mapping {
            PreparedMapping::Cosecant => self.zenith_delay_m() / sin,
            PreparedMapping::Niell { hydrostatic, wet, height_km } => {
                let rise = (1.0 / sin - HEIGHT_FRACTION.at(sin)) * height_km;
                (hydrostatic.at(sin) + rise) * self.hydrostatic_m + wet.at(sin) * self.wet_m
            }
        }
    }
}

/// Variance of a modelled slant delay (m²): 0.3 m at the zenith, mapped by 1/(sin E + 0.1).
///
/// RTKLIB manual 2.4.2, (E.6.24) and its constant for Saastamoinen.
pub(crate) fn variance_m2(elevation_rad: f64) -> f64 {
    let sigma_m = 0.3 / (elevation_rad.sin() + 0.1);
    sigma_m * sigma_m
}

/// Hydrostatic and wet zenith delay (m).
fn zenith_delays_m(receiver: &Geodetic, weather: &Weather) -> (f64, f64) {
    let height_km = receiver.height_m.max(0.0) * 1e-3;
    let gravity = 1.0 - 0.002_66 * (2.0 * receiver.latitude_rad).cos() - 0.000_28 * height_km;
    (
        0.002_276_8 * weather.pressure_hpa / gravity,
        0.002_277 * (1_255.0 / weather.temperature_k + 0.05) * weather.vapour_hpa,
    )
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum PreparedMapping {
    Cosecant,
    Niell { hydrostatic: Fraction, wet: Fraction, height_km: f64 },
}

/// Marini's continued fraction, one at the zenith.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Fraction {
    a: f64,
    b: f64,
    c: f64,
}

/// Niell (1996), table 3: the height correction.
const HEIGHT_FRACTION: Fraction = Fraction { a: 2.53e-5, b: 5.49e-3, c: 1.14e-3 };

/// Niell (1996), table 3: averages for latitudes 15°, 30°, 45°, 60°, 75°.
const HYDROSTATIC_MEAN: [Fraction; 5] = [
    Fraction { a: 1.276_993_4e-3, b: 2.915_369_5e-3, c: 62.610_505e-3 },
    Fraction { a: 1.268_323_0e-3, b: 2.915_229_9e-3, c: 62.837_393e-3 },
    Fraction { a: 1.246_539_7e-3, b: 2.928_844_5e-3, c: 63.721_774e-3 },
    Fraction { a: 1.219_604_9e-3, b: 2.902_256_5e-3, c: 63.824_265e-3 },
    Fraction { a: 1.204_599_6e-3, b: 2.902_491_2e-3, c: 64.258_455e-3 },
];
/// Niell (1996), table 3: amplitudes over the year.
const HYDROSTATIC_AMPLITUDE: [Fraction; 5] = [
    Fraction { a: 0.0, b: 0.0, c: 0.0 },
    Fraction { a: 1.270_962_6e-5, b: 2.141_497_9e-5, c: 9.012_840_0e-5 },
    Fraction { a: 2.652_366_2e-5, b: 3.016_077_9e-5, c: 4.349_703_7e-5 },
    Fraction { a: 3.400_045_2e-5, b: 7.256_272_2e-5, c: 84.795_348e-5 },
    Fraction { a: 4.120_219_1e-5, b: 11.723_375e-5, c: 170.372_06e-5 },
];
/// Niell (1996), table 4.
const WET: [Fraction; 5] = [
    Fraction { a: 5.802_189_7e-4, b: 1.427_526_8e-3, c: 4.347_296_1e-2 },
    Fraction { a: 5.679_484_7e-4, b: 1.513_862_5e-3, c: 4.672_951_0e-2 },
    Fraction { a: 5.811_801_9e-4, b: 1.457_275_2e-3, c: 4.390_893_1e-2 },
    Fraction { a: 5.972_754_2e-4, b: 1.500_742_8e-3, c: 4.462_698_2e-2 },
    Fraction { a: 6.164_169_3e-4, b: 1.759_908_2e-3, c: 5.473_603_8e-2 },
];

/// Seconds in a year of 365.25 days.
const YEAR_S: f64 = 365.25 * SECONDS_PER_DAY;
/// Niell's winter: day of year 28.
const WINTER_DAY: f64 = 28.0;
/// GPS time starts on day 6 of its year (1980).
const GPS_EPOCH_DAY: f64 = 6.0;

impl PreparedMapping {
    fn niell(receiver: &Geodetic, time: GpsTime) -> Self {
        let latitude_deg = receiver.latitude_rad.to_degrees();
        let days = GPS_EPOCH_DAY + (time - GpsTime::EPOCH) / SECONDS_PER_DAY;
        let southern = if latitude_deg < 0.0 { PI } else { 0.0 };
        let season = (TAU * (days - WINTER_DAY) * SECONDS_PER_DAY / YEAR_S + southern).cos();
        let mean = interpolate(&HYDROSTATIC_MEAN, latitude_deg.abs());
        let amplitude = interpolate(&HYDROSTATIC_AMPLITUDE, latitude_deg.abs());
        let hydrostatic = Fraction {
            a: mean.a - amplitude.a * season,
            b: mean.b - amplitude.b * season,
            c: mean.c - amplitude.c * season,
        };
        let wet = interpolate(&WET, latitude_deg.abs());
        Self::Niell { hydrostatic, wet, height_km: receiver.height_m.max(0.0) * 1e-3 }
    }
}

/// Linear between the tabulated latitudes (°), constant beyond them.
fn interpolate(table: &[Fraction; 5], latitude_deg: f64) -> Fraction {
    let position = (latitude_deg / 15.0 - 1.0).clamp(0.0, 4.0);
    let index = (position as usize).min(3);
    let (low, high, share) = (&table[index], &table[index + 1], position - index as f64);
    Fraction {
        a: low.a + (high.a - low.a) * share,
        b: low.b + (high.b - low.b) * share,
        c: low.c + (high.c - low.c) * share,
    }
}

impl Fraction {
    fn at(&self, sin: f64) -> f64 {
        let Self { a, b, c } = *self;
        (1.0 + a / (1.0 + b / (1.0 + c))) / (sin + a / (sin + b / (sin + c)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn near(value: f64, expected: f64, tolerance: f64) {
        assert!((value - expected).abs() < tolerance, "{value}, not {expected}");
    }

    /// Expected values: zenith delays computed in Python from the formulas above.
    #[test]
    fn zenith_delays_worked_apart() {
        let sea = Geodetic::from_degrees(45.0, 0.0, 0.0);
        let (dry, wet) = zenith_delays_m(&sea, &Weather::standard(0.0, 0.5));
        near(dry, 2.306_967_6, 1e-12);
        near(wet, 0.086_010_049_640_126, 1e-12);
        let hill = Geodetic::from_degrees(30.0, 0.0, 1_500.0);
        let weather = Weather::standard(1_500.0, 0.7);
        near(weather.pressure_hpa, 845.537_958_563, 1e-6);
        let (dry, wet) = zenith_delays_m(&hill, &weather);
        near(dry, 1.928_495_691_516_435, 1e-12);
        near(wet, 0.064_719_185_444_12, 1e-12);
    }

    /// Expected values: Niell's functions computed in Python, at 45° in mid-spring and at 30° on
    /// the winter day.
    #[test]
    fn niell_worked_apart() {
        let winter = GpsTime::EPOCH + (WINTER_DAY - GPS_EPOCH_DAY) * SECONDS_PER_DAY;
        let receiver = Geodetic::from_degrees(45.0, 0.0, 0.0);
        let spring = winter + YEAR_S / 4.0;
        let slant = |receiver: &Geodetic, time, elevation: f64, dry: f64, wet: f64| {
            let mapping = PreparedMapping::niell(receiver, time);
            Troposphere { hydrostatic_m: dry, wet_m: wet, mapping }
                .slant_delay_m(elevation.to_radians())
        };
        near(slant(&receiver, spring, 5.0, 1.0, 0.0), 10.128_617_232_579_067, 1e-9);
        near(slant(&receiver, spring, 5.0, 0.0, 1.0), 10.750_884_210_392_691, 1e-9);
        near(slant(&receiver, spring, 90.0, 1.0, 1.0), 2.0, 1e-12);
        let hill = Geodetic::from_degrees(30.0, 0.0, 1_500.0);
        near(slant(&hill, winter, 10.0, 1.0, 0.0), 5.556_008_471_066_759, 1e-9);
        near(slant(&hill, winter, 10.0, 0.0, 1.0), 5.659_495_589_978_741, 1e-9);
        // Half a year later it is winter in the south.
        let south = Geodetic::from_degrees(-30.0, 0.0, 1_500.0);
        near(slant(&south, winter + YEAR_S / 2.0, 10.0, 1.0, 0.0), 5.556_008_471_066_759, 1e-9);
    }

    /// The mappings agree at high elevations and differ towards the horizon.
    #[test]
    fn mappings_part_towards_the_horizon() {
        let receiver = Geodetic::from_degrees(22.3, 114.2, 5.0);
        let time = GpsTime::from_week_seconds(2051, 46_701.0);
        let with = |mapping| Troposphere::saastamoinen(&receiver, time, 0.7, mapping).unwrap();
        let (niell, cosecant) = (with(Mapping::Niell), with(Mapping::Cosecant));
        near(niell.slant_delay_m(1.0) / cosecant.slant_delay_m(1.0), 1.0, 1e-3);
        near(cosecant.slant_delay_m(0.5), cosecant.zenith_delay_m() / 0.5_f64.sin(), 1e-12);
        let low = 5.0_f64.to_radians();
        assert!(3.0 < cosecant.slant_delay_m(low) - niell.slant_delay_m(low));
        assert!(niell.slant_delay_m(-1.0).is_finite());
    }

    #[test]
    fn no_atmosphere_far_from_the_ground() {
        for height_m in [-2_000.0, 30_000.0, f64::NAN] {
            let receiver = Geodetic::from_degrees(0.0, 0.0, height_m);
            let mapping = Mapping::Cosecant;
            assert_eq!(Troposphere::saastamoinen(&receiver, GpsTime::EPOCH, 0.5, mapping), None);
        }
    }

    #[test]
    fn the_variance_worked_by_hand() {
        near(variance_m2(std::f64::consts::FRAC_PI_2), (0.3_f64 / 1.1).powi(2), 1e-12);
    }
}
