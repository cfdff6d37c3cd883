//! The options and bases of sessions. Options are prepared once for all sessions that share them.

use std::collections::{BTreeMap, HashMap};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::aiding::AidingDesk;
use crate::aiding::bases::BaseChoice;
use crate::gnss::AntennaCalibration;
use crate::positioning::PreparedOptions;
use crate::store::{SessionRow, SessionSettings, Store};

use super::SessionError;
use super::configuration::{base_of, stored_options};
use super::state::{Configuration, VERSION};

/// Most configurations in memory. When it is exceeded, all are dropped.
const KEPT: usize = 256;

/// The options and bases for new epochs.
#[derive(Clone, Debug)]
pub(super) struct ActiveConfiguration {
    pub(super) estimation: Configuration,
    /// The bases, if the mode is relative to one.
    pub(super) bases: BaseChoice,
    /// The session is closed and takes no more epochs.
    pub(super) is_closed: bool,
    /// Time for which epochs are kept (days); 0 for ever, `None` for the service's setting.
    pub(super) retention_days: Option<u32>,
}

/// Configurations in use. To read the options from texts and to prepare them takes as long as to
/// position an epoch, and a fleet has few configurations. Clones share them.
#[derive(Clone, Debug, Default)]
pub(super) struct Configurations {
    known: Arc<Mutex<HashMap<Key, Known>>>,
    /// Where they are stored; `None` for computations whose results are not.
    store: Option<Store>,
}

/// The hash of a configuration, its mode and its profile. Mode and profile give the values of
/// options that did not exist when the configuration was stored.
type Key = (Arc<str>, String, String);

/// A prepared configuration, with the stored options from which it was made. The options are
/// compared because the hash does not cover output options, such as the frame.
#[derive(Debug)]
struct Known {
    options: BTreeMap<String, String>,
    prepared: Configuration,
}

impl Configurations {
    /// Configurations of sessions whose epochs are stored. Each is stored for replay before an
    /// epoch can be positioned with it. One that is never used is not stored, so that changes
    /// of settings take no space.
    pub(super) fn stored_in(store: Store) -> Self {
        Self { store: Some(store), ..Self::default() }
    }

    /// The options and bases for a session's next epochs.
    ///
    /// # Errors
    /// An option or base no longer exists, or the store fails.
    pub(super) async fn active(
        &self,
        aiding: &AidingDesk,
        row: &SessionRow,
    ) -> Result<ActiveConfiguration, SessionError> {
        let estimation = self.of(aiding, &row.settings).await?;
        let bases = base_of(estimation.options.mode, &row.settings.base)?;
        let retention_days = row.settings.retention_days;
        let is_closed = row.closed_unix_ms.is_some();
        Ok(ActiveConfiguration { estimation, bases, is_closed, retention_days })
    }

    async fn of(
        &self,
        aiding: &AidingDesk,
        settings: &SessionSettings,
    ) -> Result<Configuration, SessionError> {
        let SessionSettings { configuration_hash: hash, mode, profile, .. } = settings;
        let key = (hash.clone(), mode.clone(), profile.clone());
        if let Some(known) = self.known().get(&key)
            && known.options == settings.configuration
        {
            return Ok(known.prepared.clone());
        }
        let options = PreparedOptions::new(stored_options(settings)?);
        let antenna = settings.antenna.as_ref().map(|antenna| &*antenna.calibration);
        let antenna = calibration(aiding, antenna).await?;
        let configuration =
            Configuration { version: VERSION.into(), hash: hash.clone(), options, antenna };
        if let Some(store) = &self.store {
            store.keep_configuration(settings).await?;
        }
        let mut known = self.known();
        if KEPT <= known.len() {
            known.clear();
        }
        let options = settings.configuration.clone();
        known.insert(key, Known { options, prepared: configuration.clone() });
        Ok(configuration)
    }

    fn known(&self) -> MutexGuard<'_, HashMap<Key, Known>> {
        self.known.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The stored calibration with this hash, if the hash is given.
pub(super) async fn calibration(
    aiding: &AidingDesk,
    hash: Option<&str>,
) -> Result<Option<Arc<AntennaCalibration>>, SessionError> {
    match hash {
        Some(hash) => Ok(Some(aiding.antennas.kept(hash).await?)),
        None => Ok(None),
    }
}
