//! What the binary formats of receivers share: bit fields, CRC-24Q, the clock that completes
//! truncated times, and the reasons for which something is refused.

mod bits;
mod clock;
mod crc;
mod refusal;

pub(in crate::formats) use bits::Bits;
pub(in crate::formats) use clock::Clock;
pub use clock::TimeReference;
pub(in crate::formats) use crc::crc24q;
pub use refusal::Refusal;

use crate::gnss::{KlobucharCoefficients, Navigation, NeQuickCoefficients};

/// Ionosphere coefficients of a satellite's message.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Ionosphere {
    /// Klobuchar's of GPS.
    Gps(KlobucharCoefficients),
    /// Klobuchar's of BeiDou D1 and D2.
    BeiDou(KlobucharCoefficients),
    /// Klobuchar's of QZSS.
    Qzss(KlobucharCoefficients),
    /// NeQuick-G's of Galileo.
    Galileo(NeQuickCoefficients),
}

impl Ionosphere {
    /// Takes the place of the coefficients of its kind.
    pub fn apply_to(self, navigation: &mut Navigation) {
        match self {
            Self::Gps(coefficients) => navigation.klobuchar_gps = Some(coefficients),
            Self::BeiDou(coefficients) => navigation.klobuchar_beidou = Some(coefficients),
            Self::Qzss(coefficients) => navigation.klobuchar_qzss = Some(coefficients),
            Self::Galileo(coefficients) => navigation.nequick = Some(coefficients),
        }
    }
}
