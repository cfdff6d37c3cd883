//! One stored epoch with the satellites and residuals that explain its answer.

use std::sync::Arc;

use crate::aiding::rover_source;
use crate::config::{OutputOptions, PositioningOptions};
use crate::gnss::{Epoch, Navigation};
use crate::positioning::satellite_views;
use crate::store::{StoreError, StoredEpoch, StoredSolution};

use super::configuration::{kept_options, output};
use super::desk::Sessions;
use super::solvers::Lane;
use super::{SessionError, SessionId};

pub use crate::positioning::{SatelliteRole, SatelliteView};

/// A stored epoch with its solutions, and its satellites at the position of the first solution.
#[derive(Clone, Debug, PartialEq)]
pub struct EpochExplanation {
    /// The epoch as received.
    pub epoch: Epoch,
    /// All revisions of its solution.
    pub solutions: Vec<StoredSolution>,
    /// The observed satellites, in the order of the epoch.
    pub satellites: Vec<SatelliteView>,
    /// Frame and heights in which the solutions are reported.
    pub output: OutputOptions,
}

impl Sessions {
    /// Explains a stored epoch, or the last one if `None`. It uses the ephemerides with which the
    /// epoch was solved, or the present ones if those are no longer stored.
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
            Some(seq) => self.store().listed_epochs_after(row.key, seq.checked_sub(1), 1).await?,
        };
        let stored = stored.into_iter().next();
        let stored = match (seq, stored) {
            (None, None) => return Err(SessionError::Empty { id: id.to_string() }),
            (None, Some(last)) => last,
            (Some(seq), found) => found
                .filter(|found| found.solution.seq == seq)
                .ok_or_else(|| SessionError::NoSuchEpoch { id: id.to_string(), seq })?,
        };
        let solutions = self.store().solutions_of(row.key, stored.solution.seq).await?;
        let satellites = Explaining::of(self, id).satellites(&stored).await?;
        let (epoch, output) = (stored.epoch, output(&row.settings)?);
        Ok(EpochExplanation { epoch, solutions, satellites, output })
    }
}

/// Computes the satellites of a session's epochs at the answered positions. It keeps the
/// ephemerides and options of the last epoch, which are usually also those of the next one.
pub(super) struct Explaining<'a> {
    sessions: &'a Sessions,
    device: Arc<str>,
    /// The ephemerides, with the number of their push.
    navigation: Option<(u64, Arc<Navigation>)>,
    /// The options, with the hash of their configuration.
    options: Option<(Arc<str>, PositioningOptions)>,
}

impl<'a> Explaining<'a> {
    pub(super) fn of(sessions: &'a Sessions, id: &SessionId) -> Self {
        let device = rover_source(sessions.tenant(), id.as_str());
        Self { sessions, device, navigation: None, options: None }
    }

    /// The observed satellites of an epoch, in its order, at the position of its first answer.
    ///
    /// # Errors
    /// The store fails, or the computation.
    pub(super) async fn satellites(
        &mut self,
        stored: &StoredEpoch,
    ) -> Result<Vec<SatelliteView>, SessionError> {
        let navigation = self.navigation(stored.navigation).await?;
        let hash = &stored.solution.configuration_hash;
        let options = match self.options.take().filter(|(of, _)| of == hash) {
            Some((_, options)) => options,
            None => kept_options(&self.sessions.store().configuration(hash).await?)?,
        };
        let (_, options) = self.options.insert((hash.clone(), options));
        let (epoch, answer) = (stored.epoch.clone(), stored.solution.solution.clone());
        let options = options.clone();
        let work = move || satellite_views(&epoch, &answer, &navigation, &options);
        self.sessions.solvers().run(Lane::OnDemand, work).await
    }

    /// The ephemerides after a push, or the present ones if those are no longer stored.
    async fn navigation(&mut self, push: u64) -> Result<Arc<Navigation>, SessionError> {
        if let Some((_, navigation)) = self.navigation.as_ref().filter(|(of, _)| *of == push) {
            return Ok(navigation.clone());
        }
        let desk = &self.sessions.aiding().navigation;
        let found = match desk.after(push, &self.device).await {
            Err(StoreError::NavigationForgotten { .. }) => desk.current_for(&self.device),
            found => found?,
        };
        self.navigation = Some((push, found.navigation.clone()));
        Ok(found.navigation)
    }
}
