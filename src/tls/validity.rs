//! The times for which a certificate (RFC 5280, section 4.1.2.5) and a list of revoked certificates
//! (section 5.1.2.5) are valid. rustls checks all other fields.

use std::fmt;

use x509_cert::Certificate;
use x509_cert::crl::CertificateList;
use x509_cert::der::{DateTime, Decode};
use x509_cert::time::Time;

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
    date: DateTime,
}

impl fmt::Display for Moment {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let date = &self.date;
        let (year, month, day) = (date.year(), date.month(), date.day());
        let (hour, minute, second) = (date.hour(), date.minutes(), date.seconds());
        write!(f, "{year:04}-{month:02}-{day:02} {hour:02}:{minute:02}:{second:02} UTC")
    }
}

/// The validity of a certificate in DER; `None` if it cannot be read.
pub(super) fn validity(certificate: &[u8]) -> Option<Validity> {
    let validity = Certificate::from_der(certificate).ok()?.tbs_certificate.validity;
    let (not_before, not_after) = (moment(&validity.not_before)?, moment(&validity.not_after)?);
    Some(Validity { not_before, not_after })
}

/// When a list of revoked certificates in DER ends; `None` if it is unreadable or has no end.
pub(super) fn next_update(list: &[u8]) -> Option<Moment> {
    moment(&CertificateList::from_der(list).ok()?.tbs_cert_list.next_update?)
}

fn moment(time: &Time) -> Option<Moment> {
    let date = time.to_date_time();
    let unix_s = i64::try_from(date.unix_duration().as_secs()).ok()?;
    Some(Moment { unix_s, date })
}

#[cfg(test)]
mod tests {
    use super::*;

    const INTEGER: u8 = 0x02;
    const BIT_STRING: u8 = 0x03;
    const OBJECT_IDENTIFIER: u8 = 0x06;
    const UTC_TIME: u8 = 0x17;
    const GENERALIZED_TIME: u8 = 0x18;
    const SEQUENCE: u8 = 0x30;
    /// `version [0] EXPLICIT`, which certificates of version 1 do not have.
    const VERSION: u8 = 0xa0;

    /// An element with this content (ITU-T X.690, section 8.1: the length in its shortest form).
    fn der(tag: u8, content: &[u8]) -> Vec<u8> {
        let length = u8::try_from(content.len()).unwrap();
        let head = if length < 0x80 { vec![tag, length] } else { vec![tag, 0x81, length] };
        [&head[..], content].concat()
    }

    /// A certificate without names, with a key and a signature of one byte (RFC 5280, section 4.1).
    fn certificate(version: &[u8], not_before: Vec<u8>, not_after: Vec<u8>) -> Vec<u8> {
        let (serial, name) = (der(INTEGER, &[7]), der(SEQUENCE, &[]));
        // id-Ed25519 (RFC 8410).
        let algorithm = der(SEQUENCE, &der(OBJECT_IDENTIFIER, &[0x2b, 0x65, 0x70]));
        let (times, bits) =
            (der(SEQUENCE, &[not_before, not_after].concat()), der(BIT_STRING, &[0, 9]));
        let key = der(SEQUENCE, &[&algorithm[..], &bits].concat());
        let signed = [version, &serial, &algorithm, &name, &times, &name, &key].concat();
        der(SEQUENCE, &[der(SEQUENCE, &signed), algorithm, bits].concat())
    }

    /// The values are from `date -u -d '1999-12-31 23:59:59' +%s` and
    /// `date -u -d '2050-02-28 12:00:01' +%s`.
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
