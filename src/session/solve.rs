//! Positions on request. Nothing is stored.

use std::collections::BTreeMap;
use std::sync::Arc;

use crate::aiding::bases::{BaseChoice, BaseId};
use crate::aiding::rover_source;
use crate::config::{Mode, PositioningOptions};
use crate::gnss::{GpsTime, Navigation};
use crate::positioning::PreparedOptions;
use crate::store::SessionSettings;

use super::base_selection::BaseSource;
use super::computation::{Computation, Computed};
use super::configurations::calibration;
use super::desk::Sessions;
use super::state::{Configuration, VERSION};
use super::{SequencedEpoch, SessionError, SessionId, configuration};

/// How to solve a session's present window.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct SolveRequest {
    /// The mode; `None` for the session's.
    pub mode: Option<String>,
    /// The profile; `None` for the session's.
    pub profile: Option<String>,
    /// Overrides of options. If neither mode nor profile is given, they are added to the session's
    /// configuration, otherwise to the profile.
    pub overrides: BTreeMap<String, String>,
    /// The bases, if the requested mode is relative to one. Without any, the session's bases are
    /// used.
    pub base: BaseChoice<BaseId>,
}

/// A few epochs to position without a session.
#[derive(Clone, Debug, PartialEq)]
pub struct Burst {
    /// Name of the mode.
    pub mode: String,
    /// Name of the profile.
    pub profile: String,
    /// Options that differ from the profile, by name.
    pub overrides: BTreeMap<String, String>,
    /// The epochs in order of time. Their numbers are returned with the solutions.
    pub epochs: Vec<SequencedEpoch>,
    /// Additional navigation data, used together with the service's.
    pub navigation: Option<Navigation>,
    /// The bases of a mode relative to one. Their stored epochs are used.
    pub base: BaseChoice<BaseId>,
    /// Type and radome of the rover's antenna; empty for no correction.
    pub antenna: String,
}

impl SolveRequest {
    /// The requested options for a session with `settings`.
    ///
    /// # Errors
    /// The mode, profile, option or value does not exist.
    pub(super) fn options(
        &self,
        settings: &SessionSettings,
    ) -> Result<PositioningOptions, SessionError> {
        let mut options = if self.mode.is_none() && self.profile.is_none() {
            configuration::stored_options(settings)?
        } else {
            let mode = self.mode.as_ref().unwrap_or(&settings.mode);
            let profile = self.profile.as_ref().unwrap_or(&settings.profile);
            configuration::options(mode, profile, &BTreeMap::new())?
        };
        for (name, value) in &self.overrides {
            options.set(name, value)?;
        }
        Ok(options)
    }
}

/// Number of epochs that a new estimator with these options receives: those of its window.
fn window_epochs(options: &PositioningOptions) -> usize {
    match options.mode {
        Mode::Spp => 1,
        _ => options.graph.window_epochs_max.max(1),
    }
}

impl Sessions {
    /// Solves the session's present window with any mode and options. A new estimator receives the
    /// last committed epochs, as many as the window of these options has, with the present
    /// navigation data and base epochs. The session is not affected, and nothing is stored. With
    /// the session's own configuration and base, the answer is the stored solution.
    ///
    /// # Errors
    /// No session has this id, it has no epoch, or a configuration or base does not exist.
    pub async fn solve(
        &self,
        id: &SessionId,
        request: &SolveRequest,
    ) -> Result<Computed, SessionError> {
        let row = self.row(id).await?;
        let options = request.options(&row.settings)?;
        self.check_window(&options)?;
        self.meter().admit_computation()?;
        let asked = self.base_names(request.base.clone())?;
        let base = if asked.is_none() { &row.settings.base } else { &asked };
        let base = configuration::base_of(options.mode, base)?;
        self.check_output(&options, &base)?;
        let own = configuration::stored_options(&row.settings)?;
        let is_own = PositioningOptions { output: own.output, ..options.clone() } == own;
        let count = window_epochs(&options).min(self.limits().epochs_per_push);
        let mut stored = self.store().last_epochs(row.key, count).await?;
        let last = stored.first().ok_or_else(|| SessionError::Empty { id: id.to_string() })?;
        let is_same_base = match &base {
            BaseChoice::None => last.base.is_none(),
            BaseChoice::One(base) => last.base.is_some_and(|used| used.base == base.key),
            choice => *choice == row.settings.base,
        };
        let is_same = last.solution.configuration_hash == row.settings.configuration_hash;
        if is_own && is_same && is_same_base {
            return Ok(Computed::of_stored(stored.swap_remove(0).solution, options.output));
        }
        let sequenced = stored
            .iter()
            .rev()
            .map(|stored| SequencedEpoch { seq: stored.solution.seq, epoch: stored.epoch.clone() });
        let epochs = sequenced.collect();
        let device = rover_source(self.tenant(), id.as_str());
        let navigation = self.aiding().navigation.current_for(&device).navigation;
        let hash = row.settings.antenna.as_ref().map(|antenna| &*antenna.calibration);
        let estimation = Configuration {
            version: VERSION.into(),
            hash: configuration::configuration_hash(&options, hash).into(),
            options: PreparedOptions::new(options),
            antenna: calibration(self.aiding(), hash).await?,
        };
        let computed = self.compute(estimation, epochs, navigation, base).await?;
        Ok(computed.into_iter().next_back().expect("an epoch gives an answer"))
    }

    /// Positions a few epochs without a session. Nothing is stored.
    ///
    /// # Errors
    /// A configuration or antenna does not exist, or the epochs exceed a limit or are not in order
    /// of time.
    pub async fn solve_once(&self, burst: Burst) -> Result<Vec<Computed>, SessionError> {
        let options = configuration::options(&burst.mode, &burst.profile, &burst.overrides)?;
        self.check_window(&options)?;
        self.check_push(&burst.epochs)?;
        self.meter().admit_computation()?;
        let limit = self.limits().observations_per_epoch;
        for (index, epoch) in burst.epochs.iter().enumerate() {
            let observations = epoch.epoch.observations.len();
            if limit < observations {
                return Err(SessionError::TooManyObservations { index, observations, limit });
            }
        }
        if let Some(index) = burst.epochs.iter().position(|e| e.epoch.time < GpsTime::EPOCH) {
            return Err(SessionError::BurstBeforeGps { index });
        }
        let disorder = burst.epochs.windows(2).position(|w| w[1].epoch.time <= w[0].epoch.time);
        if let Some(before) = disorder {
            return Err(SessionError::BurstOutOfOrder { index: before + 1 });
        }
        let current = self.aiding().navigation.of(self.tenant()).current().navigation;
        let navigation = match burst.navigation {
            None => current,
            Some(own) => {
                let mut navigation = (*current).clone();
                navigation.merge(own);
                Arc::new(navigation)
            }
        };
        let base = self.base_names(burst.base)?;
        let base = configuration::base_of(options.mode, &base)?;
        self.check_output(&options, &base)?;
        let named = match burst.antenna.trim() {
            "" => None,
            name => Some(self.aiding().antennas.named(name)?),
        };
        let calibration_hash = named.as_ref().map(|(name, _)| &*name.calibration);
        let estimation = Configuration {
            version: VERSION.into(),
            hash: configuration::configuration_hash(&options, calibration_hash).into(),
            options: PreparedOptions::new(options),
            antenna: named.map(|(_, calibration)| calibration),
        };
        self.compute(estimation, burst.epochs, navigation, base).await
    }

    /// Checks that the window is not longer than a computation on request may have.
    fn check_window(&self, options: &PositioningOptions) -> Result<(), SessionError> {
        let (epochs, limit) = (window_epochs(options), self.limits().solve_window_epochs);
        match epochs <= limit {
            true => Ok(()),
            false => Err(SessionError::WindowTooLong { epochs, limit }),
        }
    }

    async fn compute(
        &self,
        estimation: Configuration,
        epochs: Vec<SequencedEpoch>,
        navigation: Arc<Navigation>,
        base: BaseChoice,
    ) -> Result<Vec<Computed>, SessionError> {
        let times = || epochs.iter().map(|sequenced| sequenced.epoch.time);
        let span = times().next().zip(times().next_back());
        let source =
            BaseSource::new(&self.aiding().bases, self.tenant(), &base, span, &estimation.options);
        let limit = self.limits().solve_time;
        Computation::new(estimation, epochs, navigation, source, limit).run(&self.solvers()).await
    }
}
