//! Solutions as bytes.
//!
//! Layouts 8 and 9 omit what the columns of a row contain: the time, the position, and a reference
//! to the program's version and the configuration. A position that a column would not return bit by
//! bit is in the bytes. Layout 8 is whole; layout 9 is a revision relative to the first answer of
//! its epoch (see `parts`).
//!
//! Earlier layouts can still be read. Layouts 6 and 7 are like 8 and 9, but without distances: they
//! contain all values, and say of each covariance whether it is symmetric. In layout 5 the parts
//! are mixed, and up to layout 4 the bytes contain everything.

use nalgebra::Vector3;

use crate::config::IonosphereModel;
use crate::gnss::{
    BaseEpochIssue, Dops, Ecef, EphemerisIssue, GpsTime, Protection, Provenance, Reason,
    RelativeEstimate, SatelliteId, Solution, SolutionEstimate, Status, Velocity,
};

use super::CodecError;
use super::bytes::{Decoder, Encoder, constellation_number};
use super::columns::{SolutionColumns, solution_columns, status_number};
use super::lists::{decode_issues, decode_satellites, encode_issues, encode_satellites};
use super::parts::{self, Parts};

const WHOLE: u8 = 8;
/// The newest layout. Layout 1 had no relative estimate, layout 2 no base epoch, layout 3 no
/// protection levels.
const RELATIVE: u8 = 9;
/// Without distances.
const FORMER_WHOLE: u8 = 6;
const FORMER_RELATIVE: u8 = 7;
/// The first layout that needs the columns, and that writes lists in bits.
const WITH_COLUMNS: u8 = 5;

/// A decoded solution.
#[derive(Clone, Debug, PartialEq)]
pub(in crate::store) struct DecodedSolution {
    /// The solution.
    pub solution: Solution,
    /// Version of the program that computed it, and hash of the configuration in force. `None`
    /// after layout 4.
    pub origin: Option<(String, String)>,
}

/// Encodes a solution without the values of [`solution_columns`].
pub(in crate::store) fn encode_solution(solution: &Solution) -> Vec<u8> {
    whole(&parts_of(solution))
}

/// Encodes a revision like [`encode_solution`], or relative to the encoded first answer of its
/// epoch if that takes fewer bytes.
pub(in crate::store) fn encode_revision(solution: &Solution, first: &[u8]) -> Vec<u8> {
    let own = parts_of(solution);
    let whole = whole(&own);
    let Ok(first) = whole_parts(first, WHOLE) else { return whole };
    let mut out = Encoder::new(RELATIVE, whole.len());
    parts::encode_relative(&mut out, &own, &first);
    let relative = out.finish();
    if relative.len() < whole.len() { relative } else { whole }
}

/// Whether an encoded solution is relative to the first answer of its epoch.
pub(in crate::store) fn is_relative(bytes: &[u8]) -> bool {
    bytes.first().is_some_and(|layout| [FORMER_RELATIVE, RELATIVE].contains(layout))
}

fn whole(parts: &Parts<'_>) -> Vec<u8> {
    let mut out = Encoder::new(WHOLE, 16 + parts.bytes.len() + parts.floats.len());
    parts::encode_whole(&mut out, parts);
    out.finish()
}

/// The parts of a solution in this layout, which is whole.
fn whole_parts(bytes: &[u8], layout: u8) -> Result<Parts<'_>, CodecError> {
    parts::decode_whole(&mut Decoder::new(bytes, layout)?, has_distances(layout))
}

const fn has_distances(layout: u8) -> bool {
    WHOLE <= layout
}

fn parts_of(solution: &Solution) -> Parts<'static> {
    let mut out = Encoder::in_parts(320, true);
    encode_content(&mut out, solution);
    Parts::of(out)
}

fn encode_content(out: &mut Encoder, solution: &Solution) {
    out.u8(status_number(solution.status) as u8);
    out.u8(u8::from(solution.estimate.is_some()));
    if let Some(estimate) = &solution.estimate {
        let is_in_columns = solution_columns(solution).position_m[0].is_some();
        out.u8(u8::from(is_in_columns));
        if !is_in_columns {
            out.vector(&estimate.position.0);
        }
        encode_estimate(out, estimate, solution.time);
    }
    out.count(solution.reasons.len());
    for reason in &solution.reasons {
        encode_reason(out, reason);
    }
    let satellites = solution.estimate.as_ref().map_or(&[][..], |e| &e.satellites_used);
    encode_issues(out, &solution.provenance.ephemerides, satellites, solution.time);
    out.u8(u8::from(solution.provenance.base.is_some()));
    if let Some(used) = &solution.provenance.base {
        out.text(&used.base);
        out.span(used.time.as_ns().wrapping_sub(solution.time.as_ns()));
    }
    out.u8(u8::from(solution.protection.is_some()));
    if let Some(protection) = &solution.protection {
        out.f64(protection.horizontal_m);
        out.f64(protection.vertical_m);
    }
}

fn encode_estimate(out: &mut Encoder, estimate: &SolutionEstimate, time: GpsTime) {
    out.covariance(&estimate.covariance);
    out.u8(u8::from(estimate.velocity.is_some()));
    if let Some(velocity) = &estimate.velocity {
        out.vector(&velocity.velocity_m_s);
        out.covariance(&velocity.covariance);
        out.f64(velocity.clock_drift_m_s);
    }
    out.f64(estimate.clock_m);
    out.count(estimate.inter_system_biases_m.len());
    for (constellation, bias_m) in &estimate.inter_system_biases_m {
        out.u8(constellation_number(*constellation));
        out.f64(*bias_m);
    }
    out.signed(estimate.reception_time.as_ns().wrapping_sub(time.as_ns()));
    let Dops { gdop, pdop, hdop, vdop, tdop } = estimate.dops;
    [gdop, pdop, hdop].into_iter().for_each(|dop| out.f64(dop));
    out.f64_near(vdop, other_dop(pdop, hdop));
    out.f64_near(tdop, other_dop(gdop, pdop));
    encode_satellites(out, &estimate.satellites_used);
    out.u8(u8::from(estimate.relative.is_some()));
    if let Some(relative) = &estimate.relative {
        encode_relative(out, relative);
    }
}

/// The dilution of precision c of a² = b² + c².
fn other_dop(a: f64, b: f64) -> f64 {
    (a * a - b * b).sqrt()
}

fn encode_relative(out: &mut Encoder, relative: &RelativeEstimate) {
    out.vector(&relative.baseline_m);
    out.f64(relative.age_s);
    out.count(relative.ambiguities);
    out.count(relative.fixed_ambiguities);
    [relative.ratio, relative.success_rate, relative.fix_probability]
        .into_iter()
        .for_each(|value| out.optional_f64(value));
}

fn encode_reason(out: &mut Encoder, reason: &Reason) {
    match reason {
        Reason::EphemerisMissing { satellites } => {
            out.u8(0);
            encode_satellites(out, satellites);
        }
        Reason::TooFewSatellites { used, needed } => {
            out.u8(1);
            out.count(*used);
            out.count(*needed);
        }
        Reason::GeometryTooWeak { gdop } => {
            out.u8(2);
            out.f64(*gdop);
        }
        Reason::NoRedundancy => out.u8(3),
        Reason::ResidualsTooLarge { ratio } => {
            out.u8(4);
            out.f64(*ratio);
        }
        Reason::SatellitesExcluded { satellites } => {
            out.u8(5);
            encode_satellites(out, satellites);
        }
        Reason::NotConverged => out.u8(6),
        Reason::IonosphereFallback { used } => {
            out.u8(7);
            out.text(used);
        }
        of_base => encode_base_reason(out, of_base),
    }
}

/// Encodes the values of positions relative to a base, and the values that came with them.
fn encode_base_reason(out: &mut Encoder, reason: &Reason) {
    let mut numbers = |kind: u8, values: &[f64]| {
        out.u8(kind);
        values.iter().for_each(|value| out.f64(*value));
    };
    match reason {
        Reason::BaseMissing => numbers(8, &[]),
        Reason::BaseStale { age_s } => numbers(9, &[*age_s]),
        Reason::BasePositionDoubtful { distance_m } => numbers(10, &[*distance_m]),
        Reason::BaselineTooLong { length_m } => numbers(11, &[*length_m]),
        Reason::TooFewCommonSatellites { used, needed } => {
            out.u8(12);
            out.count(*used);
            out.count(*needed);
        }
        Reason::RatioBelowThreshold { ratio, threshold } => numbers(13, &[*ratio, *threshold]),
        Reason::SuccessRateTooLow { success_rate } => numbers(14, &[*success_rate]),
        Reason::FixRejected => numbers(15, &[]),
        Reason::HalfCycleUnresolved { satellites } => {
            out.u8(16);
            encode_satellites(out, satellites);
        }
        Reason::CycleSlips { satellites } => {
            out.u8(17);
            encode_satellites(out, satellites);
        }
        Reason::StartUnproven { age_s } => numbers(18, &[*age_s]),
        Reason::OdometryUnused { interval_s } => numbers(19, &[*interval_s]),
        Reason::FixImprecise { sigma_m } => numbers(20, &[*sigma_m]),
        Reason::BaseMoved { distance_m } => numbers(21, &[*distance_m]),
        Reason::BaseChanged { distance_m } => numbers(22, &[*distance_m]),
        Reason::EpochRepeated { behind_s } => numbers(23, &[*behind_s]),
        Reason::ProtectionLimitExceeded { level_m: Some(level_m), limit_m } => {
            numbers(24, &[*level_m, *limit_m]);
        }
        Reason::ProtectionLimitExceeded { level_m: None, limit_m } => numbers(25, &[*limit_m]),
        Reason::EstimatorFailed => numbers(26, &[]),
        Reason::EphemerisMissing { .. }
        | Reason::TooFewSatellites { .. }
        | Reason::GeometryTooWeak { .. }
        | Reason::NoRedundancy
        | Reason::ResidualsTooLarge { .. }
        | Reason::SatellitesExcluded { .. }
        | Reason::NotConverged
        | Reason::IonosphereFallback { .. } => unreachable!("written by encode_reason"),
    }
}

/// Decodes a solution with the columns of its row, and with the encoded first answer of its epoch
/// if it [is relative](is_relative) to it.
pub(in crate::store) fn decode_solution(
    bytes: &[u8],
    columns: SolutionColumns,
    first: Option<&[u8]>,
) -> Result<DecodedSolution, CodecError> {
    let (mut input, layout) = Decoder::of_versions(bytes, RELATIVE)?;
    let has_distances = has_distances(layout);
    let parts = match layout {
        FORMER_RELATIVE | RELATIVE => {
            let whole = if has_distances { WHOLE } else { FORMER_WHOLE };
            let first = whole_parts(first.ok_or(CodecError::ReferenceMissing)?, whole)?;
            let parts = parts::decode_relative(&mut input, &first, has_distances)?;
            input.finish()?;
            parts
        }
        FORMER_WHOLE | WHOLE => parts::decode_whole(&mut input, has_distances)?,
        _ => return decode_content(input, layout, columns),
    };
    decode_content(parts.decoder(), layout, columns)
}

fn decode_content(
    mut input: Decoder<'_>,
    layout: u8,
    columns: SolutionColumns,
) -> Result<DecodedSolution, CodecError> {
    let time = if layout < WITH_COLUMNS { input.time()? } else { columns.time };
    let number = i16::from(input.u8()?);
    let known = Status::ALL.into_iter().find(|status| status_number(*status) == number);
    let status = known.ok_or_else(|| input.invalid("status"))?;
    let estimate = match input.flag("estimate")? {
        true => Some(decode_estimate(&mut input, layout, SolutionColumns { time, ..columns })?),
        false => None,
    };
    let count = input.count("number of reasons")?;
    let reasons =
        (0..count).map(|_| decode_reason(&mut input, layout)).collect::<Result<_, _>>()?;
    let ephemerides = if WITH_COLUMNS <= layout {
        let satellites = estimate.as_ref().map_or(&[][..], |e| &e.satellites_used);
        decode_issues(&mut input, satellites, time)?
    } else {
        let count = input.count("number of ephemerides")?;
        (0..count).map(|_| decode_issue(&mut input)).collect::<Result<_, _>>()?
    };
    let base = match 3 <= layout && input.flag("base epoch")? {
        true => Some(decode_base_epoch(&mut input, layout, time)?),
        false => None,
    };
    let origin = match layout < WITH_COLUMNS {
        true => Some((input.text()?.to_owned(), input.text()?.to_owned())),
        false => None,
    };
    let protection = match 4 <= layout && input.flag("protection levels")? {
        true => Some(Protection { horizontal_m: input.f64()?, vertical_m: input.f64()? }),
        false => None,
    };
    input.finish()?;
    let provenance = Provenance { ephemerides, base };
    let solution = Solution { time, status, estimate, protection, reasons, provenance };
    Ok(DecodedSolution { solution, origin })
}

fn decode_base_epoch(
    input: &mut Decoder<'_>,
    layout: u8,
    time: GpsTime,
) -> Result<BaseEpochIssue, CodecError> {
    let base = input.text()?.to_owned();
    let time = match layout < WITH_COLUMNS {
        true => input.time()?,
        false => GpsTime::from_ns(time.as_ns().wrapping_add(input.span()?)),
    };
    Ok(BaseEpochIssue { base, time })
}

/// A list of satellites, in bytes or in bits.
fn decode_list(input: &mut Decoder<'_>, layout: u8) -> Result<Vec<SatelliteId>, CodecError> {
    if layout < WITH_COLUMNS { input.satellites() } else { decode_satellites(input) }
}

fn decode_issue(input: &mut Decoder<'_>) -> Result<EphemerisIssue, CodecError> {
    Ok(EphemerisIssue {
        satellite: input.satellite()?,
        toe: input.time()?,
        issue: input.u32("issue")?,
    })
}

fn decode_estimate(
    input: &mut Decoder<'_>,
    layout: u8,
    columns: SolutionColumns,
) -> Result<SolutionEstimate, CodecError> {
    let position = match (WITH_COLUMNS <= layout && input.flag("position")?, columns.position_m) {
        (false, _) => Ecef(input.vector()?),
        (true, [Some(x_m), Some(y_m), Some(z_m)]) => Ecef(Vector3::new(x_m, y_m, z_m)),
        (true, _) => return Err(input.invalid("position")),
    };
    let covariance = input.covariance()?;
    let velocity = match input.flag("velocity")? {
        true => Some(Velocity {
            velocity_m_s: input.vector()?,
            covariance: input.covariance()?,
            clock_drift_m_s: input.f64()?,
        }),
        false => None,
    };
    let clock_m = input.f64()?;
    let count = input.count("number of biases")?;
    let mut inter_system_biases_m = Vec::with_capacity(count);
    for _ in 0..count {
        inter_system_biases_m.push((input.constellation()?, input.f64()?));
    }
    Ok(SolutionEstimate {
        position,
        covariance,
        velocity,
        clock_m,
        inter_system_biases_m,
        reception_time: match layout < WITH_COLUMNS {
            true => input.time()?,
            false => GpsTime::from_ns(columns.time.as_ns().wrapping_add(input.signed()?)),
        },
        dops: decode_dops(input)?,
        satellites_used: decode_list(input, layout)?,
        relative: match 2 <= layout && input.flag("relative estimate")? {
            true => Some(decode_relative(input)?),
            false => None,
        },
    })
}

fn decode_dops(input: &mut Decoder<'_>) -> Result<Dops, CodecError> {
    let (gdop, pdop, hdop) = (input.f64()?, input.f64()?, input.f64()?);
    let vdop = input.f64_near(other_dop(pdop, hdop))?;
    let tdop = input.f64_near(other_dop(gdop, pdop))?;
    Ok(Dops { gdop, pdop, hdop, vdop, tdop })
}

fn decode_relative(input: &mut Decoder<'_>) -> Result<RelativeEstimate, CodecError> {
    Ok(RelativeEstimate {
        baseline_m: input.vector()?,
        age_s: input.f64()?,
        ambiguities: input.usize("ambiguities")?,
        fixed_ambiguities: input.usize("fixed ambiguities")?,
        ratio: input.optional_f64()?,
        success_rate: input.optional_f64()?,
        fix_probability: input.optional_f64()?,
    })
}

fn decode_reason(input: &mut Decoder<'_>, layout: u8) -> Result<Reason, CodecError> {
    Ok(match input.u8()? {
        0 => Reason::EphemerisMissing { satellites: decode_list(input, layout)? },
        1 => Reason::TooFewSatellites {
            used: input.usize("satellites used")?,
            needed: input.usize("satellites needed")?,
        },
        2 => Reason::GeometryTooWeak { gdop: input.f64()? },
        3 => Reason::NoRedundancy,
        4 => Reason::ResidualsTooLarge { ratio: input.f64()? },
        5 => Reason::SatellitesExcluded { satellites: decode_list(input, layout)? },
        6 => Reason::NotConverged,
        7 => {
            let text = input.text()?;
            let model = IonosphereModel::ALL.iter().find(|model| model.name() == text);
            let model = model.ok_or_else(|| input.invalid("ionosphere model"))?;
            Reason::IonosphereFallback { used: model.name() }
        }
        8 => Reason::BaseMissing,
        9 => Reason::BaseStale { age_s: input.f64()? },
        10 => Reason::BasePositionDoubtful { distance_m: input.f64()? },
        11 => Reason::BaselineTooLong { length_m: input.f64()? },
        12 => Reason::TooFewCommonSatellites {
            used: input.usize("common satellites used")?,
            needed: input.usize("common satellites needed")?,
        },
        13 => Reason::RatioBelowThreshold { ratio: input.f64()?, threshold: input.f64()? },
        14 => Reason::SuccessRateTooLow { success_rate: input.f64()? },
        15 => Reason::FixRejected,
        16 => Reason::HalfCycleUnresolved { satellites: decode_list(input, layout)? },
        17 => Reason::CycleSlips { satellites: decode_list(input, layout)? },
        18 => Reason::StartUnproven { age_s: input.f64()? },
        19 => Reason::OdometryUnused { interval_s: input.f64()? },
        20 => Reason::FixImprecise { sigma_m: input.f64()? },
        21 => Reason::BaseMoved { distance_m: input.f64()? },
        22 => Reason::BaseChanged { distance_m: input.f64()? },
        23 => Reason::EpochRepeated { behind_s: input.f64()? },
        24 => {
            Reason::ProtectionLimitExceeded { level_m: Some(input.f64()?), limit_m: input.f64()? }
        }
        25 => Reason::ProtectionLimitExceeded { level_m: None, limit_m: input.f64()? },
        26 => Reason::EstimatorFailed,
        _ => return Err(input.invalid("reason")),
    })
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use crate::store::codec::sample;

    use super::*;

    /// The solution without what `layout` cannot express.
    fn of_layout(layout: u8, solution: &Solution) -> Solution {
        let mut solution = solution.clone();
        if layout < 4 {
            solution.protection = None;
        }
        if layout < 3 {
            solution.provenance.base = None;
        }
        if let Some(estimate) = solution.estimate.as_mut().filter(|_| layout < 2) {
            estimate.relative = None;
        }
        solution
    }

    /// A solution in layouts 1 to 4, as Graphfix wrote it before layout 5.
    fn encode_former(layout: u8, solution: &Solution, version: &str, hash: &str) -> Vec<u8> {
        let mut out = Encoder::new(layout, 0);
        out.time(solution.time);
        out.u8(status_number(solution.status) as u8);
        out.u8(u8::from(solution.estimate.is_some()));
        if let Some(estimate) = &solution.estimate {
            encode_former_estimate(&mut out, layout, estimate);
        }
        out.count(solution.reasons.len());
        solution.reasons.iter().for_each(|reason| encode_former_reason(&mut out, reason));
        out.count(solution.provenance.ephemerides.len());
        for used in &solution.provenance.ephemerides {
            out.satellite(used.satellite);
            out.time(used.toe);
            out.unsigned(used.issue.into());
        }
        if 3 <= layout {
            out.u8(u8::from(solution.provenance.base.is_some()));
            if let Some(used) = &solution.provenance.base {
                out.text(&used.base);
                out.time(used.time);
            }
        }
        out.text(version);
        out.text(hash);
        if 4 <= layout {
            out.u8(u8::from(solution.protection.is_some()));
            if let Some(protection) = &solution.protection {
                out.f64(protection.horizontal_m);
                out.f64(protection.vertical_m);
            }
        }
        out.finish()
    }

    fn encode_former_estimate(out: &mut Encoder, layout: u8, estimate: &SolutionEstimate) {
        out.vector(&estimate.position.0);
        out.covariance(&estimate.covariance);
        out.u8(u8::from(estimate.velocity.is_some()));
        if let Some(velocity) = &estimate.velocity {
            out.vector(&velocity.velocity_m_s);
            out.covariance(&velocity.covariance);
            out.f64(velocity.clock_drift_m_s);
        }
        out.f64(estimate.clock_m);
        out.count(estimate.inter_system_biases_m.len());
        for (constellation, bias_m) in &estimate.inter_system_biases_m {
            out.u8(constellation_number(*constellation));
            out.f64(*bias_m);
        }
        out.time(estimate.reception_time);
        let Dops { gdop, pdop, hdop, vdop, tdop } = estimate.dops;
        [gdop, pdop, hdop, vdop, tdop].into_iter().for_each(|dop| out.f64(dop));
        encode_former_satellites(out, &estimate.satellites_used);
        if 2 <= layout {
            out.u8(u8::from(estimate.relative.is_some()));
            if let Some(relative) = &estimate.relative {
                encode_relative(out, relative);
            }
        }
    }

    fn encode_former_reason(out: &mut Encoder, reason: &Reason) {
        let (number, satellites) = match reason {
            Reason::EphemerisMissing { satellites } => (0, satellites),
            Reason::SatellitesExcluded { satellites } => (5, satellites),
            Reason::HalfCycleUnresolved { satellites } => (16, satellites),
            Reason::CycleSlips { satellites } => (17, satellites),
            other => return encode_reason(out, other),
        };
        out.u8(number);
        encode_former_satellites(out, satellites);
    }

    fn encode_former_satellites(out: &mut Encoder, satellites: &[SatelliteId]) {
        out.count(satellites.len());
        satellites.iter().for_each(|satellite| out.satellite(*satellite));
    }

    #[test]
    fn a_position_without_columns_is_corrupt() {
        let columns = |position_m| SolutionColumns { time: GpsTime::EPOCH, position_m };
        let none = encode_solution(&Solution::none(GpsTime::EPOCH, vec![]));
        assert!(decode_solution(&none, columns([None; 3]), None).is_ok());
        let bytes = [5, 10, 1, 1, 1];
        let error = decode_solution(&bytes, columns([Some(1.0), None, None]), None).unwrap_err();
        assert_eq!(error, CodecError::Invalid { what: "position", offset: 4 });
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        /// Layouts 6 and 7 have no distances.
        #[test]
        fn layouts_6_and_7_are_read(first in sample::solution(), revision in sample::solution()) {
            let former_parts = |solution: &Solution| {
                let mut out = Encoder::in_parts(0, false);
                encode_content(&mut out, solution);
                Parts::of(out)
            };
            let (first_parts, parts) = (former_parts(&first), former_parts(&revision));
            let mut out = Encoder::new(FORMER_WHOLE, 0);
            parts::encode_whole(&mut out, &first_parts);
            let whole = out.finish();
            let read = decode_solution(&whole, solution_columns(&first), None).unwrap();
            prop_assert_eq!(format!("{:?}", read.solution), format!("{first:?}"));
            let mut out = Encoder::new(FORMER_RELATIVE, 0);
            parts::encode_relative(&mut out, &parts, &first_parts);
            let relative = out.finish();
            prop_assert!(is_relative(&relative));
            let columns = solution_columns(&revision);
            let read = decode_solution(&relative, columns, Some(&whole)).unwrap();
            prop_assert_eq!(format!("{:?}", read.solution), format!("{revision:?}"));
            // A revision of the present layout has a first answer of the present layout.
            let present = encode_revision(&revision, &whole);
            prop_assert!(!is_relative(&present));
            let read = decode_solution(&present, columns, None).unwrap();
            prop_assert_eq!(format!("{:?}", read.solution), format!("{revision:?}"));
        }

        /// In layout 5 the `f64` values are not apart, and there are no distances.
        #[test]
        fn layout_5_is_read(solution in sample::solution()) {
            let mut out = Encoder::new(WITH_COLUMNS, 0);
            encode_content(&mut out, &solution);
            let columns = solution_columns(&solution);
            let read = decode_solution(&out.finish(), columns, None).unwrap();
            prop_assert_eq!(format!("{:?}", read.solution), format!("{solution:?}"));
            prop_assert_eq!(read.origin, None);
        }

        #[test]
        fn former_layouts_are_read(solution in sample::solution(), layout in 1_u8..5) {
            let solution = of_layout(layout, &solution);
            let bytes = encode_former(layout, &solution, "0.1.0", "c0ffee");
            let columns = SolutionColumns { time: GpsTime::EPOCH, position_m: [None; 3] };
            let read = decode_solution(&bytes, columns, None).unwrap();
            prop_assert_eq!(format!("{:?}", read.solution), format!("{solution:?}"));
            let origin = read.origin.unwrap();
            prop_assert_eq!((&*origin.0, &*origin.1), ("0.1.0", "c0ffee"));
            let again = encode_former(layout, &read.solution, "0.1.0", "c0ffee");
            prop_assert_eq!(again, bytes);
        }
    }
}
