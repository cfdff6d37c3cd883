//! A request for a job: options and input files, as they are stored.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::aiding::AidingError;
use crate::aiding::bases::{BaseChoice, BaseId};
use crate::config::{Mode, PositioningOptions, Profile};
use crate::formats::receiver::TimeReference;
use crate::formats::result::ResultFormat;
use crate::gnss::{CoordinateFrame, Ecef, GpsTime};
use crate::recording::{AnswerKind, BasePosition};
use crate::session::{RerunPlan, RerunRequest, SessionError, SessionId, SolveRequest};

use super::JobError;
use super::webhook::Webhook;

/// Possible distances of a base from the centre of the Earth (m): from the lowest ground at the
/// poles to the highest mountain.
const RADII_M: std::ops::RangeInclusive<f64> = 6.35e6..=6.39e6;

/// The part of a job that a file is for.
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

    /// The part with this name.
    pub fn from_name(name: &str) -> Option<Self> {
        [Self::Rover, Self::Navigation, Self::Base].into_iter().find(|part| part.name() == name)
    }
}

/// An input file of a job.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct JobInput {
    /// The part that it is for.
    pub part: Part,
    /// Name of the file on the user's side.
    pub name: String,
    /// Hash of its bytes, BLAKE3, hexadecimal.
    pub hash: String,
    /// Its size (bytes).
    pub bytes: u64,
    /// Whether the service has added it because the upload lacks this part.
    #[serde(default)]
    pub is_own: bool,
    /// The URL from which it is fetched. It has no hash before.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub url: Option<String>,
    /// The frame that a base of the service states, such as `ITRF2014@2010.0`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub frame: Option<String>,
}

impl JobInput {
    /// A line for the report on a file that the service has added.
    pub(super) fn remark(&self) -> String {
        let line = format!("{}: {}", self.part.name(), self.name);
        match (self.part, self.frame.as_deref()) {
            (Part::Base, frame) => format!("{line}, frame: {}", frame.unwrap_or("unknown")),
            _ => line,
        }
    }

    /// Whether it is a URL whose file is to be fetched.
    pub(super) fn is_unfetched(&self) -> bool {
        self.url.is_some() && self.hash.is_empty()
    }
}

/// The source of the base's position.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum BaseOrigin {
    /// Header or messages; without them, the base's own single-point positions.
    Any,
    /// Header or messages only.
    FromHeader,
    /// This position of the marker, ECEF (m).
    Marker([f64; 3]),
}

/// The options of a job.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct JobOptions {
    /// Name of the mode; empty for that of the session.
    pub mode: String,
    /// Name of the profile; empty for that of the session.
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
    /// Ids of the bases whose stored epochs are used instead of a file of the base. None means the
    /// nearest base, or for a session the bases of its source.
    #[serde(default, skip_serializing_if = "BaseChoice::is_none")]
    pub bases: BaseChoice<String>,
    /// A session instead of the rover's file.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub session: Option<SessionSource>,
    /// URL of the webhook that is informed of the end of the job.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub webhook: Option<String>,
}

/// A session whose stored epochs a job positions.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SessionSource {
    /// Its id.
    pub id: String,
    /// First and last time of the epochs (ns of GPS time); `None` for no limit.
    pub span_ns: (Option<i64>, Option<i64>),
    /// Ids of the bases whose stored epochs are used; none for the session's.
    pub bases: BaseChoice<String>,
}

/// The input that a job takes from its session, as the session was when the job was created.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SessionInput {
    /// Numbers of the first and the last epoch.
    pub numbers: (u64, u64),
    /// Name of the mode.
    pub mode: String,
    /// Name of the profile.
    pub profile: String,
    /// All options with their values in force.
    pub configuration: BTreeMap<String, String>,
    /// Each epoch is positioned with the options and base epochs with which it was answered.
    pub is_as_answered: bool,
}

/// The stored request for a job.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct JobRequest {
    /// The options.
    pub options: JobOptions,
    /// The input files: the rover's, those of navigation data, the base's.
    pub inputs: Vec<JobInput>,
    /// The input from its session, if it has one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub session: Option<SessionInput>,
}

/// The settings that result from the options of a job.
pub(super) struct Plan {
    pub(super) options: PositioningOptions,
    pub(super) answer: AnswerKind,
    pub(super) format: ResultFormat,
    pub(super) base_position: Option<BasePosition>,
    pub(super) reference: Option<TimeReference>,
}

impl JobRequest {
    /// A request with its files ordered by part.
    pub fn new(options: JobOptions, mut inputs: Vec<JobInput>) -> Self {
        inputs.sort_by_key(|input| input.part);
        Self { options, inputs, session: None }
    }

    /// Adds an input.
    pub(super) fn add(&mut self, input: JobInput) {
        self.inputs.push(input);
        self.inputs.sort_by_key(|input| input.part);
    }

    /// The frame of a base that the service has added, as the base states it.
    pub(super) fn frame_of_own_base(&self) -> Option<CoordinateFrame> {
        CoordinateFrame::parse(self.input(Part::Base)?.frame.as_deref()?)
    }

    /// Whether there is neither a file of navigation data nor a session, which has its own.
    pub(super) fn lacks_navigation(&self) -> bool {
        self.options.session.is_none() && self.input(Part::Navigation).is_none()
    }

    /// Whether positions are relative to a base, and there is no file of a base.
    pub(super) fn lacks_base(&self, options: &PositioningOptions) -> bool {
        self.options.session.is_none() && options.mode.is_relative() && !self.has_base()
    }

    /// Whether a session is positioned again relative to stored epochs of a base. An archive may
    /// have more of these epochs.
    pub(super) fn takes_stored_base(&self, options: &PositioningOptions) -> bool {
        let is_changed = self.session.as_ref().is_some_and(|session| !session.is_as_answered);
        is_changed && options.mode.is_relative() && !self.has_base()
    }

    /// Whether the service is to add navigation data or a base, if the files need them.
    pub(super) fn lacks_aiding(&self, options: &PositioningOptions) -> bool {
        self.lacks_navigation() || self.lacks_base(options) || self.takes_stored_base(options)
    }

    /// The input of a part.
    pub fn input(&self, part: Part) -> Option<&JobInput> {
        self.inputs.iter().find(|input| input.part == part)
    }

    /// Hash of what the user has sent: the options, the bytes of the files, and the secret.
    pub(super) fn hash(&self, webhook: Option<&Webhook>) -> String {
        let sent = self.inputs.iter().filter(|input| !input.is_own).cloned().collect();
        let sent = Self { options: self.options.clone(), inputs: sent, session: None };
        let secret = webhook.map_or("", |webhook| webhook.secret.text());
        blake3::hash((sent.to_json() + secret).as_bytes()).to_hex().to_string()
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
        let counts = (count(Part::Rover), count(Part::Navigation), count(Part::Base));
        match (&self.session, counts) {
            (None, (1, _, 0 | 1)) | (Some(_), (0, 0, 0 | 1)) => {}
            (None, (0, ..)) => return wrong("rover", "the part rover is missing"),
            (Some(_), (1.., ..)) => {
                return wrong("rover", "the part rover and options.session are both given");
            }
            (Some(_), (0, 1.., _)) => {
                let message = "a session has the navigation data with which it was answered";
                return wrong("navigation", message);
            }
            (_, (_, _, 2..)) => return wrong("base", "there is more than one part base"),
            (None, _) => return wrong("rover", "there is more than one part rover"),
        }
        let options = match &self.session {
            None => self.options.positioning()?,
            Some(session) => session.positioning()?,
        };
        let field = match self.options.base_position {
            BaseOrigin::Any => None,
            BaseOrigin::FromHeader => Some("options.basePositionFromHeader"),
            BaseOrigin::Marker(_) => Some("options.basePosition"),
        };
        if let Some(field) = field.filter(|_| !self.has_base()) {
            return wrong(field, "it is of the position of the part base, which is missing");
        }
        let arrived = self.inputs.iter().filter(|input| !input.is_unfetched());
        if let Some(empty) = arrived.clone().find(|input| input.bytes == 0) {
            return wrong(empty.part.name(), "the file is empty");
        }
        let is_base = |input: &JobInput| input.part == Part::Base;
        let is_rover = |input: &JobInput| input.part == Part::Rover;
        let same = |rover: &JobInput| {
            arrived.clone().any(|input| is_base(input) && input.hash == rover.hash)
        };
        if arrived.clone().any(|input| is_rover(input) && same(input)) {
            return wrong("base", "it has the bytes of the part rover: give the base's own file");
        }
        self.options.plan(options)
    }

    /// Whether there is a file of a base.
    pub fn has_base(&self) -> bool {
        self.input(Part::Base).is_some()
    }
}

impl SessionInput {
    /// The input for a job from a plan of the sessions' desk.
    pub(super) fn of(plan: &RerunPlan) -> Self {
        let RerunPlan { numbers, options, is_as_answered } = plan;
        let entries = options.entries().into_iter();
        Self {
            numbers: *numbers,
            mode: options.mode.name().to_owned(),
            profile: options.profile.name().to_owned(),
            configuration: entries.map(|entry| (entry.name.to_owned(), entry.value)).collect(),
            is_as_answered: *is_as_answered,
        }
    }

    /// The plan for the sessions' desk.
    pub(super) fn plan(&self) -> Result<RerunPlan, JobError> {
        let (numbers, is_as_answered) = (self.numbers, self.is_as_answered);
        Ok(RerunPlan { numbers, options: self.positioning()?, is_as_answered })
    }

    /// The positioning options, whose hash identifies them.
    fn positioning(&self) -> Result<PositioningOptions, JobError> {
        positioning(&self.mode, &self.profile, &self.configuration)
    }

    /// Number of the session's epochs, if their numbers have no gaps.
    pub(super) const fn epochs(&self) -> u64 {
        let (first, last) = self.numbers;
        last - first + 1
    }
}

fn positioning(
    mode: &str,
    profile: &str,
    overrides: &BTreeMap<String, String>,
) -> Result<PositioningOptions, JobError> {
    let mut options = PositioningOptions::new(Mode::parse(mode)?, Profile::parse(profile)?);
    for (name, value) in overrides {
        options.set(name, value)?;
    }
    Ok(options)
}

impl JobOptions {
    /// The positioning options, whose hash identifies them.
    pub(super) fn positioning(&self) -> Result<PositioningOptions, JobError> {
        positioning(&self.mode, &self.profile, &self.overrides)
    }

    /// The session that replaces the rover's file, and how it is to be positioned.
    pub(super) fn rerun(
        &self,
        has_base_file: bool,
    ) -> Result<Option<(SessionId, RerunRequest)>, JobError> {
        let Some(SessionSource { id, span_ns, bases }) = &self.session else { return Ok(None) };
        let unknown = || JobError::Session(SessionError::NotFound { id: id.clone() });
        let id = SessionId::parse(id).ok_or_else(unknown)?;
        let base = bases.clone().try_map(|id| {
            let unknown = || AidingError::BaseNotFound { id: id.clone() };
            BaseId::parse(&id).ok_or_else(unknown)
        });
        let named = |name: &String| Some(name.clone()).filter(|name| !name.is_empty());
        let change = SolveRequest {
            mode: named(&self.mode),
            profile: named(&self.profile),
            overrides: self.overrides.clone(),
            base: base.map_err(SessionError::from)?,
        };
        let time = |ns: Option<i64>| ns.map(GpsTime::from_ns);
        let span = (time(span_ns.0), time(span_ns.1));
        let answer = self.answer_kind()?;
        Ok(Some((id, RerunRequest { change, has_base_file, span, answer })))
    }

    fn answer_kind(&self) -> Result<AnswerKind, JobError> {
        AnswerKind::from_name(&self.answer).ok_or_else(|| JobError::InvalidOption {
            field: "options",
            message: format!("{:?} is not causal, smoothed or batch", self.answer),
        })
    }

    /// The format of the result.
    fn result_format(&self) -> Result<ResultFormat, JobError> {
        let wrong = |message| JobError::InvalidOption { field: "options.format", message };
        let format = ResultFormat::from_name(&self.format).ok_or_else(|| {
            let names = ResultFormat::names();
            wrong(format!("{:?} is not a format; known are {names}", self.format))
        })?;
        match (format, &self.session) {
            (ResultFormat::Track(track), _) if !track.is_built() => {
                Err(JobError::FormatNotBuilt { message: track.not_built() })
            }
            (ResultFormat::Rinex, Some(session)) => Err(wrong(format!(
                "the observations of a session are at /v1/sessions/{}/observations.rnx",
                session.id
            ))),
            _ => Ok(format),
        }
    }

    fn plan(&self, options: PositioningOptions) -> Result<Plan, JobError> {
        let wrong = |field, message: String| JobError::InvalidOption { field, message };
        let mode = options.mode.name();
        if options.mode.is_relative() {
            options.output.presentation(None).check(None).map_err(JobError::Frame)?;
        }
        let answer = self.answer_kind()?;
        if answer != AnswerKind::Causal && !options.mode.has_window() {
            let message = format!("mode {mode} has no window, so no answer {}", answer.name());
            let is_batch = answer == AnswerKind::Batch;
            let field = if is_batch { "options.batch" } else { "options.smoothed" };
            return Err(wrong(field, message));
        }
        let format = self.result_format()?;
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
        if self.near_ns.is_some() && self.session.is_some() {
            return Err(wrong(
                "options.near",
                "the epochs of a session have their times".to_owned(),
            ));
        }
        if self.near_ns.is_some_and(|ns| ns < 0) {
            return Err(wrong("options.near", "it is before the begin of GPS time".to_owned()));
        }
        let reference = self.near_ns.map(|ns| TimeReference::Day(GpsTime::from_ns(ns)));
        Ok(Plan { options, answer, format, base_position, reference })
    }
}
