//! Solutions as bytes, with the version and configuration that computed them.

use crate::config::IonosphereModel;
use crate::gnss::{
    BaseEpochIssue, Dops, Ecef, EphemerisIssue, Protection, Provenance, Reason, RelativeEstimate,
    Solution, SolutionEstimate, Status, Velocity,
};

use super::CodecError;
use super::bytes::{Decoder, Encoder, constellation_number};

/// The newest version. Version 1 had no relative estimate, version 2 no base epoch, version 3 no
/// protection levels.
const VERSION: u8 = 4;

/// A solution with its version and configuration.
#[derive(Clone, Debug, PartialEq)]
pub(in crate::store) struct DecodedSolution {
    /// The solution.
    pub solution: Solution,
    /// Version of the program that computed it.
    pub version: String,
    /// Hash of the configuration in force.
    pub configuration_hash: String,
}

/// The stored number of a status. It never changes, and rises from none to best.
pub(in crate::store) const fn status_number(status: Status) -> i16 {
    match status {
        Status::None => 0,
        Status::Single => 10,
        Status::Ekf => 15,
        Status::Fgo => 20,
        Status::Float => 30,
        Status::Fixed => 40,
    }
}

/// Encodes a solution.
pub(in crate::store) fn encode_solution(
    solution: &Solution,
    version: &str,
    configuration_hash: &str,
) -> Vec<u8> {
    let mut out = Encoder::new(VERSION, 512);
    out.time(solution.time);
    out.u8(status_number(solution.status) as u8);
    out.u8(u8::from(solution.estimate.is_some()));
    if let Some(estimate) = &solution.estimate {
        encode_estimate(&mut out, estimate);
    }
    out.count(solution.reasons.len());
    for reason in &solution.reasons {
        encode_reason(&mut out, reason);
    }
    out.count(solution.provenance.ephemerides.len());
    for used in &solution.provenance.ephemerides {
        out.satellite(used.satellite);
        out.time(used.toe);
        out.unsigned(used.issue.into());
    }
    out.u8(u8::from(solution.provenance.base.is_some()));
    if let Some(used) = &solution.provenance.base {
        out.text(&used.base);
        out.time(used.time);
    }
    out.text(version);
    out.text(configuration_hash);
    out.u8(u8::from(solution.protection.is_some()));
    if let Some(protection) = &solution.protection {
        out.f64(protection.horizontal_m);
        out.f64(protection.vertical_m);
    }
    out.finish()
}

fn encode_estimate(out: &mut Encoder, estimate: &SolutionEstimate) {
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
    out.satellites(&estimate.satellites_used);
    out.u8(u8::from(estimate.relative.is_some()));
    if let Some(relative) = &estimate.relative {
        encode_relative(out, relative);
    }
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
            out.satellites(satellites);
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
            out.satellites(satellites);
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
            out.satellites(satellites);
        }
        Reason::CycleSlips { satellites } => {
            out.u8(17);
            out.satellites(satellites);
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

/// Decodes a solution.
pub(in crate::store) fn decode_solution(bytes: &[u8]) -> Result<DecodedSolution, CodecError> {
    let (mut input, layout) = Decoder::of_versions(bytes, VERSION)?;
    let time = input.time()?;
    let number = i16::from(input.u8()?);
    let known = Status::ALL.into_iter().find(|status| status_number(*status) == number);
    let status = known.ok_or_else(|| input.invalid("status"))?;
    let estimate = match input.flag("estimate")? {
        true => Some(decode_estimate(&mut input, layout)?),
        false => None,
    };
    let count = input.count("number of reasons")?;
    let reasons = (0..count).map(|_| decode_reason(&mut input)).collect::<Result<_, _>>()?;
    let count = input.count("number of ephemerides")?;
    let ephemerides = (0..count).map(|_| decode_issue(&mut input)).collect::<Result<_, _>>()?;
    let base = match 3 <= layout && input.flag("base epoch")? {
        true => Some(BaseEpochIssue { base: input.text()?.to_owned(), time: input.time()? }),
        false => None,
    };
    let (version, configuration_hash) = (input.text()?.to_owned(), input.text()?.to_owned());
    let protection = match 4 <= layout && input.flag("protection levels")? {
        true => Some(Protection { horizontal_m: input.f64()?, vertical_m: input.f64()? }),
        false => None,
    };
    input.finish()?;
    let provenance = Provenance { ephemerides, base };
    let solution = Solution { time, status, estimate, protection, reasons, provenance };
    Ok(DecodedSolution { solution, version, configuration_hash })
}

fn decode_issue(input: &mut Decoder<'_>) -> Result<EphemerisIssue, CodecError> {
    Ok(EphemerisIssue {
        satellite: input.satellite()?,
        toe: input.time()?,
        issue: input.u32("issue")?,
    })
}

fn decode_estimate(input: &mut Decoder<'_>, layout: u8) -> Result<SolutionEstimate, CodecError> {
    let position = Ecef(input.vector()?);
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
        reception_time: input.time()?,
        dops: Dops {
            gdop: input.f64()?,
            pdop: input.f64()?,
            hdop: input.f64()?,
            vdop: input.f64()?,
            tdop: input.f64()?,
        },
        satellites_used: input.satellites()?,
        relative: match 2 <= layout && input.flag("relative estimate")? {
            true => Some(decode_relative(input)?),
            false => None,
        },
    })
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

fn decode_reason(input: &mut Decoder<'_>) -> Result<Reason, CodecError> {
    Ok(match input.u8()? {
        0 => Reason::EphemerisMissing { satellites: input.satellites()? },
        1 => Reason::TooFewSatellites {
            used: input.usize("satellites used")?,
            needed: input.usize("satellites needed")?,
        },
        2 => Reason::GeometryTooWeak { gdop: input.f64()? },
        3 => Reason::NoRedundancy,
        4 => Reason::ResidualsTooLarge { ratio: input.f64()? },
        5 => Reason::SatellitesExcluded { satellites: input.satellites()? },
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
        16 => Reason::HalfCycleUnresolved { satellites: input.satellites()? },
        17 => Reason::CycleSlips { satellites: input.satellites()? },
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
