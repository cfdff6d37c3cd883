//! API keys of the caller's tenant; for the operator, those of all tenants.

use std::mem;

use crate::contract::{Caller, Refusal, texts, v1};
use crate::keys::{Created, KeyInfo, NewKey, Rights};
use crate::refusal::Code;
use crate::tenant::Tenant;

use super::paging::{Pages, Reading};
use super::{page_size, timestamp, utc};

/// Keys on a page if the request gives no size.
const PAGE: usize = 100;
/// Most keys on a page.
const PAGE_LIMIT: usize = 1000;
/// Memory of a key, its message and its JSON (bytes).
const KEY_BYTES: usize = 4 << 10;
/// Longest time for which a key is in force (s): a century.
const LIFETIME_MAX_S: u64 = 3_153_600_000;

/// Creates a key.
///
/// # Errors
/// A right is unknown, the label or the lifetime is too long, the tenant is another one and the
/// caller is not the operator, the limit of keys is reached, or the store fails.
pub async fn create(
    caller: &Caller,
    request: v1::CreateKeyRequest,
) -> Result<v1::CreateKeyResponse, Refusal> {
    caller.noted("Keys.Create", "", created(caller, request).await).await
}

async fn created(
    caller: &Caller,
    request: v1::CreateKeyRequest,
) -> Result<v1::CreateKeyResponse, Refusal> {
    texts::check_label(&request.label)?;
    let new = NewKey {
        tenant: tenant(caller, &request.tenant)?,
        rights: Rights::named(&request.rights)?,
        label: request.label,
        lifetime_ms: request.lifetime_s.map(lifetime_ms).transpose()?,
    };
    let Created { key, secret } = caller.keys().create(new, &caller.author()).await?;
    let (id, tenant, rights) = (&key.id, &key.tenant, key.rights);
    tracing::info!(key = id, %tenant, %rights, by = caller.key(), "a key is created");
    Ok(v1::CreateKeyResponse { key: Some(message(key)), secret: secret.text().to_owned() })
}

/// A page of keys, the newest first.
///
/// # Errors
/// The page token or size is invalid, the tenant is another one and the caller is not the operator,
/// or the store fails.
pub async fn list(
    caller: &Caller,
    mut request: v1::ListKeysRequest,
) -> Result<v1::ListKeysResponse, Refusal> {
    let size = page_size(mem::take(&mut request.page_size), PAGE);
    let token = mem::take(&mut request.page_token);
    let tenant = tenant(caller, &request.tenant)?;
    let pages = Pages::of("Keys/List", &request, &token)?;
    let mut reading = Reading::of(&pages, (size, PAGE_LIMIT), KEY_BYTES)?;
    while let Some(count) = reading.batch()? {
        let page = caller.keys().list(&tenant, count, reading.after()).await?;
        reading.add(page.items.into_iter().map(message), page.next_page_token);
    }
    let (keys, next) = reading.end();
    Ok(v1::ListKeysResponse { keys, next_page_token: pages.token(next) })
}

/// A key, even if it is revoked or has expired. The operator finds keys of every tenant.
///
/// # Errors
/// The tenant has no such key, or the store fails.
pub async fn get(caller: &Caller, request: v1::GetKeyRequest) -> Result<v1::Key, Refusal> {
    texts::check("key", &request.key, texts::NAME_MAX)?;
    let key = caller.keys().get(visible_tenant(caller), &request.key).await?;
    Ok(message(key))
}

/// Revokes a key.
///
/// # Errors
/// The tenant has no such key, or the store fails.
pub async fn revoke(caller: &Caller, request: v1::RevokeKeyRequest) -> Result<v1::Key, Refusal> {
    caller.noted("Keys.Revoke", &request.key, revoked(caller, &request).await).await
}

async fn revoked(caller: &Caller, request: &v1::RevokeKeyRequest) -> Result<v1::Key, Refusal> {
    texts::check("key", &request.key, texts::NAME_MAX)?;
    let tenant = visible_tenant(caller);
    let key = caller.keys().revoke(tenant, &request.key, &caller.author()).await?;
    tracing::info!(key = key.id, tenant = %key.tenant, by = caller.key(), "a key is revoked");
    Ok(message(key))
}

/// The tenant in which the caller finds keys by their ids; `None` for the operator: all tenants.
fn visible_tenant(caller: &Caller) -> Option<&Tenant> {
    Some(caller.tenant()).filter(|tenant| !tenant.is_operator())
}

/// The tenant with this name; the caller's tenant if the name is empty.
///
/// # Errors
/// The text is not the name of a tenant; or it names another tenant, and the caller is not the
/// operator.
pub(super) fn tenant(caller: &Caller, name: &str) -> Result<Tenant, Refusal> {
    if name.is_empty() || name == caller.tenant().name() {
        return Ok(caller.tenant().clone());
    }
    caller.check_operator().map_err(|refusal| refusal.at("tenant"))?;
    Tenant::parse(name).ok_or_else(|| {
        let message = format!(
            "{:?} is not a name of 1 to 63 lower-case letters, digits, - and _",
            texts::brief(name)
        );
        Refusal::new(Code::InvalidField, message).at("tenant")
    })
}

fn lifetime_ms(seconds: u64) -> Result<i64, Refusal> {
    if (1..=LIFETIME_MAX_S).contains(&seconds) {
        return Ok(seconds as i64 * 1000);
    }
    let message = format!("{seconds} s is not from 1 to {LIFETIME_MAX_S}");
    Err(Refusal::new(Code::InvalidField, message).at("lifetimeS"))
}

fn message(key: KeyInfo) -> v1::Key {
    v1::Key {
        key: key.id,
        label: key.label,
        tenant: key.tenant.to_string(),
        rights: key.rights.names().into_iter().map(ToOwned::to_owned).collect(),
        created_utc: utc(key.created_unix_ms),
        expires_utc: key.expires_unix_ms.map(utc),
        revoked_utc: key.revoked_unix_ms.map(utc),
        last_used_utc: key.last_used_unix_ms.map(utc),
        create_time: timestamp(key.created_unix_ms),
        expire_time: key.expires_unix_ms.and_then(timestamp),
        revoke_time: key.revoked_unix_ms.and_then(timestamp),
        last_use_time: key.last_used_unix_ms.and_then(timestamp),
    }
}
