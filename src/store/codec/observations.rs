//! Observations as bits: each value as its difference from what is expected of it.
//!
//! Values are whole thousandths (mHz, mcycles, mm, mdB-Hz), or any other `f64` with all its bits.
//! What is expected comes from the same signal in an earlier epoch, if there is one, otherwise from
//! the satellite's previous signal:
//!
//! - Doppler: that of the earlier epoch, or in proportion to the frequencies.
//! - Phase: the earlier one less the mean Doppler times the interval, or in proportion.
//! - Pseudorange: the earlier one plus λ times the change of the phase, or the other signal's.
//! - C/N0: the earlier one, or that of the other signal.
//!
//! Where Doppler or phase of the satellite's previous signal differed from what was expected, the
//! same is expected here, in proportion to the frequencies. All is computed in integers.
//!
//! Number of observations; then in bits: a table of kinds (constellation, code, flags, and how each
//! value is written), the parameters of the Rice codes, and the observations. With an earlier
//! epoch, one bit says that the satellite and kind are those that follow in its order.

use crate::gnss::{Constellation, Cycles, Observation, ObservationCode, SatelliteId};

use super::CodecError;
use super::bits::{BitReader, BitWriter, rice_parameter};
use super::bytes::{Decoder, Encoder, constellation_number, thousandths, unzigzag, zigzag};

const LOSS_OF_LOCK: u8 = 1;
const HALF_CYCLE: u8 = 2;

/// Indices of the values, in the order in which they are written.
const DOPPLER: usize = 0;
const PHASE: usize = 1;
const RANGE: usize = 2;
const CN0: usize = 3;
const VALUES: usize = 4;

/// How a value is written.
const ABSENT: u8 = 0;
const WHOLE: u8 = 1;
const BITS: u8 = 2;
/// For C/N0: a whole number of quarters of a dB.
const QUARTERS: u8 = 3;
const QUARTER: i64 = 250;
/// C/N0 of which nothing is known (mdB-Hz).
const USUAL_CN0: i64 = 40_000;

/// What an expected value comes from. Each has Rice codes of its own.
const NOTHING: usize = 0;
const OWN_PHASE: usize = 1;
const NEIGHBOUR: usize = 2;
const BEFORE: usize = 3;
const ORIGINS: usize = 4;
const CODES: usize = VALUES * ORIGINS;

const CONSTELLATION_BITS: u32 = 3;
const BAND_BITS: u32 = 4;
const ATTRIBUTE_BITS: u32 = 5;
const FLAG_BITS: u32 = 2;
const TAG_BITS: u32 = 2;
const NUMBER_BITS: u32 = 7;
const PARAMETER_BITS: u32 = 6;

const SPEED_OF_LIGHT: i128 = 299_792_458;
const NS_PER_SECOND: i128 = 1_000_000_000;

/// Nominal frequency of a band (10 kHz). A part of the encoding: it never changes. Its errors cost
/// bits only.
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
struct Kind {
    constellation: Constellation,
    code: ObservationCode,
    flags: u8,
    tags: [u8; VALUES],
}

/// An observation as it is written.
#[derive(Clone, Copy)]
struct Signal {
    satellite: SatelliteId,
    kind: Kind,
    /// The values that are whole thousandths.
    whole: [Option<i64>; VALUES],
    values: [Option<f64>; VALUES],
}

/// The previous signal of the epoch.
#[derive(Clone, Copy)]
struct Neighbour {
    satellite: SatelliteId,
    frequency: i128,
    whole: [Option<i64>; VALUES],
    /// Doppler and phase less what an earlier epoch let expect.
    innovations: [i128; 2],
}

/// What is known of a signal before its values are read.
struct Known<'a> {
    frequency: i128,
    before: Option<&'a [Option<i64>; VALUES]>,
    /// Time since the earlier epoch (ns).
    interval_ns: i64,
    neighbour: Option<Neighbour>,
}

impl Kind {
    fn encode(&self, bits: &mut BitWriter<'_>) {
        bits.bits(constellation_number(self.constellation).into(), CONSTELLATION_BITS);
        bits.bits(self.code.band_digit().into(), BAND_BITS);
        bits.bits((self.code.attribute() - b'A').into(), ATTRIBUTE_BITS);
        bits.bits(self.flags.into(), FLAG_BITS);
        self.tags.iter().for_each(|tag| bits.bits((*tag).into(), TAG_BITS));
    }

    fn decode(bits: &mut BitReader<'_, '_>) -> Result<Self, CodecError> {
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
    fn of(observation: &Observation) -> Self {
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
            (Some(_), Some(_)) => WHOLE,
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

    fn observation(&self) -> Observation {
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
    /// What the next signal sees of `signal`, of which `known` was known.
    fn of(signal: &Signal, known: &Known<'_>) -> Self {
        let innovation = |index: usize| match (signal.whole[index], known.expected(index, signal)) {
            (Some(value), (BEFORE, expected)) => i128::from(value) - i128::from(expected),
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
    fn of(
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

    /// What is expected of a value, and what that comes from. The values before it are known.
    fn expected(&self, index: usize, signal: &Signal) -> (usize, i64) {
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
        let scaled = |value: i128, from: &Neighbour| value * self.frequency / from.frequency;
        if let Some(before) = self.value_before(index) {
            let motion = if index == PHASE { self.cycles_since(signal).unwrap_or(0) } else { 0 };
            let innovation = neighbour.map_or(0, |from| scaled(from.innovations[index], from));
            return (BEFORE, before + motion + innovation);
        }
        let value = neighbour.and_then(|from| Some(scaled(from.whole[index]?.into(), from)));
        value.map_or((NOTHING, 0), |value| (NEIGHBOUR, value))
    }

    fn expected_range(&self, signal: &Signal) -> (usize, i128) {
        let metres = |cycles: i128| cycles * SPEED_OF_LIGHT / (self.frequency * 10_000);
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
        Some(-sum * i128::from(self.interval_ns) / (2 * NS_PER_SECOND))
    }
}

/// The earlier epoch's signals, read in order.
struct Earlier {
    signals: Vec<Signal>,
    interval_ns: i64,
    next: usize,
}

impl Earlier {
    fn of(earlier: Option<(&[Observation], i64)>) -> Self {
        let (observations, interval_ns) = earlier.unwrap_or_default();
        Self { signals: observations.iter().map(Signal::of).collect(), interval_ns, next: 0 }
    }

    /// The signal that follows in the order.
    fn expected(&self) -> Option<&Signal> {
        self.signals.get(self.next)
    }

    /// Index of this signal.
    fn find(&mut self, satellite: SatelliteId, code: ObservationCode) -> Option<usize> {
        let is = |signal: &&Signal| signal.satellite == satellite && signal.kind.code == code;
        let found = match self.expected().filter(is) {
            Some(_) => Some(self.next),
            None => self.signals.iter().position(|signal| is(&signal)),
        };
        self.next = found.map_or(self.next, |index| index + 1);
        found
    }
}

/// An observation on its way into bits.
struct Written {
    signal: Signal,
    /// Index of its kind; `None` if satellite and kind are those expected.
    kind: Option<usize>,
    /// The code and difference of each value in thousandths.
    differences: [Option<(usize, u64)>; VALUES],
}

/// Encodes observations; with `earlier`, relative to those of an epoch this long before (ns).
pub(super) fn encode_observations(
    out: &mut Encoder,
    observations: &[Observation],
    earlier: Option<(&[Observation], i64)>,
) {
    let has_earlier = earlier.is_some();
    let mut earlier = Earlier::of(earlier);
    let (mut kinds, mut codes): (Vec<Kind>, [Vec<u64>; CODES]) = Default::default();
    let mut previous: Option<Neighbour> = None;
    let mut written = Vec::with_capacity(observations.len());
    for signal in observations.iter().map(Signal::of) {
        let Signal { satellite, kind, .. } = signal;
        let is_expected =
            |expected: &Signal| expected.satellite == satellite && expected.kind == kind;
        let index =
            (!earlier.expected().is_some_and(is_expected)).then(|| index_of(kind, &mut kinds));
        let before = earlier.find(satellite, kind.code).map(|index| &earlier.signals[index]);
        let known = Known::of((satellite, &kind), before, earlier.interval_ns, previous);
        let differences = std::array::from_fn(|index| difference(index, &signal, &known));
        for (code, difference) in differences.iter().flatten() {
            codes[*code].push(*difference);
        }
        previous = Some(Neighbour::of(&signal, &known));
        written.push(Written { signal, kind: index, differences });
    }
    out.count(written.len());
    out.count(kinds.len());
    let mut bits = BitWriter::new(out);
    kinds.iter().for_each(|kind| kind.encode(&mut bits));
    let parameters = codes.map(|mut code| (!code.is_empty()).then(|| rice_parameter(&mut code)));
    encode_parameters(&mut bits, &parameters);
    let mut satellite = None;
    for Written { signal, kind, differences } in written {
        if has_earlier {
            bits.bit(kind.is_none());
        }
        if let Some(kind) = kind {
            bits.bits(kind as u64, index_bits(kinds.len()));
            let is_same = satellite == Some(signal.satellite);
            bits.bit(is_same);
            if !is_same {
                bits.bits(signal.satellite.number.into(), NUMBER_BITS);
            }
        }
        satellite = Some(signal.satellite);
        encode_values(&mut bits, &signal, &differences, &parameters);
    }
    bits.finish();
}

fn index_of(kind: Kind, kinds: &mut Vec<Kind>) -> usize {
    let known = kinds.iter().position(|known| *known == kind);
    known.unwrap_or_else(|| {
        kinds.push(kind);
        kinds.len() - 1
    })
}

/// Bits of an index below `count`.
const fn index_bits(count: usize) -> u32 {
    usize::BITS - count.saturating_sub(1).leading_zeros()
}

/// Code and difference of a value in thousandths.
fn difference(index: usize, signal: &Signal, known: &Known<'_>) -> Option<(usize, u64)> {
    let (origin, expected) = known.expected(index, signal);
    let difference = signal.whole[index]?.wrapping_sub(expected);
    let is_in_quarters = signal.kind.tags[index] == QUARTERS;
    let difference = if is_in_quarters { difference / QUARTER } else { difference };
    Some((code_of(index, origin), zigzag(difference)))
}

const fn code_of(index: usize, origin: usize) -> usize {
    index * ORIGINS + origin
}

fn encode_parameters(bits: &mut BitWriter<'_>, parameters: &[Option<u32>; CODES]) {
    for parameter in parameters {
        bits.bit(parameter.is_some());
        if let Some(parameter) = parameter {
            bits.bits((*parameter).into(), PARAMETER_BITS);
        }
    }
}

fn encode_values(
    bits: &mut BitWriter<'_>,
    signal: &Signal,
    differences: &[Option<(usize, u64)>; VALUES],
    parameters: &[Option<u32>; CODES],
) {
    for (value, difference) in signal.values.iter().zip(differences) {
        match (difference, value) {
            (Some((code, difference)), _) => {
                bits.rice(*difference, parameters[*code].unwrap_or(0));
            }
            (None, Some(value)) => bits.bits(value.to_bits(), u64::BITS),
            (None, None) => {}
        }
    }
}

/// Decodes observations; with `earlier`, relative to those of an epoch this long before (ns).
pub(super) fn decode_observations(
    input: &mut Decoder<'_>,
    earlier: Option<(&[Observation], i64)>,
) -> Result<Vec<Observation>, CodecError> {
    let has_earlier = earlier.is_some();
    let mut earlier = Earlier::of(earlier);
    let count = input.count_of_bits("number of observations")?;
    let kinds = input.count_of_bits("number of kinds")?;
    let mut bits = BitReader::new(input);
    let kinds = (0..kinds).map(|_| Kind::decode(&mut bits)).collect::<Result<Vec<_>, _>>()?;
    let mut parameters = [0; CODES];
    for parameter in &mut parameters {
        if bits.bit()? {
            *parameter = bits.bits(PARAMETER_BITS)? as u32;
        }
    }
    let mut observations = Vec::new();
    let mut previous: Option<Neighbour> = None;
    for _ in 0..count {
        let (satellite, kind) = if has_earlier && bits.bit()? {
            let expected = earlier.expected().ok_or_else(|| bits.invalid("order of signals"))?;
            (expected.satellite, expected.kind)
        } else {
            decode_signal(&mut bits, &kinds, previous.map(|previous| previous.satellite))?
        };
        let before = earlier.find(satellite, kind.code).map(|index| &earlier.signals[index]);
        let known = Known::of((satellite, &kind), before, earlier.interval_ns, previous);
        let signal = decode_values(&mut bits, (satellite, kind), &known, &parameters)?;
        previous = Some(Neighbour::of(&signal, &known));
        observations.push(signal.observation());
    }
    bits.finish()?;
    Ok(observations)
}

fn decode_signal(
    bits: &mut BitReader<'_, '_>,
    kinds: &[Kind],
    previous: Option<SatelliteId>,
) -> Result<(SatelliteId, Kind), CodecError> {
    let index = bits.bits(index_bits(kinds.len()))? as usize;
    let kind = *kinds.get(index).ok_or_else(|| bits.invalid("kind of observation"))?;
    let satellite = match bits.bit()? {
        true => previous.filter(|previous| previous.constellation == kind.constellation),
        false => SatelliteId::new(kind.constellation, bits.bits(NUMBER_BITS)? as u8),
    };
    Ok((satellite.ok_or_else(|| bits.invalid("satellite"))?, kind))
}

fn decode_values(
    bits: &mut BitReader<'_, '_>,
    (satellite, kind): (SatelliteId, Kind),
    known: &Known<'_>,
    parameters: &[u32; CODES],
) -> Result<Signal, CodecError> {
    let mut signal = Signal { satellite, kind, whole: [None; VALUES], values: [None; VALUES] };
    for index in 0..VALUES {
        match kind.tags[index] {
            ABSENT => {}
            BITS => signal.values[index] = Some(f64::from_bits(bits.bits(u64::BITS)?)),
            tag => {
                let (origin, expected) = known.expected(index, &signal);
                let difference = unzigzag(bits.rice(parameters[code_of(index, origin)])?);
                let unit = if tag == QUARTERS { QUARTER } else { 1 };
                let whole = expected.wrapping_add(difference.wrapping_mul(unit));
                let value = whole as f64 / 1e3;
                if thousandths(value) != Some(whole) {
                    return Err(bits.invalid("measured value"));
                }
                (signal.whole[index], signal.values[index]) = (Some(whole), Some(value));
            }
        }
    }
    Ok(signal)
}
