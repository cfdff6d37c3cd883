//! Sign-ins of browsers, as the REST door shows them. gRPC has none.

use crate::keys::{KeyError, SignIn};

use super::calls::utc;
use super::{Lease, Refusal, Service};

/// A browser that is signed in.
#[derive(Debug)]
pub(crate) struct SignedIn {
    /// Id of the key.
    pub(crate) key: String,
    /// Rights of the key.
    pub(crate) rights: Vec<String>,
    /// Token for changes.
    pub(crate) csrf_token: String,
    /// When the sign-in ends, in RFC 3339.
    pub(crate) expires_utc: String,
}

impl Service {
    /// Signs in the browser that has sent this request with a key. Also returns the value of its
    /// cookie. `None` if no key is needed. `has_key` is `false` for a request with a cookie only:
    /// who has a cookie, perhaps a stolen one, must not make another sign-in with it.
    ///
    /// # Errors
    /// The request has no key, the system has no random bits, or the store fails.
    pub(crate) async fn sign_in(
        &self,
        has_key: bool,
    ) -> Result<Option<(String, SignedIn)>, Refusal> {
        if self.keys().are_needed() && !has_key {
            return Err(KeyError::Required.into());
        }
        let lease = Lease::current();
        let pass = lease.as_ref().and_then(Lease::pass).filter(|pass| pass.key().is_some());
        let Some(pass) = pass else { return Ok(None) };
        let (cookie, sign_in) = self.keys().sign_in(pass.clone()).await?;
        tracing::info!(key = pass.key(), "a browser signs in");
        Ok(Some((cookie.text().to_owned(), signed_in(sign_in))))
    }

    /// Signs the browser with this cookie out.
    ///
    /// # Errors
    /// The store fails.
    pub(crate) async fn sign_out(&self, cookie: &str) -> Result<(), Refusal> {
        Ok(self.keys().sign_out(cookie).await?)
    }

    /// The sign-in of a cookie; `None` if it has ended.
    pub(crate) fn signed_in(&self, cookie: &str) -> Option<SignedIn> {
        self.keys().signed_in(cookie).map(signed_in)
    }
}

fn signed_in(sign_in: SignIn) -> SignedIn {
    let SignIn { pass, csrf_token, expires_unix_ms } = sign_in;
    SignedIn {
        key: pass.key().unwrap_or_default().to_owned(),
        rights: pass.rights().names().into_iter().map(ToOwned::to_owned).collect(),
        csrf_token,
        expires_utc: utc(expires_unix_ms),
    }
}
