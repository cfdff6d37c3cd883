//! Parameters that lists have in common.

use serde::Deserialize;
use utoipa::IntoParams;

use crate::contract::{Refusal, v1};
use crate::refusal::Code;

/// The page of a list.
#[derive(Clone, Debug, Default, Deserialize, IntoParams)]
#[serde(rename_all = "camelCase", default, deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct PageQuery {
    /// At most this many items on the page, 1 to 1000; 100 if absent. A page has at most 512
    /// bases. It may have fewer although more exist, because memory is scarce.
    #[param(minimum = 0, maximum = 1000)]
    pub(super) page_size: u32,
    /// `nextPageToken` of the previous answer.
    pub(super) page_token: String,
}

/// The view of the items of a list, by its name.
pub(super) fn view(name: Option<String>) -> Result<i32, Refusal> {
    let known = |name: &str| v1::View::from_str_name(&format!("VIEW_{name}"));
    named("view", name, known, "BASIC or FULL")
}

/// The order of a list, by its name.
pub(super) fn order(name: Option<String>) -> Result<i32, Refusal> {
    let known = |name: &str| v1::Order::from_str_name(&format!("ORDER_{name}"));
    named("order", name, known, "NEWEST_FIRST or OLDEST_FIRST")
}

/// An area: `SOUTH,WEST,NORTH,EAST` in degrees.
pub(super) fn area(text: &str) -> Result<v1::Area, Refusal> {
    let sides: Option<Vec<f64>> = text.split(',').map(|side| side.trim().parse().ok()).collect();
    let Some([south_deg, west_deg, north_deg, east_deg]) = sides.as_deref() else {
        let message = "it is SOUTH,WEST,NORTH,EAST in degrees, such as 47.1,8.2,47.5,8.9";
        return Err(Refusal::new(Code::InvalidField, message).at("area"));
    };
    let [south_deg, west_deg, north_deg, east_deg] = [*south_deg, *west_deg, *north_deg, *east_deg];
    Ok(v1::Area { south_deg, west_deg, north_deg, east_deg })
}

/// The number of a choice by its name; zero without one.
fn named<E: Into<i32>>(
    field: &str,
    name: Option<String>,
    known: impl Fn(&str) -> Option<E>,
    choices: &str,
) -> Result<i32, Refusal> {
    let Some(name) = name else { return Ok(0) };
    known(&name)
        .map(Into::into)
        .ok_or_else(|| Refusal::new(Code::InvalidField, format!("it is {choices}")).at(field))
}
