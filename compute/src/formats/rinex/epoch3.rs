//! Epochs of RINEX 3 and 4: a line that begins with `>`, then one line per satellite.

use std::io::BufRead;

use super::columns::{drop_empty, fill};
use super::fields::{columns, date, integer};
use super::satellites::{SATELLITES_LIMIT, SeenSatellites};
use super::{ObservationReader, RinexError, SkipReason};
use crate::gnss::{CivilTime, Epoch, Observation};

/// Width of the satellite number at the start of a line.
const SATELLITE_WIDTH: usize = 3;

/// Content of an epoch line.
pub(super) struct EpochLine {
    /// Date and time; `None` if blank or invalid, which is allowed for events only.
    pub(super) civil: Option<CivilTime>,
    pub(super) flag: u8,
    /// Number of satellites, or of special records of an event.
    pub(super) count: usize,
}

impl EpochLine {
    /// `> 2019 04 28 12 44 33.9970000  0  8`; RINEX 3.05.
    pub(super) fn parse(line: &[u8]) -> Option<Self> {
        let flag = match columns(line, 31, 32) {
            [flag @ b'0'..=b'6'] => flag - b'0',
            _ => return None,
        };
        let count = usize::try_from(integer(columns(line, 32, 35))?).ok()?;
        let fields =
            [(7, 9), (10, 12), (13, 15), (16, 18)].map(|(from, to)| columns(line, from, to));
        let civil = date(columns(line, 2, 6), fields, columns(line, 18, 29));
        Some(Self { civil, flag, count })
    }
}

fn is_epoch_line(line: &[u8]) -> bool {
    line.first() == Some(&b'>')
}

impl<R: BufRead> ObservationReader<R> {
    pub(super) fn read_epoch3(&mut self, epoch: &mut Epoch) -> Result<bool, RinexError> {
        loop {
            let Some(line) = self.lines.next()? else { return Ok(false) };
            if !is_epoch_line(line) {
                if !line.trim_ascii().is_empty() {
                    self.note(SkipReason::StrayLine);
                }
                continue;
            }
            let Some(head) = EpochLine::parse(line) else {
                self.skip_epoch3(SkipReason::MalformedEpoch)?;
                continue;
            };
            match (head.flag, head.civil.and_then(|civil| self.gps_time(&civil))) {
                (2..=5, _) => self.read_event(head.flag, head.count, is_epoch_line)?,
                (6, _) => self.skip_epoch3(SkipReason::CycleSlipRecords)?,
                (_, None) => self.skip_epoch3(SkipReason::MalformedEpoch)?,
                (flag, Some(time)) => {
                    epoch.time = time;
                    epoch.power_failure = flag == 1;
                    if self.read_satellites3(head.count, epoch)? {
                        return Ok(true);
                    }
                }
            }
        }
    }

    /// Skips the lines up to the next epoch.
    fn skip_epoch3(&mut self, reason: SkipReason) -> Result<(), RinexError> {
        self.note(reason);
        while let Some(line) = self.lines.next()? {
            if is_epoch_line(line) {
                self.lines.unread();
                break;
            }
        }
        Ok(())
    }

    /// Reads satellites up to the next epoch line; `false` if the epoch must be dropped.
    fn read_satellites3(&mut self, count: usize, epoch: &mut Epoch) -> Result<bool, RinexError> {
        if SATELLITES_LIMIT < count {
            self.skip_epoch3(SkipReason::TooManySatellites)?;
            return Ok(false);
        }
        epoch.observations.clear();
        self.seen = SeenSatellites::default();
        for _ in 0..count {
            let Some(line) = self.lines.next()? else {
                // A truncated number is left out by itself, so the rest is usable.
                self.note(SkipReason::TruncatedEpoch);
                return Ok(true);
            };
            if is_epoch_line(line) {
                self.lines.unread();
                self.note(SkipReason::WrongSatelliteCount);
                return Ok(true);
            }
            self.read_satellite3(epoch);
        }
        Ok(true)
    }

    /// Parses the current line as that of a satellite.
    fn read_satellite3(&mut self, epoch: &mut Epoch) {
        let line = self.lines.current();
        let mut field = [b' '; SATELLITE_WIDTH];
        for (to, from) in field.iter_mut().zip(line) {
            *to = *from;
        }
        let Some(satellite) = self.decoded_satellite(&field) else { return };
        let Some(table) = &self.tables[satellite.constellation.index()] else { return };
        let start = epoch.observations.len();
        epoch.observations.extend(table.codes.iter().map(|c| Observation::empty(satellite, *c)));
        let fields = columns(self.lines.current(), SATELLITE_WIDTH, usize::MAX);
        let sound = fill(&table.columns, fields, &mut epoch.observations[start..]);
        drop_empty(&mut epoch.observations, start);
        if !sound {
            self.note(SkipReason::MalformedValue);
        }
    }
}
