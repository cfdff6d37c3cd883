//! What satellites delay two ranging codes of one carrier differently.
//!
//! Where rover and base track different codes of one carrier, such as P1 and C1, single differences
//! of pseudoranges carry a bias of each satellite. It changes by less than 6 cm in five months (the
//! IGS's mean values of P1 − C1, Ray 2005, IGSMAIL-5078), so that positions with integers held tell
//! it once for all that follows. What all satellites share is the group's offset.

use crate::gnss::{ObservationCode, SatelliteId};
use crate::positioning::differencing::SingleDifference;
use crate::snapshot::{snapshot_fields, state_fields};

/// Standard deviation before any is seen (m): RTKLIB's `ERR_CBIAS`; the IGS's 30 values have 0.28.
const PRIOR_M: f64 = 0.3;
/// At the least (m): what multipath that comes again each day leaves.
const LEAST_M: f64 = 0.05;
/// A pseudorange that misses by more standard deviations tells nothing.
const GROSS_SIGMAS: f64 = 3.0;
/// Biases held; those beyond them stay as uncertain as at first.
const HELD_MAX: usize = 1024;

/// The bias of one satellite between two codes, as far as it is known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct CodeBias {
    satellite: SatelliteId,
    /// Codes at rover and base.
    codes: [ObservationCode; 2],
    /// Rover less base (m).
    pub(super) bias_m: f64,
    /// (m²).
    pub(super) variance_m2: f64,
}

snapshot_fields!(CodeBias { satellite, codes, bias_m, variance_m2 });

/// All that were met.
#[derive(Debug, Default)]
pub(super) struct CodeBiases {
    list: Vec<CodeBias>,
}

state_fields!(CodeBiases { list });

impl CodeBiases {
    /// The bias of a difference and, where its codes differ, its place, if there is one left.
    pub(super) fn of(&mut self, difference: &SingleDifference) -> (CodeBias, Option<usize>) {
        let SingleDifference { satellite, codes, .. } = *difference;
        if difference.shares_code {
            return (CodeBias { satellite, codes, bias_m: 0.0, variance_m2: 0.0 }, None);
        }
        let is_it = |bias: &CodeBias| (bias.satellite, bias.codes) == (satellite, codes);
        if let Some(place) = self.list.iter().position(is_it) {
            return (self.list[place], Some(place));
        }
        let new = CodeBias { satellite, codes, bias_m: 0.0, variance_m2: PRIOR_M.powi(2) };
        if HELD_MAX <= self.list.len() {
            return (new, None);
        }
        self.list.push(new);
        (new, Some(self.list.len() - 1))
    }

    /// Takes what a pseudorange, corrected for the bias at `place`, is longer than the range to a
    /// position that is known (m); its variance, the bias's own included (m²); and the share of it
    /// that is new, since errors last.
    pub(super) fn learn(&mut self, place: usize, excess_m: f64, variance_m2: f64, share: f64) {
        let Some(bias) = self.list.get_mut(place) else { return };
        if GROSS_SIGMAS.powi(2) * variance_m2 < excess_m.powi(2) {
            return;
        }
        let noise_m2 = (variance_m2 - bias.variance_m2).max(0.0) / share;
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
            rover_lost_lock: false,
            half_cycle: false,
        }
    }

    /// A prior of 0.3 m and a pseudorange as uncertain, 0.4 m long: half of it is the bias. One 3 m
    /// off says nothing; many alike leave 5 cm.
    #[test]
    fn biases_are_learnt() {
        let mut biases = CodeBiases::default();
        let (bias, place) = biases.of(&difference(7));
        assert_eq!((bias.bias_m, bias.variance_m2, place), (0.0, 0.09, Some(0)));
        biases.learn(0, 0.4, 0.18, 1.0);
        let (bias, _) = biases.of(&difference(7));
        assert!((bias.bias_m - 0.2).abs() < 1e-12 && (bias.variance_m2 - 0.045).abs() < 1e-12);
        biases.learn(0, 3.0, 0.18, 1.0);
        assert_eq!(biases.of(&difference(7)).0, bias);
        for _ in 0..1000 {
            let (known, _) = biases.of(&difference(7));
            biases.learn(0, 0.4 - known.bias_m, known.variance_m2 + 0.09, 0.5);
        }
        let (bias, _) = biases.of(&difference(7));
        assert!((bias.bias_m - 0.4).abs() < 0.01, "{bias:?}");
        assert_eq!(bias.variance_m2, 0.05 * 0.05);
        assert_eq!(biases.of(&difference(8)).1, Some(1));
        assert_eq!(biases.of(&difference(7)).1, Some(0));
        let alike = SingleDifference { shares_code: true, ..difference(9) };
        let (bias, place) = biases.of(&alike);
        assert_eq!((bias.variance_m2, place), (0.0, None));
    }

    #[test]
    fn what_is_held_is_bounded() {
        let mut biases = CodeBiases::default();
        let mut codes = (0..=HELD_MAX).map(|k| {
            let letter = |k: usize| b'A' + (k % 26) as u8;
            let code = |band: usize, k: usize| ObservationCode::new(b'1' + band as u8, letter(k));
            [code(k / 676, k / 26), code(0, k)].map(Option::unwrap)
        });
        let mut place = |biases: &mut CodeBiases| {
            biases.of(&SingleDifference { codes: codes.next().unwrap(), ..difference(1) }).1
        };
        for k in 0..HELD_MAX {
            assert_eq!(place(&mut biases), Some(k));
        }
        assert_eq!(place(&mut biases), None);
    }
}
