//! I/NAV pages of Galileo, on E1-B and E5b-I; Galileo OS SIS ICD 2.1, 4.3.2 to 4.3.5.
//!
//! The receiver gives the even and the odd half of a page, four words each.

use crate::formats::binary::{Bits, Clock, Ionosphere, Refusal, crc24q};
use crate::formats::broadcast::{SEMICIRCLE_RAD, blank, nearest_second, per_power, sisa_m};
use crate::gnss::constants::GALILEO_FIRST_WEEK;
use crate::gnss::{
    Ephemeris, GpsTime, GroupDelays, KeplerianEphemeris, NavigationMessage, NeQuickCoefficients,
    SatelliteId,
};

use super::broadcast::{Broadcast, leap_seconds};

/// Bits of an even half page without its tail, and of the odd half covered by the CRC.
const EVEN_BITS: usize = 114;
const ODD_BITS: usize = 82;
const HALF_BYTES: usize = 16;
/// Data of a page: 112 bits of the even half and 16 of the odd one.
const DATA_BYTES: usize = 16;
const WEEKS: i32 = 4096;
const WORD_TYPE_BITS: usize = 6;
const ISSUE_BITS: u32 = 10;

/// The words of one satellite.
#[derive(Debug, Default)]
pub(super) struct Collector {
    /// Words 1 to 5, by number.
    words: [Option<[u8; DATA_BYTES]>; 5],
}

impl Collector {
    pub(super) fn add(
        &mut self,
        satellite: SatelliteId,
        words: &[u32; 8],
        clock: &Clock,
    ) -> Result<Broadcast, Refusal> {
        let Some(data) = data(words)? else { return Ok(Broadcast::default()) };
        let mut bits = Bits::new(&data);
        match bits.unsigned(WORD_TYPE_BITS as u32) {
            number @ 1..=5 => {
                self.words[number as usize - 1] = Some(data);
                let ephemeris = self.ephemeris(satellite, clock)?;
                let ionosphere = (number == 5).then(|| ionosphere(&data)).flatten();
                Ok(Broadcast { ephemeris, ionosphere, leap_seconds: None })
            }
            6 => {
                // A_0 and A_1; t_0t and WN_0t follow Δt_LS.
                bits.skip(32 + 24);
                let leap_seconds = utc(&mut bits, clock);
                Ok(Broadcast { leap_seconds, ..Broadcast::default() })
            }
            _ => Ok(Broadcast::default()),
        }
    }

    /// The ephemeris, if words 1 to 4 are of one issue and word 5 is present.
    fn ephemeris(
        &self,
        satellite: SatelliteId,
        clock: &Clock,
    ) -> Result<Option<Ephemeris>, Refusal> {
        let [Some(first), Some(second), Some(third), Some(fourth), Some(fifth)] = &self.words
        else {
            return Ok(None);
        };
        let issue_of =
            |data: &[u8; DATA_BYTES]| Bits::starting_at(data, WORD_TYPE_BITS).unsigned(ISSUE_BITS);
        let issue = issue_of(first);
        if [second, third, fourth].iter().any(|data| issue_of(data) != issue) {
            return Ok(None);
        }
        let sender = Bits::starting_at(fourth, 16).unsigned(6);
        if sender != u64::from(satellite.number) {
            return Err(Refusal::ImplausibleEphemeris);
        }
        let transmission_time = transmission_time(fifth, clock);
        let mut ephemeris = clock_part(satellite, fourth, transmission_time);
        ephemeris.iode = issue as u32;
        ephemeris.iodc = issue as u32;
        orbit_part(first, second, third, &mut ephemeris);
        status_part(fifth, &mut ephemeris);
        Ok(Some(Ephemeris::Keplerian(ephemeris)))
    }
}

/// The data of a page; `None` for an alert page.
fn data(words: &[u32; 8]) -> Result<Option<[u8; DATA_BYTES]>, Refusal> {
    let mut bytes = [0; 2 * HALF_BYTES];
    for (to, word) in bytes.as_chunks_mut::<4>().0.iter_mut().zip(words) {
        *to = word.to_be_bytes();
    }
    let (even, odd) = bytes.split_at(HALF_BYTES);
    if 0x40 & (even[0] | odd[0]) != 0 {
        return Ok(None);
    }
    if even[0] & 0x80 != 0 || odd[0] & 0x80 == 0 {
        return Err(Refusal::Parity);
    }
    // Leading zeros do not change the CRC, so the bits are aligned to their end.
    let mut covered = [0; (EVEN_BITS + ODD_BITS).div_ceil(8)];
    let unused = covered.len() * 8 - EVEN_BITS - ODD_BITS;
    copy_bits(even, 0, &mut covered, unused, EVEN_BITS);
    copy_bits(odd, 0, &mut covered, unused + EVEN_BITS, ODD_BITS);
    let crc = Bits::starting_at(odd, ODD_BITS).unsigned(24);
    if u64::from(crc24q(&covered)) != crc {
        return Err(Refusal::Parity);
    }
    let mut data = [0; DATA_BYTES];
    copy_bits(even, 2, &mut data, 0, 112);
    copy_bits(odd, 2, &mut data, 112, 16);
    Ok(Some(data))
}

fn copy_bits(from: &[u8], start: usize, to: &mut [u8], first_bit: usize, count: usize) {
    let mut bits = Bits::starting_at(from, start);
    for index in first_bit..first_bit + count {
        if bits.flag() {
            to[index / 8] |= 0x80 >> (index % 8);
        }
    }
}

/// Reads word 4: clock.
fn clock_part(
    satellite: SatelliteId,
    fourth: &[u8; DATA_BYTES],
    transmission_time: GpsTime,
) -> KeplerianEphemeris {
    let mut bits = Bits::starting_at(fourth, 22);
    let cic_rad = bits.signed_scaled(16, per_power(29));
    let cis_rad = bits.signed_scaled(16, per_power(29));
    let toc = nearest_second(transmission_time, bits.scaled(14, 60.0), 0.0);
    KeplerianEphemeris {
        transmission_time: Some(transmission_time),
        cic_rad,
        cis_rad,
        af0_s: bits.signed_scaled(31, per_power(34)),
        af1: bits.signed_scaled(21, per_power(46)),
        af2_per_s: bits.signed_scaled(6, per_power(59)),
        ..blank(satellite, NavigationMessage::Inav, toc)
    }
}

/// Reads words 1 to 3: orbit.
fn orbit_part(
    first: &[u8; DATA_BYTES],
    second: &[u8; DATA_BYTES],
    third: &[u8; DATA_BYTES],
    ephemeris: &mut KeplerianEphemeris,
) {
    let angle = per_power(31) * SEMICIRCLE_RAD;
    let rate = per_power(43) * SEMICIRCLE_RAD;
    let mut bits = Bits::starting_at(first, 16);
    ephemeris.toe = nearest_second(ephemeris.toc, bits.scaled(14, 60.0), 0.0);
    ephemeris.m0_rad = bits.signed_scaled(32, angle);
    ephemeris.eccentricity = bits.scaled(32, per_power(33));
    ephemeris.sqrt_a = bits.scaled(32, per_power(19));
    let mut bits = Bits::starting_at(second, 16);
    ephemeris.omega0_rad = bits.signed_scaled(32, angle);
    ephemeris.i0_rad = bits.signed_scaled(32, angle);
    ephemeris.omega_rad = bits.signed_scaled(32, angle);
    ephemeris.idot_rad_s = bits.signed_scaled(14, rate);
    let mut bits = Bits::starting_at(third, 16);
    ephemeris.omega_dot_rad_s = bits.signed_scaled(24, rate);
    ephemeris.delta_n_rad_s = bits.signed_scaled(16, rate);
    ephemeris.cuc_rad = bits.signed_scaled(16, per_power(29));
    ephemeris.cus_rad = bits.signed_scaled(16, per_power(29));
    ephemeris.crc_m = bits.signed_scaled(16, per_power(5));
    ephemeris.crs_m = bits.signed_scaled(16, per_power(5));
    ephemeris.accuracy_m = Some(sisa_m(bits.unsigned(8)));
}

/// Reads group delays and health from word 5. The health word is that of RINEX: data validity, then
/// signal health, of E1-B from bit 0 and of E5b from bit 6.
fn status_part(fifth: &[u8; DATA_BYTES], ephemeris: &mut KeplerianEphemeris) {
    let mut bits = Bits::starting_at(fifth, 47);
    ephemeris.group_delays = GroupDelays::Galileo {
        bgd_e5a_s: bits.signed_scaled(10, per_power(32)),
        bgd_e5b_s: Some(bits.signed_scaled(10, per_power(32))),
    };
    let (e5b, e1b) = (bits.unsigned(2) as u32, bits.unsigned(2) as u32);
    let (e5b_validity, e1b_validity) = (bits.unsigned(1) as u32, bits.unsigned(1) as u32);
    ephemeris.health = e1b_validity | e1b << 1 | e5b_validity << 6 | e5b << 7;
}

/// Week and second of word 5. The week count is unique until 2078, so no clock is needed.
fn transmission_time(fifth: &[u8; DATA_BYTES], clock: &Clock) -> GpsTime {
    let mut bits = Bits::starting_at(fifth, 73);
    let week = bits.unsigned(12) as i32 + GALILEO_FIRST_WEEK;
    let week = clock.week(week as u64, WEEKS).unwrap_or(week);
    GpsTime::from_week_seconds(week, bits.scaled(20, 1.0))
}

/// The coefficients of word 5; `None` if all are zero, which means that none are broadcast.
fn ionosphere(fifth: &[u8; DATA_BYTES]) -> Option<Ionosphere> {
    let mut bits = Bits::starting_at(fifth, WORD_TYPE_BITS);
    let ai = [
        bits.scaled(11, per_power(2)),
        bits.signed_scaled(11, per_power(8)),
        bits.signed_scaled(14, per_power(15)),
    ];
    (ai != [0.0; 3]).then_some(Ionosphere::Galileo(NeQuickCoefficients { ai }))
}

/// Leap seconds of word 6 from Δt_LS on; the reference time lies between the values.
fn utc(bits: &mut Bits<'_>, clock: &Clock) -> Option<i64> {
    // The fields, joined: Δt_LS, then WN_LSF, DN and Δt_LSF.
    let before = bits.unsigned(8);
    bits.skip(8 + 8);
    let rest = bits.unsigned(8 + 3 + 8);
    let joined = (before << 19 | rest) << 5;
    let bytes = (joined as u32).to_be_bytes();
    leap_seconds(&mut Bits::new(&bytes), clock, [8, 8, 3, 8])
}
