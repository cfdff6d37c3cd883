//! Invented ephemerides of every constellation, for the tests of this module.

use nalgebra::Vector3;

use crate::gnss::{
    Ephemeris, GlonassEphemeris, GpsTime, GroupDelays, KeplerianEphemeris, NavigationMessage,
};

/// Reference time of all ephemerides: week 2244, 388 800 s.
pub(super) fn toe() -> GpsTime {
    GpsTime::from_week_seconds(2244, 388_800.0)
}

/// G05, with the rates that only CNAV broadcasts.
pub(super) fn gps() -> KeplerianEphemeris {
    KeplerianEphemeris {
        satellite: "G05".parse().unwrap(),
        message: NavigationMessage::Lnav,
        toc: toe(),
        toe: toe(),
        transmission_time: None,
        af0_s: 2.5e-4,
        af1: -4.5e-12,
        af2_per_s: 1e-18,
        iode: 48,
        iodc: 48,
        sqrt_a: 5153.7,
        a_dot_m_s: 0.01,
        eccentricity: 0.012,
        m0_rad: 0.7,
        delta_n_rad_s: 4.5e-9,
        delta_n_dot_rad_s2: 1e-14,
        omega_rad: 0.9,
        omega0_rad: -1.5,
        omega_dot_rad_s: -8.1e-9,
        i0_rad: 0.96,
        idot_rad_s: 2e-10,
        cuc_rad: 2.5e-6,
        cus_rad: 1.5e-6,
        crc_m: 360.0,
        crs_m: 46.0,
        cic_rad: 9e-8,
        cis_rad: -1.1e-7,
        accuracy_m: Some(2.0),
        health: 0,
        fit_interval_h: None,
        group_delays: GroupDelays::Gps {
            tgd_s: -5e-9,
            isc_l1ca_s: None,
            isc_l2c_s: None,
            isc_l5i_s: None,
            isc_l5q_s: None,
            isc_l1cd_s: None,
            isc_l1cp_s: None,
        },
    }
}

/// E12 with I/NAV.
pub(super) fn galileo() -> KeplerianEphemeris {
    KeplerianEphemeris {
        satellite: "E12".parse().unwrap(),
        message: NavigationMessage::Inav,
        sqrt_a: 5440.6,
        eccentricity: 0.0003,
        a_dot_m_s: 0.0,
        delta_n_dot_rad_s2: 0.0,
        group_delays: GroupDelays::Galileo { bgd_e5a_s: 2e-9, bgd_e5b_s: Some(3e-9) },
        ..gps()
    }
}

/// C03, geostationary.
pub(super) fn beidou_geostationary() -> KeplerianEphemeris {
    KeplerianEphemeris {
        satellite: "C03".parse().unwrap(),
        message: NavigationMessage::D2,
        sqrt_a: 6493.4,
        eccentricity: 0.0006,
        i0_rad: 0.064,
        omega_dot_rad_s: 3e-9,
        crc_m: -450.0,
        crs_m: -510.0,
        ..beidou()
    }
}

/// C08, inclined geosynchronous.
pub(super) fn beidou() -> KeplerianEphemeris {
    KeplerianEphemeris {
        satellite: "C08".parse().unwrap(),
        message: NavigationMessage::D1,
        sqrt_a: 6493.4,
        eccentricity: 0.004,
        group_delays: GroupDelays::BeiDou { tgd1_s: 4e-9, tgd2_s: -2e-9 },
        ..galileo()
    }
}

/// J02, with the eccentricity of a QZSS orbit.
pub(super) fn qzss() -> KeplerianEphemeris {
    KeplerianEphemeris {
        satellite: "J02".parse().unwrap(),
        sqrt_a: 6493.4,
        eccentricity: 0.075,
        ..gps()
    }
}

/// R07, on a circular orbit of 25 510 km.
pub(super) fn glonass() -> GlonassEphemeris {
    GlonassEphemeris {
        satellite: "R07".parse().unwrap(),
        toe: toe(),
        transmission_time: None,
        position_m: Vector3::new(8_203_926.0, 17_381_693.0, -16_773_025.0),
        velocity_m_s: Vector3::new(-1_689.2, -1_558.9, -2_441.2),
        acceleration_m_s2: Vector3::new(1e-6, -2e-6, 3e-6),
        clock_bias_s: 2e-5,
        gamma: 9.1e-13,
        delta_tau_s: Some(-3e-9),
        channel: 1,
        health: 0,
        accuracy_m: None,
        age_days: 0,
    }
}

/// One ephemeris of each kind.
pub(super) fn all() -> Vec<Ephemeris> {
    vec![
        Ephemeris::Keplerian(gps()),
        Ephemeris::Keplerian(galileo()),
        Ephemeris::Keplerian(beidou()),
        Ephemeris::Keplerian(beidou_geostationary()),
        Ephemeris::Keplerian(qzss()),
        Ephemeris::Glonass(glonass()),
    ]
}
