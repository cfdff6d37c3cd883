//! The options and bases of sessions. Options are prepared once for all sessions that share them.

use std::collections::{BTreeMap, HashMap};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::aiding::AidingDesk;
use crate::aiding::bases::BaseChoice;
use crate::gnss::AntennaCalibration;
use crate::positioning::PreparedOptions;
use crate::store::{SessionRow, SessionSettings};

use super::SessionError;
use super::configuration::{base_of, stored_options};
use super::state::{Configuration, VERSION};

/// Configurations that are kept. When there would be more, all are forgotten.
const KEPT: usize = 256;

/// The options and bases for new epochs.
#[derive(Clone, Debug)]
pub(super) struct ActiveConfiguration {
    pub(super) estimation: Configuration,
    /// The bases, if the mode is relative to one.
    pub(super) bases: BaseChoice,
    /// The session is closed and takes no more epochs.
    pub(super) is_closed: bool,
    /// For how long epochs are kept (days); 0 for ever, `None` as the service is configured.
    pub(super) retention_days: Option<u32>,
}

/// Configurations in use. Reading the options from texts and preparing them takes as long as an
/// epoch, and a fleet has few of them. Clones share them.
#[derive(Clone, Debug, Default)]
pub(super) struct Configurations(Arc<Mutex<HashMap<Key, Known>>>);

/// The hash of a configuration, and the mode and profile, from which options have their values that
/// were unknown when it was stored.
type Key = (Arc<str>, String, String);

/// A configuration with the stored options it was prepared from: those of what is given out of a
/// session, such as its frame, are not in the hash.
#[derive(Debug)]
struct Known {
    options: BTreeMap<String, String>,
    prepared: Configuration,
}

impl Configurations {
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
        let mut known = self.known();
        if KEPT <= known.len() {
            known.clear();
        }
        let options = settings.configuration.clone();
        known.insert(key, Known { options, prepared: configuration.clone() });
        Ok(configuration)
    }

    fn known(&self) -> MutexGuard<'_, HashMap<Key, Known>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The stored calibration of a hash, if there is one.
pub(super) async fn calibration(
    aiding: &AidingDesk,
    hash: Option<&str>,
) -> Result<Option<Arc<AntennaCalibration>>, SessionError> {
    match hash {
        Some(hash) => Ok(Some(aiding.antennas.kept(hash).await?)),
        None => Ok(None),
    }
}
