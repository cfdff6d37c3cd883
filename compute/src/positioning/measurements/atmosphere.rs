//! Tropospheric and ionospheric delays of the measurements of one receiver.

use crate::config::{
    IonosphereModel, PositioningOptions, TroposphereMapping, TroposphereModel, WeightModel,
};
use crate::gnss::{Ecef, Geodetic, GpsTime, LocalFrame, Navigation};
use crate::models::ionosphere::{
    broadcast_delay_m, klobuchar_delay_m, klobuchar_variance_m2, typical_delay_m,
    typical_variance_m2,
};
#[cfg(feature = "nequick")]
use crate::models::ionosphere::{nequick_delay_m, nequick_variance_m2};
use crate::models::look_angles;
use crate::models::troposphere::{self, Mapping, Troposphere};
use crate::models::weights::MeasurementWeights;

use super::inter_frequency::InterFrequencyBiases;
use super::weights::{constellation_factor, receiver_weights};
use super::{Measurement, SecondFrequency};

/// Relative humidity of the standard atmosphere, 0 … 1; RTKLIB's `REL_HUMI`.
pub(crate) const RELATIVE_HUMIDITY: f64 = 0.7;

/// The atmosphere above one position at one time.
pub(super) struct Atmosphere<'a> {
    frame: LocalFrame,
    geodetic: Geodetic,
    time: GpsTime,
    navigation: &'a Navigation,
    troposphere: Option<Troposphere>,
    weights: MeasurementWeights,
}

/// A delay with its variance.
struct Delay {
    delay_m: f64,
    variance_m2: f64,
    /// The model that was used instead of the chosen one, if it was not available.
    fallback: Option<&'static str>,
}

impl<'a> Atmosphere<'a> {
    /// `None` for a position where no receiver can be.
    pub(super) fn at(
        position: Ecef,
        time: GpsTime,
        navigation: &'a Navigation,
        options: &PositioningOptions,
    ) -> Option<Self> {
        let geodetic = position.to_geodetic();
        let mapping = match options.troposphere_mapping {
            TroposphereMapping::Niell => Mapping::Niell,
            TroposphereMapping::Cosecant => Mapping::Cosecant,
        };
        let modelled = Troposphere::saastamoinen(&geodetic, time, RELATIVE_HUMIDITY, mapping)?;
        let troposphere =
            (options.troposphere == TroposphereModel::Saastamoinen).then_some(modelled);
        let weights = receiver_weights(options);
        let frame = LocalFrame::at(position);
        Some(Self { frame, geodetic, time, navigation, troposphere, weights })
    }

    /// Subtracts the atmospheric delays from the measurements and sets their variances. Returns the
    /// ionosphere model that was used if the chosen one was not available.
    pub(super) fn correct(
        &self,
        list: &mut [Measurement],
        biases: &mut InterFrequencyBiases,
        options: &PositioningOptions,
    ) -> Option<&'static str> {
        for measurement in list.iter_mut() {
            measurement.look = look_angles(&self.frame, measurement.state.position);
        }
        let mask_rad = mask_rad(list, options);
        biases.clear();
        let mut stand_in = None;
        for measurement in list.iter_mut() {
            measurement.is_above_mask = mask_rad <= measurement.look.elevation_rad;
            if !measurement.is_above_mask {
                continue;
            }
            let ionosphere = self.ionosphere(measurement, options);
            measurement.ionosphere_m = ionosphere.delay_m;
            measurement.ionosphere_m2 = ionosphere.variance_m2;
            stand_in = stand_in.or(ionosphere.fallback);
            measurement.noise_m2 = self.noise_m2(measurement, measurement.cn0_db_hz);
            if let Some(second) = &mut measurement.second {
                let factor = constellation_factor(measurement.satellite.constellation);
                let elevation_rad = measurement.look.elevation_rad;
                second.noise_m2 =
                    factor * self.weights.variance_m2(elevation_rad, second.cn0_db_hz);
                biases.add(measurement);
            }
        }
        biases.settle();
        for measurement in list.iter_mut().filter(|measurement| measurement.is_above_mask) {
            self.correct_one(measurement, biases, options);
        }
        stand_in
    }

    fn correct_one(
        &self,
        measurement: &mut Measurement,
        biases: &InterFrequencyBiases,
        options: &PositioningOptions,
    ) {
        let elevation_rad = measurement.look.elevation_rad;
        let (troposphere_m, troposphere_m2) = match &self.troposphere {
            Some(model) => {
                (model.slant_delay_m(elevation_rad), troposphere::variance_m2(elevation_rad))
            }
            None => (0.0, 0.0),
        };
        let second = measurement.second.as_ref();
        let second = second.filter(|_| options.ionosphere != IonosphereModel::None);
        let second = second.and_then(|second| Some((second, biases.of(measurement, second)?)));
        let (range_m, variance_m2, ionosphere_sigma_m) = match second {
            Some((second, bias_m)) => dual_frequency_range(measurement, second, bias_m),
            None => (
                measurement.pseudorange_m - measurement.ionosphere_m,
                measurement.noise_m2 + measurement.ionosphere_m2,
                measurement.ionosphere_m2.sqrt(),
            ),
        };
        measurement.troposphere_m = troposphere_m;
        measurement.corrected_range_m = range_m - troposphere_m;
        measurement.variance_m2 = match options.weighting {
            // As published: elevation and C/N0 only.
            WeightModel::GoGps => measurement.noise_m2,
            WeightModel::Cn0Elevation | WeightModel::Rtklib => {
                let satellite_m2 = measurement.state.variance_m2 + measurement.group_delay_m2;
                variance_m2 + satellite_m2 + troposphere_m2
            }
        };
        measurement.ionosphere_sigma_m = ionosphere_sigma_m;
        measurement.troposphere_sigma_m = troposphere_m2.sqrt();
    }

    /// Receiver noise and multipath of the main signal (m²).
    fn noise_m2(&self, measurement: &Measurement, cn0_db_hz: Option<f64>) -> f64 {
        constellation_factor(measurement.satellite.constellation)
            * self.weights.variance_m2(measurement.look.elevation_rad, cn0_db_hz)
    }

    /// The delay on the main frequency by the chosen model.
    fn ionosphere(&self, measurement: &Measurement, options: &PositioningOptions) -> Delay {
        match options.ionosphere {
            IonosphereModel::None => Delay { delay_m: 0.0, variance_m2: 0.0, fallback: None },
            IonosphereModel::IonosphereFree => {
                Delay { delay_m: 0.0, variance_m2: f64::INFINITY, fallback: None }
            }
            IonosphereModel::Klobuchar => self.klobuchar(measurement, options),
            IonosphereModel::TypicalKlobuchar => self.typical(measurement),
            #[cfg(feature = "nequick")]
            IonosphereModel::NequickG => self.nequick(measurement).unwrap_or_else(|| {
                let stand_in = self.klobuchar(measurement, options);
                Delay { fallback: stand_in.fallback.or(Some("klobuchar")), ..stand_in }
            }),
        }
    }

    /// `None` if Galileo broadcast no coefficients, or if the model gives no delay for this ray.
    #[cfg(feature = "nequick")]
    fn nequick(&self, measurement: &Measurement) -> Option<Delay> {
        let delay_m = nequick_delay_m(
            self.navigation.nequick.as_ref()?,
            measurement.frequency_hz,
            &self.geodetic,
            measurement.state.position,
            self.time,
            &self.navigation.leap_seconds,
        )?;
        Some(Delay { delay_m, variance_m2: nequick_variance_m2(delay_m), fallback: None })
    }

    fn typical(&self, measurement: &Measurement) -> Delay {
        let (place, look) = (&self.geodetic, &measurement.look);
        let delay_m = typical_delay_m(measurement.frequency_hz, place, look, self.time);
        Delay { delay_m, variance_m2: typical_variance_m2(delay_m), fallback: None }
    }

    fn klobuchar(&self, measurement: &Measurement, options: &PositioningOptions) -> Delay {
        let (frequency_hz, look) = (measurement.frequency_hz, &measurement.look);
        let (place, time) = (&self.geodetic, self.time);
        let delay = match options.klobuchar_beidou {
            true => broadcast_delay_m(
                self.navigation,
                measurement.satellite.constellation,
                frequency_hz,
                place,
                look,
                time,
            ),
            false => self
                .navigation
                .klobuchar_gps
                .as_ref()
                .map(|gps| klobuchar_delay_m(gps, frequency_hz, place, look, time)),
        };
        match delay {
            Some(delay_m) => {
                Delay { delay_m, variance_m2: klobuchar_variance_m2(delay_m), fallback: None }
            }
            None => Delay {
                fallback: Some(IonosphereModel::TypicalKlobuchar.name()),
                ..self.typical(measurement)
            },
        }
    }
}

/// The elevation mask in force: the lower one while few satellites are above the upper one.
fn mask_rad(list: &[Measurement], options: &PositioningOptions) -> f64 {
    let high = list.iter().filter(|m| options.elevation_mask_rad <= m.look.elevation_rad).count();
    match high < options.sparse_below {
        true => options.elevation_mask_rad.min(options.sparse_elevation_mask_rad),
        false => options.elevation_mask_rad,
    }
}

/// Least squares for the range g and the delay I of one satellite:
///
/// P₁ = g + I, P₂ − b = g + γI, and the model's I ± its standard deviation.
///
/// With an infinite variance of the model this is the ionosphere-free combination; with infinite
/// noise on P₂ it is the single-frequency correction. Returns g (m), its variance (m²) and the
/// contribution of the model's standard deviation to g (m).
fn dual_frequency_range(
    measurement: &Measurement,
    second: &SecondFrequency,
    bias_m: f64,
) -> (f64, f64, f64) {
    let (first_weight, second_weight) = (measurement.noise_m2.recip(), second.noise_m2.recip());
    let prior = measurement.ionosphere_m2.recip();
    // Relative to P₁, to keep all digits.
    let difference_m = second.pseudorange_m - bias_m - measurement.pseudorange_m;
    let gamma = second.gamma;
    let (gg, gi) = (first_weight + second_weight, first_weight + gamma * second_weight);
    let ii = first_weight + gamma * gamma * second_weight + prior;
    let g = second_weight * difference_m;
    let i = gamma * second_weight * difference_m + prior * measurement.ionosphere_m;
    let determinant = gg * ii - gi * gi;
    let share_m = gi * prior.sqrt() / determinant;
    (measurement.pseudorange_m + (ii * g - gi * i) / determinant, ii / determinant, share_m)
}
