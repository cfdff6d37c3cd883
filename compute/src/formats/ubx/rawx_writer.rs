//! Writes epochs as frames of RXM-RAWX, the inverse of [`rawx`](super::rawx).

use std::collections::BTreeMap;

use crate::gnss::{Epoch, Observation, ObservationCode, SatelliteId};

use super::rawx::{
    HALF_CYCLE_RESOLVED, HEADER_BYTES, LOCK_MAX_MS, MEASUREMENT_BYTES, PHASE_VALID,
    PSEUDORANGE_VALID, numbers,
};

/// Sync characters, class and id.
const HEAD: [u8; 4] = [0xb5, 0x62, 0x02, 0x15];
/// Version of the message that has signal numbers.
const VERSION: u8 = 1;
/// Signals of one message; their number is a byte.
const SIGNALS_MAX: usize = 255;
/// Stated standard deviation of phases (0.004 cycles).
const PHASE_DEVIATION: u8 = 1;
/// Frequency number of GLONASS channel 0. Observations do not tell the channel, and the decoder
/// does not need it.
const CHANNEL_0: u8 = 7;

/// Writes the epochs of one receiver in order of time, as a u-blox F9 sends them.
#[derive(Clone, Debug, Default)]
pub struct RawxWriter {
    /// Lock times (ms).
    locks: BTreeMap<(SatelliteId, ObservationCode), u16>,
    before_ns: Option<i64>,
}

impl RawxWriter {
    /// The frame of an epoch. Signals that the message has no number for are left out, and those
    /// beyond the 255th.
    pub fn frame(&mut self, epoch: &Epoch) -> Vec<u8> {
        let before_ns = self.before_ns.replace(epoch.time.as_ns());
        let elapsed_ms = before_ns.map_or(0, |before| (epoch.time.as_ns() - before) / 1_000_000);
        let elapsed_ms = u16::try_from(elapsed_ms).unwrap_or(LOCK_MAX_MS);
        let locks = std::mem::take(&mut self.locks);
        let mut measurements = Vec::new();
        for observation in epoch.observations.iter().take(SIGNALS_MAX) {
            let Some(numbers) = numbers(observation.satellite, observation.code) else { continue };
            let signal = (observation.satellite, observation.code);
            let lock_ms = match locks.get(&signal).filter(|_| !observation.loss_of_lock) {
                Some(before) => before.saturating_add(elapsed_ms).min(LOCK_MAX_MS),
                None => 0,
            };
            self.locks.insert(signal, lock_ms);
            measurements.push(measurement(observation, numbers, lock_ms));
        }
        let payload = HEADER_BYTES + MEASUREMENT_BYTES * measurements.len();
        let mut frame = Vec::with_capacity(HEAD.len() + 2 + payload + 2);
        frame.extend(HEAD);
        frame.extend((payload as u16).to_le_bytes());
        frame.extend(epoch.time.seconds_of_week().to_le_bytes());
        frame.extend((epoch.time.week() as u16).to_le_bytes());
        // Leap seconds and receiver status: both unknown, as before the first lock.
        frame.extend([0, measurements.len() as u8, 0, VERSION, 0, 0]);
        frame.extend(measurements.iter().flatten());
        let checksum = checksum(&frame[2..]);
        frame.extend(checksum);
        frame
    }
}

fn measurement(
    observation: &Observation,
    [system, number, signal]: [u8; 3],
    lock_ms: u16,
) -> [u8; MEASUREMENT_BYTES] {
    let status = [
        (PSEUDORANGE_VALID, observation.pseudorange_m.is_some()),
        (PHASE_VALID, observation.carrier_phase.is_some()),
        (HALF_CYCLE_RESOLVED, observation.carrier_phase.is_some() && !observation.half_cycle),
    ];
    let status = status.iter().fold(0, |all, (bit, is_set)| all | if *is_set { *bit } else { 0 });
    let cn0 = observation.cn0_db_hz.map_or(0, |cn0| cn0.round().clamp(0.0, 255.0) as u8);
    let mut bytes = [0; MEASUREMENT_BYTES];
    bytes[0..8].copy_from_slice(&observation.pseudorange_m.unwrap_or(0.0).to_le_bytes());
    let phase = observation.carrier_phase.map_or(0.0, |phase| phase.0);
    bytes[8..16].copy_from_slice(&phase.to_le_bytes());
    let doppler = observation.doppler_hz.unwrap_or(0.0) as f32;
    bytes[16..20].copy_from_slice(&doppler.to_le_bytes());
    bytes[20..24].copy_from_slice(&[system, number, signal, CHANNEL_0]);
    bytes[24..26].copy_from_slice(&lock_ms.to_le_bytes());
    bytes[26..].copy_from_slice(&[cn0, 0, PHASE_DEVIATION, 0, status, 0]);
    bytes
}

/// Fletcher's checksum; u-blox interface descriptions, 3.4.
fn checksum(bytes: &[u8]) -> [u8; 2] {
    bytes.iter().fold([0_u8, 0_u8], |[a, b], byte| {
        let a = a.wrapping_add(*byte);
        [a, b.wrapping_add(a)]
    })
}

#[cfg(test)]
mod tests {
    use crate::formats::receiver::{Decoder, Event};
    use crate::simulation::{Scenario, Simulator};

    use super::*;

    /// Doppler is single precision, and C/N0 whole decibels.
    fn rounded(observation: &Observation) -> Observation {
        Observation {
            doppler_hz: observation.doppler_hz.map(|doppler| f64::from(doppler as f32)),
            cn0_db_hz: observation.cn0_db_hz.map(f64::round),
            half_cycle: observation.half_cycle && observation.carrier_phase.is_some(),
            ..*observation
        }
    }

    #[test]
    fn epochs_are_read_as_they_are_written() {
        let mut writer = RawxWriter::default();
        let mut decoder = Decoder::new(None);
        let mut losses = 0;
        for (number, simulated) in Simulator::new(Scenario::rtk_canyon(), 3).take(60).enumerate() {
            let mut events = Vec::new();
            decoder.push(&writer.frame(&simulated.rover), &mut events);
            let [Event::Epoch(read)] = &events[..] else { panic!("{events:?}") };
            assert!((read.time - simulated.rover.time).abs() < 1e-9);
            assert_eq!(read.observations.len(), simulated.rover.observations.len());
            for (read, written) in read.observations.iter().zip(&simulated.rover.observations) {
                let loss_of_lock = read.loss_of_lock;
                assert_eq!(Observation { loss_of_lock, ..rounded(written) }, *read);
                // A signal that is new has no phase before it either.
                assert!(loss_of_lock || !written.loss_of_lock);
                losses += usize::from(0 < number && loss_of_lock);
            }
        }
        assert!((1..600).contains(&losses), "{losses} losses of lock");
    }
}
