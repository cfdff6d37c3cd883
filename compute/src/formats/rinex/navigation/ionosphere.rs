//! Ionosphere coefficients, from headers and version 4 records.

use super::record::Record;
use crate::formats::rinex::SkipReason;
use crate::gnss::{KlobucharCoefficients, Navigation, NeQuickCoefficients};

/// Klobuchar coefficients; `None` if all are zero, which means that none are broadcast.
pub(super) fn klobuchar(alpha: [f64; 4], beta: [f64; 4]) -> Option<KlobucharCoefficients> {
    ([alpha, beta] != [[0.0; 4]; 2]).then_some(KlobucharCoefficients { alpha, beta })
}

/// NeQuick-G coefficients; `None` if all are zero: none are broadcast (Galileo OS SIS ICD, 5.1.6).
pub(super) fn nequick(ai: [f64; 3]) -> Option<NeQuickCoefficients> {
    (ai != [0.0; 3]).then_some(NeQuickCoefficients { ai })
}

/// Applies a `> ION` record of version 4; a later record replaces an earlier one.
///
/// BeiDou's BDGIM (`CNVX`) and QZSS's model for Japan (region code 1) are not decoded.
pub(super) fn apply(
    letter: u8,
    message: &[u8; 4],
    record: &Record,
    navigation: &mut Navigation,
) -> Result<(), SkipReason> {
    let malformed = SkipReason::MalformedEphemeris;
    match (letter, message) {
        (b'G', b"LNAV" | b"CNVX") => {
            navigation.klobuchar_gps = klobuchar_of(record).ok_or(malformed)?;
        }
        (b'J', b"LNAV" | b"CNVX") => {
            if record.or_zero(2, 1) == Some(1.0) {
                return Err(SkipReason::OtherMessage);
            }
            navigation.klobuchar_qzss = klobuchar_of(record).ok_or(malformed)?;
        }
        (b'C', b"D1D2") => {
            navigation.klobuchar_beidou = klobuchar_of(record).ok_or(malformed)?;
        }
        (b'E', b"IFNV") => {
            navigation.nequick = nequick_of(record).ok_or(malformed)?;
        }
        (b'G' | b'J' | b'C' | b'E', _) => return Err(SkipReason::OtherMessage),
        _ => return Err(SkipReason::OtherConstellation(char::from(letter))),
    }
    Ok(())
}

fn klobuchar_of(record: &Record) -> Option<Option<KlobucharCoefficients>> {
    let need = |row, column| record.need(row, column);
    let alpha = [need(0, 1)?, need(0, 2)?, need(0, 3)?, need(1, 0)?];
    let beta = [need(1, 1)?, need(1, 2)?, need(1, 3)?, need(2, 0)?];
    Some(klobuchar(alpha, beta))
}

fn nequick_of(record: &Record) -> Option<Option<NeQuickCoefficients>> {
    Some(nequick([record.need(0, 1)?, record.need(0, 2)?, record.need(0, 3)?]))
}
