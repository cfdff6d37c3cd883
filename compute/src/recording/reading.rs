//! A recording, read epoch by epoch.

use crate::config::PositioningOptions;
use crate::formats::observations::GzipDamage;
use crate::formats::receiver::TimeReference;
use crate::formats::{antex, odometry};
use crate::gnss::{Epoch, Navigation};
use crate::positioning::Aiding;

use super::antenna::ReceiverAntenna;
use super::base::BaseRecording;
use super::navigation::{Dating, LeftOutOf, NavigationFiles};
use super::observations::{ObservationFile, ReportedSite, observations};
use super::odometry::OdometryRows;
use super::order::EpochOrder;
use super::span::Span;
use super::{AnswerKind, ApproximatePosition, BasePosition, Input, Provenance, RecordingError};

/// The files of a recording and how to read them.
pub struct RecordingInputs {
    /// Observations of the rover: RINEX, CRINEX, UBX, RTCM 3 or an Android GnssLogger log.
    pub rover: Input,
    /// Navigation data: RINEX, or UBX or RTCM 3 with ephemerides. Without any, those that the
    /// receivers of rover and base have decoded.
    pub navigation: Vec<Input>,
    /// Observations of the base, for modes relative to one.
    pub base: Option<Input>,
    /// Required source of the base's position; `None`: the best available source.
    pub base_position: Option<BasePosition>,
    /// Phase centres of antennas (ANTEX); headers and messages name the antennas.
    pub antex: Option<Input>,
    /// Displacements measured by another sensor (CSV).
    pub odometry: Option<Input>,
    /// Dates receiver data that have no GPS week.
    pub reference: Option<TimeReference>,
    /// First epoch, GPS seconds of week; `None`: the file's first. A smaller second than that of
    /// the file's first epoch may be of the next week.
    pub from_s: Option<f64>,
    /// Last epoch, GPS seconds of week; `None`: the file's last. A smaller second than the first
    /// one may be of the next week.
    pub to_s: Option<f64>,
}

impl RecordingInputs {
    /// The inputs of a rover alone, with all its epochs.
    pub const fn of_rover(rover: Input) -> Self {
        Self {
            rover,
            navigation: Vec::new(),
            base: None,
            base_position: None,
            antex: None,
            odometry: None,
            reference: None,
            from_s: None,
            to_s: None,
        }
    }

    /// Refuses a mode that needs a base if none is named, a kind of answer that the mode does not
    /// give, and a frame that nothing leads to from that of the base.
    ///
    /// # Errors
    /// The mode, the kind of answer or the frame is refused.
    pub fn check(
        &self,
        options: &PositioningOptions,
        answer: AnswerKind,
    ) -> Result<(), RecordingError> {
        let mode = options.mode.name();
        if options.mode.is_relative() && self.base.is_none() {
            return Err(RecordingError::BaseRequired { mode });
        }
        if answer != AnswerKind::Causal && !options.mode.has_window() {
            return Err(RecordingError::NoSuchAnswer { mode, answer: answer.name() });
        }
        let presentation = options.output.presentation(None);
        let checked = if options.mode.is_relative() { presentation.check(None) } else { Ok(()) };
        checked.map_err(|refusal| RecordingError::FrameUnavailable { refusal })
    }

    pub(super) const fn span(&self) -> Span {
        Span::new(self.from_s, self.to_s)
    }
}

/// A recording that is being read, epoch by epoch.
pub struct Recording<'a> {
    inputs: &'a RecordingInputs,
    span: Span,
    navigation: Navigation,
    dating: Dating,
    left_out: LeftOutOf<'a>,
    rover: ObservationFile,
    order: EpochOrder<()>,
    base: Option<BaseRecording<'a>>,
    /// The rover's antenna and approximate position.
    antenna: Option<(ReceiverAntenna, ApproximatePosition)>,
    odometry: Option<OdometryRows>,
}

impl<'a> Recording<'a> {
    /// Reads the navigation data and the header of the observations.
    ///
    /// # Errors
    /// A file cannot be read or dated, or no source gives the base's position.
    pub fn open(inputs: &'a RecordingInputs) -> Result<Self, RecordingError> {
        let observed: Vec<&Input> = std::iter::once(&inputs.rover).chain(&inputs.base).collect();
        let files = NavigationFiles::read(&inputs.navigation, &observed, inputs.reference)?;
        let NavigationFiles { navigation, left_out, dating } = files;
        let rover = observations(&inputs.rover, &dating, &navigation)?;
        let base = open_base(inputs, &dating, &navigation)?;
        let odometry = inputs.odometry.as_ref().map(read_odometry).transpose()?;
        let (span, order, antenna) = (inputs.span(), EpochOrder::default(), None);
        let mut recording = Self {
            inputs,
            span,
            navigation,
            dating,
            left_out,
            rover,
            order,
            base,
            antenna,
            odometry,
        };
        recording.find_antennas()?;
        Ok(recording)
    }

    /// The broadcast navigation data.
    pub const fn navigation(&self) -> &Navigation {
        &self.navigation
    }

    /// The files of the recording.
    pub(super) const fn inputs(&self) -> &'a RecordingInputs {
        self.inputs
    }

    /// What dates them.
    pub(super) const fn dating(&self) -> &Dating {
        &self.dating
    }

    /// The aiding data of the last epoch read.
    pub fn aiding(&self) -> Aiding<'_> {
        let base = self.base.as_ref().map(BaseRecording::aiding);
        Aiding { navigation: &self.navigation, base }
    }

    /// Reads the next epoch of the requested span into `epoch`; false at the end.
    ///
    /// # Errors
    /// The rover's or the base's file cannot be read.
    pub fn read_epoch(&mut self, epoch: &mut Epoch) -> Result<bool, RecordingError> {
        let damaged = |error| self.inputs.rover.damaged(&error);
        loop {
            let read = |epoch: &mut Epoch| {
                Ok(self.rover.read_epoch(epoch).map_err(damaged)?.then_some(()))
            };
            if self.order.next(epoch, read)?.is_none() {
                return Ok(false);
            }
            // Also for epochs outside the span, so that their rows are not assigned to later ones.
            epoch.odometry = self.odometry.as_mut().and_then(|rows| rows.at(epoch.time));
            if !self.span.contains(epoch.time) {
                continue;
            }
            if let Some((antenna, position)) = &mut self.antenna {
                let position = position.at(epoch, &self.navigation);
                antenna.correct(epoch, position, &self.navigation);
            }
            if let Some(base) = &mut self.base {
                base.follow(epoch.time, &self.navigation)?;
            }
            return Ok(true);
        }
    }

    /// The error of a recording that has no epoch in the span.
    pub(super) fn without_epochs(&self) -> RecordingError {
        let rover = &self.inputs.rover;
        match self.rover.left_out().damage {
            Some(damage) => {
                let reason = format!("no epoch in the span; {damage}");
                rover.not_understood(&reason, GzipDamage::REMEDY)
            }
            None => RecordingError::NoEpochs { name: rover.name().to_owned() },
        }
    }

    /// Looks up the antennas that headers and messages name.
    fn find_antennas(&mut self) -> Result<(), RecordingError> {
        let Some(input) = &self.inputs.antex else { return Ok(()) };
        let catalogue = antex::read(input.open()?).map_err(|error| {
            let remedy = "name an ANTEX file of absolute calibrations";
            input.not_understood(&error, remedy)
        })?;
        let site = ReportedSite::of(&self.inputs.rover, &self.rover)?;
        let antenna = ReceiverAntenna::new("rover", &site.antenna, &catalogue);
        self.antenna = Some((antenna, ApproximatePosition::new(site.marker)));
        if let Some(base) = &mut self.base {
            base.find_antenna(&catalogue);
        }
        Ok(())
    }

    /// The provenance of the epochs read so far.
    pub fn provenance(&self) -> Provenance {
        let mut left_out = vec![(self.inputs.rover.name(), self.rover.left_out())];
        left_out.extend(self.base.as_ref().map(BaseRecording::left_out));
        // A file of observations and navigation data is listed once.
        let observed = left_out.len();
        for (name, navigation) in &self.left_out {
            if left_out[..observed].iter().all(|(listed, _)| listed != name) {
                left_out.push((name, navigation.clone()));
            }
        }
        let base_antenna = self.base.as_ref().and_then(BaseRecording::antenna_provenance);
        let rover_antenna = self.antenna.as_ref().map(|(antenna, _)| antenna.provenance());
        Provenance {
            base: self.base.as_ref().map(BaseRecording::provenance),
            is_base_unused: false,
            antennas: base_antenna.into_iter().chain(rover_antenna).collect(),
            out_of_time: self.order.left_out(),
            unmatched_odometry: self.odometry.as_ref().map(OdometryRows::unmatched),
            left_out: left_out.into_iter().map(|(name, left)| (name.to_owned(), left)).collect(),
        }
    }
}

fn open_base<'a>(
    inputs: &'a RecordingInputs,
    dating: &Dating,
    navigation: &Navigation,
) -> Result<Option<BaseRecording<'a>>, RecordingError> {
    let open = |input| BaseRecording::open(input, inputs.base_position, dating, navigation);
    inputs.base.as_ref().map(open).transpose()
}

fn read_odometry(input: &Input) -> Result<OdometryRows, RecordingError> {
    let rows = odometry::read(input.open()?)
        .map_err(|error| input.not_understood(&error, "correct the file at that line"))?;
    Ok(OdometryRows::new(rows))
}
