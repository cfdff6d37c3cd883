//! API keys: which calls a sender may make.
//!
//! A key has an id, which is public; a secret, which is shown once; rights; and an end: it expires
//! or is revoked. The database contains the secret's hash. [`Keys`] has all keys in memory, so that
//! a call costs one hash and one lookup. It reads changed keys every 0.4 s. So a change by the
//! command line is in force within a second, even for open streams.
//!
//! A browser exchanges a key for a cookie ([`SignIn`]). Sign-ins are read in the same way as keys.
//!
//! While the database has no key, everybody who reaches the service has all rights. Revoked and
//! expired keys count as keys: their end does not open the service again.

mod attempts;
mod desk;
mod error;
mod known;
mod register;
mod registry;
mod right;
mod secret;
mod sign_ins;
mod upkeep;

pub use desk::{CsrfToken, Keys};
pub use error::KeyError;
pub use register::Pass;
pub use registry::{Created, KeyInfo, KeyRegistry, NewKey};
pub use right::{Right, Rights};
pub use secret::Secret;
pub use sign_ins::SignIn;

/// The kind of [`KeyId`].
#[derive(Debug)]
pub struct OfKey;

impl crate::id::Kind for OfKey {
    const PREFIX: &str = "key_";
}

/// Public id of a key.
pub type KeyId = crate::id::Id<OfKey>;
