//! The receiver's delays between the frequencies of a satellite.

use crate::gnss::{Constellation, ObservationCode};
use crate::graph::median;
use crate::positioning::pseudorange_error::WILD_M;

use super::{Measurement, SecondFrequency};

/// Receiver delay of each second signal against the main one, by signal.
///
/// b = weighted mean over the satellites of P₂ − P₁ − (γ − 1)·I with the modelled I. An error of
/// the model that is common to all satellites goes into b too, because one epoch cannot separate
/// the two. So the second frequency contributes only how the ionosphere differs from satellite to
/// satellite.
///
/// Where a satellite's value is further than W, the largest delay of multipath, from the median of
/// its signal, one of its pseudoranges is wild. It is no part of the mean, and its second
/// pseudorange is not used.
#[derive(Clone, Debug, Default)]
pub(super) struct InterFrequencyBiases {
    signals: Vec<InterFrequencyBias>,
    /// Scratch of the median.
    numbers: Vec<f64>,
}

#[derive(Clone, Debug)]
struct InterFrequencyBias {
    constellation: Constellation,
    code: ObservationCode,
    /// The value of each satellite (m), with its weight (1/m²).
    values: Vec<(f64, f64)>,
    /// b (m); `None` if it is unknown, as without a model.
    bias_m: Option<f64>,
}

impl InterFrequencyBiases {
    /// Forgets all values.
    pub(super) fn clear(&mut self) {
        self.signals.iter_mut().for_each(|signal| signal.values.clear());
    }

    /// Adds the value of a satellite with a second signal.
    pub(super) fn add(&mut self, measurement: &Measurement) {
        let Some(second) = &measurement.second else { return };
        let slope = second.gamma - 1.0;
        let noise_m2 = measurement.noise_m2 + second.noise_m2;
        let weight = (noise_m2 + slope * slope * measurement.ionosphere_m2).recip();
        let value = (bias_m(measurement, second), weight);
        match self.signals.iter_mut().find(|signal| signal.is_of(measurement, second)) {
            Some(signal) => signal.values.push(value),
            None => self.signals.push(InterFrequencyBias {
                constellation: measurement.satellite.constellation,
                code: second.code,
                values: vec![value],
                bias_m: None,
            }),
        }
    }

    /// Computes b of each signal from the values.
    pub(super) fn settle(&mut self) {
        let Self { signals, numbers } = self;
        for signal in signals {
            numbers.clear();
            numbers.extend(signal.values.iter().map(|(value_m, _)| value_m));
            signal.bias_m = median(numbers).and_then(|middle_m| signal.mean_near(middle_m));
        }
    }

    /// b of a measurement's second signal (m); zero if it is unknown. `None` where one of the
    /// measurement's pseudoranges is wild.
    pub(super) fn of(&self, measurement: &Measurement, second: &SecondFrequency) -> Option<f64> {
        let known = self.signals.iter().find(|signal| signal.is_of(measurement, second));
        let Some(known_m) = known.and_then(|signal| signal.bias_m) else { return Some(0.0) };
        let is_wild = WILD_M < (bias_m(measurement, second) - known_m).abs();
        (!is_wild).then_some(known_m)
    }
}

impl InterFrequencyBias {
    fn is_of(&self, measurement: &Measurement, second: &SecondFrequency) -> bool {
        self.constellation == measurement.satellite.constellation && self.code == second.code
    }

    /// Weighted mean of the values within W of `middle_m`; `None` if they have no weight.
    fn mean_near(&self, middle_m: f64) -> Option<f64> {
        let (mut weight, mut weighted_m) = (0.0, 0.0);
        let is_near = |value_m: f64| (value_m - middle_m).abs() <= WILD_M;
        for (value_m, its_weight) in self.values.iter().filter(|(value_m, _)| is_near(*value_m)) {
            weight += its_weight;
            weighted_m += its_weight * value_m;
        }
        (0.0 < weight).then(|| weighted_m / weight)
    }
}

/// P₂ − P₁ − (γ − 1)·I (m).
fn bias_m(measurement: &Measurement, second: &SecondFrequency) -> f64 {
    let difference_m = second.pseudorange_m - measurement.pseudorange_m;
    difference_m - (second.gamma - 1.0) * measurement.ionosphere_m
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Of four satellites with equal weights one is a millisecond off: the mean of the others is b,
    /// where the mean of all would be 75 km off.
    #[test]
    fn a_wild_value_does_not_count() {
        let signal = |values: &[f64]| InterFrequencyBias {
            constellation: Constellation::Gps,
            code: ObservationCode::parse("2W").unwrap(),
            values: values.iter().map(|value_m| (*value_m, 1.0)).collect(),
            bias_m: None,
        };
        let signals = vec![signal(&[3.0, 5.0, 299_792.458, 7.0]), signal(&[])];
        let mut biases = InterFrequencyBiases { signals, numbers: Vec::new() };
        biases.settle();
        assert_eq!(biases.signals[0].bias_m, Some(5.0));
        assert_eq!(biases.signals[1].bias_m, None);
    }
}
