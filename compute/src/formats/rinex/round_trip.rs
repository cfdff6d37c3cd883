//! Written files read back equal.

use proptest::prelude::*;

use super::*;
use crate::gnss::{
    Constellation, Cycles, Ecef, Ephemeris, Epoch, GlonassEphemeris, GpsTime, GroupDelays,
    KeplerianEphemeris, KlobucharCoefficients, LeapSeconds, NO_PREDICTION_M, Navigation,
    NavigationMessage, NeQuickCoefficients, Observation, ObservationCode, SatelliteId,
};

fn code(text: &str) -> ObservationCode {
    ObservationCode::parse(text).unwrap()
}

fn header() -> ObservationHeader {
    let mut header = ObservationHeader::new(RinexVersion::new(3, 5));
    header.marker = "ROVER".to_owned();
    header.receiver = "SIMULATED".to_owned();
    header.antenna = "NONE".to_owned();
    header.approximate_position = Some(Ecef::new(-2_414_266.919_7, 5_386_768.986_8, 2_407_460.031));
    header.antenna_delta_hen_m = [1.5, 0.0, -0.25];
    header.interval_s = Some(0.1);
    header.first_observation = Some(GpsTime::from_week_seconds(2051, 46_701.5));
    header.leap_seconds = Some(18);
    header.glonass_channels = (1..=20).map(|slot| (slot, slot as i8 - 8)).collect();
    header.codes = [
        vec![code("1C"), code("2W"), code("5Q"), code("2L")],
        vec![code("1C"), code("2P")],
        vec![code("1C"), code("7Q")],
        vec![code("2I"), code("1P")],
        vec![code("1C")],
    ];
    header
}

fn thousandths(range: std::ops::Range<i64>) -> impl Strategy<Value = Option<f64>> {
    proptest::option::weighted(0.8, range.prop_map(|value| value as f64 / 1000.0))
        .prop_map(|value| value.filter(|value| *value != 0.0))
}

fn observation() -> impl Strategy<Value = Observation> {
    let satellite = (0..5_usize, 1..64_u8);
    let flags = (any::<bool>(), any::<bool>());
    let values = (
        thousandths(1..45_000_000_000),
        thousandths(-900_000_000_000..900_000_000_000),
        thousandths(-9_000_000..9_000_000),
        thousandths(1..60_000),
    );
    (satellite, 0..4_usize, flags, values).prop_map(
        |((system, number), signal, (lost, half), (range, phase, doppler, cn0))| {
            let satellite = SatelliteId::new(Constellation::ALL[system], number).unwrap();
            let codes = &header().codes[system];
            Observation {
                satellite,
                code: codes[signal % codes.len()],
                loss_of_lock: lost,
                half_cycle: half,
                pseudorange_m: range,
                carrier_phase: phase.map(Cycles),
                doppler_hz: doppler,
                cn0_db_hz: cn0,
            }
        },
    )
}

/// Observations in file order: by satellite, then in the header's order, each once.
fn epoch() -> impl Strategy<Value = Epoch> {
    let ticks = 0_i64..2_500_000_000_000_000;
    (ticks, any::<bool>(), proptest::collection::vec(observation(), 0..60)).prop_map(
        |(ticks, power_failure, mut observations)| {
            let codes = header().codes;
            let key = |o: &Observation| {
                let codes = &codes[o.satellite.constellation.index()];
                (o.satellite, codes.iter().position(|c| *c == o.code))
            };
            observations.retain(|o| !o.is_empty());
            observations.sort_by_key(key);
            observations.dedup_by_key(|o| key(o));
            let time = GpsTime::from_ns(ticks * 100);
            Epoch { power_failure, observations, ..Epoch::new(time) }
        },
    )
}

fn written(epochs: &[Epoch]) -> Vec<u8> {
    let mut writer = ObservationWriter::new(Vec::new(), &header()).unwrap();
    for epoch in epochs {
        writer.write_epoch(epoch).unwrap();
    }
    writer.finish().unwrap()
}

fn read_back(bytes: &[u8]) -> (ObservationHeader, Vec<Epoch>, Skipped) {
    let mut reader = ObservationReader::new(bytes).unwrap();
    let mut epochs = Vec::new();
    let mut epoch = Epoch::new(GpsTime::EPOCH);
    while reader.read_epoch(&mut epoch).unwrap() {
        epochs.push(epoch.clone());
    }
    (reader.header().clone(), epochs, reader.skipped().clone())
}

/// A number with thirteen significant digits.
fn digits() -> impl Strategy<Value = f64> {
    (-9.99_f64..9.99, -14_i32..3)
        .prop_map(|(m, e)| format!("{:.12e}", m * 10_f64.powi(e)).parse().unwrap())
}

fn message_of(satellite: SatelliteId, v: &[f64], full: bool) -> (NavigationMessage, GroupDelays) {
    use NavigationMessage as M;
    let gps = GroupDelays::Gps {
        tgd_s: v[0],
        isc_l1ca_s: None,
        isc_l2c_s: None,
        isc_l5i_s: None,
        isc_l5q_s: None,
        isc_l1cd_s: None,
        isc_l1cp_s: None,
    };
    match satellite.constellation {
        Constellation::Galileo if full => {
            (M::Inav, GroupDelays::Galileo { bgd_e5a_s: v[0], bgd_e5b_s: Some(v[1]) })
        }
        Constellation::Galileo => {
            (M::Fnav, GroupDelays::Galileo { bgd_e5a_s: v[0], bgd_e5b_s: None })
        }
        Constellation::BeiDou => (
            if satellite.is_beidou_geo() { M::D2 } else { M::D1 },
            GroupDelays::BeiDou { tgd1_s: v[0], tgd2_s: v[1] },
        ),
        _ => (M::Lnav, gps),
    }
}

fn keplerian() -> impl Strategy<Value = KeplerianEphemeris> {
    let times = (1_400_i32..2_800, 0..302_400_i32, -3_600..3_600_i32, -7_000..7_000_i32);
    let small = proptest::collection::vec(digits(), 21);
    (0..4_usize, 1..64_u8, times, small, any::<[u16; 2]>(), any::<bool>())
        .prop_map(|(system, number, (week, pair, clock_s, sent_s), v, [iode, health], full)| {
            let system = [
                Constellation::Gps,
                Constellation::Qzss,
                Constellation::Galileo,
                Constellation::BeiDou,
            ][system];
            let satellite = SatelliteId::new(system, number).unwrap();
            let (message, group_delays) = message_of(satellite, &v, full);
            let galileo = system == Constellation::Galileo;
            let toe = GpsTime::from_week_seconds(week, f64::from(pair) * 2.0);
            KeplerianEphemeris {
                satellite,
                message,
                group_delays,
                toe,
                toc: toe + f64::from(clock_s),
                transmission_time: full.then(|| toe + f64::from(sent_s)),
                af0_s: v[2],
                af1: v[3],
                af2_per_s: v[4],
                iode: u32::from(iode),
                iodc: if galileo { u32::from(iode) } else { u32::from(iode / 2) },
                sqrt_a: 5_153.0 + v[5].abs(),
                a_dot_m_s: 0.0,
                eccentricity: (v[6].abs() / 1e6),
                m0_rad: v[7],
                delta_n_rad_s: v[8],
                delta_n_dot_rad_s2: 0.0,
                omega_rad: v[9],
                omega0_rad: v[10],
                omega_dot_rad_s: v[11],
                i0_rad: v[12],
                idot_rad_s: v[13],
                cuc_rad: v[14],
                cus_rad: v[15],
                crc_m: v[16],
                crs_m: v[17],
                cic_rad: v[18],
                cis_rad: v[19],
                accuracy_m: [None, Some(2.0), Some(3.12), Some(NO_PREDICTION_M)]
                    [usize::from(iode % 4)],
                health: u32::from(health),
                fit_interval_h: (full && message == NavigationMessage::Lnav).then_some(4.0),
            }
        })
        .prop_map(|mut e| {
            let thirteen = |x: f64| format!("{x:.12e}").parse::<f64>().unwrap();
            e.sqrt_a = thirteen(e.sqrt_a);
            e.eccentricity = thirteen(e.eccentricity);
            e
        })
}

fn glonass() -> impl Strategy<Value = GlonassEphemeris> {
    let vector = || proptest::array::uniform3(-9_000_000..9_000_000_i32);
    (1..28_u8, 1_400..2_800_i32, 0..672_i32, vector(), vector(), -7..13_i8, any::<bool>())
        .prop_map(|(number, week, quarter, position, rest, channel, full)| {
            let leap = LeapSeconds::table();
            let label = GpsTime::from_week_seconds(week, f64::from(quarter) * 900.0);
            let toe = label + leap.at(label) as f64;
            GlonassEphemeris {
                satellite: SatelliteId::new(Constellation::Glonass, number).unwrap(),
                toe,
                transmission_time: full.then(|| toe - 1_770.0),
                // Whole kilometres so that the conversion is exact both ways.
                position_m: nalgebra::Vector3::new(20_000.0, 0.0, 9_000.0) * 1000.0
                    + nalgebra::Vector3::from(position.map(|p| f64::from(p / 9_000) * 1000.0)),
                velocity_m_s: nalgebra::Vector3::from(rest.map(|v| f64::from(v / 9_000) * 1000.0)),
                acceleration_m_s2: nalgebra::Vector3::zeros(),
                clock_bias_s: f64::from(rest[0]) * 1e-12,
                gamma: f64::from(rest[1]) * 2_f64.powi(-40),
                delta_tau_s: full.then_some(8.5e-9),
                channel,
                health: u32::from(full),
                accuracy_m: full.then_some(2.5),
                age_days: 3,
            }
        })
        .prop_map(|mut e| {
            let thirteen = |x: f64| format!("{x:.12e}").parse::<f64>().unwrap();
            e.gamma = thirteen(e.gamma);
            e.clock_bias_s = thirteen(e.clock_bias_s);
            e
        })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn observations(epochs in proptest::collection::vec(epoch(), 0..6)) {
        let (read_header, read, skipped) = read_back(&written(&epochs));
        prop_assert_eq!(read_header, header());
        prop_assert_eq!(read, epochs);
        prop_assert!(skipped.is_empty());
    }

    #[test]
    fn navigation(
        keplerian in proptest::collection::vec(keplerian(), 0..8),
        glonass in proptest::collection::vec(glonass(), 0..4),
        leap in 18_i64..25,
    ) {
        let mut navigation = Navigation::default();
        navigation.leap_seconds = LeapSeconds::with_broadcast(leap);
        let model = |k: f64| KlobucharCoefficients {
            alpha: [1.1176e-8 * k, 7.4506e-9, -5.9605e-8, 0.0],
            beta: [9.0112e4, 0.0, -1.9661e5, -6.5e4 * k],
        };
        navigation.klobuchar_gps = Some(model(1.0));
        navigation.klobuchar_beidou = Some(model(2.0));
        navigation.klobuchar_qzss = Some(model(0.5));
        navigation.nequick = Some(NeQuickCoefficients { ai: [142.5, -0.46484, 0.0064392] });
        for e in keplerian {
            navigation.insert(Ephemeris::Keplerian(e));
        }
        // After the table's last leap second any broadcast count may hold; before it, the table.
        for e in glonass.into_iter().filter(|e| leap == 18 || e.toe.week() < 1_900) {
            navigation.insert(Ephemeris::Glonass(e));
        }
        let mut bytes = Vec::new();
        write_navigation(&mut bytes, &navigation).unwrap();
        let (read, skipped) = read_navigation(bytes.as_slice()).unwrap();
        prop_assert_eq!(&read, &navigation, "{}", String::from_utf8_lossy(&bytes));
        prop_assert!(skipped.is_empty());
    }
}

/// Deterministic pseudo-random numbers: xorshift64 (Marsaglia 2003, *Xorshift RNGs*).
struct Random(u64);

impl Random {
    fn below(&mut self, limit: usize) -> usize {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 % limit as u64) as usize
    }
}

/// Overwrites, removes, repeats and cuts bytes, preferring bytes with a meaning.
fn mutate(bytes: &[u8], random: &mut Random) -> Vec<u8> {
    const LOADED: &[u8] = b"\n\r >&-.0123456789GRECJSDXEN\xff\x00";
    let mut mutated = bytes.to_vec();
    for _ in 0..=random.below(8) {
        if mutated.len() < 2 {
            break;
        }
        let at = random.below(mutated.len());
        match random.below(5) {
            0 => drop(mutated.remove(at)),
            1 => mutated.insert(at, LOADED[random.below(LOADED.len())]),
            2 => mutated.truncate(at),
            3 => {
                let end = (at + random.below(200)).min(mutated.len());
                let repeated = mutated[at..end].to_vec();
                mutated.splice(at..at, repeated);
            }
            _ => mutated[at] = LOADED[random.below(LOADED.len())],
        }
    }
    mutated
}

/// Reads the bytes as both kinds; no more epochs than lines may result.
fn survives(bytes: &[u8]) {
    let lines = bytes.iter().filter(|b| **b == b'\n').count() + 1;
    if let Ok(mut reader) = ObservationReader::new(bytes) {
        let mut epoch = Epoch::new(GpsTime::EPOCH);
        let mut epochs = 0;
        while let Ok(true) = reader.read_epoch(&mut epoch) {
            epochs += 1;
            assert!(epochs <= lines, "more epochs than lines");
        }
    }
    let _ = read_navigation(bytes);
}

/// The digits 0 to 4 on a phase: RTKLIB's convbin adds 3 for a half cycle where it read RTCM 3.
#[test]
fn indicators_of_convbin_are_understood() {
    let file = |program: &str, source: &str| {
        let mut text = String::from(
            "     3.03           OBSERVATION DATA    M: Mixed            RINEX VERSION / TYPE\n",
        );
        text += &format!("{program:60}PGM / RUN BY / DATE\n{source:60}COMMENT\n");
        text += &format!("{:60}SYS / # / OBS TYPES\n{:60}END OF HEADER\n", "G    2 C1C L1C", "");
        for digit in 0..5 {
            text += &format!("> 2023 05 19 06 33 {digit:2}.0000000  0  1\n");
            text += &format!("G03  24600079.188   129274136.841{digit} \n");
        }
        let mut reader = ObservationReader::new(text.as_bytes()).expect("a header");
        let (mut epoch, mut flags) = (Epoch::new(GpsTime::EPOCH), Vec::new());
        while reader.read_epoch(&mut epoch).expect("epochs") {
            let observation = &epoch.observations[0];
            flags.push((observation.loss_of_lock, observation.half_cycle));
        }
        flags
    };
    let standard = [(false, false), (true, false), (false, true), (true, true), (false, false)];
    let convbin = [(false, false), (true, false), (false, true), (false, true), (true, true)];
    let by = "CONVBIN 2.4.3                           20261122 105000 UTC";
    assert_eq!(file(by, "format: RTCM 3"), convbin);
    assert_eq!(file(by, "format: u-blox UBX"), standard);
    assert_eq!(file("another program", "format: RTCM 3"), standard);
}

const RINEX2: &str =
    "     2.11           OBSERVATION DATA    M                   RINEX VERSION / TYPE
     7    L1    L2    C1    P2    S1    D1    C2            # / TYPES OF OBSERV
     1     2                                                WAVELENGTH FACT L1/2
                                                            END OF HEADER
 18  1  1  0  0  0.0000000  0  2G05R16
 126821078.928 7  98821607.305 4  24133241.235 4  24133243.234 4        45.000
      1000.125
 116900152.774 7  91091000.900 5  22245354.806 5  22245357.132 5        45.000

                            4  1
                                                            COMMENT
 18  1  1  0  0 30.0000000  0  1G05
 126821078.928 7  98821607.305 4  24133241.235 4  24133243.234 4        45.000
      1000.125
";

/// CRINEX with two satellites.
const COMPACT: &str = include_str!("sample.crx");

const RINEX4: &str =
    "     4.00           NAVIGATION DATA     M                   RINEX VERSION / TYPE
                                                            END OF HEADER
> EPH E02 INAV
E02 2019 06 06 22 40 00 6.366008892655E-05 1.733724275255E-12 0.000000000000E+00
     7.200000000000E+01 1.047812500000E+02 2.312596328920E-09-7.626860954287E-01
     4.980713129044E-06 1.261847792193E-04 1.181103289127E-05 5.440612405777E+03
     4.272000000000E+05-5.401670932770E-08 7.354717244466E-01 1.247972249985E-07
     9.880244040051E-01 1.005625000000E+02 1.196084944939E+00-5.081997399876E-09
    -1.957224383395E-10 5.170000000000E+02 2.056000000000E+03
     3.120000000000E+00 0.000000000000E+00-3.259629011154E-09-4.190951585770E-09
     4.278650000000E+05
> ION G12 LNAV
    2023 03 12 00 08 54 3.259629011154e-08 7.450580596924e-09-1.788139343262e-07
     0.000000000000e+00 1.351680000000e+05 0.000000000000e+00-2.621440000000e+05
     1.310720000000e+05
";

/// Damaged files of every form are read without a panic.
#[test]
fn mutations_never_panic_nor_loop() {
    let observation = Observation {
        pseudorange_m: Some(2.1e7),
        carrier_phase: Some(Cycles(1.1e8)),
        ..Observation::empty("G05".parse().unwrap(), code("1C"))
    };
    let epochs: Vec<_> = (0..5)
        .map(|second| Epoch {
            observations: vec![observation],
            ..Epoch::new(GpsTime::from_week_seconds(2051, f64::from(second)))
        })
        .collect();
    let (rinex4, _) = read_navigation(RINEX4.as_bytes()).unwrap();
    assert_eq!((rinex4.len(), rinex4.klobuchar_gps.is_some()), (1, true));
    let mut rinex3 = Vec::new();
    write_navigation(&mut rinex3, &rinex4).unwrap();
    let rinex3_observations = written(&epochs);
    let files: [&[u8]; 5] =
        [&rinex3_observations, RINEX2.as_bytes(), COMPACT.as_bytes(), RINEX4.as_bytes(), &rinex3];
    let mut random = Random(0x9e37_79b9_7f4a_7c15);
    for file in files {
        for _ in 0..3_000 {
            survives(&mutate(file, &mut random));
        }
        for length in 0..file.len() {
            survives(&file[..length]);
        }
    }
}
