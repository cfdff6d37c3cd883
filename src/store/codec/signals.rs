//! Observations as integers, and the value that is expected of each.
//!
//! Values are whole thousandths (mHz, mcycles, mm, mdB-Hz), or any other `f64` with all its bits.
//! An expected value comes from the same signal in an earlier epoch, if there is one. Otherwise it
//! comes from the previous signal of the same satellite:
//!
//! - Doppler: that of the earlier epoch, or in proportion to the frequencies.
//! - Phase: the earlier one less the mean Doppler times the interval, or in proportion.
//! - Pseudorange: the earlier one plus λ times the change of the phase, or the other signal's.
//! - C/N0: the earlier one, or that of the other signal.
//!
//! If Doppler or phase of the satellite's previous signal differed from its expected value, the
//! expected value here is changed by this difference, in proportion to the frequencies. All is
//! computed in integers.

use crate::gnss::{Constellation, Cycles, Observation, ObservationCode, SatelliteId};

use super::CodecError;
use super::bits::{BitReader, BitWriter};
use super::bytes::{constellation_number, thousandths};

const LOSS_OF_LOCK: u8 = 1;
const HALF_CYCLE: u8 = 2;

/// Indices of the values, in the order in which they are written.
pub(super) const DOPPLER: usize = 0;
pub(super) const PHASE: usize = 1;
const RANGE: usize = 2;
const CN0: usize = 3;
pub(super) const VALUES: usize = 4;

/// How a value is written.
pub(super) const ABSENT: u8 = 0;
const THOUSANDTHS: u8 = 1;
pub(super) const BITS: u8 = 2;
/// For C/N0: a whole number of quarters of a dB.
pub(super) const QUARTERS: u8 = 3;
pub(super) const QUARTER: i64 = 250;
/// Expected C/N0 of a signal without an earlier or other value (mdB-Hz).
const USUAL_CN0: i64 = 40_000;

/// The origin of an expected value. Each origin has Rice codes of its own.
const NOTHING: usize = 0;
const OWN_PHASE: usize = 1;
const NEIGHBOUR: usize = 2;
const BEFORE: usize = 3;
pub(super) const ORIGINS: usize = 4;
pub(super) const CODES: usize = VALUES * ORIGINS;

const CONSTELLATION_BITS: u32 = 3;
const BAND_BITS: u32 = 4;
const ATTRIBUTE_BITS: u32 = 5;
const FLAG_BITS: u32 = 2;
const TAG_BITS: u32 = 2;
pub(super) const NUMBER_BITS: u32 = 7;
pub(super) const PARAMETER_BITS: u32 = 6;

const SPEED_OF_LIGHT: i128 = 299_792_458;
const NS_PER_SECOND: i128 = 1_000_000_000;

/// Nominal frequency of a band (10 kHz). It is part of the encoding, so it never changes. An
/// inexact frequency only costs bits.
const fn frequency(constellation: Constellation, band_digit: u8) -> i128 {
    match (constellation, band_digit) {
        (Constellation::Glonass, 1) => 160_200,
        (Constellation::Glonass, 2) => 124_600,
        (Constellation::Glonass, 3) => 120_203,
        (Constellation::BeiDou, 2) => 156_110,
        (Constellation::BeiDou, 6) => 126_852,
        (_, 2) => 122_760,
        (_, 5) => 117_645,
        (_, 6) => 127_875,
        (_, 7) => 120_714,
        (_, 8) => 119_180,
        _ => 157_542,
    }
}

/// What observations of one kind have in common.
#[derive(Clone, Copy, PartialEq)]
pub(super) struct Kind {
    pub(super) constellation: Constellation,
    pub(super) code: ObservationCode,
    flags: u8,
    pub(super) tags: [u8; VALUES],
}

/// An observation as it is written.
#[derive(Clone, Copy)]
pub(super) struct Signal {
    pub(super) satellite: SatelliteId,
    pub(super) kind: Kind,
    /// The values that are whole thousandths.
    pub(super) whole: [Option<i64>; VALUES],
    pub(super) values: [Option<f64>; VALUES],
}

/// The previous signal of the epoch, if it is of the same satellite.
#[derive(Clone, Copy)]
pub(super) struct Neighbour {
    pub(super) satellite: SatelliteId,
    frequency: i128,
    whole: [Option<i64>; VALUES],
    /// Doppler and phase less their values expected from an earlier epoch.
    innovations: [i128; 2],
}

/// What the expected values of a signal are computed from.
pub(super) struct Known<'a> {
    frequency: i128,
    before: Option<&'a [Option<i64>; VALUES]>,
    /// Time since the earlier epoch (ns).
    interval_ns: i64,
    neighbour: Option<Neighbour>,
}

impl Kind {
    pub(super) fn encode(&self, bits: &mut BitWriter<'_>) {
        bits.bits(constellation_number(self.constellation).into(), CONSTELLATION_BITS);
        bits.bits(self.code.band_digit().into(), BAND_BITS);
        bits.bits((self.code.attribute() - b'A').into(), ATTRIBUTE_BITS);
        bits.bits(self.flags.into(), FLAG_BITS);
        self.tags.iter().for_each(|tag| bits.bits((*tag).into(), TAG_BITS));
    }

    pub(super) fn decode(bits: &mut BitReader<'_, '_>) -> Result<Self, CodecError> {
        let number = bits.bits(CONSTELLATION_BITS)? as u8;
        let mut all = Constellation::ALL.into_iter();
        let constellation = all.find(|c| constellation_number(*c) == number);
        let (band, attribute) = (bits.bits(BAND_BITS)? as u8, bits.bits(ATTRIBUTE_BITS)? as u8);
        let code = ObservationCode::new(b'0' + band, b'A' + attribute);
        let flags = bits.bits(FLAG_BITS)? as u8;
        let mut tags = [ABSENT; VALUES];
        for tag in &mut tags {
            *tag = bits.bits(TAG_BITS)? as u8;
        }
        match (constellation, code) {
            (Some(constellation), Some(code)) if !tags[..CN0].contains(&QUARTERS) => {
                Ok(Self { constellation, code, flags, tags })
            }
            _ => Err(bits.invalid("kind of observation")),
        }
    }
}

impl Signal {
    pub(super) fn of(observation: &Observation) -> Self {
        let values = [
            observation.doppler_hz,
            observation.carrier_phase.map(|phase| phase.0),
            observation.pseudorange_m,
            observation.cn0_db_hz,
        ];
        let whole = values.map(|value| value.and_then(thousandths));
        let tag = |index: usize| match (values[index], whole[index]) {
            (None, _) => ABSENT,
            (Some(_), Some(whole)) if index == CN0 && whole % QUARTER == 0 => QUARTERS,
            (Some(_), Some(_)) => THOUSANDTHS,
            (Some(_), None) => BITS,
        };
        let lost = if observation.loss_of_lock { LOSS_OF_LOCK } else { 0 };
        let kind = Kind {
            constellation: observation.satellite.constellation,
            code: observation.code,
            flags: lost | if observation.half_cycle { HALF_CYCLE } else { 0 },
            tags: std::array::from_fn(tag),
        };
        Self { satellite: observation.satellite, kind, whole, values }
    }

    pub(super) fn observation(&self) -> Observation {
        Observation {
            satellite: self.satellite,
            code: self.kind.code,
            loss_of_lock: self.kind.flags & LOSS_OF_LOCK != 0,
            half_cycle: self.kind.flags & HALF_CYCLE != 0,
            pseudorange_m: self.values[RANGE],
            carrier_phase: self.values[PHASE].map(Cycles),
            doppler_hz: self.values[DOPPLER],
            cn0_db_hz: self.values[CN0],
        }
    }
}

impl Neighbour {
    /// `signal` as the next signal uses it; `known` is what its own values were expected from.
    pub(super) fn of(signal: &Signal, known: &Known<'_>) -> Self {
        let expected = |index: usize| signal.whole[index].map(|_| known.expected(index, signal));
        Self::with(signal, known, [expected(DOPPLER), expected(PHASE)])
    }

    /// Like [`Self::of`], with the expected Doppler and phase and their origins given.
    pub(super) fn with(
        signal: &Signal,
        known: &Known<'_>,
        expected: [Option<(usize, i64)>; 2],
    ) -> Self {
        let innovation = |index: usize| match (signal.whole[index], expected[index]) {
            (Some(value), Some((BEFORE, expected))) => i128::from(value) - i128::from(expected),
            _ => 0,
        };
        Self {
            satellite: signal.satellite,
            frequency: known.frequency,
            whole: signal.whole,
            innovations: [innovation(DOPPLER), innovation(PHASE)],
        }
    }
}

impl<'a> Known<'a> {
    pub(super) fn of(
        (satellite, kind): (SatelliteId, &Kind),
        before: Option<&'a Signal>,
        interval_ns: i64,
        previous: Option<Neighbour>,
    ) -> Self {
        Self {
            frequency: frequency(kind.constellation, kind.code.band_digit()),
            before: before.map(|before| &before.whole),
            interval_ns,
            neighbour: previous.filter(|previous| previous.satellite == satellite),
        }
    }

    /// The origin of an expected value, and the value. Needs the values of lower index in `signal`.
    pub(super) fn expected(&self, index: usize, signal: &Signal) -> (usize, i64) {
        let (origin, expected) = match index {
            DOPPLER | PHASE => self.expected_rate_or_phase(index, signal),
            RANGE => self.expected_range(signal),
            _ => self.expected_cn0(),
        };
        let is_in_quarters = signal.kind.tags[index] == QUARTERS;
        let expected = expected as i64;
        (origin, if is_in_quarters { expected.div_euclid(QUARTER) * QUARTER } else { expected })
    }

    fn expected_rate_or_phase(&self, index: usize, signal: &Signal) -> (usize, i128) {
        let neighbour = self.neighbour.as_ref();
        let scaled = |value: i128, from: &Neighbour| ratio(value, self.frequency, from.frequency);
        if let Some(before) = self.value_before(index) {
            let motion = if index == PHASE { self.cycles_since(signal).unwrap_or(0) } else { 0 };
            let innovation = neighbour.map_or(0, |from| scaled(from.innovations[index], from));
            return (BEFORE, before + motion + innovation);
        }
        let value = neighbour.and_then(|from| Some(scaled(from.whole[index]?.into(), from)));
        value.map_or((NOTHING, 0), |value| (NEIGHBOUR, value))
    }

    fn expected_range(&self, signal: &Signal) -> (usize, i128) {
        let metres = |cycles: i128| ratio(cycles, SPEED_OF_LIGHT, self.frequency * 10_000);
        let phase = signal.whole[PHASE].map(i128::from);
        if let Some(before) = self.value_before(RANGE) {
            let by_phase = phase.zip(self.value_before(PHASE)).map(|(now, then)| now - then);
            let change = by_phase.or_else(|| self.cycles_since(signal));
            return (BEFORE, before + metres(change.unwrap_or(0)));
        }
        match (self.neighbour.and_then(|from| from.whole[RANGE]), phase) {
            (Some(range), _) => (NEIGHBOUR, range.into()),
            (None, Some(phase)) => (OWN_PHASE, metres(phase)),
            (None, None) => (NOTHING, 0),
        }
    }

    fn expected_cn0(&self) -> (usize, i128) {
        match (self.value_before(CN0), self.neighbour.and_then(|from| from.whole[CN0])) {
            (Some(before), _) => (BEFORE, before),
            (None, Some(neighbour)) => (NEIGHBOUR, neighbour.into()),
            (None, None) => (NOTHING, USUAL_CN0.into()),
        }
    }

    fn value_before(&self, index: usize) -> Option<i128> {
        self.before?[index].map(i128::from)
    }

    /// Change of the phase since the earlier epoch by the mean of both Dopplers (mcycles).
    fn cycles_since(&self, signal: &Signal) -> Option<i128> {
        let sum = self.value_before(DOPPLER)? + i128::from(signal.whole[DOPPLER]?);
        Some(ratio(-sum, self.interval_ns.into(), 2 * NS_PER_SECOND))
    }
}

/// `value` · `by` / `over`, rounded towards zero; `over` is positive. Nearly all products fit into
/// 64 bits, which are divided much faster than 128.
fn ratio(value: i128, by: i128, over: i128) -> i128 {
    let narrow = |value: i128| i64::try_from(value).ok();
    let product = narrow(value).zip(narrow(by)).and_then(|(value, by)| value.checked_mul(by));
    match (product, narrow(over)) {
        (Some(product), Some(over)) => i128::from(product / over),
        _ => value * by / over,
    }
}
