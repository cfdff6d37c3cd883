//! Inter-system biases of a receiver, estimated from earlier epochs.
//!
//! Clock of constellation c: b_c = B + o_c, B free at each epoch. An epoch whose satellites
//! determine every clock does not use o_c. An epoch with too few satellites uses them, each with
//! its variance p_c. Without any estimate p_c is (1 km)²: phones have 1.5 km between GPS and
//! GLONASS, other receivers some metres.
//!
//! Each epoch with a position gives o_c = b_c − B with the clock's variance v_c, B the weighted
//! mean over the known clocks. Successive errors are correlated, so v_c is multiplied by (1 + ρ)/(1
//! − ρ) (Bartlett 1946). Between epochs p_c grows by the options' random walk. If a clock steps by
//! more than five standard deviations and two satellites show it, its estimate starts again.

use crate::config::GraphOptions;
use crate::gnss::{Constellation, GpsTime};
use crate::positioning::uncertainty::repetition;
use crate::snapshot::{clone_fields, snapshot_fields};

use super::least_squares::{Clock, ClockPrior};

/// Standard deviation of an inter-system bias before any estimate (m).
const UNKNOWN_M: f64 = 1e3;
const UNKNOWN: Bias = Bias { value_m: 0.0, variance_m2: UNKNOWN_M * UNKNOWN_M };
/// Change of a bias that is a step and not noise, in standard deviations.
const STEP_SIGMAS: f64 = 5.0;

/// o_c and p_c of one constellation.
#[derive(Clone, Copy, Debug)]
struct Bias {
    value_m: f64,
    variance_m2: f64,
}

snapshot_fields!(Bias { value_m, variance_m2 });

/// The biases of all constellations.
#[derive(Debug, Default)]
pub(super) struct SystemBiases {
    known: [Option<Bias>; Constellation::COUNT],
    updated: Option<GpsTime>,
}

snapshot_fields!(SystemBiases { known, updated });
clone_fields!(SystemBiases { known, updated });

impl SystemBiases {
    /// Ties that an epoch may use.
    pub(super) fn priors(
        &self,
        time: GpsTime,
        options: &GraphOptions,
    ) -> [ClockPrior; Constellation::COUNT] {
        let grown_m2 = self.growth_m2(time, options);
        self.known.map(|known| {
            let Bias { value_m, variance_m2 } = known.unwrap_or(UNKNOWN);
            ClockPrior {
                bias_m: value_m,
                variance_m2: variance_m2 + grown_m2,
                is_known: known.is_some(),
            }
        })
    }

    /// Whether any bias is known.
    pub(super) fn is_known(&self) -> bool {
        self.updated.is_some()
    }

    /// Updates with the clocks of an epoch that determined them independently, in a fixed order.
    pub(super) fn learn(&mut self, time: GpsTime, clocks: &[Clock], options: &GraphOptions) {
        let grown_m2 = self.growth_m2(time, options);
        let since_s = self.updated.map_or(f64::INFINITY, |updated| time - updated);
        self.known.iter_mut().flatten().for_each(|bias| bias.variance_m2 += grown_m2);
        self.updated = Some(time);
        let (mut information, mut common_m) = (0.0, 0.0);
        let proven = || clocks.iter().filter(|clock| !clock.is_alone);
        for (clock, bias) in
            proven().filter_map(|c| Some((c, self.known[c.constellation.index()]?)))
        {
            let weight = (clock.variance_m2 + bias.variance_m2).recip();
            information += weight;
            common_m += weight * (clock.value_m - bias.value_m);
        }
        if information == 0.0 {
            // No clock in common with the known ones: the first clock is the common one from now
            // on.
            let Some(first) = proven().next() else { return };
            self.known = [None; Constellation::COUNT];
            (information, common_m) = (f64::INFINITY, first.value_m);
        } else {
            common_m /= information;
        }
        let repetition_count = repetition(since_s.max(f64::MIN_POSITIVE), options.correlation_s);
        for clock in clocks {
            let known = &mut self.known[clock.constellation.index()];
            let measured = Bias {
                value_m: clock.value_m - common_m,
                variance_m2: clock.variance_m2 + information.recip(),
            };
            let before = known.unwrap_or(UNKNOWN);
            match (before.agrees(&measured), *known) {
                (true, Some(bias)) => *known = Some(bias.updated(&measured, repetition_count)),
                (true, None) => *known = Some(measured),
                (false, _) if clock.is_alone => {}
                (false, _) => *known = Some(measured),
            }
        }
    }

    fn growth_m2(&self, time: GpsTime, options: &GraphOptions) -> f64 {
        let since_s = self.updated.map_or(0.0, |updated| (time - updated).max(0.0));
        options.bias_walk_m.powi(2) * since_s
    }
}

impl Bias {
    /// Whether a measured bias differs from the estimate by noise only.
    fn agrees(&self, measured: &Self) -> bool {
        let change_m = measured.value_m - self.value_m;
        let variance_m2 = self.variance_m2 + measured.variance_m2;
        change_m * change_m <= STEP_SIGMAS * STEP_SIGMAS * variance_m2
    }

    fn updated(self, measured: &Self, repetition_count: f64) -> Self {
        let gain = self.variance_m2 / (self.variance_m2 + repetition_count * measured.variance_m2);
        Self {
            value_m: self.value_m + gain * (measured.value_m - self.value_m),
            variance_m2: self.variance_m2 * (1.0 - gain),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{Mode, PositioningOptions, Profile};

    fn options() -> GraphOptions {
        PositioningOptions::new(Mode::Spp, Profile::General).graph
    }

    fn clock(name: Constellation, value_m: f64, is_alone: bool) -> Clock {
        Clock { constellation: name, value_m, variance_m2: 4.0, is_alone }
    }

    fn bias_m(biases: &SystemBiases, time: GpsTime) -> (f64, f64) {
        let priors = biases.priors(time, &options());
        let prior = |c: Constellation| priors[c.index()];
        let (gps, beidou) = (prior(Constellation::Gps), prior(Constellation::BeiDou));
        assert!(gps.is_known && beidou.is_known && !prior(Constellation::Galileo).is_known);
        (beidou.bias_m - gps.bias_m, (beidou.variance_m2 + gps.variance_m2).sqrt())
    }

    /// A bias of 1.4 km is found at once, whatever value the common clock has. One satellite moves
    /// it only within its noise; two show that it has stepped.
    #[test]
    fn a_bias_is_learnt_and_followed() {
        use Constellation::{BeiDou, Gps};
        let options = options();
        let mut biases = SystemBiases::default();
        assert!(!biases.is_known());
        let mut time = GpsTime::from_week_seconds(2000, 0.0);
        let mut learn = |gps_m: f64, beidou_m: f64, is_alone: bool| {
            time = time + 1.0;
            let clocks = [clock(BeiDou, beidou_m, is_alone), clock(Gps, gps_m, false)];
            biases.learn(time, &clocks, &options);
            bias_m(&biases, time)
        };
        let (first_m, first_sigma_m) = learn(3e5, 3e5 + 1_400.0, false);
        assert!((first_m - 1_400.0).abs() < 1e-6 && first_sigma_m < 4.0, "{first_m}");
        let (second_m, second_sigma_m) = learn(-2e5, -2e5 + 1_401.0, true);
        assert!((1_400.0..1_401.0).contains(&second_m) && second_sigma_m < first_sigma_m);
        let (wild_m, _) = learn(0.0, 3e5, true);
        assert!((wild_m - second_m).abs() < 1e-6, "{wild_m}");
        let (stepped_m, _) = learn(0.0, 500.0, false);
        assert!((stepped_m - 500.0).abs() < 500.0, "{stepped_m}");
    }
}
