//! Observations of the older messages: 1002 and 1004 of GPS, 1010 and 1012 of GLONASS;
//! RTCM 10403.3, 3.5.1 and 3.5.6.

use crate::formats::binary::{Bits, Clock, Refusal};
use crate::gnss::constants::{LIGHT_MILLISECOND_M, SPEED_OF_LIGHT};
use crate::gnss::{Constellation, Cycles, Observation, ObservationCode, SatelliteId, Signal};

use super::ephemeris::GlonassChannels;
use super::lock::{LockTable, LockTime};
use super::{Notes, ObservationMessage};

const RANGE_UNIT_M: f64 = 0.02;
const PHASE_UNIT_M: f64 = 0.0005;
const CN0_UNIT_DB_HZ: f64 = 0.25;
/// Roll-over of the difference of phase and range (cycles); DF012.
const ROLLOVER_CYCLES: f64 = 1500.0;
/// Smallest value of the 20-bit phase difference: no phase (DF012).
const NO_PHASE: i64 = -(1 << 19);
/// Smallest value of the 14-bit range difference: no range (DF017).
const NO_RANGE: i64 = -(1 << 13);
/// Largest number of satellites, with two bands each.
const SATELLITES: usize = 64;
const BANDS: usize = 2;
/// Satellite numbers of SBAS in GPS messages (DF009).
const SBAS: std::ops::RangeInclusive<u64> = 40..=58;

/// The last message of each signal.
#[derive(Debug)]
pub(super) struct LegacyState {
    locks: LockTable,
    /// Phase minus range (cycles), without roll-overs.
    differences: Vec<Option<f64>>,
}

impl LegacyState {
    pub(super) fn new() -> Self {
        let signals = 2 * SATELLITES * BANDS;
        Self { locks: LockTable::default(), differences: vec![None; signals] }
    }

    /// Decodes 1002 and 1004, the latter with L2.
    pub(super) fn decode_gps(
        &mut self,
        mut bits: Bits<'_>,
        has_l2: bool,
        clock: &Clock,
        notes: Notes<'_>,
    ) -> Result<ObservationMessage, Refusal> {
        let station = bits.unsigned(12) as u16;
        let time = clock.of_week(bits.unsigned(30));
        let (more, satellites) = tail(&mut bits);
        let mut records = Vec::with_capacity(satellites);
        for _ in 0..satellites {
            let number = bits.unsigned(6);
            let l1 = First::read(&mut bits, &FirstLayout::GPS, |_| None);
            let l2 = has_l2.then(|| Second::read(&mut bits, [b"2X", b"2P", b"2D", b"2W"]));
            let satellite = match SBAS.contains(&number) {
                true => Err(Refusal::OtherConstellation),
                false => super::satellite(Constellation::Gps, number),
            };
            records.push(Record { satellite, channel: None, l1, l2 });
        }
        bits.require_sound()?;
        let time = time?;
        let observations = self.observe(records, time, notes);
        Ok(ObservationMessage { station, time, more, is_msm: false, observations })
    }

    /// Decodes 1010 and 1012, the latter with L2.
    pub(super) fn decode_glonass(
        &mut self,
        mut bits: Bits<'_>,
        has_l2: bool,
        clock: &Clock,
        channels: &mut GlonassChannels,
        notes: Notes<'_>,
    ) -> Result<ObservationMessage, Refusal> {
        let station = bits.unsigned(12) as u16;
        let time = clock.of_glonass_day(bits.unsigned(27), None);
        let (more, satellites) = tail(&mut bits);
        let mut records = Vec::with_capacity(satellites);
        for _ in 0..satellites {
            let number = bits.unsigned(6);
            let channel = |bits: &mut Bits<'_>| Some(bits.unsigned(5) as i8 - 7);
            let l1 = First::read(&mut bits, &FirstLayout::GLONASS, channel);
            let l2 = has_l2.then(|| Second::read(&mut bits, [b"2C", b"2P", b"2C", b"2P"]));
            let satellite = super::satellite(Constellation::Glonass, number);
            records.push(Record { satellite, channel: l1.channel, l1, l2 });
        }
        bits.require_sound()?;
        let time = time?;
        for record in &records {
            if let (Ok(satellite), Some(-7..=6)) = (record.satellite, record.channel) {
                channels[usize::from(satellite.number)] = record.channel;
            }
        }
        let observations = self.observe(records, time, notes);
        Ok(ObservationMessage { station, time, more, is_msm: false, observations })
    }

    fn observe(
        &mut self,
        records: Vec<Record>,
        time: crate::gnss::GpsTime,
        notes: Notes<'_>,
    ) -> Vec<Observation> {
        let mut observations = Vec::with_capacity(2 * records.len());
        for Record { satellite, channel, l1, l2 } in records {
            let satellite = match satellite {
                Ok(satellite) => satellite,
                Err(refusal) => {
                    notes(refusal);
                    continue;
                }
            };
            let second = l2.map(|l2| l2.relative_to(&l1));
            for (band, part) in [Some(l1.part), second].into_iter().flatten().enumerate() {
                let hz = Signal::of(satellite, part.code).frequency_hz(channel);
                if hz.is_none() {
                    notes(Refusal::UnknownChannel);
                }
                let mut observation = Observation {
                    pseudorange_m: part.range_m,
                    carrier_phase: hz.and_then(|hz| self.phase(satellite, band, &part, hz)),
                    cn0_db_hz: (part.cn0 != 0).then_some(part.cn0 as f64 * CN0_UNIT_DB_HZ),
                    ..Observation::empty(satellite, part.code)
                };
                if observation.carrier_phase.is_some() {
                    let lock = LockTime::of_legacy(part.lock);
                    let index = signal_index(satellite, band);
                    observation.loss_of_lock = self.locks.is_lost(index, time, lock);
                }
                if !observation.is_empty() {
                    observations.push(observation);
                }
            }
        }
        observations
    }

    /// The phase: range plus difference, continuous across roll-overs.
    fn phase(
        &mut self,
        satellite: SatelliteId,
        band: usize,
        part: &Part,
        frequency_hz: f64,
    ) -> Option<Cycles> {
        let per_metre = frequency_hz / SPEED_OF_LIGHT;
        let given = part.difference_m? * per_metre;
        let last = &mut self.differences[signal_index(satellite, band)];
        let turns = last.map_or(0.0, |last| ((last - given) / ROLLOVER_CYCLES).round());
        let difference = given + turns * ROLLOVER_CYCLES;
        *last = Some(difference);
        Some(Cycles(part.reference_m * per_metre + difference))
    }
}

fn signal_index(satellite: SatelliteId, band: usize) -> usize {
    let system = usize::from(satellite.constellation == Constellation::Glonass);
    (system * SATELLITES + usize::from(satellite.number) % SATELLITES) * BANDS + band
}

/// Whether more messages of the epoch follow, and the number of satellites in this one.
fn tail(bits: &mut Bits<'_>) -> (bool, usize) {
    let more = bits.flag();
    let satellites = bits.unsigned(5) as usize;
    // Smoothing indicator and interval.
    bits.skip(1 + 3);
    (more, satellites)
}

/// One satellite of a message.
struct Record {
    satellite: Result<SatelliteId, Refusal>,
    channel: Option<i8>,
    l1: First,
    l2: Option<Second>,
}

/// One signal, with its references resolved.
struct Part {
    code: ObservationCode,
    range_m: Option<f64>,
    /// The L1 pseudorange, to which the phases of both bands refer (m).
    reference_m: f64,
    /// Phase minus that pseudorange (m).
    difference_m: Option<f64>,
    lock: u64,
    cn0: u64,
}

/// How a constellation encodes the pseudorange of L1: modulo a length, and the number of those.
struct FirstLayout {
    /// Observation codes by the indicator of the code.
    codes: [&'static [u8; 2]; 2],
    /// Bits of the pseudorange modulo `whole_m`, and of the number of `whole_m`.
    range_bits: u32,
    whole_bits: u32,
    whole_m: f64,
}

impl FirstLayout {
    /// 1002 and 1004.
    const GPS: Self =
        Self { codes: [b"1C", b"1P"], range_bits: 24, whole_bits: 8, whole_m: LIGHT_MILLISECOND_M };
    /// 1010 and 1012.
    const GLONASS: Self = Self {
        codes: [b"1C", b"1P"],
        range_bits: 25,
        whole_bits: 7,
        whole_m: 2.0 * LIGHT_MILLISECOND_M,
    };
}

/// Fields of L1: pseudorange, phase difference, lock and C/N0.
struct First {
    part: Part,
    channel: Option<i8>,
}

impl First {
    fn read(
        bits: &mut Bits<'_>,
        layout: &FirstLayout,
        channel: impl Fn(&mut Bits<'_>) -> Option<i8>,
    ) -> Self {
        let FirstLayout { codes, range_bits, whole_bits, whole_m } = *layout;
        let code = code(codes[bits.unsigned(1) as usize]);
        let channel = channel(bits);
        let fraction_m = bits.scaled(range_bits, RANGE_UNIT_M);
        let difference = bits.signed(20);
        let lock = bits.unsigned(7);
        let range_m = fraction_m + bits.scaled(whole_bits, whole_m);
        let part = Part {
            code,
            range_m: Some(range_m),
            reference_m: range_m,
            difference_m: (difference != NO_PHASE).then_some(difference as f64 * PHASE_UNIT_M),
            lock,
            cn0: bits.unsigned(8),
        };
        Self { part, channel }
    }
}

/// Fields of L2, which refer to the L1 pseudorange.
struct Second {
    code: ObservationCode,
    range_difference: i64,
    phase_difference: i64,
    lock: u64,
    cn0: u64,
}

impl Second {
    fn read(bits: &mut Bits<'_>, codes: [&[u8; 2]; 4]) -> Self {
        Self {
            code: code(codes[bits.unsigned(2) as usize]),
            range_difference: bits.signed(14),
            phase_difference: bits.signed(20),
            lock: bits.unsigned(7),
            cn0: bits.unsigned(8),
        }
    }

    fn relative_to(self, l1: &First) -> Part {
        let reference_m = l1.part.reference_m;
        let range = (self.range_difference != NO_RANGE).then_some(self.range_difference as f64);
        let phase = (self.phase_difference != NO_PHASE).then_some(self.phase_difference as f64);
        Part {
            code: self.code,
            range_m: range.map(|units| reference_m + units * RANGE_UNIT_M),
            reference_m,
            difference_m: phase.map(|units| units * PHASE_UNIT_M),
            lock: self.lock,
            cn0: self.cn0,
        }
    }
}

fn code([band, attribute]: &[u8; 2]) -> ObservationCode {
    ObservationCode::new(*band, *attribute).expect("the tables above hold codes")
}
