//! Numbers as fixed-point decimal text, written digit by digit.
//!
//! A solution row has fourteen numbers, and `write!` is exact for every float but slow. Here a
//! value is scaled to an integer first. The result is right to half a unit of the last digit as
//! long as the scaled value is below 2⁵³.

use std::io::Write;

const POWERS_OF_TEN: [f64; 10] = [1.0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9];
/// Largest scaled value that is exact as an integer: 2⁵³.
const LARGEST_EXACT: f64 = 9_007_199_254_740_992.0;

/// Appends `value` with `decimals` digits (0 … 9) after the point, right-aligned in `width`.
///
/// Zero has no sign. A value that is not finite is written as `nan`; readers skip such rows.
pub(crate) fn push_fixed(out: &mut Vec<u8>, value: f64, decimals: usize, width: usize) {
    let scaled = (value.abs() * POWERS_OF_TEN[decimals]).round();
    if !value.is_finite() {
        push_padded(out, b"nan", width);
    } else if LARGEST_EXACT <= scaled {
        write!(out, "{value:width$.decimals$}").expect("a Vec<u8> takes every byte");
    } else {
        push_digits(out, scaled as u64, value < 0.0 && 0.0 < scaled, decimals, width);
    }
}

/// Appends an integer, right-aligned in `width`.
pub(crate) fn push_integer(out: &mut Vec<u8>, value: i64, width: usize) {
    push_digits(out, value.unsigned_abs(), value < 0, 0, width);
}

/// Appends nanoseconds as seconds. The value gets as many digits after the point as it needs, at
/// least `decimals` and at most nine.
pub(crate) fn push_seconds(out: &mut Vec<u8>, ns: i64, decimals: usize, width: usize) {
    let (mut digits, mut value) = (9, ns.unsigned_abs());
    while decimals < digits && value.is_multiple_of(10) {
        digits -= 1;
        value /= 10;
    }
    push_digits(out, value, ns < 0, digits, width);
}

/// Appends `value`·10^(−decimals).
fn push_digits(out: &mut Vec<u8>, mut value: u64, negative: bool, decimals: usize, width: usize) {
    let mut text = [0_u8; 24];
    let mut at = text.len();
    let mut written = 0;
    while value != 0 || written <= decimals {
        if written == decimals && decimals != 0 {
            at -= 1;
            text[at] = b'.';
        }
        at -= 1;
        text[at] = b'0' + (value % 10) as u8;
        value /= 10;
        written += 1;
    }
    if negative {
        at -= 1;
        text[at] = b'-';
    }
    push_padded(out, &text[at..], width);
}

fn push_padded(out: &mut Vec<u8>, text: &[u8], width: usize) {
    for _ in text.len()..width {
        out.push(b' ');
    }
    out.extend_from_slice(text);
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn fixed(value: f64, decimals: usize, width: usize) -> String {
        let mut out = Vec::new();
        push_fixed(&mut out, value, decimals, width);
        String::from_utf8(out).unwrap()
    }

    #[test]
    fn values_worked_by_hand() {
        assert_eq!(fixed(-0.0004, 3, 0), "0.000");
        assert_eq!(fixed(0.0625, 2, 6), "  0.06");
        assert_eq!(fixed(-114.179_012_345_6, 9, 14), "-114.179012346");
        assert_eq!(fixed(5.0, 0, 3), "  5");
        assert_eq!(fixed(f64::NAN, 3, 5), "  nan");
        assert_eq!(fixed(1e18, 4, 0), "1000000000000000000.0000");
    }

    #[test]
    fn seconds_carry_the_digits_they_need() {
        let text = |ns| {
            let mut out = Vec::new();
            push_seconds(&mut out, ns, 3, 10);
            String::from_utf8(out).unwrap()
        };
        assert_eq!(text(46_701_000_000_000), " 46701.000");
        assert_eq!(text(46_700_997_000_100), "46700.9970001");
        assert_eq!(text(0), "     0.000");
    }

    proptest! {
        /// The text is the value to half a unit of its last digit.
        #[test]
        fn text_is_the_value(value in -1e6..1e6_f64, decimals in 0_usize..10) {
            let back: f64 = fixed(value, decimals, 0).parse().unwrap();
            let half_unit = 0.5 * 10_f64.powi(-(decimals as i32));
            prop_assert!((back - value).abs() <= half_unit * (1.0 + 1e-6) + 1e-9);
        }
    }
}
