//! The desk for aiding: the ephemerides and base stations that positioning needs besides the
//! rover's own observations. Uploads and feeds fill it; sessions read it.
//!
//! [`NavigationBroker`] keeps all navigation data in memory. Readers share the present state and
//! never wait. A push builds the next state, commits what is new, and then replaces the present
//! state. [`BaseBroker`] does the same for base stations and their epochs.

mod antennas;
pub mod bases;
mod devices;
mod error;
mod limits;
mod navigation;
mod past;
mod shared;
mod state;
mod tenant_navigation;
mod trust;
mod views;

pub use antennas::Antennas;
pub use bases::BaseBroker;
pub use error::AidingError;
pub use limits::AidingLimits;
pub use navigation::{NavigationBroker, NavigationPush};
pub use navigation::{NavigationStatus, SatelliteCoverage};
pub use state::PushedNavigation;
pub use tenant_navigation::TenantNavigation;
pub use trust::{AGREED, UPLOAD, device};
pub(crate) use trust::{OF_BASE, rover_source, tenant_source};

use std::sync::Arc;

use crate::gnss::{AntennaCatalogue, Geoid};
use crate::store::Store;

/// Both brokers, the calibrations of antennas, and the table of the geoid. All clones share them.
#[derive(Clone)]
pub struct AidingDesk {
    /// Broadcast ephemerides.
    pub navigation: NavigationBroker,
    /// Base stations.
    pub bases: BaseBroker,
    /// Calibrations of antennas.
    pub antennas: Antennas,
    /// The operator's table of the geoid's heights.
    pub geoid: Option<Arc<Geoid>>,
}

impl AidingDesk {
    /// Opens the desk with the stored data, and without calibrations of antennas.
    ///
    /// # Errors
    /// The store fails, or a row is corrupt.
    pub async fn open(store: Store, limits: AidingLimits) -> Result<Self, AidingError> {
        Self::open_with(store, limits, AntennaCatalogue::default()).await
    }

    /// Opens the desk with the stored data and with calibrations of antennas. A base whose antenna
    /// is among them has that calibration from its next epoch on. In a cluster the leader sees to
    /// this when it takes the lead.
    ///
    /// # Errors
    /// The store fails, or a row is corrupt.
    pub async fn open_with(
        store: Store,
        limits: AidingLimits,
        catalogue: AntennaCatalogue,
    ) -> Result<Self, AidingError> {
        let antennas = Antennas::new(store.clone(), Arc::new(catalogue));
        let navigation = NavigationBroker::open(store.clone(), limits.clone()).await?;
        let bases = BaseBroker::open(store.clone(), navigation.clone(), antennas.clone(), limits);
        let bases = bases.await?;
        let is_alone = !store.is_of_cluster();
        let desk = Self { navigation, bases, antennas, geoid: None };
        if is_alone {
            desk.calibrate_bases().await?;
        }
        Ok(desk)
    }

    /// Gives each base whose antenna is in the catalogue that calibration, from its next epoch on.
    ///
    /// # Errors
    /// The store fails.
    pub(crate) async fn calibrate_bases(&self) -> Result<(), AidingError> {
        if !self.antennas.is_empty() {
            for id in self.bases.ids() {
                if let Some(site) = self.bases.site(&id)? {
                    self.bases.set_site(&id, &site).await?;
                }
            }
        }
        Ok(())
    }

    /// Reads from the store what other nodes of the cluster have stored.
    ///
    /// # Errors
    /// The store fails, or a row is corrupt.
    pub(crate) async fn follow(&self) -> Result<(), AidingError> {
        self.navigation.refresh().await?;
        self.bases.follow().await
    }

    /// The desk with a table of the geoid's heights.
    #[must_use]
    pub fn with_geoid(self, geoid: Option<Arc<Geoid>>) -> Self {
        Self { geoid, ..self }
    }
}
