//! GLONASS strings; GLONASS ICD 5.1, 4.4 to 4.7.
//!
//! The receiver gives the 85 bits of a string from bit 85 on, and a fourth word with the numbers of
//! superframe and frame.

use nalgebra::Vector3;

use crate::formats::binary::{Bits, Clock, Refusal};
use crate::formats::broadcast::{GLONASS_ACCURACY_M, GLONASS_UNITS, per_power};
use crate::gnss::{Ephemeris, GlonassEphemeris, SatelliteId};

use super::broadcast::Broadcast;

const STRING_BYTES: usize = 12;
const STRING_BITS: usize = 85;
/// Number of check bits at the end of a string.
const CHECK_BITS: usize = 8;
/// Bits of the idle bit and the string number.
const AFTER_NUMBER: usize = 5;
/// Units of t_k (s): hours, minutes and half minutes.
const FRAME_TIME_UNITS_S: [u64; 3] = [3600, 60, 30];

type Strings = [u8; STRING_BYTES];

/// The strings of one satellite.
#[derive(Debug, Default)]
pub(super) struct Collector {
    /// Superframe and frame of the strings.
    frame: u32,
    /// Strings 1 to 4, by number.
    strings: [Option<Strings>; 4],
}

impl Collector {
    pub(super) fn add(
        &mut self,
        satellite: SatelliteId,
        channel: i8,
        words: &[u32; 4],
        clock: &Clock,
    ) -> Result<Broadcast, Refusal> {
        let mut string = [0; STRING_BYTES];
        for (to, word) in string.as_chunks_mut::<4>().0.iter_mut().zip(words) {
            *to = word.to_be_bytes();
        }
        if !is_sound(&string) {
            return Err(Refusal::Parity);
        }
        if words[3] != self.frame {
            *self = Self { frame: words[3], strings: [None; 4] };
        }
        let number = Bits::starting_at(&string, 1).unsigned(4) as usize;
        if !(1..=4).contains(&number) {
            return Ok(Broadcast::default());
        }
        self.strings[number - 1] = Some(string);
        let [Some(first), Some(second), Some(third), Some(fourth)] = &self.strings else {
            return Ok(Broadcast::default());
        };
        let ephemeris = ephemeris(satellite, channel, [first, second, third, fourth], clock)?;
        Ok(Broadcast::of(Ephemeris::Glonass(ephemeris)))
    }
}

/// Whether the Hamming code is valid. Bits 9 to 85 have the numbers 3, 5, 6, 7, 9, …, without the
/// powers of two; check bit i is the sum of those whose number has bit i; the eighth sums all.
fn is_sound(string: &Strings) -> bool {
    let bit = |number: usize| {
        let index = STRING_BITS - number;
        string[index / 8] >> (7 - index % 8) & 1 == 1
    };
    let mut sum = 0_usize;
    let mut parity = false;
    let numbers = (1_usize..).filter(|coded| !coded.is_power_of_two());
    for (number, coded) in (CHECK_BITS + 1..=STRING_BITS).zip(numbers) {
        if bit(number) {
            sum ^= coded;
            parity = !parity;
        }
    }
    for check in 0..CHECK_BITS - 1 {
        if bit(check + 1) {
            sum ^= 1 << check;
            parity = !parity;
        }
    }
    sum == 0 && parity == bit(CHECK_BITS)
}

fn ephemeris(
    satellite: SatelliteId,
    channel: i8,
    strings: [&Strings; 4],
    clock: &Clock,
) -> Result<GlonassEphemeris, Refusal> {
    let [mut first, mut second, mut third, mut fourth] =
        strings.map(|string| Bits::starting_at(string, AFTER_NUMBER));
    first.skip(2 + 2);
    let frame_time_s: u64 =
        [5, 6, 1].into_iter().zip(FRAME_TIME_UNITS_S).map(|(w, s)| first.unsigned(w) * s).sum();
    let is_unhealthy = second.unsigned(3) & 4 != 0;
    second.skip(1);
    let tb_s = second.unsigned(7) * 900;
    second.skip(5);
    third.skip(1);
    let gamma = third.sign_magnitude(11) as f64 * per_power(40);
    third.skip(1 + 2);
    let is_malfunctioning = third.flag();
    let axes = [&mut first, &mut second, &mut third].map(axis);
    let vector = |order: usize| Vector3::from(axes.map(|axis| axis[order]));
    let tau_s = fourth.sign_magnitude(22) as f64 * per_power(30);
    let delta_tau_s = fourth.sign_magnitude(5) as f64 * per_power(30);
    let age_days = fourth.unsigned(5) as u8;
    fourth.skip(14 + 1);
    let accuracy = fourth.unsigned(4) as usize;
    fourth.skip(3 + 11 + 5);
    let is_modern = fourth.unsigned(2) == 1;
    Ok(GlonassEphemeris {
        satellite,
        toe: clock.of_glonass_day(tb_s * 1000, None)?,
        transmission_time: clock.of_glonass_day(frame_time_s * 1000, None).ok(),
        position_m: vector(0),
        velocity_m_s: vector(1),
        acceleration_m_s2: vector(2),
        clock_bias_s: -tau_s,
        gamma,
        delta_tau_s: Some(delta_tau_s),
        channel,
        health: u32::from(is_unhealthy) | u32::from(is_malfunctioning) << 1,
        accuracy_m: GLONASS_ACCURACY_M.get(accuracy).copied().filter(|_| is_modern),
        age_days,
    })
}

/// Reads position, velocity and acceleration of one axis, the last fields of strings 1 to 3.
fn axis(bits: &mut Bits<'_>) -> [f64; 3] {
    let velocity = bits.sign_magnitude(24) as f64 * GLONASS_UNITS[1];
    let acceleration = bits.sign_magnitude(5) as f64 * GLONASS_UNITS[2];
    let position = bits.sign_magnitude(27) as f64 * GLONASS_UNITS[0];
    [position, velocity, acceleration]
}
