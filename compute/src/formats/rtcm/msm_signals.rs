//! Signals of MSM: number in the signal mask to RINEX code.
//!
//! RTCM 10403.3, tables 3.5-91 (GPS), 3.5-96 (GLONASS), 3.5-99 (Galileo), 3.5-105 (QZSS), 3.5-108
//! (BeiDou), with the BeiDou-3 signals of the standard's later amendments.

use crate::gnss::{Constellation, ObservationCode};

/// Codes by number, 1 … 32; blank for reserved numbers.
type Table = [&'static [u8; 2]; 32];

const NONE: &[u8; 2] = b"  ";

const GPS: Table = table(&[
    (2, b"1C"),
    (3, b"1P"),
    (4, b"1W"),
    (8, b"2C"),
    (9, b"2P"),
    (10, b"2W"),
    (15, b"2S"),
    (16, b"2L"),
    (17, b"2X"),
    (22, b"5I"),
    (23, b"5Q"),
    (24, b"5X"),
    (30, b"1S"),
    (31, b"1L"),
    (32, b"1X"),
]);

const GLONASS: Table = table(&[(2, b"1C"), (3, b"1P"), (8, b"2C"), (9, b"2P")]);

const GALILEO: Table = table(&[
    (2, b"1C"),
    (3, b"1A"),
    (4, b"1B"),
    (5, b"1X"),
    (6, b"1Z"),
    (8, b"6C"),
    (9, b"6A"),
    (10, b"6B"),
    (11, b"6X"),
    (12, b"6Z"),
    (14, b"7I"),
    (15, b"7Q"),
    (16, b"7X"),
    (18, b"8I"),
    (19, b"8Q"),
    (20, b"8X"),
    (22, b"5I"),
    (23, b"5Q"),
    (24, b"5X"),
]);

const QZSS: Table = table(&[
    (2, b"1C"),
    (9, b"6S"),
    (10, b"6L"),
    (11, b"6X"),
    (15, b"2S"),
    (16, b"2L"),
    (17, b"2X"),
    (22, b"5I"),
    (23, b"5Q"),
    (24, b"5X"),
    (30, b"1S"),
    (31, b"1L"),
    (32, b"1X"),
]);

const BEIDOU: Table = table(&[
    (2, b"2I"),
    (3, b"2Q"),
    (4, b"2X"),
    (8, b"6I"),
    (9, b"6Q"),
    (10, b"6X"),
    (14, b"7I"),
    (15, b"7Q"),
    (16, b"7X"),
    (22, b"5D"),
    (23, b"5P"),
    (24, b"5X"),
    (25, b"7D"),
    (30, b"1D"),
    (31, b"1P"),
    (32, b"1X"),
]);

const fn table(entries: &[(usize, &'static [u8; 2])]) -> Table {
    let mut table = [NONE; 32];
    let mut index = 0;
    while index < entries.len() {
        let (number, code) = entries[index];
        table[number - 1] = code;
        index += 1;
    }
    table
}

/// The code of signal `number` (1 … 32), if the table has one.
pub(super) const fn code(constellation: Constellation, number: u8) -> Option<ObservationCode> {
    let table = match constellation {
        Constellation::Gps => &GPS,
        Constellation::Glonass => &GLONASS,
        Constellation::Galileo => &GALILEO,
        Constellation::Qzss => &QZSS,
        Constellation::BeiDou => &BEIDOU,
    };
    let [band, attribute] = *table[number as usize - 1];
    ObservationCode::new(band, attribute)
}
