//! The desk for what satellites broadcast: uploads and feeds fill it, sessions ask it.
//!
//! [`NavigationBroker`] holds all navigation data in memory as one snapshot that readers share and
//! never wait for; a push builds the next snapshot, commits what is new, and only then shows it.

mod broker;
mod error;

pub use broker::{
    AidingLimits, NavigationBroker, NavigationPush, NavigationStatus, PushedNavigation,
    SatelliteCoverage,
};
pub use error::AidingError;
