//! Options of a cluster: several nodes on one database.

use std::path::PathBuf;

use serde::Deserialize;

/// A cluster of nodes on one database on Postgres. Without an address the service is alone.
#[derive(Clone, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ClusterConfiguration {
    /// Where the other nodes reach this one: `http://HOST:PORT`, or `https://` if its port has TLS.
    /// With it the service is a node of the cluster of its database.
    pub address: String,
    /// PEM file of the authorities of the other nodes' certificates. If absent, Mozilla's.
    pub ca_file: Option<PathBuf>,
}

impl ClusterConfiguration {
    /// Whether the service is a node of a cluster.
    pub fn is_on(&self) -> bool {
        !self.address.is_empty()
    }

    /// Host and port of the address; `None` if it has another form.
    pub(super) fn authority(&self) -> Option<(&str, u16)> {
        let (scheme, authority) = self.address.split_once("://")?;
        let (host, port) = authority.rsplit_once(':')?;
        let is_host = !host.is_empty() && !host.contains(['/', '@', '?', '#']);
        let port = port.parse().ok().filter(|port| *port != 0)?;
        (matches!(scheme, "http" | "https") && is_host).then_some((host, port))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_has_scheme_host_and_port() {
        for (address, authority) in [
            ("http://10.0.0.2:8080", Some(("10.0.0.2", 8080))),
            ("https://[2001:db8::1]:443", Some(("[2001:db8::1]", 443))),
            ("http://node-1", None),
            ("node-1:8080", None),
            ("ftp://node-1:8080", None),
            ("http://user@node-1:8080", None),
            ("http://node-1:8080/", None),
            ("http://node-1:0", None),
        ] {
            let (address, ca_file) = (address.to_owned(), None);
            assert_eq!(ClusterConfiguration { address, ca_file }.authority(), authority);
        }
    }
}
