//! `graphfix config`: every option with its value in force.

use clap::Args;
use serde::Serialize;

use crate::config::{OptionEntry, PositioningOptions};

use super::Failure;
use super::option_arguments::OptionArguments;
use super::output::print;

/// Lists every option: name, unit, default, value in force, allowed values and meaning.
#[derive(Debug, Args)]
pub(crate) struct ConfigArguments {
    #[command(flatten)]
    options: OptionArguments,
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

/// The configuration in force, in JSON.
#[derive(Serialize)]
#[serde(rename_all = "camelCase")]
struct ConfigurationView {
    mode: &'static str,
    profile: &'static str,
    configuration_hash: String,
    options: Vec<OptionView>,
}

#[derive(Serialize)]
struct OptionView {
    name: &'static str,
    unit: &'static str,
    default: String,
    value: String,
    allowed: &'static str,
    meaning: &'static str,
}

impl From<OptionEntry> for OptionView {
    fn from(entry: OptionEntry) -> Self {
        let OptionEntry { name, unit, default, value, meaning, allowed } = entry;
        Self { name, unit, default, value, allowed, meaning }
    }
}

/// Prints the options in force with these arguments.
pub(crate) fn run(arguments: &ConfigArguments) -> Result<(), Failure> {
    let options = arguments.options.options(false)?;
    let text = if arguments.json { json(&options) } else { table(&options) };
    print(&text)
}

fn json(options: &PositioningOptions) -> String {
    let view = ConfigurationView {
        mode: options.mode.name(),
        profile: options.profile.name(),
        configuration_hash: options.configuration_hash(),
        options: options.entries().into_iter().map(OptionView::from).collect(),
    };
    serde_json::to_string_pretty(&view).expect("texts serialise") + "\n"
}

fn table(options: &PositioningOptions) -> String {
    let shown = |value: &str| if value.is_empty() { "-".to_owned() } else { value.to_owned() };
    let heads = ["option", "value in force", "default", "unit"].map(str::to_owned);
    let mut rows = vec![(heads, "meaning (allowed)".to_owned())];
    rows.extend(options.entries().into_iter().map(|entry| {
        let cells = [entry.name, &entry.value, &entry.default, entry.unit].map(shown);
        (cells, format!("{} ({})", entry.meaning, entry.allowed))
    }));
    let width = |column: usize| rows.iter().map(|(cells, _)| cells[column].len()).max();
    let [name, value, default, unit] = [0, 1, 2, 3].map(|column| width(column).unwrap_or(0));
    let mut text = format!(
        "mode {}, profile {}, configuration {}\n\n",
        options.mode.name(),
        options.profile.name(),
        options.configuration_hash(),
    );
    for ([a, b, c, d], meaning) in &rows {
        text += &format!("{a:<name$} {b:<value$} {c:<default$} {d:<unit$} {meaning}\n");
    }
    text
}

#[cfg(test)]
mod tests {
    use crate::config::{Mode, Profile};

    use super::*;

    #[test]
    fn json_and_table_show_every_option_and_override() {
        let mut options = PositioningOptions::new(Mode::Spp, Profile::General);
        options.set("ionosphere", "none").unwrap();
        let json: serde_json::Value = serde_json::from_str(&json(&options)).unwrap();
        let listed = json["options"].as_array().unwrap();
        assert_eq!(listed.len(), options.entries().len());
        let ionosphere = listed.iter().find(|o| o["name"] == "ionosphere").unwrap();
        assert_eq!(
            (&ionosphere["value"], &ionosphere["default"]),
            (&"none".into(), &"klobuchar".into())
        );
        for entry in options.entries() {
            assert!(table(&options).contains(entry.name));
        }
    }
}
