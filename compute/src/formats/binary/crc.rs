//! CRC-24Q, of RTCM 3 frames and Galileo pages; RTCM 10403.3, 4.2; Galileo OS SIS ICD 2.1, 4.3.2.3.

/// x²⁴ + x²³ + x¹⁸ + x¹⁷ + x¹⁴ + x¹¹ + x¹⁰ + x⁷ + x⁶ + x⁵ + x⁴ + x³ + x + 1.
const POLYNOMIAL: u32 = 0x186_4cfb;

/// CRCs of one byte followed by 0, 1, 2 and 3 zero bytes.
const TABLES: [[u32; 256]; 4] = tables();

/// x⁸ⁿ modulo the polynomial, for n bytes.
const POWERS: [u32; CRC24Q_SHIFT_LIMIT + 1] = powers();
/// Most zero bytes by which a CRC is shifted: the longest frame of RTCM 3 has 1029 bytes.
pub(in crate::formats) const CRC24Q_SHIFT_LIMIT: usize = 1029;

const fn powers() -> [u32; CRC24Q_SHIFT_LIMIT + 1] {
    let mut powers = [1; CRC24Q_SHIFT_LIMIT + 1];
    let mut bytes = 1;
    while bytes < powers.len() {
        let before = powers[bytes - 1];
        powers[bytes] = ((before << 8) & 0xff_ffff) ^ TABLES[0][(before >> 16) as usize];
        bytes += 1;
    }
    powers
}

const fn tables() -> [[u32; 256]; 4] {
    let mut tables = [[0; 256]; 4];
    let mut byte = 0;
    while byte < 256 {
        let mut crc = (byte as u32) << 16;
        let mut bit = 0;
        while bit < 8 {
            crc <<= 1;
            if crc & 0x100_0000 != 0 {
                crc ^= POLYNOMIAL;
            }
            bit += 1;
        }
        tables[0][byte] = crc;
        byte += 1;
    }
    let mut more = 1;
    while more < 4 {
        let mut byte = 0;
        while byte < 256 {
            let crc = tables[more - 1][byte];
            tables[more][byte] = ((crc << 8) & 0xff_ffff) ^ tables[0][(crc >> 16) as usize];
            byte += 1;
        }
        more += 1;
    }
    tables
}

/// The CRC of `bytes`; zero if their own CRC follows them.
pub(in crate::formats) fn crc24q(bytes: &[u8]) -> u32 {
    let (fours, rest) = bytes.as_chunks::<4>();
    let mut crc = 0;
    for &[a, b, c, d] in fours {
        let place = |shift: u32, byte: u8| ((crc >> shift) as u8 ^ byte) as usize;
        crc = TABLES[3][place(16, a)]
            ^ TABLES[2][place(8, b)]
            ^ TABLES[1][place(0, c)]
            ^ TABLES[0][d as usize];
    }
    for &byte in rest {
        crc = crc24q_after(crc, byte);
    }
    crc
}

/// The CRC of bytes with the CRC `crc` and one byte more.
pub(in crate::formats) const fn crc24q_after(crc: u32, byte: u8) -> u32 {
    ((crc << 8) & 0xff_ffff) ^ TABLES[0][((crc >> 16) as u8 ^ byte) as usize]
}

/// The CRC of bytes with the CRC `crc` and this many zero bytes more, at most
/// [`CRC24Q_SHIFT_LIMIT`]: crc·x⁸ⁿ modulo the polynomial.
pub(in crate::formats) fn crc24q_shifted(crc: u32, bytes: usize) -> u32 {
    let power = POWERS[bytes];
    let mut product = 0;
    for bit in (0..24).rev() {
        product <<= 1;
        product ^= (product >> 24) * POLYNOMIAL;
        product ^= (power >> bit & 1) * crc;
    }
    product
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_check_value_of_the_catalogue() {
        // CRC-24/LTE-A has this polynomial, no initial value and no reflection, as CRC-24Q has.
        assert_eq!(crc24q(b"123456789"), 0xcd_e703);
        // A station message of RTCM 10403.1, 4.2, an example frame with its CRC.
        let frame = [
            0xd3, 0x00, 0x13, 0x3e, 0xd7, 0xd3, 0x02, 0x02, 0x98, 0x0e, 0xde, 0xef, 0x34, 0xb4,
            0xbd, 0x62, 0xac, 0x09, 0x41, 0x98, 0x6f, 0x33, 0x36, 0x0b, 0x98,
        ];
        assert_eq!(crc24q(&frame), 0);
    }

    #[test]
    fn zero_bytes_shift_a_crc() {
        for count in [0, 1, 2, 3, 100, CRC24Q_SHIFT_LIMIT] {
            let bytes = [b"123456789".as_slice(), &vec![0; count]].concat();
            assert_eq!(crc24q_shifted(0xcd_e703, count), crc24q(&bytes), "{count}");
        }
    }
}
