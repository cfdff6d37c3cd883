//! The desk for what positions need beside the rover's own observations: uploads and feeds fill
//! it, sessions ask it.
//!
//! [`NavigationBroker`] holds all navigation data in memory as one snapshot that readers share and
//! never wait for; a push builds the next snapshot, commits what is new, and only then shows it.
//! [`BaseBroker`] does the same for base stations and their epochs.

pub mod bases;
mod broker;
mod error;
mod limits;

pub use bases::BaseBroker;
pub use broker::{
    NavigationBroker, NavigationPush, NavigationStatus, PushedNavigation, SatelliteCoverage,
};
pub use error::AidingError;
pub use limits::AidingLimits;

use crate::store::Store;

/// Both brokers. Clones share them.
#[derive(Clone)]
pub struct AidingDesk {
    /// Of broadcast ephemerides.
    pub navigation: NavigationBroker,
    /// Of base stations.
    pub bases: BaseBroker,
}

impl AidingDesk {
    /// Opens the desk with what the store holds.
    ///
    /// # Errors
    /// The store fails, or a row is corrupt.
    pub async fn open(store: Store, limits: AidingLimits) -> Result<Self, AidingError> {
        let navigation = NavigationBroker::open(store.clone(), limits.clone()).await?;
        let bases = BaseBroker::open(store, navigation.clone(), limits).await?;
        Ok(Self { navigation, bases })
    }
}
