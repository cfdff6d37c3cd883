//! API keys: who may call what.
//!
//! A key has an id, which is public, a secret, which is shown once, rights, and an end: it expires
//! or is revoked. The database has the secret's hash. [`Keys`] has all keys in memory, so that a
//! call costs a hash and a look into a table, and reads changed ones every 0.4 s: what an operator
//! changes by the command line is in force within a second, in open streams too.
//!
//! A browser exchanges a key for a cookie ([`SignIn`]). Sign-ins are read as keys are.
//!
//! As long as the database has no key, everybody who reaches the service has all rights. Revoked
//! and expired keys count: their end opens nothing.

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
