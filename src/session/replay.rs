//! Replays stored epochs: to restore a session's state, to check its solutions, or to compute them
//! with other options.

use std::collections::BTreeMap;
use std::mem;
use std::sync::Arc;
use std::vec::IntoIter;

use crate::aiding::bases::{BaseInput, BaseView};
use crate::aiding::{AidingDesk, PushedNavigation};
use crate::clock::Stopwatch;
use crate::gnss::{Epoch, Reason};
use crate::positioning::{PreparedOptions, Scratch};
use crate::snapshot::SnapshotError;
use crate::store::{
    BaseUse, SessionKey, Store, StoreError, StoredEpoch, StoredSnapshot, StoredSolution,
    StoredState,
};
use crate::tenant::Tenant;

use super::SessionError;
use super::base_selection::BaseSource;
use super::configuration::kept_options;
use super::configurations::{ActiveConfiguration, calibration};
use super::panics::caught;
use super::solvers::{Lane, Progress, Solvers};
use super::state::{Advanced, Configuration, State, VERSION};

/// Stored epochs per read.
pub(super) const PAGE: usize = StoredState::EPOCHS;
/// Most epochs that are replayed if a session has no readable snapshot. It is more than the window
/// of any mode.
const REBUILT_EPOCHS: usize = 4_096;

/// The options and bases that replay uses.
#[derive(Clone, Debug)]
pub(super) enum ReplayWith {
    /// The stored options and bases of each epoch.
    Stored,
    /// These options and bases for all epochs.
    Options(Arc<ActiveConfiguration>),
}

/// Replays a session's stored epochs.
pub(super) struct Replay {
    pub(super) store: Store,
    pub(super) aiding: AidingDesk,
    pub(super) solvers: Solvers,
    pub(super) key: SessionKey,
    /// Tenant that owns the session.
    pub(super) tenant: Tenant,
    /// The session's device as a source of navigation data.
    pub(super) device: Arc<str>,
    pub(super) with: ReplayWith,
    /// Numbers of the epochs after which a new arc began, in order.
    pub(super) arcs: Arc<[u64]>,
    /// A configuration in memory, which need not be read from the store.
    pub(super) known: Option<Arc<Configuration>>,
    /// Whether missing data is tolerated: the present navigation data replace those no longer
    /// stored, and base epochs no longer stored are left out.
    pub(super) tolerates_missing: bool,
}

/// A stored epoch with everything that its solution depends on.
pub(super) struct Step {
    pub(super) seq: u64,
    pub(super) epoch: Epoch,
    pub(super) navigation: PushedNavigation,
    pub(super) configuration: Arc<Configuration>,
    pub(super) base: StepBase,
    /// The estimator panicked on the epoch when it was received.
    is_quarantined: bool,
}

/// The base epochs that an epoch receives.
pub(super) enum StepBase {
    None,
    /// These base epochs, such as those of the stored solution.
    Given(BaseInput),
    /// The base epochs that the base selection chooses now.
    Selected(Arc<BaseSource>),
}

impl Step {
    /// Begins a new arc if one lies between the state's last epoch and this one.
    pub(super) fn begin_arc(
        &self,
        state: &mut State,
        arcs: &[u64],
        scratch: &mut Scratch,
    ) -> Option<Vec<StoredSolution>> {
        let is_first = self.is_first_after(state.last_seq()?, arcs);
        (is_first && !state.begins_arc()).then(|| state.begin_arc(&self.configuration, scratch))
    }

    /// Whether an arc begins between epoch `last` and this one.
    pub(super) fn is_first_after(&self, last: u64, arcs: &[u64]) -> bool {
        arcs.iter().any(|after| last <= *after && *after < self.seq)
    }

    /// Advances a state by the epoch. If the estimator panics, or panicked on it before, the epoch
    /// is quarantined.
    pub(super) fn advance(self, state: &mut State, scratch: &mut Scratch) -> Advanced {
        let Self { seq, epoch, navigation, configuration, base, is_quarantined } = self;
        if is_quarantined {
            return state.quarantine(seq, &epoch, &configuration);
        }
        let advanced = caught(|| {
            let navigation = &navigation.navigation;
            let base = match base {
                StepBase::None => None,
                StepBase::Given(input) => Some(input),
                StepBase::Selected(source) => {
                    state.base_for(&source, &epoch, navigation, &configuration)
                }
            };
            state.advance(seq, &epoch, navigation, base.as_ref(), &configuration, scratch)
        });
        advanced.unwrap_or_else(|panic| {
            tracing::error!(seq, panic, "the estimator failed on a stored epoch");
            *scratch = Scratch::default();
            state.quarantine(seq, &epoch, &configuration)
        })
    }
}

/// A page of epochs that is being computed.
struct Page {
    state: State,
    steps: IntoIter<Step>,
    arcs: Arc<[u64]>,
    answers: Vec<StoredSolution>,
}

impl Page {
    /// Computes the next epoch.
    fn advance(&mut self, scratch: &mut Scratch) -> Progress {
        let Some(step) = self.steps.next() else { return Progress::Done };
        if let Some(revisions) = step.begin_arc(&mut self.state, &self.arcs, scratch) {
            self.answers.extend(revisions);
        }
        let stopwatch = Stopwatch::started();
        let advanced = step.advance(&mut self.state, scratch);
        self.state.unsaved_time += stopwatch.elapsed();
        self.answers.push(advanced.solution);
        self.answers.extend(advanced.revisions);
        Progress::Remaining
    }
}

/// A snapshot while it is decoded, and then advanced by the epochs after it.
enum Resuming {
    Encoded {
        snapshot: StoredSnapshot,
        configuration: Arc<Configuration>,
        steps: IntoIter<Step>,
        arcs: Arc<[u64]>,
    },
    Read(Box<Page>),
    Unreadable(SnapshotError),
}

impl Resuming {
    /// Reads the snapshot, or computes the next epoch.
    fn advance(&mut self, scratch: &mut Scratch) -> Progress {
        match self {
            Self::Read(page) => page.advance(scratch),
            Self::Unreadable(_) => Progress::Done,
            Self::Encoded { snapshot, configuration, steps, arcs } => {
                let (arcs, steps) = (arcs.clone(), mem::take(steps));
                *self = match State::decode(snapshot.seq, &snapshot.content, configuration) {
                    Ok(state) => {
                        Self::Read(Box::new(Page { state, steps, arcs, answers: Vec::new() }))
                    }
                    Err(error) => Self::Unreadable(error),
                };
                Progress::Remaining
            }
        }
    }
}

impl Replay {
    /// The state of a snapshot, advanced by the epochs after it; `None` if the snapshot is
    /// unreadable.
    async fn resumed(
        &self,
        snapshot: StoredSnapshot,
        epochs: Vec<StoredEpoch>,
    ) -> Result<Option<State>, SessionError> {
        let steps = self.steps(epochs).await?.into_iter();
        let configuration = self.stored_configuration(&snapshot.configuration_hash).await?;
        let arcs = self.arcs.clone();
        let resuming = Resuming::Encoded { snapshot, configuration, steps, arcs };
        match self.solvers.in_quanta(Lane::Restore, resuming, Resuming::advance).await? {
            Resuming::Read(page) => Ok(Some(page.state)),
            Resuming::Unreadable(error) => {
                tracing::warn!(%error, "a session's state is rebuilt from its last epochs");
                Ok(None)
            }
            Resuming::Encoded { .. } => unreachable!("it is read first"),
        }
    }

    /// Computes the next epochs after those of `state`. Returns their solutions and revisions; none
    /// if everything is computed.
    pub(super) async fn next(
        &self,
        state: State,
        after: Option<u64>,
    ) -> Result<(State, Vec<StoredSolution>), SessionError> {
        let stored = self.store.epochs_after(self.key, after, PAGE).await?;
        if stored.is_empty() {
            return Ok((state, Vec::new()));
        }
        let steps = self.steps(stored).await?;
        let arcs = self.arcs.clone();
        let answers = Vec::with_capacity(2 * steps.len());
        let page = Page { state, steps: steps.into_iter(), arcs, answers };
        let done = self.solvers.in_quanta(Lane::Restore, page, Page::advance).await?;
        Ok((done.state, done.answers))
    }

    /// The epochs, each with everything that its solution depends on.
    pub(super) async fn steps(&self, stored: Vec<StoredEpoch>) -> Result<Vec<Step>, SessionError> {
        let mut configurations: BTreeMap<Arc<str>, Arc<Configuration>> = BTreeMap::new();
        let mut pushes: BTreeMap<u64, PushedNavigation> = BTreeMap::new();
        let mut steps = Vec::with_capacity(stored.len());
        let bases = self.bases(&stored)?;
        for row in stored {
            let hash = &row.solution.configuration_hash;
            let configuration = match configurations.get(hash) {
                Some(configuration) => configuration.clone(),
                None => {
                    let configuration = self.configuration(hash).await?;
                    configurations.insert(hash.clone(), configuration.clone());
                    configuration
                }
            };
            let navigation = match pushes.get(&row.navigation) {
                Some(navigation) => navigation.clone(),
                None => {
                    let navigation = self.navigation(row.navigation).await?;
                    pushes.insert(row.navigation, navigation.clone());
                    navigation
                }
            };
            let (seq, base) = (row.solution.seq, bases.of(row.base, self.tolerates_missing)?);
            let is_quarantined = matches!(self.with, ReplayWith::Stored)
                && row.solution.solution.reasons.contains(&Reason::EstimatorFailed);
            let epoch = row.epoch;
            steps.push(Step { seq, epoch, navigation, configuration, base, is_quarantined });
        }
        Ok(steps)
    }

    /// The bases of a page of epochs.
    fn bases(&self, stored: &[StoredEpoch]) -> Result<PageBases, SessionError> {
        let ReplayWith::Options(active) = &self.with else {
            let uses: Vec<BaseUse> = stored.iter().filter_map(|row| row.base).collect();
            return Ok(PageBases::Used(self.aiding.bases.used(&uses)));
        };
        let span = match (stored.first(), stored.last()) {
            (Some(first), Some(last)) => Some((first.epoch.time, last.epoch.time)),
            _ => None,
        };
        let ActiveConfiguration { estimation, bases, .. } = &**active;
        let source =
            BaseSource::new(&self.aiding.bases, &self.tenant, bases, span, &estimation.options);
        Ok(PageBases::Selected(Arc::new(source)))
    }

    /// The configuration with which epochs with this stored configuration are computed.
    pub(super) async fn configuration(
        &self,
        hash: &Arc<str>,
    ) -> Result<Arc<Configuration>, SessionError> {
        match &self.with {
            ReplayWith::Options(active) => Ok(Arc::new(active.estimation.clone())),
            ReplayWith::Stored => self.stored_configuration(hash).await,
        }
    }

    /// A stored configuration.
    async fn stored_configuration(
        &self,
        hash: &Arc<str>,
    ) -> Result<Arc<Configuration>, SessionError> {
        match self.known.as_ref().filter(|known| known.hash == *hash) {
            Some(known) => Ok(known.clone()),
            None => configuration_of(&self.store, &self.aiding, hash).await.map(Arc::new),
        }
    }

    async fn navigation(&self, push: u64) -> Result<PushedNavigation, SessionError> {
        match self.aiding.navigation.after(push, &self.device).await {
            Err(error @ StoreError::NavigationForgotten { .. }) if self.tolerates_missing => {
                tracing::warn!(%error, "a session is restored with present navigation data");
                Ok(self.aiding.navigation.current_for(&self.device))
            }
            found => Ok(found?),
        }
    }
}

/// The bases of a page of epochs.
enum PageBases {
    /// Each used base with the epochs of the stored solutions.
    Used(Vec<BaseView>),
    /// One or several bases with all their epochs.
    Selected(Arc<BaseSource>),
}

impl PageBases {
    fn of(&self, used: Option<BaseUse>, tolerates_missing: bool) -> Result<StepBase, StoreError> {
        let views = match self {
            Self::Used(views) => views,
            Self::Selected(source) => return Ok(StepBase::Selected(source.clone())),
        };
        let Some(used) = used else { return Ok(StepBase::None) };
        let view = views.iter().find(|view| view.name().key == used.base);
        let view = view.expect("the views are those of these epochs");
        match view.replayed_input(used) {
            Some(input) => Ok(StepBase::Given(input)),
            None if tolerates_missing => {
                tracing::warn!(base = %view.name().id, "a session is restored without base epochs");
                Ok(StepBase::Given(view.remaining_input(used)))
            }
            None => Err(StoreError::BaseForgotten { base: used.base.number() }),
        }
    }
}

/// The options of a stored configuration.
async fn configuration_of(
    store: &Store,
    aiding: &AidingDesk,
    hash: &Arc<str>,
) -> Result<Configuration, SessionError> {
    let kept = store.configuration(hash).await?;
    let options = PreparedOptions::new(kept_options(&kept)?);
    let antenna = calibration(aiding, kept.calibration.as_deref()).await?;
    Ok(Configuration { version: VERSION.into(), hash: hash.clone(), options, antenna })
}

/// The state after a session's last stored epoch: its newest snapshot, advanced by the later
/// epochs.
///
/// A session without a snapshot is replayed from its first epoch. If this program cannot read the
/// layout of the snapshot, the last 4096 epochs are replayed instead. That state is equally good,
/// but not the same bit by bit.
pub(super) async fn restored(
    replay: &Replay,
    stored: StoredState,
    configuration: &Configuration,
) -> Result<State, SessionError> {
    let StoredState { snapshot, since_day, epochs, .. } = stored;
    let mut is_complete = epochs.len() < PAGE;
    let resumed = match snapshot {
        Some(snapshot) => replay.resumed(snapshot, epochs).await?,
        None => None,
    };
    let (mut state, mut after) = match resumed {
        Some(mut state) => {
            state.since_day = since_day;
            let last = state.last_seq();
            (state, last)
        }
        None => {
            is_complete = false;
            let after = replay.store.number_before_last(replay.key, REBUILT_EPOCHS).await?;
            (State::new(configuration), after)
        }
    };
    while !is_complete {
        let (next, answers) = replay.next(state, after).await?;
        state = next;
        after = state.last_seq();
        is_complete = answers.iter().filter(|answer| answer.revision == 0).count() < PAGE;
    }
    let ends_arc = state.last_seq().is_some_and(|last| replay.arcs.contains(&last));
    if !ends_arc || state.begins_arc() {
        return Ok(state);
    }
    let configuration = configuration.clone();
    let work = move |scratch: &mut Scratch| {
        state.begin_arc(&configuration, scratch); // Its revisions are stored.
        state
    };
    replay.solvers.estimate(Lane::Restore, work).await
}

async fn decoded(
    replay: &Replay,
    stored: StoredSnapshot,
) -> Result<Result<State, SnapshotError>, SessionError> {
    let configuration = replay.stored_configuration(&stored.configuration_hash).await?;
    let decode = move || State::decode(stored.seq, &stored.content, &configuration);
    replay.solvers.run(Lane::Restore, decode).await
}

/// The oldest state that a session keeps for replay, after epochs through `removed_through` were
/// removed. `None` if nothing of the session is stored.
///
/// # Errors
/// Epochs are stored, but no state before them can be read.
pub(super) async fn oldest_state(
    replay: &Replay,
    removed_through: u64,
) -> Result<Option<State>, SessionError> {
    for stored in replay.store.kept_snapshots(replay.key).await? {
        let seq = stored.seq;
        match decoded(replay, stored).await? {
            Ok(state) => return Ok(Some(state)),
            Err(error) => tracing::warn!(seq, %error, "a kept snapshot is skipped"),
        }
    }
    match replay.store.epochs_after(replay.key, None, 1).await?.is_empty() {
        true => Ok(None),
        false => Err(SessionError::ReplayStartMissing { removed_through }),
    }
}
