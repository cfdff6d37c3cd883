//! Decodes RTCM 3 messages. Frames belong to the `receiver` module.
//!
//! Decoded: observations 1002, 1004, 1010, 1012 and MSM4 to MSM7 of GPS, GLONASS, Galileo, QZSS and
//! BeiDou; ephemerides 1019, 1020, 1042, 1044, 1045, 1046; stations 1005 to 1008, 1033, 1230; the
//! times of 1013 and 1029. Refused, with a reason: 1001, 1003, 1009, 1011 and MSM1 to MSM3, whose
//! ranges lack their whole light-milliseconds, and MSM of other systems. All other messages are
//! skipped.
//!
//! This decoder is Graphfix's own. The crate `rtcm-rs` 0.11 refuses a whole MSM if its table lacks
//! one signal, and adds 79 s to every build.
//!
//! Interpretation where the standard is ambiguous:
//! - *Loss of lock* is reported when a signal first appears, when its lock time is below the
//!   previous one, and when the lock time is shorter than the interval since the previous phase. A
//!   lock time that grows more slowly than time is no sign: receivers let it saturate.
//! - The phase difference of 1002, 1004, 1010 and 1012 rolls over by 1500 cycles (DF012); the
//!   decoded phase is continuous across it.
//! - BeiDou epochs are in BeiDou time. A message with the same time tag as an epoch that announced
//!   more messages belongs to that epoch: older receivers use GPS time.
//! - GLONASS phase and Doppler need the channel, from MSM5, MSM7, 1010, 1012, 1020 or the caller.
//!
//! Source: RTCM 10403.3 (2016), with the BeiDou and QZSS signals of its amendments as RINEX 3.05
//! names them.

mod ephemeris;
mod legacy;
mod lock;
mod msm;
mod msm_signals;
mod station;

pub use station::Station;

use crate::formats::binary::{Bits, Clock, Refusal};
use crate::gnss::{Constellation, Ephemeris, GpsTime, Observation};

use ephemeris::GlonassChannels;
use legacy::LegacyState;
use lock::LockTable;
use msm::{Memory, MsmKind};

/// The content of a message.
#[derive(Debug)]
pub(in crate::formats) enum Message {
    Observations(ObservationMessage),
    Ephemeris(Ephemeris),
    /// The station's description changed.
    Station(Station),
    /// Observations of a system that is not decoded.
    OtherSystem {
        ends_epoch: bool,
    },
    /// The message adds nothing to what is known.
    Nothing,
}

/// The observations of one constellation.
#[derive(Debug)]
pub(in crate::formats) struct ObservationMessage {
    pub(in crate::formats) station: u16,
    pub(in crate::formats) time: GpsTime,
    /// Whether more messages of the epoch follow.
    pub(in crate::formats) more: bool,
    /// Whether the source is MSM, not one of the older messages.
    pub(in crate::formats) is_msm: bool,
    pub(in crate::formats) observations: Vec<Observation>,
}

/// Receives the reason for each part of a message that is left out.
pub(in crate::formats) type Notes<'a> = &'a mut dyn FnMut(Refusal);

/// State of the decoder between messages.
#[derive(Debug)]
pub(in crate::formats) struct Decoder {
    locks: LockTable,
    legacy: LegacyState,
    channels: GlonassChannels,
    station: Station,
    /// The epoch for which the last message announced more messages.
    open_epoch: Option<GpsTime>,
}

impl Decoder {
    pub(in crate::formats) fn new() -> Self {
        Self {
            locks: LockTable::default(),
            legacy: LegacyState::new(),
            channels: [None; 64],
            station: Station::default(),
            open_epoch: None,
        }
    }

    /// Sets the channel of a GLONASS slot.
    pub(in crate::formats) fn set_glonass_channel(&mut self, slot: u8, channel: i8) {
        if let Some(known) = self.channels.get_mut(usize::from(slot)) {
            *known = Some(channel);
        }
    }

    /// Decodes the payload of a frame; `None` for messages that are not decoded.
    pub(in crate::formats) fn decode(
        &mut self,
        payload: &[u8],
        clock: &mut Clock,
        notes: Notes<'_>,
    ) -> Result<Option<Message>, Refusal> {
        let mut bits = Bits::new(payload);
        let number = bits.unsigned(12) as u16;
        if let Some(kind) = MsmKind::of(number) {
            let memory = Memory {
                locks: &mut self.locks,
                channels: &mut self.channels,
                open_epoch: self.open_epoch,
            };
            let message = msm::decode(payload, kind?, clock, memory, notes)?;
            return Ok(Some(self.observed(message, clock)));
        }
        if let Some(ends_epoch) = msm::of_other_system(number, bits.clone()) {
            return Ok(Some(Message::OtherSystem { ends_epoch }));
        }
        let message = match number {
            1001 | 1003 | 1009 | 1011 => return Err(Refusal::AmbiguousPseudorange),
            1002 | 1004 => {
                let message = self.legacy.decode_gps(bits, number == 1004, clock, notes)?;
                self.observed(message, clock)
            }
            1010 | 1012 => {
                let has_l2 = number == 1012;
                let channels = &mut self.channels;
                let message = self.legacy.decode_glonass(bits, has_l2, clock, channels, notes)?;
                self.observed(message, clock)
            }
            1005..=1008 | 1033 | 1230 => {
                let before = self.station.clone();
                self.station.update(number, bits)?;
                match before == self.station {
                    true => Message::Nothing,
                    false => Message::Station(self.station.clone()),
                }
            }
            1013 | 1029 => {
                station::take_time(bits, clock)?;
                Message::Nothing
            }
            1019 | 1020 | 1042 | 1044 | 1045 | 1046 => {
                let ephemeris = ephemeris::decode(number, bits, clock)?;
                if let Some(channel) = ephemeris.glonass_channel() {
                    self.set_glonass_channel(ephemeris.satellite().number, channel);
                }
                Message::Ephemeris(ephemeris)
            }
            _ => return Ok(None),
        };
        Ok(Some(message))
    }

    /// Completes the message and makes its time the newest known one.
    fn observed(&mut self, message: ObservationMessage, clock: &mut Clock) -> Message {
        clock.set(message.time);
        self.open_epoch = message.more.then_some(message.time);
        Message::Observations(message)
    }
}

/// The number of a frame's message; `None` for a frame too short to have one.
pub(in crate::formats) fn message_number(payload: &[u8]) -> Option<u16> {
    let [first, second, ..] = *payload else { return None };
    Some(u16::from(first) << 4 | u16::from(second) >> 4)
}

/// The satellite with this number, if the constellation has it.
fn satellite(
    constellation: Constellation,
    number: u64,
) -> Result<crate::gnss::SatelliteId, Refusal> {
    let highest = match constellation {
        Constellation::Gps => 32,
        Constellation::Glonass => 27,
        Constellation::Galileo => 36,
        Constellation::BeiDou => 63,
        Constellation::Qzss => 10,
    };
    let number = u8::try_from(number).ok().filter(|number| *number <= highest);
    number
        .and_then(|number| crate::gnss::SatelliteId::new(constellation, number))
        .ok_or(Refusal::UnknownSatellite)
}
