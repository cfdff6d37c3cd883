//! The entries of refused calls in the audit log.
//!
//! The desks write the entry of an act that is done, in the act's transaction. A refused call has
//! no such transaction: its entry is written before the answer.

use std::time::{Duration, Instant};

use tokio::time::timeout;

use crate::clock::unix_ms;
use crate::keys::{Pass, Right, Rights};
use crate::refusal::Class;
use crate::store::{Act, AuditEntry, Author, LOOPBACK, UNKNOWN};
use crate::tenant::Tenant;

use super::access::{Call, Credential, Need, Target};
use super::{Refusal, Service};

/// Longest time that a refusal waits for its entry to be written.
const PATIENCE: Duration = Duration::from_secs(2);
/// Longest id, and longest name of a tenant (characters).
const ID_MAX: usize = 63;

/// The rights of people who administer a service. The acts of a device on its own session are not
/// administrative.
pub(super) const ADMINISTRATIVE: Rights = Rights::of(&[Right::Operate, Right::Admin]);

impl Service {
    /// The entry of a request that is refused because of its key. `None` if the request is not an
    /// administrative act, or if the actor already has too many entries.
    pub(crate) fn refused_request(
        &self,
        target: &Target,
        credential: Credential<'_>,
        refusal: &Refusal,
    ) -> Option<AuditEntry> {
        let Target::Call(call) = target else { return None };
        let known = match credential {
            Credential::None => None,
            Credential::Key(key) => self.keys().known(key),
            Credential::Cookie(cookie, _) => {
                self.keys().signed_in(cookie).map(|sign_in| sign_in.pass)
            }
        };
        let is_for_key = matches!(refusal.code.class(), Class::Unauthenticated | Class::Forbidden);
        if !is_for_key || !is_act_of(call, known.as_ref()) {
            return None;
        }
        let author = match known {
            Some(pass) => author_of(&pass, String::new(), self.node()),
            None => Author {
                actor: UNKNOWN.to_owned(),
                tenant: Tenant::operator(),
                request: String::new(),
                node: self.node().to_owned(),
            },
        };
        self.refused_act(author, call.act?, "", refusal)
    }

    /// The entry of a refused act. `None` for a failure of the service, which is in the log, or if
    /// the actor already has too many entries.
    pub(super) fn refused_act(
        &self,
        author: Author,
        call: &'static str,
        object: &str,
        refusal: &Refusal,
    ) -> Option<AuditEntry> {
        let class = refusal.code.class();
        if matches!(class, Class::Internal | Class::Unavailable) {
            return None;
        }
        let left_out = self.refused_acts().count(&author.actor, Instant::now())?;
        let change = match left_out {
            0 => String::new(),
            count => format!("{count} refused calls before this one have no entry"),
        };
        let tenant = author.tenant.clone();
        let act = Act { call, tenant: &tenant, object: own_object(class, object), change };
        Some(author.is_refused(act, refusal.code, unix_ms()))
    }

    /// Writes the entry of a refused call, if there is one. The call is refused even if this fails.
    pub(crate) async fn note_refused(&self, entry: Option<AuditEntry>) {
        let Some(entry) = entry else { return };
        let noted = timeout(PATIENCE, self.sessions().store().note(&entry)).await;
        let why = match noted {
            Ok(Ok(())) => return,
            Ok(Err(error)) => error.to_string(),
            Err(_) => "the database is slow".to_owned(),
        };
        let AuditEntry { call, outcome, author, .. } = entry;
        let actor = author.actor;
        tracing::error!(why, call, outcome, actor, "a refused call is not in the audit log");
    }
}

/// Whether a call is an administrative act when the holder of this key sends it.
fn is_act_of(call: &Call, known: Option<&Pass>) -> bool {
    let is_of_devices = match call.need {
        Need::OneOf(rights) => rights.meets(Rights::of(&[Right::Device])),
        _ => false,
    };
    let administers = known.is_some_and(|pass| pass.rights().meets(ADMINISTRATIVE));
    call.act.is_some() && (administers || !is_of_devices)
}

/// The holder of a key as the author of an act; without a key, the loopback actor.
pub(super) fn author_of(pass: &Pass, request: String, node: &str) -> Author {
    let actor = pass.key().unwrap_or(LOOPBACK).to_owned();
    Author { actor, tenant: pass.tenant().clone(), request, node: node.to_owned() }
}

/// The object of a refused act, unless the object does not exist or belongs to another tenant. In
/// that case the text may be anything, even a secret.
fn own_object(class: Class, object: &str) -> &str {
    let is_plain = |byte: u8| byte.is_ascii_alphanumeric() || byte == b'_' || byte == b'-';
    let is_own = !matches!(class, Class::NotFound | Class::Forbidden);
    let is_id = object.len() <= ID_MAX && object.bytes().all(is_plain);
    if is_own && is_id { object } else { "" }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_an_own_object_is_named() {
        let id = format!("bas_{}", "0".repeat(32));
        assert_eq!(own_object(Class::Precondition, &id), id);
        assert_eq!(own_object(Class::NotFound, &id), "");
        assert_eq!(own_object(Class::Forbidden, &id), "");
        let secret = format!("gfx_{}", "0".repeat(64));
        assert_eq!(own_object(Class::Malformed, &secret), "");
        assert_eq!(own_object(Class::Malformed, "a\u{1b}[31m"), "");
    }
}
