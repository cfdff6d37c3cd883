//! The log of failures: one line each, with the request that failed.

use super::{Lease, Refusal};

/// Writes a failure of the service to the log, with the request, the tenant and the session as far
/// as they are known, and counts it. Each line begins with the node.
pub(crate) fn log_failure(refusal: &Refusal, what: &str) {
    let lease = Lease::current();
    let lease = lease.as_ref();
    let request = lease.map(|lease| tracing::field::display(lease.request_id()));
    let tenant = lease.and_then(|lease| lease.pass()).map(|pass| pass.tenant().name());
    let session = lease.and_then(|lease| lease.session());
    lease.into_iter().for_each(Lease::count_failure);
    let code = refusal.code.name();
    tracing::error!(code, request, tenant, session, "{what}{}", refusal.logged());
}
