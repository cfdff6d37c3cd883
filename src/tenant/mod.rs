//! Tenants: the owners of sessions, bases, jobs, navigation data and keys, and their quotas.
//!
//! Code that reads or changes an object of a tenant names the tenant: the handle of a desk belongs
//! to one tenant, and the store's statements have the tenant in their condition. So an object of
//! another tenant is not found, as if it did not exist.
//!
//! The operator is a tenant, too. It is the tenant of a service without keys, and the owner of
//! everything that was stored before there were tenants. Its bases and navigation data serve all
//! tenants. It reaches objects of another tenant only with a key of that tenant.

use std::fmt;
use std::sync::Arc;

/// The name of the operator's tenant.
pub const OPERATOR: &str = "default";
/// Longest name (characters).
const NAME_MAX: usize = 63;
/// Hexadecimal digits of an etag.
const ETAG_DIGITS: usize = 16;

/// A tenant, by its name. Clones share the text.
#[derive(Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Tenant(Arc<str>);

impl Tenant {
    /// The operator's tenant.
    pub fn operator() -> Self {
        Self(OPERATOR.into())
    }

    /// The tenant with this name: 1 to 63 lower-case letters, digits, `-` and `_`, beginning with a
    /// letter or digit; `None` for any other text.
    pub fn parse(name: &str) -> Option<Self> {
        let is_inner = |byte: u8| byte.is_ascii_lowercase() || byte.is_ascii_digit();
        let is_name = (1..=NAME_MAX).contains(&name.len())
            && name.bytes().all(|byte| is_inner(byte) || byte == b'-' || byte == b'_')
            && name.bytes().next().is_some_and(is_inner);
        is_name.then(|| Self(name.into()))
    }

    /// The tenant with this stored name.
    pub(crate) fn stored(name: &str) -> Self {
        Self(name.into())
    }

    /// Its name.
    pub fn name(&self) -> &str {
        &self.0
    }

    /// Whether it is the operator's.
    pub fn is_operator(&self) -> bool {
        &*self.0 == OPERATOR
    }
}

/// The quotas of a tenant; `None` for no limit.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Quotas {
    /// Sessions that are stored, open and closed.
    pub sessions: Option<u64>,
    /// Epochs a second, over ten seconds.
    pub epochs_per_s: Option<f64>,
    /// Processor time of the solvers a minute (s).
    pub cpu_s_per_minute: Option<f64>,
    /// Bytes of stored epochs and solutions, approximately.
    pub stored_bytes: Option<u64>,
    /// Bytes of the files of jobs and uploads.
    pub job_bytes: Option<u64>,
}

impl Quotas {
    /// Whether there is a quota that is counted in the store: of sessions or of their bytes.
    pub(crate) const fn is_of_stored(&self) -> bool {
        self.sessions.is_some() || self.stored_bytes.is_some()
    }

    /// The etag of the quotas. Other quotas have another etag.
    pub(crate) fn etag(&self) -> String {
        let Self { sessions, epochs_per_s, cpu_s_per_minute, stored_bytes, job_bytes } = self;
        let rates = [epochs_per_s, cpu_s_per_minute].map(|rate| rate.map(f64::to_bits));
        let text = format!("{:?}", (sessions, rates, stored_bytes, job_bytes));
        blake3::hash(text.as_bytes()).to_hex()[..ETAG_DIGITS].to_owned()
    }

    /// The changed quotas as text for people: each with its value before and now.
    pub(crate) fn changes_since(&self, before: &Self) -> String {
        let count = |quota: Option<u64>| quota.map(|quota| quota.to_string());
        let rate = |quota: Option<f64>| quota.map(|quota| quota.to_string());
        let quotas = [
            ("sessions", count(before.sessions), count(self.sessions)),
            ("epochsPerS", rate(before.epochs_per_s), rate(self.epochs_per_s)),
            ("cpuSPerMinute", rate(before.cpu_s_per_minute), rate(self.cpu_s_per_minute)),
            ("storedBytes", count(before.stored_bytes), count(self.stored_bytes)),
            ("jobBytes", count(before.job_bytes), count(self.job_bytes)),
        ];
        let shown = |quota: Option<String>| quota.unwrap_or_else(|| "none".to_owned());
        let changed = quotas.into_iter().filter(|(_, before, now)| before != now);
        let changes: Vec<String> = changed
            .map(|(name, before, now)| format!("{name} {} → {}", shown(before), shown(now)))
            .collect();
        if changes.is_empty() { "as before".to_owned() } else { changes.join(", ") }
    }
}

impl fmt::Display for Tenant {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl fmt::Debug for Tenant {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:?}", &*self.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_is_short_and_plain() {
        for name in ["default", "a", "7", "acme-2_b", &"x".repeat(63)] {
            assert_eq!(Tenant::parse(name).unwrap().name(), name);
        }
        for text in ["", "-a", "_a", "A", "a b", "a/b", "ä", "a\n", &"x".repeat(64)] {
            assert_eq!(Tenant::parse(text), None, "{text:?}");
        }
        assert!(Tenant::operator().is_operator());
        assert!(!Tenant::parse("acme").unwrap().is_operator());
    }

    #[test]
    fn changed_quotas_are_named_with_both_values() {
        let none = Quotas::default();
        let some = Quotas { sessions: Some(10), epochs_per_s: Some(2.5), ..none };
        assert_eq!(some.changes_since(&none), "sessions none → 10, epochsPerS none → 2.5");
        let other = Quotas { sessions: Some(0), epochs_per_s: Some(2.5), ..none };
        assert_eq!(other.changes_since(&some), "sessions 10 → 0");
        assert_eq!(none.changes_since(&other), "sessions 0 → none, epochsPerS 2.5 → none");
        assert_eq!(some.changes_since(&some), "as before");
    }
}
