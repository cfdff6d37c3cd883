//! Jumps of a receiver's clock.
//!
//! Many receivers let their clock drift and correct it by whole milliseconds. The pseudoranges jump
//! with the clock, the carrier phases not always.

use crate::gnss::constants::LIGHT_MILLISECOND_M;

/// Largest error of a predicted clock that is not a jump (m), in addition to an unknown drift.
const JUMP_M: f64 = 1e3;
/// Drift of an uncompensated crystal oscillator, 3 ppm (m/s).
pub(super) const CRYSTAL_DRIFT_M_S: f64 = 1e3;

/// The whole milliseconds nearest to an error of the predicted clock (m).
pub(super) fn whole_milliseconds_m(clock_error_m: f64) -> f64 {
    (clock_error_m / LIGHT_MILLISECOND_M).round() * LIGHT_MILLISECOND_M
}

/// The jump that explains an error of the predicted clock: zero or whole milliseconds. `None` if
/// neither explains it, so that the clock must restart.
pub(super) fn jump_m(clock_error_m: f64, interval_s: f64) -> Option<f64> {
    let allowed_m = JUMP_M + CRYSTAL_DRIFT_M_S * interval_s;
    let whole_m = whole_milliseconds_m(clock_error_m);
    ((clock_error_m - whole_m).abs() < allowed_m).then_some(whole_m)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 1.5 km in a second is drift. Two milliseconds minus 800 m are a jump. Half a millisecond is
    /// neither.
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
