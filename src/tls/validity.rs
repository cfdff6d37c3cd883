//! The time for which a certificate is valid.
//!
//! Sources: RFC 5280, section 4.1 (the fields and their order); ITU-T X.690 (DER). Nothing else of
//! the certificate is read here; rustls checks it.

use std::fmt;

use crate::gnss::days_from_civil;

const INTEGER: u8 = 0x02;
const UTC_TIME: u8 = 0x17;
const GENERALIZED_TIME: u8 = 0x18;
const SEQUENCE: u8 = 0x30;
/// `version [0] EXPLICIT`, which certificates of version 1 do not have.
const VERSION: u8 = 0xa0;

/// The time for which a certificate is valid.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Validity {
    pub(super) not_before: Moment,
    pub(super) not_after: Moment,
}

/// A second of UTC.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Moment {
    /// Since 1970-01-01 UTC (s).
    pub(super) unix_s: i64,
    /// Year, month, day, hour, minute and second.
    digits: [i32; 6],
}

impl fmt::Display for Moment {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [year, month, day, hour, minute, second] = self.digits;
        write!(f, "{year:04}-{month:02}-{day:02} {hour:02}:{minute:02}:{second:02} UTC")
    }
}

/// The validity of a certificate in DER; `None` if it cannot be read.
pub(super) fn validity(certificate: &[u8]) -> Option<Validity> {
    let (certificate, _) = element(certificate, SEQUENCE)?;
    let (signed, _) = element(certificate, SEQUENCE)?;
    let after_version = element(signed, VERSION).map_or(signed, |(_, rest)| rest);
    let (_, after_serial) = element(after_version, INTEGER)?;
    let (_, after_algorithm) = element(after_serial, SEQUENCE)?;
    let (_, after_issuer) = element(after_algorithm, SEQUENCE)?;
    let (times, _) = element(after_issuer, SEQUENCE)?;
    let (not_before, rest) = moment(times)?;
    let (not_after, _) = moment(rest)?;
    Some(Validity { not_before, not_after })
}

/// Content of the element that `input` begins with, if it has this tag, and what follows it.
fn element(input: &[u8], tag: u8) -> Option<(&[u8], &[u8])> {
    let (_, rest) = input.split_first().filter(|(first, _)| **first == tag)?;
    let (&length, rest) = rest.split_first()?;
    if length < 0x80 {
        return rest.split_at_checked(usize::from(length));
    }
    // The long form: the number of octets that have the length. A certificate is below 16 MB.
    let (octets, rest) =
        rest.split_at_checked(usize::from(length - 0x80)).filter(|_| length < 0x84)?;
    let length = octets.iter().fold(0, |sum, octet| sum << 8 | usize::from(*octet));
    rest.split_at_checked(length)
}

/// The time that `input` begins with: `YYMMDDhhmmssZ` from 1950 to 2049, or with four digits of the
/// year.
fn moment(input: &[u8]) -> Option<(Moment, &[u8])> {
    let (text, rest, digits_of_year) = match element(input, UTC_TIME) {
        Some((text, rest)) => (text, rest, 2),
        None => element(input, GENERALIZED_TIME).map(|(text, rest)| (text, rest, 4))?,
    };
    let text = std::str::from_utf8(text).ok()?.strip_suffix('Z')?;
    if text.len() != digits_of_year + 10 || !text.bytes().all(|byte| byte.is_ascii_digit()) {
        return None;
    }
    let (year, others) = text.split_at(digits_of_year);
    let mut digits = [year.parse().ok()?, 0, 0, 0, 0, 0];
    if digits_of_year == 2 {
        digits[0] += if digits[0] < 50 { 2000 } else { 1900 };
    }
    for (index, value) in digits[1..].iter_mut().enumerate() {
        *value = others[2 * index..2 * index + 2].parse().ok()?;
    }
    let [year, month, day, hour, minute, second] = digits;
    let days = days_from_civil(year, u8::try_from(month).ok()?, u8::try_from(day).ok()?);
    let unix_s = days * 86_400 + i64::from(hour * 3600 + minute * 60 + second);
    Some((Moment { unix_s, digits }, rest))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// An element with this content.
    fn der(tag: u8, content: &[u8]) -> Vec<u8> {
        let length = u16::try_from(content.len()).unwrap().to_be_bytes();
        [&[tag, 0x82][..], &length, content].concat()
    }

    fn certificate(version: &[u8], not_before: Vec<u8>, not_after: Vec<u8>) -> Vec<u8> {
        let (serial, name) = (der(INTEGER, &[7]), der(SEQUENCE, &[0; 300]));
        let times = der(SEQUENCE, &[not_before, not_after].concat());
        let signed = [version, &serial, &name, &name, &times, &name].concat();
        der(SEQUENCE, &[der(SEQUENCE, &signed), name].concat())
    }

    /// `date -u -d '1999-12-31 23:59:59' +%s` and `date -u -d '2050-02-28 12:00:01' +%s`.
    #[test]
    fn both_forms_of_a_time_are_read() {
        let (first, last) = (der(UTC_TIME, b"991231235959Z"), b"20500228120001Z");
        for version in [&der(VERSION, &[2, 1, 2])[..], &[]] {
            let last = der(GENERALIZED_TIME, last);
            let read = validity(&certificate(version, first.clone(), last)).unwrap();
            assert_eq!(read.not_before.unix_s, 946_684_799);
            assert_eq!(read.not_after.unix_s, 2_529_662_401);
            assert_eq!(read.not_after.to_string(), "2050-02-28 12:00:01 UTC");
        }
    }

    #[test]
    fn what_is_no_certificate_has_no_validity() {
        let whole = certificate(&[], der(UTC_TIME, b"991231235959Z"), der(UTC_TIME, b"x"));
        assert_eq!(validity(&whole), None);
        let first = der(UTC_TIME, b"991231235959Z");
        let whole = certificate(&[], first.clone(), first);
        for length in 0..whole.len() {
            assert_eq!(validity(&whole[..length]), None, "{length}");
        }
        assert!(validity(&whole).is_some());
    }
}
