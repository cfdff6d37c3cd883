//! The reasons of a solution as the API spells them: values by name, and a remedy.

use prost_types::value::Kind;
use prost_types::{ListValue, Struct, Value};

use crate::gnss::{Reason, SatelliteId};

use super::v1;

/// A reason as a message.
pub(crate) fn reason(reason: &Reason) -> v1::Reason {
    let fields = values(reason).into_iter().map(|(name, value)| (name.to_owned(), value));
    v1::Reason {
        code: reason.code().to_owned(),
        message: reason.to_string(),
        remedy: remedy(reason).to_owned(),
        values: Some(Struct { fields: fields.collect() }),
    }
}

/// What the user can do about it.
pub(crate) const fn remedy(reason: &Reason) -> &'static str {
    match reason {
        Reason::EphemerisMissing { .. } => "push current navigation data for these satellites",
        Reason::TooFewSatellites { .. } => {
            "wait for a clearer sky, or allow more constellations or a lower elevation mask"
        }
        Reason::GeometryTooWeak { .. } => "allow more constellations or wait for a clearer sky",
        Reason::NoRedundancy => "allow more constellations so that errors can be detected",
        Reason::ResidualsTooLarge { .. } => {
            "expect reflections; trust the covariance, which has been widened"
        }
        Reason::SatellitesExcluded { .. } => "none needed: the others determine the position",
        Reason::NotConverged => "check the observations; they contradict one another",
        Reason::IonosphereFallback { .. } => {
            "push navigation data that carries the ionosphere coefficients"
        }
        Reason::BaseMissing => "name a base and push its epochs",
        Reason::BaseStale { .. } => "check the base's connection, or allow a greater base age",
        Reason::BasePositionDoubtful { .. } => "check the coordinates stated for the base",
        Reason::BaseMoved { .. } | Reason::BaseChanged { .. } => {
            "none needed: a fix comes back as after cycle slips"
        }
        Reason::BaselineTooLong { .. } => "choose a nearer base",
        Reason::TooFewCommonSatellites { .. } => {
            "choose a base that receives the rover's constellations and bands"
        }
        Reason::RatioBelowThreshold { .. }
        | Reason::SuccessRateTooLow { .. }
        | Reason::FixImprecise { .. } => {
            "wait for more epochs, a clearer sky, or receive a second frequency"
        }
        Reason::FixRejected => "none needed: it is tried again at the next epoch",
        Reason::HalfCycleUnresolved { .. } => "none needed: the receiver resolves them in time",
        Reason::CycleSlips { .. } => "expect less precision until the new ambiguities settle",
        Reason::StartUnproven { .. } => {
            "do not rely on the position until the reason is gone: drive on, or see more sky"
        }
        Reason::EpochRepeated { .. } => "write each epoch once, in the order of time",
        Reason::ProtectionLimitExceeded { .. } => {
            "do not rely on the position, or allow a greater limit or risk (`integrity.*`)"
        }
        Reason::OdometryUnused { .. } => {
            "send each displacement with the epoch where it ends, since the epoch before"
        }
        Reason::EstimatorFailed => "send the next epochs, and report the failure with this epoch",
    }
}

/// The values of a reason by name, lower camel case.
fn values(reason: &Reason) -> Vec<(&'static str, Value)> {
    match reason {
        Reason::EphemerisMissing { satellites } | Reason::SatellitesExcluded { satellites } => {
            vec![("satellites", list(satellites))]
        }
        Reason::TooFewSatellites { used, needed } => {
            vec![("used", number(*used as f64)), ("needed", number(*needed as f64))]
        }
        Reason::GeometryTooWeak { gdop } => vec![("gdop", number(*gdop))],
        Reason::ResidualsTooLarge { ratio } => vec![("ratio", number(*ratio))],
        Reason::IonosphereFallback { used } => vec![("used", text(used))],
        Reason::HalfCycleUnresolved { satellites } | Reason::CycleSlips { satellites } => {
            vec![("satellites", list(satellites))]
        }
        Reason::TooFewCommonSatellites { used, needed } => {
            vec![("used", number(*used as f64)), ("needed", number(*needed as f64))]
        }
        Reason::BaseStale { age_s } | Reason::StartUnproven { age_s } => {
            vec![("ageS", number(*age_s))]
        }
        Reason::OdometryUnused { interval_s } => vec![("intervalS", number(*interval_s))],
        Reason::EpochRepeated { behind_s } => vec![("behindS", number(*behind_s))],
        Reason::ProtectionLimitExceeded { level_m, limit_m } => {
            let level = level_m.map(|level_m| ("levelM", number(level_m)));
            level.into_iter().chain([("limitM", number(*limit_m))]).collect()
        }
        Reason::FixImprecise { sigma_m } => vec![("sigmaM", number(*sigma_m))],
        Reason::BasePositionDoubtful { distance_m }
        | Reason::BaseMoved { distance_m }
        | Reason::BaseChanged { distance_m } => {
            vec![("distanceM", number(*distance_m))]
        }
        Reason::BaselineTooLong { length_m } => vec![("lengthM", number(*length_m))],
        Reason::RatioBelowThreshold { ratio, threshold } => {
            vec![("ratio", number(*ratio)), ("threshold", number(*threshold))]
        }
        Reason::SuccessRateTooLow { success_rate } => {
            vec![("successRate", number(*success_rate))]
        }
        Reason::NoRedundancy
        | Reason::NotConverged
        | Reason::BaseMissing
        | Reason::FixRejected
        | Reason::EstimatorFailed => Vec::new(),
    }
}

fn number(number: f64) -> Value {
    Value { kind: Some(Kind::NumberValue(number)) }
}

fn text(text: &str) -> Value {
    Value { kind: Some(Kind::StringValue(text.to_owned())) }
}

fn list(satellites: &[SatelliteId]) -> Value {
    let values = satellites.iter().map(|satellite| text(&satellite.to_string())).collect();
    Value { kind: Some(Kind::ListValue(ListValue { values })) }
}
