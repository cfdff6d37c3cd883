//! RTCM 3: frames built bit by bit, real streams against other decoders, and damage.

use std::path::PathBuf;

use proptest::prelude::*;

use graphfix::formats::receiver::{Event, MessageKind, Refusal, TimeReference};
use graphfix::gnss::constants::SPEED_OF_LIGHT;
use graphfix::gnss::{Constellation, Ephemeris, Epoch};

use crate::support::data;
use crate::support::reading::epochs_of;
use crate::support::streams::{
    self, BitWriter, Random, at, counts, decode, decode_in_pieces, epochs, rtcm_frame,
    rtcm_payloads,
};

const LIGHT_MS_M: f64 = SPEED_OF_LIGHT * 1e-3;

/// A signal of a message that is to be built.
#[derive(Clone, Copy)]
struct Cell {
    satellite: u32,
    signal: u32,
    fine_range: i64,
    fine_phase: i64,
    lock: u64,
    half_cycle: u64,
    cn0: u64,
    fine_rate: i64,
}

const PLAIN: Cell = Cell {
    satellite: 5,
    signal: 2,
    fine_range: 1000,
    fine_phase: -2000,
    lock: 9,
    half_cycle: 0,
    cn0: 40,
    fine_rate: 123,
};

/// A multiple signal message: satellites with 70 whole and 512/1024 light-milliseconds and a rough
/// rate of −250 m/s, and `cells`, which must make a full grid or be its diagonal.
fn msm(number: u16, epoch: u64, more: bool, cells: &[Cell]) -> Vec<u8> {
    let level = number % 10;
    let mut satellites: Vec<u32> = cells.iter().map(|cell| cell.satellite).collect();
    satellites.dedup();
    let mut signals: Vec<u32> = cells.iter().map(|cell| cell.signal).collect();
    signals.sort_unstable();
    signals.dedup();
    let mut bits = BitWriter::default();
    bits.unsigned(12, number.into()).unsigned(12, 77).unsigned(30, epoch);
    bits.unsigned(1, more.into()).unsigned(3 + 7 + 2 + 2 + 1 + 3, 0);
    bits.unsigned(64, satellites.iter().fold(0, |mask, number| mask | 1 << (64 - number)));
    bits.unsigned(32, signals.iter().fold(0, |mask, number| mask | 1 << (32 - number)));
    for satellite in &satellites {
        for signal in &signals {
            let is = |cell: &Cell| (cell.satellite, cell.signal) == (*satellite, *signal);
            bits.unsigned(1, cells.iter().any(is).into());
        }
    }
    let rows = satellites.len();
    let has_rates = level == 5 || level == 7;
    for _ in 0..rows {
        bits.unsigned(8, 70);
    }
    if has_rates {
        // The channel −2 for GLONASS, reserved for the others.
        for _ in 0..rows {
            bits.unsigned(4, 5);
        }
    }
    for _ in 0..rows {
        bits.unsigned(10, 512);
    }
    if has_rates {
        for _ in 0..rows {
            bits.signed(14, -250);
        }
    }
    let widths = if level < 6 { [15, 22, 4, 6] } else { [20, 24, 10, 10] };
    for cell in cells {
        bits.signed(widths[0], cell.fine_range);
    }
    for cell in cells {
        bits.signed(widths[1], cell.fine_phase);
    }
    for cell in cells {
        bits.unsigned(widths[2], cell.lock);
    }
    for cell in cells {
        bits.unsigned(1, cell.half_cycle);
    }
    for cell in cells {
        bits.unsigned(widths[3], cell.cn0);
    }
    if has_rates {
        for cell in cells {
            bits.signed(15, cell.fine_rate);
        }
    }
    rtcm_frame(&bits.bytes())
}

fn day(week: i32, second: f64) -> Option<TimeReference> {
    Some(TimeReference::Day(at(week, second)))
}

fn read(bytes: &[u8], reference: Option<TimeReference>) -> Vec<Epoch> {
    epochs(decode(bytes, reference).0)
}

#[test]
fn values_of_all_levels_are_those_written() {
    for (number, range_units, phase_units, cn0) in
        [(1074, 24, 29, 40.0), (1075, 24, 29, 40.0), (1076, 29, 31, 2.5), (1077, 29, 31, 2.5)]
    {
        let frame = msm(number, 345_600_000, false, &[PLAIN]);
        let found = read(&frame, day(2100, 345_000.0));
        assert_eq!(found[0].time, at(2100, 345_600.0));
        let [observation] = found[0].observations[..] else { panic!("{number}") };
        assert_eq!(observation.satellite.to_string(), "G05");
        assert_eq!(observation.code.to_string(), "1C");
        let exp2 = |n: i32| f64::from(n).exp2();
        let range_m = (70.5 + 1000.0 / exp2(range_units)) * LIGHT_MS_M;
        assert!((observation.pseudorange_m.unwrap() - range_m).abs() < 1e-6);
        let cycles = (70.5 - 2000.0 / exp2(phase_units)) * 1_575_420.0;
        assert!((observation.carrier_phase.unwrap().0 - cycles).abs() < 1e-6);
        assert_eq!(observation.cn0_db_hz, Some(cn0));
        let hz = (250.0 - 0.0123) * 1_575_420_000.0 / SPEED_OF_LIGHT;
        let has_rate = number % 2 == 1;
        assert_eq!(observation.doppler_hz.is_some(), has_rate, "{number}");
        assert!(observation.doppler_hz.is_none_or(|found| (found - hz).abs() < 1e-6));
        assert!(observation.loss_of_lock && !observation.half_cycle);
    }
}

#[test]
fn a_message_of_many_cells_keeps_them_apart() {
    let grid: Vec<Cell> = [3, 30]
        .into_iter()
        .flat_map(|satellite| {
            [2, 10, 23].map(|signal| Cell {
                satellite,
                signal,
                fine_range: i64::from(satellite * 100 + signal),
                half_cycle: u64::from(signal == 10),
                ..PLAIN
            })
        })
        .collect();
    let found = read(&msm(1077, 0, false, &grid), day(2100, 0.0));
    let named: Vec<String> = found[0]
        .observations
        .iter()
        .map(|o| format!("{}{}{}", o.satellite, o.code, u8::from(o.half_cycle)))
        .collect();
    assert_eq!(named, ["G031C0", "G032W1", "G035Q0", "G301C0", "G302W1", "G305Q0"]);
    let ranges = found[0].observations.iter().zip(&grid);
    for (observation, cell) in ranges {
        let fine_m = cell.fine_range as f64 * 2_f64.powi(-29) * LIGHT_MS_M;
        assert!((observation.pseudorange_m.unwrap() - 70.5 * LIGHT_MS_M - fine_m).abs() < 1e-6);
    }
}

/// Missing values stay missing, and an unknown signal does not affect the others.
#[test]
fn what_is_missing_or_unknown_costs_no_more_than_itself() {
    let known = Cell { signal: 2, ..PLAIN };
    let unknown = Cell { signal: 6, ..PLAIN };
    let without_range = Cell { signal: 15, fine_range: -(1 << 19), ..PLAIN };
    let without_phase =
        Cell { signal: 22, fine_phase: -(1 << 23), fine_rate: -(1 << 14), cn0: 0, ..PLAIN };
    let cells = [known, unknown, without_range, without_phase];
    let (events, statistics) = decode(&msm(1117, 1000, false, &cells), day(2100, 0.0));
    let found = epochs(events);
    let [l1, l2, l5] = found[0].observations[..] else { panic!("{found:?}") };
    assert_eq!([l1, l2, l5].map(|o| o.signal().to_string()), ["J1C", "J2S", "J5I"]);
    assert!(l1.pseudorange_m.is_some() && l1.carrier_phase.is_some());
    assert!(l2.pseudorange_m.is_none() && l2.carrier_phase.is_some());
    assert!(l5.pseudorange_m.is_some() && l5.carrier_phase.is_none());
    assert!(l5.doppler_hz.is_none() && l5.cn0_db_hz.is_none() && !l5.loss_of_lock);
    let reason = Refusal::UnknownSignal { constellation: Constellation::Qzss, index: 6 };
    assert_eq!(statistics.refused_for(reason), 1);
    assert_eq!(statistics.of(MessageKind::Rtcm(1117)).decoded, 1);
}

#[test]
fn weeks_days_and_scales_meet_in_one_epoch() {
    // The last second of a GPS week; GLONASS's Sunday began three hours and 17 seconds earlier.
    let glonass = 10_800_000 - 18_000 + 500 - 1000;
    let frames = [
        msm(1077, 604_799_500, true, &[PLAIN]),
        msm(1087, glonass, true, &[PLAIN]),
        msm(1127, 604_785_500, false, &[PLAIN]),
        msm(1077, 500, true, &[PLAIN]),
        msm(1087, glonass + 1000, true, &[PLAIN]),
        // BeiDou's week ends 14 s later.
        msm(1127, 604_786_500, false, &[PLAIN]),
    ];
    let found = read(&frames.concat(), Some(TimeReference::Week(at(2100, 400_000.0))));
    let times: Vec<_> = found.iter().map(|e| (e.time, e.observations.len())).collect();
    assert_eq!(times, [(at(2100, 604_799.5), 3), (at(2101, 0.5), 3)]);
    // Without GPS messages GLONASS's day of the week decides: 1 is Monday.
    let monday = msm(1087, 1 << 27 | 43_200_000, false, &[PLAIN]);
    let found = read(&monday, Some(TimeReference::Week(at(2100, 302_400.0))));
    assert_eq!(found[0].time, at(2100, 86_400.0 + 43_200.0 - 10_800.0 + 18.0));
}

/// Receivers older than the standard label BeiDou in GPS time.
#[test]
fn a_beidou_message_labelled_as_the_open_epoch_is_of_it() {
    let frames = [msm(1077, 5000, true, &[PLAIN]), msm(1127, 5000, false, &[PLAIN])];
    let found = read(&frames.concat(), day(2100, 0.0));
    assert_eq!(found.len(), 1);
    assert_eq!(found[0].observations.len(), 2);
}

#[test]
fn lock_times_tell_of_lost_lock() {
    let at_second =
        |second: u64, lock: u64| msm(1074, second * 1000, false, &[Cell { lock, ..PLAIN }]);
    let frames = [at_second(0, 7), at_second(1, 7), at_second(2, 6), at_second(3, 8)];
    let lost: Vec<bool> = read(&frames.concat(), day(2100, 0.0))
        .iter()
        .map(|epoch| epoch.observations[0].loss_of_lock)
        .collect();
    assert_eq!(lost, [true, false, true, false]);
}

/// One satellite of 1004: L1 range and phase, L2 differences.
fn legacy(second: u64, more: bool, phase_difference: i64) -> Vec<u8> {
    let mut bits = BitWriter::default();
    bits.unsigned(12, 1004).unsigned(12, 3).unsigned(30, second * 1000).unsigned(1, more.into());
    bits.unsigned(5, 1).unsigned(4, 0);
    bits.unsigned(6, 9).unsigned(1, 0).unsigned(24, 5_000_000).signed(20, phase_difference);
    bits.unsigned(7, 60).unsigned(8, 70).unsigned(8, 180);
    bits.unsigned(2, 3).signed(14, -400).signed(20, -(1 << 19)).unsigned(7, 0).unsigned(8, 0);
    rtcm_frame(&bits.bytes())
}

#[test]
fn older_messages_carry_phase_across_its_roll_over() {
    // 262 m of difference are near the field's end; the next value is 1500 cycles lower.
    let turn = (1500.0 * SPEED_OF_LIGHT / 1_575_420_000.0 / 0.0005_f64).round() as i64;
    let frames = [legacy(1, false, 520_000), legacy(2, false, 520_000 - turn)];
    let found = read(&frames.concat(), day(2100, 0.0));
    let range_m = 100_000.0 + 70.0 * LIGHT_MS_M;
    let [first, second] = [0, 1].map(|epoch: usize| &found[epoch].observations);
    assert_eq!(first[0].signal().to_string(), "G1C");
    assert!((first[0].pseudorange_m.unwrap() - range_m).abs() < 1e-6);
    assert_eq!(first[0].cn0_db_hz, Some(45.0));
    assert_eq!(first[1].signal().to_string(), "G2W");
    assert!((first[1].pseudorange_m.unwrap() - range_m + 8.0).abs() < 1e-6);
    assert!(first[1].carrier_phase.is_none() && first[1].cn0_db_hz.is_none());
    let phase =
        |observations: &[graphfix::gnss::Observation]| observations[0].carrier_phase.unwrap().0;
    assert!((phase(first) - phase(second)).abs() < 0.01);
    assert!(!second[0].loss_of_lock);
}

fn station(number: u16, x: i64) -> Vec<u8> {
    let mut bits = BitWriter::default();
    bits.unsigned(12, number.into()).unsigned(12, 3).unsigned(6 + 3, 0).unsigned(1, 1);
    bits.signed(38, x).unsigned(2, 0).signed(38, -42_550_000_000).unsigned(2, 0);
    bits.signed(38, 38_980_000_001);
    if number == 1006 {
        bits.unsigned(16, 15_000);
    }
    rtcm_frame(&bits.bytes())
}

#[test]
fn a_station_is_told_when_it_changes() {
    let mut name = BitWriter::default();
    name.unsigned(12, 1007).unsigned(12, 3).unsigned(8, 4);
    for letter in b"ANT " {
        name.unsigned(8, (*letter).into());
    }
    name.unsigned(8, 0);
    let frames = [
        station(1005, -26_979_412_112),
        station(1005, -26_979_412_112),
        station(1006, -26_979_412_112),
        rtcm_frame(&name.bytes()),
    ];
    let (events, _) = decode(&frames.concat(), None);
    let stations: Vec<_> = events
        .into_iter()
        .map(|event| match event {
            Event::Station(station) => station,
            other => panic!("{other:?}"),
        })
        .collect();
    assert_eq!(stations.len(), 3);
    let point = stations[0].antenna_reference_point.unwrap().0;
    assert!((point.x + 2_697_941.211_2).abs() < 1e-9 && (point.z - 3_898_000.000_1).abs() < 1e-9);
    assert!(stations[0].is_virtual && stations[0].antenna_height_m.is_none());
    assert_eq!(stations[1].antenna_height_m, Some(1.5));
    assert_eq!((stations[2].antenna.as_str(), stations[2].id), ("ANT", 3));
}

#[test]
fn messages_are_refused_with_their_reason() {
    let whole = msm(1077, 1000, false, &[PLAIN]);
    let payload = &whole[3..whole.len() - 3];
    let mut cells = BitWriter::default();
    cells.unsigned(12, 1077).unsigned(12 + 30, 0).unsigned(1 + 18, 0);
    cells.unsigned(64, u64::MAX).unsigned(32, 3).unsigned(64, 0).unsigned(64, 0);
    let cases = [
        (rtcm_frame(&payload[..payload.len() - 4]), Refusal::Truncated),
        (rtcm_frame(&cells.bytes()), Refusal::TooManyCells),
        (msm(1107, 1000, false, &[PLAIN]), Refusal::OtherConstellation),
        (msm(1071, 1000, false, &[PLAIN]), Refusal::AmbiguousPseudorange),
        (msm(1077, 604_800_000, false, &[PLAIN]), Refusal::InvalidTime),
    ];
    for (frame, reason) in cases {
        let (events, statistics) = decode(&frame, day(2100, 0.0));
        assert!(events.is_empty(), "{reason}");
        assert_eq!(statistics.refused_for(reason), 1, "{reason}");
        assert_eq!(statistics.refusals()[0].offsets, [0]);
    }
    let (events, statistics) = decode(&msm(1077, 1000, false, &[PLAIN]), None);
    assert!(events.is_empty());
    assert_eq!(statistics.refused_for(Refusal::NoReferenceTime), 1);
}

/// Messages without C/N0 also lack the whole light-milliseconds (DF014): their pseudoranges are
/// ambiguous by multiples of 300 km. They are refused and counted by type, and do not affect other
/// messages.
#[test]
fn messages_of_ambiguous_ranges_are_counted_and_cost_no_other() {
    let mut bytes = Vec::new();
    let numbers = [1001, 1003, 1009, 1011];
    for (index, number) in numbers.into_iter().enumerate() {
        let (is_glonass, has_l2) = (1008 < number, number % 8 == 3);
        for _ in 0..=index {
            let mut bits = BitWriter::default();
            bits.unsigned(12, number).unsigned(12, 3).unsigned(if is_glonass { 27 } else { 30 }, 7);
            // One satellite: number, code, GLONASS's channel, L1 range, phase and lock.
            bits.unsigned(1, 1).unsigned(5, 1).unsigned(4, 0).unsigned(6, 9).unsigned(1, 0);
            if is_glonass {
                bits.unsigned(5, 7).unsigned(25, 5_000_000);
            } else {
                bits.unsigned(24, 5_000_000);
            }
            bits.signed(20, 1000).unsigned(7, 60);
            if has_l2 {
                bits.unsigned(2, 0).signed(14, -400).signed(20, 1000).unsigned(7, 60);
            }
            bytes.extend(rtcm_frame(&bits.bytes()));
        }
        bytes.extend(legacy(index as u64, false, 1000));
    }
    let (events, statistics) = decode(&bytes, day(2100, 0.0));
    assert_eq!(epochs(events).len(), 4);
    for (index, number) in numbers.into_iter().enumerate() {
        let kind = Some(MessageKind::Rtcm(number as u16));
        let entry = statistics.refusals().iter().find(|entry| entry.kind == kind).unwrap();
        let refused = (entry.reason, entry.count);
        assert_eq!(refused, (Refusal::AmbiguousPseudorange, index as u64 + 1), "{number}");
    }
}

/// A stream of all messages above, with other bytes between them.
fn mixture() -> Vec<u8> {
    let mut bytes = b"\xd3\x00garbage\xb5\x62$GP".to_vec();
    for second in 0..6 {
        bytes.extend(station(1006, second as i64));
        bytes.extend(msm(1074, second * 1000, true, &[PLAIN]));
        bytes.extend_from_slice(b"$GNGGA,,,*00\r\n\xd3\x03");
        bytes.extend(msm(1097, second * 1000, false, &[PLAIN, Cell { satellite: 9, ..PLAIN }]));
        bytes.extend(legacy(second, false, 1000));
    }
    bytes
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// The result does not depend on how a stream is split.
    #[test]
    fn any_split_gives_the_same(piece in 1_usize..400) {
        let bytes = mixture();
        let whole = decode(&bytes, day(2100, 0.0));
        prop_assert!(5 < whole.0.len());
        prop_assert_eq!(decode_in_pieces(&bytes, day(2100, 0.0), piece), whole);
    }

    /// A good frame is found after any other bytes.
    #[test]
    fn garbage_hides_no_frame(garbage in proptest::collection::vec(any::<u8>(), 0..2000)) {
        let mut bytes = garbage;
        bytes.extend(msm(1077, 1000, false, &[PLAIN]));
        let (_, statistics) = decode(&bytes, day(2100, 0.0));
        prop_assert_eq!(statistics.of(MessageKind::Rtcm(1077)).decoded, 1);
    }

    /// Any payload with a right CRC is decoded or refused.
    #[test]
    fn no_payload_panics(
        number in 1000_u64..1240,
        rest in proptest::collection::vec(any::<u8>(), 0..300),
    ) {
        let mut bits = BitWriter::default();
        bits.unsigned(12, number);
        for byte in rest {
            bits.unsigned(8, byte.into());
        }
        let (_, statistics) = decode(&rtcm_frame(&bits.bytes()), day(2100, 0.0));
        prop_assert_eq!(statistics.of(MessageKind::Rtcm(number as u16)).total(), 1);
    }
}

fn streams() -> Option<Vec<(String, Vec<u8>)>> {
    let folder = data::set("formats")?.join("rtcm3");
    let mut paths: Vec<PathBuf> =
        std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    paths.sort();
    let name = |path: &PathBuf| path.file_name().unwrap().to_str().unwrap().to_owned();
    Some(paths.iter().map(|path| (name(path), std::fs::read(path).unwrap())).collect())
}

/// Messages by type as `pyrtcm` 1.2 counts them: `RTCMReader(stream).read()`, the first twelve bits
/// of each raw message.
const COUNTS: &str = include_str!("rtcm/counts.txt");

#[test]
fn message_counts_are_those_of_pyrtcm() {
    let Some(streams) = streams() else { return };
    let is_rtcm = |kind| matches!(kind, MessageKind::Rtcm(_));
    let found: Vec<String> = streams
        .iter()
        .map(|(name, bytes)| format!("{name}: {}", counts(&decode(bytes, None).1, is_rtcm)))
        .collect();
    assert_eq!(found.join("\n"), COUNTS.trim_end());
}

/// The stream without messages of some types; those of type `last` end their epoch.
fn filtered(bytes: &[u8], dropped: &[u16], last: Option<u16>) -> Vec<u8> {
    let number = |payload: &[u8]| u16::from(payload[0]) << 4 | u16::from(payload[1]) >> 4;
    let mut kept = Vec::new();
    for mut payload in rtcm_payloads(bytes) {
        if dropped.contains(&number(&payload)) {
            continue;
        }
        if Some(number(&payload)) == last {
            // The multiple message bit, bit 54.
            payload[6] &= !0x02;
        }
        kept.extend(rtcm_frame(&payload));
    }
    kept
}

/// A stream, its beginning, the changes that RTKLIB needs in it, and the result of the comparison.
struct Case {
    name: &'static str,
    start: &'static str,
    week_second: (i32, f64),
    /// Types to drop, and the type that then ends the epoch.
    change: Option<(&'static [u16], u16)>,
    epochs: usize,
    observations: usize,
}

const fn case(
    name: &'static str,
    start: &'static str,
    week_second: (i32, f64),
    epochs: usize,
    observations: usize,
) -> Case {
    Case { name, start, week_second, change: None, epochs, observations }
}

const CASES: [Case; 17] = [
    case("1012_first.rtcm", "2019/03/26 10:39:58", (2046, 211_198.0), 148, 4674),
    case("beidou_invalid_fine_pseudorange.rtcm", "2019/03/28 18:29:45", (2046, 412_185.8), 1, 21),
    case("glo_day_rollover.rtcm", "2019/03/29 21:43:11", (2046, 510_191.0), 7, 238),
    case("javad.rtcm", "2019/03/26 19:35:51", (2046, 243_351.0), 28, 2919),
    case("jenoba-jrr32m.rtcm3", "2019/03/28 08:40:39", (2046, 376_839.0), 67, 2998),
    case("missing-beidou-STR17.rtcm3", "2018/07/25 03:16:09", (2011, 270_969.0), 502, 57_003),
    Case {
        // SBAS messages end its epochs, and RTKLIB uses their different time for the epoch.
        change: Some((&[1104], 1094)),
        ..case("missing-gps.rtcm", "2019/03/27 08:29:51", (2046, 289_791.0), 50, 4903)
    },
    case("mixed-msm-legacy.rtcm", "2019/03/28 09:03:57", (2046, 378_237.0), 34, 2762),
    case("msm7.rtcm", "2019/03/29 09:35:43", (2046, 466_543.0), 36, 4735),
    case("navcom.rtcm", "2019/03/30 00:32:14", (2046, 520_334.0), 64, 2128),
    case("piksi-5Hz.rtcm3", "2019/03/26 08:43:56", (2046, 204_236.6), 38, 2052),
    Case {
        // BeiDou is in GPS time here. RTKLIB then makes separate epochs of BeiDou, which hide the
        // others.
        change: Some((&[1127], 1117)),
        ..case("rtklib_GMSD7_20121014.rtcm3", "2012/10/13 23:59:44", (1709, 604_784.0), 257, 13_103)
    },
    Case {
        change: Some((&[1077, 1087, 1117], 1127)),
        ..case("rtklib_GMSD7_20121014.rtcm3", "2012/10/13 23:59:44", (1709, 604_784.0), 257, 6198)
    },
    case("rtklib_testglo.rtcm3", "2009/12/25 23:07:00", (1563, 515_220.0), 186, 5548),
    case("sept.rtcm", "2018/01/09 19:58:05", (1983, 244_685.0), 55, 7731),
    case(
        "switch-legacy-msm-legacy-msm.rtcm",
        "2019/03/27 13:47:00",
        (2046, 308_820.0),
        419,
        23_889,
    ),
    case("trimble.rtcm", "2019/03/29 20:11:12", (2046, 504_672.0), 153, 7137),
];

/// Every observation that RTKLIB's `convbin` decodes agrees, to the last digit of its RINEX.
///
/// Doppler within RTKLIB's single precision. Indicators of lost lock are Graphfix's own.
#[test]
fn observations_are_those_of_rtklib() {
    let Some(streams) = streams() else { return };
    if !streams::has_convbin() {
        return;
    }
    for case in &CASES {
        let (_, original) = streams.iter().find(|(name, _)| name == case.name).unwrap();
        let bytes = match case.change {
            Some((dropped, last)) => filtered(original, dropped, Some(last)),
            None => original.clone(),
        };
        let (rinex, _) = streams::convbin(&bytes, "rtcm3", Some(case.start));
        let ours = read(&bytes, day(case.week_second.0, case.week_second.1));
        let found = streams::compare(&ours, &epochs_of(&rinex));
        assert_eq!(
            (found.epochs, found.observations),
            (case.epochs, case.observations),
            "{}",
            case.name
        );
        assert_eq!((found.only[1], found.more_phases), (0, 0), "{}", case.name);
    }
}

#[test]
fn ephemerides_are_those_of_rtklib() {
    let Some(streams) = streams() else { return };
    if !streams::has_convbin() {
        return;
    }
    for (name, start, (week, second), count) in [
        ("missing-beidou-STR17.rtcm3", "2018/07/25 03:16:09", (2011, 270_969.0), 30),
        ("rtklib_GMSD7_20121014.rtcm3", "2012/10/13 23:59:44", (1709, 604_784.0), 31),
        ("rtklib_testglo.rtcm3", "2009/12/25 23:07:00", (1563, 515_220.0), 21),
        ("sept.rtcm", "2018/01/09 19:58:05", (1983, 244_685.0), 4),
        ("eph.rtcm", "2018/08/03 16:00:00", (2012, 489_600.0), 107),
    ] {
        let (_, bytes) = streams.iter().find(|(other, _)| other == name).unwrap();
        let (_, rinex) = streams::convbin(bytes, "rtcm3", Some(start));
        let ours = streams::navigation(&decode(bytes, day(week, second)).0);
        let found = streams::compare_ephemerides(&ours, &streams::rinex_navigation(&rinex));
        assert_eq!((found, ours.len()), (count, count), "{name}");
    }
}

/// Galileo's and BeiDou's week numbers are complete, and so is GLONASS's date: they date GPS.
#[test]
fn some_ephemerides_need_no_reference() {
    let Some(streams) = streams() else { return };
    let (_, bytes) = streams.iter().find(|(name, _)| name == "eph.rtcm").unwrap();
    let (events, statistics) = decode(bytes, None);
    // 512 messages of GPS and 48 of QZSS have the week modulo 1024, and 16 of GLONASS have no date.
    assert_eq!(statistics.refused_for(Refusal::NoReferenceTime), 576);
    let toes = events.iter().filter_map(|event| match event {
        Event::Ephemeris(ephemeris) => Some(ephemeris),
        _ => None,
    });
    let weeks: Vec<i32> = toes.map(Ephemeris::toe).map(|toe| toe.week()).collect();
    assert_eq!(weeks.len(), 1712 - 576);
    // One GLONASS satellite has a date of 2002.
    assert_eq!(weeks.iter().filter(|week| **week == 2012).count(), weeks.len() - 16);
}

/// Damaged streams, and damaged messages with a right CRC, never cause a panic.
#[test]
fn mutated_streams_never_panic() {
    let mut sources: Vec<Vec<u8>> = vec![mixture()];
    sources.extend(streams().into_iter().flatten().map(|(_, bytes)| bytes));
    let mut random = Random::new(0x5eed_0001);
    let mut left = streams::mutated_bytes() as i64;
    while 0 < left {
        let source = &sources[random.below(sources.len())];
        let start = random.below(source.len());
        let mut piece = source[start..source.len().min(start + 4096)].to_vec();
        streams::mutate(&mut piece, &mut random);
        left -= piece.len() as i64;
        let _ = decode(&piece, day(2046, 1000.0));
        let mut payloads = rtcm_payloads(&source[start..source.len().min(start + 4096)]);
        for payload in &mut payloads {
            streams::mutate(payload, &mut random);
        }
        let frames: Vec<u8> = payloads.iter().flat_map(|payload| rtcm_frame(payload)).collect();
        left -= frames.len() as i64;
        let _ = decode(&frames, day(2046, 1000.0));
    }
}
