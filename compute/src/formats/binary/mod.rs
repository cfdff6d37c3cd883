//! Common parts of the receivers' binary formats: bit fields, CRC-24Q, the clock that completes
//! truncated times, and reasons for refusals.

mod bits;
mod clock;
mod crc;
mod refusal;

pub(in crate::formats) use bits::Bits;
pub(in crate::formats) use clock::Clock;
pub use clock::TimeReference;
pub(in crate::formats) use crc::{CRC24Q_SHIFT_LIMIT, crc24q, crc24q_after, crc24q_shifted};
pub use refusal::Refusal;

use crate::gnss::{KlobucharCoefficients, Navigation, NeQuickCoefficients};

/// Ionosphere coefficients of a navigation message.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Ionosphere {
    /// Klobuchar coefficients of GPS.
    Gps(KlobucharCoefficients),
    /// Klobuchar coefficients of BeiDou D1 and D2.
    BeiDou(KlobucharCoefficients),
    /// Klobuchar coefficients of QZSS.
    Qzss(KlobucharCoefficients),
    /// NeQuick-G coefficients of Galileo.
    Galileo(NeQuickCoefficients),
}

impl Ionosphere {
    /// Replaces the coefficients of its kind.
    pub(crate) fn apply_to(self, navigation: &mut Navigation) {
        match self {
            Self::Gps(coefficients) => navigation.klobuchar_gps = Some(coefficients),
            Self::BeiDou(coefficients) => navigation.klobuchar_beidou = Some(coefficients),
            Self::Qzss(coefficients) => navigation.klobuchar_qzss = Some(coefficients),
            Self::Galileo(coefficients) => navigation.nequick = Some(coefficients),
        }
    }
}
