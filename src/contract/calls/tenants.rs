//! Tenants: their quotas and their use.

use std::mem;

use crate::contract::{Caller, Refusal, texts, v1};
use crate::quotas::{QuotaError, TenantInfo};
use crate::refusal::Code;
use crate::tenant::{Quotas, Tenant};

use super::paging::{Pages, Reading};
use super::{page_size, timestamp, utc};

/// Tenants on a page if the request gives no size.
const PAGE: usize = 100;
/// Most tenants on a page.
const PAGE_LIMIT: usize = 1000;
/// Memory of a tenant, its message and its JSON (bytes).
const TENANT_BYTES: usize = 8 << 10;

/// A tenant.
///
/// # Errors
/// It does not exist; or it is another tenant, and the caller is not the operator; or the store
/// fails.
pub async fn get(caller: &Caller, request: v1::GetTenantRequest) -> Result<v1::Tenant, Refusal> {
    let name = request.tenant;
    let sees = |tenant: &Tenant| tenant == caller.tenant() || caller.tenant().is_operator();
    let tenant = Tenant::parse(&name).filter(sees).ok_or_else(|| {
        let name = texts::brief(&name).to_owned();
        Refusal::from(QuotaError::NotFound { name })
    })?;
    Ok(message(caller.quotas().get(&tenant).await?))
}

/// A page of tenants in order of their names: all, or the caller's.
///
/// # Errors
/// The page token or size is invalid, or the store fails.
pub async fn list(
    caller: &Caller,
    mut request: v1::ListTenantsRequest,
) -> Result<v1::ListTenantsResponse, Refusal> {
    let size = page_size(mem::take(&mut request.page_size), PAGE);
    let token = mem::take(&mut request.page_token);
    let pages = Pages::of("Tenants/List", &request, &token)?;
    let mut reading = Reading::of(&pages, (size, PAGE_LIMIT), TENANT_BYTES)?;
    while let Some(count) = reading.batch()? {
        let after = reading.after().unwrap_or_default();
        let mut tenants = match caller.tenant().is_operator() {
            true => caller.quotas().list(after, count + 1).await?,
            false if caller.tenant().name() <= after => Vec::new(),
            false => vec![caller.quotas().get(caller.tenant()).await?],
        };
        let more = count < tenants.len();
        tenants.truncate(count);
        let last = tenants.last().filter(|_| more);
        let next = last.map(|last| last.tenant.to_string());
        reading.add(tenants.into_iter().map(message), next);
    }
    let (tenants, next) = reading.end();
    Ok(v1::ListTenantsResponse { tenants, next_page_token: pages.token(next) })
}

/// Sets the quotas of a tenant.
///
/// # Errors
/// The caller is not the operator, the name or a quota is invalid, or the store fails.
pub async fn set(caller: &Caller, request: v1::SetTenantRequest) -> Result<v1::Tenant, Refusal> {
    let name = request.tenant.clone();
    caller.noted("Tenants.Set", &name, done(caller, request).await).await
}

async fn done(caller: &Caller, request: v1::SetTenantRequest) -> Result<v1::Tenant, Refusal> {
    caller.check_operator()?;
    let tenant = super::keys::tenant(caller, &request.tenant)?;
    let quotas = quotas(request.quotas.unwrap_or_default())?;
    let etag = Some(&*request.etag).filter(|etag| !etag.is_empty());
    let info = caller.quotas().set(&tenant, &quotas, etag, &caller.author()).await?;
    tracing::info!(%tenant, ?quotas, by = caller.key(), "the quotas of a tenant are set");
    Ok(message(info))
}

/// Reads and checks quotas.
fn quotas(message: v1::TenantQuotas) -> Result<Quotas, Refusal> {
    let v1::TenantQuotas { sessions, epochs_per_s, cpu_s_per_minute, stored_bytes, job_bytes } =
        message;
    let refused = |field: &str, value: &dyn std::fmt::Display| {
        let message = format!("{value} is not a quota: a number from 0 to 9e15");
        Err(Refusal::new(Code::InvalidField, message).at(format!("quotas.{field}")))
    };
    let counts = [("sessions", sessions), ("storedBytes", stored_bytes), ("jobBytes", job_bytes)];
    for (field, value) in counts {
        if let Some(value) = value.filter(|value| MOST < *value as f64) {
            return refused(field, &value);
        }
    }
    for (field, value) in [("epochsPerS", epochs_per_s), ("cpuSPerMinute", cpu_s_per_minute)] {
        if let Some(value) = value.filter(|value| !(0.0..=MOST).contains(value)) {
            return refused(field, &value);
        }
    }
    Ok(Quotas { sessions, epochs_per_s, cpu_s_per_minute, stored_bytes, job_bytes })
}

/// Largest quota, which JSON represents exactly.
const MOST: f64 = 9e15;

fn message(info: TenantInfo) -> v1::Tenant {
    let TenantInfo { tenant, created_unix_ms, quotas, rates, stored } = info;
    let etag = quotas.etag();
    let Quotas { sessions, epochs_per_s, cpu_s_per_minute, stored_bytes, job_bytes } = quotas;
    let quotas =
        v1::TenantQuotas { sessions, epochs_per_s, cpu_s_per_minute, stored_bytes, job_bytes };
    v1::Tenant {
        tenant: tenant.to_string(),
        created_utc: utc(created_unix_ms),
        quotas: Some(quotas),
        used: stored.map(|stored| v1::TenantUse {
            sessions: stored.of_sessions.sessions,
            epochs_per_s: rates.epochs_per_s,
            cpu_s_per_minute: rates.cpu_s_per_minute,
            stored_bytes: stored.of_sessions.stored_bytes,
            job_bytes: stored.job_bytes,
        }),
        etag,
        create_time: timestamp(created_unix_ms),
    }
}
