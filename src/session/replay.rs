//! Stored epochs computed again: to restore a session's state, and to check or vary what is stored.

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

/// Epochs read and computed at once.
const PAGE: usize = 256;
/// Epochs replayed at most where a session has no state that can be read: more than a window of
/// any mode holds.
const REBUILT_EPOCHS: usize = 4_096;

/// What epochs are computed with.
#[derive(Clone, Debug)]
pub(super) enum By {
    /// What they were computed with before.
    Stored,
    /// These options and bases, whatever the session had.
    Options(Arc<InForce>),
}

/// What epochs that are new are computed with.
#[derive(Clone, Debug)]
pub(super) struct InForce {
    pub(super) origin: Origin,
    /// Which base it is, where the mode is relative to one.
    pub(super) base: BaseChoice,
}

/// The way through a session's stored epochs.
pub(super) struct Course {
    pub(super) store: Store,
    pub(super) aiding: AidingDesk,
    pub(super) solvers: Solvers,
    pub(super) key: SessionKey,
    pub(super) by: By,
    /// Whether navigation data that is kept no more may be replaced by today's, and base epochs by
    /// none.
    pub(super) may_differ: bool,
}

/// A stored epoch with all that its solution rests on.
struct Step {
    seq: u64,
    epoch: Epoch,
    navigation: PushedNavigation,
    origin: Arc<Origin>,
    base: StepBase,
}

/// What an epoch is given of a base.
enum StepBase {
    None,
    /// What it was given before.
    Again(BaseGiven),
    /// What is new then of all that is held.
    Held(Arc<Against>),
}

impl Course {
    /// Computes the next epochs after those of `state`; returns their answers and the revisions
    /// they brought, none once all are computed.
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

    /// The bases that epochs are computed with.
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

/// The bases of a run of epochs.
enum Bases {
    /// Each with the epochs that were given then.
    Used(Vec<BaseView>),
    /// One or several, with all that is held.
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

/// What epochs under a stored configuration are computed with.
async fn origin_of(store: &Store, hash: &Arc<str>) -> Result<Origin, SessionError> {
    let kept = store.configuration(hash).await?;
    let options = kept_options(&kept)?;
    Ok(Origin { version: VERSION.into(), configuration_hash: hash.clone(), options })
}

/// What a session's next epochs are computed with.
pub(super) async fn in_force(store: &Store, id: &str) -> Result<InForce, SessionError> {
    let row = store.session(id).await?;
    let row = row.ok_or_else(|| SessionError::NotFound { id: id.to_owned() })?;
    let options: PositioningOptions = stored_options(&row.settings)?;
    let base = base_of(options.mode, &row.settings.base)?;
    let configuration_hash = row.settings.configuration_hash;
    let origin = Origin { version: VERSION.into(), configuration_hash, options };
    Ok(InForce { origin, base })
}

/// The state after a session's last stored epoch: its newest snapshot, and the epochs since.
///
/// A session that has no snapshot yet is replayed from its first epoch. Where there is one that
/// this program cannot read, another version's, the last 4096 epochs stand for it: the state is
/// then as good, but not the same bit by bit.
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
