//! Quotas of tenants: the limits of each tenant, and its use.
//!
//! A tenant may have a quota of sessions, of epochs per second, of processor time of the solvers
//! per minute, and of stored bytes. The [`Meter`] of a tenant counts in memory, so that an epoch
//! costs no statement. Code that accepts work for the tenant asks the meter first. [`TenantQuotas`]
//! copies the quotas of the store into the meters, and reads changed quotas every 0.4 s.
//!
//! Epochs and processor time are measured over a window (`window`). Work that has begun is
//! finished, and the next request has to wait longer. Stored bytes are approximate: the encoded
//! epochs and solutions, without the database's own structures, counted every ten seconds.

mod desk;
mod error;
mod meter;
mod window;

pub use desk::{Meters, StoredAmounts, TenantInfo, TenantQuotas};
pub use error::QuotaError;
pub use meter::{Meter, Rates};
