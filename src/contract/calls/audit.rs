//! The audit log.

use std::mem;

use crate::contract::{Caller, Refusal, texts, v1};
use crate::store::{AuditEntry, AuditFilter};

use super::paging::{Pages, Reading};
use super::{oldest_first, page_size, timestamp, unix_ms, utc};

/// Entries on a page if the request gives no size.
const PAGE: usize = 100;
/// Most entries on a page.
const PAGE_LIMIT: usize = 1000;
/// Memory of an entry, its message and its JSON (bytes).
const ENTRY_BYTES: usize = 8 << 10;

/// A page of entries: those of the caller's tenant; for the operator, those of all tenants.
///
/// # Errors
/// The page token, the page size or the filter is invalid, the filter names another tenant and the
/// caller is not the operator, or the store fails.
pub async fn list(
    caller: &Caller,
    mut request: v1::ListAuditRequest,
) -> Result<v1::ListAuditResponse, Refusal> {
    let size = page_size(mem::take(&mut request.page_size), PAGE);
    let token = mem::take(&mut request.page_token);
    let pages = Pages::of("Audit/List", &request, &token)?;
    let filter = filter(caller, request)?;
    let mut reading = Reading::of(&pages, (size, PAGE_LIMIT), ENTRY_BYTES)?;
    while let Some(count) = reading.batch()? {
        let page = caller.audit(filter.clone(), count, reading.after()).await?;
        reading.add(page.items.into_iter().map(message), page.next_page_token);
    }
    let (entries, next) = reading.end();
    Ok(v1::ListAuditResponse { entries, next_page_token: pages.token(next) })
}

/// Which entries a list has.
fn filter(caller: &Caller, request: v1::ListAuditRequest) -> Result<AuditFilter, Refusal> {
    let v1::ListAuditRequest { tenant, actor, call, object, from_utc, to_utc, .. } = request;
    texts::check_names([("actor", &*actor), ("call", &*call), ("object", &*object)])?;
    let is_named = !tenant.is_empty();
    let tenant = super::keys::tenant(caller, &tenant)?;
    let time = |field: &str, text: &str, otherwise: i64| match text {
        "" => Ok(otherwise),
        text => unix_ms(field, text),
    };
    Ok(AuditFilter {
        tenant: is_named.then_some(tenant),
        actor,
        call,
        object,
        is_refused: request.refused,
        span: time("fromUtc", &from_utc, i64::MIN)?..time("toUtc", &to_utc, i64::MAX)?,
        oldest_first: oldest_first(request.order)?,
        ..AuditFilter::all()
    })
}

fn message(entry: AuditEntry) -> v1::AuditEntry {
    let AuditEntry { id, unix_ms, tenant, author, call, object, outcome, change } = entry;
    v1::AuditEntry {
        entry: id,
        created_utc: utc(unix_ms),
        tenant: tenant.to_string(),
        actor: author.actor,
        call,
        object,
        outcome,
        request: author.request,
        node: author.node,
        change,
        create_time: timestamp(unix_ms),
    }
}
