//! Quotas of tenants: what each may use, and what it uses.
//!
//! A tenant may have a quota of sessions, of epochs a second, of processor time of the solvers a
//! minute, and of stored bytes. The [`Meter`] of a tenant counts in memory, so that an epoch costs
//! no statement; who takes work for the tenant asks it before. [`TenantQuotas`] keeps the quotas of
//! the store in the meters, and reads those that were changed every 0.4 s.
//!
//! Epochs and processor time are measured over a window (`window`): what has begun is finished,
//! and the next request waits for longer. Stored bytes are approximate: the encoded epochs and
//! solutions, without the database's own structures, counted every ten seconds.

mod desk;
mod error;
mod meter;
mod window;

pub use desk::{Meters, TenantInfo, TenantQuotas};
pub use error::QuotaError;
pub use meter::{Meter, Rates};
