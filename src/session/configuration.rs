//! The options in force: from a user's request, and from the store.

use std::collections::BTreeMap;

use crate::config::{ConfigError, Mode, OptionEntry, OutputOptions, PositioningOptions, Profile};
use crate::store::{AntennaName, BaseChoice, SessionSettings, StoredConfiguration};

use super::SessionError;

/// The options of a mode and profile with overrides.
///
/// # Errors
/// The mode, profile, option or value does not exist.
pub(super) fn options(
    mode: &str,
    profile: &str,
    overrides: &BTreeMap<String, String>,
) -> Result<PositioningOptions, ConfigError> {
    let mut options = PositioningOptions::new(Mode::parse(mode)?, Profile::parse(profile)?);
    for (name, value) in overrides {
        options.set(name, value)?;
    }
    Ok(options)
}

/// The settings of a session as they are stored, without a retention of its own.
///
/// # Errors
/// The mode, profile, option or value does not exist, or the mode needs a base and none is named.
pub(super) fn settings(
    label: String,
    mode: String,
    profile: String,
    overrides: BTreeMap<String, String>,
    base: BaseChoice,
    antenna: Option<AntennaName>,
) -> Result<SessionSettings, SessionError> {
    let options = options(&mode, &profile, &overrides)?;
    base_of(options.mode, &base)?;
    let active_configuration =
        options.entries().into_iter().map(|entry| (entry.name.to_owned(), entry.value));
    let configuration = active_configuration.collect();
    let calibration = antenna.as_ref().map(|antenna| &*antenna.calibration);
    let configuration_hash = configuration_hash(&options, calibration).into();
    Ok(SessionSettings {
        label,
        mode,
        profile,
        overrides,
        configuration,
        configuration_hash,
        base,
        antenna,
        retention_days: None,
    })
}

/// The options of a stored session with their values in force. Options that this version does not
/// know are left out.
pub(super) fn entries(settings: &SessionSettings) -> Vec<OptionEntry> {
    if let Ok(options) = stored_options(settings) {
        return options.entries();
    }
    // Another version stored options that this one does not know.
    let known = options(&settings.mode, &settings.profile, &BTreeMap::new());
    let mut entries = known.map(|options| options.entries()).unwrap_or_default();
    for entry in &mut entries {
        if let Some(value) = settings.configuration.get(entry.name) {
            entry.value.clone_from(value);
        }
    }
    entries
}

/// The hash of a configuration. It covers the options and, if the session corrects for antennas,
/// the calibration of the rover's antenna.
pub(super) fn configuration_hash(
    options: &PositioningOptions,
    calibration: Option<&str>,
) -> String {
    let hash = options.configuration_hash();
    match calibration {
        None => hash,
        Some(calibration) => {
            blake3::hash(format!("{hash}\nantenna={calibration}\n").as_bytes()).to_hex().to_string()
        }
    }
}

/// The bases that a mode uses: none if it is not relative to a base.
///
/// # Errors
/// The mode is relative to a base, and none is named.
pub(super) fn base_of(mode: Mode, base: &BaseChoice) -> Result<BaseChoice, SessionError> {
    match (mode.is_relative(), base) {
        (false, _) => Ok(BaseChoice::None),
        (true, BaseChoice::None) => Err(SessionError::BaseRequired { mode: mode.name() }),
        (true, base) => Ok(base.clone()),
    }
}

/// The options that were in force when the settings were stored. Later changes of a profile's
/// values do not affect them.
///
/// # Errors
/// An option no longer exists.
pub(super) fn stored_options(
    settings: &SessionSettings,
) -> Result<PositioningOptions, ConfigError> {
    options(&settings.mode, &settings.profile, &settings.configuration)
}

/// The output options of a session: frame and heights of the reported positions.
///
/// # Errors
/// A value no longer exists.
pub(super) fn output(settings: &SessionSettings) -> Result<OutputOptions, ConfigError> {
    OutputOptions::of_values(&settings.configuration)
}

/// The options of a stored configuration, for replay.
///
/// # Errors
/// An option no longer exists.
pub(super) fn kept_options(kept: &StoredConfiguration) -> Result<PositioningOptions, ConfigError> {
    options(&kept.mode, &kept.profile, &kept.configuration)
}
