//! Detection of a receiver at rest, by a test on Doppler.
//!
//! A receiver at rest measures the range rate ρ̇₀ + d for every satellite, with one drift d.
//! Reflected signals do so too, since the reflectors are at rest. With d the weighted mean of z −
//! ρ̇₀, the sum Σ (z − ρ̇₀ − d)²/σ² is chi-square with n − 1 degrees of freedom. Above its limit
//! the receiver moves. At rest 5 % of the seconds have an epoch above the limit, at any rate of
//! epochs. Below the limit the receiver is at rest only if a slow motion would be
//! visible: 0.3 m/s in any horizontal direction must raise the sum by 25, five standard deviations:
//! Σ (eᵀ(g − ḡ))²·v²/σ² for g = ∂ρ̇/∂v.

use nalgebra::{Matrix2, Vector2};

use crate::snapshot::snapshot_fields;

use super::chi_square::probability_above;
use super::factors::{DopplerFactor, State};

/// Probability that some epoch of a second at rest fails the test.
const FALSE_ALARM: f64 = 0.05;
/// The speed that must be visible (m/s), and the increase of the sum at which it is visible.
const VISIBLE_M_S: f64 = 0.3;
const VISIBLE_INCREASE: f64 = 25.0;
/// Time for which every epoch must pass the test (s). Between epochs further apart the receiver may
/// have moved.
const STILL_S: f64 = 2.0;

/// Time for which the epochs have passed the test.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Standstill {
    /// Time since the first epoch that passed (s).
    still_s: Option<f64>,
}

snapshot_fields!(Standstill { still_s });

/// Whether the rates of one epoch fit a receiver at rest, and would not fit a slow motion. At rest
/// the epoch fails with the probability that a second of epochs at this interval requires.
fn passes(rates: &[DopplerFactor], interval_s: f64) -> bool {
    if rates.len() < 2 {
        return false;
    }
    let rows = || rates.iter().map(|rate| rate.linearize(&State::zeros()));
    let (mut weight, mut weighted_rates, mut mean) = (0.0, 0.0, Vector2::zeros());
    for row in rows() {
        let [east, north, _, w] = row.jacobian;
        weight += w * w;
        weighted_rates -= w * row.residual;
        mean += Vector2::new(east, north) * w;
    }
    let (drift_m_s, mean) = (weighted_rates / weight, mean / weight);
    let (mut squares, mut visibility) = (0.0, Matrix2::zeros());
    for row in rows() {
        let [east, north, _, w] = row.jacobian;
        squares += (row.residual + w * drift_m_s).powi(2);
        let slope = Vector2::new(east, north) - mean * w;
        visibility += slope * slope.transpose();
    }
    let (half_trace, determinant) = (0.5 * visibility.trace(), visibility.determinant());
    let smaller_eigenvalue = half_trace - (half_trace * half_trace - determinant).max(0.0).sqrt();
    let false_alarm = 1.0 - (1.0 - FALSE_ALARM).powf(interval_s);
    false_alarm <= probability_above(rates.len() - 1, squares)
        && VISIBLE_INCREASE <= smaller_eigenvalue * VISIBLE_M_S * VISIBLE_M_S
}

impl Standstill {
    /// Adds the rates of an epoch, `interval_s` after the previous one if there is one. Returns
    /// whether the receiver has been at rest for long enough, up to and including this epoch.
    pub(super) fn observe(&mut self, rates: &[DopplerFactor], interval_s: Option<f64>) -> bool {
        let before_s = self.still_s.filter(|_| interval_s.is_some_and(|s| s <= STILL_S));
        let longer = |still_s: f64| still_s + interval_s.unwrap_or(0.0);
        // The first epoch, and one after a pause, stand for a second.
        let tested_s = interval_s.filter(|s| *s <= STILL_S).unwrap_or(1.0);
        self.still_s = passes(rates, tested_s).then(|| before_s.map_or(0.0, longer));
        self.still_s.is_some_and(|still_s| STILL_S <= still_s)
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;
    use crate::gnss::{Ecef, Enu, LocalFrame};
    use crate::models::{SatelliteState, range_rate};
    use crate::positioning::draws::Draws;

    const DRIFT_M_S: f64 = 40.0;

    /// Eight satellites around, seen by a receiver of that local velocity; alternately ± `off`.
    fn rates(velocity: Vector3<f64>, sigma_m_s: f64, off_m_s: f64) -> Vec<DopplerFactor> {
        let off = |index: u8| if index.is_multiple_of(2) { off_m_s } else { -off_m_s };
        rates_off_by(velocity, sigma_m_s, off)
    }

    fn rates_off_by(
        velocity: Vector3<f64>,
        sigma_m_s: f64,
        mut off_m_s: impl FnMut(u8) -> f64,
    ) -> Vec<DopplerFactor> {
        let frame = LocalFrame::at(Ecef::new(-2_414_266.9, 5_386_768.9, 2_407_460.0));
        let rate = |index: u8| {
            let azimuth = f64::from(index) * std::f64::consts::FRAC_PI_4;
            let way = Vector3::new(azimuth.sin(), azimuth.cos(), 0.8) * 1.6e7;
            let satellite = SatelliteState {
                position: frame.to_ecef(Enu(way)),
                velocity_m_s: Vector3::new(1_500.0, -1_200.0, 2_400.0),
                clock_m: 0.0,
                clock_drift_m_s: 0.0,
                variance_m2: 0.0,
            };
            let moving = frame.rotation.transpose() * velocity;
            let (place, speed) = (satellite.position, &satellite.velocity_m_s);
            let seen = range_rate(place, speed, frame.origin, &moving).rate_m_s + DRIFT_M_S;
            let seen = seen + off_m_s(index);
            DopplerFactor::new(&frame, frame.origin, &satellite, seen, sigma_m_s)
        };
        (0..8).map(rate).collect()
    }

    fn at_rest(velocity: Vector3<f64>, sigma_m_s: f64, off_m_s: f64) -> bool {
        passes(&rates(velocity, sigma_m_s, off_m_s), 1.0)
    }

    #[test]
    fn rest_passes_and_a_crawl_does_not() {
        assert!(at_rest(Vector3::zeros(), 0.05, 0.0));
        // Eight squares of one standard deviation: 8 of the 14.07 that seven degrees allow.
        assert!(at_rest(Vector3::zeros(), 0.05, 0.05));
        assert!(!at_rest(Vector3::zeros(), 0.05, 0.1));
        assert!(!at_rest(Vector3::new(0.2, 0.0, 0.0), 0.05, 0.0));
        assert!(!at_rest(Vector3::new(0.0, -0.2, 0.0), 0.05, 0.0));
    }

    /// The standstill of a receiver with a Doppler noise of 0.05 m/s is found where all epochs of
    /// two seconds pass: 0.95³ of the time at 1 Hz and 0.95^2.05 at 20 Hz.
    #[test]
    fn rest_is_found_as_often_at_any_rate() {
        let found = |rate_hz: u32| {
            let (mut draws, mut standstill) = (Draws::new(7), Standstill::default());
            // Box and Muller (1958).
            let mut normal = move || {
                let (radius, turn) = (draws.unit(), draws.unit());
                (-2.0 * (1.0 - radius).ln()).sqrt() * (std::f64::consts::TAU * turn).cos()
            };
            let (epochs, interval_s) = (4_000 * rate_hz, f64::from(rate_hz).recip());
            let is_found = |_: &u32| {
                let noisy = rates_off_by(Vector3::zeros(), 0.05, |_| 0.05 * normal());
                standstill.observe(&noisy, Some(interval_s))
            };
            (0..epochs).filter(is_found).count() as f64 / f64::from(epochs)
        };
        for (rate_hz, expected) in [(1, 0.857), (20, 0.900)] {
            let part = found(rate_hz);
            assert!((part - expected).abs() < 0.02, "{rate_hz} Hz: {part}");
        }
    }

    /// Rates too coarse to show a slow motion do not prove rest.
    #[test]
    fn coarse_rates_prove_no_rest() {
        assert!(!at_rest(Vector3::zeros(), 0.5, 0.0));
        assert!(!passes(&[], 1.0));
    }

    #[test]
    fn two_seconds_of_rest_are_a_standstill() {
        let mut standstill = Standstill::default();
        let (rest, moving) = (rates(Vector3::zeros(), 0.05, 0.0), Vector3::new(9.0, 0.0, 0.0));
        let told: Vec<_> = [None, Some(1.0), Some(1.0), Some(1.0)]
            .map(|interval_s| standstill.observe(&rest, interval_s))
            .into();
        assert_eq!(told, [false, false, true, true]);
        assert!(!standstill.observe(&rates(moving, 0.05, 0.0), Some(1.0)));
        assert!(!standstill.observe(&rest, Some(1.0)));
        // 30 s apart, the receiver may have gone and come back.
        assert!(!standstill.observe(&rest, Some(30.0)));
        assert!(!standstill.observe(&rest, Some(30.0)));
    }
}
