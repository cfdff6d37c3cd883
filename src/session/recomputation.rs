//! Computes a stored session again: to check that the bits are the same, or with another
//! configuration.

use std::collections::BTreeMap;
use std::sync::Arc;

use crate::aiding::{AidingDesk, rover_source};
use crate::gnss::LeapSeconds;
use crate::positioning::{PreparedOptions, Scratch};
use crate::store::{EncodedSolution, Revisions, SessionKey, SolutionQuery, Store, StoredSolution};

use super::configuration::{base_of, configuration_hash};
use super::configurations::{ActiveConfiguration, Configurations, calibration};
use super::replay::{Replay, ReplayWith, oldest_state};
use super::solvers::{Lane, Solvers};
use super::state::{Configuration, State, VERSION};
use super::{SessionError, SessionId, SessionLimits, SolveRequest};

/// Stored solutions per read.
const PAGE: usize = 1_000;

/// A stored session while it is computed again, from its first epoch on. Nothing is stored.
pub struct Recomputation {
    replay: Replay,
    /// `None` once everything is computed.
    state: Option<State>,
    after: Option<u64>,
    /// Number of the epoch after which it begins, if earlier epochs are removed.
    began_after: Option<u64>,
    /// Whether the epochs that are in the window at the end get their last revision.
    ends_windows: bool,
    configuration_hash: Arc<str>,
}

/// The result of comparing a session with its stored solutions.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Check {
    /// Number of solutions, including revisions, that are stored and were computed again.
    pub compared: usize,
    /// Number of the compared solutions whose bits differ.
    pub different: usize,
    /// Number of solutions that were computed but are not stored.
    pub not_stored: usize,
    /// Number of solutions that are stored but were not computed.
    pub not_computed: usize,
    /// Epoch number and revision of the first difference.
    pub first: Option<(u64, u32)>,
    /// Number of the epoch after which it begins, if earlier epochs are removed.
    pub began_after: Option<u64>,
}

impl Check {
    /// Whether all solutions are the same bit by bit.
    pub fn is_same(&self) -> bool {
        self.first.is_none()
    }
}

impl Recomputation {
    /// Opens a session to compute it as it was, or with the options of `change`.
    ///
    /// # Errors
    /// No session has this id, a configuration does not exist, or the store fails.
    pub async fn open(
        store: Store,
        aiding: AidingDesk,
        id: &SessionId,
        change: Option<&SolveRequest>,
    ) -> Result<Self, SessionError> {
        let row = store.session_of_any(id.as_str()).await?;
        let row = row.ok_or_else(|| SessionError::NotFound { id: id.to_string() })?;
        let active = match change {
            None => Configurations::default().active(&aiding, &row).await?,
            Some(request) => {
                let options = request.options(&row.settings)?;
                let bases = aiding.bases.of(&row.tenant);
                let asked = request.base.clone().try_map(|id| bases.name(&id))?;
                let base = if asked.is_none() { &row.settings.base } else { &asked };
                let bases = base_of(options.mode, base)?;
                let antenna = row.settings.antenna.as_ref().map(|antenna| &*antenna.calibration);
                let hash = configuration_hash(&options, antenna).into();
                let antenna = calibration(&aiding, antenna).await?;
                let version = VERSION.into();
                let options = PreparedOptions::new(options);
                let estimation = Configuration { version, hash, options, antenna };
                let (is_closed, retention_days) = (false, None);
                ActiveConfiguration { estimation, bases, is_closed, retention_days }
            }
        };
        let configuration_hash = active.estimation.hash.clone();
        let mut state = State::new(&active.estimation);
        let arcs = store.arcs(row.key).await?.into();
        let replay = Replay {
            store,
            aiding,
            solvers: Solvers::new(SessionLimits::service().solver_threads),
            key: row.key,
            device: rover_source(&row.tenant, id.as_str()),
            tenant: row.tenant,
            with: if change.is_some() {
                ReplayWith::Options(Arc::new(active))
            } else {
                ReplayWith::Stored
            },
            arcs,
            known: None,
            tolerates_missing: false,
        };
        let ends_windows = change.is_some() || row.closed_unix_ms.is_some();
        let mut began_after = row.removed_through;
        if let (None, Some(removed_through)) = (change, row.removed_through)
            && let Some(oldest) = oldest_state(&replay, removed_through).await?
        {
            (began_after, state) = (oldest.last_seq(), oldest);
        }
        let (state, after) = (Some(state), began_after);
        Ok(Self { replay, state, after, began_after, ends_windows, configuration_hash })
    }

    /// Hash of the configuration in force, or of the requested one.
    pub(crate) fn configuration_hash(&self) -> &str {
        &self.configuration_hash
    }

    /// Number of the epoch after which it begins; `None` if it begins with the session, as it does
    /// while no epoch is removed.
    pub const fn began_after(&self) -> Option<u64> {
        self.began_after
    }

    /// The leap seconds known today.
    pub(crate) fn leap_seconds(&self) -> LeapSeconds {
        self.replay.aiding.navigation.current().navigation.leap_seconds
    }

    /// The next solutions with their revisions; `None` once everything is computed.
    ///
    /// # Errors
    /// Navigation data are no longer stored, or the store fails.
    pub async fn next(&mut self) -> Result<Option<Vec<StoredSolution>>, SessionError> {
        let Some(state) = self.state.take() else { return Ok(None) };
        let (mut state, answers) = self.replay.next(state, self.after).await?;
        if !answers.is_empty() {
            self.after = state.last.map(|(seq, _)| seq);
            self.state = Some(state);
            return Ok(Some(answers));
        }
        let ends_arc = state.last_seq().is_some_and(|last| self.replay.arcs.contains(&last));
        if !self.ends_windows && !ends_arc {
            return Ok(None);
        }
        let finish = move |scratch: &mut Scratch| Some(state.finish(scratch));
        self.replay.solvers.estimate(Lane::Restore, finish).await
    }

    /// Computes everything and compares it with the stored solutions.
    ///
    /// # Errors
    /// Navigation data are no longer stored, or the store fails.
    pub async fn check(mut self) -> Result<Check, SessionError> {
        let began_after = self.began_after;
        let mut check = Check { began_after, ..Check::default() };
        let is_within = |seq: u64| began_after.is_none_or(|after| after < seq);
        let mut stored = Stored::of(&self.replay, began_after);
        while let Some(answers) = self.next().await? {
            let last = answers.iter().map(|answer| answer.seq).max();
            stored.read_through(last.unwrap_or(0)).await?;
            for answer in answers.into_iter().filter(|answer| is_within(answer.seq)) {
                let key = (answer.seq, answer.revision);
                let Some(known) = stored.waiting.remove(&key) else {
                    check.not_stored += 1;
                    check.first.get_or_insert(key);
                    continue;
                };
                check.compared += 1;
                if !same_bits(&known, answer) {
                    check.different += 1;
                    check.first.get_or_insert(key);
                }
            }
        }
        stored.read_through(u64::MAX).await?;
        check.not_computed = stored.waiting.len();
        check.first = check.first.or(stored.waiting.keys().next().copied());
        Ok(check)
    }
}

/// Whether two solutions have the same bits, apart from the program's version.
fn same_bits(stored: &StoredSolution, computed: StoredSolution) -> bool {
    let version = stored.version.clone();
    EncodedSolution::new(stored) == EncodedSolution::new(&StoredSolution { version, ..computed })
}

/// The stored solutions of a session, read as far as needed.
struct Stored {
    store: Store,
    key: SessionKey,
    query: Option<SolutionQuery>,
    began_after: Option<u64>,
    /// Solutions that are read but not compared yet.
    waiting: BTreeMap<(u64, u32), StoredSolution>,
}

impl Stored {
    fn of(replay: &Replay, began_after: Option<u64>) -> Self {
        let query = SolutionQuery {
            from: None,
            to: None,
            status: None,
            revisions: Revisions::All,
            page_size: PAGE,
            page_token: None,
        };
        let (store, key) = (replay.store.clone(), replay.key);
        Self { store, key, query: Some(query), began_after, waiting: BTreeMap::new() }
    }

    /// Reads all solutions up to number `seq`.
    async fn read_through(&mut self, seq: u64) -> Result<(), SessionError> {
        while self.waiting.keys().next_back().is_none_or(|(read, _)| *read <= seq) {
            let Some(query) = &mut self.query else { break };
            let page = self.store.solutions(self.key, query).await?;
            let is_within =
                |item: &StoredSolution| self.began_after.is_none_or(|after| after < item.seq);
            let items = page.items.into_iter().filter(is_within);
            self.waiting.extend(items.map(|item| ((item.seq, item.revision), item)));
            query.page_token = page.next_page_token;
            if query.page_token.is_none() {
                self.query = None;
            }
        }
        Ok(())
    }
}
