//! Epochs of RINEX 2: a line with date and satellites, then lines of five fields per satellite.

use std::io::BufRead;

use super::columns::{drop_empty, fill};
use super::epoch3::EpochLine;
use super::fields::{columns, date, integer, satellite};
use super::satellites::{SATELLITES_LIMIT, SeenSatellites};
use super::{ObservationReader, RinexError, SkipReason};
use crate::gnss::{Epoch, Observation, SatelliteId};

const FIELDS_PER_LINE: usize = 5;
const SATELLITES_PER_LINE: usize = 12;
const SATELLITES_COLUMN: usize = 32;
const LINE_COLUMNS: usize = 80;

/// ` 18 01 01 00 00 00.0000000  0  9G05G16…`; RINEX 2.11.
///
/// No mark distinguishes an epoch line from data, so every column must be valid.
pub(super) fn parse_epoch_line(line: &[u8]) -> Option<EpochLine> {
    let flag = match columns(line, 26, 29) {
        [b' ', b' ', flag @ b'0'..=b'6'] => flag - b'0',
        [b' ', b' ', b' '] => 0,
        _ => return None,
    };
    let count = usize::try_from(integer(columns(line, 29, 32))?).ok()?;
    let date_columns = columns(line, 0, 26);
    if [0, 3, 6, 9, 12, 15].iter().any(|blank| date_columns[*blank] != b' ') {
        return None;
    }
    let fields = [(4, 6), (7, 9), (10, 12), (13, 15)].map(|(from, to)| columns(line, from, to));
    let civil = date(columns(line, 1, 3), fields, columns(line, 15, 26));
    let undated = date_columns.iter().all(|b| *b == b' ');
    (civil.is_some() || (undated && 2 <= flag)).then_some(EpochLine { civil, flag, count })
}

fn is_epoch_line(line: &[u8]) -> bool {
    parse_epoch_line(line).is_some_and(|head| {
        let listed = columns(line, SATELLITES_COLUMN, SATELLITES_COLUMN + 3);
        head.flag < 2 && satellite(listed, b'G').is_some()
    })
}

/// How the lines of a satellite ended.
enum Record {
    Whole,
    /// The next epoch came before the last line.
    Short,
    /// The file ended before the last line.
    Cut,
}

impl<R: BufRead> ObservationReader<R> {
    pub(super) fn read_epoch2(&mut self, epoch: &mut Epoch) -> Result<bool, RinexError> {
        loop {
            let Some(line) = self.lines.next()? else { return Ok(false) };
            let Some(head) = parse_epoch_line(line) else {
                if !line.trim_ascii().is_empty() {
                    self.skip_to_epoch2()?;
                }
                continue;
            };
            if (2..=5).contains(&head.flag) {
                self.read_event(head.flag, head.count, is_epoch_line)?;
                continue;
            }
            let Some(time) = head.civil.and_then(|civil| self.gps_time(&civil)) else {
                self.skip_to_epoch2()?;
                continue;
            };
            epoch.time = time;
            epoch.power_failure = head.flag == 1;
            if !self.read_satellite_list(head.count)? {
                continue;
            }
            if head.flag == 6 {
                self.skip_cycle_slips2()?;
                continue;
            }
            if !self.read_satellites2(epoch)? {
                continue;
            }
            return Ok(true);
        }
    }

    /// Skips lines up to one with the form of an epoch line.
    fn skip_to_epoch2(&mut self) -> Result<(), RinexError> {
        self.note(SkipReason::MalformedEpoch);
        while let Some(line) = self.lines.next()? {
            if parse_epoch_line(line).is_some() {
                self.lines.unread();
                break;
            }
        }
        Ok(())
    }

    /// Reads the satellites of an epoch from its line and the continuation lines.
    fn read_satellite_list(&mut self, count: usize) -> Result<bool, RinexError> {
        self.satellites.clear();
        self.seen = SeenSatellites::default();
        if SATELLITES_LIMIT < count {
            self.note(SkipReason::TooManySatellites);
            return Ok(false);
        }
        for index in 0..count {
            let column = index % SATELLITES_PER_LINE;
            if column == 0 && index != 0 && self.lines.next()?.is_none() {
                self.note(SkipReason::TruncatedEpoch);
                return Ok(false);
            }
            let from = SATELLITES_COLUMN + column * 3;
            let field = columns(self.lines.current(), from, from + 3);
            let Ok(field) = <[u8; 3]>::try_from(field) else {
                self.note(SkipReason::WrongSatelliteCount);
                self.note(SkipReason::MalformedEpoch);
                return Ok(false);
            };
            let satellite = self.decoded_satellite(&field);
            self.satellites.push(satellite);
        }
        Ok(true)
    }

    /// Skips records of repaired cycle slips, which have the form of observations.
    fn skip_cycle_slips2(&mut self) -> Result<(), RinexError> {
        self.note(SkipReason::CycleSlipRecords);
        let lines_each = self.state.types2.len().div_ceil(FIELDS_PER_LINE);
        for _ in 0..self.satellites.len() * lines_each {
            match self.lines.next()? {
                Some(line) if is_epoch_line(line) => {
                    self.lines.unread();
                    break;
                }
                Some(_) => {}
                None => break,
            }
        }
        Ok(())
    }

    /// Reads the lines of all listed satellites; `false` if the epoch must be dropped.
    fn read_satellites2(&mut self, epoch: &mut Epoch) -> Result<bool, RinexError> {
        epoch.observations.clear();
        for index in 0..self.satellites.len() {
            let start = epoch.observations.len();
            match self.read_satellite2(self.satellites[index], epoch)? {
                Record::Whole => {}
                // A line is missing: numbers may be assigned to the wrong satellite.
                Record::Short => return Ok(false),
                Record::Cut => {
                    epoch.observations.truncate(start);
                    return Ok(0 < start);
                }
            }
        }
        Ok(true)
    }

    fn read_satellite2(
        &mut self,
        satellite: Option<SatelliteId>,
        epoch: &mut Epoch,
    ) -> Result<Record, RinexError> {
        let start = epoch.observations.len();
        let table = satellite.and_then(|s| self.tables[s.constellation.index()].as_ref());
        if let (Some(satellite), Some(table)) = (satellite, table) {
            epoch
                .observations
                .extend(table.codes.iter().map(|c| Observation::empty(satellite, *c)));
        }
        let mut sound = true;
        for first in (0..self.state.types2.len()).step_by(FIELDS_PER_LINE) {
            let Some(line) = self.lines.next()? else {
                self.skipped.note(SkipReason::TruncatedEpoch, self.lines.number());
                return Ok(Record::Cut);
            };
            if is_epoch_line(line) {
                self.lines.unread();
                self.skipped.note(SkipReason::WrongSatelliteCount, self.lines.number());
                return Ok(Record::Short);
            }
            if let Some(table) = table {
                let last = (first + FIELDS_PER_LINE).min(table.columns.len());
                let fields = columns(line, 0, LINE_COLUMNS);
                sound &=
                    fill(&table.columns[first..last], fields, &mut epoch.observations[start..]);
            }
        }
        if let Some(table) = table {
            table.hand_over(&mut epoch.observations[start..]);
        }
        if let Some(satellite) = satellite {
            self.state.mark_half_cycles(satellite, &mut epoch.observations[start..]);
        }
        drop_empty(&mut epoch.observations, start);
        if !sound {
            self.note(SkipReason::MalformedValue);
        }
        Ok(Record::Whole)
    }
}
