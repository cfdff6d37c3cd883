//! Which hosts may be contacted, and at which of their addresses.
//!
//! A client's choice of host must not lead into the operator's own network. Only hosts that the
//! operator lists, for all tenants or for the client's tenant, are contacted. The host's name is
//! resolved once, each address is checked, and the connection uses a checked address. So an
//! attacker gains nothing by changing the name's address after the check.

use std::collections::BTreeMap;
use std::fmt;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};
use std::time::Duration;

use crate::tenant::Tenant;

use super::FetchError;

/// Longest time for resolving a name.
const RESOLVING: Duration = Duration::from_secs(10);
/// Most addresses of one name that are checked.
const ADDRESSES_LIMIT: usize = 16;

/// The hosts that may be contacted.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FetchPolicy {
    hosts: Vec<HostPattern>,
    /// Further hosts, by the tenant that may name them.
    of_tenants: BTreeMap<Tenant, Vec<HostPattern>>,
    allows_private: bool,
}

/// A pattern of allowed hosts: `host`, `host:port`, or `*.domain` for all hosts below a domain.
#[derive(Clone, Debug, PartialEq, Eq)]
struct HostPattern {
    host: String,
    is_domain: bool,
    port: Option<u16>,
}

impl FetchPolicy {
    /// A policy that allows the listed hosts. `allows_private` also allows private addresses.
    ///
    /// # Errors
    /// A text is not a host.
    pub fn new(hosts: &[String], allows_private: bool) -> Result<Self, FetchError> {
        Ok(Self { hosts: parsed(hosts)?, of_tenants: BTreeMap::new(), allows_private })
    }

    /// The same policy, with further hosts that certain tenants may name.
    ///
    /// # Errors
    /// A text is not a host, or not the name of a tenant.
    pub fn with_tenants(
        mut self,
        tenants: &BTreeMap<String, Vec<String>>,
    ) -> Result<Self, FetchError> {
        for (name, hosts) in tenants {
            let invalid = || FetchError::TenantInvalid { text: name.clone() };
            let tenant = Tenant::parse(name).ok_or_else(invalid)?;
            self.of_tenants.insert(tenant, parsed(hosts)?);
        }
        Ok(self)
    }

    /// The policy for hosts that a tenant names.
    pub(super) fn of(&self, tenant: &Tenant) -> Self {
        let own = self.of_tenants.get(tenant).into_iter().flatten();
        let hosts = self.hosts.iter().chain(own).cloned().collect();
        Self { hosts, of_tenants: BTreeMap::new(), allows_private: self.allows_private }
    }

    /// Checks whether a host may be contacted at a port.
    ///
    /// # Errors
    /// The host is not listed.
    pub(crate) fn check(&self, host: &str, port: u16) -> Result<(), FetchError> {
        let name = plain(host);
        if self.hosts.iter().any(|pattern| pattern.allows(&name, port)) {
            return Ok(());
        }
        Err(FetchError::HostNotAllowed { host: host.to_owned(), port })
    }

    /// The checked addresses of a host. Connect to these only.
    ///
    /// # Errors
    /// The host is not listed, cannot be resolved, or all its addresses are refused.
    pub(crate) async fn resolve(
        &self,
        host: &str,
        port: u16,
    ) -> Result<Vec<SocketAddr>, FetchError> {
        self.check(host, port)?;
        let unresolved = |why: String| FetchError::Unresolved { host: host.to_owned(), why };
        let bare = host.trim_start_matches('[').trim_end_matches(']');
        let found = tokio::time::timeout(RESOLVING, tokio::net::lookup_host((bare, port))).await;
        let found = found.map_err(|_| unresolved("no answer".to_owned()))?;
        let found = found.map_err(|error| unresolved(error.to_string()))?;
        self.permitted(host, found.take(ADDRESSES_LIMIT).collect())
    }

    fn permitted(&self, host: &str, found: Vec<SocketAddr>) -> Result<Vec<SocketAddr>, FetchError> {
        let Some(first) = found.first().copied() else {
            let why = "it has no address".to_owned();
            return Err(FetchError::Unresolved { host: host.to_owned(), why });
        };
        let is_permitted = |address: &SocketAddr| self.allows_private || is_public(address.ip());
        let permitted: Vec<SocketAddr> = found.into_iter().filter(is_permitted).collect();
        if permitted.is_empty() {
            return Err(FetchError::AddressRefused { host: host.to_owned(), address: first.ip() });
        }
        Ok(permitted)
    }
}

fn parsed(hosts: &[String]) -> Result<Vec<HostPattern>, FetchError> {
    hosts.iter().map(|text| HostPattern::parse(text)).collect()
}

impl HostPattern {
    fn parse(text: &str) -> Result<Self, FetchError> {
        let refused = || FetchError::PatternInvalid { text: text.to_owned() };
        let (host, port) = match text.rsplit_once(':') {
            // The colons of a bare IPv6 address do not begin a port.
            Some((host, port)) if !host.contains(':') || host.ends_with(']') => {
                (host, Some(port.parse::<u16>().map_err(|_| refused())?))
            }
            _ => (text, None),
        };
        let (host, is_domain) = match host.strip_prefix("*.") {
            Some(domain) => (domain, true),
            None => (host, false),
        };
        let host = plain(host);
        let is_name = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '.' | '_' | ':');
        if host.is_empty() || !host.chars().all(is_name) {
            return Err(refused());
        }
        Ok(Self { host, is_domain, port })
    }

    fn allows(&self, host: &str, port: u16) -> bool {
        let is_host = match host.strip_suffix(self.host.as_str()) {
            Some("") => !self.is_domain,
            Some(below) => self.is_domain && below.ends_with('.'),
            None => false,
        };
        is_host && self.port.is_none_or(|allowed| allowed == port)
    }
}

impl fmt::Display for HostPattern {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(if self.is_domain { "*." } else { "" })?;
        f.write_str(&self.host)
    }
}

/// The host in a form in which equal hosts are equal texts.
fn plain(host: &str) -> String {
    let bare = host.trim_start_matches('[').trim_end_matches(']');
    bare.trim_end_matches('.').to_ascii_lowercase()
}

/// Whether an address belongs to the public internet, by IANA's registries of special-purpose
/// addresses (RFC 6890).
pub(crate) fn is_public(address: IpAddr) -> bool {
    match address {
        IpAddr::V4(address) => is_public_v4(address),
        IpAddr::V6(address) => match embedded_v4(address) {
            Some(inner) => is_public_v4(inner),
            None => is_public_v6(address),
        },
    }
}

fn is_public_v4(address: Ipv4Addr) -> bool {
    let special = match address.octets() {
        // This network, shared address space, protocol assignments, benchmarks, reserved.
        [0, ..] | [192, 0, 0, _] | [240..=255, ..] => true,
        [100, second, ..] => second & 0xc0 == 64,
        [198, 18 | 19, ..] => true,
        _ => false,
    };
    !(special
        || address.is_private()
        || address.is_loopback()
        || address.is_link_local()
        || address.is_multicast()
        || address.is_documentation())
}

fn is_public_v6(address: Ipv6Addr) -> bool {
    match address.segments() {
        // Documentation; protocol assignments, Teredo among them.
        [0x2001, 0xdb8, ..] | [0x2001, 0..=0x1ff, ..] | [0x3fff, 0..=0xfff, ..] => false,
        // Global unicast; all else is loopback, unique local, link-local, multicast or reserved.
        [first, ..] => first & 0xe000 == 0x2000,
    }
}

/// The IPv4 address inside an IPv6 address: mapped, compatible, NAT64 or 6to4.
fn embedded_v4(address: Ipv6Addr) -> Option<Ipv4Addr> {
    let pair = |high: u16, low: u16| {
        let ([a, b], [c, d]) = (high.to_be_bytes(), low.to_be_bytes());
        Ipv4Addr::new(a, b, c, d)
    };
    match address.segments() {
        [0, 0, 0, 0, 0, 0 | 0xffff, high, low] => Some(pair(high, low)),
        [0x64, 0xff9b, 0, 0, 0, 0, high, low] => Some(pair(high, low)),
        [0x2002, high, low, ..] => Some(pair(high, low)),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::refusal::Code;

    fn policy(hosts: &[&str], allows_private: bool) -> FetchPolicy {
        let hosts: Vec<String> = hosts.iter().map(|host| (*host).to_owned()).collect();
        FetchPolicy::new(&hosts, allows_private).unwrap()
    }

    #[test]
    fn only_listed_hosts_are_asked() {
        let policy = policy(&["caster.example.org:2101", "*.igs.example", "192.0.2.7"], false);
        for (host, port, allowed) in [
            ("caster.example.org", 2101, true),
            ("CASTER.Example.Org.", 2101, true),
            ("caster.example.org", 80, false),
            ("xcaster.example.org", 2101, false),
            ("caster.example.org.evil.example", 2101, false),
            ("data.igs.example", 443, true),
            ("igs.example", 443, false),
            ("evil-igs.example", 443, false),
            ("192.0.2.7", 9, true),
            ("192.0.2.70", 9, false),
        ] {
            assert_eq!(policy.check(host, port).is_ok(), allowed, "{host}:{port}");
        }
        for wrong in ["", "*.", "a b", "host:port", "http://host", "user@host"] {
            assert!(FetchPolicy::new(&[wrong.to_owned()], false).is_err(), "{wrong:?}");
        }
    }

    #[test]
    fn addresses_of_the_operators_network_are_refused() {
        for private in [
            "127.0.0.1",
            "10.1.2.3",
            "172.16.0.1",
            "172.31.255.255",
            "192.168.1.1",
            "169.254.169.254",
            "100.64.0.1",
            "0.0.0.0",
            "224.0.0.1",
            "255.255.255.255",
            "198.18.0.1",
            "192.0.2.1",
            "::1",
            "::",
            "fc00::1",
            "fd12::1",
            "fe80::1",
            "ff02::1",
            "::ffff:127.0.0.1",
            "::ffff:10.0.0.1",
            "::127.0.0.1",
            "64:ff9b::7f00:1",
            "64:ff9b::a9fe:a9fe",
            "2002:7f00:1::",
            "2002:a00:1::1",
            "2001:db8::1",
            "2001::1",
            "100::1",
            "64:ff9b:1::1",
        ] {
            assert!(!is_public(private.parse().unwrap()), "{private}");
        }
        for public in ["193.0.6.139", "8.8.8.8", "2a00:1450:4001::1", "64:ff9b::808:808"] {
            assert!(is_public(public.parse().unwrap()), "{public}");
        }
    }

    #[tokio::test]
    async fn a_name_that_leads_home_is_refused() {
        let refused = policy(&["localhost", "127.0.0.1", "[::1]"], false);
        for host in ["localhost", "127.0.0.1", "[::1]"] {
            let error = refused.resolve(host, 80).await.unwrap_err();
            assert_eq!(error.code(), Code::AddressRefused, "{host}: {error}");
        }
        let allowed = policy(&["localhost"], true).resolve("localhost", 80).await.unwrap();
        assert!(allowed.iter().all(|address| address.ip().is_loopback()));
        let error = refused.resolve("example.org", 80).await.unwrap_err();
        assert_eq!(error.code(), Code::HostNotAllowed);
    }

    #[test]
    fn a_name_without_an_address_is_not_resolved() {
        let error = policy(&["x"], false).permitted("x", Vec::new()).unwrap_err();
        assert_eq!(error.code(), Code::HostUnresolved);
    }

    /// Of a name with a private and a public address, only the public address is contacted.
    #[test]
    fn of_many_addresses_the_public_ones_remain() {
        let address = |text: &str| SocketAddr::new(text.parse().unwrap(), 80);
        let found = vec![address("10.0.0.1"), address("8.8.8.8")];
        let permitted = policy(&["x"], false).permitted("x", found).unwrap();
        assert_eq!(permitted, [address("8.8.8.8")]);
    }
}
