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
//!
//! # Example
//!
//! ```
//! # #[tokio::main] async fn main() -> Result<(), Box<dyn std::error::Error>> {
//! # let folder = tempfile::tempdir()?;
//! # let url = format!("sqlite://{}", folder.path().join("graphfix.db").display());
//! use graphfix::aiding::bases::BaseChoice;
//! use graphfix::aiding::{AidingDesk, AidingLimits};
//! use graphfix::session::{NewSession, SequencedEpoch, SessionLimits, Sessions};
//! use graphfix::simulation::{Scenario, Simulator};
//! use graphfix::store::Store;
//!
//! let store = Store::open(&url).await?;
//! let aiding = AidingDesk::open(store.clone(), AidingLimits::service()).await?;
//! let sessions = Sessions::open(store, aiding.clone(), SessionLimits::service());
//!
//! let receiver = Simulator::new(Scenario { duration_s: 5.0, ..Scenario::open_sky() }, 1);
//! aiding.navigation.push((**receiver.navigation()).clone(), "simulation").await?;
//! let new = NewSession {
//!     label: "a receiver".into(),
//!     mode: "fgo".into(),
//!     profile: "general".into(),
//!     overrides: Default::default(),
//!     base: BaseChoice::None,
//! };
//! let session = sessions.create(new).await?.id;
//!
//! let numbered = (1..).zip(receiver);
//! let epochs = numbered.map(|(seq, epoch)| SequencedEpoch { seq, epoch: epoch.rover }).collect();
//! let submitted = sessions.submit(&session, epochs).await?;
//! assert!(submitted.outcomes.iter().all(|outcome| outcome.result.is_ok()));
//! assert_eq!(submitted.durable_through, submitted.outcomes.last().map(|outcome| outcome.seq));
//! sessions.drain().await;
//! # Ok(()) }
//! ```

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
