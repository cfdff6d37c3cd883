//! Fixed-width fields: numbers, dates, satellites.

use crate::gnss::{CivilTime, Constellation};

/// Content of a numeric field.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Value {
    /// Blank or zero: RINEX's sign for a missing value.
    Missing,
    /// A finite number that is not zero.
    Number(f64),
    /// Text that is not a number.
    Malformed,
}

const SPACES: u128 = u128::from_le_bytes([b' '; 16]);
const ZEROS: u128 = u128::from_le_bytes([b'0'; 16]);
/// Mask of the number's 14 columns in an observation field of 16.
const NUMBER: u128 = (1 << 112) - 1;
const HIGH_NIBBLES: u64 = 0xf0f0_f0f0_f0f0_f0f0;
const DIGITS: u64 = 0x3030_3030_3030_3030;

/// The number of an observation field, format F14.3, followed by two indicator columns.
///
/// The digits are read as one integer m, eight at a time; m < 2⁵³ and 10³ are exact, so m / 10³ is
/// the correctly rounded value. Other layouts are parsed by [`general_value`].
pub(super) fn observation_value(field: &[u8; 16]) -> Value {
    let number = u128::from_le_bytes(*field) & NUMBER;
    let not_blank = number ^ (SPACES & NUMBER);
    if not_blank == 0 {
        return Value::Missing;
    }
    let leading_bits = not_blank.trailing_zeros() & !7;
    let negative = (number >> leading_bits) as u8 == b'-';
    let before_digits = (1_u128 << (leading_bits + u32::from(negative) * 8)) - 1;
    let digits = (number & !before_digits) | (ZEROS & before_digits);
    let (low, high) = (digits as u64, (digits >> 64) as u64);
    // Columns 9 and 10, then those after the point in column 11: the last eight digits.
    let tail = ((high & 0xffff) | (high >> 8 & 0xff_ffff_0000)) << 24 | (DIGITS & 0xff_ffff);
    if (high >> 16) as u8 != b'.' || !all_digits(low) || !all_digits(tail) {
        return general_value(&field[..14]);
    }
    let thousandths = eight_digits(low) * 100_000 + eight_digits(tail);
    if thousandths == 0 {
        return Value::Missing;
    }
    let magnitude = thousandths as f64 / 1000.0;
    Value::Number(if negative { -magnitude } else { magnitude })
}

const fn all_digits(bytes: u64) -> bool {
    bytes & HIGH_NIBBLES == DIGITS
        && bytes.wrapping_add(0x0606_0606_0606_0606) & HIGH_NIBBLES == DIGITS
}

/// Eight ASCII digits, the first in the lowest byte; pairs, then fours, then all by multiplication.
const fn eight_digits(bytes: u64) -> u64 {
    let pairs = (bytes & 0x0f0f_0f0f_0f0f_0f0f).wrapping_mul(2561) >> 8;
    let fours = (pairs & 0x00ff_00ff_00ff_00ff).wrapping_mul(6_553_601) >> 16;
    (fours & 0x0000_ffff_0000_ffff).wrapping_mul(42_949_672_960_001) >> 32
}

/// Parses a number in any layout; `D` is accepted as exponent letter.
pub(super) fn general_value(field: &[u8]) -> Value {
    match decimal(field) {
        Some(Some(number)) if number != 0.0 => Value::Number(number),
        Some(_) => Value::Missing,
        None => Value::Malformed,
    }
}

/// Parses a number in any layout, zero included: `Some(None)` if blank, `None` if invalid.
///
/// Up to 19 digits form an integer. If it is below 2⁵³ and the power of ten within 10²², one
/// multiplication or division gives the correctly rounded value (Clinger 1990, *How to read
/// floating point numbers accurately*). Other numbers are parsed by the standard library.
pub(super) fn decimal(field: &[u8]) -> Option<Option<f64>> {
    let text = field.trim_ascii();
    let Some(&first) = text.first() else { return Some(None) };
    let unsigned = if matches!(first, b'-' | b'+') { &text[1..] } else { text };
    let mut mantissa = 0_u64;
    let (mut digits, mut decimals) = (0_u32, 0_i32);
    let mut point = false;
    let mut index = 0;
    while let Some(&byte) = unsigned.get(index) {
        match byte {
            b'0'..=b'9' => {
                mantissa = mantissa.wrapping_mul(10).wrapping_add(u64::from(byte - b'0'));
                digits += 1;
                decimals += i32::from(point);
            }
            b'.' if !point => point = true,
            _ => break,
        }
        index += 1;
    }
    let exponent = match unsigned.get(index) {
        None => 0,
        Some(b'D' | b'd' | b'E' | b'e') => exponent(&unsigned[index + 1..])?,
        Some(_) => return None,
    };
    if digits == 0 {
        return None;
    }
    let power = exponent - decimals;
    let exact = digits <= 19 && mantissa < 1 << 53 && power.unsigned_abs() < POWERS.len() as u32;
    let magnitude = if exact && power < 0 {
        mantissa as f64 / POWERS[power.unsigned_abs() as usize]
    } else if exact {
        mantissa as f64 * POWERS[power as usize]
    } else {
        slow_decimal(&unsigned[..index], exponent)?
    };
    Some(Some(if first == b'-' { -magnitude } else { magnitude }))
}

const POWERS: [f64; 23] = [
    1e0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10, 1e11, 1e12, 1e13, 1e14, 1e15, 1e16,
    1e17, 1e18, 1e19, 1e20, 1e21, 1e22,
];

fn exponent(text: &[u8]) -> Option<i32> {
    // Some writers leave the column of the plus sign blank.
    let value = integer(text)?;
    (-400..=400).contains(&value).then_some(value as i32)
}

fn slow_decimal(mantissa: &[u8], exponent: i32) -> Option<f64> {
    let mantissa = std::str::from_utf8(mantissa).ok()?;
    let number: f64 = format!("{mantissa}e{exponent}").parse().ok()?;
    number.is_finite().then_some(number)
}

/// Parses an integer of at most nine digits; sign and blanks around it are allowed.
pub(super) fn integer(field: &[u8]) -> Option<i64> {
    let text = field.trim_ascii();
    let (negative, digits) = match text {
        [b'-', rest @ ..] => (true, rest),
        [b'+', rest @ ..] => (false, rest),
        _ => (false, text),
    };
    if digits.is_empty() || 9 < digits.len() {
        return None;
    }
    let mut value = 0;
    for &byte in digits {
        if !byte.is_ascii_digit() {
            return None;
        }
        value = value * 10 + i64::from(byte - b'0');
    }
    Some(if negative { -value } else { value })
}

/// Columns `from..to` (from 0), shorter or empty where the line ends.
pub(super) fn columns(line: &[u8], from: usize, to: usize) -> &[u8] {
    let end = to.min(line.len());
    line.get(from..end).unwrap_or(&[])
}

/// Columns `from..to` as text, trimmed; bytes that are not UTF-8 are replaced.
pub(super) fn text(line: &[u8], from: usize, to: usize) -> String {
    String::from_utf8_lossy(columns(line, from, to)).trim().to_owned()
}

/// Parses a satellite such as `G05` or `G 5` into letter and number; a blank letter means
/// `default`.
///
/// `None` if it is not a satellite. The letter may be of a system that is not decoded.
pub(super) fn satellite(field: &[u8], default: u8) -> Option<(u8, u8)> {
    let [letter, tens, ones] = *field else { return None };
    let tens = if tens == b' ' { b'0' } else { tens };
    if !tens.is_ascii_digit() || !ones.is_ascii_digit() {
        return None;
    }
    let letter = if letter == b' ' { default } else { letter };
    let number = (tens - b'0') * 10 + (ones - b'0');
    (letter.is_ascii_uppercase() && 0 < number).then_some((letter, number))
}

/// The constellation of a letter; `None` if it is not decoded.
pub(super) const fn constellation(letter: u8) -> Option<Constellation> {
    Constellation::from_letter(letter as char)
}

/// Parses a date `year month day hour minute` at the given columns, and seconds with decimals.
///
/// Two-digit years below 80 belong to this century (RINEX 2.11).
pub(super) fn date(
    year: &[u8],
    [month, day, hour, minute]: [&[u8]; 4],
    seconds: &[u8],
) -> Option<CivilTime> {
    let year = match integer(year)? {
        year @ 0..=79 => year + 2000,
        year @ 80..=99 => year + 1900,
        year @ 1980..=2200 => year,
        _ => return None,
    };
    let (second, nanosecond) = seconds_and_ns(seconds)?;
    let small = |field| integer(field).and_then(|value| u8::try_from(value).ok());
    Some(CivilTime {
        year: year as i32,
        month: small(month)?,
        day: small(day)?,
        hour: small(hour)?,
        minute: small(minute)?,
        second,
        nanosecond,
    })
}

/// Seconds with up to twelve decimals, truncated to the nanosecond.
fn seconds_and_ns(field: &[u8]) -> Option<(u8, u32)> {
    let text = field.trim_ascii();
    let point = text.iter().position(|b| *b == b'.').unwrap_or(text.len());
    let whole = if point == 0 { 0 } else { u8::try_from(integer(&text[..point])?).ok()? };
    let decimals = text.get(point + 1..).unwrap_or(&[]);
    if text.is_empty() || 12 < decimals.len() || !decimals.iter().all(u8::is_ascii_digit) {
        return None;
    }
    let ns = (0..9).fold(0, |ns, position| {
        ns * 10 + decimals.get(position).map_or(0, |digit| u32::from(digit - b'0'))
    });
    Some((whole, ns))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn field(text: &str) -> Value {
        let mut bytes = [b' '; 16];
        bytes[..text.len()].copy_from_slice(text.as_bytes());
        observation_value(&bytes)
    }

    #[test]
    fn observation_fields_as_files_write_them() {
        assert_eq!(field("  21600712.022"), Value::Number(21_600_712.022));
        assert_eq!(field(" 113512506.87637"), Value::Number(113_512_506.876));
        assert_eq!(field("      -811.2247"), Value::Number(-811.224));
        assert_eq!(field("         -.5551"), Value::Number(-0.555));
        assert_eq!(field("          .020"), Value::Number(0.02));
        assert_eq!(field("-999999999.999"), Value::Number(-999_999_999.999));
        assert_eq!(field("9999999999.999"), Value::Number(9_999_999_999.999));
        assert_eq!(field("   21600712.02"), Value::Number(21_600_712.02));
        for missing in ["", "         0.000", "        -0.000 3", "             0"] {
            assert_eq!(field(missing), Value::Missing, "{missing:?}");
        }
        for wrong in ["  2160 712.022", "  2160x712.022", "         -", "   nan", "         .", "-"]
        {
            assert_eq!(field(wrong), Value::Malformed, "{wrong:?}");
        }
    }

    #[test]
    fn navigation_fields_as_files_write_them() {
        let read = |text: &str| decimal(text.as_bytes());
        assert_eq!(read(" 5.142397712916D-04"), Some(Some(5.142397712916e-4)));
        assert_eq!(read("  .144737772644D-03"), Some(Some(0.144737772644e-3)));
        assert_eq!(read("-0.272848410532D-11"), Some(Some(-0.272848410532e-11)));
        assert_eq!(read(" 0.000000000000E+00"), Some(Some(0.0)));
        assert_eq!(read("1.8626e-08"), Some(Some(1.8626e-8)));
        assert_eq!(read("   "), Some(None));
        for wrong in ["1.0D", "D+00", "1.2.3", "1.0D+999", "abc", "1 2", "é"] {
            assert_eq!(read(wrong), None, "{wrong:?}");
        }
    }

    #[test]
    fn dates_and_satellites() {
        let parts = |line: &'static [u8]| {
            let fields = [&line[3..5], &line[6..8], &line[9..11], &line[12..14]];
            date(&line[..2], fields, &line[14..])
        };
        let civil = parts(b"99 12 31 23 59 59.1234567").unwrap();
        assert_eq!((civil.year, civil.second, civil.nanosecond), (1999, 59, 123_456_700));
        assert_eq!(parts(b" 5  1  2  3  4  5.0").unwrap().year, 2005);
        assert_eq!(parts(b" 5  1  2  3  4  5.0x"), None);
        assert_eq!(satellite(b"G 5", b'G'), Some((b'G', 5)));
        assert_eq!(satellite(b" 12", b'R'), Some((b'R', 12)));
        assert_eq!(satellite(b"G0x", b'G'), None);
        assert_eq!(satellite(b"G00", b'G'), None);
    }

    proptest! {
        /// The quick way gives what the standard library gives.
        #[test]
        fn observation_values_are_correctly_rounded(
            thousandths in -999_999_999_999_i64..9_999_999_999_999,
        ) {
            let text = format!("{:>10}.{:03}", thousandths / 1000, thousandths.abs() % 1000);
            let text = if -1000 < thousandths && thousandths < 0 {
                format!("        -0.{:03}", -thousandths)
            } else {
                text
            };
            let expected: f64 = text.trim().parse().unwrap();
            let missing = expected == 0.0;
            let expected = if missing { Value::Missing } else { Value::Number(expected) };
            prop_assert_eq!(field(&text), expected);
        }

        /// So does the general way, on both sides of its exact range.
        #[test]
        fn decimals_are_correctly_rounded(mantissa in -9.0..9.0_f64, exponent in -40_i32..30) {
            let text = format!("{mantissa:.12}e{exponent}");
            prop_assert_eq!(decimal(text.as_bytes()), Some(Some(text.parse::<f64>().unwrap())));
        }
    }
}
