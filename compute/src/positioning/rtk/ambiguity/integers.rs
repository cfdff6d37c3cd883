//! The search for integers among float ambiguities.
//!
//! An integer that was found is held with its arc, relative to a datum of the arc's group. Held
//! integers are not part of the graph. At each epoch the float solution is tested against the
//! proven integers. If it still agrees, it is conditioned on them; if not, they are dropped. The
//! conditioned solution is then searched for the integers of the other ambiguities. These integers
//! are on trial: they are searched again until enough epochs in a row have found them.

use nalgebra::DMatrix;

use crate::config::RtkOptions;
use crate::gnss::{GpsTime, Reason};
use crate::lambda::{KnownScale, Options, Outcome, Partial, Resolver};
use crate::positioning::rtk::observed::{Arcs, CarrierArc, HeldInteger};

use super::acceptance::{lambda_options, refusal};
use super::differences::{Differences, DoubleDifference};
use super::fixed_position::{FixedPosition, LocalPosition, fixed_position};
use super::float::FloatSolution;
use super::held_integers::HeldIntegers;
use super::hold::{FOUND_EPOCHS, Found, HoldState, NEARLY_CERTAIN};
use super::joint::{Joint, bonferroni, condition, given_unfixed_ambiguities, scale_odds};

/// Number of ambiguities for which storage is reserved at first.
const CAPACITY: usize = 64;
/// Largest number of subsets tried when new ambiguities join held integers; each epoch tries again.
const OTHERS_ATTEMPTS_MAX: usize = 3;
/// ‖â − z‖² per held integer below which they are accepted without a search: 2σ rms.
pub(crate) const DISAGREEMENT: f64 = 4.0;

/// Outcome of a search.
#[derive(Clone, Debug)]
pub(crate) struct Resolution {
    /// Double-differenced ambiguities.
    pub(crate) ambiguities: usize,
    pub(crate) ratio: Option<f64>,
    pub(crate) success_rate: Option<f64>,
    pub(crate) outcome: Result<FixedPosition, Reason>,
}

impl Resolution {
    /// The ambiguities stay real-valued because the caller requests no integers.
    pub(crate) fn unresolved(ambiguities: usize) -> Self {
        let (ratio, success_rate) = (None, None);
        Self { ambiguities, ratio, success_rate, outcome: Err(Reason::FixRejected) }
    }

    /// This resolution, refused for a reason.
    pub(crate) fn refused(self, reason: Reason) -> Self {
        Self { outcome: Err(reason), ..self }
    }

    /// Rejects a fix with a horizontal standard deviation above 5 cm or a vertical one above 15 cm.
    pub(crate) fn require_precise(self) -> Self {
        let precise = |fixed: FixedPosition| match fixed.excessive_sigma_m() {
            Some(sigma_m) => Err(Reason::FixImprecise { sigma_m }),
            None => Ok(fixed),
        };
        Self { outcome: self.outcome.and_then(precise), ..self }
    }
}

/// The question that a search answers.
#[derive(Clone, Copy, Debug)]
pub(crate) struct IntegerQuestion<'a> {
    /// Only arcs with a phase at this time.
    pub(crate) time: GpsTime,
    pub(crate) float: &'a FloatSolution,
    pub(crate) noise: KnownScale,
    pub(crate) options: &'a RtkOptions,
}

/// How a search is judged.
#[derive(Clone, Copy, Debug)]
struct Judgement<'a> {
    options: &'a Options,
    /// Epochs in a row that prove an integer.
    hold_epochs: u32,
    /// Whether the integers found replace the held ones, with which the float solution disagrees.
    replaces_held: bool,
}

impl Judgement<'_> {
    /// Epochs in a row that prove an integer, given the probability of the search of the last one.
    fn proven_after(&self, probability: f64) -> u32 {
        match NEARLY_CERTAIN <= probability {
            true => FOUND_EPOCHS.min(self.hold_epochs),
            false => self.hold_epochs,
        }
    }
}

/// Why held integers do not fix an epoch.
enum Unfixed {
    /// Too few of their arcs have a phase.
    TooFew,
    /// The float solution is too far from them.
    Disagreeing,
}

/// An arc on trial: its index, its integer and the number of epochs that found it.
type Trial = (usize, Option<HeldInteger>, u32);

/// Searches for integers; its memory is used again.
#[derive(Debug)]
pub(crate) struct IntegerSearch {
    pub(crate) resolver: Resolver,
    pub(super) held: HeldIntegers,
    pub(super) differences: Differences,
    order: Vec<usize>,
}

impl Default for IntegerSearch {
    fn default() -> Self {
        Self {
            resolver: Resolver::with_capacity(CAPACITY),
            held: HeldIntegers::with_capacity(CAPACITY),
            differences: Differences::default(),
            order: Vec::new(),
        }
    }
}

impl IntegerSearch {
    /// Searches for the integers of the arcs with a phase, and holds the integers it finds.
    pub(crate) fn resolve(
        &mut self,
        arcs: &mut Arcs,
        hold: &mut HoldState,
        question: &IntegerQuestion<'_>,
        is_confirmed: bool,
    ) -> Resolution {
        let IntegerQuestion { time, float, noise, options } = *question;
        self.held.forget();
        let is_eligible = |arc: &CarrierArc| arc.last == time && may_be_integer(arc, options);
        self.differences.form(arcs.list(), is_eligible, float);
        for pair in self.differences.pairs.iter().filter(|pair| pair.known.is_none()) {
            if arcs.list()[pair.reference].held.is_some() {
                arcs.forget(pair.arc);
            }
        }
        if self.differences.pairs.len() < options.fixed_min {
            let (used, needed) = (self.differences.pairs.len(), options.fixed_min);
            return self.refused(Reason::TooFewCommonSatellites { used, needed });
        }
        let joint = self.differences.joint(float);
        let lambda = lambda_options(options, noise);
        let hold_epochs = options.hold_epochs;
        let all = Judgement { options: &lambda, hold_epochs, replaces_held: false };
        let (period, is_held) = (hold.period, hold_epochs <= hold.epochs_in_a_row);
        if !(is_confirmed && is_held) {
            let resolution = self.resolve_all(arcs, hold, &joint, &all);
            if resolution.outcome.is_err() && hold.period == period {
                hold.missed();
            }
            return resolution;
        }
        let held = Options { probability_min: options.hold_probability_min, ..lambda };
        match self.resolve_held(arcs, hold, &joint, &Judgement { options: &held, ..all }) {
            Ok(resolution) => resolution,
            // The others may return.
            Err(Unfixed::TooFew) => self.resolve_all(arcs, hold, &joint, &all),
            Err(Unfixed::Disagreeing) => {
                let instead = Judgement { replaces_held: true, ..all };
                let resolution = self.resolve_all(arcs, hold, &joint, &instead);
                if resolution.outcome.is_err() && hold.period == period {
                    // Without other integers there is no proof that the held ones are wrong.
                    hold.release(arcs);
                }
                resolution
            }
        }
    }

    /// The known integers of the pairs `wanted`.
    pub(super) fn known_values(&self, wanted: &[usize]) -> Vec<f64> {
        wanted.iter().map(|&i| self.differences.pairs[i].known.unwrap_or(0) as f64).collect()
    }

    fn refused(&self, reason: Reason) -> Resolution {
        let ambiguities = self.differences.pairs.len();
        let (ratio, success_rate) = (None, None);
        Resolution { ambiguities, ratio, success_rate, outcome: Err(reason) }
    }

    /// Conditions on the proven integers, then searches for those of the others.
    ///
    /// If too few are proven, those on trial are held as well, and `probability_min` is their
    /// probability: each was found with at least that.
    fn resolve_held(
        &mut self,
        arcs: &mut Arcs,
        hold: &mut HoldState,
        joint: &Joint,
        judgement: &Judgement<'_>,
    ) -> Result<Resolution, Unfixed> {
        let Judgement { options, .. } = *judgement;
        let is_enough = options.fixed_min <= self.differences.which(|pair| pair.is_proven).len();
        let is_held =
            |pair: &DoubleDifference| pair.is_proven || !is_enough && pair.known.is_some();
        let held = self.differences.which(is_held);
        let others = self.differences.which(|pair| !is_held(pair));
        if held.len() < options.fixed_min {
            return Err(Unfixed::TooFew);
        }
        let conditioned = condition(joint, &held, &self.known_values(&held), &others);
        let (rest, squared_norm) = conditioned.ok_or(Unfixed::Disagreeing)?;
        // Errors that are correlated in time put float ambiguities further from their integers than
        // their covariance allows. This is no evidence against the integers as long as no others
        // fit better.
        let against = match DISAGREEMENT * (held.len() as f64) < squared_norm {
            true => self.held.load(&self.differences.pairs, &held, joint, options).map(|l| l.odds),
            false => Some(1.0),
        };
        let odds = against.ok_or(Unfixed::Disagreeing)?;
        let against_others = scale_odds(odds, hold.probability);
        let probability = given_unfixed_ambiguities(against_others, &rest);
        if probability < options.probability_min {
            return Err(Unfixed::Disagreeing);
        }
        let least = if is_enough { 1.0 } else { options.probability_min };
        let by_proven = is_enough.then(|| LocalPosition::of(&rest));
        let trial = self.try_others(arcs, hold, &rest, &others, judgement);
        let (rest, added, likely) = trial.unwrap_or((rest, 0, 1.0));
        let fixed = fixed_position(&rest, held.len() + added, probability * likely * least);
        Ok(Resolution {
            ambiguities: self.differences.pairs.len(),
            ratio: hold.ratio,
            success_rate: hold.success_rate,
            outcome: Ok(FixedPosition { by_proven, ..fixed }),
        })
    }

    /// Searches for the integers of the pairs `others`, whose ambiguities are those of `joint`.
    /// Returns the distribution conditioned on the integers found, their number and their
    /// probability. Arcs on trial whose integers are not found again lose them.
    fn try_others(
        &mut self,
        arcs: &mut Arcs,
        hold: &mut HoldState,
        joint: &Joint,
        others: &[usize],
        judgement: &Judgement<'_>,
    ) -> Option<(Joint, usize, f64)> {
        let before = self.on_trial(arcs, others.iter().copied());
        let lambda =
            Options { fixed_min: 1, attempts_max: OTHERS_ATTEMPTS_MAX, ..*judgement.options };
        let indices: Vec<usize> = (0..others.len()).collect();
        let found = match others.is_empty() {
            true => None,
            false => self.search(arcs.list(), joint, &indices, others, &lambda),
        };
        let accepted = found.filter(|outcome| outcome.rejection.is_none()).and_then(|outcome| {
            let left = self.condition_on_found(joint, &indices)?;
            // The ambiguities that stay float have counted against the held integers.
            let likely = bonferroni(outcome.attempts, outcome.probability.unwrap_or(0.0));
            if likely < lambda.probability_min {
                return None;
            }
            let added = self.hold_found(arcs, hold, others, judgement.proven_after(likely));
            Some((left, added, likely))
        });
        forget_unfound(arcs, &before);
        accepted
    }

    /// The arcs of the pairs `wanted` whose integers are on trial.
    fn on_trial(&self, arcs: &Arcs, wanted: impl Iterator<Item = usize>) -> Vec<Trial> {
        let pairs = wanted.map(|i| &self.differences.pairs[i]);
        let both = pairs.flat_map(|pair| [pair.arc, pair.reference]);
        let trial = |arc: usize| {
            let CarrierArc { held, found, is_proven, .. } = arcs.list()[arc];
            (held.is_some() && !is_proven).then_some((arc, held, found))
        };
        both.filter_map(trial).collect()
    }

    /// Searches for the integers of all ambiguities; they must be found in consecutive epochs
    /// before they are held. Arcs on trial whose integers are not found again lose them.
    ///
    /// A candidate set that contradicts the integers so far replaces them only if its probability
    /// is higher, and from the next epoch on.
    fn resolve_all(
        &mut self,
        arcs: &mut Arcs,
        hold: &mut HoldState,
        joint: &Joint,
        judgement: &Judgement<'_>,
    ) -> Resolution {
        let Judgement { options, replaces_held, .. } = *judgement;
        let (mut tried, mut resolution) = (0, self.refused(Reason::FixRejected));
        for wanted in self.differences.subsets(arcs.list(), options.fixed_min) {
            let found = self.search(arcs.list(), joint, &wanted, &wanted, options);
            let Some(outcome) = found else { continue };
            tried += outcome.attempts;
            resolution.ratio = outcome.ratio;
            resolution.success_rate = Some(outcome.success_rate);
            if let Some(reason) = refusal(&outcome, options) {
                resolution.outcome = Err(reason);
                continue;
            }
            resolution.outcome = Err(Reason::FixRejected);
            let stated = bonferroni(tried, outcome.probability.unwrap_or(0.0));
            let Some(rest) = self.condition_on_found(joint, &wanted) else { continue };
            let probability = given_unfixed_ambiguities(stated, &rest);
            if probability < options.probability_min {
                continue;
            }
            let [agreeing, contradicting] = self.compare_with_known(&wanted);
            if 0 < contradicting {
                if probability <= hold.probability {
                    continue;
                }
                hold.refute(arcs);
                return resolution;
            }
            if replaces_held {
                hold.release(arcs);
            } else if agreeing < options.fixed_min {
                // These are other integers than those of the epochs before.
                hold.missed();
            }
            let proven_after = judgement.proven_after(probability);
            let before = self.on_trial(arcs, 0..self.differences.pairs.len());
            let held = self.hold_found(arcs, hold, &wanted, proven_after);
            forget_unfound(arcs, &before);
            let Outcome { ratio, success_rate, .. } = outcome;
            let found = Found { probability, ratio, success_rate };
            hold.found(&found);
            resolution.outcome = Ok(fixed_position(&rest, held, probability));
            return resolution;
        }
        resolution
    }

    /// Numbers of the integers found last, among the pairs `wanted`, that agree with the known ones
    /// and that contradict them.
    pub(super) fn compare_with_known(&self, wanted: &[usize]) -> [usize; 2] {
        let found = wanted.iter().zip(self.resolver.fix().entries());
        let both = found.filter_map(|(&i, entry)| self.differences.pairs[i].known.zip(*entry));
        both.fold([0, 0], |[agreeing, contradicting], (known, found)| match known == found {
            true => [agreeing + 1, contradicting],
            false => [agreeing, contradicting + 1],
        })
    }

    /// Position and float ambiguities, conditioned on the integers that the last search found.
    /// `wanted` contains the indices of the searched pairs, ascending. `None` if the covariance is
    /// not positive definite.
    fn condition_on_found(&self, joint: &Joint, wanted: &[usize]) -> Option<Joint> {
        let found = wanted.iter().zip(self.resolver.fix().entries());
        let (held, values): (Vec<usize>, Vec<f64>) =
            found.filter_map(|(&i, entry)| Some((i, (*entry)? as f64))).unzip();
        let all = 0..joint.ambiguities();
        let left: Vec<usize> = all.filter(|i| held.binary_search(i).is_err()).collect();
        condition(joint, &held, &values, &left).map(|(rest, _)| rest)
    }

    /// Searches for the integers of the pairs `wanted`, whose estimates and covariances are at
    /// `indices` of `joint`.
    pub(super) fn search(
        &mut self,
        arcs: &[CarrierArc],
        joint: &Joint,
        indices: &[usize],
        wanted: &[usize],
        options: &Options,
    ) -> Option<Outcome> {
        let n = wanted.len();
        let float: Vec<f64> = indices.iter().map(|i| joint.estimate[3 + i]).collect();
        let between = |i: usize, j: usize| joint.covariance[(3 + indices[i], 3 + indices[j])];
        let covariance = DMatrix::from_fn(n, n, between);
        let strength = |&i: &usize| {
            let arc = &arcs[self.differences.pairs[wanted[i]].arc];
            (arc.epochs.min(2), arc.elevation_rad)
        };
        self.order.clear();
        self.order.extend(0..n);
        self.order.sort_by(|a, b| {
            let ((a_epochs, a), (b_epochs, b)) = (strength(a), strength(b));
            a_epochs.cmp(&b_epochs).then(a.total_cmp(&b))
        });
        let partial = Partial::Ordered(&self.order);
        self.resolver.resolve(&float, &covariance, partial, options).ok()
    }

    /// Holds the integers found last of the pairs `wanted`; returns their number.
    fn hold_found(
        &self,
        arcs: &mut Arcs,
        hold: &mut HoldState,
        wanted: &[usize],
        proven_after: u32,
    ) -> usize {
        let entries = wanted.iter().zip(self.resolver.fix().entries());
        let integer = |(&i, entry): (&usize, &Option<i64>)| {
            let DoubleDifference { arc, reference, .. } = self.differences.pairs[i];
            Some((arc, reference, (*entry)?))
        };
        let found: Vec<_> = entries.filter_map(integer).collect();
        hold.hold(arcs, &found, proven_after);
        found.len()
    }
}

/// Forgets the integers of the arcs on trial that have not been found again.
fn forget_unfound(arcs: &mut Arcs, before: &[Trial]) {
    for &(arc, held, found) in before {
        if (arcs.list()[arc].held, arcs.list()[arc].found) == (held, found) {
            arcs.forget(arc);
        }
    }
}

/// Whether the ambiguity of an arc may be fixed: elevation mask, no half-cycle ambiguity.
pub(crate) fn may_be_integer(arc: &CarrierArc, options: &RtkOptions) -> bool {
    !arc.half_cycle && options.elevation_mask_rad <= arc.elevation_rad
}

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix3, Vector3};

    use super::*;
    use crate::config::{Mode, PositioningOptions, Profile};
    use crate::gnss::{Band, Constellation, ObservationCode, SatelliteId};
    use crate::positioning::rtk::observed::{HeldInteger, Receivers, Residuals};

    const N: usize = 7;

    /// Arcs of one group; the satellite of arc `highest` has the highest elevation.
    fn arcs(highest: usize) -> Arcs {
        let code = ObservationCode::parse("1C").unwrap();
        let arc = |k: usize| CarrierArc {
            satellite: SatelliteId::new(Constellation::Gps, 1 + k as u8).unwrap(),
            band: Band::L1,
            codes: [code; 2],
            variable: k,
            serial: k as u64,
            frequency_hz: 1_575.42e6,
            last: GpsTime::EPOCH,
            unobserved_s: 0.0,
            epochs: 5,
            half_cycle: false,
            elevation_rad: if k == highest { 1.5 } else { 0.5 + 0.1 * k as f64 },
            code_minus_phase_m: None,
            held: None,
            found: 0,
            is_proven: false,
        };
        Arcs::of((0..N).map(arc).collect())
    }

    /// Ambiguities at most 0.05 cycles from the integers k², plus 25.3 cycles common to all. A
    /// metre of position moves each of them by at most two cycles.
    fn float() -> FloatSolution {
        let wave = |k: usize| (1.7 * k as f64).sin();
        let tie = |i: usize, axis: usize| match i.checked_sub(3) {
            None => f64::from(u8::from(i == axis)),
            Some(k) => 2.0 * ((1 + axis) as f64 * k as f64).cos(),
        };
        let mut covariance = DMatrix::identity(3 + N, 3 + N) * 4e-4;
        for i in 0..3 + N {
            for j in 0..3 + N {
                // σ is 5 cm along each axis, and one cycle for the common part.
                let real = (0..3).map(|axis| 0.0025 * tie(i, axis) * tie(j, axis)).sum::<f64>();
                covariance[(i, j)] += real + if i < 3 || j < 3 { 0.0 } else { 1.0 };
            }
        }
        FloatSolution {
            position: Vector3::new(5.0, -3.0, 2.0),
            variables: (0..N).collect(),
            ambiguities: (0..N).map(|k| 25.3 + (k * k) as f64 + 0.05 * wave(k)).collect(),
            covariance,
        }
    }

    fn resolved(arcs: &mut Arcs, hold: &mut HoldState, float: &FloatSolution) -> Resolution {
        let options = PositioningOptions::new(Mode::RtkFgo, Profile::General);
        let noise = Receivers::new().known_noise(&Residuals::NONE);
        let time = GpsTime::EPOCH;
        let question = IntegerQuestion { time, float, noise, options: &options.rtk };
        IntegerSearch::default().resolve(arcs, hold, &question, true)
    }

    fn integers(arcs: &Arcs) -> Vec<i64> {
        arcs.list().iter().map(|arc| arc.held.unwrap().cycles).collect()
    }

    fn hold_all(arcs: &mut Arcs, integers: impl Iterator<Item = i64>) {
        for (index, cycles) in integers.enumerate() {
            arcs.record_integer(index, HeldInteger { datum: 1, cycles }, 1);
        }
    }

    /// Two of the held integers are left, which are too few. All are found again, and kept also
    /// where one epoch proves them.
    #[test]
    fn integers_that_are_found_again_are_kept() {
        let mut options = PositioningOptions::new(Mode::RtkFgo, Profile::General);
        options.rtk.hold_epochs = 1;
        let mut arcs = arcs(0);
        hold_all(&mut arcs, [0, 1].into_iter());
        let mut hold = HoldState { epochs_in_a_row: 1, datums: 1, ..HoldState::default() };
        let noise = Receivers::new().known_noise(&Residuals::NONE);
        let (time, float) = (GpsTime::EPOCH, &float());
        let question = IntegerQuestion { time, float, noise, options: &options.rtk };
        let found = IntegerSearch::default().resolve(&mut arcs, &mut hold, &question, true);
        assert!(found.outcome.is_ok(), "{found:?}");
        assert_eq!(arcs.list().iter().filter(|arc| arc.held.is_some()).count(), N);
    }

    /// Epochs in a row have found the same integers: other ones begin to count at one.
    #[test]
    fn other_integers_count_from_one() {
        let mut arcs = arcs(0);
        let mut hold = HoldState { epochs_in_a_row: 5, ..HoldState::default() };
        for epochs_in_a_row in [1, 2] {
            assert!(resolved(&mut arcs, &mut hold, &float()).outcome.is_ok());
            assert_eq!(hold.epochs_in_a_row, epochs_in_a_row);
        }
    }

    /// The ambiguity of the lowest satellite is no longer known to a cycle, so the search leaves it
    /// out. Its arc is on trial, and loses the integer.
    #[test]
    fn an_integer_that_is_not_found_again_is_forgotten() {
        let (mut arcs, mut hold) = (arcs(0), HoldState::default());
        for (index, cycles) in (0..N as i64).map(|k| k * k).enumerate() {
            arcs.record_integer(index, HeldInteger { datum: 1, cycles }, 9);
        }
        let mut float = float();
        float.covariance[(3 + 1, 3 + 1)] += 25.0;
        assert_eq!(resolved(&mut arcs, &mut hold, &float).outcome.unwrap().held, N - 2);
        let found: Vec<_> = arcs.list().iter().map(|arc| arc.found).collect();
        assert_eq!(found, [2, 0, 2, 2, 2, 2, 2]);
    }

    /// Of seven arcs two have no phase for a moment, and the last present one is new. The proven
    /// integers are too few then, and the float solution finds none. All are kept.
    #[test]
    fn integers_that_are_too_few_for_an_epoch_are_kept() {
        let mut list = arcs(0).list().to_vec();
        list[5..].iter_mut().for_each(|arc| arc.last = GpsTime::EPOCH + -1.0);
        let mut arcs = Arcs::of(list);
        hold_all(&mut arcs, (0..N as i64).map(|k| k * k));
        arcs.forget(4);
        let (epochs_in_a_row, probability) = (1000, 1.0 - 1e-6);
        let mut hold = HoldState { epochs_in_a_row, probability, ..HoldState::default() };
        let mut float = float();
        float.covariance *= 100.0;
        assert!(resolved(&mut arcs, &mut hold, &float).outcome.is_err());
        assert_eq!((hold.period, hold.epochs_in_a_row), (0, 1000));
        assert_eq!(arcs.list().iter().filter(|arc| arc.held.is_some()).count(), N - 1);
    }

    /// One arc has no difference: a new period begins, in which nothing is confirmed. Two have one.
    #[test]
    fn a_period_ends_with_its_arcs() {
        for (held, period) in [(2, 0), (1, 1)] {
            let mut arcs = arcs(0);
            hold_all(&mut arcs, 0..held);
            let mut hold = HoldState { probability: 0.99, ..HoldState::default() };
            hold.end_with_arcs(&mut arcs);
            assert_eq!(hold.period, period);
            assert_eq!(arcs.list().iter().any(|arc| arc.held.is_some()), period == 0);
        }
    }

    /// Whichever satellite is the reference, the same integers, position and probability are found.
    #[test]
    fn the_reference_satellite_does_not_matter() {
        let found = |highest: usize| {
            let (mut arcs, mut hold) = (arcs(highest), HoldState::default());
            let fixed = resolved(&mut arcs, &mut hold, &float()).outcome.unwrap();
            let all = integers(&arcs);
            assert_eq!((fixed.held, all[highest]), (N - 1, 0));
            (fixed, all.iter().map(|integer| integer - all[0]).collect::<Vec<_>>())
        };
        let (fixed, integers) = found(0);
        assert_eq!(integers, (0..N).map(|k| (k * k) as i64).collect::<Vec<_>>());
        for highest in 1..N {
            let (other, others) = found(highest);
            assert_eq!(others, integers, "{highest}");
            assert!((other.position - fixed.position).norm() < 1e-9, "{highest}");
            assert!((other.covariance - fixed.covariance).norm() < 1e-12, "{highest}");
            assert!((other.probability - fixed.probability).abs() < 1e-9, "{highest}");
        }
    }

    /// A candidate set that contradicts more probable integers is refused; a more probable one
    /// replaces them at the next epoch, and they are marked as wrong.
    #[test]
    fn the_more_probable_integers_win() {
        let others: Vec<i64> = (0..N as i64).map(|k| k * k + k % 2).collect();
        for epochs_in_a_row in [1, 1000] {
            let with_others = || {
                let mut arcs = arcs(0);
                hold_all(&mut arcs, others.iter().copied());
                arcs
            };
            let probability = 1.0 - 1e-6;
            let certain =
                HoldState { epochs_in_a_row, probability, period: 4, ..HoldState::default() };
            let (mut known, mut hold) = (with_others(), certain);
            assert!(resolved(&mut known, &mut hold, &float()).outcome.is_err());
            assert_eq!(hold.refuted, None);
            match epochs_in_a_row {
                1 => assert_eq!(integers(&known), others),
                _ => assert!(known.list().iter().all(|arc| arc.held.is_none()), "out of reach"),
            }
            let mut arcs = with_others();
            let mut hold = HoldState { probability: 0.99, ..certain };
            assert!(resolved(&mut arcs, &mut hold, &float()).outcome.is_err());
            assert_eq!((hold.refuted, hold.period), (Some(4), 5));
            assert!(resolved(&mut arcs, &mut hold, &float()).outcome.is_ok());
            assert_eq!(integers(&arcs), (0..N as i64).map(|k| k * k).collect::<Vec<_>>());
        }
    }

    /// Held integers stay although the float ambiguities are 3σ from them, as long as no other
    /// integers fit better.
    #[test]
    fn held_integers_stay_while_none_fit_better() {
        let mut arcs = arcs(0);
        hold_all(&mut arcs, (0..N as i64).map(|k| k * k));
        let (epochs_in_a_row, probability) = (1000, 1.0 - 1e-6);
        let mut hold =
            HoldState { epochs_in_a_row, probability, period: 4, ..HoldState::default() };
        let mut off = float();
        for (k, ambiguity) in off.ambiguities.iter_mut().enumerate() {
            *ambiguity += 0.15 * (1.7 * k as f64).sin();
        }
        let resolution = resolved(&mut arcs, &mut hold, &off);
        let fixed = resolution.outcome.unwrap();
        assert_eq!(fixed.held, N - 1);
        // All of them are proven, so the position by these is the fixed one.
        assert_eq!(fixed.by_proven.unwrap().position, fixed.position);
        assert_eq!((hold.period, hold.epochs_in_a_row), (4, 1000));
    }

    /// An arc that joins proven integers is on trial. Another integer at the next epoch replaces
    /// its first one. Two epochs in a row that are nearly certain prove it.
    #[test]
    fn new_integers_are_on_trial() {
        let mut arcs = arcs(0);
        hold_all(&mut arcs, (0..N as i64 - 1).map(|k| k * k));
        let (epochs_in_a_row, probability) = (1000, 1.0 - 1e-6);
        let mut hold =
            HoldState { epochs_in_a_row, probability, period: 4, ..HoldState::default() };
        let new = |arcs: &Arcs| {
            let arc = &arcs.list()[N - 1];
            (arc.held.map(|held| held.cycles), arc.found, arc.is_proven)
        };
        let right = ((N - 1) * (N - 1)) as i64;
        let mut off = float();
        off.ambiguities[N - 1] += 1.0;
        for (float, expected) in [
            (&off, (Some(right + 1), 1, false)),
            (&float(), (Some(right), 1, false)),
            (&float(), (Some(right), 2, true)),
        ] {
            let resolution = resolved(&mut arcs, &mut hold, float);
            assert_eq!(resolution.outcome.unwrap().held, N - 1);
            assert_eq!(new(&arcs), expected);
        }
    }

    /// The search without any one satellite finds the right integers again, also without the
    /// reference. If one held integer is a cycle off, only the search without its satellite finds
    /// the others again.
    #[test]
    fn searches_without_a_satellite_find_who_is_wrong() {
        let options = PositioningOptions::new(Mode::RtkFgo, Profile::General);
        let noise = Receivers::new().known_noise(&Residuals::NONE);
        let (time, float) = (GpsTime::EPOCH, float());
        let question = IntegerQuestion { time, float: &float, noise, options: &options.rtk };
        for (wrong, reference) in [(None, 2), (Some(4), 2), (Some(2), 2)] {
            let mut arcs = arcs(reference);
            let off = |k: usize| i64::from(wrong == Some(k));
            hold_all(&mut arcs, (0..N).map(|k| (k * k) as i64 + off(k)));
            let mut search = IntegerSearch::default();
            let mut separator = search.separator(&arcs, &question).unwrap();
            for k in 0..N {
                let found = separator.without(arcs.list()[k].satellite).unwrap();
                let is_right = wrong.is_none_or(|wrong| wrong == k);
                assert_eq!(0.9 < found.probability, is_right, "{wrong:?}, without {k}: {found:?}");
            }
        }
        // Without integers there is nothing to search.
        assert!(IntegerSearch::default().separator(&arcs(2), &question).is_none());
    }

    /// Integers that leave the position uncertain by more than 5 cm, or the height by more than
    /// 15 cm, are not accepted as a fix.
    #[test]
    fn an_uncertain_position_is_refused() {
        let outcome = |horizontal_m: f64, vertical_m: f64| {
            let sigmas = Vector3::new(horizontal_m, 0.01, vertical_m);
            let covariance = Matrix3::from_diagonal(&sigmas.map(|sigma_m| sigma_m.powi(2)));
            let position = Vector3::zeros();
            let (probability, by_proven) = (0.999, None);
            let fixed = FixedPosition { position, covariance, held: 8, probability, by_proven };
            let (ratio, success_rate) = (None, None);
            let outcome = Ok(fixed);
            Resolution { ambiguities: 9, ratio, success_rate, outcome }.require_precise().outcome
        };
        assert!(outcome(0.04, 0.14).is_ok());
        let refused = |outcome, stated_m: f64| match outcome {
            Err(Reason::FixImprecise { sigma_m }) => (sigma_m - stated_m).abs() < 1e-12,
            _ => false,
        };
        assert!(refused(outcome(0.06, 0.14), 0.06));
        assert!(refused(outcome(0.04, 0.16), 0.16));
    }
}
