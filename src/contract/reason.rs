//! The reasons of a solution in the form of the API: values by name, and a remedy.

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
        remedy: reason.remedy().to_owned(),
        values: Some(Struct { fields: fields.collect() }),
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
