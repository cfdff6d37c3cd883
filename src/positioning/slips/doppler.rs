//! Detector that compares the change of a phase with the Doppler before and after.

use super::causes::SlipCause;
use super::track::{Candidate, Sample, Track};
use crate::gnss::constants::SPEED_OF_LIGHT;

/// Deviation of Doppler as range rate (m/s): what is always there, and at the C/N0 below.
const FLOOR_M_S: f64 = 0.03;
const THERMAL_M_S: f64 = 0.05;
const REFERENCE_DB_HZ: f64 = 42.0;
/// Taken where no C/N0 is reported (dB-Hz).
const USUAL_DB_HZ: f64 = 40.0;
/// Jerk of a vehicle and of a receiver's clock (m/s³): the mean of two rates misses j·Δt³/12.
const JERK_M_S3: f64 = 2.0;
/// Standard deviations that a change may be off.
const FACTOR: f64 = 4.0;
/// Signals needed to tell what the clock did.
const SIGNALS_MIN: usize = 4;

/// Marks the phases whose change is not what the mean of two Dopplers says.
///
/// |Δ(λφ) + λ(D + D₊)Δt/2 − m| against 4σ; m, the median over all signals, is what the receiver's
/// clock did, a step by a millisecond included. Where half of the signals disagree the Doppler is
/// to blame, and nothing is marked.
pub(super) fn compare(
    candidates: &mut [Candidate],
    tracks: &[Track],
    is_static: bool,
    scratch: &mut Vec<f64>,
) {
    let mut common = |step_s: f64| {
        scratch.clear();
        let misses = candidates.iter().filter_map(|candidate| miss(candidate, tracks, step_s));
        scratch.extend(misses.map(|(miss_m, _)| miss_m));
        let middle = scratch.len().checked_sub(1)? / 2;
        Some(*scratch.select_nth_unstable_by(middle, f64::total_cmp).1)
    };
    // A clock that stepped has put the tags further apart than the phases were taken.
    let Some(step_s) = common(0.0).map(|common_m| common_m / SPEED_OF_LIGHT) else { return };
    let Some(common_m) = common(step_s) else { return };
    if scratch.len() < SIGNALS_MIN {
        return;
    }
    let is_off = |candidate: &Candidate| {
        let Some((miss_m, elapsed_s)) = miss(candidate, tracks, step_s) else { return false };
        let jerk_m_s3 = if is_static { 0.0 } else { JERK_M_S3 };
        let sigma_m = (rate_sigma_m_s(&candidate.sample) * elapsed_s / 2.0_f64.sqrt())
            .hypot(2.0_f64.sqrt() * candidate.sample.phase_sigma_m())
            .hypot(jerk_m_s3 * elapsed_s.powi(3) / 12.0);
        FACTOR * sigma_m < (miss_m - common_m).abs()
    };
    let off = candidates.iter().filter(|candidate| is_off(candidate)).count();
    if scratch.len() <= 2 * off {
        return;
    }
    for candidate in candidates.iter_mut() {
        if is_off(candidate) {
            candidate.causes.insert(SlipCause::Doppler);
        }
    }
}

/// Change of the phase less what the Dopplers say (m), and the time between (s): that of the tags
/// less what the clock stepped.
fn miss(candidate: &Candidate, tracks: &[Track], step_s: f64) -> Option<(f64, f64)> {
    let before = &candidate.continued(tracks)?.last;
    let after = &candidate.sample;
    let rate_m_s = 0.5 * (before.range_rate_m_s? + after.range_rate_m_s?);
    let elapsed_s = after.time - before.time - step_s;
    Some((after.phase_m - before.phase_m - rate_m_s * elapsed_s, elapsed_s))
}

fn rate_sigma_m_s(sample: &Sample) -> f64 {
    let cn0_db_hz = sample.cn0_db_hz.unwrap_or(USUAL_DB_HZ);
    FLOOR_M_S.hypot(THERMAL_M_S * 10_f64.powf((REFERENCE_DB_HZ - cn0_db_hz) / 20.0))
}
