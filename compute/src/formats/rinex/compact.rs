//! Reads an epoch of CRINEX, Hatanaka's compact form of observation files, versions 1 (RINEX 2)
//! and 3.
//!
//! An epoch is a line with all satellites, a line for the receiver clock, and one line per
//! satellite. The module `differences` restores the complete lines.
//!
//! Source: Hatanaka (2008), *A compression format and tools for GNSS observation data*, Bulletin of
//! the Geographical Survey Institute 55.

use std::io::BufRead;

use super::columns::drop_empty;
use super::differences::{CompactState, apply_difference};
use super::epoch2;
use super::epoch3::EpochLine;
use super::fields::columns;
use super::satellites::{SATELLITES_LIMIT, SeenSatellites};
use super::{ObservationReader, RinexError, SkipReason};
use crate::gnss::{Epoch, Observation, SatelliteId};

const SATELLITES_COLUMN_2: usize = 32;
const SATELLITES_COLUMN_3: usize = 41;

/// Whether the line is a complete epoch line.
fn is_full(line: &[u8]) -> bool {
    matches!(line.first(), Some(b'&' | b'>'))
}

impl<R: BufRead> ObservationReader<R> {
    pub(super) fn read_compact_epoch(
        &mut self,
        state: &mut CompactState,
        epoch: &mut Epoch,
    ) -> Result<bool, RinexError> {
        loop {
            let Some(line) = self.lines.next()? else { return Ok(false) };
            if line.is_empty() && state.epoch_line.is_empty() {
                continue;
            }
            let Some(head) = self.compact_epoch_line(state) else {
                self.skip_compact(state)?;
                continue;
            };
            if 2 <= head.flag {
                self.read_event(head.flag, head.count, is_full)?;
                state.epoch_line.clear();
                continue;
            }
            let time = head.civil.and_then(|civil| self.gps_time(&civil));
            let (Some(time), true) = (time, head.count <= SATELLITES_LIMIT) else {
                self.skip_compact(state)?;
                continue;
            };
            epoch.time = time;
            epoch.power_failure = head.flag == 1;
            // The receiver clock is not used.
            if self.lines.next()?.is_none()
                || !self.read_compact_satellites(state, head.count, epoch)?
            {
                self.note(SkipReason::TruncatedEpoch);
                return Ok(false);
            }
            return Ok(true);
        }
    }

    /// The complete epoch line that corresponds to the line last read.
    fn compact_epoch_line(&self, state: &mut CompactState) -> Option<EpochLine> {
        let line = self.lines.current();
        let rinex2 = self.state.header.version.major == 2;
        if is_full(line) {
            state.epoch_line.clear();
            state.epoch_line.extend_from_slice(line);
            if rinex2 {
                state.epoch_line[0] = b' ';
            }
        } else if state.epoch_line.is_empty() {
            return None;
        } else {
            apply_difference(&mut state.epoch_line, line);
        }
        if rinex2 {
            epoch2::parse_epoch_line(&state.epoch_line)
        } else {
            EpochLine::parse(&state.epoch_line)
        }
    }

    /// Skips lines up to the next complete epoch line.
    fn skip_compact(&mut self, state: &mut CompactState) -> Result<(), RinexError> {
        self.note(SkipReason::BrokenDifferences);
        state.epoch_line.clear();
        while let Some(line) = self.lines.next()? {
            if is_full(line) {
                self.lines.unread();
                break;
            }
        }
        Ok(())
    }

    /// Reads one line per satellite; `false` if the file ends before.
    fn read_compact_satellites(
        &mut self,
        state: &mut CompactState,
        count: usize,
        epoch: &mut Epoch,
    ) -> Result<bool, RinexError> {
        epoch.observations.clear();
        self.seen = SeenSatellites::default();
        state.ordinal += 1;
        let rinex2 = self.state.header.version.major == 2;
        let first = if rinex2 { SATELLITES_COLUMN_2 } else { SATELLITES_COLUMN_3 };
        for index in 0..count {
            if self.lines.next()?.is_none() {
                return Ok(false);
            }
            let from = first + index * 3;
            let mut field = [b' '; 3];
            field
                .iter_mut()
                .zip(columns(&state.epoch_line, from, from + 3))
                .for_each(|(to, b)| *to = *b);
            if let Some(satellite) = self.decoded_satellite(&field) {
                self.read_compact_satellite(state, satellite, epoch);
            }
        }
        Ok(true)
    }

    fn read_compact_satellite(
        &mut self,
        state: &mut CompactState,
        satellite: SatelliteId,
        epoch: &mut Epoch,
    ) {
        let Some(table) = &self.tables[satellite.constellation.index()] else { return };
        let ordinal = state.ordinal;
        let differences = state.of(satellite, table);
        differences.ordinal = ordinal;
        let start = epoch.observations.len();
        epoch.observations.extend(table.codes.iter().map(|c| Observation::empty(satellite, *c)));
        let slots = &mut epoch.observations[start..];
        let broken = differences.advance(self.lines.current(), table, slots);
        table.hand_over(slots);
        self.state.mark_half_cycles(satellite, slots);
        drop_empty(&mut epoch.observations, start);
        for _ in 0..broken {
            self.note(SkipReason::BrokenDifferences);
        }
    }
}
