//! Sign-ins of browsers: a cookie replaces the key, so that no page has the key in its memory.
//!
//! They are in the store, by the hash of their cookies, and in memory at each node of a cluster.

use std::collections::HashMap;
use std::fmt;
use std::sync::atomic::{AtomicI64, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

use crate::store::SignInRow;
use crate::tenant::Tenant;

use super::Pass;
use super::register::Register;
use super::secret::{Secret, hash};

/// Most sign-ins at the same time. Beyond it, the tenant with the most loses its oldest one.
const SIGN_INS: usize = 1024;
/// Duration of a sign-in (ms): a working day.
pub(super) const LIFETIME_MS: i64 = 12 * 3_600_000;
/// The purpose for which the token is derived from the cookie.
const CSRF: &str = "csrf";

/// A browser that is signed in.
#[derive(Clone)]
pub struct SignIn {
    /// The holder of the key with which the browser signed in.
    pub pass: Pass,
    /// Token that only pages of this service know. Each change must have it.
    pub csrf_token: String,
    /// When it ends (ms since 1970-01-01 UTC), unless the key ends before.
    pub expires_unix_ms: i64,
}

/// All sign-ins, by the hash of their cookies.
#[derive(Debug, Default)]
pub(super) struct SignIns {
    by_cookie: Mutex<HashMap<[u8; 32], InForce>>,
    /// Number of the last change that was read.
    changed: AtomicI64,
}

/// A sign-in that was not ended.
#[derive(Debug)]
struct InForce {
    pass: Pass,
    expires_unix_ms: i64,
}

impl SignIns {
    /// Number of the last change that was read.
    pub(super) fn changed(&self) -> i64 {
        self.changed.load(Ordering::Acquire)
    }

    /// Adds changed sign-ins, in the order of their changes. Their keys must be known.
    pub(super) fn take(&self, rows: Vec<SignInRow>, register: &Register) {
        let mut sign_ins = self.lock();
        for row in rows {
            let pass = register.of_id(&row.key).filter(|_| !row.is_ended);
            match pass {
                Some(pass) => {
                    let sign_in = InForce { pass, expires_unix_ms: row.expires_unix_ms };
                    sign_ins.insert(row.cookie_sha256, sign_in);
                }
                None => drop(sign_ins.remove(&row.cookie_sha256)),
            }
            self.changed.fetch_max(row.changed, Ordering::AcqRel);
        }
    }

    /// The sign-in of a cookie, while it and its key are in force.
    pub(super) fn find(&self, cookie: &str, unix_ms: i64) -> Option<SignIn> {
        let hash = hash(cookie)?;
        let sign_ins = self.lock();
        let sign_in = sign_ins.get(&hash).filter(|sign_in| sign_in.is_at(unix_ms))?;
        let InForce { pass, expires_unix_ms } = sign_in;
        Some(SignIn {
            pass: pass.clone(),
            csrf_token: csrf_token(cookie),
            expires_unix_ms: *expires_unix_ms,
        })
    }

    /// Makes room for another sign-in of a tenant. Returns the hashes of the cookies that it ends.
    pub(super) fn make_room(&self, tenant: &Tenant, unix_ms: i64) -> Vec<[u8; 32]> {
        let mut sign_ins = self.lock();
        sign_ins.retain(|_, sign_in| sign_in.is_at(unix_ms));
        let mut ended = Vec::new();
        while SIGN_INS <= sign_ins.len()
            && let Some(oldest) = oldest_of_most(&sign_ins, tenant)
        {
            sign_ins.remove(&oldest);
            ended.push(oldest);
        }
        ended
    }

    /// Ends the sign-in of a cookie.
    pub(super) fn end(&self, cookie_sha256: &[u8; 32]) {
        self.lock().remove(cookie_sha256);
    }

    fn lock(&self) -> MutexGuard<'_, HashMap<[u8; 32], InForce>> {
        self.by_cookie.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl InForce {
    fn is_at(&self, unix_ms: i64) -> bool {
        unix_ms < self.expires_unix_ms && self.pass.check_at(unix_ms).is_ok()
    }
}

/// The token of a cookie's sign-in. Every node computes the same one.
pub(super) fn csrf_token(cookie: &str) -> String {
    Secret::derived(CSRF, cookie).text().to_owned()
}

/// The oldest sign-in of the tenant with the most, where one more of `tenant` is counted. So nobody
/// can sign out other tenants by signing in often.
fn oldest_of_most(sign_ins: &HashMap<[u8; 32], InForce>, tenant: &Tenant) -> Option<[u8; 32]> {
    let mut counts = HashMap::from([(tenant, 1_usize)]);
    for sign_in in sign_ins.values() {
        *counts.entry(sign_in.pass.tenant()).or_default() += 1;
    }
    let most = *counts.values().max()?;
    let of_most = sign_ins.iter().filter(|(_, other)| counts[other.pass.tenant()] == most);
    of_most.min_by_key(|(_, other)| other.expires_unix_ms).map(|(hash, _)| *hash)
}

/// Omits the token, so that no log contains it.
impl fmt::Debug for SignIn {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "SignIn({:?}, until {})", self.pass, self.expires_unix_ms)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::{KeyRow, NewKeyRow};

    /// A register with a key for each of these tenants. The key has the tenant's name as its id.
    fn keys(tenants: &[&str]) -> Register {
        let register = Register::new();
        let row = |(index, tenant): (usize, &&str)| KeyRow {
            key: NewKeyRow {
                id: (*tenant).to_owned(),
                tenant: Tenant::parse(tenant).unwrap(),
                rights: "read".to_owned(),
                label: String::new(),
                secret_sha256: [index as u8; 32],
                created_unix_ms: 0,
                expires_unix_ms: None,
            },
            revoked_unix_ms: None,
            last_used_unix_ms: None,
            changed: 1,
        };
        register.take(tenants.iter().enumerate().map(row).collect());
        register
    }

    /// A sign-in by this key, as a service stores it: the cookie and the row.
    fn begun(key: &str, unix_ms: i64) -> (Secret, SignInRow) {
        let cookie = Secret::random().unwrap();
        let row = SignInRow {
            cookie_sha256: hash(cookie.text()).unwrap(),
            key: key.to_owned(),
            expires_unix_ms: unix_ms + LIFETIME_MS,
            is_ended: false,
            changed: unix_ms,
        };
        (cookie, row)
    }

    /// Signs in, and returns the cookie.
    fn sign_in(sign_ins: &SignIns, register: &Register, key: &str, unix_ms: i64) -> Secret {
        let (cookie, row) = begun(key, unix_ms);
        for ended in sign_ins.make_room(register.of_id(key).unwrap().tenant(), unix_ms) {
            sign_ins.end(&ended);
        }
        sign_ins.take(vec![row], register);
        cookie
    }

    #[test]
    fn a_sign_in_ends_by_time_and_by_hand() {
        let (sign_ins, register) = (SignIns::default(), keys(&["one"]));
        let (cookie, row) = begun("one", 1000);
        sign_ins.take(vec![row.clone()], &register);
        assert_eq!(sign_ins.changed(), 1000);
        let found = sign_ins.find(cookie.text(), 1000).unwrap();
        assert_eq!(found.expires_unix_ms, 1000 + LIFETIME_MS);
        assert_eq!(found.csrf_token, csrf_token(cookie.text()));
        assert_ne!(cookie.text(), found.csrf_token);
        let is_found = |unix_ms| sign_ins.find(cookie.text(), unix_ms).is_some();
        assert!(is_found(1000) && is_found(999 + LIFETIME_MS));
        assert!(!is_found(1000 + LIFETIME_MS));
        assert!(sign_ins.find("gfx_0", 1000).is_none());
        assert!(sign_ins.find(Secret::random().unwrap().text(), 1000).is_none());
        let ended = SignInRow { is_ended: true, changed: 1001, ..row };
        sign_ins.take(vec![ended], &register);
        assert!(!is_found(1000));
        assert_eq!(sign_ins.changed(), 1001);
    }

    /// A sign-in by an unknown key is not accepted.
    #[test]
    fn a_sign_in_needs_its_key() {
        let (sign_ins, register) = (SignIns::default(), keys(&["one"]));
        let (cookie, row) = begun("other", 1000);
        sign_ins.take(vec![row], &register);
        assert!(sign_ins.find(cookie.text(), 1000).is_none());
    }

    /// A tenant that signs in often ends only its own sign-ins.
    #[test]
    fn a_tenant_ends_its_own_sign_ins() {
        let (sign_ins, register) = (SignIns::default(), keys(&["one", "other"]));
        let first = sign_in(&sign_ins, &register, "one", 1);
        for unix_ms in 2..=2 * SIGN_INS as i64 {
            sign_in(&sign_ins, &register, "other", unix_ms);
        }
        let now = 3 * SIGN_INS as i64;
        assert!(sign_ins.find(first.text(), now).is_some());
        assert_eq!(sign_ins.lock().len(), SIGN_INS);
    }

    /// At the limit, the oldest sign-in is ended.
    #[test]
    fn sign_ins_are_bounded() {
        let (sign_ins, register) = (SignIns::default(), keys(&["one"]));
        let begin = |unix_ms| sign_in(&sign_ins, &register, "one", unix_ms);
        let (first, second) = (begin(1), begin(2));
        (3..=SIGN_INS as i64 + 1).for_each(|unix_ms| drop(begin(unix_ms)));
        let now = SIGN_INS as i64 + 2;
        assert!(sign_ins.find(first.text(), now).is_none());
        assert!(sign_ins.find(second.text(), now).is_some());
        assert_eq!(sign_ins.lock().len(), SIGN_INS);
    }
}
