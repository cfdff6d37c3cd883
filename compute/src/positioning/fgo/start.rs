//! The start of the solve after an epoch is added.
//!
//! Robust kernels have many minima, so the start decides which one is found. Extrapolation by the
//! last velocity over some seconds is wrong by tens of metres if the receiver has braked or turned.
//! The epoch's own Doppler gives its velocity, and so the displacement.

use nalgebra::{Matrix4, Vector4};

use crate::config::GraphOptions;
use crate::graph::{HUBER_WIDTH, Kernel};
use crate::positioning::clock_jump::CRYSTAL_DRIFT_M_S;
use crate::positioning::factors::{CLOCK, ComponentFactor, DRIFT, DopplerFactor, State, VELOCITY};
use crate::positioning::starts::{START_CLOCK_M, START_M, START_M_S};

use super::epoch::Factors;

/// Minimum number of Doppler measurements: two more than the unknowns, so that an outlier is
/// visible.
const RATES_MIN: usize = 6;
/// Iterations of reweighted least squares.
const ITERATIONS: usize = 10;

/// Largest standard deviation of a precise start (m): that of the best pseudoranges.
const PRECISE_M: f64 = 1.0;

/// Sets the velocity of `guess` from the epoch's own Doppler. Its position follows from the mean of
/// that velocity and the velocity of `before`, `interval_s` earlier. Returns whether Doppler
/// determines the velocity.
pub(super) fn follow_doppler(
    guess: &mut State,
    before: &State,
    interval_s: f64,
    rates: &[DopplerFactor],
) -> bool {
    let Some(rate) = velocity_and_drift(rates, guess) else { return false };
    for axis in 0..3 {
        let mean_m_s = 0.5 * (before[VELOCITY + axis] + rate[axis]);
        guess[axis] = before[axis] + interval_s * mean_m_s;
        guess[VELOCITY + axis] = rate[axis];
    }
    guess[DRIFT] = rate[3];
    true
}

/// Whether a start is precise, from the velocity before it and, if `follows`, its own. White
/// acceleration of q = `velocity_walk` (m/s/√s) leaves the position q·√(Δt³/3), and q·√(Δt³/12)
/// between two known velocities.
pub(super) fn is_precise(interval_s: f64, follows: bool, velocity_walk: f64) -> bool {
    let parts = if follows { 12.0 } else { 3.0 };
    velocity_walk * (interval_s.powi(3) / parts).sqrt() <= PRECISE_M
}

/// Velocity and drift (m/s) by least squares with Huber's weights; `None` if the Doppler
/// measurements do not determine them.
fn velocity_and_drift(rates: &[DopplerFactor], start: &State) -> Option<Vector4<f64>> {
    if rates.len() < RATES_MIN {
        return None;
    }
    let (huber, mut state) = (Kernel::huber(HUBER_WIDTH), *start);
    for iteration in 0..ITERATIONS {
        let (mut normal, mut right) = (Matrix4::zeros(), Vector4::zeros());
        for rate in rates {
            let row = rate.linearize(&state);
            let weight = if iteration == 0 { 1.0 } else { huber.weight(row.residual) };
            let slope = Vector4::from(row.jacobian);
            normal += slope * slope.transpose() * weight;
            right -= slope * (row.residual * weight);
        }
        let step = normal.cholesky()?.solve(&right);
        (0..3).for_each(|axis| state[VELOCITY + axis] += step[axis]);
        state[DRIFT] += step[3];
    }
    Some(Vector4::new(state[VELOCITY], state[VELOCITY + 1], state[VELOCITY + 2], state[DRIFT]))
}

/// Adds the priors on single components of a state.
pub(super) fn regularize(
    factors: &mut Factors,
    is_first: bool,
    guess: &State,
    options: &GraphOptions,
) {
    let mut add = |column: usize, mean: f64, sigma: f64| {
        factors.components.push(ComponentFactor { column, mean, inverse_sigma: sigma.recip() });
    };
    if is_first {
        (0..3).for_each(|axis| add(axis, guess[axis], START_M));
    }
    if is_first || !options.motion {
        (VELOCITY..CLOCK).for_each(|rate| add(rate, guess[rate], START_M_S));
        add(CLOCK, guess[CLOCK], START_CLOCK_M);
        add(DRIFT, guess[DRIFT], CRYSTAL_DRIFT_M_S);
    }
    if options.vertical_velocity_m_s.is_finite() {
        add(VELOCITY + 2, 0.0, options.vertical_velocity_m_s);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gnss::{Ecef, LocalFrame};
    use crate::models::SatelliteState;
    use nalgebra::Vector3;

    const RADIUS_M: f64 = 6_378_137.0;

    /// Doppler of seven satellites around a receiver with this velocity and drift (m/s), the first
    /// of them `wrong_m_s` off.
    fn rates(velocity_m_s: Vector3<f64>, drift_m_s: f64, wrong_m_s: f64) -> Vec<DopplerFactor> {
        let receiver = Ecef::new(RADIUS_M, 0.0, 0.0);
        let frame = LocalFrame::at(receiver);
        let rate = |index: usize| {
            let (azimuth, elevation): (f64, f64) = (0.9 * index as f64, [0.2, 1.2, 0.6][index % 3]);
            let e = Vector3::new(
                azimuth.sin() * elevation.cos(),
                azimuth.cos() * elevation.cos(),
                elevation.sin(),
            );
            let satellite = SatelliteState {
                position: Ecef(receiver.0 + frame.rotation.transpose() * e * 2e7),
                velocity_m_s: Vector3::zeros(),
                clock_m: 0.0,
                clock_drift_m_s: 0.0,
                variance_m2: 0.0,
            };
            let at_rest = DopplerFactor::new(&frame, receiver, &satellite, 0.0, 1.0);
            let still = at_rest.linearize(&State::zeros()).residual;
            let wrong_m_s = if index == 0 { wrong_m_s } else { 0.0 };
            let measured_m_s = still - e.dot(&velocity_m_s) + drift_m_s + wrong_m_s;
            DopplerFactor::new(&frame, receiver, &satellite, measured_m_s, 0.05)
        };
        (0..7).map(rate).collect()
    }

    /// From 10 m/s east to a stop within 4 s the displacement is 20 m, not 40 m.
    #[test]
    fn a_start_follows_the_brakes() {
        let mut before = State::zeros();
        before[VELOCITY] = 10.0;
        let mut guess = before;
        guess[0] = 40.0;
        assert!(follow_doppler(&mut guess, &before, 4.0, &rates(Vector3::zeros(), 3.0, 0.0)));
        assert!((guess[0] - 20.0).abs() < 0.1 && guess[VELOCITY].abs() < 0.05, "{guess}");
        assert!((guess[DRIFT] - 3.0).abs() < 0.05, "{guess}");
    }

    /// One Doppler 2 m/s (40 σ) off moves the velocity by less than 0.6 m/s. With five Doppler
    /// measurements the start is not changed.
    #[test]
    fn a_wrong_doppler_shift_is_bounded() {
        let before = State::zeros();
        let mut guess = before;
        let rates = rates(Vector3::zeros(), 0.0, 2.0);
        assert!(follow_doppler(&mut guess, &before, 1.0, &rates));
        assert!(guess.fixed_rows::<3>(VELOCITY).norm() < 0.6, "{guess}");
        let mut guess = before;
        assert!(!follow_doppler(&mut guess, &before, 1.0, &rates[..5]));
        assert_eq!(guess, before);
    }

    /// With 2 m/s/√s: 0.58 m in 1 s between two velocities, 1.15 m after one, 1.63 m in 2 s.
    #[test]
    fn a_start_is_precise_for_about_a_second() {
        assert!(is_precise(1.0, true, 2.0) && is_precise(0.2, false, 2.0));
        assert!(!is_precise(1.0, false, 2.0) && !is_precise(2.0, true, 2.0));
    }
}
