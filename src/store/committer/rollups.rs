//! Rollups: sums of a session's first answers over each minute and each hour of their times.
//!
//! Each transaction adds what it commits: one row for each session and bucket that it touches, and
//! one for each tenant and hour. Only first answers count: a revision is another answer to an epoch
//! that is already counted. Rows are written in the order of their keys, so that no two
//! transactions wait for each other in a circle.

use std::collections::BTreeMap;
use std::sync::LazyLock;

use sqlx::PgConnection;

use crate::gnss::Status;
use crate::store::codec::{Measures, status_number};
use crate::store::rollup::{HOUR_S, MINUTE_S, QUANTITIES};

use super::batch::{Batch, EncodedEpoch};

const NS_PER_S: i64 = 1_000_000_000;
const STATUSES: usize = Status::ALL.len();

/// How a new value of a column changes the stored one.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Merge {
    /// Part of the key: identifies the row.
    Key,
    Sum,
    Least,
    Greatest,
    /// The new value replaces the stored one, unless it is null.
    Last,
}

/// The columns of `rollups` except those of the quantities, with their types on Postgres.
const COLUMNS: [(&str, Merge, &str); 22] = [
    ("session", Merge::Key, "bigint"),
    ("seconds", Merge::Key, "integer"),
    ("begin_s", Merge::Key, "bigint"),
    ("day", Merge::Last, "integer"),
    ("first_time_ns", Merge::Least, "bigint"),
    ("last_time_ns", Merge::Greatest, "bigint"),
    ("last_seq", Merge::Last, "bigint"),
    ("n_none", Merge::Sum, "integer"),
    ("n_single", Merge::Sum, "integer"),
    ("n_ekf", Merge::Sum, "integer"),
    ("n_fgo", Merge::Sum, "integer"),
    ("n_float", Merge::Sum, "integer"),
    ("n_fixed", Merge::Sum, "integer"),
    ("status", Merge::Last, "smallint"),
    ("latitude_deg", Merge::Last, "double precision"),
    ("longitude_deg", Merge::Last, "double precision"),
    ("positions", Merge::Sum, "integer"),
    ("ages", Merge::Sum, "integer"),
    ("south_deg", Merge::Least, "double precision"),
    ("west_deg", Merge::Least, "double precision"),
    ("north_deg", Merge::Greatest, "double precision"),
    ("east_deg", Merge::Greatest, "double precision"),
];
/// The columns of hours from which a fleet's sums are made, with their types on Postgres.
pub(super) const FLEET_COLUMNS: [(&str, &str); 14] = [
    ("session", "bigint"),
    ("begin_s", "bigint"),
    ("day", "integer"),
    ("n_none", "bigint"),
    ("n_single", "bigint"),
    ("n_ekf", "bigint"),
    ("n_fgo", "bigint"),
    ("n_float", "bigint"),
    ("n_fixed", "bigint"),
    ("positions", "bigint"),
    ("ages", "bigint"),
    ("sigma_sum_m", "double precision"),
    ("satellites_sum", "double precision"),
    ("age_sum_s", "double precision"),
];
/// Index of the first column that is a sum.
pub(super) const FLEET_SUMS: usize = 3;

/// All columns of `rollups`.
pub(super) fn columns() -> Vec<(String, Merge, &'static str)> {
    let named = |(name, merge, kind): (&str, Merge, &'static str)| (name.to_owned(), merge, kind);
    let mut columns: Vec<_> = COLUMNS.into_iter().map(named).collect();
    for (name, unit) in QUANTITIES {
        columns.push((format!("{name}_min{unit}"), Merge::Least, "real"));
        columns.push((format!("{name}_max{unit}"), Merge::Greatest, "real"));
        columns.push((format!("{name}_sum{unit}"), Merge::Sum, "double precision"));
        columns.push((format!("{name}_last{unit}"), Merge::Last, "real"));
    }
    columns
}

pub(super) fn names() -> String {
    columns().into_iter().map(|(name, ..)| name).collect::<Vec<_>>().join(", ")
}

/// The conflict clause of the insert: how a stored bucket is changed. `least` and `greatest` are
/// the functions of the database.
pub(super) fn merging(least: &str, greatest: &str) -> String {
    let set = |(name, merge, _): (String, Merge, &str)| {
        let (stored, further) = (format!("rollups.{name}"), format!("excluded.{name}"));
        let of_both = |function| {
            format!("{function}(COALESCE({stored}, {further}), COALESCE({further}, {stored}))")
        };
        let value = match merge {
            Merge::Key => return None,
            Merge::Sum => format!("{stored} + {further}"),
            Merge::Least => of_both(least),
            Merge::Greatest => of_both(greatest),
            Merge::Last => format!("COALESCE({further}, {stored})"),
        };
        Some(format!("{name} = {value}"))
    };
    let set: Vec<String> = columns().into_iter().filter_map(set).collect();
    format!(" ON CONFLICT (session, seconds, begin_s) DO UPDATE SET {}", set.join(", "))
}

/// The names of a fleet's sums.
fn fleet_sums() -> Vec<&'static str> {
    FLEET_COLUMNS[FLEET_SUMS..].iter().map(|(name, _)| *name).collect()
}

/// The conflict clause of the insert: how a stored hour of a tenant is changed.
pub(super) fn fleet_merging() -> String {
    let sums = fleet_sums().into_iter();
    let set = sums.map(|name| format!("{name} = fleet_hours.{name} + excluded.{name}"));
    format!(
        " ON CONFLICT (tenant, begin_s) DO UPDATE SET \
         day = COALESCE(excluded.day, fleet_hours.day), \
         sessions = fleet_hours.sessions + excluded.sessions, {}",
        set.collect::<Vec<_>>().join(", ")
    )
}

/// Adds hours to the sums of their fleets. It must run before they are written to `rollups`,
/// because a session is counted if the hour is not there yet. `hours` are rows with the columns'
/// names.
fn into_fleet(hours: &str) -> String {
    let (sums, merging) = (fleet_sums(), fleet_merging());
    let added = sums.iter().map(|name| format!("SUM(b.{name})")).collect::<Vec<_>>();
    format!(
        "INSERT INTO fleet_hours (tenant, begin_s, day, sessions, {}) \
         SELECT s.tenant, b.begin_s, MAX(b.day), SUM(CASE WHEN EXISTS (SELECT 1 FROM rollups r \
         WHERE r.session = b.session AND r.seconds = {HOUR_S} AND r.begin_s = b.begin_s) \
         THEN 0 ELSE 1 END), {} FROM ({hours}) AS b JOIN sessions s ON s.key = b.session \
         WHERE 1 = 1 GROUP BY s.tenant, b.begin_s ORDER BY s.tenant, b.begin_s{merging}",
        sums.join(", "),
        added.join(", "),
    )
}

static POSTGRES: LazyLock<String> = LazyLock::new(|| {
    let numbered = columns().into_iter().enumerate();
    let arrays = numbered.map(|(index, (_, _, kind))| format!("${}::{kind}[]", index + 1));
    let arrays: Vec<String> = arrays.collect();
    let (names, merging) = (names(), merging("LEAST", "GREATEST"));
    format!("INSERT INTO rollups ({names}) SELECT * FROM UNNEST({}){merging}", arrays.join(", "))
});
static POSTGRES_FLEET: LazyLock<String> = LazyLock::new(|| {
    let numbered = FLEET_COLUMNS.iter().enumerate();
    let arrays = numbered.map(|(index, (_, kind))| format!("${}::{kind}[]", index + 1));
    let names = FLEET_COLUMNS.map(|(name, _)| name).join(", ");
    let arrays = arrays.collect::<Vec<_>>().join(", ");
    into_fleet(&format!("SELECT * FROM UNNEST({arrays}) AS u({names})"))
});
/// The values of a quantity.
#[derive(Clone, Copy, Default)]
pub(super) struct Values {
    pub(super) min: Option<f32>,
    pub(super) max: Option<f32>,
    pub(super) sum: f64,
    pub(super) last: Option<f32>,
}

impl Values {
    fn take(&mut self, value: f64) {
        let rounded = value as f32;
        self.min = Some(self.min.map_or(rounded, |min| min.min(rounded)));
        self.max = Some(self.max.map_or(rounded, |max| max.max(rounded)));
        self.sum += value;
        self.last = Some(rounded);
    }
}

/// Session, length of the bucket (s), and its begin (s).
type Key = (i64, i64, i64);

/// The sums that a transaction adds to a bucket.
pub(super) struct Row {
    pub(super) key: Key,
    pub(super) day: Option<i32>,
    pub(super) times_ns: (i64, i64),
    pub(super) last_seq: i64,
    pub(super) counts: [i32; STATUSES],
    pub(super) status: i16,
    pub(super) position_deg: Option<(f64, f64)>,
    pub(super) positions: i32,
    pub(super) ages: i32,
    /// South, west, north, east (degrees).
    pub(super) bounds_deg: Option<[f64; 4]>,
    pub(super) values: [Values; QUANTITIES.len()],
}

impl Row {
    fn new(key: Key, epoch: &EncodedEpoch) -> Self {
        Self {
            key,
            day: None,
            times_ns: (epoch.gps_time_ns, epoch.gps_time_ns),
            last_seq: epoch.seq,
            counts: [0; STATUSES],
            status: epoch.solution.status,
            position_deg: None,
            positions: 0,
            ages: 0,
            bounds_deg: None,
            values: Default::default(),
        }
    }

    fn take(&mut self, day: Option<i32>, epoch: &EncodedEpoch) {
        let (first_ns, last_ns) = self.times_ns;
        self.times_ns = (first_ns.min(epoch.gps_time_ns), last_ns.max(epoch.gps_time_ns));
        self.day = day.or(self.day);
        self.last_seq = epoch.seq;
        self.status = epoch.solution.status;
        let is_given = |status: &Status| status_number(*status) == epoch.solution.status;
        let index = Status::ALL.iter().position(is_given);
        self.counts[index.expect("each number is that of a status")] += 1;
        if let Some(measures) = &epoch.measures {
            self.take_measures(measures);
        }
    }

    fn take_measures(&mut self, measures: &Measures) {
        let Measures { latitude_deg, longitude_deg, height_m, sigma_m, satellites, age_s } =
            *measures;
        self.position_deg = Some((latitude_deg, longitude_deg));
        self.positions += 1;
        let corner = [latitude_deg, longitude_deg, latitude_deg, longitude_deg];
        let [south, west, north, east] = self.bounds_deg.unwrap_or(corner);
        self.bounds_deg = Some([
            south.min(latitude_deg),
            west.min(longitude_deg),
            north.max(latitude_deg),
            east.max(longitude_deg),
        ]);
        let [heights, sigmas, numbers, ages] = &mut self.values;
        heights.take(height_m);
        sigmas.take(sigma_m);
        numbers.take(satellites);
        if let Some(age_s) = age_s {
            ages.take(age_s);
            self.ages += 1;
        }
    }
}

/// The sums that batches add, in the order of their keys.
pub(super) fn rows(batches: &[&Batch]) -> Vec<Row> {
    let mut rows: BTreeMap<Key, Row> = BTreeMap::new();
    for batch in batches {
        for epoch in &batch.epochs {
            let time_s = epoch.gps_time_ns.div_euclid(NS_PER_S);
            for length_s in [MINUTE_S, HOUR_S] {
                let key = (batch.session.0, length_s, time_s.div_euclid(length_s) * length_s);
                let row = rows.entry(key).or_insert_with(|| Row::new(key, epoch));
                row.take(batch.day(), epoch);
            }
        }
    }
    rows.into_values().collect()
}

/// A column of rows as an array.
macro_rules! array {
    ($rows:expr, $row:ident => $value:expr) => {
        $rows.iter().map(|$row| $value).collect::<Vec<_>>()
    };
}

/// Adds batches to their rollups, within the transaction that writes them.
pub(super) async fn write_rollups_postgres(
    connection: &mut PgConnection,
    batches: &[&Batch],
) -> Result<(), sqlx::Error> {
    let rows = rows(batches);
    if rows.is_empty() {
        return Ok(());
    }
    let hours: Vec<&Row> = rows.iter().filter(|row| row.key.1 == HOUR_S).collect();
    let mut insert = sqlx::query(POSTGRES_FLEET.as_str())
        .bind(array!(hours, row => row.key.0))
        .bind(array!(hours, row => row.key.2))
        .bind(array!(hours, row => row.day));
    for status in 0..STATUSES {
        insert = insert.bind(array!(hours, row => i64::from(row.counts[status])));
    }
    insert = insert
        .bind(array!(hours, row => i64::from(row.positions)))
        .bind(array!(hours, row => i64::from(row.ages)));
    for quantity in 1..QUANTITIES.len() {
        insert = insert.bind(array!(hours, row => row.values[quantity].sum));
    }
    insert.execute(&mut *connection).await?;
    merge_postgres(connection, &rows).await
}

async fn merge_postgres(connection: &mut PgConnection, rows: &[Row]) -> Result<(), sqlx::Error> {
    let mut insert = sqlx::query(POSTGRES.as_str())
        .bind(array!(rows, row => row.key.0))
        .bind(array!(rows, row => row.key.1 as i32))
        .bind(array!(rows, row => row.key.2))
        .bind(array!(rows, row => row.day))
        .bind(array!(rows, row => row.times_ns.0))
        .bind(array!(rows, row => row.times_ns.1))
        .bind(array!(rows, row => row.last_seq));
    for status in 0..STATUSES {
        insert = insert.bind(array!(rows, row => row.counts[status]));
    }
    insert = insert
        .bind(array!(rows, row => row.status))
        .bind(array!(rows, row => row.position_deg.map(|deg| deg.0)))
        .bind(array!(rows, row => row.position_deg.map(|deg| deg.1)))
        .bind(array!(rows, row => row.positions))
        .bind(array!(rows, row => row.ages));
    for side in 0..4 {
        insert = insert.bind(array!(rows, row => row.bounds_deg.map(|deg| deg[side])));
    }
    for quantity in 0..QUANTITIES.len() {
        insert = insert
            .bind(array!(rows, row => row.values[quantity].min))
            .bind(array!(rows, row => row.values[quantity].max))
            .bind(array!(rows, row => row.values[quantity].sum))
            .bind(array!(rows, row => row.values[quantity].last));
    }
    insert.execute(connection).await.map(drop)
}
