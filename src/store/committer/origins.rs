//! Origins of solutions: each row names the program's version and the configuration by one key.

use std::collections::HashMap;
use std::sync::{Mutex, PoisonError};

use sqlx::PgConnection;

use super::batch::{Batch, EncodedSolution, Origin};

/// Most keys in memory. There are as many as configurations in use.
const KNOWN_MAX: usize = 10_000;

pub(super) const FIND: &str =
    "SELECT key FROM solution_origins WHERE version = $1 AND configuration_hash = $2";
/// Another node may insert the same origin at the same time.
pub(super) const INSERT: &str = "INSERT INTO solution_origins (version, configuration_hash) \
    VALUES ($1, $2) ON CONFLICT (version, configuration_hash) \
    DO UPDATE SET version = excluded.version RETURNING key";

/// The keys of committed origins.
#[derive(Default)]
pub(super) struct Origins {
    known: Mutex<HashMap<Origin, i32>>,
}

/// The keys of the origins that a transaction names.
#[derive(Clone, Debug)]
pub(super) struct OriginKeys(HashMap<Origin, i32>);

impl Origins {
    /// The known keys of these batches' origins, and the origins without a known key.
    pub(super) fn of(&self, batches: &[&Batch]) -> (OriginKeys, Vec<Origin>) {
        let known = self.known.lock().unwrap_or_else(PoisonError::into_inner);
        let (mut keys, mut unknown) = (HashMap::new(), Vec::new());
        let mut last: Option<&Origin> = None;
        for origin in batches.iter().flat_map(|batch| origins(batch)) {
            let is_done = last == Some(origin) || keys.contains_key(origin);
            last = Some(origin);
            if is_done || unknown.contains(origin) {
                continue;
            }
            match known.get(origin) {
                Some(key) => drop(keys.insert(origin.clone(), *key)),
                None => unknown.push(origin.clone()),
            }
        }
        unknown.sort(); // In one order, so that nodes do not wait for each other in a circle.
        (OriginKeys(keys), unknown)
    }

    /// Remembers keys that are committed.
    pub(super) fn learn(&self, keys: OriginKeys) {
        let mut known = self.known.lock().unwrap_or_else(PoisonError::into_inner);
        if KNOWN_MAX < known.len() {
            known.clear();
        }
        known.extend(keys.0);
    }
}

impl OriginKeys {
    /// The key of a solution's origin.
    pub(super) fn key(&self, solution: &EncodedSolution) -> i32 {
        self.0[&solution.origin]
    }

    /// Adds the key of an origin.
    pub(super) fn insert(&mut self, origin: Origin, key: i32) {
        self.0.insert(origin, key);
    }
}

fn origins(batch: &Batch) -> impl Iterator<Item = &Origin> {
    let first = batch.epochs.iter().map(|epoch| &epoch.solution);
    first.chain(&batch.revisions).map(|solution| &solution.origin)
}

/// The keys of all origins of these batches. Stores new origins in the transaction.
pub(super) async fn origin_keys(
    origins: &Origins,
    transaction: &mut PgConnection,
    batches: &[&Batch],
) -> Result<OriginKeys, sqlx::Error> {
    let (mut keys, unknown) = origins.of(batches);
    for origin in unknown {
        let (version, hash) = (&*origin.0, &*origin.1);
        let find = sqlx::query_scalar(FIND).bind(version).bind(hash);
        let found: Option<i64> = find.fetch_optional(&mut *transaction).await?;
        let key = match found {
            Some(key) => key,
            None => {
                let insert = sqlx::query_scalar(INSERT).bind(version).bind(hash);
                insert.fetch_one(&mut *transaction).await?
            }
        };
        // The column of solutions has 32 bits.
        let key = i32::try_from(key).map_err(|error| sqlx::Error::Encode(Box::new(error)))?;
        keys.insert(origin, key);
    }
    Ok(keys)
}
