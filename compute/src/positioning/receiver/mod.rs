//! Noise and clocks of a receiver, estimated from its own data.
//!
//! Receivers differ by more than any table of defaults: in how they report C/N0, in the noise of
//! Doppler and phase, in how long multipath lasts, and in whether pseudorange, phase and Doppler
//! follow one clock. [`ReceiverModel`] starts from priors that cover all of them and narrows with
//! the residuals of each epoch. Its evidence fades with a time constant of five minutes, so that it
//! follows a change of surroundings.
//!
//! | part | learns | from |
//! |---|---|---|
//! | [`PseudorangeNoise`] | C/N0 at which half the signals are reflected | pseudorange residuals |
//! | [`NoiseScale`] | factor on the stated noise of Doppler and of phase | their residuals |
//! | [`ErrorMemory`] | how long pseudorange errors last | pseudorange residuals |
//! | [`ClockCoupling`] | how clocks move apart | pseudorange minus phase and minus Doppler |
//! | [`VerticalSpeed`] | how fast the receiver climbs and sinks | the estimate itself |
//! | [`RepeatedRates`] | Doppler values that repeat the last ones | Doppler |

mod clock_coupling;
mod error_memory;
mod grid;
mod noise_scale;
mod pseudorange_noise;
mod repeated_rates;
mod vertical_speed;

use nalgebra::SMatrix;

use crate::gnss::{Constellation, GpsTime};
use crate::snapshot::state_fields;

use super::Measurement;
use super::factors::{ClockStepPrior, STATE, State};
use super::pseudorange_error::PseudorangeError;

use clock_coupling::ClockCoupling;
use error_memory::ErrorMemory;
use noise_scale::NoiseScale;
use pseudorange_noise::PseudorangeNoise;
use repeated_rates::RepeatedRates;
pub(super) use vertical_speed::VerticalPrior;
use vertical_speed::VerticalSpeed;

pub(super) use pseudorange_noise::{
    PseudorangeExcess, Signal, common_ionosphere_m, error_before_learning,
    reflected_before_learning,
};

/// Time constant with which the evidence fades (s): streets change within some minutes.
const FADING_S: f64 = 300.0;

/// Interval at which the level of C/N0 is updated (s): residuals closer in time are not
/// independent.
const LEARNING_S: f64 = 0.9;

/// Interval that counts for the first epoch (s): that of most receivers.
const FIRST_S: f64 = 1.0;

/// The fraction of the evidence that is left after an interval (s).
fn kept(interval_s: f64) -> f64 {
    (-interval_s / FADING_S).exp()
}

/// Estimated properties of one receiver.
#[derive(Debug, Default)]
pub(super) struct ReceiverModel {
    pseudorange: PseudorangeNoise,
    doppler: NoiseScale,
    phase: NoiseScale,
    memory: ErrorMemory,
    clocks: ClockCoupling,
    vertical: VerticalSpeed,
    rates: RepeatedRates,
    /// Time of the last epoch observed.
    observed: Option<GpsTime>,
    /// Time of the last epoch learnt from.
    learnt: Option<GpsTime>,
    /// Time since the level of C/N0 was last updated (s).
    unlearnt_s: f64,
}

state_fields!(ReceiverModel {
    pseudorange,
    doppler,
    phase,
    memory,
    clocks,
    vertical,
    rates,
    observed,
    learnt,
    unlearnt_s,
});

/// Residuals and state of the newest epoch after the solve.
#[derive(Clone, Copy, Debug)]
pub(super) struct PostFit<'a> {
    /// Its time.
    pub(super) time: GpsTime,
    /// Residuals of the pseudoranges.
    pub(super) pseudorange: &'a [PseudorangeExcess],
    /// Residuals of Doppler over the standard deviation in force.
    pub(super) doppler: &'a [f64],
    /// Residuals of phase differences over the standard deviation in force, without the clock's
    /// step.
    pub(super) phase: &'a [f64],
    /// State of the newest epoch.
    pub(super) state: &'a State,
    /// Its formal covariance.
    pub(super) covariance: &'a SMatrix<f64, STATE, STATE>,
}

impl ReceiverModel {
    /// Compares an epoch with the one before, before it is solved. An epoch with which a second
    /// chain begins is not compared again: all its Doppler values would repeat.
    pub(super) fn observe(&mut self, time: GpsTime, list: &[Measurement]) {
        if self.observed == Some(time) {
            return;
        }
        let interval_s = self.observed.map(|before| time - before).filter(|s| 0.0 < *s);
        self.clocks.observe(list, interval_s);
        self.rates.observe(list);
        self.observed = Some(time);
    }

    /// Updates with the residuals of the newest epoch.
    pub(super) fn learn(&mut self, fit: &PostFit<'_>) {
        let interval_s = self.learnt.map_or(FIRST_S, |before| (fit.time - before).max(0.0));
        self.learnt = Some(fit.time);
        self.unlearnt_s += interval_s;
        if LEARNING_S <= self.unlearnt_s {
            let share = self.independent_share(self.unlearnt_s);
            self.pseudorange.learn(self.unlearnt_s, share, fit.pseudorange);
            self.unlearnt_s = 0.0;
        }
        self.memory.learn(interval_s, fit.pseudorange);
        self.doppler.learn(interval_s, fit.doppler);
        self.phase.learn(interval_s, fit.phase);
        self.vertical.learn(interval_s, fit.state, fit.covariance);
    }

    /// Error model of a pseudorange.
    pub(super) fn pseudorange_error(
        &self,
        constellation: Constellation,
        signal: &Signal,
    ) -> PseudorangeError {
        self.pseudorange.error(constellation, signal)
    }

    /// Forgets the noise of pseudoranges, which was learnt at a wrong position.
    pub(super) fn forget_pseudorange_noise(&mut self) {
        self.pseudorange = PseudorangeNoise::default();
    }

    /// Independent share of a pseudorange's information, `spacing_s` after the last pseudorange of
    /// the same satellite.
    pub(super) fn independent_share(&self, spacing_s: f64) -> f64 {
        self.memory.independent_share(spacing_s)
    }

    /// Factor on the a-priori standard deviation of Doppler.
    pub(super) fn doppler_scale(&self) -> f64 {
        self.doppler.value()
    }

    /// Factor on the a-priori standard deviation of phase differences.
    pub(super) fn phase_scale(&self) -> f64 {
        self.phase.value()
    }

    /// Prior of the step of the pseudoranges' clock over `interval_s`, against the integral of the
    /// Doppler's drift.
    pub(super) fn pseudorange_against_doppler(&self, interval_s: f64) -> ClockStepPrior {
        self.clocks.pseudorange_against_doppler(interval_s)
    }

    /// Prior of the step of the phases' clock against the pseudoranges' over `interval_s`.
    pub(super) fn phase_against_pseudorange(&self, interval_s: f64) -> ClockStepPrior {
        self.clocks.phase_against_pseudorange(interval_s)
    }

    /// The prior of one epoch's vertical velocity, `spacing_s` after the last.
    pub(super) fn vertical_prior(&self, spacing_s: f64) -> VerticalPrior {
        self.vertical.prior(spacing_s)
    }

    /// Whether the newest Doppler of a measurement's signal repeats the value before.
    pub(super) fn repeats_rate(&self, measurement: &Measurement) -> bool {
        self.rates.repeats(measurement)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn learn(model: &mut ReceiverModel, time: GpsTime, doppler: &[f64]) {
        let (state, covariance) = (State::zeros(), SMatrix::identity());
        model.learn(&PostFit {
            time,
            pseudorange: &[],
            doppler,
            phase: &[],
            state: &state,
            covariance: &covariance,
        });
    }

    /// Eight Doppler residuals of four standard deviations an epoch raise their factor. After 20
    /// time constants without an epoch it is that of the prior, to e⁻²⁰ of the evidence.
    #[test]
    fn evidence_fades_over_a_pause() {
        let (mut model, start) = (ReceiverModel::default(), GpsTime::EPOCH);
        let before = model.doppler_scale();
        for second in 0..300 {
            let z = 4.0 / model.doppler_scale();
            learn(&mut model, start + f64::from(second), &[z, -z, z, -z, z, -z, z, -z]);
        }
        assert!(1.5 * before < model.doppler_scale(), "{}", model.doppler_scale());
        learn(&mut model, start + (299.0 + 20.0 * FADING_S), &[]);
        assert!((model.doppler_scale() / before - 1.0).abs() < 1e-3, "{}", model.doppler_scale());
    }
}
