//! The arguments `--mode`, `--profile` and `--set` of several commands.

use clap::Args;

use crate::config::{Mode, OutputOptions, PositioningOptions, Profile};
use crate::refusal::Code;

use super::Failure;

/// The arguments that make [`PositioningOptions`].
#[derive(Clone, Debug, Args)]
pub(crate) struct OptionArguments {
    /// Estimator: spp, ekf, fgo, rtk-ekf or rtk-fgo. Default: fgo, with a base rtk-fgo.
    #[arg(long, value_name = "MODE")]
    pub(crate) mode: Option<String>,
    /// Profile (set of defaults): general, urban-vehicle, static, phone or paper.
    #[arg(long, value_name = "NAME", default_value = "general")]
    pub(crate) profile: String,
    /// Overrides one option, as in ionosphere=none; may be repeated. See `graphfix config`.
    #[arg(long, value_name = "KEY=VALUE", allow_hyphen_values = true)]
    pub(crate) set: Vec<String>,
}

impl OptionArguments {
    /// The options from the arguments, for a recording with or without a base.
    pub(crate) fn options(&self, has_base: bool) -> Result<PositioningOptions, Failure> {
        let standard = Mode::of_recording(has_base);
        let mode = self.mode.as_deref().map_or(Ok(standard), Mode::parse)?;
        let mut options = PositioningOptions::new(mode, Profile::parse(&self.profile)?);
        for (key, value) in assignments(&self.set)? {
            options.set(key, value)?;
        }
        Ok(options)
    }
}

/// Option and value of each `--set`.
///
/// # Errors
/// A `--set` without "=".
pub(crate) fn assignments(set: &[String]) -> Result<Vec<(&str, &str)>, Failure> {
    let mut all = Vec::with_capacity(set.len());
    for assignment in set {
        let (key, value) = assignment.split_once('=').ok_or_else(|| {
            let message = format!("--set {assignment:?} has no \"=\"");
            Failure::new(Code::Usage, message, "write --set KEY=VALUE")
        })?;
        all.push((key.trim(), value));
    }
    Ok(all)
}

/// Refuses options of the presentation, for a command that gives positions as they are computed.
///
/// # Errors
/// Such an option is set.
pub(crate) fn check_as_computed(set: &[String]) -> Result<(), Failure> {
    let values =
        assignments(set)?.into_iter().map(|(key, value)| (key.to_owned(), value.to_owned()));
    match OutputOptions::of_values(&values.collect())? == OutputOptions::as_computed() {
        true => Ok(()),
        false => {
            let message = "positions are compared as they are computed";
            let remedy = "leave out --set frame, base_frame and geoid";
            Err(Failure::new(Code::Usage, message, remedy))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn options(mode: &str, set: &[&str]) -> Result<PositioningOptions, Failure> {
        let set = set.iter().map(|s| (*s).to_owned()).collect();
        let mode = Some(mode.to_owned());
        OptionArguments { mode, profile: "general".to_owned(), set }.options(false)
    }

    #[test]
    fn the_default_is_the_best_that_the_files_allow() {
        let none = OptionArguments { mode: None, profile: "general".to_owned(), set: Vec::new() };
        let mode = |has_base| none.options(has_base).unwrap().mode;
        assert_eq!([false, true].map(mode), [Mode::Fgo, Mode::RtkFgo]);
    }

    #[test]
    fn overrides_apply_in_order() {
        let options = options("spp", &["cn0_mask_db_hz=20", "cn0_mask_db_hz=25"]).unwrap();
        assert_eq!(options.cn0_mask_db_hz, 25.0);
    }

    #[test]
    fn what_is_given_out_is_not_compared() {
        let check = |set: &str| check_as_computed(&[set.to_owned()]).map_err(|f| f.code());
        assert_eq!(check("velocity=on"), Ok(()));
        assert_eq!(check("frame=native"), Ok(()));
        assert_eq!(check("frame=ETRS89"), Err(Code::Usage));
        assert_eq!(check("geoid=on"), Err(Code::Usage));
    }

    #[test]
    fn refusals_have_their_codes() {
        let code = |mode, set: &[&str]| options(mode, set).unwrap_err().code();
        assert_eq!(code("ppp", &[]), Code::UnknownMode);
        assert_eq!(code("spp", &["velocity"]), Code::Usage);
        assert_eq!(code("spp", &["velocty=on"]), Code::UnknownOption);
        assert_eq!(code("spp", &["velocity=1"]), Code::InvalidOptionValue);
    }
}
