//! The casters' streams that fill bases.

use std::fmt;

use crate::gnss::{Ecef, GpsTime};
use crate::secrets::{Secrets, SecretsError, StoredSecret};

use super::StoreError;

/// A caster's stream that fills a base.
#[derive(Clone, PartialEq)]
pub struct BaseFeed {
    /// Address of the caster, such as `ntrip://caster.example.org:2101`.
    pub caster: String,
    /// Name of the stream.
    pub mountpoint: String,
    /// User at the caster; empty for none.
    pub name: String,
    /// Password at the caster. It is never shown.
    pub password: String,
    /// NTRIP version, 1 or 2.
    pub version: u8,
    /// A time within half a day of the stream's first message, for a recorded stream.
    pub near: Option<GpsTime>,
    /// The rovers' position, for casters that compute the stream for a position.
    pub position: Option<Ecef>,
    /// Report the last position of the base's rovers to such a caster.
    pub follows_rover: bool,
    /// A network's sourcetable lists the stream. It is requested only while a rover needs it.
    pub is_on_demand: bool,
}

impl fmt::Debug for BaseFeed {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { caster, mountpoint, name, .. } = self;
        write!(f, "BaseFeed({name}@{caster}/{mountpoint})")
    }
}

#[derive(sqlx::FromRow)]
pub(super) struct RawFeed {
    pub(super) base: i64,
    caster: String,
    mountpoint: String,
    name: String,
    password: String,
    password_key: Option<String>,
    version: i32,
    near_ns: Option<i64>,
    x_m: Option<f64>,
    y_m: Option<f64>,
    z_m: Option<f64>,
    follows_rover: i32,
    on_demand: i32,
}

impl RawFeed {
    /// The feed. If the key of its password is unknown, the password is empty: this is so in a
    /// command beside a service, which connects to no caster. A service has all keys
    /// (`Store::reseal`).
    pub(super) fn parse(self, secrets: &Secrets) -> Result<BaseFeed, StoreError> {
        let stored = StoredSecret { text: self.password, key: self.password_key };
        let password = match secrets.unseal(&password_owner(self.base), &stored) {
            Err(SecretsError::KeyUnknown { .. }) => String::new(),
            password => password?,
        };
        let version = u8::try_from(self.version).map_err(|_| StoreError::CorruptText {
            what: "feed",
            why: format!("{} is not a version of NTRIP", self.version),
        })?;
        let position = self.x_m.zip(self.y_m).zip(self.z_m);
        Ok(BaseFeed {
            caster: self.caster,
            mountpoint: self.mountpoint,
            name: self.name,
            password,
            version,
            near: self.near_ns.map(GpsTime::from_ns),
            position: position.map(|((x, y), z)| Ecef::new(x, y, z)),
            follows_rover: self.follows_rover != 0,
            is_on_demand: self.on_demand != 0,
        })
    }
}

/// Name of the owner of a password, so that the password can be opened for this base only.
pub(super) fn password_owner(base: i64) -> String {
    format!("base {base}")
}

pub(super) const INSERT_FEED: &str = "INSERT INTO base_feeds
    (base, caster, mountpoint, name, password, version, near_ns, x_m, y_m, z_m,
     follows_rover, on_demand, password_key)
    VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9, $10, $11, $12, $13)";

/// Binds a feed after the key of its base, with its password sealed by these secrets.
macro_rules! feed {
    ($base:expr, $feed:expr, $secrets:expr) => {{
        let owner = $crate::store::feeds::password_owner($base.0);
        let password = $secrets.seal(&owner, &$feed.password);
        let axis = |axis: usize| $feed.position.map(|position| position.0[axis]);
        sqlx::query($crate::store::feeds::INSERT_FEED)
            .bind($base.0)
            .bind(&$feed.caster)
            .bind(&$feed.mountpoint)
            .bind(&$feed.name)
            .bind(password.text)
            .bind(i32::from($feed.version))
            .bind($feed.near.map(crate::gnss::GpsTime::as_ns))
            .bind(axis(0))
            .bind(axis(1))
            .bind(axis(2))
            .bind(i32::from($feed.follows_rover))
            .bind(i32::from($feed.is_on_demand))
            .bind(password.key)
    }};
}
pub(super) use feed;
