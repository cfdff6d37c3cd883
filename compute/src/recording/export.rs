//! The rover's observations as a RINEX file, as they are read: before antennas correct them.

use std::io::{self, Write};

use crate::formats::rinex::{ObservationHeader, ObservationWriter, RinexVersion, RinexWriteError};
use crate::gnss::{Ecef, Epoch, GpsTime};

use super::observations::{ObservationFile, ReportedSite, observations};
use super::span::Span;
use super::{Input, Recording, RecordingError, RecordingInputs};

/// The rover's observations of a recording on their way into a RINEX 3.05 file.
///
/// The header names all signals, so the rover's file is read twice, epoch by epoch: first for the
/// header, then for the epochs.
pub struct ObservationExport<'a, W: Write> {
    inputs: &'a RecordingInputs,
    span: Span,
    header: ObservationHeader,
    /// Reads for the header.
    surveyed: Option<ObservationFile>,
    /// Reads for the epochs, which the writer writes.
    written: ObservationFile,
    epoch: Epoch,
    target: Target<W>,
}

/// Where the file goes.
enum Target<W: Write> {
    Waiting(Counted<W>),
    Begun(ObservationWriter<Counted<W>>),
    /// Writing has failed.
    Failed,
}

/// An output that counts its bytes.
#[derive(Debug)]
struct Counted<W> {
    output: W,
    bytes: u64,
}

/// Why the observations cannot be written.
#[derive(Debug, thiserror::Error)]
pub enum ExportError {
    /// The rover's file cannot be read.
    #[error(transparent)]
    Read(#[from] RecordingError),
    /// The output fails.
    #[error(transparent)]
    Write(#[from] io::Error),
}

impl<'a> Recording<'a> {
    /// Begins a file of the rover's observations in `output`. `position` is that of the rover, if
    /// its file has none (m).
    ///
    /// # Errors
    /// The rover's file cannot be read.
    pub fn export<W: Write>(
        &self,
        output: W,
        position: Option<Ecef>,
    ) -> Result<ObservationExport<'a, W>, RecordingError> {
        let (inputs, dating) = (self.inputs(), self.dating());
        let open = || observations(&inputs.rover, dating, self.navigation());
        let surveyed = open()?;
        let mut header = begun_header(&inputs.rover, &surveyed)?;
        header.approximate_position = header.approximate_position.or(position);
        header.add_channels(self.navigation());
        Ok(ObservationExport {
            inputs,
            span: inputs.span(),
            header,
            surveyed: Some(surveyed),
            written: open()?,
            epoch: Epoch::new(GpsTime::EPOCH),
            target: Target::Waiting(Counted { output, bytes: 0 }),
        })
    }
}

/// A header with what the rover's file says of receiver, antenna and place.
fn begun_header(
    rover: &Input,
    file: &ObservationFile,
) -> Result<ObservationHeader, RecordingError> {
    let mut header = ObservationHeader::new(RinexVersion::new(3, 5));
    let site = ReportedSite::of(rover, file)?;
    if let Some(own) = file.header() {
        header.receiver.clone_from(&own.receiver);
        header.glonass_channels.clone_from(&own.glonass_channels);
    }
    header.marker = site.name;
    header.antenna = site.antenna;
    header.approximate_position = site.marker;
    header.antenna_delta_hen_m = site.antenna_delta_hen_m;
    Ok(header)
}

impl<W: Write> ObservationExport<'_, W> {
    /// Reads the next epoch, and writes it once the header is complete. Returns false at the end.
    ///
    /// # Errors
    /// The rover's file cannot be read, or the output fails.
    pub fn step(&mut self) -> Result<bool, ExportError> {
        let file = self.surveyed.as_mut().unwrap_or(&mut self.written);
        let damaged = |error| self.inputs.rover.damaged(&error);
        if !file.read_epoch(&mut self.epoch).map_err(damaged)? {
            return match self.surveyed.take() {
                Some(_) => self.begin().map(|()| true),
                None => Ok(false),
            };
        }
        if !self.span.contains(self.epoch.time) {
            return Ok(true);
        }
        match &mut self.target {
            Target::Waiting(_) => {
                self.header.first_observation.get_or_insert(self.epoch.time);
                self.header.add_codes(&self.epoch);
            }
            Target::Begun(writer) => {
                let fresh = Epoch::new(self.epoch.time);
                let epoch = std::mem::replace(&mut self.epoch, fresh);
                writer.write_what_fits(epoch).map_err(unwritable)?;
            }
            Target::Failed => {}
        }
        Ok(true)
    }

    /// Writes the header.
    fn begin(&mut self) -> Result<(), ExportError> {
        self.header.codes.iter_mut().for_each(|codes| codes.sort_unstable());
        if let Target::Waiting(output) = std::mem::replace(&mut self.target, Target::Failed) {
            let writer = ObservationWriter::new(output, &self.header).map_err(unwritable)?;
            self.target = Target::Begun(writer);
        }
        Ok(())
    }

    /// Number of bytes written so far.
    pub fn bytes(&self) -> u64 {
        match &self.target {
            Target::Waiting(output) => output.bytes,
            Target::Begun(writer) => writer.output().bytes,
            Target::Failed => 0,
        }
    }

    /// Completes the file after the last step. Returns the output and the number of bytes.
    ///
    /// # Errors
    /// The output fails.
    pub fn finish(self) -> Result<(W, u64), ExportError> {
        match self.target {
            Target::Begun(writer) => {
                let Counted { output, bytes } = writer.finish().map_err(unwritable)?;
                Ok((output, bytes))
            }
            Target::Waiting(_) | Target::Failed => {
                Err(io::Error::other("the observations are not complete").into())
            }
        }
    }
}

fn unwritable(error: RinexWriteError) -> ExportError {
    match error {
        RinexWriteError::WriteFailed(error) => error.into(),
        other => io::Error::other(other).into(),
    }
}

impl<W: Write> Write for Counted<W> {
    fn write(&mut self, buffer: &[u8]) -> io::Result<usize> {
        let count = self.output.write(buffer)?;
        self.bytes += count as u64;
        Ok(count)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.output.flush()
    }
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use super::*;
    use crate::formats::receiver::RawxWriter;
    use crate::formats::rinex::{ObservationReader, write_navigation};
    use crate::simulation::{Scenario, Simulator};

    const EPOCHS: usize = 5;

    /// A simulated log of a receiver, its epochs, and the inputs of a recording with it.
    fn recorded() -> (RecordingInputs, Vec<Epoch>) {
        let scenario = Scenario { duration_s: EPOCHS as f64 - 1.0, ..Scenario::rtk_open() };
        let simulator = Simulator::new(scenario, 1);
        let mut navigation = Vec::new();
        write_navigation(&mut navigation, simulator.navigation()).unwrap();
        let epochs: Vec<Epoch> = simulator.map(|epoch| epoch.rover).collect();
        let mut log = RawxWriter::default();
        let bytes: Vec<u8> = epochs.iter().flat_map(|epoch| log.frame(epoch)).collect();
        let input = |name: &str, bytes: Vec<u8>| Input::from_bytes(name.to_owned(), bytes.into());
        let inputs = RecordingInputs {
            navigation: vec![input("navigation", navigation)],
            ..RecordingInputs::of_rover(input("rover.ubx", bytes))
        };
        (inputs, epochs)
    }

    fn exported(inputs: &RecordingInputs) -> Vec<u8> {
        let recording = Recording::open(inputs).unwrap();
        let mut export = recording.export(Vec::new(), Some(Ecef::new(1.0, 2.0, 3.0))).unwrap();
        while export.step().unwrap() {}
        let counted = export.bytes();
        let (bytes, count) = export.finish().unwrap();
        assert_eq!((count, counted), (bytes.len() as u64, bytes.len() as u64));
        bytes
    }

    fn read(bytes: Vec<u8>) -> (ObservationHeader, Vec<Epoch>) {
        let mut reader = ObservationReader::new(Cursor::new(bytes)).unwrap();
        let (mut epoch, mut epochs) = (Epoch::new(GpsTime::EPOCH), Vec::new());
        while reader.read_epoch(&mut epoch).unwrap() {
            epochs.push(epoch.clone());
        }
        (reader.header().clone(), epochs)
    }

    #[test]
    fn a_receivers_log_becomes_rinex() {
        let (inputs, sent) = recorded();
        let (header, epochs) = read(exported(&inputs));
        assert_eq!(header.approximate_position, Some(Ecef::new(1.0, 2.0, 3.0)));
        assert_eq!(header.first_observation, Some(sent[0].time));
        assert_eq!(epochs.len(), EPOCHS);
        for (read, sent) in epochs.iter().zip(&sent) {
            assert_eq!(read.time, sent.time);
            assert_eq!(read.observations.len(), sent.observations.len());
        }
    }

    #[test]
    fn a_span_is_that_of_the_positions_and_nothing_complete_is_an_error() {
        let (mut inputs, sent) = recorded();
        inputs.from_s = Some(sent[1].time.seconds_of_week());
        inputs.to_s = Some(sent[3].time.seconds_of_week());
        let (header, epochs) = read(exported(&inputs));
        assert_eq!(header.first_observation, Some(sent[1].time));
        assert_eq!(epochs.len(), 3);
        let recording = Recording::open(&inputs).unwrap();
        let mut export = recording.export(Vec::new(), None).unwrap();
        export.step().unwrap();
        assert!(export.finish().is_err());
    }
}
