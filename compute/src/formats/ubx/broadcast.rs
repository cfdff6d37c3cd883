//! Content of navigation messages, and fields that several of them share.

use crate::formats::binary::{Bits, Clock, Ionosphere};
use crate::formats::broadcast::per_power;
use crate::gnss::constants::SECONDS_PER_DAY;
use crate::gnss::{Ephemeris, GpsTime, KlobucharCoefficients};

/// The result of a subframe, page or string.
#[derive(Debug, Default)]
pub(in crate::formats) struct Broadcast {
    pub(in crate::formats) ephemeris: Option<Ephemeris>,
    pub(in crate::formats) ionosphere: Option<Ionosphere>,
    /// GPS time minus UTC (s).
    pub(in crate::formats) leap_seconds: Option<i64>,
}

impl Broadcast {
    /// A result that holds an ephemeris only.
    pub(super) fn of(ephemeris: Ephemeris) -> Self {
        Self { ephemeris: Some(ephemeris), ..Self::default() }
    }
}

/// Reads eight bits each of α_0 … α_3 and β_0 … β_3; IS-GPS-200N, table 20-X; BDS-SIS-ICD-B1I-3.0,
/// table 5-7. All zero means that none are broadcast.
pub(super) fn klobuchar(bits: &mut Bits<'_>) -> Option<KlobucharCoefficients> {
    let mut four = |units: [f64; 4]| units.map(|unit| bits.signed_scaled(8, unit));
    let alpha = four([per_power(30), per_power(27), per_power(24), per_power(24)]);
    let beta = four([2048.0, 16_384.0, 65_536.0, 65_536.0]);
    ([alpha, beta] != [[0.0; 4]; 2]).then_some(KlobucharCoefficients { alpha, beta })
}

/// Reads the leap seconds in force from Δt_LS, the week (modulo 256) and day at whose end Δt_LSF
/// takes effect, and Δt_LSF, in fields of `widths`; IS-GPS-200N, 20.3.3.5.2.4; Galileo OS SIS ICD
/// 2.1, 5.1.7.
///
/// `None` if the values differ and the clock cannot decide between them.
pub(super) fn leap_seconds(bits: &mut Bits<'_>, clock: &Clock, widths: [u32; 4]) -> Option<i64> {
    let before = bits.signed(widths[0]);
    let week = bits.unsigned(widths[1]);
    let day = bits.unsigned(widths[2]);
    let after = bits.signed(widths[3]);
    if before == after {
        return Some(before);
    }
    let week = clock.week(week, 256).ok()?;
    let change = GpsTime::from_week_seconds(week, day as f64 * SECONDS_PER_DAY);
    Some(if change <= clock.time()? { after } else { before })
}
