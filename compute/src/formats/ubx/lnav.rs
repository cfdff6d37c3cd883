//! LNAV subframes of GPS and QZSS; IS-GPS-200N, 20.3.3 to 20.3.5; IS-QZSS-PNT-005, 4.
//!
//! The receiver gives ten words of 30 bits. It has already undone the inversion of a word's data by
//! the last bit of the previous word, for the whole word.

use crate::formats::binary::{Bits, Clock, Ionosphere, Refusal};
use crate::formats::broadcast::{
    SEMICIRCLE_RAD, blank, legacy_ura_m, nearest_second, per_power, sent_legacy_delay,
};
use crate::gnss::{
    Constellation, Ephemeris, GpsTime, KeplerianEphemeris, NavigationMessage, SatelliteId,
};

use super::broadcast::{Broadcast, klobuchar, leap_seconds};

/// Bytes of a subframe without parity: ten words of 24 bits.
const DATA_BYTES: usize = 30;
/// Index of the first data bit of word 3.
const THIRD_WORD: usize = 48;
const WEEKS: i32 = 1024;
/// Satellite number of subframe 4's page with ionosphere and UTC.
const IONOSPHERE_PAGE: u64 = 56;

/// For each parity bit D25 to D30: the data bits (d1 is the most significant of 24), and whether
/// D29* (2) and D30* (1), that it sums; IS-GPS-200N, table 20-XIV.
const PARITY: [(u32, u32); 6] = [
    (0b1110_1100_0111_1100_1101_0010, 2),
    (0b0111_0110_0011_1110_0110_1001, 1),
    (0b1011_1011_0001_1111_0011_0100, 2),
    (0b0101_1101_1000_1111_1001_1010, 1),
    (0b1010_1110_1100_0111_1100_1101, 1),
    (0b0010_1101_1110_1010_0010_0111, 2),
];

/// The subframes of one satellite.
#[derive(Debug, Default)]
pub(super) struct Collector {
    /// Subframes 1 to 3, by number.
    subframes: [Option<[u8; DATA_BYTES]>; 3],
}

impl Collector {
    pub(super) fn add(
        &mut self,
        satellite: SatelliteId,
        words: &[u32; 10],
        clock: &Clock,
    ) -> Result<Broadcast, Refusal> {
        let data = data(words).ok_or(Refusal::Parity)?;
        let mut bits = Bits::starting_at(&data, 24 + 19);
        match bits.unsigned(3) {
            number @ 1..=3 => {
                self.subframes[number as usize - 1] = Some(data);
                self.ephemeris(satellite, clock)
            }
            4 => Ok(ionosphere_and_utc(satellite, &data, clock).unwrap_or_default()),
            _ => Ok(Broadcast::default()),
        }
    }

    /// The ephemeris, if the stored subframes are of one issue.
    fn ephemeris(&self, satellite: SatelliteId, clock: &Clock) -> Result<Broadcast, Refusal> {
        let [Some(first), Some(second), Some(third)] = &self.subframes else {
            return Ok(Broadcast::default());
        };
        let issue_of = |data, at| Bits::starting_at(data, at).unsigned(8);
        let issue = issue_of(second, THIRD_WORD);
        // Word 8 holds eight bits of IODC; word 10 of subframe 3 holds all of IODE.
        if issue_of(first, 7 * 24) != issue || issue_of(third, 9 * 24) != issue {
            return Ok(Broadcast::default());
        }
        let mut ephemeris = clock_part(satellite, first, clock)?;
        orbit_part(second, third, &mut ephemeris);
        Ok(Broadcast::of(Ephemeris::Keplerian(ephemeris)))
    }
}

/// The data bits of the words, joined; `None` if a word fails its parity.
fn data(words: &[u32; 10]) -> Option<[u8; DATA_BYTES]> {
    let mut data = [0; DATA_BYTES];
    // The last word of the previous subframe has zeros in D29 and D30.
    let mut before = 0;
    for (word, bytes) in words.iter().zip(data.as_chunks_mut::<3>().0) {
        let (bits, parity) = (word >> 6 & 0xff_ffff, word & 0x3f);
        let expected = PARITY.iter().fold(0, |parity, &(mask, star)| {
            let sum = (bits & mask).count_ones() + (before & star).count_ones();
            parity << 1 | sum & 1
        });
        // The receiver inverts the parity with the data.
        let sent = if before & 1 == 1 { parity ^ 0x3f } else { parity };
        if expected != sent {
            return None;
        }
        before = sent & 3;
        *bytes = [(bits >> 16) as u8, (bits >> 8) as u8, bits as u8];
    }
    Some(data)
}

/// Start of the subframe: the count in the hand-over word is that of the next subframe.
fn start(data: &[u8; DATA_BYTES]) -> f64 {
    Bits::starting_at(data, 24).scaled(17, 6.0) - 6.0
}

/// Reads subframe 1: clock.
fn clock_part(
    satellite: SatelliteId,
    data: &[u8; DATA_BYTES],
    clock: &Clock,
) -> Result<KeplerianEphemeris, Refusal> {
    let mut bits = Bits::starting_at(data, THIRD_WORD);
    let week = clock.week(bits.unsigned(10), WEEKS)?;
    bits.skip(2);
    let accuracy_m = Some(legacy_ura_m(bits.unsigned(4)));
    let health = bits.unsigned(6) as u32;
    let issue_high = bits.unsigned(2) as u32;
    // L2 P data flag and reserved bits up to word 7.
    bits.skip(24 + 24 + 24 + 16);
    let tgd = bits.signed(8);
    let issue_low = bits.unsigned(8) as u32;
    let toc_s = bits.scaled(16, 16.0);
    let transmission_time = GpsTime::from_week_seconds(week, start(data));
    let toc = nearest_second(transmission_time, toc_s, 0.0);
    Ok(KeplerianEphemeris {
        transmission_time: Some(transmission_time),
        accuracy_m,
        health,
        iodc: issue_high << 8 | issue_low,
        af2_per_s: bits.signed_scaled(8, per_power(55)),
        af1: bits.signed_scaled(16, per_power(43)),
        af0_s: bits.signed_scaled(22, per_power(31)),
        group_delays: sent_legacy_delay(satellite.constellation, tgd),
        ..blank(satellite, NavigationMessage::Lnav, toc)
    })
}

/// Reads subframes 2 and 3: orbit.
fn orbit_part(
    second: &[u8; DATA_BYTES],
    third: &[u8; DATA_BYTES],
    ephemeris: &mut KeplerianEphemeris,
) {
    let angle = per_power(31) * SEMICIRCLE_RAD;
    let rate = per_power(43) * SEMICIRCLE_RAD;
    let mut bits = Bits::starting_at(second, THIRD_WORD);
    ephemeris.iode = bits.unsigned(8) as u32;
    ephemeris.crs_m = bits.signed_scaled(16, per_power(5));
    ephemeris.delta_n_rad_s = bits.signed_scaled(16, rate);
    ephemeris.m0_rad = bits.signed_scaled(32, angle);
    ephemeris.cuc_rad = bits.signed_scaled(16, per_power(29));
    ephemeris.eccentricity = bits.scaled(32, per_power(33));
    ephemeris.cus_rad = bits.signed_scaled(16, per_power(29));
    ephemeris.sqrt_a = bits.scaled(32, per_power(19));
    ephemeris.toe = nearest_second(ephemeris.toc, bits.scaled(16, 16.0), 0.0);
    let fits_long = bits.flag();
    let shortest_h = match ephemeris.satellite.constellation {
        Constellation::Qzss => 2.0,
        _ => 4.0,
    };
    ephemeris.fit_interval_h = (!fits_long).then_some(shortest_h);
    let mut bits = Bits::starting_at(third, THIRD_WORD);
    ephemeris.cic_rad = bits.signed_scaled(16, per_power(29));
    ephemeris.omega0_rad = bits.signed_scaled(32, angle);
    ephemeris.cis_rad = bits.signed_scaled(16, per_power(29));
    ephemeris.i0_rad = bits.signed_scaled(32, angle);
    ephemeris.crc_m = bits.signed_scaled(16, per_power(5));
    ephemeris.omega_rad = bits.signed_scaled(32, angle);
    ephemeris.omega_dot_rad_s = bits.signed_scaled(24, rate);
    bits.skip(8);
    ephemeris.idot_rad_s = bits.signed_scaled(14, rate);
}

/// Reads subframe 4, page 18: Klobuchar coefficients and leap seconds.
fn ionosphere_and_utc(
    satellite: SatelliteId,
    data: &[u8; DATA_BYTES],
    clock: &Clock,
) -> Option<Broadcast> {
    let mut bits = Bits::starting_at(data, THIRD_WORD + 2);
    if bits.unsigned(6) != IONOSPHERE_PAGE {
        return None;
    }
    let coefficients = klobuchar(&mut bits);
    // A_1, A_0, t_ot and WN_t.
    bits.skip(24 + 32 + 8 + 8);
    let leap_seconds = leap_seconds(&mut bits, clock, [8, 8, 8, 8]);
    let ionosphere = coefficients.map(|coefficients| match satellite.constellation {
        Constellation::Qzss => Ionosphere::Qzss(coefficients),
        _ => Ionosphere::Gps(coefficients),
    });
    Some(Broadcast { ephemeris: None, ionosphere, leap_seconds })
}
