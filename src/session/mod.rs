//! The desk where estimation, aiding and storage meet. One task owns one session.
//!
//! [`Sessions`] is what the doors call. A batch of epochs waits in its session's bounded mailbox;
//! the session's task positions it in one piece on the solver pool, commits epochs and solutions
//! together, and only then keeps the estimator's new state and answers. What is acknowledged is
//! durable.
//!
//! # Order, and what overlaps
//! Batches enter a mailbox in the order of the [`Sessions::enqueue`] calls and are answered in it.
//! Within a session nothing overlaps: the next piece is positioned from the committed state of the
//! one before, so no answer ever rests on an epoch that a crash could lose. A pipelining client
//! loses nothing by this, for all batches that wait while one piece is committed form the next
//! piece. Sessions overlap freely: while one waits for its commit, others estimate, and one
//! transaction of the store commits them all.
//!
//! # State, and the same bits
//! A session's state is what its estimator remembers. It is stored in the transaction of every
//! 256th epoch or so, and when the session is parked; what came since is replayed onto it, each
//! epoch with the configuration and the navigation data it was solved with. So the state after a
//! crash, and every later solution, is the same bit by bit. An epoch whose configuration differs
//! from that of the epoch before starts the estimator anew, in replay as it did then.
//!
//! # Revisions
//! Revision 0 is the answer at once. An epoch that leaves the window is answered again, smoothed by
//! what came after it: revision 1, committed together with the epoch that pushed it out. What the
//! window holds when the session is closed, or when its configuration changes, is answered then.
//!
//! # What can fail
//! A failed commit acknowledges nothing, and as its fate may be unknown (a connection lost during
//! `COMMIT`), the task forgets its state and restores it from the store before the next piece.
//! Clients resend; what had been stored after all is answered from the store.

mod configuration;
mod course;
mod desk;
mod error;
mod info;
mod limits;
mod piece;
mod raw;
mod recomputation;
mod replay;
mod solve;
mod solvers;
mod state;
mod submission;
mod task;

pub use desk::Sessions;
pub use error::SessionError;
pub use info::{NewSession, SessionId, SessionInfo, SessionKind, SessionUpdate};
pub use limits::SessionLimits;
pub use raw::{RawPiece, RawReceived};
pub use recomputation::{Check, Recomputation};
pub use solve::{Burst, Computed, SolveRequest};
pub use submission::{
    Acknowledged, EpochOutcome, EpochRefusal, Pending, SequencedEpoch, Submitted,
};
