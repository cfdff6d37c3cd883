//! Protection levels: distances that errors exceed with a stated probability, and their limits.
//!
//! Single points bound their error by the hypotheses that one satellite is wrong
//! (`spp::protection`). The other modes use their reported covariance with the tail of Student's t
//! of ν degrees of freedom:
//!
//! HPL = √λ₁·√(ν·(P^(−2/ν) − 1)), VPL = σ_u·√(ν·(P^(−2/ν) − 1)),
//!
//! λ₁ the larger eigenvalue of the horizontal covariance, P the risk: the radius of a bivariate t
//! is √(2·F(2, ν)), whose tail is (1 + r²/ν)^(−ν/2) (Kotz & Nadarajah 2004, *Multivariate t
//! distributions and their applications*, section 1.7), which also bounds one component.
//!
//! A fixed solution whose integers are wrong with a probability above the risk has no level. While
//! a start is unproven, another position may be as likely, and no covariance shows this. The levels
//! are then at least the longest delay of multipath.

use crate::config::{Beyond, IntegrityOptions};
use crate::gnss::{LocalFrame, Protection, Reason, Solution, SolutionEstimate, Status};

use super::pseudorange_error::WILD_M;

/// ν.
const DEGREES: f64 = 4.0;

/// Sets the protection levels of a solution if its mode has not, and applies their limits.
pub(super) fn complete(solution: &mut Solution, options: &IntegrityOptions) {
    let Some(estimate) = &solution.estimate else { return };
    if solution.protection.is_none() {
        solution.protection = of_covariance(solution.status, estimate, options.risk);
        let is_unproven = |reason: &Reason| matches!(reason, Reason::StartUnproven { .. });
        if let Some(levels) = &mut solution.protection
            && solution.reasons.iter().any(is_unproven)
        {
            levels.horizontal_m = levels.horizontal_m.max(WILD_M);
            levels.vertical_m = levels.vertical_m.max(WILD_M);
        }
    }
    let levels = solution.protection;
    let exceeded = [
        (levels.map(|levels| levels.horizontal_m), options.limit_h_m),
        (levels.map(|levels| levels.vertical_m), options.limit_v_m),
    ];
    let exceeded = exceeded.into_iter().find(|(level_m, limit_m)| {
        limit_m.is_finite() && level_m.is_none_or(|level_m| *limit_m < level_m)
    });
    let Some((level_m, limit_m)) = exceeded else { return };
    solution.reasons.push(Reason::ProtectionLimitExceeded { level_m, limit_m });
    if options.beyond == Beyond::Withhold {
        solution.status = Status::None;
        solution.estimate = None;
        solution.protection = None;
        solution.provenance = Default::default();
    }
}

/// The same for each of several solutions.
pub(super) fn complete_all(solutions: &mut [Solution], options: &IntegrityOptions) {
    solutions.iter_mut().for_each(|solution| complete(solution, options));
}

/// Levels of a reported covariance; `None` if it gives no bound.
fn of_covariance(status: Status, estimate: &SolutionEstimate, risk: f64) -> Option<Protection> {
    let integers = estimate.relative.as_ref().filter(|_| status == Status::Fixed);
    let wrong_probability =
        integers.and_then(|relative| relative.fix_probability).map_or(0.0, |p| 1.0 - p);
    if risk < wrong_probability {
        return None;
    }
    let enu = LocalFrame::at(estimate.position).covariance_to_enu(&estimate.covariance);
    let radius = radius(risk);
    let levels = Protection {
        horizontal_m: major_m2(enu[(0, 0)], enu[(1, 1)], enu[(0, 1)]).sqrt() * radius,
        vertical_m: enu[(2, 2)].sqrt() * radius,
    };
    (levels.horizontal_m.is_finite() && levels.vertical_m.is_finite()).then_some(levels)
}

/// The larger eigenvalue of a symmetric 2×2 matrix.
pub(super) fn major_m2(xx: f64, yy: f64, xy: f64) -> f64 {
    let half = 0.5 * (xx - yy);
    0.5 * (xx + yy) + half.hypot(xy)
}

/// Radius of a bivariate t that is exceeded with probability `risk`, in units of its scale.
fn radius(risk: f64) -> f64 {
    (DEGREES * (risk.powf(-2.0 / DEGREES) - 1.0)).sqrt()
}

/// The value that a standard normal variable exceeds with probability `tail`, 0 < `tail` ≤ ½:
/// Abramowitz & Stegun (1964), *Handbook of Mathematical Functions*, 26.2.23, within 4.5·10⁻⁴.
pub(super) fn normal_one_sided(tail: f64) -> f64 {
    let t = (-2.0 * tail.ln()).sqrt();
    let numerator = 2.515_517 + t * (0.802_853 + t * 0.010_328);
    let denominator = 1.0 + t * (1.432_788 + t * (0.189_269 + t * 0.001_308));
    (t - numerator / denominator).max(0.0)
}

/// The length that a bivariate normal vector of unit variances exceeds with probability `tail`,
/// 0 < `tail` ≤ 1: Rayleigh's distribution.
pub(super) fn bivariate_normal(tail: f64) -> f64 {
    (-2.0 * tail.ln()).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gnss::{Dops, Ecef, GpsTime, Provenance};
    use nalgebra::Matrix3;

    /// F(2, 4) is 6.94 at 5 %: √(2·6.944).
    #[test]
    fn the_horizontal_quantile_is_that_of_f() {
        assert!((radius(0.05) - (2.0 * 6.944_272_f64).sqrt()).abs() < 1e-5);
    }

    /// 3.0902 at 0.1 %, 1.6449 at 5 %.
    #[test]
    fn the_normal_quantile_is_that_of_the_tables() {
        assert!((normal_one_sided(1e-3) - 3.090_2).abs() < 5e-4, "{}", normal_one_sided(1e-3));
        assert!((normal_one_sided(0.05) - 1.644_9).abs() < 5e-4);
        assert!(normal_one_sided(0.5) < 5e-4);
    }

    /// χ² of two degrees of freedom is 13.8155 at 0.1 %.
    #[test]
    fn the_bivariate_quantile_is_that_of_the_tables() {
        assert!((bivariate_normal(1e-3) - 13.815_51_f64.sqrt()).abs() < 1e-6);
        assert_eq!(bivariate_normal(1.0), 0.0);
    }

    /// Integers that are wrong in one of a hundred epochs give no bound at a risk of one in a
    /// thousand.
    #[test]
    fn doubtful_integers_have_no_level() {
        use crate::gnss::RelativeEstimate;
        let level = |fix_probability| {
            let mut answer = solution();
            answer.status = Status::Fixed;
            answer.estimate.as_mut().unwrap().relative = Some(RelativeEstimate {
                baseline_m: nalgebra::Vector3::zeros(),
                age_s: 0.0,
                ambiguities: 5,
                fixed_ambiguities: 5,
                ratio: None,
                success_rate: None,
                fix_probability: Some(fix_probability),
            });
            complete(&mut answer, &options());
            answer.protection
        };
        assert_eq!(level(0.99), None);
        let sure = level(0.9999).unwrap();
        assert!((sure.horizontal_m - radius(1e-3)).abs() < 1e-9);
    }

    /// 440 m is 1.5 chips of 293 m.
    #[test]
    fn an_unproven_start_may_be_anywhere_that_multipath_leads() {
        let mut answer = solution();
        answer.reasons.push(Reason::StartUnproven { age_s: 3.0 });
        complete(&mut answer, &options());
        let levels = answer.protection.unwrap();
        assert!((levels.horizontal_m - 439.6).abs() < 0.1 && levels.vertical_m == WILD_M);
    }

    /// Eigenvalues of [4 2; 2 1] are 5 and 0.
    #[test]
    fn the_larger_eigenvalue_worked_by_hand() {
        assert!((major_m2(4.0, 1.0, 2.0) - 5.0).abs() < 1e-12);
    }

    fn solution() -> Solution {
        let time = GpsTime::from_week_seconds(2300, 100.0);
        let estimate = SolutionEstimate {
            position: Ecef::new(6_378_147.0, 0.0, 0.0),
            covariance: Matrix3::identity(),
            velocity: None,
            clock_m: 0.0,
            inter_system_biases_m: Vec::new(),
            reception_time: time,
            dops: Dops { gdop: 2.0, pdop: 1.5, hdop: 1.0, vdop: 1.1, tdop: 1.2 },
            satellites_used: Vec::new(),
            relative: None,
        };
        Solution {
            time,
            status: Status::Fgo,
            estimate: Some(estimate),
            protection: None,
            reasons: Vec::new(),
            provenance: Provenance::default(),
        }
    }

    fn options() -> IntegrityOptions {
        use crate::config::{Mode, PositioningOptions, Profile};
        PositioningOptions::new(Mode::Fgo, Profile::General).integrity
    }

    #[test]
    fn without_limits_a_position_has_levels_and_no_reason() {
        let mut answer = solution();
        complete(&mut answer, &options());
        let levels = answer.protection.unwrap();
        assert!((levels.horizontal_m - radius(1e-3)).abs() < 1e-9);
        assert!((levels.vertical_m - radius(1e-3)).abs() < 1e-9);
        assert!(answer.reasons.is_empty());
    }

    #[test]
    fn beyond_a_limit_a_position_is_flagged_or_withheld() {
        let flag = IntegrityOptions { limit_v_m: 5.0, ..options() };
        let mut flagged = solution();
        complete(&mut flagged, &flag);
        assert_eq!(flagged.status, Status::Fgo);
        let [Reason::ProtectionLimitExceeded { level_m: Some(level_m), limit_m }] =
            flagged.reasons[..]
        else {
            panic!("{:?}", flagged.reasons);
        };
        assert!(limit_m == 5.0 && (level_m - radius(1e-3)).abs() < 1e-9);
        let mut withheld = solution();
        complete(&mut withheld, &IntegrityOptions { beyond: Beyond::Withhold, ..flag });
        assert_eq!((withheld.status, withheld.estimate), (Status::None, None));
        assert_eq!(withheld.reasons, flagged.reasons);
        let mut within = solution();
        complete(&mut within, &IntegrityOptions { limit_h_m: 50.0, ..options() });
        assert!(within.reasons.is_empty());
    }
}
