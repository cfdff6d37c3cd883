//! The decoder of a byte stream.

use crate::formats::binary::{Clock, Ionosphere, Refusal, TimeReference};
use crate::formats::rtcm;
use crate::formats::ubx;
use crate::gnss::{Ephemeris, Epoch, GpsTime, LeapSeconds, Navigation};

use super::Station;
use super::assembly::{Assembly, Part, Rank};
use super::frames::{Frame, FrameBuffer, Scan};
use super::statistics::{MessageKind, Outcome, Statistics};

/// Number of bytes decoded in one step, which bounds the memory besides one frame.
const PIECE_BYTES: usize = 1 << 16;

/// Something that the stream has completed.
#[derive(Clone, Debug, PartialEq)]
pub enum Event {
    /// Observations of one epoch.
    Epoch(Epoch),
    /// An ephemeris; one issue is reported once, as long as it is the satellite's latest.
    Ephemeris(Ephemeris),
    /// Ionosphere coefficients that differ from the last reported ones.
    Ionosphere(Ionosphere),
    /// GPS time minus UTC (s), if it differs from the last reported value.
    LeapSeconds(i64),
    /// The station, each time a message adds to it or changes it.
    Station(Station),
}

impl Event {
    /// Adds the event to navigation data, if it holds any; returns whether it does.
    pub fn apply_to(&self, navigation: &mut Navigation) -> bool {
        match self {
            Self::Ephemeris(ephemeris) => navigation.insert(ephemeris.clone()),
            Self::Ionosphere(ionosphere) => {
                ionosphere.apply_to(navigation);
                true
            }
            Self::LeapSeconds(seconds) => {
                navigation.leap_seconds = LeapSeconds::with_broadcast(*seconds);
                true
            }
            Self::Epoch(_) | Self::Station(_) => false,
        }
    }
}

/// Decodes a stream of RTCM 3, UBX and NMEA in chunks.
///
/// ```
/// use graphfix_compute::formats::receiver::{Decoder, Event};
///
/// let frame = [
///     0xd3, 0x00, 0x13, 0x3e, 0xd7, 0xd3, 0x02, 0x02, 0x98, 0x0e, 0xde, 0xef, 0x34, 0xb4, 0xbd,
///     0x62, 0xac, 0x09, 0x41, 0x98, 0x6f, 0x33, 0x36, 0x0b, 0x98,
/// ];
/// let (mut decoder, mut events) = (Decoder::new(None), Vec::new());
/// decoder.push(&frame[..10], &mut events);
/// assert!(events.is_empty());
/// decoder.push(&frame[10..], &mut events);
/// decoder.finish(&mut events);
/// let [Event::Station(station)] = &events[..] else { panic!("{events:?}") };
/// assert_eq!(station.id, 2003);
/// let position = station.antenna_reference_point.expect("1005 has it");
/// assert!((position.0.x - 1_114_104.5999).abs() < 1e-4);
/// ```
#[derive(Debug)]
pub struct Decoder {
    frames: FrameBuffer,
    clock: Clock,
    rtcm: rtcm::Decoder,
    ubx: ubx::Decoder,
    assembly: Assembly,
    statistics: Statistics,
    is_in_garbage: bool,
}

impl Decoder {
    /// A decoder at the start of a stream; `reference` is used for streams without week number.
    pub fn new(reference: Option<TimeReference>) -> Self {
        Self {
            frames: FrameBuffer::new(),
            clock: Clock::new(reference),
            rtcm: rtcm::Decoder::new(),
            ubx: ubx::Decoder::new(),
            assembly: Assembly::default(),
            statistics: Statistics::default(),
            is_in_garbage: false,
        }
    }

    /// Adds known FDMA channels of GLONASS satellites, which some messages need.
    pub fn learn_channels(&mut self, navigation: &Navigation) {
        for (satellite, ephemerides) in navigation.satellites() {
            let channel = ephemerides.last().and_then(Ephemeris::glonass_channel);
            if let Some(channel) = channel {
                self.rtcm.set_glonass_channel(satellite.number, channel);
            }
        }
    }

    /// Decodes the next bytes and appends the completed events to `events`.
    pub fn push(&mut self, bytes: &[u8], events: &mut Vec<Event>) {
        for piece in bytes.chunks(PIECE_BYTES) {
            self.frames.push(piece);
            self.drain(false, events);
        }
    }

    /// Ends the stream and passes on what is incomplete.
    pub fn finish(&mut self, events: &mut Vec<Event>) {
        self.drain(true, events);
        events.extend(self.assembly.finish().map(Event::Epoch));
    }

    /// Counts of the stream so far.
    pub const fn statistics(&self) -> &Statistics {
        &self.statistics
    }

    /// Counts of the stream since the last call.
    pub(crate) fn take_statistics(&mut self) -> Statistics {
        std::mem::take(&mut self.statistics)
    }

    /// Sets a time within half a day of what follows, as after a gap without dated messages.
    pub(crate) fn date(&mut self, time: GpsTime) {
        self.clock.set(time);
    }

    /// The newest known time, from the reference or from the stream.
    pub(crate) const fn time(&self) -> Option<GpsTime> {
        self.clock.time()
    }

    fn drain(&mut self, is_end: bool, events: &mut Vec<Event>) {
        // The frames' bytes stay borrowed while the rest of the decoder changes.
        let mut frames = std::mem::replace(&mut self.frames, FrameBuffer::new());
        while let Some(scan) = frames.next(is_end) {
            match scan {
                Scan::Frame { at, frame } => {
                    self.is_in_garbage = false;
                    self.decode(at, frame, events);
                }
                Scan::Broken { at, is_ubx } => {
                    // The preamble of RTCM 3 is one byte and frequent outside its frames.
                    if is_ubx || !self.is_in_garbage {
                        self.statistics.refuse(None, Refusal::Checksum, at);
                    }
                    self.garbage(at, 1);
                }
                Scan::Garbage { at, length } => self.garbage(at, length as u64),
            }
        }
        self.frames = frames;
    }

    fn garbage(&mut self, at: u64, length: u64) {
        self.statistics.garbage(at, length, !self.is_in_garbage);
        self.is_in_garbage = true;
    }

    fn decode(&mut self, at: u64, frame: Frame<'_>, events: &mut Vec<Event>) {
        match frame {
            Frame::Rtcm(payload) => self.decode_rtcm(at, payload, events),
            Frame::Ubx { class, id, payload } => {
                self.assembly.expect_rawx();
                self.decode_ubx(at, (class, id), payload, events);
            }
            Frame::Nmea => self.statistics.count(MessageKind::Nmea, Outcome::PassedOver),
        }
    }

    fn decode_rtcm(&mut self, at: u64, payload: &[u8], events: &mut Vec<Event>) {
        // A frame without a message is a filler.
        let Some(number) = rtcm::message_number(payload) else { return };
        let kind = MessageKind::Rtcm(number);
        let Self { rtcm, clock, statistics, .. } = self;
        let mut notes = |refusal| statistics.refuse(Some(kind), refusal, at);
        let mut decoded = rtcm.decode(payload, clock, &mut notes);
        if let Ok(Some(rtcm::Message::OtherSystem { ends_epoch })) = decoded {
            let epoch = if ends_epoch { self.assembly.end() } else { None };
            events.extend(epoch.map(Event::Epoch));
            decoded = Err(Refusal::OtherConstellation);
        }
        let message = self.judge(kind, at, decoded);
        match message {
            Some(rtcm::Message::Observations(message)) => {
                let rank = if message.is_msm { Rank::Msm } else { Rank::Legacy };
                let part = Part {
                    rank,
                    station: message.station,
                    time: message.time,
                    more: message.more,
                    observations: message.observations,
                };
                self.assemble(kind, at, part, events);
            }
            Some(rtcm::Message::Ephemeris(ephemeris)) => events.push(Event::Ephemeris(ephemeris)),
            Some(rtcm::Message::Station(station)) => events.push(Event::Station(station)),
            Some(rtcm::Message::OtherSystem { .. } | rtcm::Message::Nothing) | None => {}
        }
    }

    fn decode_ubx(
        &mut self,
        at: u64,
        (class, id): (u8, u8),
        payload: &[u8],
        events: &mut Vec<Event>,
    ) {
        let kind = MessageKind::Ubx { class, id };
        let Self { ubx, clock, statistics, .. } = self;
        let mut notes = |refusal| statistics.refuse(Some(kind), refusal, at);
        let decoded = ubx.decode((class, id), payload, clock, &mut notes);
        match self.judge(kind, at, decoded) {
            Some(ubx::Message::Epoch { time, observations }) => {
                let part = Part { rank: Rank::Rawx, station: 0, time, more: false, observations };
                self.assemble(kind, at, part, events);
            }
            Some(ubx::Message::Broadcast(broadcast)) => self.tell(*broadcast, events),
            Some(ubx::Message::Nothing) | None => {}
        }
    }

    fn tell(&mut self, broadcast: ubx::Broadcast, events: &mut Vec<Event>) {
        if let Some(ephemeris) = broadcast.ephemeris {
            if let Some(channel) = ephemeris.glonass_channel() {
                self.rtcm.set_glonass_channel(ephemeris.satellite().number, channel);
            }
            events.push(Event::Ephemeris(ephemeris));
        }
        events.extend(broadcast.ionosphere.map(Event::Ionosphere));
        if let Some(seconds) = broadcast.leap_seconds {
            self.clock.set_leap_seconds(LeapSeconds::with_broadcast(seconds));
            events.push(Event::LeapSeconds(seconds));
        }
    }

    /// Counts a message and returns its content if it was decoded.
    fn judge<M>(
        &mut self,
        kind: MessageKind,
        at: u64,
        decoded: Result<Option<M>, Refusal>,
    ) -> Option<M> {
        let (message, outcome) = match decoded {
            Ok(Some(message)) => (Some(message), Outcome::Decoded),
            Ok(None) => (None, Outcome::PassedOver),
            Err(refusal) => {
                self.statistics.refuse(Some(kind), refusal, at);
                (None, Outcome::Refused)
            }
        };
        self.statistics.count(kind, outcome);
        message
    }

    fn assemble(&mut self, kind: MessageKind, at: u64, part: Part, events: &mut Vec<Event>) {
        let assembled = self.assembly.add(part);
        for _ in 0..assembled.duplicates {
            self.statistics.refuse(Some(kind), Refusal::DuplicateSignal, at);
        }
        if let Some(refusal) = assembled.refusal {
            self.statistics.refuse(Some(kind), refusal, at);
        }
        events.extend(assembled.epochs.into_iter().flatten().map(Event::Epoch));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formats::binary::crc24q;

    fn frame(payload: &[u8]) -> Vec<u8> {
        let mut frame = [&[0xd3, 0, payload.len() as u8], payload].concat();
        frame.extend_from_slice(&crc24q(&frame).to_be_bytes()[1..]);
        frame
    }

    /// Message 1084: L1 C/A and L2 C/A of GLONASS satellites 1 and 2, whose channels are unknown.
    fn glonass(ms: u64) -> Vec<u8> {
        let head = [(1084, 12), (7, 12), (2, 3), (ms, 27), (0, 19)];
        let masks = [(0b11, 2), (0, 62), (1 << 6 | 1, 8), (0, 24), (0b1111, 4)];
        let satellites = [(70, 8), (70, 8), (512, 10), (512, 10)];
        let signals = [[(0, 15); 4], [(0, 22); 4], [(15, 4); 4], [(0, 1); 4], [(40, 6); 4]];
        let fields = [&head[..], &masks, &satellites, signals.as_flattened()].concat();
        let bits: Vec<u8> = fields
            .into_iter()
            .flat_map(|(value, width): (u64, u32)| {
                (0..width).rev().map(move |bit| (value >> bit & 1) as u8)
            })
            .collect();
        let byte =
            |bits: &[u8]| bits.iter().fold(0, |byte, bit| byte << 1 | bit) << (8 - bits.len());
        frame(&bits.chunks(8).map(byte).collect::<Vec<u8>>())
    }

    /// A frame is listed once, by the offset of its first byte, however the stream is split.
    #[test]
    fn left_out_signals_are_found_at_their_frames() {
        let station = frame(&[
            0x3e, 0xd7, 0xd3, 0x02, 0x02, 0x98, 0x0e, 0xde, 0xef, 0x34, 0xb4, 0xbd, 0x62, 0xac,
            0x09, 0x41, 0x98, 0x6f, 0x33,
        ]);
        let mut broken = station.clone();
        broken[9] ^= 1;
        let (mut bytes, mut starts) = (Vec::new(), Vec::new());
        for second in 0..13 {
            starts.push(bytes.len() as u64);
            bytes.extend(glonass(1000 * second));
            bytes.extend_from_slice(&station);
        }
        let broken_at = bytes.len() as u64;
        bytes.extend(broken);
        let reference = TimeReference::Day(GpsTime::from_week_seconds(2100, 2.0 * 86_400.0));
        for length in [1, 7, 64, bytes.len()] {
            let (mut decoder, mut events) = (Decoder::new(Some(reference)), Vec::new());
            bytes.chunks(length).for_each(|chunk| decoder.push(chunk, &mut events));
            decoder.finish(&mut events);
            let epochs = events.iter().filter(|event| matches!(event, Event::Epoch(_))).count();
            assert_eq!(epochs, 13, "{length}");
            let [channel, checksum] = decoder.statistics().refusals() else {
                panic!("{:?}", decoder.statistics())
            };
            assert_eq!(channel.reason, Refusal::UnknownChannel);
            assert_eq!(channel.kind, Some(MessageKind::Rtcm(1084)));
            assert_eq!((channel.count, channel.has_more), (13 * 4, true));
            assert_eq!(channel.offsets, starts[..10], "{length}");
            assert_eq!(checksum.reason, Refusal::Checksum);
            assert_eq!(checksum.offsets, [broken_at], "{length}");
        }
    }
}
