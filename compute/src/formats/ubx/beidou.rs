//! D1 and D2 subframes of BeiDou on B1I, B2I and B3I; BDS-SIS-ICD-B1I-3.0, 5.
//!
//! The receiver gives ten deinterleaved words of 30 bits. Neither message has an issue that
//! connects its parts; their times (seconds of week) do.

use crate::formats::binary::{Bits, Clock, Ionosphere, Refusal};
use crate::formats::broadcast::{SEMICIRCLE_RAD, blank, legacy_ura_m, nearest_second, per_power};
use crate::gnss::constants::{BEIDOU_FIRST_WEEK, BEIDOU_LAG_S};
use crate::gnss::{
    Ephemeris, GpsTime, GroupDelays, KeplerianEphemeris, NavigationMessage, SatelliteId,
};

use super::broadcast::{Broadcast, klobuchar};

/// Bytes of a subframe without parity: 26 bits of the first word, 22 of each other word.
const DATA_BYTES: usize = 28;
/// Bits of preamble and reserved field.
const BEFORE_NUMBER: usize = 15;
/// Bits before the data: preamble, reserved field, subframe number and second of week.
const AFTER_SECOND: usize = 38;
/// Bits before the data of a D2 page: also the page number.
const AFTER_PAGE: usize = 42;
/// Interval between subframes of D1 and between pages of D2 (s).
const D1_STEP_S: u64 = 6;
const D2_STEP_S: u64 = 3;
const PAGES: usize = 10;
const WEEKS: i32 = 8192;
/// x⁴ + x + 1, which generates BCH(15, 11, 1).
const BCH: u32 = 0b1_0011;

type Data = [u8; DATA_BYTES];

/// The subframes, or the pages of subframe 1, of one satellite.
#[derive(Debug, Default)]
pub(super) struct Collector {
    parts: [Option<Data>; PAGES],
}

impl Collector {
    pub(super) fn add(
        &mut self,
        satellite: SatelliteId,
        words: &[u32; 10],
        clock: &Clock,
    ) -> Result<Broadcast, Refusal> {
        let data = data(words).ok_or(Refusal::Parity)?;
        let number = Bits::starting_at(&data, BEFORE_NUMBER).unsigned(3) as usize;
        if satellite.is_beidou_geo() {
            let page = Bits::starting_at(&data, AFTER_SECOND).unsigned(4) as usize;
            if number != 1 || !(1..=PAGES).contains(&page) {
                return Ok(Broadcast::default());
            }
            self.parts[page - 1] = Some(data);
            return Ok(self.of_d2(satellite, clock));
        }
        if !(1..=3).contains(&number) {
            return Ok(Broadcast::default());
        }
        self.parts[number - 1] = Some(data);
        Ok(self.of_d1(satellite, clock))
    }

    /// The parts from the first on, if they were sent consecutively.
    fn consecutive<const N: usize>(&self, step_s: u64) -> Option<[Data; N]> {
        let first = self.parts[0].as_ref()?;
        let mut joined = [*first; N];
        for (index, to) in joined.iter_mut().enumerate() {
            let part = self.parts[index].as_ref()?;
            *to = *part;
            if second(part) != second(first) + index as u64 * step_s {
                return None;
            }
        }
        Some(joined)
    }

    fn of_d1(&self, satellite: SatelliteId, clock: &Clock) -> Broadcast {
        let Some([first, second, third]) = self.consecutive(D1_STEP_S) else {
            return Broadcast::default();
        };
        let mut bits = Bits::starting_at(&first, AFTER_SECOND);
        let mut ephemeris = status(satellite, NavigationMessage::D1, &mut bits);
        dated(&mut ephemeris, &first, &mut bits, clock);
        let ionosphere = klobuchar(&mut bits).map(Ionosphere::BeiDou);
        ephemeris.af2_per_s = af2_per_s(&mut bits);
        ephemeris.af0_s = bits.signed_scaled(24, per_power(33));
        ephemeris.af1 = bits.signed_scaled(22, per_power(50));
        ephemeris.iode = bits.unsigned(5) as u32;
        let mut bits = Joined::new([(&second, AFTER_SECOND, 186), (&third, AFTER_SECOND, 185)]);
        let mut bits = bits.bits();
        ephemeris.delta_n_rad_s = bits.signed_scaled(16, rate());
        ephemeris.cuc_rad = bits.signed_scaled(18, per_power(31));
        ephemeris.m0_rad = bits.signed_scaled(32, angle());
        ephemeris.eccentricity = bits.scaled(32, per_power(33));
        ephemeris.cus_rad = bits.signed_scaled(18, per_power(31));
        ephemeris.crc_m = bits.signed_scaled(18, per_power(6));
        ephemeris.crs_m = bits.signed_scaled(18, per_power(6));
        ephemeris.sqrt_a = bits.scaled(32, per_power(19));
        ephemeris.toe = nearest_second(ephemeris.toc, bits.scaled(17, 8.0), BEIDOU_LAG_S);
        ephemeris.i0_rad = bits.signed_scaled(32, angle());
        ephemeris.cic_rad = bits.signed_scaled(18, per_power(31));
        ephemeris.omega_dot_rad_s = bits.signed_scaled(24, rate());
        ephemeris.cis_rad = bits.signed_scaled(18, per_power(31));
        ephemeris.idot_rad_s = bits.signed_scaled(14, rate());
        ephemeris.omega0_rad = bits.signed_scaled(32, angle());
        ephemeris.omega_rad = bits.signed_scaled(32, angle());
        let ephemeris = Some(Ephemeris::Keplerian(ephemeris));
        Broadcast { ephemeris, ionosphere, leap_seconds: None }
    }

    /// Figures 5-18-1 to 5-18-10; pages 3 to 10 form one sequence.
    fn of_d2(&self, satellite: SatelliteId, clock: &Clock) -> Broadcast {
        let Some(pages) = self.consecutive::<PAGES>(D2_STEP_S) else {
            return Broadcast::default();
        };
        let mut bits = Bits::starting_at(&pages[0], AFTER_PAGE);
        let mut ephemeris = status(satellite, NavigationMessage::D2, &mut bits);
        dated(&mut ephemeris, &pages[0], &mut bits, clock);
        let mut bits = Bits::starting_at(&pages[1], AFTER_PAGE + 6);
        let ionosphere = klobuchar(&mut bits).map(Ionosphere::BeiDou);
        let mut bits = Joined::new([
            (&pages[2], AFTER_PAGE + 38, 28),
            (&pages[3], AFTER_PAGE, 64),
            (&pages[4], AFTER_PAGE, 64),
            (&pages[5], AFTER_PAGE, 64),
            (&pages[6], AFTER_PAGE, 64),
            (&pages[7], AFTER_PAGE, 66),
            (&pages[8], AFTER_PAGE, 64),
            (&pages[9], AFTER_PAGE, 19),
        ]);
        let mut bits = bits.bits();
        ephemeris.af0_s = bits.signed_scaled(24, per_power(33));
        ephemeris.af1 = bits.signed_scaled(22, per_power(50));
        ephemeris.af2_per_s = af2_per_s(&mut bits);
        ephemeris.iode = bits.unsigned(5) as u32;
        ephemeris.delta_n_rad_s = bits.signed_scaled(16, rate());
        ephemeris.cuc_rad = bits.signed_scaled(18, per_power(31));
        ephemeris.m0_rad = bits.signed_scaled(32, angle());
        ephemeris.cus_rad = bits.signed_scaled(18, per_power(31));
        ephemeris.eccentricity = bits.scaled(32, per_power(33));
        ephemeris.sqrt_a = bits.scaled(32, per_power(19));
        ephemeris.cic_rad = bits.signed_scaled(18, per_power(31));
        ephemeris.cis_rad = bits.signed_scaled(18, per_power(31));
        ephemeris.toe = nearest_second(ephemeris.toc, bits.scaled(17, 8.0), BEIDOU_LAG_S);
        ephemeris.i0_rad = bits.signed_scaled(32, angle());
        ephemeris.crc_m = bits.signed_scaled(18, per_power(6));
        ephemeris.crs_m = bits.signed_scaled(18, per_power(6));
        ephemeris.omega_dot_rad_s = bits.signed_scaled(24, rate());
        ephemeris.omega0_rad = bits.signed_scaled(32, angle());
        ephemeris.omega_rad = bits.signed_scaled(32, angle());
        ephemeris.idot_rad_s = bits.signed_scaled(14, rate());
        let ephemeris = Some(Ephemeris::Keplerian(ephemeris));
        Broadcast { ephemeris, ionosphere, leap_seconds: None }
    }
}

/// The data bits of the words, joined; `None` if a word fails its parity.
fn data(words: &[u32; 10]) -> Option<Data> {
    let mut joined = [0; DATA_BYTES];
    let mut bit = 0;
    let mut push = |bits: u32, count: usize| {
        for shift in (0..count).rev() {
            joined[bit / 8] |= ((bits >> shift & 1) as u8) << (7 - bit % 8);
            bit += 1;
        }
    };
    for (index, word) in words.iter().enumerate() {
        let word = word & 0x3fff_ffff;
        if index == 0 {
            // The first 15 bits of a subframe have no code.
            if !is_codeword(word & 0x7fff) {
                return None;
            }
            push(word >> 4, 26);
        } else {
            // Two code words, deinterleaved: data of both, then parity of both.
            let first = word >> 15 & 0x7ff0 | word >> 4 & 0xf;
            let second = word >> 4 & 0x7ff0 | word & 0xf;
            if !is_codeword(first) || !is_codeword(second) {
                return None;
            }
            push(word >> 8, 22);
        }
    }
    Some(joined)
}

/// Whether the 15 bits are a code word of BCH(15, 11, 1).
fn is_codeword(word: u32) -> bool {
    let remainder = (4..15)
        .rev()
        .fold(word, |left, bit| if left >> bit & 1 == 1 { left ^ BCH << (bit - 4) } else { left });
    remainder == 0
}

/// Second of the BeiDou week at the start of a subframe.
fn second(data: &Data) -> u64 {
    Bits::starting_at(data, BEFORE_NUMBER + 3).unsigned(20)
}

fn angle() -> f64 {
    per_power(31) * SEMICIRCLE_RAD
}

fn rate() -> f64 {
    per_power(43) * SEMICIRCLE_RAD
}

/// Reads a_f2, in units of 2⁻⁶⁶.
fn af2_per_s(bits: &mut Bits<'_>) -> f64 {
    bits.signed(11) as f64 * (per_power(33) * per_power(33))
}

/// Reads health, age of clock and accuracy.
fn status(
    satellite: SatelliteId,
    message: NavigationMessage,
    bits: &mut Bits<'_>,
) -> KeplerianEphemeris {
    let health = bits.unsigned(1) as u32;
    let iodc = bits.unsigned(5) as u32;
    let accuracy_m = Some(legacy_ura_m(bits.unsigned(4)));
    KeplerianEphemeris { health, iodc, accuracy_m, ..blank(satellite, message, GpsTime::EPOCH) }
}

/// Reads week, toc and group delays. The week count is unique until 2163, so no clock is needed.
fn dated(ephemeris: &mut KeplerianEphemeris, first: &Data, bits: &mut Bits<'_>, clock: &Clock) {
    let week = bits.unsigned(13) as i32 + BEIDOU_FIRST_WEEK;
    let week = clock.week(week as u64, WEEKS).unwrap_or(week);
    let began = GpsTime::from_week_seconds(week, second(first) as f64) + BEIDOU_LAG_S;
    ephemeris.transmission_time = Some(began);
    ephemeris.toc = nearest_second(began, bits.scaled(17, 8.0), BEIDOU_LAG_S);
    ephemeris.group_delays = GroupDelays::BeiDou {
        tgd1_s: bits.signed_scaled(10, 1e-10),
        tgd2_s: bits.signed_scaled(10, 1e-10),
    };
}

/// A bit reader for fields that continue in the next part.
struct Joined {
    bytes: [u8; 64],
}

impl Joined {
    /// Joins a number of bits from a position of each part.
    fn new<const N: usize>(parts: [(&Data, usize, usize); N]) -> Self {
        let mut bytes = [0; 64];
        let mut bit = 0;
        for (data, at, count) in parts {
            let mut bits = Bits::starting_at(data, at);
            for _ in 0..count {
                bytes[bit / 8] |= u8::from(bits.flag()) << (7 - bit % 8);
                bit += 1;
            }
        }
        Self { bytes }
    }

    fn bits(&mut self) -> Bits<'_> {
        Bits::new(&self.bytes)
    }
}
