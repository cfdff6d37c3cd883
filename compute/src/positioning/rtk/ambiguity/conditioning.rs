//! Conditions an epoch on integers that were found at other epochs.

use crate::config::RtkOptions;
use crate::lambda::{KnownScale, Partial, Resolver};
use crate::positioning::differencing::DifferenceGroup;
use crate::positioning::rtk::observed::{ArcReference, FREEDOM_LEAST, HeldInteger};

use super::acceptance::lambda_options;
use super::fixed_position::{FixedPosition, fixed_position};
use super::float::FloatSolution;
use super::integers::DISAGREEMENT;
use super::joint::{Joint, condition, given_unfixed_ambiguities};

/// An ambiguity of an earlier epoch, with the integer that is known for it now.
pub(crate) struct EarlierAmbiguity<'a> {
    pub(crate) arc: &'a ArcReference,
    pub(crate) held: Option<HeldInteger>,
}

/// Conditions an epoch on the known integers of its ambiguities. `None` if these are too few, leave
/// the position too uncertain, or do not agree with the epoch.
///
/// The integers agree with the epoch if the float ambiguities lie within 2σ rms of them and the
/// unfixed ambiguities do not contradict them. Errors that are correlated in time can put float
/// ambiguities further from the right integers than their covariance allows. So integers beyond 2σ
/// rms agree only if a search accepts exactly these.
pub(crate) fn condition_on_known_integers(
    float: &FloatSolution,
    ambiguities: &[EarlierAmbiguity<'_>],
    probability: f64,
    resolver: &mut Resolver,
    options: &RtkOptions,
) -> Option<FixedPosition> {
    let (mut pairs, mut integers) = (Vec::new(), Vec::new());
    let mut unfixed = Vec::new();
    for (i, ambiguity) in ambiguities.iter().enumerate() {
        let Some(reference) = reference(ambiguities, ambiguity.arc.group).filter(|&r| r != i)
        else {
            continue;
        };
        let zero = &ambiguities[reference];
        let pair = (float.index(ambiguity.arc.variable)?, float.index(zero.arc.variable)?);
        match ambiguity.held.zip(zero.held).and_then(|(own, zero)| own.minus(zero)) {
            Some(integer) => {
                pairs.push(pair);
                integers.push(integer);
            }
            None => unfixed.push(pair),
        }
    }
    let held = integers.len();
    if held < options.fixed_min {
        return None;
    }
    pairs.extend(unfixed);
    let joint = Joint::of_differences(float, &pairs);
    let (known, others): (Vec<usize>, Vec<usize>) = (0..pairs.len()).partition(|&i| i < held);
    let values: Vec<f64> = integers.iter().map(|&integer| integer as f64).collect();
    let (rest, squared_norm) = condition(&joint, &known, &values, &others)?;
    let probability = given_unfixed_ambiguities(probability, &rest);
    let agree = options.hold_probability_min <= probability
        && (squared_norm <= DISAGREEMENT * held as f64
            || are_found(&joint.of(&known), &integers, resolver, options));
    let fixed = fixed_position(&rest, held, probability);
    (agree && fixed.excessive_sigma_m().is_none()).then_some(fixed)
}

/// The first ambiguity of a group with the newest datum.
fn reference(ambiguities: &[EarlierAmbiguity<'_>], group: DifferenceGroup) -> Option<usize> {
    let of_group = ambiguities.iter().enumerate().filter(|(_, a)| a.arc.group == group);
    let datums = of_group.filter_map(|(i, a)| Some((a.held?.datum, i)));
    datums.max_by_key(|&(datum, i)| (datum, std::cmp::Reverse(i))).map(|(_, i)| i)
}

/// Whether a search accepts exactly these integers.
fn are_found(
    joint: &Joint,
    integers: &[i64],
    resolver: &mut Resolver,
    options: &RtkOptions,
) -> bool {
    let n = integers.len();
    let float: Vec<f64> = joint.estimate.iter().skip(3).copied().collect();
    let covariance = joint.covariance.view((3, 3), (n, n)).into_owned();
    let found = resolver.resolve(
        &float,
        &covariance,
        Partial::None,
        &lambda_options(options, KnownScale { freedom: FREEDOM_LEAST, variance: 1.0 }),
    );
    let entries = resolver.fix().entries().iter();
    found.is_ok_and(|outcome| outcome.rejection.is_none())
        && entries.zip(integers).all(|(entry, integer)| *entry == Some(*integer))
}

#[cfg(test)]
mod tests {
    use nalgebra::{DMatrix, Vector3};

    use super::*;
    use crate::config::{Mode, PositioningOptions, Profile};
    use crate::gnss::{Band, Constellation, ObservationCode, SatelliteId};

    const N: usize = 7;

    /// Ambiguities that an east shift moves by −2 cycles/m. Their σ is 0.3 m along that direction
    /// and `sigma` across it. They are at the integers k², minus the effect of an east shift of
    /// `off_m`.
    fn float(off_m: f64, sigma: f64) -> FloatSolution {
        let mut covariance = DMatrix::identity(3 + N, 3 + N) * sigma * sigma;
        let tie = |i: usize| match i {
            0 => 1.0,
            1 | 2 => 0.0,
            _ => -2.0 * (i - 3) as f64 / N as f64,
        };
        for i in 0..3 + N {
            for j in 0..3 + N {
                covariance[(i, j)] += 0.09 * tie(i) * tie(j);
            }
        }
        let integer = |k: usize| (k * k) as f64;
        FloatSolution {
            position: Vector3::new(5.0 + off_m, 0.0, 0.0),
            variables: (10..10 + N).collect(),
            ambiguities: (0..N).map(|k| integer(k) + off_m * tie(3 + k)).collect(),
            covariance,
        }
    }

    fn arcs() -> [ArcReference; N] {
        let code = ObservationCode::parse("1C").unwrap();
        let gps = SatelliteId::new(Constellation::Gps, 3).unwrap();
        let group = DifferenceGroup::of(gps, Band::L1, [code; 2]);
        std::array::from_fn(|k| ArcReference { serial: k as u64, variable: 10 + k, group })
    }

    fn held(float: &FloatSolution, integers: [Option<i64>; N]) -> Option<FixedPosition> {
        let arcs = arcs();
        let held = |cycles| HeldInteger { datum: 4, cycles };
        let both = arcs.iter().zip(integers);
        let ambiguities: Vec<_> =
            both.map(|(arc, integer)| EarlierAmbiguity { arc, held: integer.map(held) }).collect();
        let options = PositioningOptions::new(Mode::RtkFgo, Profile::General);
        let resolver = &mut Resolver::with_capacity(N);
        condition_on_known_integers(float, &ambiguities, 0.9999, resolver, &options.rtk)
    }

    fn right() -> [Option<i64>; N] {
        std::array::from_fn(|k| Some(100 + (k * k) as i64))
    }

    /// With a float position 0.2 m off, the right integers are found for every datum. They are also
    /// accepted if the float ambiguities are improbably far from them, as long as no others are as
    /// near.
    #[test]
    fn integers_lead_back() {
        for float in [float(0.2, 0.01), float(0.2, 0.002)] {
            let fixed = held(&float, right()).unwrap();
            assert_eq!(fixed.held, N - 1);
            assert!((fixed.position.x - 5.0).abs() < 0.01, "{}", fixed.position.x);
        }
    }

    /// Wrong integers, too few, and those that unfixed ambiguities contradict are not held.
    #[test]
    fn what_does_not_agree_is_not_held() {
        let float = float(0.2, 0.01);
        let mut integers = right();
        integers[5] = Some(126);
        assert!(held(&float, integers).is_none());
        let few = std::array::from_fn(|k| right()[k].filter(|_| k < 4));
        assert!(held(&float, few).is_none(), "three double differences");
        let mut integers = right();
        (integers[1], integers[2]) = (None, None);
        assert!(held(&float, integers).is_some());
        let mut contradicting = float.clone();
        (contradicting.ambiguities[1], contradicting.ambiguities[2]) = (1.5 - 0.06, 4.5 - 0.12);
        assert!(held(&contradicting, integers).is_none());
    }
}
