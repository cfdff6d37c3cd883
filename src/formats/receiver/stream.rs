//! The decoder of a stream.

use crate::formats::binary::{Clock, Ionosphere, Refusal, TimeReference};
use crate::formats::rtcm;
use crate::formats::ubx;
use crate::gnss::{Ephemeris, Epoch, GpsTime, LeapSeconds, Navigation};

use super::Station;
use super::assembly::{Assembly, Part, Rank};
use super::frames::{Frame, FrameBuffer, Scan};
use super::statistics::{MessageKind, Outcome, Statistics};

/// How much is looked at together, which bounds what is held beside a frame (bytes).
const PIECE_BYTES: usize = 1 << 16;

/// What a stream told.
#[derive(Clone, Debug, PartialEq)]
pub enum Event {
    /// Observations of one epoch.
    Epoch(Epoch),
    /// An ephemeris, each issue once for as long as it is the satellite's latest.
    Ephemeris(Ephemeris),
    /// Ionosphere coefficients, where they are not those told before.
    Ionosphere(Ionosphere),
    /// GPS time minus UTC (s), where it is not what was told before.
    LeapSeconds(i64),
    /// The station, each time that more or something else is known of it.
    Station(Station),
}

impl Event {
    /// Adds to navigation data what the event has for them; returns whether it has.
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

/// Decodes a stream of RTCM 3, UBX and NMEA, piece by piece.
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
    /// A decoder at the start of a stream; `reference` serves streams that do not tell the week.
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

    /// Tells the FDMA channels of GLONASS satellites, which some messages presuppose.
    pub fn learn_channels(&mut self, navigation: &Navigation) {
        for (satellite, ephemerides) in navigation.satellites() {
            let channel = ephemerides.last().and_then(Ephemeris::glonass_channel);
            if let Some(channel) = channel {
                self.rtcm.set_glonass_channel(satellite.number, channel);
            }
        }
    }

    /// Decodes the next bytes; what they complete is added to `events`.
    pub fn push(&mut self, bytes: &[u8], events: &mut Vec<Event>) {
        for piece in bytes.chunks(PIECE_BYTES) {
            self.frames.push(piece);
            self.drain(false, events);
        }
    }

    /// Ends the stream: what is incomplete is taken as it is.
    pub fn finish(&mut self, events: &mut Vec<Event>) {
        self.drain(true, events);
        events.extend(self.assembly.finish().map(Event::Epoch));
    }

    /// What the stream held so far.
    pub const fn statistics(&self) -> &Statistics {
        &self.statistics
    }

    /// What the stream held since this was last asked for.
    pub fn take_statistics(&mut self) -> Statistics {
        std::mem::take(&mut self.statistics)
    }

    /// Tells a time within half a day of what comes, as after a gap that the stream does not tell.
    pub fn date(&mut self, time: GpsTime) {
        self.clock.set(time);
    }

    /// The newest time known: the reference's, or one the stream told.
    pub const fn time(&self) -> Option<GpsTime> {
        self.clock.time()
    }

    fn drain(&mut self, is_end: bool, events: &mut Vec<Event>) {
        // The frames' bytes are read while the rest of the decoder changes.
        let mut frames = std::mem::replace(&mut self.frames, FrameBuffer::new());
        while let Some(scan) = frames.next(is_end) {
            match scan {
                Scan::Frame { at, frame } => {
                    self.is_in_garbage = false;
                    self.decode(at, frame, events);
                }
                Scan::Broken { at, is_ubx } => {
                    // A preamble of RTCM 3 is one byte, common in what is none of its frames.
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
        // A frame without a message fills time where nothing is to be said.
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

    /// Counts a message; what it says, if it was decoded.
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
