//! Tests whether another position explains the pseudoranges better than the estimate does.
//!
//! [`rivalry`] searches pooled residuals for the likeliest other position. [`Watch`] decides when
//! to search and when to move.

mod evidence;
mod hypotheses;
mod watch;

pub(crate) use evidence::{Knowledge, Offset, Pooled};
pub(crate) use hypotheses::{Rivalry, rivalry};
pub(crate) use watch::{Movable, POOL_S, SPACING_S, Verdict, Watch};
