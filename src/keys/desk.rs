//! The keys of a service: calls use them in memory, changes go to the store.

use std::fmt;
use std::net::IpAddr;
use std::sync::Arc;
use std::time::Instant;

use tokio::sync::{Mutex, watch};
use tokio::task::JoinHandle;

use crate::clock::Clock;
use crate::store::{Author, Page, Store};
use crate::tenant::Tenant;

use super::attempts::Attempts;
use super::known::Known;
use super::registry::{Created, KeyInfo, KeyRegistry, NewKey};
use super::sign_ins::{LIFETIME_MS, SignIn, csrf_token};
use super::upkeep::Upkeep;
use super::{KeyError, Pass, Secret, secret};

/// The keys of a service. All clones share them.
#[derive(Clone)]
pub struct Keys(Arc<Desk>);

struct Desk {
    store: Store,
    clock: Clock,
    registry: KeyRegistry,
    known: Arc<Known>,
    attempts: Attempts,
    /// Stops the upkeep. It also stops when the desk is dropped.
    stop: watch::Sender<bool>,
    upkeep: Mutex<Option<JoinHandle<()>>>,
}

/// The token that proves that a page of this service makes a change.
#[derive(Clone, Copy, Debug)]
pub enum CsrfToken<'a> {
    /// The request changes nothing.
    NotNeeded,
    /// The token of the request; empty without one.
    Given(&'a str),
}

impl Keys {
    /// Reads all keys, and follows their changes until it is closed or dropped.
    ///
    /// # Errors
    /// The store fails.
    pub async fn open(store: Store) -> Result<Self, KeyError> {
        let clock = Clock::system();
        let known = Arc::new(Known::new(store.clone()));
        known.refresh().await?;
        let (stop, stopped) = watch::channel(false);
        let upkeep = Upkeep { store: store.clone(), clock: clock.clone(), stopped };
        let upkeep = tokio::spawn(upkeep.run(known.clone()));
        Ok(Self(Arc::new(Desk {
            registry: KeyRegistry::new(store.clone()),
            store,
            clock,
            known,
            attempts: Attempts::default(),
            stop,
            upkeep: Mutex::new(Some(upkeep)),
        })))
    }

    /// Whether requests need a key.
    pub fn are_needed(&self) -> bool {
        self.0.known.register.is_closed()
    }

    /// The sender of a request with this key, or without one, from this address.
    ///
    /// # Errors
    /// The key is missing or not in force, or this address has sent too many wrong keys.
    pub fn admit(&self, key: Option<&str>, peer: Option<IpAddr>) -> Result<Pass, KeyError> {
        let error = match self.0.known.register.find(key, self.0.clock.unix_ms()) {
            Ok(pass) => return Ok(pass),
            Err(KeyError::Required) => return Err(KeyError::Required),
            Err(error) => error,
        };
        let counted = peer.map_or(Ok(()), |peer| self.0.attempts.count(peer, Instant::now()));
        if let Err(retry_after) = counted {
            return Err(KeyError::TooManyAttempts { retry_after });
        }
        tracing::info!(code = error.code().name(), ?peer, "{error}");
        Err(error)
    }

    /// The holder of the key with this id; the id is empty if no key is needed.
    ///
    /// # Errors
    /// No key has this id, or it is not in force.
    pub(crate) fn admit_by_id(&self, id: &str) -> Result<Pass, KeyError> {
        let (register, now) = (&self.0.known.register, self.0.clock.unix_ms());
        if id.is_empty() {
            return register.find(None, now);
        }
        let pass = register.of_id(id).ok_or(KeyError::Invalid)?;
        pass.check_at(now)?;
        Ok(pass)
    }

    /// Whether a key has this id, in force or not.
    pub(crate) fn has_id(&self, id: &str) -> bool {
        self.0.known.register.of_id(id).is_some()
    }

    /// Reads what others have changed until now.
    ///
    /// # Errors
    /// The store fails.
    pub(crate) async fn catch_up(&self) -> Result<(), KeyError> {
        Ok(self.0.known.catch_up().await?)
    }

    /// The holder of the key with this text, in force or not; `None` if it never existed.
    pub(crate) fn known(&self, key: &str) -> Option<Pass> {
        self.0.known.register.known(key)
    }

    /// The sender of a request with this cookie. For a change, the sign-in's token is also checked.
    ///
    /// # Errors
    /// The sign-in has ended, or the token does not belong to it.
    pub fn admit_cookie(&self, cookie: &str, token: CsrfToken<'_>) -> Result<Pass, KeyError> {
        let register = &self.0.known.register;
        if !register.is_closed() {
            return register.find(None, self.0.clock.unix_ms());
        }
        let sign_in = self.signed_in(cookie).ok_or(KeyError::SignInEnded)?;
        match token {
            CsrfToken::NotNeeded => Ok(sign_in.pass),
            CsrfToken::Given(token) if token == sign_in.csrf_token => Ok(sign_in.pass),
            CsrfToken::Given(_) => Err(KeyError::CsrfTokenInvalid),
        }
    }

    /// Signs a browser in by a key. Also returns the value of its cookie.
    ///
    /// # Errors
    /// There is no key, the system has no random bits, or the store fails.
    pub async fn sign_in(&self, pass: Pass) -> Result<(Secret, SignIn), KeyError> {
        let Desk { store, known, clock, .. } = &*self.0;
        let key = pass.key().ok_or(KeyError::Required)?;
        let (cookie, now) = (Secret::random()?, clock.unix_ms());
        let hash = secret::hash(cookie.text()).expect("a secret has the form of one");
        let (ended, expires_unix_ms) =
            (known.sign_ins.make_room(pass.tenant(), now), now + LIFETIME_MS);
        store.begin_sign_in((&hash, key), expires_unix_ms, &ended, now).await?;
        known.refresh().await?;
        let csrf_token = csrf_token(cookie.text());
        Ok((cookie, SignIn { pass, csrf_token, expires_unix_ms }))
    }

    /// The sign-in of a cookie, while it and its key are in force.
    pub fn signed_in(&self, cookie: &str) -> Option<SignIn> {
        self.0.known.sign_ins.find(cookie, self.0.clock.unix_ms())
    }

    /// Signs out.
    ///
    /// # Errors
    /// The store fails: other nodes still accept the cookie.
    pub async fn sign_out(&self, cookie: &str) -> Result<(), KeyError> {
        let Some(hash) = secret::hash(cookie) else { return Ok(()) };
        self.0.known.sign_ins.end(&hash);
        Ok(self.0.store.end_sign_in(&hash, self.0.clock.unix_ms()).await?)
    }

    /// Creates a key, in force at once, as an act of `author`.
    ///
    /// # Errors
    /// It has no right, its label is too long, the limit of keys is reached, or the store fails.
    pub async fn create(&self, new: NewKey, author: &Author) -> Result<Created, KeyError> {
        let created = self.0.registry.create(new, author).await?;
        self.0.known.refresh().await?;
        Ok(created)
    }

    /// A page of the keys of a tenant, the newest first.
    ///
    /// # Errors
    /// The page token or size is invalid, or the store fails.
    pub async fn list(
        &self,
        tenant: &Tenant,
        page_size: usize,
        page_token: Option<&str>,
    ) -> Result<Page<KeyInfo>, KeyError> {
        self.0.registry.list(Some(tenant), page_size, page_token).await
    }

    /// A key of a tenant, or of any.
    ///
    /// # Errors
    /// No key of the tenant has this id, or the store fails.
    pub async fn get(&self, tenant: Option<&Tenant>, id: &str) -> Result<KeyInfo, KeyError> {
        self.0.registry.get(tenant, id).await
    }

    /// Revokes a key of a tenant, or of any, at once, as an act of `author`.
    ///
    /// # Errors
    /// No key of the tenant has this id, or the store fails.
    pub async fn revoke(
        &self,
        tenant: Option<&Tenant>,
        id: &str,
        author: &Author,
    ) -> Result<KeyInfo, KeyError> {
        let revoked = self.0.registry.revoke(tenant, id, author).await?;
        self.0.known.refresh().await?;
        Ok(revoked)
    }

    /// Stores the last uses and stops following changes. After this the desk no longer uses the
    /// store on its own.
    pub(crate) async fn close(&self) {
        self.0.stop.send_replace(true);
        if let Some(upkeep) = self.0.upkeep.lock().await.take() {
            // Err: it panicked, so it has ended, too.
            upkeep.await.ok();
        }
    }
}

impl fmt::Debug for Keys {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Keys").field("are_needed", &self.are_needed()).finish_non_exhaustive()
    }
}
