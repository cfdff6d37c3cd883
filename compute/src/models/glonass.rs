//! GLONASS broadcast orbits, by numerical integration in the rotating frame, and clocks.
//!
//! Equations of motion of GLONASS ICD 5.1, A.3.1.2: the Earth's central field and oblateness, the
//! rotating frame's own terms, and the broadcast acceleration of Sun and Moon held constant.
//! Fourth-order Runge–Kutta with steps of at most 60 s, which leave 0.5 mm after 15 minutes.

use nalgebra::Vector3;

use super::orbit::{Clock, Orbit};
use crate::gnss::constants::{
    EARTH_ROTATION_RATE_GLONASS as ROTATION, GRAVITATIONAL_CONSTANT_GLONASS as GRAVITATION,
};
use crate::gnss::{GlonassEphemeris, GpsTime};

/// Equatorial radius of PZ-90.02 (m); GLONASS ICD 5.1, table 3.2.
const EQUATORIAL_RADIUS: f64 = 6_378_136.0;
/// Second zonal harmonic J₂ of PZ-90.02; GLONASS ICD 5.1, table 3.2.
const J2: f64 = 1_082_625.75e-9;
/// 3/2·J₂·µ·a_e² (m⁵/s²).
const OBLATENESS: f64 = 1.5 * J2 * GRAVITATION * EQUATORIAL_RADIUS * EQUATORIAL_RADIUS;

/// Longest integration step (s).
const STEP_MAX_S: f64 = 60.0;
/// Largest number of steps: a wrong time costs at most 12 hours of orbit.
const STEPS_MAX: f64 = 720.0;

/// Orbit at `time`, integrated from toe in equal steps no longer than `STEP_MAX_S`.
pub(super) fn orbit(e: &GlonassEphemeris, time: GpsTime) -> Orbit {
    let span = time - e.toe;
    let steps = (span.abs() / STEP_MAX_S).ceil().min(STEPS_MAX);
    let step = if steps == 0.0 { 0.0 } else { span / steps };
    let mut motion = Motion { position: e.position_m, velocity: e.velocity_m_s };
    for _ in 0..steps as usize {
        motion = motion.advance(step, &e.acceleration_m_s2);
    }
    Orbit { position_m: motion.position, velocity_m_s: motion.velocity }
}

/// −τ_n + γ_n·(t − t_b); relativity is in both already (GLONASS ICD 5.1, 3.3.3).
pub(super) fn clock(e: &GlonassEphemeris, time: GpsTime) -> Clock {
    Clock { bias_s: e.clock_bias_s + e.gamma * (time - e.toe), drift: e.gamma }
}

/// Position (m) and velocity (m/s), or their time derivatives.
#[derive(Clone, Copy)]
struct Motion {
    position: Vector3<f64>,
    velocity: Vector3<f64>,
}

impl Motion {
    fn advance(&self, step: f64, perturbation: &Vector3<f64>) -> Self {
        let k1 = self.derivative(perturbation);
        let k2 = self.moved(&k1, 0.5 * step).derivative(perturbation);
        let k3 = self.moved(&k2, 0.5 * step).derivative(perturbation);
        let k4 = self.moved(&k3, step).derivative(perturbation);
        let sixth = step / 6.0;
        Self {
            position: self.position
                + (k1.position + (k2.position + k3.position) * 2.0 + k4.position) * sixth,
            velocity: self.velocity
                + (k1.velocity + (k2.velocity + k3.velocity) * 2.0 + k4.velocity) * sixth,
        }
    }

    fn moved(&self, rate: &Self, by: f64) -> Self {
        Self {
            position: self.position + rate.position * by,
            velocity: self.velocity + rate.velocity * by,
        }
    }

    fn derivative(&self, perturbation: &Vector3<f64>) -> Self {
        let (p, v) = (&self.position, &self.velocity);
        let inverse_r2 = 1.0 / p.norm_squared();
        let inverse_r3 = inverse_r2 * inverse_r2.sqrt();
        let oblateness = OBLATENESS * inverse_r3 * inverse_r2;
        let slope = 5.0 * p.z * p.z * inverse_r2;
        let central = -GRAVITATION * inverse_r3;
        let equatorial = central - oblateness * (1.0 - slope) + ROTATION * ROTATION;
        let polar = central - oblateness * (3.0 - slope);
        let acceleration = Vector3::new(
            equatorial * p.x + 2.0 * ROTATION * v.y,
            equatorial * p.y - 2.0 * ROTATION * v.x,
            polar * p.z,
        );
        Self { position: *v, velocity: acceleration + perturbation }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::models::sample;

    /// Integration over 15 minutes forwards and backwards returns to the start.
    #[test]
    fn integration_undoes_itself() {
        let start = sample::glonass();
        for span in [900.0, -900.0, 333.3] {
            let there = orbit(&start, start.toe + span);
            let moved = GlonassEphemeris {
                toe: start.toe + span,
                position_m: there.position_m,
                velocity_m_s: there.velocity_m_s,
                ..start.clone()
            };
            let back = orbit(&moved, start.toe);
            assert!((back.position_m - start.position_m).norm() < 1e-3);
            assert!((back.velocity_m_s - start.velocity_m_s).norm() < 1e-6);
        }
    }

    /// Without Sun and Moon the orbit's energy in inertial axes is constant, including the potential
    /// of the oblateness, µJ₂a²(3 sin²φ − 1)/2r³.
    #[test]
    fn energy_is_kept() {
        let mut start = sample::glonass();
        start.acceleration_m_s2 = Vector3::zeros();
        let energy = |orbit: &Orbit| {
            let (p, v) = (orbit.position_m, orbit.velocity_m_s);
            let inertial = v + Vector3::new(-p.y, p.x, 0.0) * ROTATION;
            let r = p.norm();
            let oblate = OBLATENESS / 3.0 / r.powi(3) * (3.0 * (p.z / r).powi(2) - 1.0);
            inertial.norm_squared() / 2.0 - GRAVITATION / r + oblate
        };
        let before = energy(&orbit(&start, start.toe));
        let after = energy(&orbit(&start, start.toe + 1_800.0));
        // GM/r is 1.6e7 m²/s²; the oblate part alone changes by some 500.
        assert!((after - before).abs() < 1e-3, "{before} {after}");
    }

    #[test]
    fn steps_of_a_minute_are_short_enough() {
        let start = sample::glonass();
        let whole = orbit(&start, start.toe + 900.0);
        let mut at = start.clone();
        for _ in 0..90 {
            let next = orbit(&at, at.toe + 10.0);
            at.toe = at.toe + 10.0;
            (at.position_m, at.velocity_m_s) = (next.position_m, next.velocity_m_s);
        }
        let error = (whole.position_m - at.position_m).norm();
        assert!(error < 1e-3, "{error} m");
    }

    #[test]
    fn the_clock_worked_by_hand() {
        let clock = clock(&sample::glonass(), sample::toe() + 100.0);
        assert!((clock.bias_s - (2e-5 + 9.1e-11)).abs() < 1e-18);
    }
}
