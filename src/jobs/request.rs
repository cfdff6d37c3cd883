//! What a job is asked for: options and input files, as they are stored.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::config::{Mode, PositioningOptions, Profile};
use crate::formats::receiver::TimeReference;
use crate::formats::track::TrackFormat;
use crate::gnss::{Ecef, GpsTime};
use crate::recording::{AnswerKind, BasePosition};

use super::JobError;

/// Distances from the centre of the Earth at which a base can be (m), from the lowest ground at the
/// poles to the highest mountain.
const RADII_M: std::ops::RangeInclusive<f64> = 6.35e6..=6.39e6;

/// What a file is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Part {
    /// Observations of the rover.
    Rover,
    /// Navigation data.
    Navigation,
    /// Observations of the base.
    Base,
}

impl Part {
    /// The name of the part of an upload.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Rover => "rover",
            Self::Navigation => "navigation",
            Self::Base => "base",
        }
    }

    /// The part of a name.
    pub fn from_name(name: &str) -> Option<Self> {
        [Self::Rover, Self::Navigation, Self::Base].into_iter().find(|part| part.name() == name)
    }
}

/// An input file of a job.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct JobInput {
    /// What it is for.
    pub part: Part,
    /// Its name at the user.
    pub name: String,
    /// Hash of its bytes, BLAKE3, hexadecimal.
    pub hash: String,
    /// Its size (bytes).
    pub bytes: u64,
    /// Whether the service has added it, because the upload has none of this part.
    #[serde(default)]
    pub is_own: bool,
}

/// The source of the base's position.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum BaseOrigin {
    /// Header or messages, else the base's own single-point positions.
    Any,
    /// Header or messages only.
    FromHeader,
    /// This position of the marker, ECEF (m).
    Marker([f64; 3]),
}

/// The options of a job.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct JobOptions {
    /// Name of the mode.
    pub mode: String,
    /// Name of the profile.
    pub profile: String,
    /// Options that differ from the profile, by name.
    pub overrides: BTreeMap<String, String>,
    /// Name of the kind of answer: causal, smoothed or batch.
    pub answer: String,
    /// The source of the base's position.
    pub base_position: BaseOrigin,
    /// Name of the result's format.
    pub format: String,
    /// A time within half a day of the first message (ns of GPS time), for messages without week.
    pub near_ns: Option<i64>,
}

/// A job as it was asked for.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct JobRequest {
    /// The options.
    pub options: JobOptions,
    /// The input files: the rover's, those of navigation data, the base's.
    pub inputs: Vec<JobInput>,
}

/// What the options of a job mean.
pub(super) struct Plan {
    pub(super) options: PositioningOptions,
    pub(super) answer: AnswerKind,
    pub(super) format: TrackFormat,
    pub(super) base_position: Option<BasePosition>,
    pub(super) reference: Option<TimeReference>,
}

impl JobRequest {
    /// A request with its files in order.
    pub fn new(options: JobOptions, mut inputs: Vec<JobInput>) -> Self {
        inputs.sort_by_key(|input| input.part);
        Self { options, inputs }
    }

    /// The input of a part.
    pub fn input(&self, part: Part) -> Option<&JobInput> {
        self.inputs.iter().find(|input| input.part == part)
    }

    /// Identifies what the user has sent: the options, and the bytes of the files.
    pub(super) fn hash(&self) -> String {
        let sent = self.inputs.iter().filter(|input| !input.is_own).cloned().collect();
        let sent = Self { options: self.options.clone(), inputs: sent };
        blake3::hash(sent.to_json().as_bytes()).to_hex().to_string()
    }

    pub(super) fn to_json(&self) -> String {
        serde_json::to_string(self).expect("texts and finite numbers are JSON")
    }

    /// Checks files and options.
    ///
    /// # Errors
    /// A part is missing or given twice, or an option does not exist or does not fit the others.
    pub(super) fn plan(&self) -> Result<Plan, JobError> {
        let count = |part| self.inputs.iter().filter(|input| input.part == part).count();
        let wrong = |field, message: &str| {
            Err(JobError::InvalidOption { field, message: message.to_owned() })
        };
        match (count(Part::Rover), count(Part::Navigation), count(Part::Base)) {
            (1, 1.., 0 | 1) => {}
            (0, ..) => return wrong("rover", "the part rover is missing"),
            (1, 0, _) => {
                return wrong("navigation", "the part navigation is missing");
            }
            (1, ..) => return wrong("base", "there is more than one part base"),
            _ => return wrong("rover", "there is more than one part rover"),
        }
        self.options.plan(count(Part::Base) == 1)
    }
}

impl JobOptions {
    /// The positioning options, whose hash identifies them.
    pub(super) fn positioning(&self) -> Result<PositioningOptions, JobError> {
        let (mode, profile) = (Mode::parse(&self.mode)?, Profile::parse(&self.profile)?);
        let mut options = PositioningOptions::new(mode, profile);
        for (name, value) in &self.overrides {
            options.set(name, value)?;
        }
        Ok(options)
    }

    fn plan(&self, has_base: bool) -> Result<Plan, JobError> {
        let wrong = |field, message: String| JobError::InvalidOption { field, message };
        let options = self.positioning()?;
        let mode = options.mode.name();
        if options.mode.is_relative() && !has_base {
            return Err(JobError::BaseRequired { mode });
        }
        if options.mode.is_relative() {
            options.output.presentation(None).check(None).map_err(JobError::Frame)?;
        }
        let answer = AnswerKind::from_name(&self.answer).ok_or_else(|| {
            wrong("options", format!("{:?} is not causal, smoothed or batch", self.answer))
        })?;
        if answer != AnswerKind::Causal && !options.mode.has_window() {
            let message = format!("mode {mode} has no window, so no answer {}", answer.name());
            let is_batch = answer == AnswerKind::Batch;
            let field = if is_batch { "options.batch" } else { "options.smoothed" };
            return Err(wrong(field, message));
        }
        let format = TrackFormat::from_name(&self.format).ok_or_else(|| {
            let names = TrackFormat::names();
            wrong("options.format", format!("{:?} is not a format; known are {names}", self.format))
        })?;
        let base_position = match self.base_position {
            BaseOrigin::Any => None,
            BaseOrigin::FromHeader => Some(BasePosition::FromHeader),
            BaseOrigin::Marker([x, y, z]) => {
                let marker = Ecef::new(x, y, z);
                if !RADII_M.contains(&marker.0.norm()) {
                    let message =
                        format!("it is {:.0} m from the centre of the Earth", marker.0.norm());
                    return Err(wrong("options.basePosition", message));
                }
                Some(BasePosition::Marker(marker))
            }
        };
        let reference = self.near_ns.map(|ns| TimeReference::Day(GpsTime::from_ns(ns)));
        Ok(Plan { options, answer, format, base_position, reference })
    }
}
