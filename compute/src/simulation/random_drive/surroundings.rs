//! Draws the city, the traffic and the sky of a drive.

use crate::gnss::{Constellation, Geodetic};
use crate::simulation::Atmosphere;
use crate::simulation::city::CityPlan;
use crate::simulation::motion::Traffic;
use crate::simulation::random::Random;
use crate::simulation::scenario::Scenario;

use super::draws::pick;

/// Range of walking speeds (m/s), and distance of a walker from the wall (m).
const WALK_M_S: (f64, f64) = (0.9, 1.6);
const PAVEMENT_M: f64 = 1.5;

/// Draws the streets and houses of a drive.
pub(super) fn city(random: &mut Random) -> CityPlan {
    let lowest_m = random.uniform(5.0, 25.0);
    // Concrete and coated glass, and the loss of a circularly polarised antenna to a reflection.
    let weakest_db = random.uniform(4.0, 9.0);
    CityPlan {
        street_azimuth_rad: random.uniform(0.0, std::f64::consts::FRAC_PI_2),
        street_width_m: random.uniform(12.0, 40.0),
        block_m: random.uniform(50.0, 150.0),
        heights_m: (lowest_m, lowest_m + random.uniform(5.0, 90.0)),
        open_share: random.uniform(0.02, 0.35),
        reflection_loss_db: (weakest_db, weakest_db + random.uniform(6.0, 14.0)),
        pane_m: random.uniform(8.0, 30.0),
        reflecting_share: random.uniform(0.4, 0.9),
        longest_excess_m: 200.0,
        // Roofs are rounder and rougher than a knife edge: the loss grows faster.
        diffraction_limit_db: random.uniform(8.0, 13.0),
    }
}

/// Speed limits are 30 to 60 km/h. Half of the drives start inside a street and wait there for up
/// to a minute: a cold start between walls.
pub(super) fn traffic(plan: &CityPlan, walks: bool, random: &mut Random) -> Traffic {
    let half_m = 0.5 * plan.street_width_m;
    let starts_inside = random.chance(0.5);
    let (start_share, start_wait_s) = match starts_inside {
        true => (random.uniform(0.2, 0.6), random.uniform(0.0, 60.0)),
        false => (0.0, 0.0),
    };
    let moving = Traffic {
        red_probability: random.uniform(0.2, 0.6),
        red_s: (5.0, random.uniform(20.0, 60.0)),
        start_share,
        start_wait_s,
        ..Traffic::town()
    };
    match walks {
        true => {
            let speed_m_s = random.uniform(WALK_M_S.0, WALK_M_S.1);
            Traffic {
                cruise_m_s: speed_m_s,
                acceleration_m_s2: 0.5,
                turn_m_s: 0.8 * speed_m_s,
                turn_radius_m: 1.0,
                lane_m: half_m - PAVEMENT_M,
                ..moving
            }
        }
        false => Traffic {
            cruise_m_s: random.uniform(8.0, 17.0),
            acceleration_m_s2: random.uniform(1.0, 2.5),
            turn_m_s: 4.0,
            turn_radius_m: half_m.min(8.0),
            lane_m: (0.5 * half_m).min(3.0),
            ..moving
        },
    }
}

/// Draws origin, time, constellations and atmosphere of a drive.
pub(super) fn sky(random: &mut Random) -> Scenario {
    use Constellation as C;
    let open = Scenario::open_sky();
    let constellations = pick(
        random,
        &[
            (0.12, &[C::Gps][..]),
            (0.13, &[C::Gps, C::Glonass]),
            (0.2, &[C::Gps, C::BeiDou]),
            (0.15, &[C::Gps, C::Galileo]),
            (0.4, &[C::Gps, C::Glonass, C::Galileo, C::BeiDou]),
        ],
    );
    let origin = Geodetic::from_degrees(
        random.uniform(-45.0, 62.0),
        random.uniform(-180.0, 180.0),
        random.uniform(0.0, 300.0),
    );
    let mut gradient = || 1e-6 * random.uniform(-2.0, 2.0);
    let ionosphere_gradient = [gradient(), gradient()];
    let atmosphere = open.atmosphere.map(|atmosphere| Atmosphere {
        ionosphere_gradient,
        relative_humidity: random.uniform(0.2, 0.9),
        ..atmosphere
    });
    Scenario {
        start: open.start + random.uniform(-3.0 * 86_400.0, 2.0 * 86_400.0).round(),
        origin,
        constellations: constellations.to_vec(),
        atmosphere,
        base: None,
        ..open
    }
}
