//! RXM-SFRBX: passes subframes, pages and strings to the decoder of their message.

use std::collections::BTreeMap;

use crate::formats::binary::{Clock, Ionosphere, Refusal};
use crate::formats::broadcast::is_plausible;
use crate::gnss::{Constellation, Ephemeris, SatelliteId};

use super::broadcast::Broadcast;
use super::rawx::satellite;
use super::{beidou, field, galileo, glonass, lnav};

const HEADER_BYTES: usize = 8;
const VERSIONS: std::ops::RangeInclusive<u8> = 1..=2;
/// Number of words in LNAV, D1 and D2 subframes.
const TEN: usize = 10;

/// The navigation messages of all satellites.
#[derive(Debug, Default)]
pub(super) struct Subframes {
    lnav: BTreeMap<SatelliteId, lnav::Collector>,
    galileo: BTreeMap<SatelliteId, galileo::Collector>,
    beidou: BTreeMap<SatelliteId, beidou::Collector>,
    glonass: BTreeMap<SatelliteId, glonass::Collector>,
    told: Told,
}

/// Content already reported, which is not repeated.
#[derive(Debug, Default)]
struct Told {
    ephemerides: BTreeMap<SatelliteId, Ephemeris>,
    ionosphere: Vec<Ionosphere>,
    leap_seconds: Option<i64>,
}

impl Subframes {
    /// Decodes a payload; `None` for messages that are not decoded.
    pub(super) fn decode(
        &mut self,
        payload: &[u8],
        clock: &Clock,
    ) -> Result<Option<Broadcast>, Refusal> {
        let [system, number, signal, channel, count] = field(payload, 0)?;
        let [version] = field(payload, 6)?;
        if !VERSIONS.contains(&version) {
            return Err(Refusal::UnknownVersion(version));
        }
        let words = payload.get(HEADER_BYTES..).and_then(|rest| rest.get(..usize::from(count) * 4));
        let words: Vec<u32> = words
            .ok_or(Refusal::Truncated)?
            .as_chunks::<4>()
            .0
            .iter()
            .map(|word| u32::from_le_bytes(*word))
            .collect();
        let satellite = match satellite(system, number) {
            Err(Refusal::OtherConstellation) => return Ok(None),
            satellite => satellite?,
        };
        let ten = words.first_chunk::<TEN>();
        let broadcast = match (satellite.constellation, signal, ten) {
            (Constellation::Gps | Constellation::Qzss, 0, Some(words)) => {
                self.lnav.entry(satellite).or_default().add(satellite, words, clock)?
            }
            (Constellation::BeiDou, 0..=3, Some(words)) => {
                self.beidou.entry(satellite).or_default().add(satellite, words, clock)?
            }
            // E5b-I, and E1-B, to which the first receivers give no signal number.
            (Constellation::Galileo, 0 | 1 | 5, _) => {
                let words = words.first_chunk::<8>().ok_or(Refusal::Truncated)?;
                self.galileo.entry(satellite).or_default().add(satellite, words, clock)?
            }
            (Constellation::Glonass, ..) => {
                let words = words.first_chunk::<4>().ok_or(Refusal::Truncated)?;
                let channel = i8::try_from(channel).map_err(|_| Refusal::ImplausibleEphemeris)? - 7;
                self.glonass.entry(satellite).or_default().add(satellite, channel, words, clock)?
            }
            (_, 0, None) => return Err(Refusal::Truncated),
            _ => return Ok(None),
        };
        self.told.judge(broadcast).map(Some)
    }
}

impl Told {
    /// The content that has not been reported yet.
    fn judge(&mut self, mut broadcast: Broadcast) -> Result<Broadcast, Refusal> {
        if let Some(ephemeris) = &broadcast.ephemeris {
            if !is_plausible(ephemeris) {
                return Err(Refusal::ImplausibleEphemeris);
            }
            let undated = without_transmission_time(ephemeris.clone());
            let last = self.ephemerides.insert(ephemeris.satellite(), undated.clone());
            if last == Some(undated) {
                broadcast.ephemeris = None;
            }
        }
        if let Some(ionosphere) = broadcast.ionosphere {
            let kind = std::mem::discriminant(&ionosphere);
            let known = self.ionosphere.iter().position(|i| std::mem::discriminant(i) == kind);
            let last = known.map(|index| self.ionosphere.swap_remove(index));
            self.ionosphere.push(ionosphere);
            broadcast.ionosphere = (last != Some(ionosphere)).then_some(ionosphere);
        }
        if let Some(seconds) = broadcast.leap_seconds {
            let last = self.leap_seconds.replace(seconds);
            broadcast.leap_seconds = (last != Some(seconds)).then_some(seconds);
        }
        Ok(broadcast)
    }
}

fn without_transmission_time(mut ephemeris: Ephemeris) -> Ephemeris {
    match &mut ephemeris {
        Ephemeris::Keplerian(e) => e.transmission_time = None,
        Ephemeris::Glonass(e) => e.transmission_time = None,
    }
    ephemeris
}
