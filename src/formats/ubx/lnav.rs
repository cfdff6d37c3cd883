//! LNAV subframes of GPS and QZSS; IS-GPS-200N, 20.3.3 to 20.3.5; IS-QZSS-PNT-005, 4.
//!
//! The receiver gives ten words of 30 bits; where the last bit of the word before inverts a word's
//! data, it has inverted the whole word back.

use crate::formats::binary::{Bits, Clock, Ionosphere, Refusal};
use crate::formats::broadcast::{
    SEMICIRCLE_RAD, blank, legacy_delay, legacy_ura_m, nearest_second, per_power,
};
use crate::gnss::{
    Constellation, Ephemeris, GpsTime, KeplerianEphemeris, NavigationMessage, SatelliteId,
};

use super::broadcast::{Broadcast, klobuchar, leap_seconds};

/// Data of a subframe without parity: ten words of 24 bits.
const DATA_BYTES: usize = 30;
/// First bit of the third word's data.
const THIRD_WORD: usize = 48;
const WEEKS: i32 = 1024;
/// Subframe 4's page with ionosphere and UTC, by its satellite number.
const IONOSPHERE_PAGE: u64 = 56;

/// Which data bits (d1 the most significant of 24) and which of D29* (2) and D30* (1) each of the
/// parity bits D25 to D30 sums; IS-GPS-200N, table 20-XIV.
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
    /// Subframes 1 to 3.
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

    /// The ephemeris, where the subframes held are of one issue.
    fn ephemeris(&self, satellite: SatelliteId, clock: &Clock) -> Result<Broadcast, Refusal> {
        let [Some(first), Some(second), Some(third)] = &self.subframes else {
            return Ok(Broadcast::default());
        };
        let issue_of = |data, at| Bits::starting_at(data, at).unsigned(8);
        let issue = issue_of(second, THIRD_WORD);
        // Of IODC eight bits stand in word 8, of IODE of subframe 3 all in word 10.
        if issue_of(first, 7 * 24) != issue || issue_of(third, 9 * 24) != issue {
            return Ok(Broadcast::default());
        }
        let mut ephemeris = clock_part(satellite, first, clock)?;
        orbit_part(second, third, &mut ephemeris);
        Ok(Broadcast::of(Ephemeris::Keplerian(ephemeris)))
    }
}

/// The words' data bits one behind the other; `None` if one fails its parity.
fn data(words: &[u32; 10]) -> Option<[u8; DATA_BYTES]> {
    let mut data = [0; DATA_BYTES];
    // The last word before has zeros in D29 and D30.
    let mut before = 0;
    for (word, bytes) in words.iter().zip(data.as_chunks_mut::<3>().0) {
        let (bits, parity) = (word >> 6 & 0xff_ffff, word & 0x3f);
        let expected = PARITY.iter().fold(0, |parity, &(mask, star)| {
            let sum = (bits & mask).count_ones() + (before & star).count_ones();
            parity << 1 | sum & 1
        });
        // The receiver inverts parity with the data.
        let sent = if before & 1 == 1 { parity ^ 0x3f } else { parity };
        if expected != sent {
            return None;
        }
        before = sent & 3;
        *bytes = [(bits >> 16) as u8, (bits >> 8) as u8, bits as u8];
    }
    Some(data)
}

/// The start of the subframe: the count in the hand-over word is that of the next one.
fn start(data: &[u8; DATA_BYTES]) -> f64 {
    Bits::starting_at(data, 24).scaled(17, 6.0) - 6.0
}

/// Subframe 1.
fn clock_part(
    satellite: SatelliteId,
    data: &[u8; DATA_BYTES],
    clock: &Clock,
) -> Result<KeplerianEphemeris, Refusal> {
    let mut bits = Bits::starting_at(data, THIRD_WORD);
    let week = clock.week(bits.unsigned(10), WEEKS)?;
    bits.skip(2);
    let accuracy_m = legacy_ura_m(bits.unsigned(4));
    let health = bits.unsigned(6) as u32;
    let issue_high = bits.unsigned(2) as u32;
    // L2 P data flag and reserved bits up to word 7.
    bits.skip(24 + 24 + 24 + 16);
    let tgd_s = bits.signed_scaled(8, per_power(31));
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
        group_delays: legacy_delay(tgd_s),
        ..blank(satellite, NavigationMessage::Lnav, toc)
    })
}

/// Subframes 2 and 3.
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

/// Subframe 4, page 18: Klobuchar's coefficients and leap seconds.
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
    // A_1, A_0, t_ot, WN_t.
    bits.skip(24 + 32 + 8 + 8);
    let leap_seconds = leap_seconds(&mut bits, clock, [8, 8, 8, 8]);
    let ionosphere = coefficients.map(|coefficients| match satellite.constellation {
        Constellation::Qzss => Ionosphere::Qzss(coefficients),
        _ => Ionosphere::Gps(coefficients),
    });
    Some(Broadcast { ephemeris: None, ionosphere, leap_seconds })
}
