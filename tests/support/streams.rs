//! Streams for the tests of the decoders: built bit by bit, read from logs, damaged, and compared.

use std::path::Path;
use std::process::{Command, Stdio};

use graphfix::formats::receiver::{Decoder, Event, MessageKind, Statistics, TimeReference};
use graphfix::formats::rinex::read_navigation;
use graphfix::gnss::{
    Ephemeris, Epoch, GpsTime, GroupDelays, KeplerianEphemeris, Navigation, Observation,
    SatelliteId,
};

/// Writes fields, most significant bit first.
#[derive(Clone, Default)]
pub(crate) struct BitWriter {
    bits: Vec<bool>,
}

impl BitWriter {
    pub(crate) fn unsigned(&mut self, width: u32, value: u64) -> &mut Self {
        assert!(width == 64 || value < 1 << width, "{value} in {width} bits");
        self.bits.extend((0..width).rev().map(|bit| value >> bit & 1 == 1));
        self
    }

    pub(crate) fn signed(&mut self, width: u32, value: i64) -> &mut Self {
        let limit = 1_i64 << (width - 1);
        assert!((-limit..limit).contains(&value), "{value} in {width} bits");
        self.unsigned(width, value as u64 & (u64::MAX >> (64 - width)))
    }

    pub(crate) fn bytes(&self) -> Vec<u8> {
        let byte = |bits: &[bool]| {
            bits.iter().enumerate().fold(0, |byte, (at, bit)| byte | u8::from(*bit) << (7 - at))
        };
        self.bits.chunks(8).map(byte).collect()
    }
}

/// CRC-24Q, bit by bit.
fn crc24q(bytes: &[u8]) -> u32 {
    bytes.iter().fold(0, |crc, byte| {
        (0..8).fold(crc ^ u32::from(*byte) << 16, |crc, _| {
            let shifted = crc << 1;
            if shifted & 0x100_0000 == 0 { shifted } else { shifted ^ 0x186_4cfb }
        })
    })
}

pub(crate) fn rtcm_frame(payload: &[u8]) -> Vec<u8> {
    let mut frame = vec![0xd3, (payload.len() >> 8) as u8, payload.len() as u8];
    frame.extend_from_slice(payload);
    frame.extend_from_slice(&crc24q(&frame).to_be_bytes()[1..]);
    frame
}

/// The frame of RTCM 3 message 1019 for a GPS ephemeris; RTCM 10403.3, table 3.5-21.
pub(crate) fn ephemeris_frame(e: &KeplerianEphemeris) -> Vec<u8> {
    let semicircles = |rad: f64| rad / std::f64::consts::PI;
    let scaled = |value: f64, power: i32| (value * 2f64.powi(power)).round() as i64;
    let angle = |rad: f64, power: i32| scaled(semicircles(rad), power);
    let in_week = |time: GpsTime| (time.as_ns() / 1_000_000_000 % 604_800 / 16) as u64;
    let GroupDelays::Gps { tgd_s, .. } = e.group_delays else { panic!("a GPS ephemeris") };
    let week = (e.toe.as_ns() / 1_000_000_000 / 604_800 % 1024) as u64;
    let mut bits = BitWriter::default();
    bits.unsigned(12, 1019).unsigned(6, e.satellite.number.into()).unsigned(10, week);
    bits.unsigned(4, 0).unsigned(2, 0);
    bits.signed(14, angle(e.idot_rad_s, 43)).unsigned(8, u64::from(e.iode) & 0xff);
    bits.unsigned(16, in_week(e.toc)).signed(8, scaled(e.af2_per_s, 55));
    bits.signed(16, scaled(e.af1, 43)).signed(22, scaled(e.af0_s, 31));
    bits.unsigned(10, u64::from(e.iodc) & 0x3ff).signed(16, scaled(e.crs_m, 5));
    bits.signed(16, angle(e.delta_n_rad_s, 43)).signed(32, angle(e.m0_rad, 31));
    bits.signed(16, scaled(e.cuc_rad, 29)).unsigned(32, scaled(e.eccentricity, 33) as u64);
    bits.signed(16, scaled(e.cus_rad, 29)).unsigned(32, scaled(e.sqrt_a, 19) as u64);
    bits.unsigned(16, in_week(e.toe)).signed(16, scaled(e.cic_rad, 29));
    bits.signed(32, angle(e.omega0_rad, 31)).signed(16, scaled(e.cis_rad, 29));
    bits.signed(32, angle(e.i0_rad, 31)).signed(16, scaled(e.crc_m, 5));
    bits.signed(32, angle(e.omega_rad, 31)).signed(24, angle(e.omega_dot_rad_s, 43));
    bits.signed(8, scaled(tgd_s, 31)).unsigned(6, e.health.into()).unsigned(2, 0);
    rtcm_frame(&bits.bytes())
}

pub(crate) fn ubx_frame(class: u8, id: u8, payload: &[u8]) -> Vec<u8> {
    let length = (payload.len() as u16).to_le_bytes();
    let mut frame = vec![0xb5, 0x62, class, id, length[0], length[1]];
    frame.extend_from_slice(payload);
    let sums = frame[2..].iter().fold((0_u8, 0_u8), |(a, b), byte| {
        let a = a.wrapping_add(*byte);
        (a, b.wrapping_add(a))
    });
    frame.extend([sums.0, sums.1]);
    frame
}

/// Payloads of the RTCM 3 frames of a stream.
pub(crate) fn rtcm_payloads(bytes: &[u8]) -> Vec<Vec<u8>> {
    let mut payloads = Vec::new();
    let mut at = 0;
    while at + 6 <= bytes.len() {
        let length = usize::from(bytes[at + 1] & 3) << 8 | usize::from(bytes[at + 2]);
        let frame = bytes.get(at..at + length + 6);
        match frame.filter(|frame| frame[0] == 0xd3 && frame[1] & 0xfc == 0 && crc24q(frame) == 0) {
            Some(frame) => {
                payloads.push(frame[3..length + 3].to_vec());
                at += frame.len();
            }
            None => at += 1,
        }
    }
    payloads
}

/// The number of an RTCM 3 message.
pub(crate) fn message_number(payload: &[u8]) -> u16 {
    u16::from(payload[0]) << 4 | u16::from(payload[1]) >> 4
}

/// Message 1005 or 1006 with its x moved by this many tenths of millimetres.
pub(crate) fn moved_station(payload: &[u8], by: i64) -> Vec<u8> {
    let bits = payload.iter().flat_map(|byte| (0..8).rev().map(move |bit| byte >> bit & 1 == 1));
    let mut bits: Vec<bool> = bits.collect();
    let x = bits[34..72].iter().fold(0_i64, |x, bit| x << 1 | i64::from(*bit));
    for (place, bit) in bits[34..72].iter_mut().rev().enumerate() {
        *bit = (x + by) >> place & 1 == 1;
    }
    BitWriter { bits }.bytes()
}

/// A week and second of it.
pub(crate) fn at(week: i32, second: f64) -> GpsTime {
    GpsTime::from_week_seconds(week, second)
}

/// The decoded content of a stream that is pushed in chunks of `piece` bytes.
pub(crate) fn decode_in_pieces(
    bytes: &[u8],
    reference: Option<TimeReference>,
    piece: usize,
) -> (Vec<Event>, Statistics) {
    let mut decoder = Decoder::new(reference);
    let mut events = Vec::new();
    for piece in bytes.chunks(piece) {
        decoder.push(piece, &mut events);
    }
    decoder.finish(&mut events);
    (events, decoder.statistics().clone())
}

pub(crate) fn decode(bytes: &[u8], reference: Option<TimeReference>) -> (Vec<Event>, Statistics) {
    decode_in_pieces(bytes, reference, 1 << 16)
}

pub(crate) fn epochs(events: Vec<Event>) -> Vec<Epoch> {
    let epoch = |event| match event {
        Event::Epoch(epoch) => Some(epoch),
        _ => None,
    };
    events.into_iter().filter_map(epoch).collect()
}

pub(crate) fn navigation(events: &[Event]) -> Navigation {
    let mut navigation = Navigation::default();
    for event in events {
        event.apply_to(&mut navigation);
    }
    navigation
}

/// The messages of a stream that are of the kinds `named` keeps, as `kind: count` with commas.
pub(crate) fn counts(statistics: &Statistics, named: impl Fn(MessageKind) -> bool) -> String {
    let counted = statistics.messages().filter(|(kind, _)| named(*kind));
    let texts: Vec<String> =
        counted.map(|(kind, count)| format!("{kind}: {}", count.total())).collect();
    texts.join(", ")
}

pub(crate) fn rinex_navigation(bytes: &[u8]) -> Navigation {
    read_navigation(bytes).unwrap().0
}

/// Whether RTKLIB's `convbin` can be called.
pub(crate) fn has_convbin() -> bool {
    let tried = Command::new("convbin").stdout(Stdio::null()).stderr(Stdio::null()).status();
    if tried.is_err() {
        super::data::note_missing("program convbin of RTKLIB");
    }
    tried.is_ok()
}

/// Observation and navigation file that `convbin` makes of a stream; either may be empty.
pub(crate) fn convbin(bytes: &[u8], format: &str, start: Option<&str>) -> (Vec<u8>, Vec<u8>) {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str| folder.path().join(name);
    std::fs::write(file("stream"), bytes).unwrap();
    let mut command = Command::new("convbin");
    command.args(["-r", format, "-v", "3.04", "-od", "-os", "-f", "7"]);
    if let Some(start) = start {
        command.arg("-tr").args(start.split(' '));
    }
    let status = command
        .arg("-o")
        .arg(file("obs"))
        .arg("-n")
        .arg(file("nav"))
        .arg(file("stream"))
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .status();
    assert!(status.unwrap().success(), "convbin failed");
    let read = |name: &str| std::fs::read(file(name)).unwrap_or_default();
    (read("obs"), read("nav"))
}

/// Time tags that differ by less belong to one epoch (s).
const SAME_EPOCH_S: f64 = 0.004;

/// The result of a comparison of epochs.
#[derive(Debug, Default, PartialEq, Eq)]
pub(crate) struct Agreement {
    /// Epochs in both.
    pub(crate) epochs: usize,
    /// Observations in both.
    pub(crate) observations: usize,
    /// Observations of common epochs that only the first has, and only the second.
    pub(crate) only: [usize; 2],
    /// Carrier phases that only the first has.
    pub(crate) more_phases: usize,
    /// Phases whose indicators (loss of lock, half cycle) differ.
    pub(crate) flags: usize,
}

/// Compares our epochs with those of a RINEX file, to the last digit of the file. Panics if a value
/// differs.
///
/// If the other epoch does not have a code, another code of its band is used: RINEX files of
/// receivers that track pilot and data call both X, or contain one of them.
pub(crate) fn compare(ours: &[Epoch], theirs: &[Epoch]) -> Agreement {
    let mut agreement = Agreement::default();
    let mut ours = ours.iter().peekable();
    for epoch in theirs {
        while ours.next_if(|o| o.time - epoch.time < -SAME_EPOCH_S).is_some() {}
        let Some(own) = ours.next_if(|o| (o.time - epoch.time).abs() < SAME_EPOCH_S) else {
            continue;
        };
        agreement.epochs += 1;
        let mut matched = 0;
        for theirs in &epoch.observations {
            let of_satellite =
                || own.observations.iter().filter(|o| o.satellite == theirs.satellite);
            let same = of_satellite().find(|o| o.code == theirs.code);
            let band = theirs.code.band_digit();
            match same.or_else(|| of_satellite().find(|o| o.code.band_digit() == band)) {
                Some(own) => {
                    matched += 1;
                    compare_observation(epoch.time, own, theirs, &mut agreement);
                }
                None => agreement.only[1] += 1,
            }
        }
        agreement.observations += matched;
        agreement.only[0] += own.observations.len() - matched;
    }
    agreement
}

fn compare_observation(
    time: GpsTime,
    ours: &Observation,
    theirs: &Observation,
    agreement: &mut Agreement,
) {
    // Half of the last digit, and rounding errors of reading and adding.
    let digit = |value: f64| 0.0005 + value.abs() * 1e-15 + 1e-9;
    let values = [
        (ours.pseudorange_m, theirs.pseudorange_m, 0.0),
        (ours.carrier_phase.map(|c| c.0), theirs.carrier_phase.map(|c| c.0), 0.0),
        // RTKLIB keeps Doppler in single precision.
        (ours.doppler_hz, theirs.doppler_hz, 6e-8),
        (ours.cn0_db_hz, theirs.cn0_db_hz, 0.0),
    ];
    for (index, (own, other, relative)) in values.into_iter().enumerate() {
        match (own, other) {
            (Some(own), Some(other)) => assert!(
                (own - other).abs() <= digit(other) + relative * other.abs(),
                "{time} {} {}: {own}, RINEX {other}",
                ours.satellite,
                ours.code
            ),
            (Some(_), None) if index == 1 => agreement.more_phases += 1,
            (own, other) => {
                assert_eq!(own, other, "{time} {} {} {index}", ours.satellite, ours.code);
            }
        }
    }
    if ours.carrier_phase.is_some() && theirs.carrier_phase.is_some() {
        let flags = |o: &Observation| (o.loss_of_lock, o.half_cycle);
        agreement.flags += usize::from(flags(ours) != flags(theirs));
    }
}

/// Asserts that all ephemerides of a RINEX file agree with ours, to its twelve digits; returns
/// their number.
///
/// Not compared are times of transmission, for which RTKLIB writes other values; the fit interval
/// of QZSS, which it writes as 1; and the bit of the GLONASS health for l_n, which RINEX 3.04 does
/// not have.
pub(crate) fn compare_ephemerides(ours: &Navigation, theirs: &Navigation) -> usize {
    for (satellite, list) in theirs.satellites() {
        for other in list {
            let own = ours.of(satellite).iter().find(|own| is_same_issue(own, other));
            let own = own.unwrap_or_else(|| panic!("{satellite} {} missing", other.toe()));
            for (index, (own, other)) in numbers(own).into_iter().zip(numbers(other)).enumerate() {
                assert!(
                    (own - other).abs() <= 5.1e-12 * other.abs() + 1e-25,
                    "{satellite} number {index}: {own:e}, RINEX {other:e}"
                );
            }
        }
    }
    theirs.len()
}

fn is_same_issue(a: &Ephemeris, b: &Ephemeris) -> bool {
    a.toe() == b.toe()
        && a.toc() == b.toc()
        && match (a, b) {
            (Ephemeris::Keplerian(a), Ephemeris::Keplerian(b)) => {
                (a.iode, a.message) == (b.iode, b.message)
            }
            (Ephemeris::Glonass(_), Ephemeris::Glonass(_)) => true,
            _ => false,
        }
}

fn numbers(ephemeris: &Ephemeris) -> Vec<f64> {
    match ephemeris {
        Ephemeris::Keplerian(e) => {
            let delays = match e.group_delays {
                GroupDelays::Gps { tgd_s, .. } => [tgd_s, 0.0],
                GroupDelays::Galileo { bgd_e5a_s, bgd_e5b_s } => {
                    [bgd_e5a_s, bgd_e5b_s.unwrap_or(0.0)]
                }
                GroupDelays::BeiDou { tgd1_s, tgd2_s } => [tgd1_s, tgd2_s],
                GroupDelays::BeiDouCnav { .. } => panic!("no stream has it"),
            };
            let is_qzss = e.satellite.to_string().starts_with('J');
            let fit_h = e.fit_interval_h.filter(|_| !is_qzss);
            let mut numbers = vec![e.af0_s, e.af1, e.af2_per_s, e.sqrt_a, e.eccentricity, e.m0_rad];
            numbers.extend([e.delta_n_rad_s, e.omega_rad, e.omega0_rad, e.omega_dot_rad_s]);
            numbers.extend([e.i0_rad, e.idot_rad_s, e.cuc_rad, e.cus_rad, e.crc_m, e.crs_m]);
            numbers.extend([e.cic_rad, e.cis_rad, e.iodc.into(), e.health.into()]);
            numbers.extend([e.accuracy_m.unwrap_or(-1.0), fit_h.unwrap_or(-1.0)]);
            numbers.extend(delays);
            numbers
        }
        Ephemeris::Glonass(e) => {
            let mut numbers: Vec<f64> = e.position_m.iter().copied().collect();
            numbers.extend(e.velocity_m_s.iter());
            numbers.extend(e.acceleration_m_s2.iter());
            numbers.extend([e.clock_bias_s, e.gamma, f64::from(e.channel)]);
            numbers.extend([f64::from(e.health & 1), f64::from(e.age_days)]);
            numbers
        }
    }
}

pub(crate) fn satellite(name: &str) -> SatelliteId {
    name.parse().unwrap()
}

/// Pseudo-random numbers by xorshift64 (Marsaglia 2003).
pub(crate) struct Random(u64);

impl Random {
    pub(crate) const fn new(seed: u64) -> Self {
        Self(seed)
    }

    pub(crate) fn below(&mut self, limit: usize) -> usize {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 % limit as u64) as usize
    }
}

/// Number of bytes that each mutation test decodes; `GRAPHFIX_MUTATED_BYTES` sets a larger one.
pub(crate) fn mutated_bytes() -> usize {
    let asked = std::env::var("GRAPHFIX_MUTATED_BYTES").ok();
    asked.map_or(2_000_000, |text| text.parse().expect("a number of bytes"))
}

/// Damages bytes at random positions: flipped, replaced, dropped, doubled, cut.
pub(crate) fn mutate(bytes: &mut Vec<u8>, random: &mut Random) {
    for _ in 0..1 + random.below(8) {
        if bytes.len() < 2 {
            return;
        }
        let place = random.below(bytes.len());
        match random.below(6) {
            0 => bytes[place] ^= 1 << random.below(8),
            1 => bytes[place] = random.below(256) as u8,
            2 => drop(bytes.remove(place)),
            3 => bytes.insert(place, bytes[random.below(place + 1)]),
            4 => bytes.truncate(place),
            _ => bytes[place] = [0, 0xff, 0x7f, 0x80][random.below(4)],
        }
    }
}

/// The bytes of a file, unpacked.
pub(crate) fn unpacked(path: &Path) -> Vec<u8> {
    let packed = std::fs::read(path).unwrap();
    let mut bytes = Vec::new();
    std::io::Read::read_to_end(&mut graphfix::formats::decompress(packed.as_slice()), &mut bytes)
        .unwrap();
    bytes
}
