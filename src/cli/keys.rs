//! `graphfix keys`: the API keys in a database, which a service may be using.

use std::fmt::Write as _;

use clap::{Args, Subcommand};

use crate::clock::Clock;
use crate::contract::calls::utc;
use crate::keys::{Created, KeyError, KeyInfo, KeyRegistry, NewKey, Rights};
use crate::refusal::Code;
use crate::store::{AuditEntry, AuditFilter, Store};
use crate::tenant::{OPERATOR, Tenant};

use super::database::{DatabaseArgument, author};
use super::output::{print, print_once};
use super::{Failure, host};

const MS_PER_HOUR: i64 = 3_600_000;
const MS_PER_DAY: i64 = 24 * MS_PER_HOUR;
/// Keys read at a time.
const PAGE: usize = 1000;
/// Largest times: a century. They keep each sum of times in range.
const DAYS_MAX: u32 = 36_500;
const HOURS_MAX: u32 = 24 * DAYS_MAX;

/// Creates, lists, revokes and rotates API keys in the service's database, also while it runs. A
/// running service takes a change within a second.
#[derive(Debug, Args)]
pub(super) struct KeysArguments {
    #[command(subcommand)]
    act: Act,
    #[command(flatten)]
    database: DatabaseArgument,
}

#[derive(Debug, Subcommand)]
enum Act {
    /// Creates a key and prints its secret once. As soon as a key exists, every call needs one.
    Create {
        /// Right: device (sends observations), read, operate (changes sessions and bases) or admin
        /// (changes keys); may be repeated.
        #[arg(long = "right", value_name = "RIGHT", required = true, value_delimiter = ',')]
        rights: Vec<String>,
        /// A name that helps people to recognise the key.
        #[arg(long, value_name = "TEXT", default_value = "")]
        label: String,
        /// Tenant that owns the key: 1 to 63 lower-case letters, digits, - and _. Default: the
        /// operator's tenant.
        #[arg(long, value_name = "NAME", default_value = OPERATOR, value_parser = tenant)]
        tenant: Tenant,
        /// Days until the key expires. Default: never.
        #[arg(long, value_name = "DAYS", value_parser = days())]
        days: Option<u32>,
    },
    /// Lists all keys, the newest first, without their secrets.
    List,
    /// Lists entries of the audit log, the newest first: who has changed keys, tenants, bases and
    /// sessions, and who was refused.
    Audit {
        /// Only those of this tenant.
        #[arg(long, value_name = "NAME", value_parser = tenant)]
        tenant: Option<Tenant>,
        /// Largest number of entries.
        #[arg(long, value_name = "N", default_value_t = 100)]
        count: usize,
    },
    /// Revokes a key: calls with it are refused, and its open streams end.
    Revoke {
        /// Id of the key.
        #[arg(value_name = "KEY")]
        key: String,
    },
    /// Creates a key in place of another, with the same rights and label. The other one stays in
    /// force for a while, so that its user can change to the new one.
    Rotate {
        /// Id of the key to replace.
        #[arg(value_name = "KEY")]
        key: String,
        /// Hours for which the replaced key stays in force.
        #[arg(long, value_name = "HOURS", default_value_t = 24, value_parser = hours())]
        overlap: u32,
        /// Days until the new key expires. Default: never.
        #[arg(long, value_name = "DAYS", value_parser = days())]
        days: Option<u32>,
    },
}

/// Reads the name of a tenant.
pub(super) fn tenant(name: &str) -> Result<Tenant, String> {
    let wrong = "a tenant's name has 1 to 63 lower-case letters, digits, - and _";
    Tenant::parse(name).ok_or_else(|| wrong.to_owned())
}

fn days() -> clap::builder::RangedI64ValueParser<u32> {
    clap::value_parser!(u32).range(1..=i64::from(DAYS_MAX))
}

fn hours() -> clap::builder::RangedI64ValueParser<u32> {
    clap::value_parser!(u32).range(0..=i64::from(HOURS_MAX))
}

/// Does what one subcommand asks.
///
/// # Errors
/// The database cannot be opened, or the change is refused.
pub(super) fn run(arguments: KeysArguments) -> Result<(), Failure> {
    let shows_secret = matches!(arguments.act, Act::Create { .. } | Act::Rotate { .. });
    let text = host::block_on(async {
        // The first key may come before the service's first start.
        let store = match arguments.act {
            Act::Create { .. } => arguments.database.open().await?,
            _ => arguments.database.open_existing().await?,
        };
        let done = act(&store, arguments.act).await;
        store.close().await;
        Ok(done?)
    })?;
    if shows_secret { print_once(&text) } else { print(&text) }
}

/// Does what one subcommand asks; returns the text to print.
async fn act(store: &Store, act: Act) -> Result<String, KeyError> {
    let keys = KeyRegistry::new(store.clone());
    let lifetime_ms = |days: Option<u32>| days.map(|days| i64::from(days) * MS_PER_DAY);
    match act {
        Act::Create { rights, label, tenant, days } => {
            let rights = Rights::named(&rights)?;
            let lifetime_ms = lifetime_ms(days);
            let new = NewKey { tenant, rights, label, lifetime_ms };
            keys.create(new, &author()).await.map(shown)
        }
        Act::List => list(&keys).await,
        Act::Audit { tenant, count } => audit(store, tenant, count).await,
        Act::Revoke { key } => {
            let key = keys.revoke(None, &key, &author()).await?;
            Ok(format!("{} is revoked\n", key.id))
        }
        Act::Rotate { key, overlap, days } => {
            let overlap_ms = i64::from(overlap) * MS_PER_HOUR;
            let author = author();
            let rotated = keys.rotate(&key, lifetime_ms(days), overlap_ms, &author);
            rotated.await.map(shown)
        }
    }
}

/// Creates a key. The secret is the last line of the text, so that scripts find it.
fn shown(created: Created) -> String {
    let Created { key, secret } = created;
    let end = key
        .expires_unix_ms
        .map_or("does not expire".to_owned(), |ms| format!("expires {}", utc(ms)));
    format!(
        "{} of {} ({}), {end}; its secret is not shown again:\n{}\n",
        key.id,
        key.tenant,
        key.rights,
        secret.text()
    )
}

async fn list(keys: &KeyRegistry) -> Result<String, KeyError> {
    let mut text = String::new();
    let mut token = None;
    loop {
        let page = keys.list(None, PAGE, token.as_deref()).await?;
        for key in page.items {
            let KeyInfo { id, tenant, rights, label, .. } = &key;
            let state = state(&key);
            let used = key
                .last_used_unix_ms
                .map_or("never used".to_owned(), |ms| format!("last used {}", utc(ms)));
            writeln!(text, "{id} {tenant} [{rights}] {state}, {used} {label}")
                .expect("a text takes any text");
        }
        token = page.next_page_token;
        if token.is_none() {
            return Ok(text);
        }
    }
}

/// The newest entries of the audit log.
async fn audit(
    store: &Store,
    tenant: Option<Tenant>,
    mut count: usize,
) -> Result<String, KeyError> {
    let filter = AuditFilter { tenant, ..AuditFilter::all() };
    let (mut text, mut token) = (String::new(), None);
    while 0 < count {
        let page = store.audit(&filter, count.min(PAGE), token.as_deref()).await?;
        count -= page.items.len();
        for entry in &page.items {
            let AuditEntry { tenant, author, call, object, outcome, change, .. } = entry;
            let (utc, actor) = (utc(entry.unix_ms), &author.actor);
            writeln!(text, "{utc} {tenant} {actor} {call} {outcome} [{object}] {change}")
                .expect("a text takes any text");
        }
        token = page.next_page_token;
        if token.is_none() {
            break;
        }
    }
    Ok(text)
}

/// Whether a key is in force, and until when.
fn state(key: &KeyInfo) -> String {
    match (key.revoked_unix_ms, key.expires_unix_ms) {
        (Some(ms), _) => format!("revoked {}", utc(ms)),
        (None, Some(ms)) if ms <= Clock::system().unix_ms() => format!("expired {}", utc(ms)),
        (None, Some(ms)) => format!("in force until {}", utc(ms)),
        (None, None) => "in force".to_owned(),
    }
}

impl From<KeyError> for Failure {
    fn from(error: KeyError) -> Self {
        match error.code() {
            Code::InvalidField => Self::of(Code::Usage, error),
            code => Self::of(code, error),
        }
    }
}
