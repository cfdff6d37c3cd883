//! Code biases: the delay of one ranging code against another of the same carrier, by satellite.
//!
//! Where rover and base track different codes of one carrier, such as P1 and C1, single differences
//! of pseudoranges contain a bias for each satellite. It changes by less than 6 cm in five months
//! (the IGS's mean values of P1 − C1, Ray 2005, IGSMAIL-5078), so it is estimated as a constant,
//! from fixed positions. The part that all satellites share belongs to the group's offset.

use crate::gnss::{ObservationCode, SatelliteId};
use crate::positioning::differencing::SingleDifference;
use crate::snapshot::{snapshot_fields, state_fields};

/// Standard deviation before anything is learnt (m): RTKLIB's `ERR_CBIAS`; the IGS's 30 values have
/// 0.28.
const PRIOR_M: f64 = 0.3;
/// Least standard deviation (m): multipath that repeats every day.
const LEAST_M: f64 = 0.05;
/// Pseudoranges with a residual beyond this many standard deviations are not learnt from.
const GROSS_SIGMAS: f64 = 3.0;
/// Most biases kept; further ones stay at their prior.
const BIASES_MAX: usize = 1024;

/// The bias of one satellite between two codes, as far as it is known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct CodeBias {
    satellite: SatelliteId,
    /// Codes at rover and base.
    codes: [ObservationCode; 2],
    /// Rover minus base (m).
    pub(crate) bias_m: f64,
    /// (m²).
    pub(crate) variance_m2: f64,
}

snapshot_fields!(CodeBias { satellite, codes, bias_m, variance_m2 });

/// All biases that have occurred.
#[derive(Debug, Default)]
pub(crate) struct CodeBiases {
    list: Vec<CodeBias>,
}

state_fields!(CodeBiases { list });

impl CodeBiases {
    /// The bias of a difference, which begins if it is new, and its index. There is no index if
    /// both codes are the same or the list is full.
    pub(crate) fn find_or_begin(
        &mut self,
        difference: &SingleDifference,
    ) -> (CodeBias, Option<usize>) {
        let SingleDifference { satellite, codes, .. } = *difference;
        if difference.shares_code {
            return (CodeBias { satellite, codes, bias_m: 0.0, variance_m2: 0.0 }, None);
        }
        let is_it = |bias: &CodeBias| (bias.satellite, bias.codes) == (satellite, codes);
        if let Some(index) = self.list.iter().position(is_it) {
            return (self.list[index], Some(index));
        }
        let new = CodeBias { satellite, codes, bias_m: 0.0, variance_m2: PRIOR_M.powi(2) };
        if BIASES_MAX <= self.list.len() {
            return (new, None);
        }
        self.list.push(new);
        (new, Some(self.list.len() - 1))
    }

    /// Updates the bias at `index` from one pseudorange. `excess_m` is its corrected value minus
    /// the range to a known position (m), `variance_m2` the variance of that difference, including
    /// the variance of the bias (m²). `independent_share` is the fraction of its information that
    /// is independent.
    pub(crate) fn learn(
        &mut self,
        index: usize,
        excess_m: f64,
        variance_m2: f64,
        independent_share: f64,
    ) {
        let Some(bias) = self.list.get_mut(index) else { return };
        if GROSS_SIGMAS.powi(2) * variance_m2 < excess_m.powi(2) {
            return;
        }
        let noise_m2 = (variance_m2 - bias.variance_m2).max(0.0) / independent_share;
        let gain = bias.variance_m2 / (bias.variance_m2 + noise_m2);
        bias.bias_m += gain * excess_m;
        bias.variance_m2 = (bias.variance_m2 * (1.0 - gain)).max(LEAST_M.powi(2));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gnss::{Band, Constellation};

    fn difference(number: u8) -> SingleDifference {
        SingleDifference {
            common: 0,
            satellite: SatelliteId::new(Constellation::Gps, number).unwrap(),
            band: Band::L1,
            codes: ["1W", "1C"].map(|code| ObservationCode::parse(code).unwrap()),
            shares_code: false,
            frequency_hz: 1_575.42e6,
            pseudorange: None,
            carrier: None,
            half_cycle: false,
        }
    }

    /// With a prior of 0.3 m and one pseudorange of the same σ that is 0.4 m long, the bias is half
    /// of it. One outlier of 3 m changes nothing. After many equal residuals σ is 5 cm.
    #[test]
    fn biases_are_learnt() {
        let mut biases = CodeBiases::default();
        let (bias, index) = biases.find_or_begin(&difference(7));
        assert_eq!((bias.bias_m, bias.variance_m2, index), (0.0, 0.09, Some(0)));
        biases.learn(0, 0.4, 0.18, 1.0);
        let (bias, _) = biases.find_or_begin(&difference(7));
        assert!((bias.bias_m - 0.2).abs() < 1e-12 && (bias.variance_m2 - 0.045).abs() < 1e-12);
        biases.learn(0, 3.0, 0.18, 1.0);
        assert_eq!(biases.find_or_begin(&difference(7)).0, bias);
        for _ in 0..1000 {
            let (known, _) = biases.find_or_begin(&difference(7));
            biases.learn(0, 0.4 - known.bias_m, known.variance_m2 + 0.09, 0.5);
        }
        let (bias, _) = biases.find_or_begin(&difference(7));
        assert!((bias.bias_m - 0.4).abs() < 0.01, "{bias:?}");
        assert_eq!(bias.variance_m2, 0.05 * 0.05);
        assert_eq!(biases.find_or_begin(&difference(8)).1, Some(1));
        assert_eq!(biases.find_or_begin(&difference(7)).1, Some(0));
        let alike = SingleDifference { shares_code: true, ..difference(9) };
        let (bias, index) = biases.find_or_begin(&alike);
        assert_eq!((bias.variance_m2, index), (0.0, None));
    }

    #[test]
    fn what_is_kept_is_bounded() {
        let mut biases = CodeBiases::default();
        let mut codes = (0..=BIASES_MAX).map(|k| {
            let letter = |k: usize| b'A' + (k % 26) as u8;
            let code = |band: usize, k: usize| ObservationCode::new(b'1' + band as u8, letter(k));
            [code(k / 676, k / 26), code(0, k)].map(Option::unwrap)
        });
        let mut index = |biases: &mut CodeBiases| {
            biases
                .find_or_begin(&SingleDifference { codes: codes.next().unwrap(), ..difference(1) })
                .1
        };
        for k in 0..BIASES_MAX {
            assert_eq!(index(&mut biases), Some(k));
        }
        assert_eq!(index(&mut biases), None);
    }
}
