//! Pairs of signals that rover and base observe of one satellite.

use crate::config::PositioningOptions;
use crate::gnss::{Band, Constellation, Observation, ObservationCode, Signal};
use crate::positioning::measurements::preference;

/// One signal of one satellite, observed by both receivers.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pair<'a> {
    pub(super) band: Band,
    pub(super) frequency_hz: f64,
    pub(super) rover: &'a Observation,
    pub(super) base: &'a Observation,
}

impl Pair<'_> {
    /// Similarity of the two codes.
    fn likeness(&self) -> Likeness {
        likeness(self.rover.satellite.constellation, self.rover.code, self.base.code)
    }

    /// Whether both pseudoranges have the same code delay at the satellite.
    pub(super) fn shares_code(&self) -> bool {
        self.likeness() <= Likeness::Family
    }
}

/// Similarity of two codes, best first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Likeness {
    /// Both have the same observation code.
    Code,
    /// Both are components of one signal, such as data and pilot channel.
    Family,
    /// Both have the same carrier only.
    Carrier,
}

fn likeness(
    constellation: Constellation,
    rover: ObservationCode,
    base: ObservationCode,
) -> Likeness {
    if rover == base {
        Likeness::Code
    } else if family(constellation, rover) == family(constellation, base) {
        Likeness::Family
    } else {
        Likeness::Carrier
    }
}

/// The signal to which a tracking attribute belongs (RINEX 3.05, tables 4 to 10). Civil codes of
/// one carrier and P(Y) have different satellite delays, by up to some metres.
fn family(constellation: Constellation, code: ObservationCode) -> (u8, u8) {
    use Constellation as C;
    let family = match (constellation, code.band_digit(), code.attribute()) {
        (C::Gps | C::Glonass, _, b'P' | b'W' | b'Y') => b'P',
        // L2C and L1C; C/A on L1 and L2 is a signal by itself.
        (C::Gps | C::Qzss, 1 | 2, b'L' | b'S' | b'X') => b'X',
        (C::Gps | C::Qzss | C::Glonass, 1 | 2, attribute) => attribute,
        // B1C and B2 of BeiDou-3 share their carriers with no other signal of BeiDou.
        _ => b'X',
    };
    (code.band_digit(), family)
}

/// Appends the pair to use in each band: the most similar codes, then the rover's preferred signal,
/// then the base's. A pair with both carrier phases comes before one without.
pub(super) fn pairs<'a>(
    rover: &'a [Observation],
    base: &'a [Observation],
    glonass_channel: Option<i8>,
    options: &PositioningOptions,
    pairs: &mut Vec<Pair<'a>>,
) {
    pairs.clear();
    for band in Band::ALL.into_iter().filter(|band| options.frequencies.contains(*band)) {
        let of_band = |observation: &&Observation| {
            observation.signal().band() == Some(band) && is_strong(observation, options)
        };
        let mut best: Option<((bool, Likeness, u8, u8), Pair<'a>)> = None;
        for rover in rover.iter().filter(of_band) {
            let Some(place) = preference(rover.signal(), band) else { continue };
            let Some(frequency_hz) = rover.signal().frequency_hz(glonass_channel) else { continue };
            for base in base.iter().filter(of_band) {
                let Some(other) = preference(base.signal(), band) else { continue };
                if Signal::frequency_hz(base.signal(), glonass_channel) != Some(frequency_hz) {
                    continue;
                }
                let pair = Pair { band, frequency_hz, rover, base };
                let lacks_phase = rover.carrier_phase.is_none() || base.carrier_phase.is_none();
                let rank = (lacks_phase, pair.likeness(), place, other);
                if best.as_ref().is_none_or(|(known, _)| rank < *known) {
                    best = Some((rank, pair));
                }
            }
        }
        pairs.extend(best.map(|(_, pair)| pair));
    }
}

fn is_strong(observation: &Observation, options: &PositioningOptions) -> bool {
    observation.cn0_db_hz.is_none_or(|cn0| options.cn0_mask_db_hz <= cn0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{Mode, Profile};
    use crate::gnss::{Cycles, SatelliteId};

    fn observed(satellite: &str, codes: &[&str]) -> Vec<Observation> {
        let satellite: SatelliteId = satellite.parse().unwrap();
        let observe = |code: &&str| Observation {
            pseudorange_m: Some(2e7),
            carrier_phase: Some(Cycles(1e8)),
            ..Observation::empty(satellite, ObservationCode::parse(code).unwrap())
        };
        codes.iter().map(observe).collect()
    }

    fn found(satellite: &str, rover: &[&str], base: &[&str]) -> Vec<String> {
        let options = PositioningOptions::new(Mode::RtkFgo, Profile::General);
        let (rover, base) = (observed(satellite, rover), observed(satellite, base));
        let mut list = Vec::new();
        pairs(&rover, &base, None, &options, &mut list);
        list.iter().map(|pair| format!("{}/{}", pair.rover.code, pair.base.code)).collect()
    }

    #[test]
    fn the_same_code_first_then_the_same_signal_then_the_same_carrier() {
        assert_eq!(found("G05", &["1C", "2L", "2W"], &["1C", "2W", "2S"]), ["1C/1C", "2W/2W"]);
        assert_eq!(found("G05", &["1C", "2L"], &["1C", "2W", "2S"]), ["1C/1C", "2L/2S"]);
        assert_eq!(found("G05", &["1W", "2W"], &["1C", "2W"]), ["1W/1C", "2W/2W"]);
        assert_eq!(found("E11", &["1C", "5Q"], &["1X", "5X"]), ["1C/1X", "5Q/5X"]);
    }

    /// B1I at 1561.098 MHz and B1C at 1575.42 MHz are one band and two carriers.
    #[test]
    fn one_band_with_two_carriers_does_not_mix_them() {
        assert_eq!(found("C30", &["2I"], &["1P"]), [""; 0]);
        assert_eq!(found("C30", &["2I", "1P"], &["1P"]), ["1P/1P"]);
    }

    #[test]
    fn codes_of_other_delays_are_told_apart() {
        let shares = |rover: &str, base: &str| {
            let code = |text| ObservationCode::parse(text).unwrap();
            likeness(Constellation::Gps, code(rover), code(base)) <= Likeness::Family
        };
        assert!(shares("2L", "2S") && shares("5Q", "5X"));
        assert!(!shares("1C", "1W") && !shares("2L", "2W"));
    }
}
