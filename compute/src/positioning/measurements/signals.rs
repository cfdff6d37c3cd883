//! The choice among a satellite's signals.

use crate::gnss::{Band, Constellation, ObservationCode, Signal};

/// Rank of a signal within its band, the best is 0; `None` for signals that are not civil or
/// semi-codeless ranging signals of that constellation and band.
///
/// Order: on L1 the signal that nearly every receiver tracks and the legacy message describes (C/A,
/// E1, B1I); elsewhere pilots before combined before data channels; GPS L2 semi-codeless P(Y)
/// before L2C, because T_GD of the legacy message is that of P(Y). Codes are those of RINEX 3.05,
/// tables 4 to 10, and L1 C/B (1E) of RINEX 4, which newer QZSS satellites send in place of C/A.
pub(crate) fn preference(signal: Signal, band: Band) -> Option<u8> {
    use Constellation as C;
    let order: &[&str] = match (signal.constellation, band) {
        (C::Gps, Band::L1) => &["1C", "1W", "1P", "1Y", "1L", "1X", "1S"],
        (C::Gps, Band::L2) => &["2W", "2P", "2Y", "2L", "2X", "2S", "2C", "2D"],
        (C::Gps, Band::L5) => &["5Q", "5X", "5I"],
        (C::Glonass, Band::L1) => &["1C", "1P", "4B", "4X", "4A"],
        (C::Glonass, Band::L2) => &["2C", "2P", "6B", "6X", "6A"],
        (C::Glonass, Band::L5) => &["3Q", "3X", "3I"],
        (C::Galileo, Band::L1) => &["1C", "1X", "1B", "1Z"],
        (C::Galileo, Band::L2) => &["7Q", "7X", "7I"],
        (C::Galileo, Band::L5) => &["5Q", "5X", "5I", "8Q", "8X", "8I"],
        (C::Galileo, Band::L6) => &["6C", "6X", "6B", "6Z"],
        (C::BeiDou, Band::L1) => &["2I", "2X", "2Q", "1P", "1X", "1D"],
        (C::BeiDou, Band::L2) => &["7I", "7X", "7Q", "7P", "7Z", "7D"],
        (C::BeiDou, Band::L5) => &["5P", "5X", "5D", "8P", "8X", "8D"],
        (C::BeiDou, Band::L6) => &["6I", "6X", "6Q"],
        (C::Qzss, Band::L1) => &["1C", "1E", "1L", "1X", "1S", "1Z"],
        (C::Qzss, Band::L2) => &["2L", "2X", "2S"],
        (C::Qzss, Band::L5) => &["5Q", "5X", "5I"],
        (C::Qzss, Band::L6) => &["6L", "6X", "6S"],
        (C::Gps, Band::L6) | (C::Glonass, Band::L6) => &[],
    };
    place(order, signal.code)
}

fn place(order: &[&str], code: ObservationCode) -> Option<u8> {
    order.iter().position(|known| *known == code.as_str()).map(|place| place as u8)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn place_of(constellation: Constellation, code: &str) -> Option<u8> {
        let signal = Signal { constellation, code: ObservationCode::parse(code).unwrap() };
        preference(signal, signal.band()?)
    }

    #[test]
    fn legacy_first_on_l1_and_pilots_elsewhere() {
        use Constellation as C;
        assert_eq!(place_of(C::Gps, "1C"), Some(0));
        assert!(place_of(C::Gps, "2W") < place_of(C::Gps, "2L"));
        assert!(place_of(C::BeiDou, "2I") < place_of(C::BeiDou, "1P"));
        assert!(place_of(C::Galileo, "5Q") < place_of(C::Galileo, "8Q"));
        assert_eq!(place_of(C::Gps, "1M"), None);
    }
}
