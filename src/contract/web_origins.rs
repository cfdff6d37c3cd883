//! Web pages on other hosts that may call the service, each for certain tenants.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use hyper::Uri;

use crate::tenant::Tenant;

/// Origins of web pages (RFC 6454), each with the tenants whose keys its pages may send. Clones
/// share them.
#[derive(Clone, Debug, Default)]
pub struct WebOrigins(Arc<BTreeMap<String, BTreeSet<Tenant>>>);

/// Why a list of origins is refused.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum WebOriginError {
    /// A text is not the name of a tenant.
    #[error("{text:?} in cors is not the name of a tenant")]
    Tenant {
        /// The text as given.
        text: String,
    },
    /// A text is not an origin as browsers write it.
    #[error(
        "{text:?} in cors is not an origin: https://HOST or https://HOST:PORT in lower case, \
         without the standard port and without a path; http:// is for tests on one machine"
    )]
    Origin {
        /// The text as given.
        text: String,
    },
}

impl WebOrigins {
    /// The origins of each tenant, by the name of the tenant.
    ///
    /// # Errors
    /// A text is not the name of a tenant, or not an origin.
    pub fn new(lists: &BTreeMap<String, Vec<String>>) -> Result<Self, WebOriginError> {
        let mut origins = BTreeMap::<String, BTreeSet<Tenant>>::new();
        for (name, list) in lists {
            let invalid = || WebOriginError::Tenant { text: name.clone() };
            let tenant = Tenant::parse(name).ok_or_else(invalid)?;
            for text in list {
                if !is_origin(text) {
                    return Err(WebOriginError::Origin { text: text.clone() });
                }
                origins.entry(text.clone()).or_default().insert(tenant.clone());
            }
        }
        Ok(Self(Arc::new(origins)))
    }

    /// Whether the operator lists no origin.
    pub(crate) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Whether pages of an origin may call for any tenant.
    pub(crate) fn has(&self, origin: &str) -> bool {
        self.0.contains_key(origin)
    }

    /// Whether pages of an origin may send keys of a tenant.
    pub(crate) fn serve(&self, origin: &str, tenant: &Tenant) -> bool {
        self.0.get(origin).is_some_and(|tenants| tenants.contains(tenant))
    }
}

/// Whether a text has the form in which browsers send the origin of a page.
fn is_origin(text: &str) -> bool {
    let Ok(uri) = text.parse::<Uri>() else { return false };
    let (Some(scheme), Some(authority)) = (uri.scheme_str(), uri.authority()) else { return false };
    let standard = match scheme {
        "https" => 443,
        "http" => 80,
        _ => return false,
    };
    // An origin without user, path and upper case consists of nothing else.
    *text == format!("{scheme}://{authority}").to_ascii_lowercase()
        && !authority.as_str().contains('@')
        && authority.port_u16() != Some(standard)
        && !authority.host().contains('*')
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(tenant: &str, origin: &str) -> Result<WebOrigins, WebOriginError> {
        WebOrigins::new(&BTreeMap::from([(tenant.to_owned(), vec![origin.to_owned()])]))
    }

    #[test]
    fn an_origin_is_for_its_tenants() {
        let list = |origins: &[&str]| origins.iter().map(|text| (*text).to_owned()).collect();
        let origins = WebOrigins::new(&BTreeMap::from([
            ("acme".to_owned(), list(&["https://fleet.acme.example", "http://localhost:3000"])),
            ("other".to_owned(), list(&["https://fleet.acme.example"])),
        ]));
        let origins = origins.expect("names of tenants and origins");
        let tenant = |name| Tenant::parse(name).expect("a name");
        for (origin, acme, other) in [
            ("https://fleet.acme.example", true, true),
            ("http://localhost:3000", true, false),
            ("http://localhost", false, false),
            ("http://fleet.acme.example", false, false),
            ("https://x.fleet.acme.example", false, false),
            ("null", false, false),
        ] {
            assert_eq!(origins.has(origin), acme || other, "{origin}");
            assert_eq!(origins.serve(origin, &tenant("acme")), acme, "{origin}");
            assert_eq!(origins.serve(origin, &tenant("other")), other, "{origin}");
        }
        assert!(!origins.serve("https://fleet.acme.example", &Tenant::operator()));
    }

    #[test]
    fn what_no_browser_sends_is_refused() {
        for text in [
            "*",
            "null",
            "",
            "fleet.acme.example",
            "https://",
            "https://fleet.acme.example/",
            "https://fleet.acme.example/app",
            "https://Fleet.acme.example",
            "https://fleet.acme.example:443",
            "http://localhost:80",
            "https://user@fleet.acme.example",
            "https://*.acme.example",
            "ftp://fleet.acme.example",
            "https://fleet.acme.example?x",
        ] {
            let text = text.to_owned();
            assert_eq!(of("acme", &text).unwrap_err(), WebOriginError::Origin { text });
        }
        assert!(of("acme", "https://[2001:db8::1]:8443").is_ok());
        let text = "Acme".to_owned();
        assert_eq!(of(&text, "https://a.b").unwrap_err(), WebOriginError::Tenant { text });
    }
}
