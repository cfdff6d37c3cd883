//! Changes of keys in the store. The service and the command line make them here, even at the same
//! time.

use crate::clock::{Clock, MS_PER_DAY};
use crate::store::{Act, Author, KeyRow, NewKeyRow, Page, Store};
use crate::tenant::Tenant;

use super::{KeyError, KeyId, Rights, Secret, secret};

/// Most keys in force in one database. Each service has them in memory.
const KEYS: i64 = 65_536;
/// Most keys that a tenant creates within a day. Rows of keys that have ended are kept for long.
const CREATED: i64 = 10_000;
/// Most characters of a label.
const LABEL: usize = 200;

/// A key to create.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NewKey {
    /// Tenant that owns the key.
    pub tenant: Tenant,
    /// Its rights.
    pub rights: Rights,
    /// A name for people.
    pub label: String,
    /// Time for which it is in force (ms); `None` until it is revoked.
    pub lifetime_ms: Option<i64>,
}

/// A key as people see it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct KeyInfo {
    /// Public id.
    pub id: String,
    /// Tenant that owns the key.
    pub tenant: Tenant,
    /// Its rights.
    pub rights: Rights,
    /// A name for people.
    pub label: String,
    /// When it was created (ms since 1970-01-01 UTC).
    pub created_unix_ms: i64,
    /// When it expires (ms since 1970-01-01 UTC); `None` for never.
    pub expires_unix_ms: Option<i64>,
    /// When it was revoked (ms since 1970-01-01 UTC).
    pub revoked_unix_ms: Option<i64>,
    /// When it was last used (ms since 1970-01-01 UTC); written once a minute at most.
    pub last_used_unix_ms: Option<i64>,
}

/// A new key with its secret, which nobody can read again.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Created {
    /// The key.
    pub key: KeyInfo,
    /// Its secret.
    pub secret: Secret,
}

/// The keys in a store.
#[derive(Clone, Debug)]
pub struct KeyRegistry {
    store: Store,
    clock: Clock,
    /// Most keys that may be in force.
    most: i64,
    /// Most keys that a tenant may create within a day.
    most_created: i64,
}

impl KeyRegistry {
    /// The keys in `store`.
    pub const fn new(store: Store) -> Self {
        Self { store, clock: Clock::system(), most: KEYS, most_created: CREATED }
    }

    /// Creates a key, as an act of `author`.
    ///
    /// # Errors
    /// It has no right, its label is too long, a limit of keys is reached, or the store fails.
    pub async fn create(&self, new: NewKey, author: &Author) -> Result<Created, KeyError> {
        self.insert(new, None, author).await
    }

    /// Creates a key that replaces another one, with the same tenant, rights and label. The other
    /// key expires after `overlap_ms`, or at its own expiry if that is sooner.
    ///
    /// # Errors
    /// No key has this id, it has ended, or the store fails.
    pub async fn rotate(
        &self,
        id: &str,
        lifetime_ms: Option<i64>,
        overlap_ms: i64,
        author: &Author,
    ) -> Result<Created, KeyError> {
        let earlier = self.get(None, id).await?;
        let now = self.clock.unix_ms();
        let has_expired = earlier.expires_unix_ms.is_some_and(|expires| expires <= now);
        if has_expired || earlier.revoked_unix_ms.is_some() {
            return Err(KeyError::Ended { id: earlier.id });
        }
        let KeyInfo { id, tenant, rights, label, .. } = earlier;
        let new = NewKey { tenant, rights, label, lifetime_ms };
        self.insert(new, Some((&id, now.saturating_add(overlap_ms))), author).await
    }

    async fn insert(
        &self,
        new: NewKey,
        replaces: Option<(&str, i64)>,
        author: &Author,
    ) -> Result<Created, KeyError> {
        let NewKey { tenant, rights, label, lifetime_ms } = new;
        if rights == Rights::NONE {
            return Err(KeyError::NoRights);
        }
        if let Some(at) = label.chars().position(char::is_control) {
            return Err(KeyError::LabelControl { at: at + 1 });
        }
        let characters = label.chars().count();
        if LABEL < characters {
            return Err(KeyError::LabelTooLong { characters, limit: LABEL });
        }
        let created_unix_ms = self.clock.unix_ms();
        if self.most <= self.store.count_keys(created_unix_ms).await? {
            return Err(KeyError::TooMany { limit: self.most });
        }
        let limit = self.most_created;
        let day_before = created_unix_ms - MS_PER_DAY;
        if limit <= self.store.count_created_keys(&tenant, day_before).await? {
            return Err(KeyError::TooManyCreated { tenant: tenant.to_string(), limit });
        }
        let secret = Secret::random()?;
        let row = NewKeyRow {
            id: KeyId::random().to_string(),
            tenant,
            rights: rights.to_string(),
            label,
            secret_sha256: secret::hash(secret.text()).expect("a secret has the form of one"),
            created_unix_ms,
            expires_unix_ms: lifetime_ms.map(|ms| created_unix_ms.saturating_add(ms)),
        };
        let call = if replaces.is_some() { "Keys.Rotate" } else { "Keys.Create" };
        let change = described(&row, replaces.map(|(earlier, _)| earlier));
        let act = Act { call, tenant: &row.tenant, object: &row.id, change };
        self.store.create_key(&row, replaces, &author.does(act, created_unix_ms)).await?;
        let (revoked_unix_ms, last_used_unix_ms, changed) = (None, None, 0);
        let row = KeyRow { key: row, revoked_unix_ms, last_used_unix_ms, changed };
        Ok(Created { key: info(row), secret })
    }

    /// A key of a tenant, or of any.
    ///
    /// # Errors
    /// No key of the tenant has this id, or the store fails.
    pub async fn get(&self, tenant: Option<&Tenant>, id: &str) -> Result<KeyInfo, KeyError> {
        let not_found = || KeyError::NotFound { id: id.to_owned() };
        let id = KeyId::parse(id).ok_or_else(not_found)?;
        let found = self.store.key(id.as_str()).await?.map(info);
        let found = found.filter(|key| tenant.is_none_or(|tenant| key.tenant == *tenant));
        found.ok_or_else(not_found)
    }

    /// A page of the keys of a tenant, or of all, the newest first.
    ///
    /// # Errors
    /// The page token or size is invalid, or the store fails.
    pub async fn list(
        &self,
        tenant: Option<&Tenant>,
        page_size: usize,
        page_token: Option<&str>,
    ) -> Result<Page<KeyInfo>, KeyError> {
        let page = self.store.keys(tenant, page_size, page_token).await?;
        page.try_map(|row| Ok(info(row)))
    }

    /// Revokes a key of a tenant, or of any tenant, as an act of `author`. A revoked key stays
    /// unchanged.
    ///
    /// # Errors
    /// No key of the tenant has this id, or the store fails.
    pub async fn revoke(
        &self,
        tenant: Option<&Tenant>,
        id: &str,
        author: &Author,
    ) -> Result<KeyInfo, KeyError> {
        let key = self.get(tenant, id).await?;
        let (now, change) = (self.clock.unix_ms(), format!("label {:?}", key.label));
        let act = Act { call: "Keys.Revoke", tenant: &key.tenant, object: &key.id, change };
        self.store.revoke_key(&key.id, now, &author.does(act, now)).await?;
        self.get(tenant, &key.id).await
    }
}

/// A new key as text for the audit log.
fn described(new: &NewKeyRow, replaces: Option<&str>) -> String {
    let end = match new.expires_unix_ms {
        Some(ms) => format!("for {} s", (ms - new.created_unix_ms) / 1000),
        None => "until it is revoked".to_owned(),
    };
    let earlier = replaces.map_or_else(String::new, |key| format!(", in place of {key}"));
    format!("rights {}, label {:?}, {end}{earlier}", new.rights, new.label)
}

fn info(row: KeyRow) -> KeyInfo {
    let KeyRow { key, revoked_unix_ms, last_used_unix_ms, .. } = row;
    let NewKeyRow { id, tenant, label, created_unix_ms, expires_unix_ms, .. } = key;
    let rights = Rights::stored(&key.rights);
    KeyInfo {
        id,
        tenant,
        rights,
        label,
        created_unix_ms,
        expires_unix_ms,
        revoked_unix_ms,
        last_used_unix_ms,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::keys::Right;
    use crate::refusal::Code;

    /// A registry of a new database in `folder`, at a time of its own.
    async fn registry(folder: &tempfile::TempDir) -> KeyRegistry {
        let url = format!("sqlite://{}", folder.path().join("keys.db").display());
        let store = Store::open(&url).await.unwrap();
        KeyRegistry { store, clock: Clock::at(1_000_000), most: 2, most_created: 6 }
    }

    fn author() -> Author {
        let (actor, tenant) = ("key_1".to_owned(), Tenant::operator());
        Author { actor, tenant, request: String::new(), node: "here".to_owned() }
    }

    fn new(lifetime_ms: Option<i64>) -> NewKey {
        let (tenant, label) = (Tenant::operator(), "rover".to_owned());
        NewKey { tenant, rights: Rights::of(&[Right::Device]), label, lifetime_ms }
    }

    /// A list of keys has one line for each.
    #[tokio::test]
    async fn a_label_is_one_line() {
        let folder = tempfile::tempdir().unwrap();
        let keys = registry(&folder).await;
        let two_lines = NewKey { label: "rover\nkey_2".to_owned(), ..new(None) };
        let refused = keys.create(two_lines, &author()).await.unwrap_err();
        assert_eq!(refused.to_string(), "character 6 of the label is a control character");
        assert_eq!(refused.code(), Code::InvalidField);
    }

    /// Keys that have ended do not count.
    #[tokio::test]
    async fn the_keys_in_force_are_bounded() {
        let folder = tempfile::tempdir().unwrap();
        let keys = registry(&folder).await;
        let first = keys.create(new(None), &author()).await.unwrap().key;
        keys.create(new(Some(1000)), &author()).await.unwrap();
        let refused = async || keys.create(new(None), &author()).await.unwrap_err().code();
        assert_eq!(refused().await, Code::TooManyKeys);
        keys.clock.set(1_001_000);
        let second = keys.create(new(None), &author()).await.unwrap().key;
        assert_eq!(refused().await, Code::TooManyKeys);
        keys.revoke(None, &first.id, &author()).await.unwrap();
        keys.rotate(&second.id, None, 0, &author()).await.unwrap();
    }

    /// Revoked keys count, so that a tenant cannot fill the database with them. Those of other
    /// tenants do not.
    #[tokio::test]
    async fn the_keys_that_a_tenant_creates_within_a_day_are_bounded() {
        let folder = tempfile::tempdir().unwrap();
        let keys = registry(&folder).await;
        for _ in 0..6 {
            let key = keys.create(new(None), &author()).await.unwrap().key;
            keys.revoke(None, &key.id, &author()).await.unwrap();
        }
        let refused = keys.create(new(None), &author()).await.unwrap_err();
        assert_eq!(refused.code(), Code::TooManyKeys);
        assert!(refused.to_string().contains("within a day"), "{refused}");
        let tenant = Tenant::parse("other").unwrap();
        keys.create(NewKey { tenant, ..new(None) }, &author()).await.unwrap();
        keys.clock.set(1_000_000 + MS_PER_DAY);
        keys.create(new(None), &author()).await.unwrap();
    }

    /// Keys that ended long ago are removed, but never the newest one.
    #[tokio::test]
    async fn ended_keys_are_removed() {
        let folder = tempfile::tempdir().unwrap();
        let keys = registry(&folder).await;
        let lifetimes = [Some(1_000), Some(9_000), Some(500), Some(1_000)];
        for lifetime_ms in lifetimes {
            keys.create(new(lifetime_ms), &author()).await.unwrap();
            keys.clock.set(keys.clock.unix_ms() + 1_000);
        }
        let remove = async || keys.store.remove_keys_ended_before(1_008_000, 1).await.unwrap();
        assert!(remove().await && remove().await && !remove().await);
        let left = keys.list(None, 10, None).await.unwrap().items;
        let lifetime = |key: &KeyInfo| key.expires_unix_ms.map(|ms| ms - key.created_unix_ms);
        let left: Vec<_> = left.iter().rev().map(lifetime).collect();
        assert_eq!(left, [lifetimes[1], lifetimes[3]]);
    }

    /// The replaced key ends after the overlap, or at its own expiry if that is sooner.
    #[tokio::test]
    async fn a_rotated_key_ends_after_the_overlap() {
        let folder = tempfile::tempdir().unwrap();
        let keys = registry(&folder).await;
        let first = keys.create(new(Some(5000)), &author()).await.unwrap().key;
        let second = keys.rotate(&first.id, Some(9000), 7000, &author()).await.unwrap().key;
        assert_eq!((second.rights, &second.label), (first.rights, &first.label));
        assert_eq!(second.expires_unix_ms, Some(1_009_000));
        let expires = async |id: &str| keys.get(None, id).await.unwrap().expires_unix_ms;
        assert_eq!(expires(&first.id).await, Some(1_005_000));
        keys.revoke(None, &first.id, &author()).await.unwrap();
        keys.rotate(&second.id, None, 2000, &author()).await.unwrap();
        assert_eq!(expires(&second.id).await, Some(1_002_000));
    }

    #[tokio::test]
    async fn a_key_of_another_tenant_is_not_found() {
        let folder = tempfile::tempdir().unwrap();
        let keys = registry(&folder).await;
        let key = keys.create(new(None), &author()).await.unwrap().key;
        let (own, other) = (Tenant::operator(), Tenant::parse("other").unwrap());
        let revoked = keys.revoke(Some(&other), &key.id, &author()).await.unwrap_err();
        assert_eq!(revoked.code(), Code::KeyNotFound);
        assert_eq!(keys.get(Some(&own), &key.id).await.unwrap(), key);
        assert!(keys.list(Some(&other), 10, None).await.unwrap().items.is_empty());
        let foreign = keys.list(Some(&other), 10, Some(&key.id)).await.unwrap_err();
        assert_eq!(foreign.code(), Code::PageTokenInvalid);
        assert_eq!(keys.list(Some(&own), 10, None).await.unwrap().items, [key]);
    }
}
