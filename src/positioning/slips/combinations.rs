//! Detectors that compare the signals of one satellite: geometry-free and Melbourne–Wübbena.

use super::causes::SlipCause;
use super::track::{Candidate, Pairing, Sample, Track, Trend, Verdict, WideLane};
use crate::gnss::GpsTime;
use crate::gnss::constants::SPEED_OF_LIGHT;

/// Standard deviations that a value may be off; Blewitt (1990) for the wide lane.
const FACTOR: f64 = 4.0;
/// Standard deviation of the wide-lane ambiguity before it is known (cycles).
const FIRST_WIDE_LANE_SIGMA: f64 = 0.5;
/// The wide-lane ambiguity slips by whole cycles; less than this is no slip (cycles).
const TOLERATED_WIDE_LANE: f64 = 0.75;
/// The running mean forgets what is older than so many epochs.
const WIDE_LANE_MEMORY: u16 = 300;
/// Signals of one satellite that are compared; more than any satellite sends and receivers track.
const SIGNALS_LIMIT: usize = 16;

/// One signal's change since the epoch to which it is compared.
#[derive(Clone, Copy)]
struct Change {
    /// Among the changes.
    place: usize,
    candidate: usize,
    frequency_hz: f64,
    wavelength_m: f64,
    /// Against the first signal, less what its drift explains (m).
    excess_m: f64,
    noise_m2: f64,
    drift_m2: f64,
    agrees: u32,
}

/// Geometry-free: marks the signals of a satellite whose phases no longer agree.
///
/// The difference of two phases in metres changes by the ionosphere alone; a trend predicts it. Two
/// signals disagree where the prediction fails by 4σ and by half of what one cycle on both would
/// do, |λ_1 − λ_2|/2. Of disagreeing signals those survive that agree with one on another frequency
/// and are most; of two, the one that the other satellites vouch for, if they name the other.
pub(super) fn geometry_free(group: &mut [Candidate], tracks: &[Track]) {
    let mut changes = [None; SIGNALS_LIMIT];
    let count = gather(group, tracks, &mut changes);
    let changes = &mut changes[..count];
    if count < 2 {
        return;
    }
    for i in 0..count {
        for j in 0..i {
            if let (Some(a), Some(b)) = (changes[i], changes[j])
                && agree(&a, &b)
            {
                mark(changes, i, j);
                mark(changes, j, i);
            }
        }
    }
    let whole = (1_u32 << count) - 1;
    let spans = |set: u32| {
        let inside = changes.iter().flatten().enumerate();
        let mut inside = inside.filter(|(index, _)| set & (1 << index) != 0);
        let first = inside.next().map(|(_, change)| change.frequency_hz);
        inside.any(|(_, change)| Some(change.frequency_hz) != first)
    };
    let own = |(index, change): (usize, &Change)| change.agrees | (1 << index);
    let sets = changes.iter().flatten().enumerate().map(own);
    if sets.clone().all(|set| set == whole) {
        return;
    }
    let best = sets.filter(|set| spans(*set)).max_by_key(|set| set.count_ones());
    let best = best.or_else(|| vouched(group, changes)).unwrap_or(0);
    for (index, change) in changes.iter().flatten().enumerate() {
        if best & (1 << index) == 0 {
            group[change.candidate].causes.insert(SlipCause::GeometryFree);
        }
    }
}

/// The signals that go on in the eyes of the other satellites, if these say that the rest slipped.
fn vouched(group: &[Candidate], changes: &[Option<Change>]) -> Option<u32> {
    let mut set = 0;
    for (index, change) in changes.iter().flatten().enumerate() {
        match group[change.candidate].verdict {
            Verdict::Continues => set |= 1 << index,
            Verdict::Slipped => {}
            Verdict::Untested | Verdict::Shared => return None,
        }
    }
    let agree = |change: &Change| set & !change.agrees == set & (1 << change.place);
    let inside = changes.iter().flatten().filter(|change| set & (1 << change.place) != 0);
    inside.clone().all(agree).then_some(set)
}

fn mark(changes: &mut [Option<Change>], of: usize, with: usize) {
    if let Some(change) = &mut changes[of] {
        change.agrees |= 1 << with;
    }
}

/// The changes of all signals that go on from one and the same epoch; returns how many.
fn gather(
    group: &[Candidate],
    tracks: &[Track],
    changes: &mut [Option<Change>; SIGNALS_LIMIT],
) -> usize {
    let mut count = 0;
    let mut first: Option<(&Candidate, &Track)> = None;
    for (index, candidate) in group.iter().enumerate().take(SIGNALS_LIMIT) {
        let Some(track) = candidate.continued(tracks) else { continue };
        let (main, main_track) = *first.get_or_insert((candidate, track));
        if track.last.time != main_track.last.time {
            continue;
        }
        let elapsed_s = candidate.sample.time - track.last.time;
        let step = |c: &Candidate, t: &Track| c.sample.phase_m - t.last.phase_m;
        let trend = trend_of(track, main);
        let is_main = count == 0;
        let (expected_m, drift_m2) = match is_main {
            true => (0.0, 0.0),
            false => (trend.expected_m(elapsed_s), trend.variance_m2(elapsed_s)),
        };
        changes[count] = Some(Change {
            place: count,
            candidate: index,
            frequency_hz: candidate.sample.frequency_hz,
            wavelength_m: candidate.sample.wavelength_m,
            excess_m: step(candidate, track) - step(main, main_track) - expected_m,
            noise_m2: candidate.sample.phase_sigma_m().powi(2) + track.last.phase_sigma_m().powi(2),
            drift_m2,
            agrees: 0,
        });
        count += 1;
    }
    count
}

fn agree(a: &Change, b: &Change) -> bool {
    // Signals of one frequency are delayed alike.
    let drift_m2 = if a.frequency_hz == b.frequency_hz { 0.0 } else { a.drift_m2 + b.drift_m2 };
    let sigma_m = (a.noise_m2 + b.noise_m2 + drift_m2).sqrt();
    let both_cycles_m = (a.wavelength_m - b.wavelength_m).abs();
    (a.excess_m - b.excess_m).abs() <= (FACTOR * sigma_m).max(0.5 * both_cycles_m)
}

fn trend_of(track: &Track, main: &Candidate) -> Trend {
    let known = track.pairing.filter(|pairing| pairing.with == main.sample.code);
    known.map_or(Trend::new(), |pairing| pairing.trend)
}

/// Melbourne–Wübbena: marks both signals where the wide-lane ambiguity left its mean by 4σ.
///
/// W = φ_1 − φ_2 − (f_1 − f_2)/(f_1 + f_2)·(P_1/λ_1 + P_2/λ_2), in cycles of c/(f_1 − f_2). Running
/// mean and deviation as in Blewitt (1990), *An automatic editing algorithm for GPS data*.
/// `code_offset_m` is what the receiver's clock stepped in the pseudoranges alone.
pub(super) fn melbourne_wuebbena(group: &mut [Candidate], tracks: &[Track], code_offset_m: f64) {
    for other in 1..group.len() {
        let Some((main, wide_lane)) = known_wide_lane(group, tracks, other) else { continue };
        let Some(value) = wide_lane_cycles(&group[main], &group[other], code_offset_m) else {
            continue;
        };
        let tolerated = (FACTOR * wide_lane.variance.sqrt()).max(TOLERATED_WIDE_LANE);
        if tolerated < (value - wide_lane.mean).abs() {
            group[main].causes.insert(SlipCause::MelbourneWuebbena);
            group[other].causes.insert(SlipCause::MelbourneWuebbena);
        }
    }
}

/// Place of the signal to which another is tied, and the wide-lane ambiguity of the two, where both
/// go on.
fn known_wide_lane(
    group: &[Candidate],
    tracks: &[Track],
    other: usize,
) -> Option<(usize, WideLane)> {
    let pairing = group[other].continued(tracks)?.pairing?;
    let main = group.iter().position(|candidate| candidate.sample.code == pairing.with)?;
    group[main].continued(tracks)?;
    pairing.wide_lane.map(|wide_lane| (main, wide_lane))
}

fn wide_lane_cycles(a: &Candidate, b: &Candidate, code_offset_m: f64) -> Option<f64> {
    let (a, b) = (&a.sample, &b.sample);
    if a.frequency_hz == b.frequency_hz {
        return None;
    }
    let range =
        |sample: &Sample| Some((sample.pseudorange_m? - code_offset_m) / sample.wavelength_m);
    let narrow = (a.frequency_hz - b.frequency_hz) / (a.frequency_hz + b.frequency_hz);
    let phases = a.phase_m / a.wavelength_m - b.phase_m / b.wavelength_m;
    Some(phases - narrow * (range(a)? + range(b)?))
}

impl WideLane {
    fn first(value: f64) -> Self {
        Self { mean: value, variance: FIRST_WIDE_LANE_SIGMA * FIRST_WIDE_LANE_SIGMA, count: 1 }
    }

    /// Mean and variance with one value more.
    fn with(self, value: f64) -> Self {
        let count = (self.count + 1).min(WIDE_LANE_MEMORY);
        let off = value - self.mean;
        let share = 1.0 / f64::from(count);
        Self {
            mean: self.mean + share * off,
            variance: self.variance + share * (off * off - self.variance),
            count,
        }
    }
}

/// What ties the signals of a satellite together after this epoch; `arcs` tells of each whether
/// it goes on. In the order of `group`.
pub(super) fn next_pairings(
    group: &[Candidate],
    tracks: &[Track],
    goes_on: impl Fn(usize) -> bool,
    code_offset_m: f64,
    mut put: impl FnMut(usize, Option<Pairing>),
) {
    put(0, None);
    let main = &group[0];
    for (index, candidate) in group.iter().enumerate().skip(1) {
        let before = candidate.track.and_then(|track| tracks[track].pairing);
        let before = before.filter(|pairing| pairing.with == main.sample.code);
        let mut trend = before.map_or(Trend::new(), |pairing| pairing.trend);
        let both = main.continued(tracks).zip(candidate.continued(tracks));
        let both = both.filter(|(a, b)| a.last.time == b.last.time);
        let (main_goes_on, goes_on) = (goes_on(0), goes_on(index));
        if let Some((main_track, track)) = both {
            let jumped = [main, candidate].map(|c| c.causes.contains(SlipCause::GeometryFree));
            let is_believed = !jumped.contains(&true);
            if !is_believed || (main_goes_on && goes_on) {
                learn(&mut trend, (main, main_track), (candidate, track), is_believed);
            }
        }
        let both = both.filter(|_| main_goes_on && goes_on);
        let value = wide_lane_cycles(main, candidate, code_offset_m);
        let kept = before.filter(|_| both.is_some()).and_then(|pairing| pairing.wide_lane);
        let jumped = candidate.causes.contains(SlipCause::MelbourneWuebbena);
        let wide_lane = match (value, kept.filter(|_| !jumped)) {
            (Some(value), Some(kept)) => Some(kept.with(value)),
            (Some(value), None) => Some(WideLane::first(value)),
            (None, kept) => kept,
        };
        put(index, Some(Pairing { with: main.sample.code, trend, wide_lane }));
    }
}

fn learn(
    trend: &mut Trend,
    (main, main_track): (&Candidate, &Track),
    (candidate, track): (&Candidate, &Track),
    is_believed: bool,
) {
    let step = |c: &Candidate, t: &Track| c.sample.phase_m - t.last.phase_m;
    let noise = |c: &Candidate| 2.0 * c.sample.phase_sigma_m().powi(2);
    let elapsed_s = candidate.sample.time - track.last.time;
    let change_m = step(candidate, track) - step(main, main_track);
    let variance_m2 = noise(candidate) + noise(main);
    match is_believed {
        true => trend.learn(change_m, variance_m2, elapsed_s),
        false => trend.doubt(change_m, variance_m2, elapsed_s),
    }
}

/// Whole milliseconds by which the pseudoranges of most signals left their phases since the last
/// epoch (m): receivers step their clocks.
pub(super) fn code_step_m(
    candidates: &[Candidate],
    tracks: &[Track],
    last: Option<GpsTime>,
    scratch: &mut Vec<f64>,
) -> f64 {
    const MILLISECOND_M: f64 = 1e-3 * SPEED_OF_LIGHT;
    scratch.clear();
    scratch.extend(candidates.iter().filter_map(|candidate| {
        let track = candidate.continued(tracks).filter(|track| Some(track.last.time) == last)?;
        let code_m = candidate.sample.pseudorange_m? - track.last.pseudorange_m?;
        Some(code_m - (candidate.sample.phase_m - track.last.phase_m))
    }));
    let Some(middle) = scratch.len().checked_sub(1) else { return 0.0 };
    let median_m = *scratch.select_nth_unstable_by(middle / 2, f64::total_cmp).1;
    (median_m / MILLISECOND_M).round() * MILLISECOND_M
}
