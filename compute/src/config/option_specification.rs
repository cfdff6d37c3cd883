//! One row of a table of options, and the parsers of option values.

use super::PositioningOptions;

/// Formats the value of one option as text.
pub(super) type Get = fn(&PositioningOptions) -> String;
/// Parses a text and stores the value; `None` if the option does not accept it.
pub(super) type Set = fn(&mut PositioningOptions, &str) -> Option<()>;

/// One row of a table: an option's name, unit, meaning, accepted values, getter and setter.
pub(super) struct OptionSpecification {
    pub(super) name: &'static str,
    pub(super) unit: &'static str,
    pub(super) meaning: &'static str,
    pub(super) allowed: &'static str,
    pub(super) get: Get,
    pub(super) set: Set,
}

/// Parses a number from `lowest` to `highest`, bounds included.
pub(super) fn number(text: &str, lowest: f64, highest: f64) -> Option<f64> {
    text.parse().ok().filter(|value| (lowest..=highest).contains(value))
}

/// Parses `on` or `off`.
pub(super) fn switch(text: &str) -> Option<bool> {
    match text {
        "on" => Some(true),
        "off" => Some(false),
        _ => None,
    }
}

/// The text that [`switch`] parses.
pub(super) fn switch_text(on: bool) -> String {
    if on { "on" } else { "off" }.to_owned()
}
