//! The desk where estimation, aiding and storage meet. One task owns one session.
//!
//! The doors call [`Sessions`]. The epochs of a push wait in their session's bounded mailbox. The
//! session's task takes all waiting pushes as one batch, positions it on the solver pool, and
//! commits epochs and solutions in one transaction. Only after the commit it replaces its estimator
//! by the new state, and answers. So everything that is acknowledged is durable.
//!
//! # Order and overlap
//! Pushes enter a mailbox in the order of the [`Sessions::enqueue`] calls, and are answered in this
//! order. Within one session nothing overlaps: the next batch starts from the committed state of
//! the previous one, so no answer depends on an epoch that a crash could lose. A client that
//! pipelines its pushes loses no throughput, because all pushes that wait during a commit form the
//! next batch. Different sessions overlap: while one waits for its commit, others are estimated,
//! and one transaction of the store commits many of them.
//!
//! # State and reproducibility
//! A session's state is the state of its estimator. It is stored every 256 epochs, in the same
//! transaction as the epochs, or earlier if computing them again would take too long. A session
//! that is parked leaves its encoded state in memory, up to a limit, and continues from it. To
//! restore a state from the store, the epochs stored since then are replayed, each with the
//! configuration and navigation data of its solution. So the state after a crash is the same bit by
//! bit, and so are all later solutions. An epoch with another configuration than the previous one
//! starts a new estimator, both originally and in replay.
//!
//! # Revisions
//! Revision 0 is the immediate answer. When an epoch leaves the window, it is answered again,
//! smoothed by later epochs: this is revision 1, committed together with the epoch that pushed it
//! out. When the session is closed or its configuration changes, the epochs in the window get their
//! revision 1.
//!
//! # Failures
//! A failed commit acknowledges nothing, and the session continues from the state before it. A
//! commit that failed during `COMMIT` may still have succeeded. Then the task keeps both states,
//! and asks the store before the next batch which of them is valid. Clients send the epochs again;
//! the stored ones are answered from the store.
//!
//! # Deletion
//! A deleted session is closed first and then not found any more. Its epochs and solutions are
//! removed in the background, a few hundred in a transaction, and after a restart too. Its id is
//! never used again.
//!
//! # Retention
//! A session may keep its epochs for a limited number of days. It then keeps the first snapshot of
//! each day after the one on which it began. Every hour its epochs are removed, in the same small
//! steps, through the newest kept snapshot that is older than the retention. So all that remains
//! can be replayed, from this snapshot on. A removed epoch that is sent again is refused as already
//! acknowledged.
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
//!     antenna: String::new(),
//!     retention_days: None,
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

mod answers;
mod antenna;
mod base_selection;
mod batch;
mod changing;
mod checks;
mod closing;
mod computation;
mod configuration;
mod configurations;
mod counters;

mod desk;
mod error;
mod explanation;
mod history;
mod info;
mod limits;
mod live;
mod locks;
mod moving;
mod observed;
mod panics;
mod parked;

mod raw;
mod reading;
mod recomputation;
mod removal;
mod replay;
mod rerun;
mod residuals;
mod series;
mod solve;
mod solvers;
mod starting;
mod state;
mod streamed;
mod submission;
mod task;
mod tasks;
mod update_rates;
mod updates_to_confirm;
mod watching;

pub use crate::store::SessionHead;
pub use answers::Answers;
pub use computation::Computed;
pub use counters::Counters;
pub use desk::Sessions;
pub use error::SessionError;
pub use explanation::{EpochExplanation, SatelliteRole, SatelliteView};
pub use history::{FleetHistory, HistoryQuery, Intervals, SessionHistory};
pub use info::{NewSession, SessionId, SessionInfo, SessionKind, SessionUpdate, SolutionPage};
pub use limits::SessionLimits;
pub use live::{Watch, WatchEvent};
pub use observed::ObservedEpochs;
pub use raw::{RawChunk, RawReceived};
pub use recomputation::{Check, Recomputation};
pub use rerun::{Rerun, RerunPlan, RerunRequest};
pub use residuals::{EpochResiduals, RESIDUAL_POINTS, ResidualQuery};
pub use series::{Interval, Range, SERIES_POINTS, SeriesQuery, SolutionSeries};
pub use solve::{Burst, SolveRequest};
pub use solvers::{BATCH_QUANTUM, BatchLane, BatchTurn};
pub use streamed::StreamedPush;
pub use submission::{
    Acknowledged, EpochOutcome, EpochRefusal, Pending, SEQUENCES, SequencedEpoch, Submitted,
};
pub use watching::{WatchCursor, WatchPage};
