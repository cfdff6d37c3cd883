//! Wheels and compass of a car.
//!
//! Wheels measure the distance driven. Their errors are one scale error for the whole drive, a
//! noise that grows with the square root of the distance as slips do, and the rounding to ticks;
//! lateral motion is zero. The heading has one constant error for the whole drive and noise. The
//! stated covariance treats all errors as independent between displacements.

use nalgebra::{Matrix3, Vector3};

use super::motion::Path;
use super::random::Random;
use crate::gnss::{Odometry, OdometryFrame};

/// Standard deviation of the scale error of a drive.
const SCALE_SIGMA: f64 = 0.01;
/// Standard deviation of slips (m/√m).
const SLIP_M: f64 = 0.01;
/// Distance between ticks (m).
const TICK_M: f64 = 0.02;
/// Standard deviations of the constant error and of the noise of the heading (rad): 1° and 0.5°.
const HEADING_BIAS_RAD: f64 = 0.017_453;
const HEADING_NOISE_RAD: f64 = 0.008_727;
/// Standard deviation of lateral and vertical motion, as a share of the distance: turns, slopes.
const ASIDE: f64 = 0.02;
const SLOPE: f64 = 0.05;
/// Number of parts in which the distance is integrated.
const PARTS: usize = 16;
/// Speed below which the heading is undefined (m/s).
const STANDING_M_S: f64 = 0.01;

/// The wheels and compass of one drive.
#[derive(Clone, Debug)]
pub(super) struct Odometer {
    random: Random,
    scale: f64,
    bias_rad: f64,
    heading_rad: f64,
    last_s: Option<f64>,
}

impl Odometer {
    pub(super) fn new(mut random: Random) -> Self {
        let scale = 1.0 + SCALE_SIGMA * random.normal();
        let bias_rad = HEADING_BIAS_RAD * random.normal();
        Self { random, scale, bias_rad, heading_rad: 0.0, last_s: None }
    }

    /// The displacement along `path` since the last call, up to a time after the start (s); `None`
    /// at the first call.
    pub(super) fn measure(&mut self, path: &Path, elapsed_s: f64) -> Option<Odometry> {
        let last_s = self.last_s.replace(elapsed_s)?;
        let interval_s = elapsed_s - last_s;
        let way_m = way_m(path, last_s, interval_s);
        let velocity = path.at(last_s + 0.5 * interval_s).velocity_m_s;
        if STANDING_M_S < velocity.norm() {
            self.heading_rad = velocity.x.atan2(velocity.y);
        }
        let driven_m = way_m * self.scale + SLIP_M * way_m.sqrt() * self.random.normal();
        let ticks = (driven_m / TICK_M).round();
        let heading_rad =
            self.heading_rad + self.bias_rad + HEADING_NOISE_RAD * self.random.normal();
        let variance = |share: f64| (share * way_m).powi(2) + TICK_M * TICK_M;
        let along = variance(SCALE_SIGMA) + SLIP_M * SLIP_M * way_m;
        let diagonal = Vector3::new(along, variance(ASIDE), variance(SLOPE));
        Some(Odometry {
            interval_s,
            frame: OdometryFrame::Body {
                heading_rad,
                heading_sigma_rad: HEADING_BIAS_RAD.hypot(HEADING_NOISE_RAD),
            },
            displacement_m: Vector3::new(ticks * TICK_M, 0.0, 0.0),
            covariance: Matrix3::from_diagonal(&diagonal),
        })
    }
}

/// Length of the path over a time interval (m), by the trapezoid rule.
fn way_m(path: &Path, from_s: f64, interval_s: f64) -> f64 {
    let speed_m_s =
        |part: usize| path.at(from_s + interval_s * part as f64 / PARTS as f64).velocity_m_s.norm();
    let ends = 0.5 * (speed_m_s(0) + speed_m_s(PARTS));
    let sum: f64 = ends + (1..PARTS).map(speed_m_s).sum::<f64>();
    sum * interval_s / PARTS as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulation::motion::Motion;

    /// The stated covariance fits the errors: the mean normalised square of three components is 3.
    #[test]
    fn the_stated_covariance_is_honest() {
        let motion = Motion::Loop { half_length_m: 200.0, speed_m_s: 10.0 };
        let (mut squares, mut count) = (0.0, 0.0);
        for seed in 0..40 {
            let path = Path::new(motion, None, 60.0, seed);
            let mut odometer = Odometer::new(Random::new(seed, 3));
            for second in 0..60 {
                let Some(odometry) = odometer.measure(&path, f64::from(second)) else { continue };
                let OdometryFrame::Body { heading_rad, heading_sigma_rad } = odometry.frame else {
                    panic!("a car has a heading");
                };
                let ends = [second - 1, second].map(|s| path.at(f64::from(s)).position_m);
                let (sin, cos) = heading_rad.sin_cos();
                let moved = ends[1] - ends[0];
                let body = Vector3::new(
                    moved.x * sin + moved.y * cos,
                    moved.y * sin - moved.x * cos,
                    moved.z,
                );
                let mut covariance = odometry.covariance;
                covariance[(1, 1)] += (odometry.displacement_m.x * heading_sigma_rad).powi(2);
                let error = body - odometry.displacement_m;
                squares += (error.transpose() * covariance.try_inverse().unwrap() * error).x;
                count += 1.0;
            }
        }
        let mean = squares / count;
        assert!((1.0..3.5).contains(&mean), "{mean}");
    }

    #[test]
    fn a_car_that_stands_counts_no_ticks() {
        let path = Path::new(Motion::Static, None, 60.0, 1);
        let mut odometer = Odometer::new(Random::new(1, 3));
        assert_eq!(odometer.measure(&path, 0.0), None);
        let odometry = odometer.measure(&path, 1.0).unwrap();
        assert_eq!((odometry.interval_s, odometry.displacement_m), (1.0, Vector3::zeros()));
    }
}
