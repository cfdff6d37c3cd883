//! Replays stored epochs: to restore a session's state, to check its solutions, or to compute them
//! with other options.

use std::collections::BTreeMap;
use std::sync::Arc;

use crate::aiding::bases::{BaseChoice, BaseGiven, BaseView};
use crate::aiding::{AidingDesk, PushedNavigation};
use crate::config::PositioningOptions;
use crate::gnss::Epoch;
use crate::positioning::Scratch;
use crate::store::{BaseUse, SessionKey, Store, StoreError, StoredEpoch, StoredSolution};

use super::SessionError;
use super::configuration::{base_of, kept_options, stored_options};
use super::course::Against;
use super::solvers::Solvers;
use super::state::{Origin, State, VERSION};

/// Stored epochs per read.
const PAGE: usize = 256;
/// Most epochs that are replayed if a session has no readable snapshot: more than the window of any
/// mode.
const REBUILT_EPOCHS: usize = 4_096;

/// The options and bases that replay uses.
#[derive(Clone, Debug)]
pub(super) enum By {
    /// Those of the stored solutions.
    Stored,
    /// These, for all epochs.
    Options(Arc<InForce>),
}

/// The options and bases for new epochs.
#[derive(Clone, Debug)]
pub(super) struct InForce {
    pub(super) origin: Origin,
    /// The bases, if the mode is relative to one.
    pub(super) base: BaseChoice,
}

/// Replays a session's stored epochs.
pub(super) struct Course {
    pub(super) store: Store,
    pub(super) aiding: AidingDesk,
    pub(super) solvers: Solvers,
    pub(super) key: SessionKey,
    pub(super) by: By,
    /// Whether missing data is tolerated: today's navigation data replace those no longer stored,
    /// and base epochs no longer stored are left out.
    pub(super) may_differ: bool,
}

/// A stored epoch with everything that its solution depends on.
struct Step {
    seq: u64,
    epoch: Epoch,
    navigation: PushedNavigation,
    origin: Arc<Origin>,
    base: StepBase,
}

/// The base epochs that an epoch receives.
enum StepBase {
    None,
    /// The same as in the stored solution.
    Again(BaseGiven),
    /// Those that the selection gives now.
    Held(Arc<Against>),
}

impl Course {
    /// Computes the next epochs after those of `state`. Returns their solutions and revisions; none
    /// once everything is computed.
    pub(super) async fn next(
        &self,
        mut state: State,
        after: Option<u64>,
    ) -> Result<(State, Vec<StoredSolution>), SessionError> {
        let stored = self.store.epochs_after(self.key, after, PAGE).await?;
        if stored.is_empty() {
            return Ok((state, Vec::new()));
        }
        let steps = self.steps(stored).await?;
        let work = move |scratch: &mut Scratch| {
            let mut answers = Vec::with_capacity(2 * steps.len());
            for Step { seq, epoch, navigation, origin, base } in steps {
                let base = match base {
                    StepBase::None => None,
                    StepBase::Again(given) => Some(given),
                    StepBase::Held(against) => {
                        state.base_for(&against, &epoch, &navigation.navigation, &origin)
                    }
                };
                let navigation = &navigation.navigation;
                let base = base.as_ref();
                let advanced = state.advance(seq, &epoch, navigation, base, &origin, scratch);
                answers.push(advanced.solution);
                answers.extend(advanced.revisions);
            }
            (state, answers)
        };
        self.solvers.estimate(work).await
    }

    async fn steps(&self, stored: Vec<StoredEpoch>) -> Result<Vec<Step>, SessionError> {
        let mut origins: BTreeMap<Arc<str>, Arc<Origin>> = BTreeMap::new();
        let mut pushes: BTreeMap<u64, PushedNavigation> = BTreeMap::new();
        let mut steps = Vec::with_capacity(stored.len());
        let bases = self.bases(&stored)?;
        for row in stored {
            let hash = &row.solution.configuration_hash;
            let origin = match origins.get(hash) {
                Some(origin) => origin.clone(),
                None => {
                    let origin = self.origin(hash).await?;
                    origins.insert(hash.clone(), origin.clone());
                    origin
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
            let (seq, base) = (row.solution.seq, bases.of(row.base, self.may_differ)?);
            steps.push(Step { seq, epoch: row.epoch()?, navigation, origin, base });
        }
        Ok(steps)
    }

    /// The bases of a page of epochs.
    fn bases(&self, stored: &[StoredEpoch]) -> Result<Bases, SessionError> {
        let By::Options(force) = &self.by else {
            let uses: Vec<BaseUse> = stored.iter().filter_map(|row| row.base).collect();
            return Ok(Bases::Used(self.aiding.bases.used(&uses)));
        };
        let span = match (stored.first(), stored.last()) {
            (Some(first), Some(last)) => Some((first.epoch()?.time, last.epoch()?.time)),
            _ => None,
        };
        let InForce { origin, base } = &**force;
        let against = Against::new(&self.aiding.bases, base, span, &origin.options);
        Ok(Bases::Held(Arc::new(against)))
    }

    async fn origin(&self, hash: &Arc<str>) -> Result<Arc<Origin>, SessionError> {
        match &self.by {
            By::Options(force) => Ok(Arc::new(force.origin.clone())),
            By::Stored => origin_of(&self.store, hash).await.map(Arc::new),
        }
    }

    async fn navigation(&self, push: u64) -> Result<PushedNavigation, SessionError> {
        match self.aiding.navigation.after(push).await {
            Err(error @ StoreError::NavigationForgotten { .. }) if self.may_differ => {
                tracing::warn!(%error, "a session is restored with today's navigation data");
                Ok(self.aiding.navigation.current())
            }
            found => Ok(found?),
        }
    }
}

/// The bases of a page of epochs.
enum Bases {
    /// Each used base with the epochs of the stored solutions.
    Used(Vec<BaseView>),
    /// One or several bases with all their epochs.
    Held(Arc<Against>),
}

impl Bases {
    fn of(&self, used: Option<BaseUse>, may_differ: bool) -> Result<StepBase, StoreError> {
        let views = match self {
            Self::Used(views) => views,
            Self::Held(against) => return Ok(StepBase::Held(against.clone())),
        };
        let Some(used) = used else { return Ok(StepBase::None) };
        let view = views.iter().find(|view| view.name().key == used.base);
        let view = view.expect("the views are those of these epochs");
        match view.replayed_input(used) {
            Some(given) => Ok(StepBase::Again(given)),
            None if may_differ => {
                tracing::warn!(base = %view.name().id, "a session is restored without base epochs");
                Ok(StepBase::Again(view.remaining_input(used)))
            }
            None => Err(StoreError::BaseForgotten { base: used.base.number() }),
        }
    }
}

/// The options of a stored configuration.
async fn origin_of(store: &Store, hash: &Arc<str>) -> Result<Origin, SessionError> {
    let kept = store.configuration(hash).await?;
    let options = kept_options(&kept)?;
    Ok(Origin { version: VERSION.into(), configuration_hash: hash.clone(), options })
}

/// The options and bases for a session's next epochs.
pub(super) async fn in_force(store: &Store, id: &str) -> Result<InForce, SessionError> {
    let row = store.session(id).await?;
    let row = row.ok_or_else(|| SessionError::NotFound { id: id.to_owned() })?;
    let options: PositioningOptions = stored_options(&row.settings)?;
    let base = base_of(options.mode, &row.settings.base)?;
    let configuration_hash = row.settings.configuration_hash;
    let origin = Origin { version: VERSION.into(), configuration_hash, options };
    Ok(InForce { origin, base })
}

/// The state after a session's last stored epoch: its newest snapshot, advanced by the epochs
/// since.
///
/// A session without a snapshot is replayed from its first epoch. If the snapshot is of a version
/// that this program cannot read, the last 4096 epochs are replayed instead. The state is then
/// equally good, but not the same bit by bit.
pub(super) async fn restored(course: &Course, origin: &Origin) -> Result<State, SessionError> {
    let (mut state, mut after) = match snapshot(course).await? {
        Some(state) => (state.clone(), state.last.map(|(seq, _)| seq)),
        None => {
            let after = course.store.number_before_last(course.key, REBUILT_EPOCHS).await?;
            (State::new(origin), after)
        }
    };
    loop {
        let (next, answers) = course.next(state, after).await?;
        state = next;
        if answers.is_empty() {
            return Ok(state);
        }
        after = state.last.map(|(seq, _)| seq);
    }
}

async fn snapshot(course: &Course) -> Result<Option<State>, SessionError> {
    let Some(stored) = course.store.snapshot(course.key).await? else { return Ok(None) };
    let origin = origin_of(&course.store, &stored.configuration_hash).await?;
    match State::decode(stored.seq, &stored.content, &origin) {
        Ok(state) => Ok(Some(state)),
        Err(error) => {
            tracing::warn!(%error, "a session's state is rebuilt from its last epochs");
            Ok(None)
        }
    }
}
