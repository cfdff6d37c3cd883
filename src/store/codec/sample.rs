//! Arbitrary values for the tests of the codec.

use nalgebra::{Matrix3, Vector3};
use proptest::collection::vec;
use proptest::option;
use proptest::prelude::*;

use crate::config::IonosphereModel;
use crate::gnss::{
    AntennaCalibration, BaseEpochIssue, Constellation, Cycles, Dops, Ecef, Ephemeris,
    EphemerisIssue, Epoch, GlonassEphemeris, GpsTime, GroupDelays, KeplerianEphemeris,
    NavigationMessage, Observation, ObservationCode, Odometry, OdometryFrame, PhaseCentrePattern,
    Protection, Provenance, Reason, RelativeEstimate, SatelliteId, Solution, SolutionEstimate,
    Status, Velocity,
};

use super::ephemeris::MESSAGES;

/// Any bits, including infinities, subnormals, NaN payloads and negative zero.
fn number() -> impl Strategy<Value = f64> {
    prop_oneof![
        any::<u64>().prop_map(f64::from_bits),
        (-1e9..1e9).prop_map(|v: f64| v.round() / 8.0)
    ]
}

fn time() -> impl Strategy<Value = GpsTime> {
    prop_oneof![any::<i64>(), (0..4_000_000_000_i64).prop_map(|s| s * 1_000_000_000)]
        .prop_map(GpsTime::from_ns)
}

fn constellation() -> impl Strategy<Value = Constellation> {
    (0..Constellation::COUNT).prop_map(|index| Constellation::ALL[index])
}

fn satellite() -> impl Strategy<Value = SatelliteId> {
    (constellation(), 1_u8..=99).prop_map(|(c, number)| SatelliteId::new(c, number).unwrap())
}

fn vector() -> impl Strategy<Value = Vector3<f64>> {
    [number(), number(), number()].prop_map(Vector3::from)
}

fn covariance() -> impl Strategy<Value = Matrix3<f64>> {
    (vec(number(), 9), any::<bool>()).prop_map(|(values, symmetric)| {
        let matrix = Matrix3::from_column_slice(&values);
        if symmetric { Matrix3::from_fn(|i, j| matrix[(i.min(j), i.max(j))]) } else { matrix }
    })
}

pub(super) fn observation() -> impl Strategy<Value = Observation> {
    let flags = (any::<bool>(), any::<bool>());
    let values = vec(option::of(number()), 4);
    (satellite(), b'1'..=b'9', b'A'..=b'Z', flags, values).prop_map(
        |(satellite, b, a, flags, v)| Observation {
            satellite,
            code: ObservationCode::new(b, a).unwrap(),
            loss_of_lock: flags.0,
            half_cycle: flags.1,
            pseudorange_m: v[0],
            carrier_phase: v[1].map(Cycles),
            doppler_hz: v[2],
            cn0_db_hz: v[3],
        },
    )
}

fn pattern() -> impl Strategy<Value = PhaseCentrePattern> {
    let rows = vec(vec(number(), 0..4), 0..4);
    (constellation(), any::<u8>(), vector(), number(), number(), rows).prop_map(
        |(constellation, band_digit, offset_m, first_zenith_rad, zenith_step_rad, rows)| {
            PhaseCentrePattern {
                constellation,
                band_digit,
                offset_m,
                first_zenith_rad,
                zenith_step_rad,
                variations_m: rows.first().cloned().unwrap_or_default(),
                azimuth_variations_m: rows,
            }
        },
    )
}

pub(super) fn calibration() -> impl Strategy<Value = AntennaCalibration> {
    (["[A-Z0-9.]{0,16}", "[A-Z]{0,4}", "[0-9]{0,5}"], vec(pattern(), 0..3)).prop_map(
        |([antenna, radome, serial], patterns)| AntennaCalibration {
            antenna,
            radome,
            serial,
            patterns,
        },
    )
}

pub(super) fn epoch() -> impl Strategy<Value = Epoch> {
    (time(), any::<bool>(), vec(observation(), 0..50), option::of(odometry())).prop_map(
        |(time, power_failure, observations, odometry)| Epoch {
            time,
            power_failure,
            observations,
            odometry,
        },
    )
}

fn odometry() -> impl Strategy<Value = Odometry> {
    let body = (number(), number()).prop_map(|(heading_rad, heading_sigma_rad)| {
        OdometryFrame::Body { heading_rad, heading_sigma_rad }
    });
    let frame = prop_oneof![Just(OdometryFrame::Ecef), Just(OdometryFrame::Enu), body];
    (number(), frame, vector(), covariance()).prop_map(
        |(interval_s, frame, displacement_m, covariance)| Odometry {
            interval_s,
            frame,
            displacement_m,
            covariance,
        },
    )
}

fn reason() -> impl Strategy<Value = Reason> {
    let satellites = || vec(satellite(), 0..5);
    prop_oneof![
        satellites().prop_map(|satellites| Reason::EphemerisMissing { satellites }),
        (any::<usize>(), any::<usize>())
            .prop_map(|(used, needed)| Reason::TooFewSatellites { used, needed }),
        number().prop_map(|gdop| Reason::GeometryTooWeak { gdop }),
        Just(Reason::NoRedundancy),
        number().prop_map(|ratio| Reason::ResidualsTooLarge { ratio }),
        satellites().prop_map(|satellites| Reason::SatellitesExcluded { satellites }),
        Just(Reason::NotConverged),
        Just(Reason::EstimatorFailed),
        (0..IonosphereModel::ALL.len())
            .prop_map(|m| Reason::IonosphereFallback { used: IonosphereModel::ALL[m].name() }),
        base_reason(),
    ]
}

fn base_reason() -> impl Strategy<Value = Reason> {
    let satellites = || vec(satellite(), 0..5);
    prop_oneof![
        Just(Reason::BaseMissing),
        number().prop_map(|age_s| Reason::BaseStale { age_s }),
        number().prop_map(|distance_m| Reason::BasePositionDoubtful { distance_m }),
        number().prop_map(|length_m| Reason::BaselineTooLong { length_m }),
        (any::<usize>(), any::<usize>())
            .prop_map(|(used, needed)| Reason::TooFewCommonSatellites { used, needed }),
        (number(), number())
            .prop_map(|(ratio, threshold)| Reason::RatioBelowThreshold { ratio, threshold }),
        number().prop_map(|success_rate| Reason::SuccessRateTooLow { success_rate }),
        Just(Reason::FixRejected),
        satellites().prop_map(|satellites| Reason::HalfCycleUnresolved { satellites }),
        satellites().prop_map(|satellites| Reason::CycleSlips { satellites }),
        number().prop_map(|age_s| Reason::StartUnproven { age_s }),
        number().prop_map(|interval_s| Reason::OdometryUnused { interval_s }),
        number().prop_map(|sigma_m| Reason::FixImprecise { sigma_m }),
        number().prop_map(|distance_m| Reason::BaseMoved { distance_m }),
        number().prop_map(|distance_m| Reason::BaseChanged { distance_m }),
        number().prop_map(|behind_s| Reason::EpochRepeated { behind_s }),
        (option::of(number()), number())
            .prop_map(|(level_m, limit_m)| Reason::ProtectionLimitExceeded { level_m, limit_m }),
    ]
}

fn velocity() -> impl Strategy<Value = Velocity> {
    (vector(), covariance(), number()).prop_map(|(velocity_m_s, covariance, clock_drift_m_s)| {
        Velocity { velocity_m_s, covariance, clock_drift_m_s }
    })
}

fn relative_estimate() -> impl Strategy<Value = RelativeEstimate> {
    let counts = (any::<usize>(), any::<usize>());
    (vector(), number(), counts, vec(option::of(number()), 3)).prop_map(
        |(baseline_m, age_s, (ambiguities, fixed_ambiguities), quality)| RelativeEstimate {
            baseline_m,
            age_s,
            ambiguities,
            fixed_ambiguities,
            ratio: quality[0],
            success_rate: quality[1],
            fix_probability: quality[2],
        },
    )
}

fn estimate() -> impl Strategy<Value = SolutionEstimate> {
    let biases = vec((constellation(), number()), 0..4);
    let position = (vector(), covariance(), option::of(velocity()));
    let satellites = vec(satellite(), 0..40);
    let rest =
        (number(), biases, time(), vec(number(), 5), satellites, option::of(relative_estimate()));
    (position, rest).prop_map(|((position, covariance, velocity), rest)| SolutionEstimate {
        position: Ecef(position),
        covariance,
        velocity,
        clock_m: rest.0,
        inter_system_biases_m: rest.1,
        reception_time: rest.2,
        dops: Dops {
            gdop: rest.3[0],
            pdop: rest.3[1],
            hdop: rest.3[2],
            vdop: rest.3[3],
            tdop: rest.3[4],
        },
        satellites_used: rest.4,
        relative: rest.5,
    })
}

pub(super) fn solution() -> impl Strategy<Value = Solution> {
    let issue = (satellite(), time(), any::<u32>())
        .prop_map(|(satellite, toe, issue)| EphemerisIssue { satellite, toe, issue });
    let base = (".{0,8}", time()).prop_map(|(base, time)| BaseEpochIssue { base, time });
    let protection = (number(), number())
        .prop_map(|(horizontal_m, vertical_m)| Protection { horizontal_m, vertical_m });
    let estimate = (option::of(estimate()), option::of(protection));
    let made = (estimate, vec(reason(), 0..4), vec(issue, 0..40), option::of(base));
    (time(), made).prop_map(|(time, ((estimate, protection), reasons, ephemerides, base))| {
        Solution {
            time,
            status: if estimate.is_some() { Status::Single } else { Status::None },
            estimate,
            protection,
            reasons,
            provenance: Provenance { ephemerides, base },
        }
    })
}

fn group_delays() -> impl Strategy<Value = GroupDelays> {
    (0..4, number(), number(), vec(option::of(number()), 6)).prop_map(
        |(kind, a, b, o)| match kind {
            0 => GroupDelays::Gps {
                tgd_s: a,
                isc_l1ca_s: o[0],
                isc_l2c_s: o[1],
                isc_l5i_s: o[2],
                isc_l5q_s: o[3],
                isc_l1cd_s: o[4],
                isc_l1cp_s: o[5],
            },
            1 => GroupDelays::Galileo { bgd_e5a_s: a, bgd_e5b_s: o[0] },
            2 => GroupDelays::BeiDou { tgd1_s: a, tgd2_s: b },
            _ => GroupDelays::BeiDouCnav {
                tgd_b1cp_s: o[0],
                tgd_b2ap_s: o[1],
                tgd_b2bi_s: o[2],
                isc_b1cd_s: o[3],
                isc_b2ad_s: o[4],
            },
        },
    )
}

fn message() -> impl Strategy<Value = NavigationMessage> {
    (0..MESSAGES.len()).prop_map(|index| MESSAGES[index].0)
}

fn keplerian() -> impl Strategy<Value = Ephemeris> {
    let times = (time(), time(), option::of(time()));
    let numbers = (any::<u32>(), any::<u32>(), any::<u32>());
    let stated = (option::of(number()), option::of(number()), group_delays());
    (satellite(), message(), times, numbers, vec(number(), 20), stated).prop_map(
        |(satellite, message, times, (iode, iodc, health), v, stated)| {
            Ephemeris::Keplerian(KeplerianEphemeris {
                satellite,
                message,
                toc: times.0,
                toe: times.1,
                transmission_time: times.2,
                af0_s: v[0],
                af1: v[1],
                af2_per_s: v[2],
                iode,
                iodc,
                sqrt_a: v[3],
                a_dot_m_s: v[4],
                eccentricity: v[5],
                m0_rad: v[6],
                delta_n_rad_s: v[7],
                delta_n_dot_rad_s2: v[8],
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
                accuracy_m: stated.0,
                health,
                fit_interval_h: stated.1,
                group_delays: stated.2,
            })
        },
    )
}

fn glonass() -> impl Strategy<Value = Ephemeris> {
    let times = (time(), option::of(time()));
    let motion = (vector(), vector(), vector());
    let numbers = (any::<i8>(), any::<u32>(), any::<u8>());
    let stated = (option::of(number()), option::of(number()));
    (satellite(), times, motion, (number(), number()), numbers, stated).prop_map(
        |(satellite, times, motion, (clock_bias_s, gamma), numbers, stated)| {
            Ephemeris::Glonass(GlonassEphemeris {
                satellite,
                toe: times.0,
                transmission_time: times.1,
                position_m: motion.0,
                velocity_m_s: motion.1,
                acceleration_m_s2: motion.2,
                clock_bias_s,
                gamma,
                delta_tau_s: stated.0,
                channel: numbers.0,
                health: numbers.1,
                accuracy_m: stated.1,
                age_days: numbers.2,
            })
        },
    )
}

pub(super) fn ephemeris() -> impl Strategy<Value = Ephemeris> {
    prop_oneof![keplerian(), glonass()]
}
