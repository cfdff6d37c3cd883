//! Rollups on SQLite. An existing row of a bucket is updated in place. An insert happens only for
//! the first epochs of a bucket, and for the first ones of a day.

use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;

use rusqlite::{Connection, OptionalExtension, Statement};

use crate::store::committer::batch::Batch;
use crate::store::committer::rollups::{
    FLEET_COLUMNS, FLEET_SUMS, Merge, Row, columns, fleet_merging, merging, names, rows,
};
use crate::store::rollup::HOUR_S;

use super::binding::{Binding, with_values};

/// Most sessions whose tenant is kept in memory.
const KNOWN_MAX: usize = 100_000;

const HAS_ROW: &str = "SELECT 1 FROM rollups WHERE session = ?1 AND seconds = ?2 AND begin_s = ?3";
const TENANT: &str = "SELECT tenant FROM sessions WHERE key = ?1";

/// The statements of rollups.
pub(super) struct Rollups<'c> {
    update: Statement<'c>,
    has_row: Statement<'c>,
    upsert: Statement<'c>,
    fleet: Statement<'c>,
    /// The tenants of sessions, which never change.
    tenants: HashMap<i64, Arc<str>>,
}

/// The sums that a transaction adds to an hour of a tenant.
#[derive(Default)]
struct FleetRow {
    day: Option<i32>,
    sessions: i64,
    counts: [i64; FLEET_COUNTS],
    sums: [f64; 3],
}

/// Number of the sums that count epochs.
const FLEET_COUNTS: usize = FLEET_COLUMNS.len() - FLEET_SUMS - 3;

impl<'c> Rollups<'c> {
    /// Prepares the statements.
    pub(super) fn new(connection: &'c Connection) -> rusqlite::Result<Self> {
        let insert = format!("INSERT INTO rollups ({})", names());
        let upsert = with_values(&insert, columns().len(), &merging("MIN", "MAX"));
        Ok(Self {
            update: connection.prepare(&updating())?,
            has_row: connection.prepare(HAS_ROW)?,
            upsert: connection.prepare(&upsert)?,
            fleet: connection.prepare(&fleet())?,
            tenants: HashMap::new(),
        })
    }

    /// Adds batches to their rollups, within the transaction that writes them.
    pub(super) fn write(
        &mut self,
        connection: &Connection,
        batches: &[&Batch],
    ) -> rusqlite::Result<()> {
        let mut fleet: BTreeMap<(Arc<str>, i64), FleetRow> = BTreeMap::new();
        for row in rows(batches) {
            let is_new = self.adds_row(&row)?;
            let (session, length_s, begin_s) = row.key;
            if length_s == HOUR_S
                && let Some(tenant) = self.tenant(connection, session)?
            {
                fleet.entry((tenant, begin_s)).or_default().take(&row, is_new);
            }
        }
        for ((tenant, begin_s), row) in fleet {
            Binding::of(&mut self.fleet)
                .bind(&*tenant)?
                .bind(begin_s)?
                .bind(row.day)?
                .bind(row.sessions)?
                .bind_all(row.counts)?
                .bind_all(row.sums)?
                .execute()?;
        }
        Ok(())
    }

    /// Adds to a bucket. Returns whether this inserted its row.
    fn adds_row(&mut self, row: &Row) -> rusqlite::Result<bool> {
        if bound(&mut self.update, row)?.execute()? == 1 {
            return Ok(false);
        }
        let has_row = self.has_row.query_row(row.key, |_| Ok(())).optional()?.is_some();
        bound(&mut self.upsert, row)?.execute()?;
        Ok(!has_row)
    }

    /// The tenant of a session.
    fn tenant(
        &mut self,
        connection: &Connection,
        session: i64,
    ) -> rusqlite::Result<Option<Arc<str>>> {
        if let Some(tenant) = self.tenants.get(&session) {
            return Ok(Some(tenant.clone()));
        }
        let mut find = connection.prepare_cached(TENANT)?;
        let found: Option<Arc<str>> = find.query_row([session], |row| row.get(0)).optional()?;
        if KNOWN_MAX <= self.tenants.len() {
            self.tenants.clear();
        }
        self.tenants.extend(found.clone().map(|tenant| (session, tenant)));
        Ok(found)
    }
}

impl FleetRow {
    fn take(&mut self, hour: &Row, is_new: bool) {
        self.day = self.day.max(hour.day);
        self.sessions += i64::from(is_new);
        let counts = hour.counts.into_iter().chain([hour.positions, hour.ages]);
        for (sum, count) in self.counts.iter_mut().zip(counts) {
            *sum += i64::from(count);
        }
        let [_, values @ ..] = &hour.values;
        for (sum, values) in self.sums.iter_mut().zip(values) {
            *sum += values.sum;
        }
    }
}

/// Updates a bucket if its row has the same day, or if the day is not known. So no index changes.
fn updating() -> String {
    let numbered = columns().into_iter().enumerate();
    let set = numbered.filter_map(|(index, (name, merge, _))| {
        let further = format!("?{}", index + 1);
        let value = match merge {
            _ if name == "day" => return None,
            Merge::Key => return None,
            Merge::Sum => format!("{name} + {further}"),
            Merge::Least => format!(
                "CASE WHEN {name} <= {further} OR {further} IS NULL THEN {name} ELSE {further} END"
            ),
            Merge::Greatest => format!(
                "CASE WHEN {name} >= {further} OR {further} IS NULL THEN {name} ELSE {further} END"
            ),
            Merge::Last => format!("COALESCE({further}, {name})"),
        };
        Some(format!("{name} = {value}"))
    });
    format!(
        "UPDATE rollups SET {} WHERE session = ?1 AND seconds = ?2 AND begin_s = ?3 \
         AND day IS COALESCE(?4, day)",
        set.collect::<Vec<_>>().join(", ")
    )
}

/// The statement that adds to an hour of a tenant.
fn fleet() -> String {
    let sums = FLEET_COLUMNS.map(|(name, _)| name);
    let insert = format!(
        "INSERT INTO fleet_hours (tenant, begin_s, day, sessions, {})",
        sums[FLEET_SUMS..].join(", ")
    );
    with_values(&insert, FLEET_COLUMNS.len() + 1, &fleet_merging())
}

/// Binds the columns of a bucket.
fn bound<'s, 'c>(statement: &'s mut Statement<'c>, row: &Row) -> rusqlite::Result<Binding<'s, 'c>> {
    let (session, length_s, begin_s) = row.key;
    let bounds_deg = row.bounds_deg.map_or([None; 4], |deg| deg.map(Some));
    let mut binding = Binding::of(statement)
        .bind_all([session, length_s, begin_s])?
        .bind(row.day)?
        .bind_all([row.times_ns.0, row.times_ns.1, row.last_seq])?
        .bind_all(row.counts)?
        .bind(row.status)?
        .bind(row.position_deg.map(|deg| deg.0))?
        .bind(row.position_deg.map(|deg| deg.1))?
        .bind_all([row.positions, row.ages])?
        .bind_all(bounds_deg)?;
    for values in &row.values {
        binding =
            binding.bind(values.min)?.bind(values.max)?.bind(values.sum)?.bind(values.last)?;
    }
    Ok(binding)
}
