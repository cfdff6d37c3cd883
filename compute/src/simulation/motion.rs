//! Motion of the rover: smooth paths with position and velocity at any time.

use nalgebra::{Vector2, Vector3};

use super::city::City;
use super::kinematics::Kinematics;
use super::random::Random;

/// Number of crossings that the rover stays within, counted from its start.
const TOWN_CORNERS: i64 = 5;

/// How the rover moves through the streets of a city.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Traffic {
    /// Speed between the turns (m/s).
    pub cruise_m_s: f64,
    /// Acceleration and deceleration (m/s²).
    pub acceleration_m_s2: f64,
    /// Speed through a turn (m/s).
    pub turn_m_s: f64,
    /// Radius of a turn (m).
    pub turn_radius_m: f64,
    /// Distance from the street's centre to the lane, to its right (m).
    pub lane_m: f64,
    /// Probability that a traffic light is red.
    pub red_probability: f64,
    /// Range of waiting times at a red light (s).
    pub red_s: (f64, f64),
    /// Start between the first crossing (0) and the second (1); at most 0.6.
    pub start_share: f64,
    /// Time at rest at the start (s).
    pub start_wait_s: f64,
}

impl Traffic {
    /// A car in town that starts at a crossing.
    pub(crate) const fn town() -> Self {
        Self {
            cruise_m_s: 12.0,
            acceleration_m_s2: 2.0,
            turn_m_s: 4.0,
            turn_radius_m: 8.0,
            lane_m: 3.0,
            red_probability: 0.35,
            red_s: (8.0, 35.0),
            start_share: 0.0,
            start_wait_s: 0.0,
        }
    }
}

/// The kind of motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Motion {
    /// At rest at the origin.
    Static,
    /// Along a figure of eight.
    Loop {
        /// Half its length, towards east (m).
        half_length_m: f64,
        /// Mean speed (m/s).
        speed_m_s: f64,
    },
    /// Through the streets of the scenario's city, with turns and red lights.
    Streets(Traffic),
}

/// A path for a given duration.
#[derive(Clone, Debug)]
pub(super) enum Path {
    Static,
    Eight { half_length_m: f64, rate_rad_s: f64 },
    Drive { segments: Vec<Segment>, phases: Vec<Phase>, heading: Vector2<f64> },
}

/// A segment of a drive: straight, or an arc to the left (positive curvature) or right.
#[derive(Clone, Copy, Debug)]
pub(super) struct Segment {
    from_m: f64,
    start: Vector2<f64>,
    direction: Vector2<f64>,
    curvature_per_m: f64,
}

/// A time interval of a drive with constant acceleration.
#[derive(Clone, Copy, Debug)]
pub(super) struct Phase {
    from_s: f64,
    distance_m: f64,
    speed_m_s: f64,
    acceleration_m_s2: f64,
}

/// Length of the figure of eight over its half length: ∮√(cos²φ + cos²2φ) dφ, by quadrature.
const EIGHT_LENGTH: f64 = 6.097_223_470_104_917;

impl Path {
    /// The path of a motion for a duration (s); streets are those of `city`.
    pub(super) fn new(motion: Motion, city: Option<&City>, duration_s: f64, seed: u64) -> Self {
        match (motion, city) {
            (Motion::Loop { half_length_m, speed_m_s }, _) => Self::Eight {
                half_length_m,
                rate_rad_s: std::f64::consts::TAU * speed_m_s / (EIGHT_LENGTH * half_length_m),
            },
            (Motion::Streets(traffic), Some(city)) => {
                Drive::through(city, traffic, duration_s, seed).into_path()
            }
            (Motion::Static, _) | (Motion::Streets(_), None) => Self::Static,
        }
    }

    /// Position and velocity at a time after the start (s).
    pub(super) fn at(&self, elapsed_s: f64) -> Kinematics {
        match self {
            Self::Static => {
                Kinematics { position_m: Vector3::zeros(), velocity_m_s: Vector3::zeros() }
            }
            Self::Eight { half_length_m, rate_rad_s } => {
                let (a, w) = (*half_length_m, *rate_rad_s);
                let phase = w * elapsed_s;
                // Up: a gentle slope along the path.
                let position = Vector3::new(phase.sin(), 0.5 * (2.0 * phase).sin(), 0.0);
                let slope = Vector3::new(phase.cos(), (2.0 * phase).cos(), 0.0);
                let up = Vector3::new(0.0, 0.0, 0.02 * a);
                Kinematics {
                    position_m: a * position + up * phase.sin(),
                    velocity_m_s: w * (a * slope + up * phase.cos()),
                }
            }
            Self::Drive { segments, phases, heading } => {
                drive_at(segments, phases, heading, elapsed_s)
            }
        }
    }
}

/// `heading` is the direction of the first street, which rotates city axes into east and north.
fn drive_at(
    segments: &[Segment],
    phases: &[Phase],
    heading: &Vector2<f64>,
    elapsed_s: f64,
) -> Kinematics {
    let phase = &phases[phases.partition_point(|p| p.from_s <= elapsed_s).max(1) - 1];
    let dt = elapsed_s - phase.from_s;
    let speed = phase.speed_m_s + phase.acceleration_m_s2 * dt;
    let distance =
        phase.distance_m + phase.speed_m_s * dt + 0.5 * phase.acceleration_m_s2 * dt * dt;
    let segment = &segments[segments.partition_point(|p| p.from_m <= distance).max(1) - 1];
    let along = distance - segment.from_m;
    let (d, left) = (segment.direction, Vector2::new(-segment.direction.y, segment.direction.x));
    let (position, direction) = if segment.curvature_per_m == 0.0 {
        (segment.start + d * along, d)
    } else {
        let (sin, cos) = (along * segment.curvature_per_m).sin_cos();
        let turned = (d * sin + left * (1.0 - cos)) / segment.curvature_per_m;
        (segment.start + turned, d * cos + left * sin)
    };
    let to_east_north = |v: Vector2<f64>| {
        Vector3::new(v.x * heading.x - v.y * heading.y, v.x * heading.y + v.y * heading.x, 0.0)
    };
    Kinematics {
        position_m: to_east_north(position),
        velocity_m_s: to_east_north(direction) * speed,
    }
}

/// A drive under construction.
struct Drive {
    traffic: Traffic,
    segments: Vec<Segment>,
    phases: Vec<Phase>,
    heading: Vector2<f64>,
    /// End of the segments so far.
    end: Vector2<f64>,
    length_m: f64,
    time_s: f64,
    speed_m_s: f64,
}

impl Drive {
    fn through(city: &City, traffic: Traffic, duration_s: f64, seed: u64) -> Self {
        let mut random = Random::new(seed, 11);
        let (sin, cos) = city.street_azimuth_rad.sin_cos();
        let mut drive = Self {
            traffic,
            segments: Vec::new(),
            phases: Vec::new(),
            heading: Vector2::new(sin, cos),
            end: Vector2::new(traffic.start_share * city.pitch_m(), -traffic.lane_m),
            length_m: 0.0,
            time_s: 0.0,
            speed_m_s: 0.0,
        };
        if 0.0 < traffic.start_wait_s {
            drive.wait(traffic.start_wait_s);
        }
        let mut corner = (0_i64, 0_i64);
        let mut direction = (1_i64, 0_i64);
        while drive.time_s <= duration_s {
            corner = (corner.0 + direction.0, corner.1 + direction.1);
            let next = turn(corner, direction, &mut random);
            drive.drive_to(corner, direction, next, city.pitch_m(), &mut random);
            direction = next;
        }
        drive
    }

    /// Drives to a crossing, waits at a red light, and leaves in the direction `next`.
    fn drive_to(
        &mut self,
        corner: (i64, i64),
        direction: (i64, i64),
        next: (i64, i64),
        pitch_m: f64,
        random: &mut Random,
    ) {
        let vector = |d: (i64, i64)| Vector2::new(d.0 as f64, d.1 as f64);
        let (now, then) = (vector(direction), vector(next));
        let lane = |d: Vector2<f64>| Vector2::new(d.y, -d.x) * self.traffic.lane_m;
        let node = Vector2::new(corner.0 as f64, corner.1 as f64) * pitch_m;
        let bend = now.perp(&then);
        let crossing = if bend == 0.0 { node + lane(now) } else { node + lane(now) + lane(then) };
        let Traffic { cruise_m_s, turn_m_s, turn_radius_m, red_probability, red_s, .. } =
            self.traffic;
        let arc = if bend == 0.0 { 0.0 } else { turn_radius_m };
        let straight = (crossing - self.end).dot(&now) - arc;
        self.segments.push(Segment {
            from_m: self.length_m,
            start: self.end,
            direction: now,
            curvature_per_m: 0.0,
        });
        let is_red = random.chance(red_probability);
        let leaving = match (is_red, bend == 0.0) {
            (true, _) => 0.0,
            (false, true) => cruise_m_s,
            (false, false) => turn_m_s,
        };
        self.travel(straight, leaving, cruise_m_s);
        if is_red {
            self.wait(random.uniform(red_s.0, red_s.1));
        }
        self.length_m += straight;
        self.end += now * straight;
        if bend != 0.0 {
            let length = std::f64::consts::FRAC_PI_2 * turn_radius_m;
            self.segments.push(Segment {
                from_m: self.length_m,
                start: self.end,
                direction: now,
                curvature_per_m: bend / turn_radius_m,
            });
            self.travel(length, turn_m_s, turn_m_s);
            self.length_m += length;
            self.end += (now + then) * turn_radius_m;
        }
    }

    fn push(&mut self, done_m: f64, acceleration_m_s2: f64, duration_s: f64) {
        self.phases.push(Phase {
            from_s: self.time_s,
            distance_m: self.length_m + done_m,
            speed_m_s: self.speed_m_s,
            acceleration_m_s2,
        });
        self.time_s += duration_s;
        self.speed_m_s += acceleration_m_s2 * duration_s;
    }

    fn wait(&mut self, duration_s: f64) {
        self.phases.push(Phase {
            from_s: self.time_s,
            distance_m: self.phases_end_m(),
            speed_m_s: 0.0,
            acceleration_m_s2: 0.0,
        });
        self.time_s += duration_s;
    }

    /// Distance at the end of the time intervals so far (m).
    fn phases_end_m(&self) -> f64 {
        self.phases.last().map_or(0.0, |last| {
            let dt = self.time_s - last.from_s;
            last.distance_m + last.speed_m_s * dt + 0.5 * last.acceleration_m_s2 * dt * dt
        })
    }

    /// Covers a distance and ends with a given speed: accelerates, cruises, brakes.
    fn travel(&mut self, length_m: f64, leaving_m_s: f64, limit_m_s: f64) {
        let (v0, v1, a) = (self.speed_m_s, leaving_m_s, self.traffic.acceleration_m_s2);
        // v² of the highest speed if acceleration and braking alone cover the distance.
        let peak = (a * length_m + 0.5 * (v0 * v0 + v1 * v1)).max(0.0).sqrt();
        let top = peak.min(limit_m_s).max(v0.max(v1));
        let speeding = (top * top - v0 * v0) / (2.0 * a);
        let braking = (top * top - v1 * v1) / (2.0 * a);
        let cruising = (length_m - speeding - braking).max(0.0);
        self.push(0.0, a, (top - v0) / a);
        self.push(speeding, 0.0, cruising / top);
        self.push(speeding + cruising, -a, (top - v1) / a);
        self.speed_m_s = v1;
    }

    fn into_path(self) -> Path {
        Path::Drive { segments: self.segments, phases: self.phases, heading: self.heading }
    }
}

/// Straight on, left or right, but never out of the town.
fn turn(corner: (i64, i64), direction: (i64, i64), random: &mut Random) -> (i64, i64) {
    let left = (-direction.1, direction.0);
    let right = (direction.1, -direction.0);
    let choice = random.uniform(0.0, 1.0);
    let order = match choice {
        c if c < 0.4 => [direction, left, right],
        c if c < 0.7 => [left, right, direction],
        _ => [right, left, direction],
    };
    let inside = |d: &(i64, i64)| {
        let next = (corner.0 + d.0, corner.1 + d.1);
        next.0.abs() <= TOWN_CORNERS && next.1.abs() <= TOWN_CORNERS
    };
    order.into_iter().find(inside).expect("a corner of the town has two streets into it")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulation::city::CityPlan;

    fn paths() -> Vec<Path> {
        let city = City::new(CityPlan::dense(), 5);
        let eight = Motion::Loop { half_length_m: 300.0, speed_m_s: 10.0 };
        let streets = Motion::Streets(Traffic::town());
        vec![Path::new(eight, None, 600.0, 1), Path::new(streets, Some(&city), 600.0, 1)]
    }

    /// Velocity is the derivative of position, and neither jumps.
    #[test]
    fn paths_are_smooth() {
        for path in paths() {
            for step in 1..6000 {
                let t = f64::from(step) * 0.1;
                let (before, here, after) = (path.at(t - 1e-4), path.at(t), path.at(t + 1e-4));
                let slope = (after.position_m - before.position_m) / 2e-4;
                assert!((slope - here.velocity_m_s).norm() < 1e-3, "{slope} {here:?} at {t}");
                let change = (path.at(t + 0.1).velocity_m_s - here.velocity_m_s).norm();
                assert!(change < 0.35, "{change} m/s in 0.1 s at {t}");
            }
        }
    }

    #[test]
    fn the_loop_keeps_its_mean_speed_and_the_car_stops_at_lights() {
        let speeds = |path: &Path| -> Vec<f64> {
            (0..6000).map(|i| path.at(f64::from(i) * 0.1).velocity_m_s.norm()).collect()
        };
        let [eight, drive] = &paths()[..] else { panic!("two paths") };
        let turn_s = EIGHT_LENGTH * 300.0 / 10.0;
        let steps = (turn_s * 10.0).round() as usize;
        let mean = speeds(eight)[..steps].iter().sum::<f64>() / steps as f64;
        assert!((mean - 10.0).abs() < 0.05, "{mean}");
        let driving = speeds(drive);
        assert!(driving.iter().all(|v| *v < Traffic::town().cruise_m_s + 1e-9));
        let standing = driving.iter().filter(|v| **v < 1e-9).count();
        assert!((100..4000).contains(&standing), "{standing}");
    }
}
