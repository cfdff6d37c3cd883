//! One stored epoch with everything that explains its answer.

use crate::aiding::rover_source;
use crate::config::OutputOptions;
use crate::gnss::Epoch;
use crate::positioning::satellite_views;
use crate::store::{StoreError, StoredSolution};

use super::configuration::{kept_options, output};
use super::desk::Sessions;
use super::{SessionError, SessionId};

pub use crate::positioning::{SatelliteRole, SatelliteView};

/// A stored epoch with its solutions, and its satellites as the first of them sees them.
#[derive(Clone, Debug, PartialEq)]
pub struct EpochExplanation {
    /// The epoch as received.
    pub epoch: Epoch,
    /// All revisions of its solution.
    pub solutions: Vec<StoredSolution>,
    /// The observed satellites, in the order of the epoch.
    pub satellites: Vec<SatelliteView>,
    /// How the solutions are given out.
    pub output: OutputOptions,
}

impl Sessions {
    /// Explains a stored epoch; `None` for the last one. The ephemerides are those that it was
    /// solved with, or the present ones if those are no longer stored.
    ///
    /// # Errors
    /// No session has this id, it has no epoch of this number, or the store fails.
    pub async fn explain(
        &self,
        id: &SessionId,
        seq: Option<u64>,
    ) -> Result<EpochExplanation, SessionError> {
        let row = self.row(id).await?;
        let stored = match seq {
            None => self.store().last_epochs(row.key, 1).await?,
            Some(seq) => self.store().epochs_after(row.key, seq.checked_sub(1), 1).await?,
        };
        let stored = stored.into_iter().next();
        let stored = match (seq, stored) {
            (None, None) => return Err(SessionError::Empty { id: id.to_string() }),
            (None, Some(last)) => last,
            (Some(seq), found) => found
                .filter(|found| found.solution.seq == seq)
                .ok_or_else(|| SessionError::NoSuchEpoch { id: id.to_string(), seq })?,
        };
        let (navigation, device) =
            (&self.aiding().navigation, rover_source(self.tenant(), id.as_str()));
        let navigation = match navigation.after(stored.navigation, &device).await {
            Err(StoreError::NavigationForgotten { .. }) => navigation.current_for(&device),
            found => found?,
        };
        let hash = &stored.solution.configuration_hash;
        let options = kept_options(&self.store().configuration(hash).await?)?;
        let solutions = self.store().solutions_of(row.key, stored.solution.seq).await?;
        let answer = &stored.solution.solution;
        let satellites = satellite_views(&stored.epoch, answer, &navigation.navigation, &options);
        let (epoch, output) = (stored.epoch, output(&row.settings)?);
        Ok(EpochExplanation { epoch, solutions, satellites, output })
    }
}
