//! Steps of a receiver's clock.
//!
//! Many receivers let their clock drift and set it back by a millisecond; the pseudoranges step
//! with it, the phases sometimes do not.

use crate::gnss::constants::LIGHT_MILLISECOND_M;

/// Clocks that miss their prediction by more jumped (m), besides what an unknown drift explains.
const JUMP_M: f64 = 1e3;
/// Drift of a plain crystal, 3 ppm (m/s).
pub(super) const CRYSTAL_DRIFT_M_S: f64 = 1e3;

/// The whole milliseconds nearest to a miss (m).
pub(super) fn whole_milliseconds_m(miss_m: f64) -> f64 {
    (miss_m / LIGHT_MILLISECOND_M).round() * LIGHT_MILLISECOND_M
}

/// The jump that a miss of the clock's prediction is taken for: none, whole milliseconds, or
/// `None` where it is neither and the clock starts anew.
pub(super) fn jump_m(miss_m: f64, interval_s: f64) -> Option<f64> {
    let allowed_m = JUMP_M + CRYSTAL_DRIFT_M_S * interval_s;
    let whole_m = whole_milliseconds_m(miss_m);
    ((miss_m - whole_m).abs() < allowed_m).then_some(whole_m)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 1.5 km in a second is drift; two milliseconds less 800 m a jump; half a millisecond neither.
    #[test]
    fn misses_are_drift_jumps_or_new_clocks() {
        assert_eq!(jump_m(1_500.0, 1.0), Some(0.0));
        assert_eq!(
            jump_m(-2.0 * LIGHT_MILLISECOND_M + 800.0, 1.0),
            Some(-2.0 * LIGHT_MILLISECOND_M)
        );
        assert_eq!(jump_m(0.5 * LIGHT_MILLISECOND_M, 1.0), None);
    }
}
