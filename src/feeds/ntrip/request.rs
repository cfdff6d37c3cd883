//! Requests to a caster.

use std::fmt;
use std::str::FromStr;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;

use crate::feeds::FetchError;

/// Name of this client. Casters expect it to begin with NTRIP.
const AGENT: &str = concat!("NTRIP graphfix/", env!("CARGO_PKG_VERSION"));
const PORT: u16 = 2101;
const TLS_PORT: u16 = 443;
/// Longest host name (RFC 1035) and longest name of a mountpoint.
const HOST_LIMIT: usize = 255;
const MOUNTPOINT_LIMIT: usize = 100;

/// The address of a caster, such as `ntrip://caster.example.org:2101`; `ntrips://` for TLS.
/// `http://` and `https://` mean the same, as other clients of casters write them.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Caster {
    /// Name or address of the host.
    pub host: String,
    /// TCP port.
    pub port: u16,
    /// Whether the connection uses TLS.
    pub is_tls: bool,
}

impl FromStr for Caster {
    type Err = FetchError;

    fn from_str(text: &str) -> Result<Self, FetchError> {
        let parse = || {
            let (scheme, rest) = text.split_once("://")?;
            let is_tls = match scheme {
                "ntrip" | "http" => false,
                "ntrips" | "https" => true,
                _ => return None,
            };
            let authority = rest.strip_suffix('/').unwrap_or(rest);
            let (host, port) = match authority.rsplit_once(':') {
                Some((host, port)) if !host.contains(':') || host.ends_with(']') => {
                    (host, port.parse().ok().filter(|port| *port != 0)?)
                }
                _ => (authority, if is_tls { TLS_PORT } else { PORT }),
            };
            let is_bracketed = host.starts_with('[') && host.ends_with(']');
            let allowed =
                |c: char| c.is_ascii_alphanumeric() || matches!(c, '.' | '-' | '_') || is_bracketed;
            let is_host = !host.is_empty() && host.len() <= HOST_LIMIT && host.chars().all(allowed);
            let host = host.to_ascii_lowercase();
            (is_host && is_plain(&host)).then_some(Self { host, port, is_tls })
        };
        parse().ok_or_else(|| FetchError::CasterInvalid { text: text.to_owned() })
    }
}

impl fmt::Display for Caster {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let scheme = if self.is_tls { "ntrips" } else { "ntrip" };
        write!(f, "{scheme}://{}:{}", self.host, self.port)
    }
}

/// User and password at a caster.
#[derive(Clone, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Credentials {
    /// Name of the user.
    pub name: String,
    /// The password. `Debug` does not print it.
    pub password: String,
}

impl fmt::Debug for Credentials {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Credentials").field("name", &self.name).finish_non_exhaustive()
    }
}

/// The protocol version of a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum NtripVersion {
    /// NTRIP 1.0, for casters that do not accept HTTP/1.1.
    One,
    /// NTRIP 2.0. Casters of version 1 accept it, too.
    Two,
}

/// A request for a stream or a sourcetable.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct StreamRequest {
    /// Address of the caster.
    pub caster: Caster,
    /// Name of the stream; empty for the sourcetable.
    pub mountpoint: String,
    /// User and password, if the caster asks for them.
    pub credentials: Option<Credentials>,
    /// Protocol version of the request.
    pub version: NtripVersion,
}

impl StreamRequest {
    /// Whether the mountpoint's name has only characters that a request can contain.
    pub(crate) fn is_sound(&self) -> bool {
        let is_name = |c: char| c.is_ascii_graphic() && !matches!(c, '/' | '?' | '#' | '%');
        let mountpoint = &self.mountpoint;
        mountpoint.len() <= MOUNTPOINT_LIMIT && mountpoint.chars().all(is_name)
    }

    /// The request as sent. `position` is a GGA sentence for casters that compute a stream for the
    /// rover's position.
    pub(super) fn text(&self, position: Option<&str>) -> String {
        let Self { caster: Caster { host, port, .. }, mountpoint, credentials, version } = self;
        let mut text = match version {
            NtripVersion::One => format!("GET /{mountpoint} HTTP/1.0\r\n"),
            NtripVersion::Two => format!(
                "GET /{mountpoint} HTTP/1.1\r\nHost: {host}:{port}\r\nNtrip-Version: Ntrip/2.0\r\n"
            ),
        };
        text.push_str(&format!("User-Agent: {AGENT}\r\n"));
        if let Some(Credentials { name, password }) = credentials {
            let encoded = STANDARD.encode(format!("{name}:{password}"));
            text.push_str(&format!("Authorization: Basic {encoded}\r\n"));
        }
        if let (NtripVersion::Two, Some(position)) = (version, position) {
            text.push_str(&format!("Ntrip-GGA: {}\r\n", position.trim_end()));
        }
        text.push_str("Connection: close\r\n\r\n");
        text
    }
}

fn is_plain(text: &str) -> bool {
    text.chars().all(|c| c.is_ascii_graphic())
}

/// The NMEA 0183 sentence GGA for a position (degrees, metres above the ellipsoid) at a second of
/// the UTC day, as a rover with a single-point position sends it.
///
/// The geoid separation is given as zero. Casters need the height only to about 100 m.
pub fn position_sentence(
    latitude_deg: f64,
    longitude_deg: f64,
    height_m: f64,
    second_of_day: u32,
) -> String {
    let angle = |degrees: f64, digits: usize| {
        // Integers of the last digit, so that 60 minutes never appear.
        let units = (degrees.abs() * 600_000.0).round() as u64;
        format!("{:0digits$}{:07.4}", units / 600_000, (units % 600_000) as f64 / 1e4)
    };
    let (hours, minutes) = (second_of_day / 3600 % 24, second_of_day / 60 % 60);
    let body = format!(
        "GPGGA,{hours:02}{minutes:02}{:02}.00,{},{},{},{},1,12,1.0,{height_m:.1},M,0.0,M,,",
        second_of_day % 60,
        angle(latitude_deg, 2),
        if latitude_deg < 0.0 { 'S' } else { 'N' },
        angle(longitude_deg, 3),
        if longitude_deg < 0.0 { 'W' } else { 'E' },
    );
    let sum = body.bytes().fold(0, |sum, byte| sum ^ byte);
    format!("${body}*{sum:02X}\r\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn casters_are_named_by_address() {
        let caster = |text: &str| text.parse::<Caster>().map(|caster| caster.to_string());
        assert_eq!(
            caster("ntrip://Caster.example.org").unwrap(),
            "ntrip://caster.example.org:2101"
        );
        assert_eq!(caster("ntrips://a.example/").unwrap(), "ntrips://a.example:443");
        assert_eq!(caster("http://[2001:db8::1]:80").unwrap(), "ntrip://[2001:db8::1]:80");
        for wrong in [
            "caster.example.org",
            "ftp://a.example",
            "ntrip://",
            "ntrip://a.example:0",
            "ntrip://a.example:99999",
            "ntrip://user:password@a.example",
            "ntrip://a.example/path",
            "ntrip://a b",
            "ntrip://a\r\nX: y",
        ] {
            assert!(caster(wrong).is_err(), "{wrong:?}");
        }
    }

    #[test]
    fn requests_of_both_versions() {
        let credentials = Credentials { name: "Aladdin".into(), password: "open sesame".into() };
        assert!(!format!("{credentials:?}").contains("sesame"));
        let mut request = StreamRequest {
            caster: "ntrip://a.example".parse().unwrap(),
            mountpoint: "MOUNT0".to_owned(),
            credentials: Some(credentials),
            version: NtripVersion::Two,
        };
        let text = request.text(Some("$GPGGA,*00\r\n"));
        assert!(text.starts_with("GET /MOUNT0 HTTP/1.1\r\nHost: a.example:2101\r\n"), "{text}");
        // RFC 7617, section 2.
        assert!(text.contains("Authorization: Basic QWxhZGRpbjpvcGVuIHNlc2FtZQ==\r\n"), "{text}");
        assert!(text.contains("\r\nNtrip-GGA: $GPGGA,*00\r\n"), "{text}");
        assert!(text.ends_with("\r\n\r\n") && text.matches("\r\n\r\n").count() == 1);
        request.version = NtripVersion::One;
        let text = request.text(Some("$GPGGA,*00\r\n"));
        assert!(text.starts_with("GET /MOUNT0 HTTP/1.0\r\nUser-Agent: NTRIP "), "{text}");
        assert!(!text.contains("GGA"), "{text}");
        for wrong in ["A B", "A\r\nX: y", "../x", "a?b"] {
            let request = StreamRequest { mountpoint: wrong.to_owned(), ..request.clone() };
            assert!(!request.is_sound(), "{wrong:?}");
        }
    }

    #[test]
    fn a_position_as_nmea_has_it() {
        let sentence = position_sentence(-33.999_999_99, 151.2, 22.5, 45_296);
        let body = "GPGGA,123456.00,3400.0000,S,15112.0000,E,1,12,1.0,22.5,M,0.0,M,,";
        let sum = body.bytes().fold(0, |sum, byte| sum ^ byte);
        assert_eq!(sentence, format!("${body}*{sum:02X}\r\n"));
    }
}
