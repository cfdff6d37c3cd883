//! Bits of State and AccumulatedDeltaRangeState, and what they say of the time of transmission.
//!
//! Source: Android API reference, `GnssMeasurement`, constants and `getReceivedSvTimeNanos`.

use super::Cause;
use crate::gnss::Constellation;
use crate::gnss::constants::NS_PER_SECOND;

pub(super) const CODE_LOCK: i64 = 1 << 0;
pub(super) const BIT_SYNC: i64 = 1 << 1;
pub(super) const SUBFRAME_SYNC: i64 = 1 << 2;
pub(super) const TOW_DECODED: i64 = 1 << 3;
pub(super) const MSEC_AMBIGUOUS: i64 = 1 << 4;
pub(super) const GLO_STRING_SYNC: i64 = 1 << 6;
pub(super) const GLO_TOD_DECODED: i64 = 1 << 7;
pub(super) const BDS_D2_SUBFRAME_SYNC: i64 = 1 << 9;
pub(super) const GAL_E1BC_CODE_LOCK: i64 = 1 << 10;
pub(super) const GAL_E1C_2ND_CODE_LOCK: i64 = 1 << 11;
pub(super) const GAL_E1B_PAGE_SYNC: i64 = 1 << 12;
pub(super) const TOW_KNOWN: i64 = 1 << 14;
pub(super) const GLO_TOD_KNOWN: i64 = 1 << 15;

pub(super) const ADR_VALID: i64 = 1 << 0;
pub(super) const ADR_RESET: i64 = 1 << 1;
pub(super) const ADR_CYCLE_SLIP: i64 = 1 << 2;
pub(super) const ADR_HALF_CYCLE_RESOLVED: i64 = 1 << 3;
pub(super) const ADR_HALF_CYCLE_REPORTED: i64 = 1 << 4;

const MS: i64 = NS_PER_SECOND / 1000;
const DAY_NS: i64 = 86_400 * NS_PER_SECOND;
const WEEK_NS: i64 = 7 * DAY_NS;
const TOW: i64 = TOW_DECODED | TOW_KNOWN;
const TOD: i64 = GLO_TOD_DECODED | GLO_TOD_KNOWN;

/// The period of ReceivedSvTimeNanos (ns): the largest that a set bit of `state` gives.
///
/// | constellation | bit | period |
/// |---|---|---|
/// | GPS, QZSS, BeiDou, Galileo | TOW decoded or known | a week |
/// | GPS, QZSS, BeiDou D1 | subframe sync | 6 s |
/// | BeiDou D2 | D2 subframe sync | 0.6 s |
/// | Galileo | E1B page sync | 2 s |
/// | Galileo | E1C secondary code lock | 0.1 s |
/// | GLONASS | time of day decoded or known | a day |
/// | GLONASS | string sync | 2 s |
///
/// # Errors
/// The code is not tracked, or the period is shorter than any time of flight.
pub(super) fn period_ns(constellation: Constellation, state: i64) -> Result<i64, Cause> {
    use Constellation as C;
    let locks = match constellation {
        C::Galileo => CODE_LOCK | GAL_E1BC_CODE_LOCK | GAL_E1C_2ND_CODE_LOCK,
        C::Gps | C::Glonass | C::BeiDou | C::Qzss => CODE_LOCK,
    };
    if state & locks == 0 {
        return Err(Cause::NoCodeLock);
    }
    let periods: &[(i64, i64)] = match constellation {
        C::Gps | C::Qzss => &[(TOW, WEEK_NS), (SUBFRAME_SYNC, 6_000 * MS)],
        C::BeiDou => {
            &[(TOW, WEEK_NS), (SUBFRAME_SYNC, 6_000 * MS), (BDS_D2_SUBFRAME_SYNC, 600 * MS)]
        }
        C::Galileo => {
            &[(TOW, WEEK_NS), (GAL_E1B_PAGE_SYNC, 2_000 * MS), (GAL_E1C_2ND_CODE_LOCK, 100 * MS)]
        }
        C::Glonass => &[(TOD, DAY_NS), (GLO_STRING_SYNC, 2_000 * MS)],
    };
    let known = periods.iter().find(|(bits, _)| state & bits != 0 && state & MSEC_AMBIGUOUS == 0);
    known.map(|(_, period_ns)| *period_ns).ok_or(Cause::Ambiguous)
}

/// The bits of a signal whose time of transmission is decoded.
pub(super) const fn decoded(constellation: Constellation) -> i64 {
    let tracked = CODE_LOCK | BIT_SYNC;
    match constellation {
        Constellation::Glonass => tracked | GLO_STRING_SYNC | TOD,
        Constellation::Galileo => {
            tracked | GAL_E1BC_CODE_LOCK | GAL_E1C_2ND_CODE_LOCK | GAL_E1B_PAGE_SYNC | TOW
        }
        Constellation::Gps | Constellation::BeiDou | Constellation::Qzss => {
            tracked | SUBFRAME_SYNC | TOW
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Values of State with their bits spelt out in the reference's decimal values.
    #[test]
    fn periods_by_state() {
        use Constellation as C;
        for (constellation, state, expected) in [
            (C::Gps, 1 + 2 + 4 + 8 + 16_384, Ok(WEEK_NS)),
            (C::Gps, 1 + 16_384, Ok(WEEK_NS)),
            (C::Gps, 1 + 2 + 4, Ok(6_000_000_000)),
            (C::Gps, 1 + 2, Err(Cause::Ambiguous)),
            (C::Gps, 1 + 8 + 16, Err(Cause::Ambiguous)),
            (C::Gps, 8 + 16_384, Err(Cause::NoCodeLock)),
            (C::Qzss, 1 + 2_048, Err(Cause::Ambiguous)),
            (C::Galileo, 1_024 + 2_048, Ok(100_000_000)),
            (C::Galileo, 1_024 + 4_096, Ok(2_000_000_000)),
            (C::Galileo, 1_024, Err(Cause::Ambiguous)),
            (C::BeiDou, 1 + 256 + 512, Ok(600_000_000)),
            (C::Glonass, 1 + 64 + 128, Ok(86_400_000_000_000)),
            (C::Glonass, 1 + 32_768, Ok(86_400_000_000_000)),
            (C::Glonass, 1 + 2 + 64, Ok(2_000_000_000)),
            (C::Glonass, 1 + 8, Err(Cause::Ambiguous)),
        ] {
            assert_eq!(period_ns(constellation, state), expected, "{constellation:?} {state}");
        }
    }
}
