//! Header records of observation files, at the start of the file and in events.

use super::columns::{ColumnTable, Indicator, ScaleFactor};
use super::fields::{columns, constellation, date, decimal, integer, text};
use super::header::ObservationHeader;
use super::lines::Lines;
use super::{RinexError, RinexVersion, SkipReason, Skipped};
use crate::gnss::{Constellation, Ecef, GpsTime, LeapSeconds, Observation, SatelliteId, TimeScale};

const LABEL_COLUMN: usize = 60;
const LABEL_END: usize = 80;
/// Largest number of header lines, comments included.
const HEADER_LINES_LIMIT: u64 = 20_000;
const LABEL_VERSION: &str = "RINEX VERSION / TYPE";
const LABEL_COMPACT: &[u8] = b"CRINEX VERS   / TYPE";
const LABEL_END_OF_HEADER: &str = "END OF HEADER";
const TYPES_LABEL_2: &str = "# / TYPES OF OBSERV";
const TYPES_LABEL_3: &str = "SYS / # / OBS TYPES";

/// First line of a RINEX file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct FirstLine {
    pub(super) version: RinexVersion,
    /// Upper-case letter of the file type.
    pub(super) kind: u8,
    /// Upper-case letter of the satellite system; blank if not given.
    pub(super) system: u8,
    /// Whether the file is CRINEX.
    pub(super) compact: bool,
}

/// The label in columns 61 to 80 of a header line.
pub(super) fn label(line: &[u8]) -> &[u8] {
    columns(line, LABEL_COLUMN, LABEL_END).trim_ascii()
}

/// Reads the first line that is not blank.
pub(super) fn first_line<R: std::io::Read>(lines: &mut Lines<R>) -> Result<FirstLine, RinexError> {
    refuse_compressed(lines.peek_start()?)?;
    let mut compact = false;
    loop {
        let number = lines.number() + 1;
        let Some(line) = lines.next()? else {
            return Err(RinexError::NotRinex { line: number, found: String::new() });
        };
        if line.trim_ascii().is_empty() && number < 10 {
            continue;
        }
        let version = text(line, 0, 20);
        match label(line) {
            LABEL_COMPACT if !compact && matches!(version.as_bytes(), [b'1' | b'3', b'.', ..]) => {
                compact = true;
                lines.next()?;
                continue;
            }
            LABEL_COMPACT => {
                return Err(RinexError::UnsupportedVersion {
                    line: number,
                    format: "CRINEX",
                    version,
                });
            }
            _ => {}
        }
        if label(line) != LABEL_VERSION.as_bytes() {
            let found = String::from_utf8_lossy(&line[..line.len().min(LABEL_END)]).into_owned();
            return Err(RinexError::NotRinex { line: number, found });
        }
        let first =
            |from| columns(line, from, LABEL_COLUMN).first().map_or(b' ', u8::to_ascii_uppercase);
        let (kind, system) = (first(20), first(40));
        return match parse_version(&version) {
            Some(version @ RinexVersion { major: 2..=4, .. }) => {
                Ok(FirstLine { version, kind, system, compact })
            }
            _ => Err(RinexError::UnsupportedVersion { line: number, format: "RINEX", version }),
        };
    }
}

fn refuse_compressed(start: &[u8]) -> Result<(), RinexError> {
    let method = match start {
        [0x1f, 0x9d, ..] => "UNIX compress (.Z)",
        [0x1f, 0x8b, ..] => "gzip inside gzip",
        [b'P', b'K', 3, 4] => "zip",
        [b'B', b'Z', b'h', _] => "bzip2",
        [0xfd, b'7', b'z', b'X'] => "xz",
        [0x28, 0xb5, 0x2f, 0xfd] => "zstd",
        _ => return Ok(()),
    };
    Err(RinexError::CompressionUnsupported { method })
}

fn parse_version(text: &str) -> Option<RinexVersion> {
    let (major, minor) = text.split_once('.').unwrap_or((text, "0"));
    let minor = match minor.len() {
        1 => minor.parse::<u8>().ok()? * 10,
        2 => minor.parse().ok()?,
        _ => return None,
    };
    Some(RinexVersion::new(major.trim().parse().ok()?, minor))
}

/// The present header of an observation file, with what the columns need.
#[derive(Clone, Debug)]
pub(super) struct HeaderState {
    pub(super) header: ObservationHeader,
    /// System letter that a blank letter means.
    pub(super) default_system: u8,
    pub(super) types2: Vec<[u8; 2]>,
    types3: [Vec<[u8; 3]>; Constellation::COUNT],
    scales: Vec<ScaleFactor>,
    /// Whether L1 and L2 have half-cycle ambiguities (wavelength factor 2), by default and for
    /// single satellites; RINEX 2.11.
    pub(super) half_cycles: [bool; 2],
    pub(super) half_cycles_of: Vec<(SatelliteId, [bool; 2])>,
    /// Whether RTKLIB's convbin 2.4 made the file, and whether of RTCM 3: see
    /// [`Indicator::Convbin`].
    by_convbin: bool,
    of_rtcm3: bool,
    /// System letter of the last type record, for its continuation lines.
    types_of: u8,
    /// Stated number of types and line, by system letter.
    stated: Vec<(u8, usize, u64)>,
}

impl HeaderState {
    fn new(first: FirstLine) -> Self {
        let mut header = ObservationHeader::new(first.version);
        header.constellation = constellation(first.system);
        header.time_scale = match first.system {
            b'R' => TimeScale::Utc,
            b'E' => TimeScale::Galileo,
            b'C' => TimeScale::BeiDou,
            b'J' => TimeScale::Qzss,
            _ => TimeScale::Gps,
        };
        let default_system = if matches!(first.system, b' ' | b'M') { b'G' } else { first.system };
        Self {
            header,
            default_system,
            types2: Vec::new(),
            types3: Default::default(),
            scales: Vec::new(),
            half_cycles: [false; 2],
            half_cycles_of: Vec::new(),
            by_convbin: false,
            of_rtcm3: false,
            types_of: b' ',
            stated: Vec::new(),
        }
    }

    /// Reads the header to its end; `first` is its first line.
    pub(super) fn read<R: std::io::Read>(
        first: FirstLine,
        lines: &mut Lines<R>,
        skipped: &mut Skipped,
    ) -> Result<Self, RinexError> {
        if first.kind != b'O' {
            return Err(RinexError::WrongKind {
                line: lines.number(),
                found: format!("{:?}", char::from(first.kind)),
                expected: "observation",
            });
        }
        let mut state = Self::new(first);
        loop {
            let number = lines.number() + 1;
            if HEADER_LINES_LIMIT < number {
                return Err(state.invalid(number, LABEL_END_OF_HEADER, "is not found"));
            }
            let Some(line) = lines.next()? else {
                return Err(RinexError::Truncated { line: number - 1 });
            };
            if label(line) == LABEL_END_OF_HEADER.as_bytes() {
                state.check(number, skipped)?;
                return Ok(state);
            }
            if state.apply(line, number).is_none() {
                skipped.note(SkipReason::MalformedHeaderRecord, number);
            }
        }
    }

    fn invalid(&self, line: u64, label: &'static str, reason: &str) -> RinexError {
        RinexError::HeaderInvalid { line, label, reason: reason.to_owned() }
    }

    /// Checks the records that define the columns.
    pub(super) fn check(&self, line: u64, skipped: &mut Skipped) -> Result<(), RinexError> {
        let rinex2 = self.header.version.major == 2;
        let label = if rinex2 { TYPES_LABEL_2 } else { TYPES_LABEL_3 };
        if self.stated.is_empty() {
            return Err(self.invalid(line, label, "is missing"));
        }
        for &(letter, stated, at) in &self.stated {
            let listed = match constellation(letter) {
                _ if rinex2 => self.types2.len(),
                Some(constellation) => self.types3[constellation.index()].len(),
                None => continue,
            };
            if stated == listed {
                continue;
            }
            skipped.note(SkipReason::MalformedHeaderRecord, at);
            if rinex2 && stated.div_ceil(5) != listed.div_ceil(5) {
                let reason = format!("{stated} types are stated, {listed} listed");
                return Err(self.invalid(at, label, &reason));
            }
        }
        Ok(())
    }

    /// Column tables by constellation; `None` where no types are declared.
    pub(super) fn tables(&mut self) -> [Option<ColumnTable>; Constellation::COUNT] {
        let tables = Constellation::ALL.map(|c| {
            if self.header.version.major == 2 {
                return Some(ColumnTable::of_rinex2(c, &self.types2));
            }
            let types = &self.types3[c.index()];
            let table = ColumnTable::of_rinex3(c, self.header.version, types, &self.scales);
            (!types.is_empty()).then_some(table)
        });
        let indicator = match self.by_convbin && self.of_rtcm3 {
            true => Indicator::Convbin,
            false => Indicator::Rinex,
        };
        let tables = tables.map(|table| table.map(|table| table.with_indicator(indicator)));
        for (codes, table) in self.header.codes.iter_mut().zip(&tables) {
            *codes = table.as_ref().map_or_else(Vec::new, |t| t.codes.clone());
        }
        tables
    }

    /// Applies one record; `None` if it is malformed. Unknown labels are skipped.
    pub(super) fn apply(&mut self, line: &[u8], number: u64) -> Option<()> {
        let header = &mut self.header;
        match label(line) {
            b"PGM / RUN BY / DATE" => self.by_convbin = line.starts_with(b"CONVBIN 2.4."),
            b"COMMENT" => self.of_rtcm3 |= text(line, 0, 60) == "format: RTCM 3",
            b"MARKER NAME" => header.marker = text(line, 0, 60),
            b"REC # / TYPE / VERS" => header.receiver = text(line, 20, 40),
            b"ANT # / TYPE" => header.antenna = text(line, 20, 40),
            b"APPROX POSITION XYZ" => {
                let [x, y, z] = three_numbers(line)?;
                header.approximate_position = ([x, y, z] != [0.0; 3]).then(|| Ecef::new(x, y, z));
            }
            b"ANTENNA: DELTA H/E/N" => header.antenna_delta_hen_m = three_numbers(line)?,
            b"INTERVAL" => header.interval_s = decimal(columns(line, 0, 10))?.filter(|s| 0.0 < *s),
            b"TIME OF FIRST OBS" => self.first_observation(line)?,
            b"LEAP SECONDS" => header.leap_seconds = leap_seconds(line, header.constellation)?,
            b"GLONASS SLOT / FRQ #" => self.glonass_channels(line)?,
            b"# / TYPES OF OBSERV" => self.types_of_rinex2(line, number)?,
            b"SYS / # / OBS TYPES" => self.types_of_rinex3(line, number)?,
            b"SYS / SCALE FACTOR" => self.scale_factor(line)?,
            b"WAVELENGTH FACT L1/2" => self.wavelength_factor(line)?,
            _ => {}
        }
        Some(())
    }

    /// Clears the declared types before the header records of an event.
    pub(super) fn begin_event(&mut self) {
        self.stated.clear();
    }

    /// Whether records since [`HeaderState::begin_event`] declared types.
    pub(super) fn types_changed(&self) -> bool {
        !self.stated.is_empty()
    }

    /// The part of the header that defines the meaning of the columns.
    pub(super) fn layout(&self) -> impl PartialEq + use<'_> {
        let Self { header, types2, types3, scales, half_cycles, half_cycles_of, .. } = self;
        (header.time_scale, types2, types3, scales, half_cycles, half_cycles_of)
    }

    /// The error for a layout that changes inside the file.
    pub(super) fn changed_inside(&self, line: u64) -> RinexError {
        let reason = "it changes inside the stream: end the stream, begin another with this header";
        let rinex2 = self.header.version.major == 2;
        self.invalid(line, if rinex2 { TYPES_LABEL_2 } else { TYPES_LABEL_3 }, reason)
    }

    fn first_observation(&mut self, line: &[u8]) -> Option<()> {
        let scale = match columns(line, 48, 51).trim_ascii() {
            b"" => self.header.time_scale,
            b"GPS" | b"IRN" => TimeScale::Gps,
            b"GLO" | b"UTC" => TimeScale::Utc,
            b"GAL" => TimeScale::Galileo,
            b"BDT" | b"BDS" => TimeScale::BeiDou,
            b"QZS" => TimeScale::Qzss,
            _ => return None,
        };
        self.header.time_scale = scale;
        let fields =
            [(6, 12), (12, 18), (18, 24), (24, 30)].map(|(from, to)| columns(line, from, to));
        let civil = date(columns(line, 0, 6), fields, columns(line, 30, 43))?;
        let leap = self.leap_seconds();
        self.header.first_observation = Some(GpsTime::from_civil(&civil, scale, &leap)?);
        Some(())
    }

    /// Leap seconds for tags in UTC.
    pub(super) fn leap_seconds(&self) -> LeapSeconds {
        self.header.leap_seconds.map_or(LeapSeconds::table(), LeapSeconds::with_broadcast)
    }

    fn glonass_channels(&mut self, line: &[u8]) -> Option<()> {
        for entry in columns(line, 4, LABEL_COLUMN).chunks(7) {
            if entry.trim_ascii().is_empty() {
                continue;
            }
            let slot = u8::try_from(integer(columns(entry, 1, 3))?).ok()?;
            let channel = i8::try_from(integer(columns(entry, 3, 7))?).ok()?;
            if entry[0] != b'R' || !(-7..=13).contains(&channel) {
                return None;
            }
            self.header.glonass_channels.insert(slot, channel);
        }
        Some(())
    }

    fn types_of_rinex2(&mut self, line: &[u8], number: u64) -> Option<()> {
        if !columns(line, 0, 6).trim_ascii().is_empty() {
            let stated = usize::try_from(integer(columns(line, 0, 6))?).ok()?;
            self.types2.clear();
            self.stated = vec![(b' ', stated, number)];
        }
        for kind in columns(line, 6, LABEL_COLUMN).chunks(6) {
            match *kind.trim_ascii() {
                [] => {}
                [letter, band] => self.types2.push([letter, band]),
                // The column of an unknown type still counts.
                _ => self.types2.push(*b"??"),
            }
        }
        Some(())
    }

    fn types_of_rinex3(&mut self, line: &[u8], number: u64) -> Option<()> {
        let letter = *line.first()?;
        if letter != b' ' {
            let stated = usize::try_from(integer(columns(line, 3, 6))?).ok()?;
            self.types_of = letter;
            if let Some(constellation) = constellation(letter) {
                self.types3[constellation.index()].clear();
            }
            self.stated.push((letter, stated, number));
        }
        let Some(constellation) = constellation(self.types_of) else { return Some(()) };
        self.types3[constellation.index()].extend(types_in(columns(line, 6, LABEL_COLUMN)));
        Some(())
    }

    fn scale_factor(&mut self, line: &[u8]) -> Option<()> {
        let types: Vec<_> = types_in(columns(line, 10, LABEL_COLUMN)).collect();
        let letter = *line.first()?;
        if letter == b' ' {
            self.scales.last_mut()?.types.extend(types);
            return Some(());
        }
        let divisor = integer(columns(line, 2, 6)).filter(|f| 0 < *f)? as f64;
        if let Some(constellation) = constellation(letter) {
            self.scales.push(ScaleFactor { constellation, divisor, types });
        }
        Some(())
    }

    /// Marks carrier phases with wavelength factor 2; bit 1 of the indicator then means the
    /// opposite of the factor (RINEX 2.11).
    pub(super) fn mark_half_cycles(&self, satellite: SatelliteId, slots: &mut [Observation]) {
        let single = self.half_cycles_of.iter().rev().find(|(s, _)| *s == satellite);
        let [first, second] = single.map_or(self.half_cycles, |(_, factors)| *factors);
        if !first && !second {
            return;
        }
        for slot in slots.iter_mut().filter(|slot| slot.carrier_phase.is_some()) {
            slot.half_cycle ^= match slot.code.band_digit() {
                1 => first,
                2 => second,
                _ => false,
            };
        }
    }

    fn wavelength_factor(&mut self, line: &[u8]) -> Option<()> {
        let factor = |from| match integer(columns(line, from, from + 6)) {
            Some(0 | 1) | None => Some(false),
            Some(2) => Some(true),
            Some(_) => None,
        };
        let factors = [factor(0)?, factor(6)?];
        let count = integer(columns(line, 12, 18)).unwrap_or(0);
        if count == 0 {
            self.half_cycles = factors;
            return Some(());
        }
        for index in 0..usize::try_from(count.clamp(0, 7)).expect("clamped") {
            let field = columns(line, 21 + index * 6, 24 + index * 6);
            let (letter, number) = super::fields::satellite(field, self.default_system)?;
            let satellite = constellation(letter).and_then(|c| SatelliteId::new(c, number));
            self.half_cycles_of.extend(satellite.map(|s| (s, factors)));
        }
        Some(())
    }
}

fn types_in(fields: &[u8]) -> impl Iterator<Item = [u8; 3]> {
    fields.chunks(4).map(|field| field.trim_ascii()).filter(|kind| !kind.is_empty()).map(|kind| {
        let mut padded = [b' '; 3];
        for (to, from) in padded.iter_mut().zip(kind) {
            *to = *from;
        }
        padded
    })
}

/// Parses three numbers of fourteen columns, or separated by blanks if a writer used other columns.
fn three_numbers(line: &[u8]) -> Option<[f64; 3]> {
    let number = |from| decimal(columns(line, from, from + 14)).map(|value| value.unwrap_or(0.0));
    let in_columns = || Some([number(0)?, number(14)?, number(28)?]);
    let between_blanks = || {
        let fields = columns(line, 0, LABEL_COLUMN).split(u8::is_ascii_whitespace);
        let mut numbers = fields.filter(|field| !field.is_empty()).map(|field| decimal(field)?);
        let three = [numbers.next()??, numbers.next()??, numbers.next()??];
        numbers.next().is_none().then_some(three)
    };
    in_columns().or_else(between_blanks)
}

/// GPS time minus UTC (s) of a `LEAP SECONDS` record; `Some(None)` if it is blank.
///
/// A count relative to BeiDou time is 14 s smaller (RINEX 3.05, field "time system identifier").
/// Some BeiDou files lack the identifier. GPS − UTC was 14 s when BeiDou time began, so a smaller
/// count in such a file is relative to BeiDou time.
pub(super) fn leap_seconds(line: &[u8], file: Option<Constellation>) -> Option<Option<i64>> {
    let count = match columns(line, 0, 6).trim_ascii() {
        b"" => return Some(None),
        field => integer(field)?,
    };
    let beidou = match columns(line, 24, 27).trim_ascii() {
        b"BDS" | b"BDT" => true,
        _ => file == Some(Constellation::BeiDou),
    };
    Some(match count {
        0 => None,
        1..14 if beidou => Some(count + 14),
        1..100 => Some(count),
        _ => return None,
    })
}
