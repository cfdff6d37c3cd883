//! The desk for aiding: the ephemerides and base stations that positioning needs besides the
//! rover's own observations. Uploads and feeds fill it; sessions read it.
//!
//! [`NavigationBroker`] keeps all navigation data in memory. Readers share the present state and
//! never wait. A push builds the next state, commits what is new, and then replaces the present
//! state. [`BaseBroker`] does the same for base stations and their epochs.

pub mod bases;
mod error;
mod limits;
mod navigation;

pub use bases::BaseBroker;
pub use error::AidingError;
pub use limits::AidingLimits;
pub use navigation::{
    NavigationBroker, NavigationPush, NavigationStatus, PushedNavigation, SatelliteCoverage,
};

use crate::store::Store;

/// Both brokers. All clones share them.
#[derive(Clone)]
pub struct AidingDesk {
    /// Broadcast ephemerides.
    pub navigation: NavigationBroker,
    /// Base stations.
    pub bases: BaseBroker,
}

impl AidingDesk {
    /// Opens the desk with what the store has.
    ///
    /// # Errors
    /// The store fails, or a row is corrupt.
    pub async fn open(store: Store, limits: AidingLimits) -> Result<Self, AidingError> {
        let navigation = NavigationBroker::open(store.clone(), limits.clone()).await?;
        let bases = BaseBroker::open(store, navigation.clone(), limits).await?;
        Ok(Self { navigation, bases })
    }
}
