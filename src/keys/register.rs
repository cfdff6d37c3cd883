//! The keys in memory, by the hash of their secrets: all keys in force, and those that ended last.

use std::collections::HashMap;
use std::fmt;
use std::mem::replace;
use std::sync::atomic::{AtomicBool, AtomicI64, Ordering};
use std::sync::{Arc, PoisonError, RwLock, RwLockReadGuard};

use tokio::sync::watch;

use crate::store::KeyRow;
use crate::tenant::Tenant;

use super::{KeyError, Rights, secret};

/// Expiry of a key that does not expire.
const NEVER: i64 = i64::MAX;
/// Most keys in memory that have ended; their requests are refused with the code of their end. Of
/// more, those that ended first are forgotten: a request with one of them is refused as one with a
/// key that never existed.
pub(super) const ENDED: usize = 4_096;
/// They are forgotten once there are this many more than that.
const ENDED_MORE: usize = ENDED / 4;

/// The keys in memory, and the rights of requests without a key.
#[derive(Debug)]
pub(super) struct Register {
    holders: RwLock<Holders>,
    /// Number of the last change that was read.
    changed: AtomicI64,
    /// The latest expiry of a key that was forgotten because it has expired.
    forgotten_unix_ms: AtomicI64,
    /// Whether requests need a key. It is never set back.
    is_closed: AtomicBool,
    /// The holder for requests without a key, while none is needed.
    anybody: Arc<Holder>,
}

/// The holders of the keys in memory.
#[derive(Debug, Default)]
struct Holders {
    /// By the hash of the key's secret.
    by_hash: HashMap<[u8; 32], Arc<Holder>>,
    /// By the key's id.
    by_id: HashMap<Arc<str>, Arc<Holder>>,
}

/// The holder of a key.
struct Holder {
    /// Id of the key; empty if no key is needed.
    id: Arc<str>,
    tenant: Tenant,
    rights: Rights,
    expires_unix_ms: AtomicI64,
    revoked_unix_ms: AtomicI64,
    state: watch::Sender<State>,
    last_used_unix_ms: AtomicI64,
    /// The time of the last use that is stored.
    noted_unix_ms: AtomicI64,
}

/// Whether a key is in force. A revocation is final. An expiry is not: a clock that was ahead for a
/// moment must not end keys for ever.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    InForce,
    Expired,
    Revoked,
}

/// The sender of a request. All clones stand for the same key.
#[derive(Clone)]
pub struct Pass(Arc<Holder>);

impl Register {
    /// A register without keys, in which everybody is the operator.
    pub(super) fn new() -> Self {
        Self::of_tenant(&Tenant::operator())
    }

    /// A register without keys, in which everybody belongs to this tenant.
    pub(super) fn of_tenant(tenant: &Tenant) -> Self {
        let anybody = Holder::new("", tenant, Rights::ALL, NEVER);
        Self {
            holders: RwLock::default(),
            changed: AtomicI64::new(0),
            forgotten_unix_ms: AtomicI64::new(i64::MIN),
            is_closed: AtomicBool::new(false),
            anybody: Arc::new(anybody),
        }
    }

    /// Number of the last change that was read.
    pub(super) fn changed(&self) -> i64 {
        self.changed.load(Ordering::Acquire)
    }

    /// Whether requests need a key.
    pub(super) fn is_closed(&self) -> bool {
        self.is_closed.load(Ordering::Acquire)
    }

    /// Makes requests need a key from now on.
    pub(super) fn close(&self) {
        if !self.is_closed.swap(true, Ordering::AcqRel) {
            self.anybody.revoke();
        }
    }

    /// Adds changed keys. A change may come twice, and an earlier change after a later one.
    pub(super) fn take(&self, rows: Vec<KeyRow>) {
        let Some(last) = rows.iter().map(|row| row.changed).max() else { return };
        let mut holders = self.holders.write().unwrap_or_else(PoisonError::into_inner);
        let Holders { by_hash, by_id } = &mut *holders;
        for KeyRow { key, revoked_unix_ms, last_used_unix_ms, .. } in rows {
            let expires_unix_ms = key.expires_unix_ms.unwrap_or(NEVER);
            let holder = by_hash.entry(key.secret_sha256).or_insert_with(|| {
                let rights = Rights::stored(&key.rights);
                let holder = Holder::new(&key.id, &key.tenant, rights, expires_unix_ms);
                let holder = Arc::new(holder);
                by_id.insert(holder.id.clone(), holder.clone());
                holder
            });
            holder.expires_unix_ms.fetch_min(expires_unix_ms, Ordering::AcqRel);
            let noted = last_used_unix_ms.unwrap_or(0);
            holder.noted_unix_ms.fetch_max(noted, Ordering::AcqRel);
            if let Some(revoked_unix_ms) = revoked_unix_ms {
                holder.revoked_unix_ms.store(revoked_unix_ms, Ordering::Release);
                holder.revoke();
            }
        }
        drop(holders);
        self.changed.fetch_max(last, Ordering::AcqRel);
        self.close();
    }

    /// The sender with this key, or without one.
    pub(super) fn find(&self, presented: Option<&str>, unix_ms: i64) -> Result<Pass, KeyError> {
        if !self.is_closed() {
            return Ok(Pass(self.anybody.clone()));
        }
        let presented = presented.ok_or(KeyError::Required)?;
        let pass = self.known(presented).ok_or(KeyError::Invalid)?;
        pass.check_at(unix_ms)?;
        Ok(pass)
    }

    /// The holder of this key, in force or not; `None` if the text is not a key.
    pub(super) fn known(&self, presented: &str) -> Option<Pass> {
        let hash = secret::hash(presented)?;
        self.read().by_hash.get(&hash).cloned().map(Pass)
    }

    /// The holder of the key with this id, in force or not.
    pub(super) fn of_id(&self, id: &str) -> Option<Pass> {
        self.read().by_id.get(id).cloned().map(Pass)
    }

    /// Ends the keys that have expired at this time, and puts those in force that have not.
    pub(super) fn follow_clock(&self, unix_ms: i64) {
        self.read().by_hash.values().for_each(|holder| holder.follow_clock(unix_ms));
    }

    /// Forgets the keys that ended first, if there are too many, as of this time.
    pub(super) fn forget_ended(&self, unix_ms: i64) {
        self.follow_clock(unix_ms);
        let ended = self.read().by_hash.values().filter(|holder| holder.has_ended()).count();
        if ended <= ENDED + ENDED_MORE {
            return;
        }
        let mut holders = self.holders.write().unwrap_or_else(PoisonError::into_inner);
        let Holders { by_hash, by_id } = &mut *holders;
        // A revocation must reach each pass. So a key stays while a request or a sign-in has one.
        let is_free = |holder: &Arc<Holder>| holder.has_ended() && Arc::strong_count(holder) == 2;
        let mut ended: Vec<(i64, [u8; 32])> = by_hash
            .iter()
            .filter(|(_, holder)| is_free(holder))
            .map(|(hash, holder)| (holder.end_unix_ms(), *hash))
            .collect();
        ended.sort_unstable();
        let forgotten = ended.len().saturating_sub(ENDED);
        for (end_unix_ms, hash) in &ended[..forgotten] {
            let Some(holder) = by_hash.remove(hash) else { continue };
            by_id.remove(&holder.id);
            if *holder.state.borrow() == State::Expired {
                self.forgotten_unix_ms.fetch_max(*end_unix_ms, Ordering::AcqRel);
            }
        }
    }

    /// If a forgotten key has not expired at this time, because the clock was ahead when it was
    /// forgotten, all changes are to be read again.
    pub(super) fn read_forgotten(&self, unix_ms: i64) {
        if unix_ms < self.forgotten_unix_ms.load(Ordering::Acquire) {
            self.forgotten_unix_ms.store(i64::MIN, Ordering::Release);
            self.changed.store(0, Ordering::Release);
        }
    }

    /// The last uses that are not stored yet.
    pub(super) fn uses(&self) -> Vec<(String, i64)> {
        let read = self.read();
        let holders = read.by_hash.values();
        holders.filter_map(|holder| Some((holder.id.to_string(), holder.unnoted()?))).collect()
    }

    /// Notes that these uses are stored.
    pub(super) fn note(&self, uses: &[(String, i64)]) {
        let read = self.read();
        for (id, unix_ms) in uses {
            if let Some(holder) = read.by_id.get(&**id) {
                holder.noted_unix_ms.fetch_max(*unix_ms, Ordering::AcqRel);
            }
        }
    }

    fn read(&self) -> RwLockReadGuard<'_, Holders> {
        self.holders.read().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Holder {
    fn new(id: &str, tenant: &Tenant, rights: Rights, expires_unix_ms: i64) -> Self {
        Self {
            id: id.into(),
            tenant: tenant.clone(),
            rights,
            expires_unix_ms: AtomicI64::new(expires_unix_ms),
            revoked_unix_ms: AtomicI64::new(NEVER),
            state: watch::Sender::new(State::InForce),
            last_used_unix_ms: AtomicI64::new(0),
            noted_unix_ms: AtomicI64::new(0),
        }
    }

    fn revoke(&self) {
        self.state.send_if_modified(|state| replace(state, State::Revoked) != State::Revoked);
    }

    fn has_ended(&self) -> bool {
        *self.state.borrow() != State::InForce
    }

    /// When it ended or will end (ms since 1970-01-01 UTC).
    fn end_unix_ms(&self) -> i64 {
        let revoked = self.revoked_unix_ms.load(Ordering::Acquire);
        self.expires_unix_ms.load(Ordering::Acquire).min(revoked)
    }

    /// Expired or in force, as of this time, unless it is revoked.
    fn follow_clock(&self, unix_ms: i64) {
        let is_expired = self.expires_unix_ms.load(Ordering::Acquire) <= unix_ms;
        let state = if is_expired { State::Expired } else { State::InForce };
        self.state.send_if_modified(|present| {
            *present != State::Revoked && replace(present, state) != state
        });
    }

    /// The last use, if it is not stored yet.
    fn unnoted(&self) -> Option<i64> {
        let used = self.last_used_unix_ms.load(Ordering::Acquire);
        (self.noted_unix_ms.load(Ordering::Acquire) < used).then_some(used)
    }

    /// The refusal of the key in this state, if there is one.
    fn refused(&self, state: State) -> Result<(), KeyError> {
        let id = self.id.to_string();
        match state {
            State::InForce => Ok(()),
            _ if id.is_empty() => Err(KeyError::Required),
            State::Expired => Err(KeyError::Expired { id }),
            State::Revoked => Err(KeyError::Revoked { id }),
        }
    }
}

impl Pass {
    /// Id of the key; `None` if no key is needed.
    pub fn key(&self) -> Option<&str> {
        Some(&*self.0.id).filter(|id| !id.is_empty())
    }

    /// The tenant for which the request is made.
    pub fn tenant(&self) -> &Tenant {
        &self.0.tenant
    }

    /// The rights of the key.
    pub fn rights(&self) -> Rights {
        self.0.rights
    }

    /// Checks that the key is still in force.
    ///
    /// # Errors
    /// It was revoked or has expired; or it was a request without a key, and keys are needed now.
    pub(crate) fn check(&self) -> Result<(), KeyError> {
        let state = *self.0.state.borrow();
        self.0.refused(state)
    }

    /// Like [`Self::check`], at this time (ms since 1970-01-01 UTC).
    ///
    /// # Errors
    /// As for [`Self::check`].
    pub(super) fn check_at(&self, unix_ms: i64) -> Result<(), KeyError> {
        self.0.follow_clock(unix_ms);
        self.check()?;
        self.0.last_used_unix_ms.fetch_max(unix_ms, Ordering::Relaxed);
        Ok(())
    }

    /// Waits until the key is no longer in force, and returns why.
    pub(crate) fn ended(&self) -> impl Future<Output = KeyError> + Send + use<> {
        let (mut state, holder) = (self.0.state.subscribe(), self.0.clone());
        async move {
            let ended = state.wait_for(|state| *state != State::InForce).await;
            let state = *ended.expect("the holder has the sender");
            holder.refused(state).err().unwrap_or(KeyError::Required)
        }
    }
}

impl fmt::Debug for Holder {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { id, tenant, rights, .. } = self;
        write!(f, "Holder({id:?} of {tenant:?}, {rights})")
    }
}

impl fmt::Debug for Pass {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

#[cfg(test)]
mod tests {
    use futures::FutureExt;

    use super::*;
    use crate::keys::{Right, Secret};
    use crate::refusal::Code;
    use crate::store::NewKeyRow;

    fn row(secret: &Secret, changed: i64, expires_unix_ms: Option<i64>) -> KeyRow {
        let key = NewKeyRow {
            id: format!("key_{changed}"),
            tenant: Tenant::operator(),
            rights: "device".to_owned(),
            label: String::new(),
            secret_sha256: secret::hash(secret.text()).unwrap(),
            created_unix_ms: 0,
            expires_unix_ms,
        };
        KeyRow { key, revoked_unix_ms: None, last_used_unix_ms: None, changed }
    }

    fn refused(register: &Register, key: Option<&str>, unix_ms: i64) -> Code {
        register.find(key, unix_ms).unwrap_err().code()
    }

    /// The first key ends streams and watches that were opened without a key.
    #[test]
    fn from_the_first_key_on_a_key_is_needed() {
        let register = Register::new();
        let before = register.find(Some("any text"), 0).unwrap();
        assert_eq!((before.key(), before.rights()), (None, Rights::ALL));
        let mut ended = Box::pin(before.ended());
        assert!(ended.as_mut().now_or_never().is_none());
        let secret = Secret::random().unwrap();
        register.take(vec![row(&secret, 1, None)]);
        assert_eq!(ended.now_or_never().unwrap().code(), Code::KeyRequired);
        assert_eq!(refused(&register, None, 0), Code::KeyRequired);
        assert_eq!(refused(&register, Some("any text"), 0), Code::KeyInvalid);
        let other = Secret::random().unwrap();
        assert_eq!(refused(&register, Some(other.text()), 0), Code::KeyInvalid);
        let pass = register.find(Some(secret.text()), 0).unwrap();
        assert_eq!((pass.key(), pass.rights()), (Some("key_1"), Rights::of(&[Right::Device])));
    }

    /// Calls see the end at the millisecond, waiting streams at the next upkeep.
    #[test]
    fn a_key_expires() {
        let (register, secret) = (Register::new(), Secret::random().unwrap());
        register.take(vec![row(&secret, 1, Some(1000))]);
        let pass = register.find(Some(secret.text()), 999).unwrap();
        let mut ended = Box::pin(pass.ended());
        register.follow_clock(999);
        assert!(ended.as_mut().now_or_never().is_none());
        register.follow_clock(1000);
        assert_eq!(ended.now_or_never().unwrap().code(), Code::KeyExpired);
        assert_eq!(refused(&register, Some(secret.text()), 1000), Code::KeyExpired);
        assert_eq!(refused(&register, None, 1000), Code::KeyRequired, "an ended key counts");
    }

    /// Open streams have ended, but the key is in force again.
    #[test]
    fn a_clock_that_was_ahead_for_a_moment_ends_no_key_for_ever() {
        let (register, secret) = (Register::new(), Secret::random().unwrap());
        register.take(vec![row(&secret, 1, Some(1000))]);
        let pass = register.find(Some(secret.text()), 0).unwrap();
        register.follow_clock(5000);
        assert_eq!(pass.check().unwrap_err().code(), Code::KeyExpired);
        register.follow_clock(10);
        pass.check().unwrap();
        register.follow_clock(5000);
        register.find(Some(secret.text()), 20).unwrap().check().unwrap();
    }

    /// A revocation stays, in whatever order changes arrive.
    #[test]
    fn a_revocation_stays() {
        let (register, secret) = (Register::new(), Secret::random().unwrap());
        let first = row(&secret, 1, None);
        let mut shorter = KeyRow { changed: 2, ..first.clone() };
        shorter.key.expires_unix_ms = Some(5000);
        let revoked = KeyRow { changed: 3, revoked_unix_ms: Some(7), ..shorter.clone() };
        register.take(vec![first.clone()]);
        let pass = register.find(Some(secret.text()), 0).unwrap();
        register.take(vec![shorter]);
        register.take(vec![first.clone()]);
        pass.check().unwrap();
        register.follow_clock(5000);
        assert_eq!(pass.check().unwrap_err().code(), Code::KeyExpired);
        let (register, secret) = (Register::new(), Secret::random().unwrap());
        let hash = secret::hash(secret.text()).unwrap();
        let of_secret = |row: &KeyRow| {
            let mut row = row.clone();
            row.key.secret_sha256 = hash;
            row
        };
        register.take(vec![of_secret(&revoked)]);
        register.take(vec![of_secret(&first)]);
        assert_eq!(register.changed(), 3);
        assert_eq!(refused(&register, Some(secret.text()), 0), Code::KeyRevoked);
    }

    /// Of many revoked keys those that ended last stay in memory. Keys in force stay all, and one
    /// that a stream still has.
    #[test]
    fn ended_keys_are_bounded_in_memory() {
        let register = Register::new();
        let (kept, used) = (Secret::random().unwrap(), Secret::random().unwrap());
        register.take(vec![row(&kept, 1, None), row(&used, 2, Some(5))]);
        let pass = register.find(Some(used.text()), 0).unwrap();
        let secrets: Vec<Secret> = (0..3 * ENDED).map(|_| Secret::random().unwrap()).collect();
        for (changed, secret) in (3..).zip(&secrets) {
            let revoked_unix_ms = Some(changed);
            register.take(vec![KeyRow { revoked_unix_ms, ..row(secret, changed, None) }]);
        }
        register.forget_ended(10);
        assert_eq!(register.read().by_hash.len(), ENDED + 2);
        assert_eq!(register.read().by_id.len(), ENDED + 2);
        let refused = |secret: &Secret| refused(&register, Some(secret.text()), 10);
        assert_eq!(refused(&secrets[0]), Code::KeyInvalid);
        assert_eq!(refused(&secrets[3 * ENDED - 1]), Code::KeyRevoked);
        register.find(Some(kept.text()), 10).unwrap();
        assert_eq!(pass.check().unwrap_err().code(), Code::KeyExpired);
        assert_eq!(register.changed(), 2 + 3 * ENDED as i64);
    }

    /// Keys that were forgotten while the clock was ahead are read again.
    #[test]
    fn forgotten_keys_are_read_again_when_the_clock_steps_back() {
        let register = Register::new();
        for changed in 1..=2 * ENDED as i64 {
            let secret = Secret::random().unwrap();
            register.take(vec![row(&secret, changed, Some(1_000 + changed))]);
        }
        register.forget_ended(1_000_000);
        register.read_forgotten(1_000_000);
        assert_eq!(register.changed(), 2 * ENDED as i64);
        register.read_forgotten(1_001);
        assert_eq!(register.changed(), 0);
    }

    #[test]
    fn a_use_is_noted_once() {
        let (register, secret) = (Register::new(), Secret::random().unwrap());
        register.take(vec![row(&secret, 1, None)]);
        assert!(register.uses().is_empty());
        register.find(Some(secret.text()), 50).unwrap();
        let uses = register.uses();
        assert_eq!(uses, [("key_1".to_owned(), 50)]);
        register.find(Some(secret.text()), 60).unwrap();
        register.note(&uses);
        assert_eq!(register.uses(), [("key_1".to_owned(), 60)]);
        register.note(&register.uses());
        assert!(register.uses().is_empty());
    }
}
