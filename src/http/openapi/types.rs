//! Types of texts that the derived schemas lack: enumerations by their names, and times of RFC
//! 3339.
//!
//! The schemas are derived from the messages, in which these fields are texts. If REST sends an
//! empty text while a field has no value, its schema allows the empty text, too.

use utoipa::openapi::path::Parameter;
use utoipa::openapi::schema::{AnyOfBuilder, Object, ObjectBuilder, Schema, SchemaType, Type};
use utoipa::openapi::{KnownFormat, OpenApi, RefOr, SchemaFormat};

use crate::contract::v1;

/// Ending of the names of properties that are UTC times of RFC 3339.
const TIME: &str = "Utc";
/// Times that are empty until their event has happened: schema and property.
const SOMETIMES_EMPTY: [(&str, &str); 8] = [
    ("Base", "lastStoredUtc"),
    ("Job", "startedUtc"),
    ("Job", "endedUtc"),
    ("Job", "expiresUtc"),
    ("JobDeliveries", "nextUtc"),
    ("JobDelivery", "endedUtc"),
    ("NavigationSource", "lastUtc"),
    ("Network", "lastUtc"),
];

/// Adds the types to a document.
pub(super) fn add(document: &mut OpenApi) {
    let schemas = document.components.iter_mut().flat_map(|components| &mut components.schemas);
    for (name, schema) in schemas {
        let RefOr::T(Schema::Object(object)) = schema else { continue };
        for (property, schema) in &mut object.properties {
            let RefOr::T(schema) = schema else { continue };
            if let Some(choices) = choices(name, property) {
                choose(schema, &choices);
            } else if property.ends_with(TIME) {
                date(schema, SOMETIMES_EMPTY.contains(&(name, property)));
            }
        }
    }
}

/// Adds the type of a parameter of a call at `path`.
pub(super) fn add_to_parameter(path: &str, parameter: &mut RefOr<Parameter>) {
    let RefOr::T(parameter) = parameter else { return };
    let Some(RefOr::T(schema)) = &mut parameter.schema else { return };
    let choices = match &*parameter.name {
        "order" => names("ORDER_", v1::Order::as_str_name),
        "view" => names("VIEW_", v1::View::as_str_name),
        "status" => statuses(),
        "state" => job_states(),
        "revisions" if path.ends_with(":series") => vec!["last".to_owned(), "first".to_owned()],
        "revisions" if path.ends_with(":watch") => vec!["all".to_owned(), "first".to_owned()],
        "revisions" => {
            let names = names("REVISIONS_", v1::Revisions::as_str_name);
            names.iter().map(|name| name.to_lowercase()).collect()
        }
        name if name.ends_with(TIME) => return date(schema, false),
        _ => return,
    };
    choose(schema, &choices);
}

/// The allowed texts of a property, if they are few and known.
fn choices(schema: &str, property: &str) -> Option<Vec<String>> {
    let or = |other: &str, mut names: Vec<String>| {
        names.push(other.to_owned());
        names
    };
    let listed = |names: &[&str]| names.iter().map(|name| (*name).to_owned()).collect();
    let of_status = ["Solution", "SeriesStatus", "SeriesInterval", "HistoryInterval"];
    Some(match (schema, property) {
        (_, "status" | "worstStatus" | "bestStatus") if of_status.contains(&schema) => statuses(),
        ("SessionHead", "status") => or("UNSPECIFIED", statuses()),
        ("Job", "state") => job_states(),
        ("Job", "webhookState") | ("JobDeliveries", "state") => {
            or("", names("DELIVERY_STATE_", v1::DeliveryState::as_str_name))
        }
        ("BaseArchive" | "Feed" | "NavigationSource" | "Network", "state") => {
            names("SOURCE_STATE_", v1::SourceState::as_str_name)
        }
        ("SatelliteView", "role") => names("SATELLITE_ROLE_", v1::SatelliteRole::as_str_name),
        ("PositionCheck", "verdict") => listed(&["UNCHECKED", "AGREES", "DOUBTFUL", "REFUSED"]),
        ("NavigationSource", "kind") => listed(&["archive", "caster"]),
        ("JobInput" | "JobUrl" | "JobUploadInput", "part") => {
            listed(&["rover", "navigation", "base"])
        }
        ("Odometry", "frame") => listed(&["ecef", "enu", "body"]),
        _ => return None,
    })
}

fn statuses() -> Vec<String> {
    names("STATUS_", v1::Status::as_str_name)
}

fn job_states() -> Vec<String> {
    names("JOB_STATE_", v1::JobState::as_str_name)
}

/// The names of an enumeration without its prefix and without UNSPECIFIED, which is 0. Its numbers
/// have no gaps.
fn names<E: TryFrom<i32>>(prefix: &str, name: impl Fn(&E) -> &'static str) -> Vec<String> {
    let values = (1..).map_while(|number| E::try_from(number).ok());
    values.map(|value| name(&value).trim_start_matches(prefix).to_owned()).collect()
}

/// Restricts a text to these choices.
fn choose(schema: &mut Schema, choices: &[String]) {
    let Schema::Object(text) = schema else { return };
    let is_choice = |text: &str| choices.iter().any(|choice| choice == text);
    text.default.take_if(|default| !default.as_str().is_some_and(is_choice));
    text.enum_values = Some(choices.iter().map(|choice| choice.as_str().into()).collect());
}

/// Makes a text a time, or a time that may be empty.
fn date(schema: &mut Schema, may_be_empty: bool) {
    let Schema::Object(text) = schema else { return };
    let format = || Some(SchemaFormat::KnownFormat(KnownFormat::DateTime));
    if !may_be_empty {
        text.default.take_if(|default| !default.is_null());
        text.format = format();
        return;
    }
    let Object { description, default, .. } = text.clone();
    let of_any_type = || ObjectBuilder::new().schema_type(SchemaType::AnyValue);
    *schema = AnyOfBuilder::new()
        .schema_type(Type::String)
        .item(of_any_type().format(format()))
        .item(of_any_type().max_length(Some(0)))
        .description(description)
        .default(default)
        .into();
}
