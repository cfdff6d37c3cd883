//! A city of blocks and streets, and the effect of its walls on signals.
//!
//! Streets form a square grid with blocks between them; each block has one height. Signals are
//! plane waves. A wall in the path blocks a signal, a wall at the right position reflects it, and a
//! signal that passes just below a roof's edge is diffracted: weak, with little delay. A wall
//! consists of panes, some of which do not reflect, so a reflection lasts along a pane and ends at
//! its border. City axes: x along the first street, y to its left, origin at a crossing.

use nalgebra::{Vector2, Vector3};

use super::kinematics::Kinematics;
use super::random::of_cell;

/// Largest number of grid cells searched for a wall.
const LONGEST_LOOK: usize = 40;
/// Distance from a wall at which the search continues (m).
const OFF_THE_WALL_M: f64 = 1e-3;
/// Wavelength for which diffraction is computed (m): L1.
const WAVELENGTH_M: f64 = 0.19;

/// Dimensions of a city.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CityPlan {
    /// Azimuth of the streets along x (rad).
    pub street_azimuth_rad: f64,
    /// Street width from wall to wall (m).
    pub street_width_m: f64,
    /// Side length of a block (m).
    pub block_m: f64,
    /// Lowest and highest building (m).
    pub heights_m: (f64, f64),
    /// Share of blocks without a building.
    pub open_share: f64,
    /// Smallest and largest loss of a reflection (dB): metal and coated glass to rough concrete.
    pub reflection_loss_db: (f64, f64),
    /// Width of a pane, a part of a wall with constant reflection (m).
    pub pane_m: f64,
    /// Share of panes that reflect.
    pub reflecting_share: f64,
    /// Largest excess path of a reflection that a receiver tracks (m).
    pub longest_excess_m: f64,
    /// Largest loss of a diffracted signal (dB).
    pub diffraction_limit_db: f64,
}

impl CityPlan {
    /// Streets of 22 m between buildings of 15 to 60 m; one block in eight is open.
    pub(crate) const fn dense() -> Self {
        Self {
            street_azimuth_rad: 0.6,
            street_width_m: 22.0,
            block_m: 90.0,
            heights_m: (15.0, 60.0),
            open_share: 0.125,
            reflection_loss_db: (3.0, 14.0),
            pane_m: 15.0,
            reflecting_share: 0.75,
            longest_excess_m: 200.0,
            diffraction_limit_db: 25.0,
        }
    }
}

/// A city: its dimensions and the seed of its buildings.
#[derive(Clone, Debug)]
pub(super) struct City {
    plan: CityPlan,
    pub(super) street_azimuth_rad: f64,
    seed: u64,
}

/// How a satellite's signal reaches the rover.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Arrival {
    /// Directly; `reflected` if a reflection arrives too.
    Direct { reflected: bool },
    /// By one reflection only.
    Reflected(Reflection),
    /// Diffracted at the edge of a roof.
    Diffracted(Diffraction),
    /// The signal does not reach the rover.
    Blocked,
}

/// A reflection relative to the direct path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Reflection {
    /// Excess path length (m).
    pub(super) excess_m: f64,
    /// Rate of the excess path as the rover moves (m/s).
    pub(super) excess_rate_m_s: f64,
    /// Loss of signal strength (dB).
    pub(super) loss_db: f64,
}

/// A diffraction relative to the direct path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Diffraction {
    /// Excess path length (m).
    pub(super) excess_m: f64,
    /// Loss of signal strength (dB).
    pub(super) loss_db: f64,
}

impl Diffraction {
    /// Diffraction at an edge that is `above_m` above the ray, perpendicular to it, and
    /// `distance_m` along it from the antenna, for a distant satellite: ν = h·√(2/(λd)), J(ν) = 6.9
    /// + 20·log(√((ν − 0.1)² + 1) + ν − 0.1) dB.
    ///
    /// Source: ITU-R P.526, single knife-edge obstacle.
    fn over_edge(above_m: f64, distance_m: f64) -> Self {
        let nu = above_m * (2.0 / (WAVELENGTH_M * distance_m)).sqrt() - 0.1;
        let loss_db = 6.9 + 20.0 * (nu.hypot(1.0) + nu).log10();
        Self { excess_m: above_m * above_m / (2.0 * distance_m), loss_db }
    }
}

/// The first point where a ray meets a wall.
struct Hit {
    point: Vector3<f64>,
    /// Normal of the wall, outwards, horizontal.
    normal: Vector2<f64>,
    block: (i64, i64),
}

impl City {
    pub(super) fn new(plan: CityPlan, seed: u64) -> Self {
        Self { plan, street_azimuth_rad: plan.street_azimuth_rad, seed }
    }

    /// Distance between crossings (m).
    pub(super) fn pitch_m(&self) -> f64 {
        self.plan.block_m + self.plan.street_width_m
    }

    /// Height of a block's building (m); 0 without building.
    pub(super) fn height_m(&self, block: (i64, i64)) -> f64 {
        if of_cell(self.seed, block.0, block.1, 0) < self.plan.open_share {
            return 0.0;
        }
        let (low, high) = self.plan.heights_m;
        low + (high - low) * of_cell(self.seed, block.0, block.1, 1)
    }

    /// How a signal from azimuth and elevation reaches an antenna; the third coordinate of its
    /// position is the height above the street.
    pub(super) fn arrival(
        &self,
        kinematics: &Kinematics,
        azimuth_rad: f64,
        elevation_rad: f64,
    ) -> Arrival {
        let (from, velocity) =
            (self.to_streets(&kinematics.position_m), self.to_streets(&kinematics.velocity_m_s));
        let bearing = self.street_azimuth_rad - azimuth_rad;
        let flat = elevation_rad.cos();
        let ray = Vector3::new(flat * bearing.cos(), flat * bearing.sin(), elevation_rad.sin());
        let reflection = self.shortest_reflection(&from, &velocity, &ray);
        let Some(hit) = self.first_wall(&from, &ray) else {
            return Arrival::Direct { reflected: reflection.is_some() };
        };
        // The receiver tracks the stronger of the two.
        match (self.diffraction(&from, &ray, &hit), reflection) {
            (Some(bent), Some(reflection)) if bent.loss_db < reflection.loss_db => {
                Arrival::Diffracted(bent)
            }
            (_, Some(reflection)) => Arrival::Reflected(reflection),
            (Some(bent), None) => Arrival::Diffracted(bent),
            (None, None) => Arrival::Blocked,
        }
    }

    /// Diffraction at the roof of the wall that the ray hits, if nothing else blocks the ray.
    fn diffraction(
        &self,
        from: &Vector3<f64>,
        ray: &Vector3<f64>,
        hit: &Hit,
    ) -> Option<Diffraction> {
        let gap_m = self.height_m(hit.block) - hit.point.z;
        let edge = Vector3::new(hit.point.x, hit.point.y, hit.point.z + gap_m + OFF_THE_WALL_M);
        let bent = Diffraction::over_edge(gap_m * ray.xy().norm(), (hit.point - from).norm());
        let is_heard =
            bent.loss_db < self.plan.diffraction_limit_db && self.first_wall(&edge, ray).is_none();
        is_heard.then_some(bent)
    }

    /// Rotates east, north, up into the city axes.
    fn to_streets(&self, enu: &Vector3<f64>) -> Vector3<f64> {
        let (sin, cos) = self.street_azimuth_rad.sin_cos();
        Vector3::new(enu.x * sin + enu.y * cos, enu.y * sin - enu.x * cos, enu.z)
    }

    /// The shorter of the single reflections on walls along x and along y. For a plane wave from
    /// direction u and a wall with normal n at distance p, the excess path is 2·p·(u·n).
    fn shortest_reflection(
        &self,
        from: &Vector3<f64>,
        velocity: &Vector3<f64>,
        ray: &Vector3<f64>,
    ) -> Option<Reflection> {
        let mirrored = [Vector3::new(-ray.x, ray.y, ray.z), Vector3::new(ray.x, -ray.y, ray.z)];
        let found = mirrored.iter().enumerate().filter_map(|(axis, direction)| {
            let hit = self.first_wall(from, direction)?;
            let slant = hit.normal.dot(&ray.xy());
            if hit.normal[axis] == 0.0 || slant <= 0.0 {
                return None;
            }
            let off = Vector3::new(hit.normal.x, hit.normal.y, 0.0) * OFF_THE_WALL_M;
            if self.first_wall(&(hit.point + off), ray).is_some() {
                return None;
            }
            let (low, high) = self.plan.reflection_loss_db;
            // Panes are numbered along the wall; each of a block's four walls has its own.
            let pane = (hit.point[1 - axis] / self.plan.pane_m).floor() as i64;
            let side = 2 * axis as u64 + u64::from(0.0 < hit.normal[axis]);
            let drawn = |what| {
                of_cell(self.seed ^ (4 * side + what), hit.block.0, hit.block.1, 8)
                    + of_cell(self.seed, pane, side as i64, 16 + what)
            };
            if self.plan.reflecting_share < drawn(0).fract() {
                return None;
            }
            let share = drawn(1).fract();
            Some(Reflection {
                excess_m: 2.0 * (from.xy() - hit.point.xy()).dot(&hit.normal) * slant,
                excess_rate_m_s: 2.0 * velocity.xy().dot(&hit.normal) * slant,
                loss_db: low + (high - low) * share,
            })
        });
        let tracked = found.filter(|found| found.excess_m <= self.plan.longest_excess_m);
        tracked.min_by(|a, b| a.excess_m.total_cmp(&b.excess_m))
    }

    /// The first wall that a rising ray meets below its roof.
    fn first_wall(&self, from: &Vector3<f64>, ray: &Vector3<f64>) -> Option<Hit> {
        let pitch = self.pitch_m();
        let index = |value: f64| (value / pitch).floor() as i64;
        let (mut i, mut j) = (index(from.x), index(from.y));
        for _ in 0..LONGEST_LOOK {
            if let Some(hit) = self.wall_of((i, j), from, ray) {
                return Some(hit);
            }
            // Continue in the cell whose border the ray crosses first.
            let border = |cell: i64, start: f64, slope: f64| match slope {
                s if 0.0 < s => ((cell + 1) as f64 * pitch - start) / s,
                s if s < 0.0 => (cell as f64 * pitch - start) / s,
                _ => f64::INFINITY,
            };
            let (across, along) = (border(i, from.x, ray.x), border(j, from.y, ray.y));
            let nearer = across.min(along);
            if self.plan.heights_m.1 < from.z + nearer * ray.z || !nearer.is_finite() {
                return None;
            }
            if across <= along {
                i += if 0.0 < ray.x { 1 } else { -1 };
            } else {
                j += if 0.0 < ray.y { 1 } else { -1 };
            }
        }
        None
    }

    /// The point where the ray enters the block of a cell, if it is below the roof.
    fn wall_of(&self, cell: (i64, i64), from: &Vector3<f64>, ray: &Vector3<f64>) -> Option<Hit> {
        let (pitch, half_street) = (self.pitch_m(), 0.5 * self.plan.street_width_m);
        let (mut enter, mut leave) = (f64::NEG_INFINITY, f64::INFINITY);
        let mut normal = Vector2::zeros();
        for (axis, index) in [cell.0, cell.1].into_iter().enumerate() {
            let low = index as f64 * pitch + half_street;
            let high = (index + 1) as f64 * pitch - half_street;
            if ray[axis] == 0.0 {
                if from[axis] < low || high < from[axis] {
                    return None;
                }
                continue;
            }
            let (a, b) = ((low - from[axis]) / ray[axis], (high - from[axis]) / ray[axis]);
            if enter < a.min(b) {
                enter = a.min(b);
                normal = Vector2::zeros();
                normal[axis] = -ray[axis].signum();
            }
            leave = leave.min(a.max(b));
        }
        if leave <= enter || enter <= 0.0 {
            return None;
        }
        let point = from + ray * enter;
        (point.z < self.height_m(cell)).then_some(Hit { point, normal, block: cell })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Streets run east; every building is 40 m high.
    fn canyon() -> City {
        let plan = CityPlan {
            street_azimuth_rad: std::f64::consts::FRAC_PI_2,
            street_width_m: 20.0,
            block_m: 180.0,
            heights_m: (40.0, 40.0),
            open_share: 0.0,
            reflection_loss_db: (6.0, 6.0),
            pane_m: 15.0,
            reflecting_share: 1.0,
            longest_excess_m: 200.0,
            diffraction_limit_db: 25.0,
        };
        City::new(plan, 1)
    }

    /// Antenna on the ground, driving north at 2 m/s.
    fn at(east_m: f64, north_m: f64, azimuth_deg: f64, elevation_deg: f64) -> Arrival {
        let kinematics = Kinematics {
            position_m: Vector3::new(east_m, north_m, 0.0),
            velocity_m_s: Vector3::new(0.0, 2.0, 0.0),
        };
        canyon().arrival(&kinematics, azimuth_deg.to_radians(), elevation_deg.to_radians())
    }

    /// In the middle of a block, 4 m north of the street's middle, antenna on the ground.
    fn arrival(azimuth_deg: f64, elevation_deg: f64) -> Arrival {
        at(100.0, 4.0, azimuth_deg, elevation_deg)
    }

    /// The wall in the north is 6 m away: it hides what is below atan(40/6) = 81.47°.
    #[test]
    fn a_wall_blocks_up_to_its_roof() {
        assert!(matches!(arrival(0.0, 82.0), Arrival::Direct { .. }));
        assert!(!matches!(arrival(0.0, 81.0), Arrival::Direct { .. }));
        // South: 14 m, atan(40/14) = 70.71°.
        assert!(matches!(arrival(180.0, 71.0), Arrival::Direct { .. }));
        assert!(!matches!(arrival(180.0, 70.0), Arrival::Direct { .. }));
        // Along the street nothing blocks the signal.
        assert!(matches!(arrival(90.0, 10.0), Arrival::Direct { .. }));
    }

    /// A satellite in the north at 65° is seen in the southern wall, 14 m away: the path is
    /// 2·14·cos 65° longer. There the ray is 14·tan 65° = 30.0 m high; from the northern roof's edge,
    /// 20 m on, it is 72.9 m, above the roof.
    #[test]
    fn the_far_wall_reflects() {
        let Arrival::Reflected(reflection) = arrival(0.0, 65.0) else {
            panic!("{:?}", arrival(0.0, 65.0))
        };
        let cos = 65_f64.to_radians().cos();
        assert!((reflection.excess_m - 28.0 * cos).abs() < 1e-9, "{reflection:?}");
        assert!((reflection.excess_rate_m_s - 4.0 * cos).abs() < 1e-9, "{reflection:?}");
        assert_eq!(reflection.loss_db, 6.0);
        // At 40° the ray to the southern wall passes the northern one at 28.5 m: too low.
        assert_eq!(arrival(0.0, 40.0), Arrival::Blocked);
    }

    /// On the edge itself half the field is left, 6 dB; ν = 1 costs 13.9 dB, as the curve of P.526
    /// has it, and lengthens the path by λ/4.
    #[test]
    fn an_edge_bends_what_passes_close() {
        assert!((Diffraction::over_edge(0.0, 20.0).loss_db - 6.03).abs() < 0.01);
        let above_m = (0.5 * WAVELENGTH_M * 20.0).sqrt();
        let bent = Diffraction::over_edge(above_m, 20.0);
        assert!((bent.loss_db - 13.93).abs() < 0.01, "{bent:?}");
        assert!((bent.excess_m - 0.25 * WAVELENGTH_M).abs() < 1e-12, "{bent:?}");
        // Towards the north the roof hides what is below 81.47°; at 81.3° the gap is small.
        assert!(matches!(arrival(0.0, 81.3), Arrival::Diffracted(_)), "{:?}", arrival(0.0, 81.3));
    }

    /// Along a street with panes, a reflection comes, stays for metres, and goes.
    #[test]
    fn reflections_persist_and_end() {
        let plan = CityPlan { reflecting_share: 0.5, ..canyon().plan };
        let city = City::new(plan, 1);
        let heard = |step: i32| {
            let kinematics = Kinematics {
                position_m: Vector3::new(12.0 + 0.5 * f64::from(step), 4.0, 0.0),
                velocity_m_s: Vector3::zeros(),
            };
            matches!(city.arrival(&kinematics, 0.0, 65_f64.to_radians()), Arrival::Reflected(_))
        };
        let heard: Vec<_> = (0..320).map(heard).collect();
        let changes = heard.windows(2).filter(|pair| pair[0] != pair[1]).count();
        let share = heard.iter().filter(|heard| **heard).count() as f64 / heard.len() as f64;
        assert!((2..=12).contains(&changes), "{changes}");
        assert!((0.2..0.8).contains(&share), "{share}");
    }

    /// Past the crossing, buildings of the next block stop oblique rays.
    #[test]
    fn buildings_beyond_the_crossing_count() {
        // From x = 100 the block ends at 190; bearing 10° north of east reaches the wall (y = 10) at
        // 34 m: blocked when low.
        assert!(!matches!(arrival(80.0, 20.0), Arrival::Direct { .. }));
        assert!(
            matches!(at(195.0, 0.0, 0.0, 10.0), Arrival::Direct { .. }),
            "the street northwards"
        );
    }
}
