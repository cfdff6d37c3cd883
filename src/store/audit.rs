//! The audit log: an entry for each administrative act, done or refused.
//!
//! The entry of an act is written in the act's transaction, so that neither is stored without the
//! other. An act with several transactions has its entry after the last of them. Entries are added,
//! and removed once they are old. No statement of this program changes an entry, and a trigger of
//! the database refuses any statement that does.

use crate::id::{Id, Kind};
use crate::refusal::Code;
use crate::tenant::Tenant;

use super::page::rows_asked;
use super::pool::{reading, writing};
use super::{Page, Store, StoreError};

/// Actor of a call without a key, while the service needs no key.
pub const LOOPBACK: &str = "loopback";
/// Actor of a command that changes the database directly.
pub const COMMAND_LINE: &str = "command-line";
/// Actor of a call without a key, or with a key that never existed.
pub const UNKNOWN: &str = "unknown";
/// Actor under which other tenants see the operator's acts.
pub const BY_OPERATOR: &str = "operator";
/// Outcome of an act that was done. The outcome of a refused act is the code of the refusal.
pub const DONE: &str = "DONE";

const PAGE_LIMIT: usize = 1_000;
/// Longest text about a change (characters).
const CHANGE_MAX: usize = 400;

pub(super) const INSERT: &str = "INSERT INTO audit_entries (id, unix_ms, tenant, actor, \
    actor_tenant, call, object, outcome, request, node, change) \
    VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9, $10, $11)";
const REMOVE: &str = "DELETE FROM audit_entries WHERE key IN \
    (SELECT key FROM audit_entries WHERE unix_ms < $1 ORDER BY unix_ms LIMIT $2)";

/// The kind of an entry's id.
struct OfEntry;

impl Kind for OfEntry {
    const PREFIX: &str = "aud_";
}

/// Who acts, and from where.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Author {
    /// Id of a key, [`LOOPBACK`], [`COMMAND_LINE`] or [`UNKNOWN`].
    pub actor: String,
    /// Tenant of the actor.
    pub tenant: Tenant,
    /// Id of the request; empty without one.
    pub request: String,
    /// Name of the node, or of the command's host.
    pub node: String,
}

/// What is done, apart from who does it and when.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Act<'a> {
    /// The call, such as `Keys.Create`.
    pub call: &'static str,
    /// Tenant that owns the object.
    pub tenant: &'a Tenant,
    /// Id of what is changed; empty if it has no id.
    pub object: &'a str,
    /// What changes, for people. It has no secret.
    pub change: String,
}

/// An entry of the audit log.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AuditEntry {
    /// Public id.
    pub id: String,
    /// When it was written (ms since 1970-01-01 UTC).
    pub unix_ms: i64,
    /// Tenant that owns the object. For a refused act: the tenant that asked for it.
    pub tenant: Tenant,
    /// Who acted.
    pub author: Author,
    /// The call, such as `Keys.Create`.
    pub call: String,
    /// Id of what is changed; empty if it has no id.
    pub object: String,
    /// [`DONE`], or the code of the refusal.
    pub outcome: String,
    /// What changed, for people.
    pub change: String,
}

impl Author {
    /// The entry of an act that the author does now (ms since 1970-01-01 UTC).
    pub(crate) fn does(&self, act: Act<'_>, unix_ms: i64) -> AuditEntry {
        self.entry(act, DONE, unix_ms)
    }

    /// The entry of an act that is refused now (ms since 1970-01-01 UTC).
    pub(crate) fn is_refused(&self, act: Act<'_>, code: Code, unix_ms: i64) -> AuditEntry {
        self.entry(act, code.name(), unix_ms)
    }

    fn entry(&self, act: Act<'_>, outcome: &str, unix_ms: i64) -> AuditEntry {
        AuditEntry {
            id: Id::<OfEntry>::random().to_string(),
            unix_ms,
            tenant: act.tenant.clone(),
            author: self.clone(),
            call: act.call.to_owned(),
            object: act.object.to_owned(),
            outcome: outcome.to_owned(),
            change: act.change.chars().take(CHANGE_MAX).collect(),
        }
    }
}

/// Which entries a list has, and in which order.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AuditFilter {
    /// Only those of this tenant.
    pub tenant: Option<Tenant>,
    /// Only those of this actor; empty for all. Other tenants select all acts of the operator by
    /// [`BY_OPERATOR`], because they see no other name of the operator.
    pub actor: String,
    /// Tenant that reads; `None` for the operator, who sees every actor.
    pub reader: Option<Tenant>,
    /// Only those of this call; empty for all.
    pub call: String,
    /// Only those about this object; empty for all.
    pub object: String,
    /// Only those of refused acts, or only those of acts that were done.
    pub is_refused: Option<bool>,
    /// Only those written in this span of time (ms since 1970-01-01 UTC), without its end.
    pub span: std::ops::Range<i64>,
    /// The oldest entry first, not the newest.
    pub oldest_first: bool,
}

impl AuditFilter {
    /// All entries, the newest first.
    pub const fn all() -> Self {
        Self {
            tenant: None,
            actor: String::new(),
            reader: None,
            call: String::new(),
            object: String::new(),
            is_refused: None,
            span: i64::MIN..i64::MAX,
            oldest_first: false,
        }
    }

    /// Row key before the first entry of the list.
    const fn start(&self) -> i64 {
        if self.oldest_first { i64::MIN } else { i64::MAX }
    }

    /// Column of `is_refused`: 0 for all acts, 1 for acts that were done, 2 for refused ones.
    fn refused_column(&self) -> i32 {
        self.is_refused.map_or(0, |is_refused| if is_refused { 2 } else { 1 })
    }
}

#[derive(sqlx::FromRow)]
struct RawEntry {
    id: String,
    unix_ms: i64,
    tenant: String,
    actor: String,
    actor_tenant: String,
    call: String,
    object: String,
    outcome: String,
    request: String,
    node: String,
    change: String,
}

impl RawEntry {
    /// The entry as its reader sees it. Other tenants do not see the key, the request and the node
    /// of an act of the operator.
    fn seen_by(self, reader: Option<&Tenant>) -> AuditEntry {
        let Self { id, unix_ms, actor, call, object, outcome, request, node, change, .. } = self;
        let is_hidden = reader.is_some_and(|reader| reader.name() != self.actor_tenant);
        let tenant = Tenant::stored(&self.actor_tenant);
        let author = match is_hidden {
            false => Author { actor, tenant, request, node },
            true => Author {
                actor: BY_OPERATOR.to_owned(),
                tenant,
                request: String::new(),
                node: String::new(),
            },
        };
        let tenant = Tenant::stored(&self.tenant);
        AuditEntry { id, unix_ms, tenant, author, call, object, outcome, change }
    }
}

/// Selects a page of entries: those of one tenant, found by the index, or all.
macro_rules! select_entries {
    ($tenant:literal, $after:literal) => {
        concat!(
            "SELECT id, unix_ms, tenant, actor, actor_tenant, call, object, outcome, request, ",
            "node, change FROM audit_entries WHERE ",
            $tenant,
            " AND ($3 = '' OR (actor = $3 AND ($4 = '' OR actor_tenant = $4)) ",
            "OR ($3 = 'operator' AND $4 <> '' AND actor_tenant <> $4)) ",
            "AND ($5 = '' OR call = $5) AND ($6 = '' OR object = $6) ",
            "AND ($7 = 0 OR (outcome = 'DONE') = ($7 = 1)) ",
            "AND $8 <= unix_ms AND unix_ms < $9 AND ",
            $after,
            " LIMIT $10"
        )
    };
    ($after:literal) => {
        (select_entries!("tenant = $2", $after), select_entries!("$2 = ''", $after))
    };
}
const NEWEST_FIRST: (&str, &str) = select_entries!("key < $1 ORDER BY key DESC");
const OLDEST_FIRST: (&str, &str) = select_entries!("$1 < key ORDER BY key");

/// Writes an entry, if there is one, within a transaction. If the clock is behind, the entry gets
/// the time by which ages are counted, so that it is not removed early. `timed` entries have this
/// time.
macro_rules! note {
    (timed $transaction:expr, $entry:expr) => {
        $crate::store::audit::note!(by |unix_ms: i64| unix_ms, $transaction, $entry)
    };
    (by $time:expr, $transaction:expr, $entry:expr) => {
        if let Some(entry) = Option::<&$crate::store::AuditEntry>::from($entry) {
            let time = $time;
            sqlx::query($crate::store::audit::INSERT)
                .bind(&entry.id)
                .bind(time(entry.unix_ms))
                .bind(entry.tenant.name())
                .bind(&entry.author.actor)
                .bind(entry.author.tenant.name())
                .bind(&entry.call)
                .bind(&entry.object)
                .bind(&entry.outcome)
                .bind(&entry.author.request)
                .bind(&entry.author.node)
                .bind(&entry.change)
                .execute(&mut *$transaction)
                .await?;
        }
    };
    ($store:expr, $transaction:expr, $entry:expr) => {
        $crate::store::audit::note!(
            by |unix_ms: i64| $store.arrival_time(unix_ms), $transaction, $entry
        )
    };
}
pub(super) use note;

impl Store {
    /// Writes an entry by itself.
    ///
    /// # Errors
    /// The database fails.
    pub(crate) async fn note(&self, entry: &AuditEntry) -> Result<(), StoreError> {
        let noted = writing!(&self.pool, pool => {
            let note = async {
                let mut connection = pool.acquire().await?;
                note!(self, connection, entry);
                Ok::<(), sqlx::Error>(())
            };
            note.await
        });
        noted.map_err(StoreError::database("writing an entry of the audit log"))
    }

    /// A page of the audit log.
    ///
    /// # Errors
    /// The page token or size is invalid, or the database fails.
    pub async fn audit(
        &self,
        filter: &AuditFilter,
        page_size: usize,
        page_token: Option<&str>,
    ) -> Result<Page<AuditEntry>, StoreError> {
        let rows_asked = rows_asked(page_size, PAGE_LIMIT)?;
        let name =
            |tenant: &Option<Tenant>| tenant.as_ref().map_or_else(String::new, ToString::to_string);
        let (tenant, reader) = (name(&filter.tenant), name(&filter.reader));
        let beside = match page_token {
            None => filter.start(),
            Some(id) => {
                let key = self.key_of_entry(id, &tenant).await?;
                key.ok_or_else(|| StoreError::PageToken { token: id.to_owned() })?
            }
        };
        let (of_one, of_all) = if filter.oldest_first { OLDEST_FIRST } else { NEWEST_FIRST };
        let sql = if filter.tenant.is_some() { of_one } else { of_all };
        let rows: Result<Vec<RawEntry>, _> = reading!(list &self.pool, pool => {
            sqlx::query_as(sql)
                .bind(beside)
                .bind(&tenant)
                .bind(&filter.actor)
                .bind(&reader)
                .bind(&filter.call)
                .bind(&filter.object)
                .bind(filter.refused_column())
                .bind(filter.span.start)
                .bind(filter.span.end)
                .bind(rows_asked)
                .fetch_all(pool)
                .await
        });
        let rows = rows.map_err(StoreError::database("reading the audit log"))?;
        let seen = |row: RawEntry| Ok(row.seen_by(filter.reader.as_ref()));
        Page::of(rows, page_size, |row| row.id.clone()).try_map(seen)
    }

    /// Row key of an entry of a tenant; of any tenant if the name is empty.
    async fn key_of_entry(&self, id: &str, tenant: &str) -> Result<Option<i64>, StoreError> {
        let key: Result<Option<i64>, _> = reading!(list &self.pool, pool => {
            let sql = "SELECT key FROM audit_entries WHERE id = $1 AND ($2 = '' OR tenant = $2)";
            sqlx::query_scalar(sql).bind(id).bind(tenant).fetch_optional(pool).await
        });
        key.map_err(StoreError::database("reading the audit log"))
    }

    /// Removes up to `entries` of the entries before this time (ms since 1970-01-01 UTC). Returns
    /// whether there may be more.
    ///
    /// # Errors
    /// The database fails.
    pub(crate) async fn remove_audit_before(
        &self,
        unix_ms: i64,
        entries: usize,
    ) -> Result<bool, StoreError> {
        let removed = writing!(&self.pool, pool => {
            let remove = sqlx::query(REMOVE).bind(unix_ms).bind(entries as i64);
            remove.execute(pool).await.map(|done| done.rows_affected())
        });
        let removed = removed.map_err(StoreError::database("removing entries of the audit log"))?;
        Ok(removed == entries as u64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::{LOOPBACK, Page};

    /// The log's retention counts by the time that is stored, and a clock may be behind it.
    #[tokio::test]
    async fn an_entry_is_not_older_than_what_is_stored() {
        let folder = tempfile::tempdir().unwrap();
        let url = format!("sqlite://{}", folder.path().join("graphfix.db").display());
        let store = Store::open(&url).await.unwrap();
        assert_eq!(store.advance_expiry_clock(5_000, 0).await.unwrap(), 5_000);
        let tenant = Tenant::operator();
        let author = Author {
            actor: LOOPBACK.to_owned(),
            tenant: tenant.clone(),
            request: String::new(),
            node: String::new(),
        };
        let act =
            |object| Act { call: "Keys.Create", tenant: &tenant, object, change: String::new() };
        store.note(&author.does(act("behind"), 7)).await.unwrap();
        store.note(&author.does(act("right"), 6_000)).await.unwrap();
        let filter = AuditFilter { oldest_first: true, ..AuditFilter::all() };
        let Page { items, .. } = store.audit(&filter, 10, None).await.unwrap();
        let times: Vec<i64> = items.iter().map(|entry| entry.unix_ms).collect();
        assert_eq!(times, [5_000, 6_000]);
    }
}
