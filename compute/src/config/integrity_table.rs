//! The table of the options of protection levels.

use super::choices::Beyond;
use super::option_specification::{OptionSpecification, number};

#[rustfmt::skip]
pub(super) const INTEGRITY_TABLE: &[OptionSpecification] = &[
    OptionSpecification {
        name: "integrity.risk", unit: "",
        meaning: "probability that an error exceeds its protection level",
        allowed: "a number from 0.0000001 to 0.5",
        get: |o| o.integrity.risk.to_string(),
        set: |o, text| number(text, 1e-7, 0.5).map(|v| o.integrity.risk = v),
    },
    OptionSpecification {
        name: "integrity.limit_h_m", unit: "m",
        meaning: "largest horizontal protection level of a position to rely on",
        allowed: "off, or a number from 0.01 to 100000",
        get: |o| limit_text(o.integrity.limit_h_m),
        set: |o, text| limit(text).map(|v| o.integrity.limit_h_m = v),
    },
    OptionSpecification {
        name: "integrity.limit_v_m", unit: "m",
        meaning: "largest vertical protection level of a position to rely on",
        allowed: "off, or a number from 0.01 to 100000",
        get: |o| limit_text(o.integrity.limit_v_m),
        set: |o, text| limit(text).map(|v| o.integrity.limit_v_m = v),
    },
    OptionSpecification {
        name: "integrity.beyond", unit: "",
        meaning: "a position beyond a limit is answered with a reason, or not answered",
        allowed: "flag, withhold",
        get: |o| o.integrity.beyond.name().to_owned(),
        set: |o, text| Beyond::from_name(text).map(|v| o.integrity.beyond = v),
    },
];

fn limit(text: &str) -> Option<f64> {
    match text {
        "off" => Some(f64::INFINITY),
        text => number(text, 0.01, 1e5),
    }
}

fn limit_text(limit_m: f64) -> String {
    if limit_m.is_finite() { limit_m.to_string() } else { "off".to_owned() }
}
