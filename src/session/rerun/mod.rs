//! A stored session positioned again for a batch job: with another mode, profile, base or kind of
//! answer, or as it was answered.
//!
//! Each epoch has the navigation data with which it was answered. Epochs are read in pages. The
//! caller computes them one by one, in turns of the solver pool. Nothing is stored.

mod plan;
mod whole;

use std::collections::BTreeSet;
use std::sync::Arc;
use std::vec::IntoIter;

use crate::aiding::bases::BaseInput;
use crate::aiding::{AidingDesk, rover_source};
use crate::gnss::{GpsTime, LeapSeconds, Navigation, Solution};
use crate::positioning::{PreparedOptions, Scratch};
use crate::recording::{AnswerKind, BaseRecording, RecordingError};
use crate::snapshot::{Snapshot, SnapshotError, SnapshotReader, SnapshotWriter, seal};
use crate::store::{BaseKey, SessionRow, Store, StoredEpoch, StoredSolution};
use crate::tenant::Tenant;

use super::configuration::configuration_hash;
use super::configurations::{ActiveConfiguration, Configurations, calibration};
use super::replay::{PAGE, Replay, ReplayWith, Step, StepBase, oldest_state};
use super::solvers::Solvers;
use super::state::{Configuration, State, VERSION};
use super::{SessionError, SessionId, SessionLimits};

use plan::session;
pub use plan::{RerunPlan, RerunRequest};
use whole::WholeSession;

/// Layout of checkpoints, around a state. Raise it when their content changes.
const LAYOUT: u16 = 1;

/// A stored session that is positioned again.
pub struct Rerun<'a> {
    replay: Replay,
    id: SessionId,
    numbers: (u64, u64),
    span: (Option<GpsTime>, Option<GpsTime>),
    /// The base's file, if its epochs come from one.
    base: Option<BaseRecording<'a>>,
    estimating: Estimating,
    scratch: Box<Scratch>,
    /// The epochs that are read but not positioned yet.
    steps: IntoIter<Step>,
    /// Number of the last epoch that is read, or of the epoch after which the plan begins.
    after: Option<u64>,
    /// Number of the last epoch that is positioned.
    passed: Option<u64>,
    /// Number of the last epoch before the checkpoint from which it continues. Epochs up to this
    /// number are only read.
    positioned: Option<u64>,
    /// Number of the last epoch that was removed before it was read.
    removed_through: Option<u64>,
    /// The stored bases that epochs were positioned with.
    bases: BTreeSet<BaseKey>,
}

/// The estimator that answers the epochs.
enum Estimating {
    /// A session's estimator. Only answers of this revision to epochs above a number are returned.
    Session { state: Box<State>, revision: u32, above: Option<u64> },
    /// An estimator of all epochs at once.
    Whole(Box<WholeSession>),
}

impl<'a> Rerun<'a> {
    /// Opens a session to compute what was planned.
    ///
    /// # Errors
    /// The tenant no longer has the session, a base no longer exists, or the store fails.
    pub async fn open(
        request: &RerunRequest,
        plan: RerunPlan,
        (store, aiding): (Store, AidingDesk),
        tenant: &Tenant,
        id: &SessionId,
    ) -> Result<Self, SessionError> {
        let row = session(&store, tenant, id).await?;
        let active = match plan.is_as_answered {
            true => Configurations::default().active(&aiding, &row).await?,
            false => changed(request, &plan, &aiding, &row).await?,
        };
        let estimation = active.estimation.clone();
        let replay = Replay {
            arcs: store.arcs(row.key).await?.into(),
            store,
            aiding,
            solvers: Solvers::new(SessionLimits::service().solver_threads),
            key: row.key,
            device: rover_source(&row.tenant, id.as_str()),
            tenant: row.tenant,
            with: match plan.is_as_answered {
                true => ReplayWith::Stored,
                false => ReplayWith::Options(Arc::new(active)),
            },
            known: None,
            tolerates_missing: false,
        };
        let before = plan.numbers.0.checked_sub(1);
        let mut after = row.removed_through.max(before);
        let revision = match request.answer {
            AnswerKind::Causal => 0,
            AnswerKind::FixedLag | AnswerKind::Batch => 1,
        };
        let mut state = State::new(&estimation);
        if let (true, Some(removed)) = (plan.is_as_answered, row.removed_through)
            && let Some(oldest) = oldest_state(&replay, removed).await?
        {
            (after, state) = (oldest.last_seq(), oldest);
        }
        let estimating = match request.answer {
            AnswerKind::Batch => {
                Estimating::Whole(Box::new(WholeSession::new(estimation, replay.arcs.clone())))
            }
            _ => Estimating::Session { state: Box::new(state), revision, above: after },
        };
        Ok(Self {
            replay,
            id: id.clone(),
            numbers: plan.numbers,
            span: request.span,
            base: None,
            estimating,
            scratch: Box::default(),
            steps: Vec::new().into_iter(),
            after,
            passed: None,
            positioned: None,
            removed_through: after.filter(|_| before < after),
            bases: BTreeSet::new(),
        })
    }

    /// From now on, takes the epochs of the base from a file.
    pub fn follow(&mut self, base: BaseRecording<'a>) {
        self.base = Some(base);
    }

    /// The file of the base.
    pub const fn base(&self) -> Option<&BaseRecording<'a>> {
        self.base.as_ref()
    }

    /// The base of the last epoch that had one.
    fn present_base(&self) -> Option<BaseKey> {
        match &self.estimating {
            Estimating::Session { state, .. } => state.base(),
            Estimating::Whole(whole) => whole.base(),
        }
    }

    /// The ids of the stored bases that epochs were positioned with.
    pub fn bases(&self) -> Vec<Arc<str>> {
        let broker = &self.replay.aiding.bases;
        self.bases.iter().filter_map(|key| broker.id_of(*key)).collect()
    }

    /// The leap seconds known today.
    pub fn leap_seconds(&self) -> LeapSeconds {
        self.replay.aiding.navigation.current().navigation.leap_seconds
    }

    /// Number of the last epoch that the session's retention has removed since the plan was made,
    /// if there is one.
    pub const fn removed_through(&self) -> Option<u64> {
        self.removed_through
    }

    /// Number of the session's epoch numbers that are passed.
    pub fn passed(&self) -> u64 {
        self.passed.map_or(0, |passed| (passed + 1).saturating_sub(self.numbers.0))
    }

    /// Time and navigation data of the next epoch, once it is read.
    pub fn next_epoch(&self) -> Option<(GpsTime, &Navigation)> {
        let step = self.steps.as_slice().first()?;
        Some((step.epoch.time, &step.navigation.navigation))
    }

    /// Reads epochs, if all read ones are positioned. Returns whether there are any.
    ///
    /// # Errors
    /// The session is deleted, data with which it was answered are no longer stored, or the store
    /// fails.
    pub async fn read(&mut self) -> Result<bool, SessionError> {
        while self.steps.as_slice().is_empty() {
            let (key, before) = (self.replay.key, self.after);
            let mut stored = self.replay.store.listed_epochs_after(key, before, PAGE).await?;
            // If the session is deleted meanwhile, some epochs are missing.
            let row = session(&self.replay.store, &self.replay.tenant, &self.id).await?;
            if before < row.removed_through {
                self.removed_through = row.removed_through.min(Some(self.numbers.1));
            }
            let Some(last) = stored.last().map(|last| last.solution.seq) else { return Ok(false) };
            self.after = Some(last);
            stored.retain(|stored| self.is_asked(stored));
            if stored.is_empty() && self.numbers.1 <= last {
                return Ok(false);
            }
            self.steps = self.replay.steps(stored).await?.into_iter();
        }
        Ok(true)
    }

    fn is_asked(&self, stored: &StoredEpoch) -> bool {
        let ((_, last), (from, to)) = (self.numbers, self.span);
        let time = stored.epoch.time;
        stored.solution.seq <= last
            && from.is_none_or(|from| from <= time)
            && to.is_none_or(|to| time <= to)
    }

    /// Positions the next epoch that is read, and appends the answers that are due. Returns false
    /// if no epoch was left.
    ///
    /// # Errors
    /// The file of the base cannot be read.
    pub fn step(&mut self, due: &mut Vec<Solution>) -> Result<bool, RecordingError> {
        let Some(mut step) = self.steps.next() else { return Ok(false) };
        if let Some(base) = &mut self.base {
            base.follow(step.epoch.time, &step.navigation.navigation)?;
            step.base = StepBase::Given(BaseInput::not_stored(base.aiding()));
        }
        self.passed = Some(step.seq);
        if self.passed <= self.positioned {
            return Ok(true);
        }
        match &mut self.estimating {
            Estimating::Whole(whole) => due.extend(whole.push(step)),
            Estimating::Session { state, revision, above } => {
                let (arcs, scratch) = (&self.replay.arcs, &mut *self.scratch);
                let mut answers = step.begin_arc(state, arcs, scratch).unwrap_or_default();
                let advanced = step.advance(state, scratch);
                answers.push(advanced.solution);
                answers.extend(advanced.revisions);
                due.extend(those_of(answers, *revision, *above));
            }
        }
        self.bases.extend(self.present_base());
        Ok(true)
    }

    /// The number of the last epoch and the state of the estimator, from which [`Self::resume`]
    /// continues. `None` before the first epoch, and if all answers come at the end.
    pub fn checkpoint(&self) -> Option<Vec<u8>> {
        let Estimating::Session { state, .. } = &self.estimating else { return None };
        let (seq, content) = state.unsealed(Vec::new())?;
        let mut writer = SnapshotWriter::new(LAYOUT);
        seq.save(&mut writer);
        state.configuration_hash.to_string().save(&mut writer);
        writer.bytes(&seal(content));
        Some(writer.finish())
    }

    /// Continues after a checkpoint of the same plan, with the same bits. The epochs before the
    /// checkpoint are read again, but get no answers. Call it before the first epoch. The inner
    /// result says whether this program can read the checkpoint.
    ///
    /// # Errors
    /// The options of its state are no longer stored, or the store fails.
    pub async fn resume(
        &mut self,
        checkpoint: &[u8],
    ) -> Result<Result<(), SnapshotError>, SessionError> {
        let (seq, hash, content) = match read_checkpoint(checkpoint) {
            Ok(read) => read,
            Err(error) => return Ok(Err(error)),
        };
        let configuration = self.replay.configuration(&hash.into()).await?;
        let Estimating::Session { state, .. } = &mut self.estimating else {
            unreachable!("answers that all come at the end have no checkpoint");
        };
        Ok(State::decode(seq, content, &configuration).map(|decoded| {
            **state = decoded;
            self.positioned = Some(seq);
        }))
    }

    /// Appends the answers that are due after the last epoch.
    pub fn finish(&mut self, due: &mut Vec<Solution>) {
        match &mut self.estimating {
            Estimating::Whole(whole) => due.extend(whole.end_arc()),
            Estimating::Session { state, revision, above } => {
                let answers = state.finish(&mut self.scratch);
                due.extend(those_of(answers, *revision, *above));
            }
        }
    }
}

/// The number of an epoch, the hash of the configuration and the state of a checkpoint.
fn read_checkpoint(checkpoint: &[u8]) -> Result<(u64, String, &[u8]), SnapshotError> {
    let mut reader = SnapshotReader::open(checkpoint, LAYOUT)?;
    let (seq, hash) = (Snapshot::load(&mut reader)?, Snapshot::load(&mut reader)?);
    let content = reader.bytes()?;
    reader.finish()?;
    Ok((seq, hash, content))
}

/// The solutions of one revision, of epochs above a number.
fn those_of(
    answers: impl IntoIterator<Item = StoredSolution>,
    revision: u32,
    above: Option<u64>,
) -> impl Iterator<Item = Solution> {
    let is_asked =
        move |answer: &StoredSolution| answer.revision == revision && above < Some(answer.seq);
    answers.into_iter().filter(is_asked).map(|answer| answer.solution)
}

/// The options and bases of a plan that differs from the session.
async fn changed(
    request: &RerunRequest,
    plan: &RerunPlan,
    aiding: &AidingDesk,
    row: &SessionRow,
) -> Result<ActiveConfiguration, SessionError> {
    let options = plan.options.clone();
    let bases = request.bases(aiding, row, options.mode)?;
    let antenna = row.settings.antenna.as_ref().map(|antenna| &*antenna.calibration);
    let hash = configuration_hash(&options, antenna).into();
    let antenna = calibration(aiding, antenna).await?;
    let options = PreparedOptions::new(options);
    let estimation = Configuration { version: VERSION.into(), hash, options, antenna };
    Ok(ActiveConfiguration { estimation, bases, is_closed: false, retention_days: None })
}
