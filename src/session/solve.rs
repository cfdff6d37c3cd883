//! Positions on request, that nothing is stored of.

use std::collections::BTreeMap;
use std::sync::Arc;

use crate::config::PositioningOptions;
use crate::gnss::{Navigation, Solution};
use crate::positioning::{Aiding, Estimator};

use super::desk::Sessions;
use super::piece::VERSION;
use super::{SequencedEpoch, SessionError, SessionId, configuration};

/// How to solve a session's present window.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct SolveRequest {
    /// Estimator; `None`: the session's.
    pub mode: Option<String>,
    /// Profile; `None`: the session's.
    pub profile: Option<String>,
    /// Options that differ. Where neither mode nor profile is given they come on top of the
    /// session's configuration, otherwise on top of the profile.
    pub overrides: BTreeMap<String, String>,
}

/// A short run of epochs without a session.
#[derive(Clone, Debug, PartialEq)]
pub struct Burst {
    /// Estimator, as users write it.
    pub mode: String,
    /// Profile, as users write it.
    pub profile: String,
    /// Options that differ from the profile, by name.
    pub overrides: BTreeMap<String, String>,
    /// In order of time; the numbers are given back with the answers.
    pub epochs: Vec<SequencedEpoch>,
    /// Navigation data of its own, used together with what the service holds.
    pub navigation: Option<Navigation>,
}

/// A solution that is not stored.
#[derive(Clone, Debug, PartialEq)]
pub struct Computed {
    /// The epoch's number.
    pub seq: u64,
    /// The solution.
    pub solution: Solution,
    /// Version of the program that made it.
    pub version: Arc<str>,
    /// Hash of the configuration in force.
    pub configuration_hash: Arc<str>,
}

impl Sessions {
    /// Solves the session's present window, as committed, with any mode and options. The session
    /// goes on undisturbed and nothing is stored; with the session's own configuration and
    /// unchanged navigation data the answer is the stored one bit by bit.
    ///
    /// # Errors
    /// No such session, no epoch in it, a configuration that does not exist.
    pub async fn solve(
        &self,
        id: &SessionId,
        request: &SolveRequest,
    ) -> Result<Computed, SessionError> {
        let row = self.row(id).await?;
        let mut options = if request.mode.is_none() && request.profile.is_none() {
            configuration::stored_options(&row.settings)?
        } else {
            let mode = request.mode.as_ref().unwrap_or(&row.settings.mode);
            let profile = request.profile.as_ref().unwrap_or(&row.settings.profile);
            configuration::options(mode, profile, &BTreeMap::new())?
        };
        for (name, value) in &request.overrides {
            options.set(name, value)?;
        }
        // The window of a single-epoch estimator: the last epoch, from the state before it.
        let mut window = self.store().last_epochs(row.key, 2).await?.into_iter();
        let last = window.next().ok_or_else(|| SessionError::Empty { id: id.to_string() })?;
        let before = window.next().map(|stored| stored.solution.solution);
        let epochs = vec![SequencedEpoch { seq: last.solution.seq, epoch: last.epoch()? }];
        let navigation = self.aiding().current();
        let computed = self.compute(options, before, epochs, navigation).await?;
        Ok(computed.into_iter().next_back().expect("one epoch gives one answer"))
    }

    /// Positions a burst of epochs without a session; nothing is stored.
    ///
    /// # Errors
    /// A configuration that does not exist, epochs beyond the limits or out of order.
    pub async fn solve_once(&self, burst: Burst) -> Result<Vec<Computed>, SessionError> {
        let options = configuration::options(&burst.mode, &burst.profile, &burst.overrides)?;
        self.check_batch(&burst.epochs)?;
        let limit = self.limits().observations_per_epoch;
        for (index, epoch) in burst.epochs.iter().enumerate() {
            let observations = epoch.epoch.observations.len();
            if limit < observations {
                return Err(SessionError::TooManyObservations { index, observations, limit });
            }
        }
        let disorder = burst.epochs.windows(2).position(|w| w[1].epoch.time <= w[0].epoch.time);
        if let Some(before) = disorder {
            return Err(SessionError::BurstOutOfOrder { index: before + 1 });
        }
        let navigation = match burst.navigation {
            None => self.aiding().current(),
            Some(own) => {
                let mut navigation = (*self.aiding().current()).clone();
                navigation.merge(own);
                Arc::new(navigation)
            }
        };
        self.compute(options, None, burst.epochs, navigation).await
    }

    async fn compute(
        &self,
        options: PositioningOptions,
        before: Option<Solution>,
        epochs: Vec<SequencedEpoch>,
        navigation: Arc<Navigation>,
    ) -> Result<Vec<Computed>, SessionError> {
        let version: Arc<str> = VERSION.into();
        let configuration_hash: Arc<str> = options.configuration_hash().into();
        let work = move || {
            let mut estimator = Estimator::new(options);
            if let Some(before) = &before {
                estimator.resume(before);
            }
            let position = |SequencedEpoch { seq, epoch }| Computed {
                seq,
                solution: estimator.advance(&epoch, &Aiding::alone(&navigation)),
                version: version.clone(),
                configuration_hash: configuration_hash.clone(),
            };
            epochs.into_iter().map(position).collect()
        };
        self.solvers().run(work).await
    }
}
