//! Whether pseudoranges are better explained by another position than the estimate's.
//!
//! [`rivalry`] looks for the likeliest other position in residuals that were gathered; [`Watch`]
//! decides when to look and when to move.

mod hypotheses;
mod watch;

pub(crate) use hypotheses::{Knowledge, Offset, Pooled, Rivalry, rivalry};
pub(crate) use watch::{POOL_S, Verdict, Watch};
