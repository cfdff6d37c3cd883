//! Navigation data of a recording, and the dates of its receiver data.
//!
//! RTCM 3 gives times of week without the week. It comes, in this order, from a time in the same
//! file, from the user, from another file of the recording, or from the times of ephemeris.

use crate::formats::observations::{FileFormat, LeftOut, first_time, read_navigation};
use crate::formats::receiver::TimeReference;
use crate::gnss::{Ephemeris, GpsTime, Navigation};

use super::{Input, RecordingError};

/// Dates the receiver data of a recording, whose files are of one time.
pub(super) struct Dating {
    /// The reference time that the user gives.
    given: Option<TimeReference>,
    /// A reference time from another file, or from the navigation data.
    found: Option<TimeReference>,
}

impl Dating {
    /// Dates a file by this reference, if there is one, unless it has a time of its own.
    pub(super) const fn new(given: Option<TimeReference>) -> Self {
        Self { given, found: None }
    }

    /// The reference of a file: its own time, else the one given, else the recording's.
    pub(super) fn of(&self, input: &Input) -> Result<Option<TimeReference>, RecordingError> {
        let own = first_time(input.recognised()?).map_err(|error| input.damaged(&error))?;
        Ok(own.map(TimeReference::Day).or(self.given).or(self.found))
    }
}

/// Skipped content of each file.
pub(super) type LeftOutOf<'a> = Vec<(&'a str, LeftOut)>;

/// The navigation data of a recording.
pub(super) struct NavigationFiles<'a> {
    pub(super) navigation: Navigation,
    pub(super) left_out: LeftOutOf<'a>,
    pub(super) dating: Dating,
}

impl<'a> NavigationFiles<'a> {
    /// Reads the navigation data of `inputs`; without any, those that the receivers of
    /// `observations` have decoded. `observations` help to date data without a GPS week.
    ///
    /// # Errors
    /// A file cannot be read or dated, or there are no navigation data.
    pub(super) fn read(
        inputs: &'a [Input],
        observations: &[&'a Input],
        given: Option<TimeReference>,
    ) -> Result<Self, RecordingError> {
        let mut dating = Dating::new(given);
        for input in observations {
            if dating.found.is_none()
                && let Some(TimeReference::Day(time)) = dating.of(input)?
            {
                dating.found = Some(TimeReference::Week(time));
            }
        }
        let mut files = Self { navigation: Navigation::default(), left_out: Vec::new(), dating };
        let mut undated = Vec::new();
        for input in navigation_of(inputs, observations)? {
            let is_receiver_data = input.format()? == FileFormat::Receiver;
            let reference = if is_receiver_data { files.dating.of(input)? } else { None };
            if is_receiver_data && reference.is_none() {
                undated.push(input);
            }
            files.merge(input, reference)?;
        }
        let middle = || middle_toe(&files.navigation).map(TimeReference::Week);
        files.dating.found = files.dating.found.or_else(middle);
        // Some ephemerides contain the full week and date the others.
        for input in undated {
            let name = input.name();
            let reference = files.dating.found;
            let reference =
                reference.ok_or(RecordingError::NoReferenceTime { name: name.to_owned() })?;
            files.left_out.retain(|(other, _)| *other != name);
            files.merge(input, Some(reference))?;
        }
        Ok(files)
    }

    fn merge(
        &mut self,
        input: &'a Input,
        reference: Option<TimeReference>,
    ) -> Result<(), RecordingError> {
        let remedy = "name a RINEX navigation file, or receiver data with ephemerides";
        let read = read_navigation(input.recognised()?, reference);
        let (navigation, left_out) =
            read.map_err(|error| input.not_understood(&error, error.remedy().unwrap_or(remedy)))?;
        self.navigation.merge(navigation);
        self.left_out.push((input.name(), left_out));
        Ok(())
    }
}

/// The files with navigation data: those named, else the receiver data among the observations.
fn navigation_of<'a>(
    inputs: &'a [Input],
    observations: &[&'a Input],
) -> Result<Vec<&'a Input>, RecordingError> {
    if !inputs.is_empty() {
        return Ok(inputs.iter().collect());
    }
    let mut own = Vec::new();
    for input in observations {
        if input.format()? == FileFormat::Receiver {
            own.push(*input);
        }
    }
    match (own.is_empty(), observations.first()) {
        (true, Some(rover)) => {
            // A file that holds no observations either is refused for that.
            rover.observations(None, &Navigation::default())?;
            Err(RecordingError::NavigationRequired { name: rover.name().to_owned() })
        }
        _ => Ok(own),
    }
}

/// The median of all times of ephemeris. Old ephemerides of single satellites do not change it.
fn middle_toe(navigation: &Navigation) -> Option<GpsTime> {
    let mut times: Vec<GpsTime> =
        navigation.satellites().flat_map(|(_, list)| list.iter().map(Ephemeris::toe)).collect();
    times.sort_unstable();
    times.get(times.len() / 2).copied()
}
