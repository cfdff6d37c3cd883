//! The reader of observation files: its state, and what reading an epoch of any version needs.

use std::io::BufRead;

use super::columns::ColumnTable;
use super::differences::CompactState;
use super::header::ObservationHeader;
use super::header_lines::{HeaderState, first_line};
use super::lines::Lines;
use super::satellites::SeenSatellites;
use super::{RinexError, SkipReason, Skipped};
use crate::gnss::{CivilTime, Constellation, GpsTime, LeapSeconds, SatelliteId};

/// Reads epochs of observations one at a time.
#[derive(Clone, Debug)]
pub struct ObservationReader<R> {
    pub(super) lines: Lines<R>,
    pub(super) state: HeaderState,
    pub(super) tables: [Option<ColumnTable>; Constellation::COUNT],
    pub(super) skipped: Skipped,
    pub(super) seen: SeenSatellites,
    /// Satellites of the current epoch; `None` for skipped ones (RINEX 2).
    pub(super) satellites: Vec<Option<SatelliteId>>,
    /// The values that the differences of a CRINEX file refer to.
    pub(super) compact: Option<CompactState>,
    leap_seconds: LeapSeconds,
}

impl<R: BufRead> ObservationReader<R> {
    /// A reader after the header of `input`.
    pub fn new(input: R) -> Result<Self, RinexError> {
        let mut lines = Lines::new(input);
        let mut skipped = Skipped::default();
        let first = first_line(&mut lines)?;
        let mut state = HeaderState::read(first, &mut lines, &mut skipped)?;
        let tables = state.tables();
        let leap_seconds = state.leap_seconds();
        let mut reader = Self {
            lines,
            state,
            tables,
            skipped,
            seen: SeenSatellites::default(),
            satellites: Vec::new(),
            compact: first.compact.then(CompactState::default),
            leap_seconds,
        };
        reader.note_unknown_types();
        Ok(reader)
    }

    /// The header, with the changes of events read so far.
    pub const fn header(&self) -> &ObservationHeader {
        &self.state.header
    }

    /// What was left out so far.
    pub const fn skipped(&self) -> &Skipped {
        &self.skipped
    }

    /// Whether the file is CRINEX.
    pub(super) const fn is_compact(&self) -> bool {
        self.compact.is_some()
    }

    pub(super) fn note(&mut self, reason: SkipReason) {
        self.skipped.note(reason, self.lines.number());
    }

    pub(super) fn gps_time(&self, civil: &CivilTime) -> Option<GpsTime> {
        GpsTime::from_civil(civil, self.state.header.time_scale, &self.leap_seconds)
    }

    /// Applies the header records of an event; they end early where `is_epoch` accepts a line.
    pub(super) fn read_event(
        &mut self,
        flag: u8,
        records: usize,
        is_epoch: impl Fn(&[u8]) -> bool,
    ) -> Result<(), RinexError> {
        self.note(SkipReason::Event(flag));
        self.state.begin_event();
        for _ in 0..records {
            let number = self.lines.number() + 1;
            let Some(line) = self.lines.next()? else {
                self.note(SkipReason::TruncatedEpoch);
                break;
            };
            if is_epoch(line) {
                self.lines.unread();
                self.note(SkipReason::WrongSatelliteCount);
                break;
            }
            if self.state.apply(line, number).is_none() {
                self.skipped.note(SkipReason::MalformedHeaderRecord, number);
            }
        }
        if self.state.types_changed() {
            self.state.check(self.lines.number(), &mut self.skipped)?;
        }
        self.tables = self.state.tables();
        self.leap_seconds = self.state.leap_seconds();
        if self.state.types_changed() {
            self.note_unknown_types();
        }
        Ok(())
    }

    fn note_unknown_types(&mut self) {
        let rinex2 = self.state.header.version.major == 2;
        let count = |c: Constellation, table: &Option<ColumnTable>| match table {
            // A RINEX 2 list applies to all systems, so each system lacks some of its types.
            Some(table) if !rinex2 || c == Constellation::Gps => table.unknown_types,
            _ => 0,
        };
        let unknown: usize =
            Constellation::ALL.iter().zip(&self.tables).map(|(c, table)| count(*c, table)).sum();
        for _ in 0..unknown {
            self.note(SkipReason::UnknownObservationType);
        }
    }

    /// The satellite of a field; `None` if it is skipped, which is noted.
    pub(super) fn decoded_satellite(&mut self, field: &[u8]) -> Option<SatelliteId> {
        let Some((letter, number)) = super::fields::satellite(field, self.state.default_system)
        else {
            self.note(SkipReason::MalformedSatellite);
            return None;
        };
        let Some(constellation) = super::fields::constellation(letter) else {
            self.note(SkipReason::OtherConstellation(char::from(letter)));
            return None;
        };
        let satellite = SatelliteId::new(constellation, number)?;
        if self.tables[constellation.index()].is_none() {
            self.note(SkipReason::UndeclaredConstellation);
            return None;
        }
        if !self.seen.insert(satellite) {
            self.note(SkipReason::DuplicateSatellite);
            return None;
        }
        Some(satellite)
    }
}
