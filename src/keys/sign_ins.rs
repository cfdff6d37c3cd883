//! Sign-ins of browsers: a cookie in place of a key, so that no page has the key in its memory.
//!
//! They are in memory only: after a restart of the service people sign in again.

use std::collections::HashMap;
use std::fmt;
use std::sync::{Mutex, MutexGuard, PoisonError};

use crate::tenant::Tenant;

use super::secret::{Secret, hash};
use super::{KeyError, Pass};

/// Sign-ins at the same time. Another one ends the oldest of the tenant that has the most.
const SIGN_INS: usize = 1024;
/// How long a sign-in lasts (ms): a working day.
pub(super) const LIFETIME_MS: i64 = 12 * 3_600_000;

/// A browser that is signed in.
#[derive(Clone)]
pub struct SignIn {
    /// Whose key it was.
    pub pass: Pass,
    /// What a page of this service knows and others do not; it comes with each change.
    pub csrf_token: String,
    /// When it ends (ms since 1970-01-01 UTC), unless the key ends before.
    pub expires_unix_ms: i64,
}

/// All sign-ins, by the hash of their cookies.
#[derive(Debug, Default)]
pub(super) struct SignIns(Mutex<HashMap<[u8; 32], SignIn>>);

impl SignIns {
    fn lock(&self) -> MutexGuard<'_, HashMap<[u8; 32], SignIn>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Signs in; returns the value of the cookie, too.
    ///
    /// # Errors
    /// The system has no random bits.
    pub(super) fn begin(&self, pass: Pass, unix_ms: i64) -> Result<(Secret, SignIn), KeyError> {
        let (cookie, csrf_token) = (Secret::random()?, Secret::random()?.text().to_owned());
        let sign_in = SignIn { pass, csrf_token, expires_unix_ms: unix_ms + LIFETIME_MS };
        let mut sign_ins = self.lock();
        sign_ins.retain(|_, other| other.is_in_force(unix_ms));
        if SIGN_INS <= sign_ins.len()
            && let Some(oldest) = oldest_of_most(&sign_ins, sign_in.pass.tenant())
        {
            sign_ins.remove(&oldest);
        }
        sign_ins
            .insert(hash(cookie.text()).expect("a secret has the form of one"), sign_in.clone());
        Ok((cookie, sign_in))
    }

    /// The sign-in of a cookie, while it and its key are in force.
    pub(super) fn find(&self, cookie: &str, unix_ms: i64) -> Option<SignIn> {
        let sign_in = self.lock().get(&hash(cookie)?)?.clone();
        sign_in.is_in_force(unix_ms).then_some(sign_in)
    }

    /// Signs out.
    pub(super) fn end(&self, cookie: &str) {
        if let Some(hash) = hash(cookie) {
            self.lock().remove(&hash);
        }
    }
}

impl SignIn {
    fn is_in_force(&self, unix_ms: i64) -> bool {
        unix_ms < self.expires_unix_ms && self.pass.check_at(unix_ms).is_ok()
    }
}

/// The oldest sign-in of the tenant that has the most, one more of `tenant` included; nobody signs
/// others out by signing in often.
fn oldest_of_most(sign_ins: &HashMap<[u8; 32], SignIn>, tenant: &Tenant) -> Option<[u8; 32]> {
    let mut counts = HashMap::from([(tenant, 1_usize)]);
    for sign_in in sign_ins.values() {
        *counts.entry(sign_in.pass.tenant()).or_default() += 1;
    }
    let most = *counts.values().max()?;
    let of_most = sign_ins.iter().filter(|(_, other)| counts[other.pass.tenant()] == most);
    of_most.min_by_key(|(_, other)| other.expires_unix_ms).map(|(hash, _)| *hash)
}

/// Without the token, so that no log has it.
impl fmt::Debug for SignIn {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "SignIn({:?}, until {})", self.pass, self.expires_unix_ms)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::keys::register::Register;

    fn anybody() -> Pass {
        Register::new().find(None, 0).unwrap()
    }

    #[test]
    fn a_sign_in_ends_by_time_and_by_hand() {
        let sign_ins = SignIns::default();
        let (cookie, sign_in) = sign_ins.begin(anybody(), 1000).unwrap();
        assert_eq!(sign_in.expires_unix_ms, 1000 + LIFETIME_MS);
        assert_ne!(cookie.text(), sign_in.csrf_token);
        let is_found = |unix_ms| sign_ins.find(cookie.text(), unix_ms).is_some();
        assert!(is_found(1000) && is_found(999 + LIFETIME_MS));
        assert!(!is_found(1000 + LIFETIME_MS));
        assert!(sign_ins.find("gfx_0", 1000).is_none());
        sign_ins.end(cookie.text());
        assert!(!is_found(1000));
    }

    /// Who signs in often ends sign-ins of its own tenant only.
    #[test]
    fn a_tenant_ends_its_own_sign_ins() {
        let sign_ins = SignIns::default();
        let other = Register::of_tenant(&Tenant::parse("other").unwrap()).find(None, 0).unwrap();
        let first = sign_ins.begin(anybody(), 1).unwrap().0;
        for unix_ms in 2..=2 * SIGN_INS as i64 {
            sign_ins.begin(other.clone(), unix_ms).unwrap();
        }
        let now = 3 * SIGN_INS as i64;
        assert!(sign_ins.find(first.text(), now).is_some());
        assert_eq!(sign_ins.lock().len(), SIGN_INS);
    }

    /// The oldest makes room.
    #[test]
    fn sign_ins_are_bounded() {
        let sign_ins = SignIns::default();
        let begin = |unix_ms| sign_ins.begin(anybody(), unix_ms).unwrap().0;
        let (first, second) = (begin(1), begin(2));
        (3..=SIGN_INS as i64 + 1).for_each(|unix_ms| drop(begin(unix_ms)));
        let now = SIGN_INS as i64 + 2;
        assert!(sign_ins.find(first.text(), now).is_none());
        assert!(sign_ins.find(second.text(), now).is_some());
        assert_eq!(sign_ins.lock().len(), SIGN_INS);
    }
}
