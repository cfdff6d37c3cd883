//! Navigation files: ephemerides, ionosphere coefficients, leap seconds.
//!
//! The week of an ephemeris follows from its clock reference date, not from the week field: the two
//! times are never half a week apart, and files disagree on whether the field rolls over.

mod glonass;
mod header;
mod ionosphere;
mod keplerian;
mod record;

use std::io::BufRead;

pub(super) use glonass::accuracy_index as glonass_accuracy_index;

use header::NavigationHeader;
use record::{Record, RecordLayout};

use super::fields::constellation;
use super::header_lines::first_line;
use super::lines::Lines;
use super::{RinexError, SkipReason, Skipped};
use crate::gnss::{Constellation, Ephemeris, Navigation, NavigationMessage};

/// Reads a navigation file of version 2, 3 or 4 to its end.
///
/// # Errors
/// What makes the whole file unreadable. A damaged record is skipped and noted.
///
/// # Example
/// ```
/// use graphfix_compute::formats::rinex::{read_navigation, write_navigation};
/// use graphfix_compute::simulation::{Scenario, navigation};
///
/// let broadcast = navigation(&Scenario::open_sky());
/// let mut file = Vec::new();
/// write_navigation(&mut file, &broadcast)?;
/// let (read, skipped) = read_navigation(file.as_slice())?;
/// assert_eq!((read.len(), skipped.is_empty()), (broadcast.len(), true));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn read_navigation(input: impl BufRead) -> Result<(Navigation, Skipped), RinexError> {
    read_navigation_within(input, usize::MAX)
}

/// As [`read_navigation`], for a file of others.
///
/// # Errors
/// As [`read_navigation`], and more than `most_of_satellite` ephemerides of one satellite.
pub fn read_navigation_within(
    input: impl BufRead,
    most_of_satellite: usize,
) -> Result<(Navigation, Skipped), RinexError> {
    let mut lines = Lines::new(input);
    let first = first_line(&mut lines)?;
    let mut reader = Reader {
        layout: RecordLayout::of(first, lines.number())?,
        navigation: Navigation::default(),
        skipped: Skipped::default(),
        header: NavigationHeader::new(first),
        most_of_satellite,
    };
    reader.header.read(&mut lines, &mut reader.skipped)?;
    reader.header.apply_to(&mut reader.navigation);
    if first.version.major < 4 {
        reader.read_records(&mut lines)?;
    } else {
        reader.read_typed_records(&mut lines)?;
    }
    Ok((reader.navigation, reader.skipped))
}

struct Reader {
    layout: RecordLayout,
    navigation: Navigation,
    skipped: Skipped,
    header: NavigationHeader,
    /// Most ephemerides of one satellite.
    most_of_satellite: usize,
}

impl Reader {
    /// Reads a file of version 2 or 3: one ephemeris after another.
    fn read_records<R: BufRead>(&mut self, lines: &mut Lines<R>) -> Result<(), RinexError> {
        while lines.next()?.is_some() {
            let (line, number) = (lines.current(), lines.number());
            if line.trim_ascii().is_empty() {
                continue;
            }
            let start = self.layout.parse_start(line);
            let Some(mut record) = start else {
                self.skipped.note(SkipReason::MalformedEphemeris, number);
                self.layout.skip_continuation(lines)?;
                continue;
            };
            self.layout.read_continuation(&mut record, lines)?;
            let Some(system) = constellation(record.letter) else {
                let letter = char::from(record.letter);
                self.skipped.note(SkipReason::OtherConstellation(letter), number);
                continue;
            };
            let message = legacy_message(system, &record);
            self.insert(&record, message, number)?;
        }
        Ok(())
    }

    /// Reads a file of version 4: each record follows a line with its type.
    fn read_typed_records<R: BufRead>(&mut self, lines: &mut Lines<R>) -> Result<(), RinexError> {
        while lines.next()?.is_some() {
            let (line, number) = (lines.current(), lines.number());
            let Some(title) = Title::parse(line) else {
                if !line.trim_ascii().is_empty() {
                    self.skipped.note(SkipReason::StrayLine, number);
                }
                continue;
            };
            match title.kind {
                Kind::Ephemeris => self.read_ephemeris(&title, lines)?,
                Kind::Ionosphere => self.read_ionosphere(&title, lines)?,
                Kind::Other => self.skipped.note(SkipReason::OtherMessage, number),
            }
            // Skips the rest of the record.
            while let Some(line) = lines.next()? {
                if line.first() == Some(&b'>') {
                    lines.unread();
                    break;
                }
            }
        }
        Ok(())
    }

    fn read_ephemeris<R: BufRead>(
        &mut self,
        title: &Title,
        lines: &mut Lines<R>,
    ) -> Result<(), RinexError> {
        let number = lines.number();
        let Some(system) = constellation(title.letter) else {
            let reason = SkipReason::OtherConstellation(char::from(title.letter));
            self.skipped.note(reason, number);
            return Ok(());
        };
        let Some(message) = typed_message(system, &title.message) else {
            self.skipped.note(SkipReason::OtherMessage, number);
            return Ok(());
        };
        let start = match lines.next()? {
            Some(line) if line.first() != Some(&b'>') => self.layout.parse_start(line),
            _ => {
                lines.unread();
                None
            }
        };
        let Some(mut record) = start else {
            self.skipped.note(SkipReason::MalformedEphemeris, number);
            return Ok(());
        };
        self.layout.read_continuation(&mut record, lines)?;
        self.insert(&record, message, number)
    }

    fn read_ionosphere<R: BufRead>(
        &mut self,
        title: &Title,
        lines: &mut Lines<R>,
    ) -> Result<(), RinexError> {
        let number = lines.number();
        let Some(line) = lines.next()? else { return Ok(()) };
        if line.first() == Some(&b'>') {
            lines.unread();
            self.skipped.note(SkipReason::MalformedEphemeris, number);
            return Ok(());
        }
        let mut record = self.layout.parse_undated(line);
        self.layout.read_continuation(&mut record, lines)?;
        let reason =
            match ionosphere::apply(title.letter, &title.message, &record, &mut self.navigation) {
                Ok(()) => return Ok(()),
                Err(reason) => reason,
            };
        self.skipped.note(reason, number);
        Ok(())
    }

    fn insert(
        &mut self,
        record: &Record,
        message: NavigationMessage,
        line: u64,
    ) -> Result<(), RinexError> {
        let leap = self.navigation.leap_seconds;
        let ephemeris = match message {
            NavigationMessage::Fdma => {
                glonass::ephemeris(record, self.header.version, &leap).map(Ephemeris::Glonass)
            }
            _ => keplerian::ephemeris(record, message, &leap).map(Ephemeris::Keplerian),
        };
        match ephemeris {
            Some(ephemeris) => {
                let (satellite, limit) = (ephemeris.satellite(), self.most_of_satellite);
                self.navigation.insert(ephemeris);
                if limit < self.navigation.of(satellite).len() {
                    return Err(RinexError::TooManyEphemerides { line, satellite, limit });
                }
            }
            None => self.skipped.note(SkipReason::MalformedEphemeris, line),
        }
        Ok(())
    }
}

/// The type of a version 4 record, such as `> EPH G01 LNAV`.
struct Title {
    kind: Kind,
    letter: u8,
    message: [u8; 4],
}

enum Kind {
    Ephemeris,
    Ionosphere,
    /// System time offsets and Earth orientation parameters, which are not used.
    Other,
}

impl Title {
    fn parse(line: &[u8]) -> Option<Self> {
        let rest = line.strip_prefix(b"> ")?;
        let kind = match rest.get(..3)? {
            b"EPH" => Kind::Ephemeris,
            b"ION" => Kind::Ionosphere,
            b"STO" | b"EOP" => Kind::Other,
            _ => return None,
        };
        let mut message = [b' '; 4];
        let named = rest.get(8..).unwrap_or(&[]);
        for (to, from) in message.iter_mut().zip(named) {
            *to = *from;
        }
        Some(Self { kind, letter: *rest.get(4)?, message })
    }
}

/// The message type of a version 2 or 3 record.
///
/// Galileo: RINEX 3.05, data sources: bit 8 means the clock of E5a and E1 (F/NAV), bit 9 that of
/// E5b and E1 (I/NAV). Without either the message bits decide, and I/NAV is the default.
fn legacy_message(system: Constellation, record: &Record) -> NavigationMessage {
    match system {
        Constellation::Gps | Constellation::Qzss => NavigationMessage::Lnav,
        Constellation::Glonass => NavigationMessage::Fdma,
        Constellation::BeiDou if keplerian::is_geostationary(record) => NavigationMessage::D2,
        Constellation::BeiDou => NavigationMessage::D1,
        Constellation::Galileo => {
            let sources = keplerian::galileo_data_sources(record);
            let fnav_clock = sources >> 8 & 1 == 1 && sources >> 9 & 1 == 0;
            let fnav_only = sources >> 8 & 3 == 0 && sources & 7 == 2;
            if fnav_clock || fnav_only { NavigationMessage::Fnav } else { NavigationMessage::Inav }
        }
    }
}

/// The message type in a version 4 title; RINEX 4.01.
fn typed_message(system: Constellation, name: &[u8; 4]) -> Option<NavigationMessage> {
    use Constellation as C;
    use NavigationMessage as M;
    Some(match (system, name) {
        (C::Gps | C::Qzss, b"LNAV") => M::Lnav,
        (C::Gps | C::Qzss, b"CNAV") => M::Cnav,
        (C::Gps | C::Qzss, b"CNV2") => M::Cnav2,
        (C::Galileo, b"INAV") => M::Inav,
        (C::Galileo, b"FNAV") => M::Fnav,
        (C::BeiDou, b"D1  ") => M::D1,
        (C::BeiDou, b"D2  ") => M::D2,
        (C::BeiDou, b"CNV1") => M::Cnv1,
        (C::BeiDou, b"CNV2") => M::Cnv2,
        (C::BeiDou, b"CNV3") => M::Cnv3,
        (C::Glonass, b"FDMA") => M::Fdma,
        _ => return None,
    })
}
