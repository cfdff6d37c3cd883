//! UBX messages of u-blox receivers: RXM-RAWX, RXM-SFRBX, and the times of NAV-PVT and NAV-TIMEGPS.
//! Frames belong to the `receiver` module; all other messages are skipped.
//!
//! Subframes are decoded here: LNAV of GPS and QZSS, I/NAV of Galileo, D1 and D2 of BeiDou, strings
//! of GLONASS. Each is checked by its own code. An ephemeris is complete once all of its parts are
//! present and agree on their issue. F/NAV, CNAV and B-CNAV subframes are skipped: the same
//! satellites send the decoded messages.
//!
//! The crate `ublox` would replace only the framing and two fixed layouts, some three hundred
//! lines, so it is not used.
//!
//! Sources: u-blox, *ZED-F9P Interface Description*, UBX-22008968, 3.17; *u-blox 8 / M8 Receiver
//! description*, UBX-13003221, 10 and 32; the signals' ICDs where they are decoded.

mod beidou;
mod broadcast;
mod galileo;
mod glonass;
mod lnav;
mod rawx;
mod rawx_writer;
mod sfrbx;

use crate::formats::binary::{Clock, Refusal};
use crate::gnss::{CivilTime, GpsTime, LeapSeconds, Observation, TimeScale};

pub(in crate::formats) use broadcast::Broadcast;
use rawx::RawxState;
pub use rawx_writer::RawxWriter;
use sfrbx::Subframes;

/// The content of a message.
#[derive(Debug)]
pub(in crate::formats) enum Message {
    Epoch {
        time: GpsTime,
        observations: Vec<Observation>,
    },
    Broadcast(Box<Broadcast>),
    /// The message adds nothing to what is known.
    Nothing,
}

/// Receives the reason for each part of a message that is left out.
pub(in crate::formats) type Notes<'a> = &'a mut dyn FnMut(Refusal);

/// State of the decoder between messages.
#[derive(Debug)]
pub(in crate::formats) struct Decoder {
    rawx: RawxState,
    subframes: Subframes,
}

impl Decoder {
    pub(in crate::formats) fn new() -> Self {
        Self { rawx: RawxState::new(), subframes: Subframes::default() }
    }

    /// Decodes the payload of a frame; `None` for messages that are not decoded.
    pub(in crate::formats) fn decode(
        &mut self,
        class_and_id: (u8, u8),
        payload: &[u8],
        clock: &mut Clock,
        notes: Notes<'_>,
    ) -> Result<Option<Message>, Refusal> {
        match class_and_id {
            (0x02, 0x15) => {
                let (time, observations) = self.rawx.decode(payload, notes)?;
                clock.set(time);
                // Before its first lock a receiver sends epochs without measurements.
                Ok(Some(match observations.is_empty() {
                    true => Message::Nothing,
                    false => Message::Epoch { time, observations },
                }))
            }
            (0x02, 0x13) => {
                let broadcast = self.subframes.decode(payload, clock)?;
                Ok(broadcast.map(Box::new).map(Message::Broadcast))
            }
            (0x01, 0x07) => {
                if let Some(time) = time_of_pvt(payload)? {
                    clock.set(time);
                }
                Ok(Some(Message::Nothing))
            }
            (0x01, 0x20) => {
                if let Some(time) = time_of_timegps(payload)? {
                    clock.set(time);
                }
                Ok(Some(Message::Nothing))
            }
            _ => Ok(None),
        }
    }
}

/// Reads `N` bytes of a payload.
fn field<const N: usize>(payload: &[u8], at: usize) -> Result<[u8; N], Refusal> {
    let field = payload.get(at..).and_then(|rest| rest.first_chunk::<N>());
    field.copied().ok_or(Refusal::Truncated)
}

/// The time of NAV-PVT, if date and time of day are valid and fully resolved.
fn time_of_pvt(payload: &[u8]) -> Result<Option<GpsTime>, Refusal> {
    const VALID: u8 = 0b111;
    let [month, day, hour, minute, second, valid] = field(payload, 6)?;
    if valid & VALID != VALID {
        return Ok(None);
    }
    let year = i32::from(u16::from_le_bytes(field(payload, 4)?));
    let civil = CivilTime { year, month, day, hour, minute, second, nanosecond: 0 };
    let time = GpsTime::from_civil(&civil, TimeScale::Utc, &LeapSeconds::table());
    time.ok_or(Refusal::InvalidTime).map(Some)
}

/// The time of NAV-TIMEGPS, if week and time of week are valid.
fn time_of_timegps(payload: &[u8]) -> Result<Option<GpsTime>, Refusal> {
    const VALID: u8 = 0b011;
    let ms = u32::from_le_bytes(field(payload, 0)?);
    let week = i16::from_le_bytes(field(payload, 8)?);
    let [valid] = field(payload, 11)?;
    if valid & VALID != VALID {
        return Ok(None);
    }
    let ns = i64::from(ms) * 1_000_000;
    GpsTime::from_week_ns(i32::from(week), ns).ok_or(Refusal::InvalidTime).map(Some)
}
