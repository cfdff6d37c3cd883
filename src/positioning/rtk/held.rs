//! Integers found at one time, held at another.

use crate::config::RtkOptions;
use crate::lambda::{KnownScale, Partial, Resolver};
use crate::positioning::differencing::DifferenceGroup;

use super::answered::Named;
use super::arcs::Label;
use super::float::FloatSolution;
use super::integers::{DISAGREEMENT, lambda_options};
use super::joint::{Joint, condition, doubted};
use super::noise::FREEDOM_LEAST;
use super::placed::{FIXED_SIGMA_M, FixedPosition, fixed_position};

/// An ambiguity of an epoch.
pub(super) struct Ambiguity<'a> {
    pub(super) named: &'a Named,
    pub(super) label: Option<Label>,
}

/// Conditions an epoch on the integers of its ambiguities that have labels; `None` where these are
/// too few, or place it too roughly, or do not agree with it.
///
/// They agree where the real-valued ones are about there, and those without a label do not make
/// them improbable. Errors that last longer than their variances say can put the real-valued ones
/// further off; then they agree if a search finds them and no others.
pub(super) fn hold(
    float: &FloatSolution,
    ambiguities: &[Ambiguity<'_>],
    probability: f64,
    resolver: &mut Resolver,
    options: &RtkOptions,
) -> Option<FixedPosition> {
    let (mut places, mut integers) = (Vec::new(), Vec::new());
    let mut without = Vec::new();
    for (i, ambiguity) in ambiguities.iter().enumerate() {
        let Some(reference) = reference(ambiguities, ambiguity.named.group).filter(|&r| r != i)
        else {
            continue;
        };
        let zero = &ambiguities[reference];
        let pair = (float.place(ambiguity.named.variable)?, float.place(zero.named.variable)?);
        match ambiguity.label.zip(zero.label).and_then(|(own, zero)| own.less(zero)) {
            Some(integer) => {
                places.push(pair);
                integers.push(integer);
            }
            None => without.push(pair),
        }
    }
    let held = integers.len();
    if held < options.fixed_min {
        return None;
    }
    places.extend(without);
    let joint = Joint::of_differences(float, &places);
    let (known, others): (Vec<usize>, Vec<usize>) = (0..places.len()).partition(|&i| i < held);
    let values: Vec<f64> = integers.iter().map(|&integer| integer as f64).collect();
    let (rest, squared_norm) = condition(&joint, &known, &values, &others)?;
    let probability = doubted(probability, &rest);
    let agree = options.hold_probability_min <= probability
        && (squared_norm <= DISAGREEMENT * held as f64
            || are_found(&joint.of(&known), &integers, resolver, options));
    let fixed = fixed_position(&rest, held, probability);
    (agree && fixed.horizontal_sigma_m() <= FIXED_SIGMA_M).then_some(fixed)
}

/// The first ambiguity of a group with the newest label.
fn reference(ambiguities: &[Ambiguity<'_>], group: DifferenceGroup) -> Option<usize> {
    let labelled = ambiguities.iter().enumerate().filter(|(_, a)| a.named.group == group);
    let origins = labelled.filter_map(|(i, a)| Some((a.label?.origin, i)));
    origins.max_by_key(|&(origin, i)| (origin, std::cmp::Reverse(i))).map(|(_, i)| i)
}

/// Whether a search finds these integers and no others.
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

    /// Ambiguities tied to the east by −2 cycles a metre, known to 0.3 m that way and to `sigma`
    /// beside it: at integers k², less what `off_m` makes of them.
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

    fn named() -> [Named; N] {
        let code = ObservationCode::parse("1C").unwrap();
        let gps = SatelliteId::new(Constellation::Gps, 3).unwrap();
        let group = DifferenceGroup::of(gps, Band::L1, [code; 2]);
        std::array::from_fn(|k| Named { serial: k as u64, variable: 10 + k, group })
    }

    fn held(float: &FloatSolution, labels: [Option<i64>; N]) -> Option<FixedPosition> {
        let named = named();
        let label = |integer| Label { origin: 4, integer };
        let both = named.iter().zip(labels);
        let ambiguities: Vec<_> =
            both.map(|(named, integer)| Ambiguity { named, label: integer.map(label) }).collect();
        let options = PositioningOptions::new(Mode::RtkFgo, Profile::General);
        hold(float, &ambiguities, 0.9999, &mut Resolver::with_capacity(N), &options.rtk)
    }

    fn right() -> [Option<i64>; N] {
        std::array::from_fn(|k| Some(100 + (k * k) as i64))
    }

    /// 0.2 m off, the right integers lead back, whatever they are counted from; so they do where
    /// the ambiguities are further from them than is likely, if nothing else is as near.
    #[test]
    fn integers_lead_back() {
        for float in [float(0.2, 0.01), float(0.2, 0.002)] {
            let fixed = held(&float, right()).unwrap();
            assert_eq!(fixed.held, N - 1);
            assert!((fixed.position.x - 5.0).abs() < 0.01, "{}", fixed.position.x);
        }
    }

    /// Wrong integers, too few of them, and such as those without a label contradict, are not held.
    #[test]
    fn what_does_not_agree_is_not_held() {
        let float = float(0.2, 0.01);
        let mut labels = right();
        labels[5] = Some(126);
        assert!(held(&float, labels).is_none());
        let few = std::array::from_fn(|k| right()[k].filter(|_| k < 4));
        assert!(held(&float, few).is_none(), "three double differences");
        let mut labels = right();
        (labels[1], labels[2]) = (None, None);
        assert!(held(&float, labels).is_some());
        let mut astray = float.clone();
        (astray.ambiguities[1], astray.ambiguities[2]) = (1.5 - 0.06, 4.5 - 0.12);
        assert!(held(&astray, labels).is_none());
    }
}
