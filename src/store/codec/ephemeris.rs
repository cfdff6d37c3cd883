//! Ephemerides and other broadcast data as bytes.

use crate::gnss::{
    Ephemeris, GlonassEphemeris, GroupDelays, KeplerianEphemeris, KlobucharCoefficients,
    NavigationMessage, NeQuickCoefficients, SatelliteId,
};

use super::CodecError;
use super::bytes::{Decoder, Encoder};

const VERSION: u8 = 1;

/// A broadcast value of which only the newest is kept.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::store) enum NavigationRecord {
    /// Coefficients of a Klobuchar model.
    Klobuchar(KlobucharCoefficients),
    /// Coefficients of NeQuick-G.
    NeQuick(NeQuickCoefficients),
    /// Leap seconds.
    LeapSeconds(i64),
}

/// Each navigation message with its stored number, which never changes.
pub(super) const MESSAGES: [(NavigationMessage, u8); 11] = [
    (NavigationMessage::Lnav, 0),
    (NavigationMessage::Cnav, 1),
    (NavigationMessage::Cnav2, 2),
    (NavigationMessage::Inav, 3),
    (NavigationMessage::Fnav, 4),
    (NavigationMessage::D1, 5),
    (NavigationMessage::D2, 6),
    (NavigationMessage::Cnv1, 7),
    (NavigationMessage::Cnv2, 8),
    (NavigationMessage::Cnv3, 9),
    (NavigationMessage::Fdma, 10),
];

/// Encodes a record.
pub(in crate::store) fn encode_record(record: &NavigationRecord) -> Vec<u8> {
    let mut out = Encoder::new(VERSION, 72);
    match record {
        NavigationRecord::Klobuchar(coefficients) => {
            out.u8(0);
            coefficients.alpha.iter().chain(&coefficients.beta).for_each(|value| out.f64(*value));
        }
        NavigationRecord::NeQuick(coefficients) => {
            out.u8(1);
            coefficients.ai.iter().for_each(|value| out.f64(*value));
        }
        NavigationRecord::LeapSeconds(seconds) => {
            out.u8(2);
            out.signed(*seconds);
        }
    }
    out.finish()
}

/// Decodes a record.
pub(in crate::store) fn decode_record(bytes: &[u8]) -> Result<NavigationRecord, CodecError> {
    let mut input = Decoder::new(bytes, VERSION)?;
    let record = match input.u8()? {
        0 => NavigationRecord::Klobuchar(KlobucharCoefficients {
            alpha: four(&mut input)?,
            beta: four(&mut input)?,
        }),
        1 => NavigationRecord::NeQuick(NeQuickCoefficients {
            ai: [input.f64()?, input.f64()?, input.f64()?],
        }),
        2 => NavigationRecord::LeapSeconds(input.signed()?),
        _ => return Err(input.invalid("record")),
    };
    input.finish()?;
    Ok(record)
}

fn four(input: &mut Decoder<'_>) -> Result<[f64; 4], CodecError> {
    Ok([input.f64()?, input.f64()?, input.f64()?, input.f64()?])
}

/// Encodes an ephemeris.
pub(in crate::store) fn encode_ephemeris(ephemeris: &Ephemeris) -> Vec<u8> {
    let mut out = Encoder::new(VERSION, 256);
    out.satellite(ephemeris.satellite());
    match ephemeris {
        Ephemeris::Keplerian(keplerian) => {
            out.u8(0);
            encode_keplerian(&mut out, keplerian);
        }
        Ephemeris::Glonass(glonass) => {
            out.u8(1);
            encode_glonass(&mut out, glonass);
        }
    }
    out.finish()
}

fn encode_keplerian(out: &mut Encoder, e: &KeplerianEphemeris) {
    let known = MESSAGES.iter().find(|(message, _)| *message == e.message);
    out.u8(known.expect("the table holds every message").1);
    out.time(e.toc);
    out.time(e.toe);
    out.optional_time(e.transmission_time);
    out.unsigned(e.iode.into());
    out.unsigned(e.iodc.into());
    out.unsigned(e.health.into());
    for value in [
        e.af0_s,
        e.af1,
        e.af2_per_s,
        e.sqrt_a,
        e.a_dot_m_s,
        e.eccentricity,
        e.m0_rad,
        e.delta_n_rad_s,
        e.delta_n_dot_rad_s2,
        e.omega_rad,
        e.omega0_rad,
        e.omega_dot_rad_s,
        e.i0_rad,
        e.idot_rad_s,
        e.cuc_rad,
        e.cus_rad,
        e.crc_m,
        e.crs_m,
        e.cic_rad,
        e.cis_rad,
    ] {
        out.f64(value);
    }
    out.optional_f64(e.accuracy_m);
    out.optional_f64(e.fit_interval_h);
    encode_group_delays(out, &e.group_delays);
}

fn encode_group_delays(out: &mut Encoder, delays: &GroupDelays) {
    match *delays {
        GroupDelays::Gps {
            tgd_s,
            isc_l1ca_s,
            isc_l2c_s,
            isc_l5i_s,
            isc_l5q_s,
            isc_l1cd_s,
            isc_l1cp_s,
        } => {
            out.u8(0);
            out.f64(tgd_s);
            for isc in [isc_l1ca_s, isc_l2c_s, isc_l5i_s, isc_l5q_s, isc_l1cd_s, isc_l1cp_s] {
                out.optional_f64(isc);
            }
        }
        GroupDelays::Galileo { bgd_e5a_s, bgd_e5b_s } => {
            out.u8(1);
            out.f64(bgd_e5a_s);
            out.optional_f64(bgd_e5b_s);
        }
        GroupDelays::BeiDou { tgd1_s, tgd2_s } => {
            out.u8(2);
            out.f64(tgd1_s);
            out.f64(tgd2_s);
        }
        GroupDelays::BeiDouCnav { tgd_b1cp_s, tgd_b2ap_s, tgd_b2bi_s, isc_b1cd_s, isc_b2ad_s } => {
            out.u8(3);
            for delay in [tgd_b1cp_s, tgd_b2ap_s, tgd_b2bi_s, isc_b1cd_s, isc_b2ad_s] {
                out.optional_f64(delay);
            }
        }
    }
}

fn encode_glonass(out: &mut Encoder, e: &GlonassEphemeris) {
    out.time(e.toe);
    out.optional_time(e.transmission_time);
    out.vector(&e.position_m);
    out.vector(&e.velocity_m_s);
    out.vector(&e.acceleration_m_s2);
    out.f64(e.clock_bias_s);
    out.f64(e.gamma);
    out.optional_f64(e.delta_tau_s);
    out.signed(e.channel.into());
    out.unsigned(e.health.into());
    out.optional_f64(e.accuracy_m);
    out.u8(e.age_days);
}

/// Decodes an ephemeris.
pub(in crate::store) fn decode_ephemeris(bytes: &[u8]) -> Result<Ephemeris, CodecError> {
    let mut input = Decoder::new(bytes, VERSION)?;
    let satellite = input.satellite()?;
    let ephemeris = match input.u8()? {
        0 => Ephemeris::Keplerian(decode_keplerian(&mut input, satellite)?),
        1 => Ephemeris::Glonass(decode_glonass(&mut input, satellite)?),
        _ => return Err(input.invalid("kind of ephemeris")),
    };
    input.finish()?;
    Ok(ephemeris)
}

fn decode_keplerian(
    input: &mut Decoder<'_>,
    satellite: SatelliteId,
) -> Result<KeplerianEphemeris, CodecError> {
    let number = input.u8()?;
    let known = MESSAGES.iter().find(|(_, stored)| *stored == number);
    // The fields are read in the order of this expression, which is that of `encode_keplerian`.
    Ok(KeplerianEphemeris {
        satellite,
        message: known.ok_or_else(|| input.invalid("message"))?.0,
        toc: input.time()?,
        toe: input.time()?,
        transmission_time: input.optional_time()?,
        iode: input.u32("issue of data")?,
        iodc: input.u32("issue of clock")?,
        health: input.u32("health")?,
        af0_s: input.f64()?,
        af1: input.f64()?,
        af2_per_s: input.f64()?,
        sqrt_a: input.f64()?,
        a_dot_m_s: input.f64()?,
        eccentricity: input.f64()?,
        m0_rad: input.f64()?,
        delta_n_rad_s: input.f64()?,
        delta_n_dot_rad_s2: input.f64()?,
        omega_rad: input.f64()?,
        omega0_rad: input.f64()?,
        omega_dot_rad_s: input.f64()?,
        i0_rad: input.f64()?,
        idot_rad_s: input.f64()?,
        cuc_rad: input.f64()?,
        cus_rad: input.f64()?,
        crc_m: input.f64()?,
        crs_m: input.f64()?,
        cic_rad: input.f64()?,
        cis_rad: input.f64()?,
        accuracy_m: input.optional_f64()?,
        fit_interval_h: input.optional_f64()?,
        group_delays: decode_group_delays(input)?,
    })
}

fn decode_group_delays(input: &mut Decoder<'_>) -> Result<GroupDelays, CodecError> {
    Ok(match input.u8()? {
        0 => GroupDelays::Gps {
            tgd_s: input.f64()?,
            isc_l1ca_s: input.optional_f64()?,
            isc_l2c_s: input.optional_f64()?,
            isc_l5i_s: input.optional_f64()?,
            isc_l5q_s: input.optional_f64()?,
            isc_l1cd_s: input.optional_f64()?,
            isc_l1cp_s: input.optional_f64()?,
        },
        1 => GroupDelays::Galileo { bgd_e5a_s: input.f64()?, bgd_e5b_s: input.optional_f64()? },
        2 => GroupDelays::BeiDou { tgd1_s: input.f64()?, tgd2_s: input.f64()? },
        3 => GroupDelays::BeiDouCnav {
            tgd_b1cp_s: input.optional_f64()?,
            tgd_b2ap_s: input.optional_f64()?,
            tgd_b2bi_s: input.optional_f64()?,
            isc_b1cd_s: input.optional_f64()?,
            isc_b2ad_s: input.optional_f64()?,
        },
        _ => return Err(input.invalid("kind of group delays")),
    })
}

fn decode_glonass(
    input: &mut Decoder<'_>,
    satellite: SatelliteId,
) -> Result<GlonassEphemeris, CodecError> {
    Ok(GlonassEphemeris {
        satellite,
        toe: input.time()?,
        transmission_time: input.optional_time()?,
        position_m: input.vector()?,
        velocity_m_s: input.vector()?,
        acceleration_m_s2: input.vector()?,
        clock_bias_s: input.f64()?,
        gamma: input.f64()?,
        delta_tau_s: input.optional_f64()?,
        channel: i8::try_from(input.signed()?).map_err(|_| input.invalid("channel"))?,
        health: input.u32("health")?,
        accuracy_m: input.optional_f64()?,
        age_days: input.u8()?,
    })
}
