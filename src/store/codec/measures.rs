//! The values of one solution that rollups add up and a history shows.

use crate::gnss::Solution;

/// The values of a solution with a position that a history shows. All are finite.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::store) struct Measures {
    /// Geodetic latitude (degrees).
    pub latitude_deg: f64,
    /// Longitude, east positive (degrees).
    pub longitude_deg: f64,
    /// Height above the ellipsoid (m).
    pub height_m: f64,
    /// Standard deviation along the worst horizontal direction (m).
    pub sigma_m: f64,
    /// Number of satellites used.
    pub satellites: f64,
    /// The epoch's time minus that of the base epoch (s), if the position is relative to a base.
    pub age_s: Option<f64>,
}

/// The measures of a solution; `None` without a position, or if a value is not finite.
pub(in crate::store) fn solution_measures(solution: &Solution) -> Option<Measures> {
    let estimate = solution.estimate.as_ref()?;
    if !estimate.covariance.iter().all(|v| v.is_finite()) {
        return None;
    }
    let position = estimate.position.to_geodetic();
    let measures = Measures {
        latitude_deg: position.latitude_rad.to_degrees(),
        longitude_deg: position.longitude_rad.to_degrees(),
        height_m: position.height_m,
        sigma_m: estimate.sigmas_m().0,
        satellites: estimate.satellites_used.len() as f64,
        age_s: estimate.relative.as_ref().map(|r| r.age_s).filter(|age_s| age_s.is_finite()),
    };
    let Measures { latitude_deg, longitude_deg, height_m, sigma_m, .. } = measures;
    let are_finite = [latitude_deg, longitude_deg, height_m, sigma_m].iter().all(|v| v.is_finite());
    are_finite.then_some(measures)
}

#[cfg(test)]
mod tests {
    use nalgebra::Matrix3;

    use crate::gnss::{Dops, Ecef, GpsTime, Provenance, SolutionEstimate, Status};

    use super::*;

    fn solution(covariance: Matrix3<f64>) -> Solution {
        let estimate = SolutionEstimate {
            position: Ecef::new(0.0, 6_378_137.0, 0.0),
            covariance,
            velocity: None,
            clock_m: 0.0,
            inter_system_biases_m: Vec::new(),
            reception_time: GpsTime::EPOCH,
            dops: Dops { gdop: 1.0, pdop: 1.0, hdop: 1.0, vdop: 1.0, tdop: 1.0 },
            satellites_used: vec!["G05".parse().unwrap()],
            relative: None,
        };
        Solution {
            time: GpsTime::EPOCH,
            status: Status::Single,
            estimate: Some(estimate),
            protection: None,
            reasons: Vec::new(),
            provenance: Provenance { ephemerides: Vec::new(), base: None },
        }
    }

    /// On the equator at 90° east.
    #[test]
    fn a_solution_is_measured_in_degrees_and_metres() {
        let measures = solution_measures(&solution(Matrix3::identity() * 4.0)).unwrap();
        assert_eq!((measures.latitude_deg, measures.longitude_deg), (0.0, 90.0));
        assert!(measures.height_m.abs() < 1e-6 && (measures.sigma_m - 2.0).abs() < 1e-12);
        assert_eq!((measures.satellites, measures.age_s), (1.0, None));
    }

    #[test]
    fn a_solution_without_position_or_sigma_has_no_measures() {
        assert_eq!(solution_measures(&Solution::none(GpsTime::EPOCH, vec![])), None);
        assert_eq!(solution_measures(&solution(Matrix3::identity() * f64::INFINITY)), None);
    }
}
