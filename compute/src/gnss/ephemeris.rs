//! Broadcast ephemerides with the parameters of their messages, in SI units.

use nalgebra::Vector3;

use super::{GpsTime, SatelliteId};

/// Accuracy of an ephemeris whose message predicts none, or warns against use (m): the last bound
/// of the URA; IS-GPS-200N, 20.3.3.3.1.3. Other constellations' messages are given the same.
pub const NO_PREDICTION_M: f64 = 6_144.0;

/// Broadcast orbit and clock of one satellite and issue.
#[derive(Clone, Debug, PartialEq)]
pub enum Ephemeris {
    /// Keplerian elements: GPS, Galileo, BeiDou, QZSS.
    Keplerian(KeplerianEphemeris),
    /// Position, velocity and acceleration: GLONASS.
    Glonass(GlonassEphemeris),
}

impl Ephemeris {
    /// The satellite that the ephemeris describes.
    pub const fn satellite(&self) -> SatelliteId {
        match self {
            Self::Keplerian(e) => e.satellite,
            Self::Glonass(e) => e.satellite,
        }
    }

    /// Time of ephemeris: reference time of the orbit.
    pub const fn toe(&self) -> GpsTime {
        match self {
            Self::Keplerian(e) => e.toe,
            Self::Glonass(e) => e.toe,
        }
    }

    /// Time of clock: reference time of the clock polynomial.
    pub const fn toc(&self) -> GpsTime {
        match self {
            Self::Keplerian(e) => e.toc,
            Self::Glonass(e) => e.toe,
        }
    }

    /// Whether it is of a message that RINEX 3 has a record for: all but the civil ones.
    pub const fn is_legacy(&self) -> bool {
        use NavigationMessage::{Cnav, Cnav2, Cnv1, Cnv2, Cnv3};
        match self {
            Self::Keplerian(e) => !matches!(e.message, Cnav | Cnav2 | Cnv1 | Cnv2 | Cnv3),
            Self::Glonass(_) => true,
        }
    }

    /// Issue of data; with `toe` it identifies an ephemeris of a satellite.
    pub const fn issue(&self) -> u32 {
        match self {
            Self::Keplerian(e) => e.iode,
            Self::Glonass(e) => e.age_days as u32,
        }
    }

    /// FDMA channel of a GLONASS satellite, otherwise `None`.
    pub const fn glonass_channel(&self) -> Option<i8> {
        match self {
            Self::Keplerian(_) => None,
            Self::Glonass(e) => Some(e.channel),
        }
    }
}

/// The navigation message of an ephemeris; it defines the clock's signals and the validity.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum NavigationMessage {
    /// GPS or QZSS legacy (L1 C/A).
    Lnav,
    /// GPS or QZSS civil (L2C, L5).
    Cnav,
    /// GPS or QZSS civil on L1C.
    Cnav2,
    /// Galileo I/NAV (E1-B, E5b-I): clock of the pair E1, E5b.
    Inav,
    /// Galileo F/NAV (E5a-I): clock of the pair E1, E5a.
    Fnav,
    /// BeiDou D1 (MEO and IGSO, B1I, B2I, B3I).
    D1,
    /// BeiDou D2 (GEO).
    D2,
    /// BeiDou B-CNAV1 (B1C).
    Cnv1,
    /// BeiDou B-CNAV2 (B2a).
    Cnv2,
    /// BeiDou B-CNAV3 (B2b).
    Cnv3,
    /// GLONASS FDMA.
    Fdma,
}

/// Group delays of a message, by constellation (s).
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum GroupDelays {
    /// GPS and QZSS: T_GD, and inter-signal corrections where the message is CNAV or CNAV-2.
    Gps {
        /// T_GD (s).
        tgd_s: f64,
        /// ISC of L1 C/A (s).
        isc_l1ca_s: Option<f64>,
        /// ISC of L2C (s).
        isc_l2c_s: Option<f64>,
        /// ISC of L5 I5 (s).
        isc_l5i_s: Option<f64>,
        /// ISC of L5 Q5 (s).
        isc_l5q_s: Option<f64>,
        /// ISC of L1C data (s).
        isc_l1cd_s: Option<f64>,
        /// ISC of L1C pilot (s).
        isc_l1cp_s: Option<f64>,
    },
    /// Galileo broadcast group delays.
    Galileo {
        /// BGD(E1, E5a) (s).
        bgd_e5a_s: f64,
        /// BGD(E1, E5b) (s); F/NAV does not carry it.
        bgd_e5b_s: Option<f64>,
    },
    /// BeiDou D1 and D2; the clock refers to B3I.
    BeiDou {
        /// T_GD1, B1I against B3I (s).
        tgd1_s: f64,
        /// T_GD2, B2I against B3I (s).
        tgd2_s: f64,
    },
    /// BeiDou B-CNAV; the clock refers to B3I.
    BeiDouCnav {
        /// T_GD of the B1C pilot (s).
        tgd_b1cp_s: Option<f64>,
        /// T_GD of the B2a pilot (s).
        tgd_b2ap_s: Option<f64>,
        /// T_GD of B2b-I (s).
        tgd_b2bi_s: Option<f64>,
        /// ISC of the B1C data channel (s).
        isc_b1cd_s: Option<f64>,
        /// ISC of the B2a data channel (s).
        isc_b2ad_s: Option<f64>,
    },
}

/// Keplerian broadcast ephemeris.
///
/// Symbols of IS-GPS-200N, table 20-II; Galileo OS SIS ICD 2.1, 5.1.1 and BDS-SIS-ICD-B1I-3.0,
/// 5.2.4 define the same set. Angles in radians, lengths in metres, times in seconds. CNAV's
/// A_0 + ΔA is stored as its square root; its rates are zero in legacy messages.
#[derive(Clone, Debug, PartialEq)]
pub struct KeplerianEphemeris {
    /// The satellite that broadcast the message.
    pub satellite: SatelliteId,
    /// The navigation message that carried the ephemeris.
    pub message: NavigationMessage,
    /// Time of clock toc: reference time of the clock polynomial.
    pub toc: GpsTime,
    /// Time of ephemeris toe: reference time of the orbit.
    pub toe: GpsTime,
    /// Time of transmission of the message, where known.
    pub transmission_time: Option<GpsTime>,
    /// Clock bias a_f0 (s).
    pub af0_s: f64,
    /// Clock drift a_f1 (s/s).
    pub af1: f64,
    /// Clock drift rate a_f2 (s/s²).
    pub af2_per_s: f64,
    /// Issue of data: IODE, IODnav or AODE.
    pub iode: u32,
    /// Issue of clock: IODC or AODC.
    pub iodc: u32,
    /// Square root of the semi-major axis √A (√m).
    pub sqrt_a: f64,
    /// Rate of the semi-major axis Ȧ (m/s).
    pub a_dot_m_s: f64,
    /// Eccentricity e.
    pub eccentricity: f64,
    /// Mean anomaly at toe M_0 (rad).
    pub m0_rad: f64,
    /// Mean motion difference Δn (rad/s).
    pub delta_n_rad_s: f64,
    /// Rate of the mean motion difference Δṅ (rad/s²).
    pub delta_n_dot_rad_s2: f64,
    /// Argument of perigee ω (rad).
    pub omega_rad: f64,
    /// Longitude of the ascending node at weekly epoch Ω_0 (rad).
    pub omega0_rad: f64,
    /// Rate of the right ascension Ω̇ (rad/s).
    pub omega_dot_rad_s: f64,
    /// Inclination at toe i_0 (rad).
    pub i0_rad: f64,
    /// Rate of the inclination IDOT (rad/s).
    pub idot_rad_s: f64,
    /// Harmonic correction of the argument of latitude, cosine C_uc (rad).
    pub cuc_rad: f64,
    /// Harmonic correction of the argument of latitude, sine C_us (rad).
    pub cus_rad: f64,
    /// Harmonic correction of the radius, cosine C_rc (m).
    pub crc_m: f64,
    /// Harmonic correction of the radius, sine C_rs (m).
    pub crs_m: f64,
    /// Harmonic correction of the inclination, cosine C_ic (rad).
    pub cic_rad: f64,
    /// Harmonic correction of the inclination, sine C_is (rad).
    pub cis_rad: f64,
    /// Broadcast accuracy, URA or SISA (m); [`NO_PREDICTION_M`] where the message warns against
    /// use, `None` where its source does not state one.
    pub accuracy_m: Option<f64>,
    /// Health word as broadcast; zero is healthy.
    pub health: u32,
    /// Fit interval (h), where the message gives one.
    pub fit_interval_h: Option<f64>,
    /// Group delays of the message (s).
    pub group_delays: GroupDelays,
}

/// GLONASS broadcast ephemeris; GLONASS ICD 5.1, table 4.5. PZ-90.02 is treated as WGS 84.
#[derive(Clone, Debug, PartialEq)]
pub struct GlonassEphemeris {
    /// The satellite that broadcast the message.
    pub satellite: SatelliteId,
    /// Reference time t_b.
    pub toe: GpsTime,
    /// Start of the frame that carried it, where known.
    pub transmission_time: Option<GpsTime>,
    /// Position at toe, Earth-fixed (m).
    pub position_m: Vector3<f64>,
    /// Velocity at toe, Earth-fixed (m/s).
    pub velocity_m_s: Vector3<f64>,
    /// Acceleration of Sun and Moon (m/s²).
    pub acceleration_m_s2: Vector3<f64>,
    /// Clock bias −τ_n (s), positive if the satellite's clock is ahead.
    pub clock_bias_s: f64,
    /// Relative frequency offset γ_n.
    pub gamma: f64,
    /// Difference of G2 and G1 delays Δτ_n (s), where given.
    pub delta_tau_s: Option<f64>,
    /// FDMA channel, −7 … 13.
    pub channel: i8,
    /// Health word as broadcast; zero is healthy.
    pub health: u32,
    /// Broadcast accuracy F_T (m), where given.
    pub accuracy_m: Option<f64>,
    /// Age of the information E_n (days).
    pub age_days: u8,
}
