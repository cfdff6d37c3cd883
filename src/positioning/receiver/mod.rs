//! What a receiver's own data tell of its noise and its clocks, learnt as epochs pass.
//!
//! Receivers differ by more than any table of defaults: in how C/N0 is stated, in the noise of
//! Doppler and phase, in how long multipath lasts, and in whether code, phase and Doppler share one
//! clock. [`ReceiverModel`] starts from priors that cover all of them and narrows with the
//! residuals of the newest epoch. What is learnt fades with a time constant of five minutes, so
//! that it follows a change of surroundings.
//!
//! | part | learns | from |
//! |---|---|---|
//! | [`CodeNoise`] | C/N0 at which half the signals are reflected | pseudorange residuals |
//! | [`NoiseScale`] | factor on the stated noise of Doppler, of phase | their residuals |
//! | [`ErrorMemory`] | how long pseudorange errors last | pseudorange residuals |
//! | [`ClockCoupling`] | how clocks move apart | code minus phase, code minus Doppler |
//! | [`VerticalSpeed`] | how fast the receiver climbs and sinks | the estimate itself |
//! | [`RepeatedRates`] | Doppler values that repeat the last ones | Doppler |

mod clock_coupling;
mod code_noise;
mod error_memory;
mod grid;
mod noise_scale;
mod repeated_rates;
mod vertical_speed;

use nalgebra::SMatrix;

use crate::snapshot::state_fields;

use super::Measurement;
use super::code_error::CodeError;
use super::factors::{ClockTie, STATE, State};

use clock_coupling::ClockCoupling;
use code_noise::CodeNoise;
use error_memory::ErrorMemory;
use noise_scale::NoiseScale;
use repeated_rates::RepeatedRates;
use vertical_speed::VerticalSpeed;

pub(super) use code_noise::{CodeResidual, Signal, common_ionosphere_m};

/// Time constant with which what is learnt fades (s): streets change within some minutes.
const FADING_S: f64 = 300.0;

/// Interval at which the level of C/N0 is learnt (s): residuals closer than this are one.
const LEARNING_S: f64 = 0.9;

/// The share of what is known that is left after an interval (s).
fn kept(interval_s: f64) -> f64 {
    (-interval_s / FADING_S).exp()
}

/// What is known of one receiver.
#[derive(Debug, Default)]
pub(super) struct ReceiverModel {
    code: CodeNoise,
    doppler: NoiseScale,
    phase: NoiseScale,
    memory: ErrorMemory,
    clocks: ClockCoupling,
    vertical: VerticalSpeed,
    rates: RepeatedRates,
    /// Since the level of C/N0 was learnt last (s).
    unlearnt_s: f64,
}

state_fields!(ReceiverModel { code, doppler, phase, memory, clocks, vertical, rates, unlearnt_s });

/// What the solved newest epoch left.
#[derive(Clone, Copy, Debug)]
pub(super) struct PostFit<'a> {
    /// Since the epoch before (s).
    pub(super) interval_s: f64,
    /// Of the pseudoranges.
    pub(super) code: &'a [CodeResidual],
    /// Of Doppler, over the standard deviation in force.
    pub(super) doppler: &'a [f64],
    /// Of phase differences, over the standard deviation in force, the clock's step taken out.
    pub(super) phase: &'a [f64],
    /// Of the newest epoch.
    pub(super) state: &'a State,
    /// Its formal covariance.
    pub(super) covariance: &'a SMatrix<f64, STATE, STATE>,
}

impl ReceiverModel {
    /// Compares an epoch with the one before, `interval_s` earlier, before it is solved.
    pub(super) fn observe(&mut self, list: &[Measurement], interval_s: Option<f64>) {
        self.clocks.observe(list, interval_s);
        self.rates.observe(list);
    }

    /// Takes in the residuals of the newest epoch.
    pub(super) fn learn(&mut self, fit: &PostFit<'_>) {
        self.unlearnt_s += fit.interval_s;
        if LEARNING_S <= self.unlearnt_s {
            let share = self.independent_share(self.unlearnt_s);
            self.code.learn(self.unlearnt_s, share, fit.code);
            self.unlearnt_s = 0.0;
        }
        self.memory.learn(fit.interval_s, fit.code);
        self.doppler.learn(fit.interval_s, fit.doppler);
        self.phase.learn(fit.interval_s, fit.phase);
        self.vertical.learn(fit.interval_s, fit.state, fit.covariance);
    }

    /// Error model of a pseudorange.
    pub(super) fn code_error(&self, signal: &Signal) -> CodeError {
        self.code.error(signal)
    }

    /// Share of independent information in a pseudorange that follows one of the same satellite
    /// after `spacing_s`.
    pub(super) fn independent_share(&self, spacing_s: f64) -> f64 {
        self.memory.independent_share(spacing_s)
    }

    /// Factor on the stated standard deviation of Doppler.
    pub(super) fn doppler_scale(&self) -> f64 {
        self.doppler.value()
    }

    /// Factor on the stated standard deviation of phase differences.
    pub(super) fn phase_scale(&self) -> f64 {
        self.phase.value()
    }

    /// How the code's clock moves against the integral of the Doppler's drift in `interval_s`.
    pub(super) fn code_against_doppler(&self, interval_s: f64) -> ClockTie {
        self.clocks.code_against_doppler(interval_s)
    }

    /// How the phase's clock moves against the code's in `interval_s`.
    pub(super) fn phase_against_code(&self, interval_s: f64) -> ClockTie {
        self.clocks.phase_against_code(interval_s)
    }

    /// Standard deviation of the vertical velocity of one epoch, `spacing_s` after the last (m/s).
    pub(super) fn vertical_sigma_m_s(&self, spacing_s: f64) -> f64 {
        self.vertical.sigma_m_s(spacing_s)
    }

    /// Whether the Doppler of a measurement of the epoch observed last repeats the one before.
    pub(super) fn repeats_rate(&self, measurement: &Measurement) -> bool {
        self.rates.repeats(measurement)
    }
}
