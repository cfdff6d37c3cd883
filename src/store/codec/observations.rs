//! Observations as bits: each value as its difference from an expected value (`signals`).
//!
//! The number of observations comes first. Then follow, in bits: a table of kinds (constellation,
//! code, flags, and how each value is written), the parameters of the Rice codes, and the
//! observations. If there is an earlier epoch, one bit of each observation says whether satellite
//! and kind are the next ones of that epoch.

use crate::gnss::{Observation, ObservationCode, SatelliteId};

use super::CodecError;
use super::bits::{BitReader, BitWriter, rice_parameter};
use super::bytes::{Decoder, Encoder, thousandths, unzigzag, zigzag};
use super::signals::{
    ABSENT, BITS, CODES, DOPPLER, Kind, Known, NUMBER_BITS, Neighbour, ORIGINS, PARAMETER_BITS,
    PHASE, QUARTER, QUARTERS, Signal, VALUES,
};

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

    /// The next signal of the earlier epoch.
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

/// An observation prepared for writing.
struct Written {
    /// Index of its kind; `None` if satellite and kind are the expected ones.
    kind: Option<usize>,
    /// For each value, the index of its Rice code, and its difference in thousandths.
    differences: [Option<(usize, u64)>; VALUES],
}

/// Encodes observations; with `earlier`, relative to an epoch that is `interval` older (ns).
pub(super) fn encode_observations(
    out: &mut Encoder,
    observations: &[Observation],
    earlier: Option<(&[Observation], i64)>,
) {
    let has_earlier = earlier.is_some();
    let mut earlier = Earlier::of(earlier);
    let (mut kinds, mut codes): (Vec<Kind>, [Vec<u64>; CODES]) = Default::default();
    let mut previous: Option<Neighbour> = None;
    let signals: Vec<Signal> = observations.iter().map(Signal::of).collect();
    let mut written = Vec::with_capacity(observations.len());
    for signal in &signals {
        let Signal { satellite, kind, .. } = *signal;
        let is_expected =
            |expected: &Signal| expected.satellite == satellite && expected.kind == kind;
        let index =
            (!earlier.expected().is_some_and(is_expected)).then(|| index_of(kind, &mut kinds));
        let before = earlier.find(satellite, kind.code).map(|index| &earlier.signals[index]);
        let known = Known::of((satellite, &kind), before, earlier.interval_ns, previous);
        let expected: [_; VALUES] =
            std::array::from_fn(|index| signal.whole[index].map(|_| known.expected(index, signal)));
        let differences: [_; VALUES] = std::array::from_fn(|index| {
            expected[index].and_then(|expected| difference(index, signal, expected))
        });
        for (code, difference) in differences.iter().flatten() {
            let values = &mut codes[*code];
            if values.is_empty() {
                values.reserve(observations.len());
            }
            values.push(*difference);
        }
        previous = Some(Neighbour::with(signal, &known, [expected[DOPPLER], expected[PHASE]]));
        written.push(Written { kind: index, differences });
    }
    out.count(written.len());
    out.count(kinds.len());
    let mut bits = BitWriter::new(out);
    kinds.iter().for_each(|kind| kind.encode(&mut bits));
    let parameters = codes.map(|mut code| (!code.is_empty()).then(|| rice_parameter(&mut code)));
    encode_parameters(&mut bits, &parameters);
    let mut satellite = None;
    for (signal, Written { kind, differences }) in signals.iter().zip(written) {
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
        encode_values(&mut bits, signal, &differences, &parameters);
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

/// Number of bits that an index below `count` needs.
const fn index_bits(count: usize) -> u32 {
    usize::BITS - count.saturating_sub(1).leading_zeros()
}

/// Index of the Rice code, and the difference of a value from the expected one (thousandths).
fn difference(
    index: usize,
    signal: &Signal,
    (origin, expected): (usize, i64),
) -> Option<(usize, u64)> {
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

/// Decodes observations; with `earlier`, relative to an epoch that is `interval` older (ns).
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
