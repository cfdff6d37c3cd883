//! Base stations, their sites and their epochs.

use std::collections::BTreeMap;
use std::sync::Arc;

use crate::gnss::{
    AntennaCalibration, BaseSite, CoordinateFrame, Ecef, Epoch, GpsTime, PositionSource,
};
use crate::tenant::Tenant;

use super::antennas::calibration_hash;
use super::audit::note;
use super::codec::{decode_epoch, encode_epoch};
use super::feeds::{RawFeed, feed};
use super::notices::{Change, notify};
use super::pool::{reading, writing};
use super::{AuditEntry, BaseFeed, NamedRequest, Store, StoreError};

/// Primary key of a base.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct BaseKey(pub(super) i64);

impl BaseKey {
    /// The key as a number, for snapshots.
    pub(crate) const fn number(self) -> i64 {
        self.0
    }

    /// The key with this number.
    pub(crate) const fn of_number(number: i64) -> Self {
        Self(number)
    }
}

/// Key and id of a base.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BaseName {
    /// Primary key of the base.
    pub key: BaseKey,
    /// Public id of the base.
    pub id: Arc<str>,
}

/// The bases that a session may use, if its mode is relative to one.
#[derive(Clone, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub enum BaseChoice<B = BaseName> {
    /// No base.
    #[default]
    None,
    /// One base.
    One(B),
    /// The nearest of these bases.
    NearestOf(Vec<B>),
    /// The nearest of all bases of the service.
    Nearest,
}

impl<B> BaseChoice<B> {
    /// Whether the session uses no base.
    pub(crate) const fn is_none(&self) -> bool {
        matches!(self, Self::None)
    }

    /// The bases that are named.
    pub(crate) const fn named(&self) -> &[B] {
        match self {
            Self::One(base) => std::slice::from_ref(base),
            Self::NearestOf(bases) => bases.as_slice(),
            Self::None | Self::Nearest => &[],
        }
    }

    /// The same choice, with each base replaced by the result of `name`.
    ///
    /// # Errors
    /// The first error of `name`.
    pub fn try_map<C, E>(
        self,
        mut name: impl FnMut(B) -> Result<C, E>,
    ) -> Result<BaseChoice<C>, E> {
        Ok(match self {
            Self::None => BaseChoice::None,
            Self::One(base) => BaseChoice::One(name(base)?),
            Self::NearestOf(bases) => {
                BaseChoice::NearestOf(bases.into_iter().map(name).collect::<Result<_, E>>()?)
            }
            Self::Nearest => BaseChoice::Nearest,
        })
    }
}

impl<B> From<Option<B>> for BaseChoice<B> {
    fn from(base: Option<B>) -> Self {
        base.map_or(Self::None, Self::One)
    }
}

/// The base that an epoch was solved with, and the numbers of the base epochs that were new then.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BaseUse {
    /// Primary key of the base.
    pub base: BaseKey,
    /// Number before the first base epoch that the estimator received.
    pub after: u64,
    /// Number of the last base epoch that it received; equal to `after` if it received none, and
    /// zero if it never received any.
    pub through: u64,
}

/// A base to store.
#[derive(Clone, Copy, Debug)]
pub(crate) struct NewBaseRow<'a> {
    /// Tenant that owns the base.
    pub(crate) tenant: &'a Tenant,
    /// Public id.
    pub(crate) id: &'a str,
    /// A name for people.
    pub(crate) label: &'a str,
    /// Position and antenna, if they are known.
    pub(crate) site: Option<&'a BaseSite>,
    /// The caster's stream that fills it.
    pub(crate) feed: Option<&'a BaseFeed>,
    /// The address of the archive's files that fill it.
    pub(crate) archive: Option<&'a str>,
    /// When it is created (ms since 1970-01-01 UTC).
    pub(crate) created_unix_ms: i64,
    /// The named request that creates it.
    pub(crate) request: Option<&'a NamedRequest>,
    /// The frame of its coordinates, if it is known.
    pub(crate) frame: Option<CoordinateFrame>,
}

/// A stored base.
#[derive(Clone, Debug, PartialEq)]
pub struct BaseRow {
    /// Primary key of the base.
    pub key: BaseKey,
    /// Tenant that owns the base.
    pub tenant: Tenant,
    /// Public id of the base.
    pub id: String,
    /// A name for people.
    pub label: String,
    /// When it was created (ms since 1970-01-01 UTC).
    pub created_unix_ms: i64,
    /// Position and antenna, each with the number of the first base epoch for which it is valid.
    pub sites: Vec<(u64, BaseSite)>,
    /// The caster's stream that fills it.
    pub feed: Option<BaseFeed>,
    /// The address of the archive's files that fill it.
    pub archive: Option<String>,
    /// The named request that created it.
    pub request: Option<NamedRequest>,
    /// The frame of its coordinates, if it is known.
    pub frame: Option<CoordinateFrame>,
}

/// An encoded epoch of a base.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StoredBaseEpoch {
    /// Its number: epochs of a base are numbered from 1 in order of time.
    pub number: u64,
    /// Its time tag.
    pub time: GpsTime,
    content: Arc<[u8]>,
}

impl StoredBaseEpoch {
    /// Encodes an epoch.
    pub fn new(number: u64, epoch: &Epoch) -> Self {
        Self { number, time: epoch.time, content: encode_epoch(epoch).into() }
    }

    /// The epoch of a row.
    ///
    /// # Errors
    /// The stored bytes are corrupt.
    pub(super) fn of_row(number: i64, ns: i64, content: Vec<u8>) -> Result<Self, StoreError> {
        let (number, time) = (number as u64, GpsTime::from_ns(ns));
        let stored = Self { number, time, content: content.into() };
        stored.epoch().map(|_| stored)
    }

    /// Decodes the epoch.
    ///
    /// # Errors
    /// The stored bytes are corrupt.
    pub(crate) fn epoch(&self) -> Result<Epoch, StoreError> {
        decode_epoch(&self.content).map_err(StoreError::corrupt("base epoch"))
    }

    /// Whether `other` has the same time tag and observations, bit by bit.
    pub(crate) fn is(&self, other: &Self) -> bool {
        // Bytes of different layouts can encode equal epochs, so both are decoded and encoded
        // again.
        let whole = |stored: &Self| stored.epoch().map(|epoch| encode_epoch(&epoch));
        self.content == other.content
            || self.content.first() != other.content.first()
                && whole(self).is_ok_and(|own| whole(other).is_ok_and(|other| own == other))
    }

    /// The same epoch under another number.
    #[must_use]
    pub(crate) fn numbered(&self, number: u64) -> Self {
        Self { number, ..self.clone() }
    }

    /// Size of the encoded epoch (bytes).
    pub(crate) fn size(&self) -> usize {
        self.content.len()
    }
}

/// The changes of one push to a base.
#[derive(Clone, Debug)]
pub struct BaseChange<'a> {
    /// A new position and antenna, with the number of the first epoch for which it is valid.
    pub site: Option<(u64, &'a BaseSite)>,
    /// New epochs.
    pub epochs: &'a [StoredBaseEpoch],
    /// Epochs numbered below this are deleted.
    pub first_kept: u64,
    /// Time of the push (ms since 1970-01-01 UTC).
    pub stored_unix_ms: i64,
}

#[derive(sqlx::FromRow)]
struct RawSite {
    base: i64,
    since: i64,
    x_m: f64,
    y_m: f64,
    z_m: f64,
    height_m: f64,
    east_m: f64,
    north_m: f64,
    antenna: String,
    source: String,
    calibration: Option<String>,
}

impl RawSite {
    /// The site. `kept` contains the calibrations by hash.
    fn parse(
        self,
        kept: &BTreeMap<String, Arc<AntennaCalibration>>,
    ) -> Result<(u64, BaseSite), StoreError> {
        let source = PositionSource::from_name(&self.source).ok_or_else(|| {
            let why = format!("{:?} is not a source of a position", self.source);
            StoreError::CorruptText { what: "base", why }
        })?;
        let calibration = self.calibration.map(|hash| {
            let known = kept.get(&hash).cloned();
            let why = format!("no calibration has the hash {hash:?}");
            known.ok_or(StoreError::CorruptText { what: "antenna calibration", why })
        });
        let site = BaseSite {
            marker: Ecef::new(self.x_m, self.y_m, self.z_m),
            antenna_delta_hen_m: [self.height_m, self.east_m, self.north_m],
            antenna: self.antenna,
            calibration: calibration.transpose()?,
            source,
        };
        Ok((self.since as u64, site))
    }
}

/// The previous site is replaced if no epoch was observed with it.
const UPSERT_SITE: &str = "INSERT INTO base_sites
    (base, since, x_m, y_m, z_m, height_m, east_m, north_m, antenna, source, calibration)
    VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9, $10, $11)
    ON CONFLICT (base, since) DO UPDATE SET x_m = excluded.x_m, y_m = excluded.y_m,
    z_m = excluded.z_m, height_m = excluded.height_m, east_m = excluded.east_m,
    north_m = excluded.north_m, antenna = excluded.antenna, source = excluded.source,
    calibration = excluded.calibration";
const INSERT_EPOCH: &str = "INSERT INTO base_epochs
    (base, number, gps_time_ns, stored_unix_ms, content) VALUES ($1, $2, $3, $4, $5)";
const FORGET: &str = "DELETE FROM base_epochs WHERE base = $1 AND number < $2";
/// Locks the row of the leader while its fence is this one, so that no other node takes the lead.
const LEADS: &str = "SELECT fence FROM leader WHERE fence = $1 FOR SHARE";

/// Binds the columns of a site after the key of its base.
macro_rules! site {
    ($base:expr, $since:expr, $site:expr) => {{
        let BaseSite { marker: Ecef(marker), antenna_delta_hen_m: delta, antenna, .. } = $site;
        sqlx::query(UPSERT_SITE)
            .bind($base.0)
            .bind($since as i64)
            .bind(marker.x)
            .bind(marker.y)
            .bind(marker.z)
            .bind(delta[0])
            .bind(delta[1])
            .bind(delta[2])
            .bind(antenna)
            .bind($site.source.name())
            .bind($site.calibration.as_deref().map(calibration_hash))
    }};
}

#[derive(sqlx::FromRow)]
struct RawBase {
    key: i64,
    id: String,
    label: String,
    created_unix_ms: i64,
    archive: Option<String>,
    tenant: String,
    request_name: Option<String>,
    request_hash: Option<String>,
    frame: Option<String>,
    frame_epoch_year: Option<f64>,
}

impl RawBase {
    /// The base without its sites and its feed.
    fn parse(self) -> Result<BaseRow, StoreError> {
        let frame = self.frame.map(|name| {
            let why = format!("{name:?} is not a known frame");
            let known = CoordinateFrame::named(&name, self.frame_epoch_year);
            known.ok_or(StoreError::CorruptText { what: "base", why })
        });
        let request = self.request_name.zip(self.request_hash);
        Ok(BaseRow {
            key: BaseKey(self.key),
            tenant: Tenant::stored(&self.tenant),
            id: self.id,
            label: self.label,
            created_unix_ms: self.created_unix_ms,
            sites: Vec::new(),
            feed: None,
            archive: self.archive,
            request: request.map(|(name, hash)| NamedRequest { name, hash }),
            frame: frame.transpose()?,
        })
    }
}

impl Store {
    /// Stores a new base of a tenant, and writes the entry of the audit log.
    ///
    /// # Errors
    /// The database fails. An existing id is such a failure.
    pub(crate) async fn create_base(
        &self,
        new: &NewBaseRow<'_>,
        entry: Option<&AuditEntry>,
    ) -> Result<BaseKey, StoreError> {
        let NewBaseRow { tenant, id, label, site, feed, archive, created_unix_ms, .. } = *new;
        let NewBaseRow { request, frame, .. } = *new;
        self.keep_calibration_of(site).await?;
        let created = writing!(&self.pool, pool => {
            let created = async {
                let mut transaction = pool.begin().await?;
                let sql = "INSERT INTO bases (id, label, created_unix_ms, archive, tenant,
                                              request_name, request_hash, frame,
                                              frame_epoch_year)
                           VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9) RETURNING key";
                let insert = sqlx::query_as(sql).bind(id).bind(label).bind(created_unix_ms);
                let insert = insert.bind(archive).bind(tenant.name());
                let insert = insert.bind(request.map(|request| &*request.name));
                let insert = insert.bind(request.map(|request| &*request.hash));
                let insert = insert.bind(frame.map(|frame| frame.name));
                let insert = insert.bind(frame.and_then(|frame| frame.epoch_year));
                let (key,): (i64,) = insert.fetch_one(&mut *transaction).await?;
                let key = BaseKey(key);
                if let Some(site) = site {
                    site!(key, 1_u64, site).execute(&mut *transaction).await?;
                }
                if let Some(feed) = feed {
                    feed!(key, feed, &self.secrets).execute(&mut *transaction).await?;
                }
                note!(self, transaction, entry);
                notify!(self, transaction, Change::Bases);
                transaction.commit().await?;
                Ok::<BaseKey, sqlx::Error>(key)
            };
            created.await
        });
        created.map_err(StoreError::database("storing a base"))
    }

    /// All bases that were not deleted, in order of key.
    ///
    /// # Errors
    /// The database fails, or a row is corrupt.
    pub(crate) async fn bases(&self) -> Result<Vec<BaseRow>, StoreError> {
        let failed = "reading bases";
        let rows: Result<Vec<RawBase>, _> = reading!(&self.pool, pool => {
            let sql = "SELECT key, id, label, created_unix_ms, archive, tenant, request_name,
                              request_hash, frame, frame_epoch_year
                       FROM bases WHERE deleted_unix_ms IS NULL ORDER BY key";
            sqlx::query_as(sql).fetch_all(pool).await
        });
        let sites: Result<Vec<RawSite>, _> = reading!(&self.pool, pool => {
            let sql = "SELECT * FROM base_sites
                       WHERE base IN (SELECT key FROM bases WHERE deleted_unix_ms IS NULL)
                       ORDER BY base, since";
            sqlx::query_as(sql).fetch_all(pool).await
        });
        let kept = self.calibrations().await?;
        let feeds: Result<Vec<RawFeed>, _> = reading!(&self.pool, pool => {
            sqlx::query_as("SELECT * FROM base_feeds").fetch_all(pool).await
        });
        let rows = rows.map_err(StoreError::database(failed))?;
        let mut bases: Vec<BaseRow> =
            rows.into_iter().map(RawBase::parse).collect::<Result<_, _>>()?;
        for site in sites.map_err(StoreError::database(failed))? {
            if let Ok(index) = bases.binary_search_by_key(&site.base, |base| base.key.0) {
                bases[index].sites.push(site.parse(&kept)?);
            }
        }
        for feed in feeds.map_err(StoreError::database(failed))? {
            if let Ok(index) = bases.binary_search_by_key(&feed.base, |base| base.key.0) {
                bases[index].feed = Some(feed.parse(&self.secrets)?);
            }
        }
        Ok(bases)
    }

    /// Stores all these changes of a base, or none. The transaction takes the turn of the writer,
    /// so a long push is stored in several.
    ///
    /// # Errors
    /// Another node leads the cluster, or the database fails. Nothing may then be considered
    /// stored.
    pub(crate) async fn push_base(
        &self,
        base: BaseKey,
        change: &BaseChange<'_>,
    ) -> Result<(), StoreError> {
        self.keep_calibration_of(change.site.map(|(_, site)| site)).await?;
        let pushed = writing!(&self.pool, pool => {
            let pushed = async {
                let mut transaction = pool.begin().await?;
                if let Some(fence) = self.fence() {
                    let leads = sqlx::query_scalar(LEADS).bind(fence);
                    let leads: Option<i64> = leads.fetch_optional(&mut *transaction).await?;
                    if leads.is_none() {
                        return Ok(Err(StoreError::NotLeader));
                    }
                }
                if let Some((since, site)) = change.site {
                    site!(base, since, site).execute(&mut *transaction).await?;
                }
                for epoch in change.epochs {
                    sqlx::query(INSERT_EPOCH)
                        .bind(base.0)
                        .bind(epoch.number as i64)
                        .bind(epoch.time.as_ns())
                        .bind(change.stored_unix_ms)
                        .bind(&epoch.content[..])
                        .execute(&mut *transaction)
                        .await?;
                }
                let forget = sqlx::query(FORGET).bind(base.0).bind(change.first_kept as i64);
                forget.execute(&mut *transaction).await?;
                notify!(self, transaction, Change::Bases);
                transaction.commit().await.map(Ok)
            };
            pushed.await
        });
        pushed.map_err(StoreError::database("storing a base's epochs"))?
    }

    /// Stores the calibration of a site's antenna, if it has one.
    async fn keep_calibration_of(&self, site: Option<&BaseSite>) -> Result<(), StoreError> {
        match site.and_then(|site| site.calibration.as_deref()) {
            Some(calibration) => self.keep_calibration(calibration).await,
            None => Ok(()),
        }
    }
}
