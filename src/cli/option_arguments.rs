//! The arguments `--mode`, `--profile` and `--set` of several commands.

use clap::Args;

use crate::config::{Mode, PositioningOptions, Profile};
use crate::refusal::Code;

use super::Failure;

/// The arguments that make [`PositioningOptions`].
#[derive(Clone, Debug, Args)]
pub(crate) struct OptionArguments {
    /// Estimator: spp, ekf, fgo, rtk-ekf or rtk-fgo.
    #[arg(long, value_name = "MODE", default_value = "spp")]
    pub(crate) mode: String,
    /// Profile (set of defaults): general, urban-vehicle, static, phone or paper.
    #[arg(long, value_name = "NAME", default_value = "general")]
    pub(crate) profile: String,
    /// Overrides one option, as in ionosphere=none; may be repeated. See `graphfix config`.
    #[arg(long, value_name = "KEY=VALUE", allow_hyphen_values = true)]
    pub(crate) set: Vec<String>,
}

impl OptionArguments {
    /// The options given.
    pub(crate) fn options(&self) -> Result<PositioningOptions, Failure> {
        let mut options =
            PositioningOptions::new(Mode::parse(&self.mode)?, Profile::parse(&self.profile)?);
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

#[cfg(test)]
mod tests {
    use super::*;

    fn options(mode: &str, set: &[&str]) -> Result<PositioningOptions, Failure> {
        let set = set.iter().map(|s| (*s).to_owned()).collect();
        OptionArguments { mode: mode.to_owned(), profile: "general".to_owned(), set }.options()
    }

    #[test]
    fn overrides_apply_in_order() {
        let options = options("spp", &["cn0_mask_db_hz=20", "cn0_mask_db_hz=25"]).unwrap();
        assert_eq!(options.cn0_mask_db_hz, 25.0);
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
