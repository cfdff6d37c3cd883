//! What a table of options is made of.

use super::PositioningOptions;

/// Reads one option out of the options, as text.
pub(super) type Get = fn(&PositioningOptions) -> String;
/// Puts a text into the options; `None` if the option does not take it.
pub(super) type Set = fn(&mut PositioningOptions, &str) -> Option<()>;

/// One line of a table: an option's name, what it does, and how it is read and written.
pub(super) struct OptionSpecification {
    pub(super) name: &'static str,
    pub(super) unit: &'static str,
    pub(super) meaning: &'static str,
    pub(super) allowed: &'static str,
    pub(super) get: Get,
    pub(super) set: Set,
}

/// A number from `lowest` to `highest`.
pub(super) fn number(text: &str, lowest: f64, highest: f64) -> Option<f64> {
    text.parse().ok().filter(|value| (lowest..=highest).contains(value))
}

/// `on` or `off`.
pub(super) fn switch(text: &str) -> Option<bool> {
    match text {
        "on" => Some(true),
        "off" => Some(false),
        _ => None,
    }
}

/// What [`switch`] reads.
pub(super) fn switch_text(on: bool) -> String {
    if on { "on" } else { "off" }.to_owned()
}
