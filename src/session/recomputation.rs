//! A stored session computed again: the same bits, or what another configuration would have given.

use std::collections::BTreeMap;
use std::sync::Arc;

use crate::aiding::AidingDesk;
use crate::gnss::LeapSeconds;
use crate::store::{EncodedSolution, Revisions, SessionKey, SolutionQuery, Store, StoredSolution};

use super::configuration::base_of;
use super::replay::{By, Course, InForce, in_force};
use super::solvers::Solvers;
use super::state::{Origin, State, VERSION};
use super::{SessionError, SessionId, SessionLimits, SolveRequest};

/// Stored solutions read at once.
const PAGE: usize = 1_000;

/// The way through a stored session, from its first epoch on; nothing is stored.
pub struct Recomputation {
    course: Course,
    /// `None` once all is computed.
    state: Option<State>,
    after: Option<u64>,
    /// Whether what the window holds at the end is answered too.
    to_the_end: bool,
    configuration_hash: Arc<str>,
}

/// What came of comparing a session with what is stored of it.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Check {
    /// Solutions, revisions included, that are stored and were computed again.
    pub compared: usize,
    /// Those of them whose bits differ.
    pub different: usize,
    /// Solutions that were computed and are not stored.
    pub not_stored: usize,
    /// Solutions that are stored and were not computed.
    pub not_computed: usize,
    /// Number and revision of the first that is not as stored.
    pub first: Option<(u64, u32)>,
}

impl Check {
    /// Whether everything is as stored, bit by bit.
    pub fn is_same(&self) -> bool {
        self.first.is_none()
    }
}

impl Recomputation {
    /// A session as it was computed; where `change` is given, all of it by those options.
    ///
    /// # Errors
    /// No such session, a configuration that does not exist, or the store fails.
    pub async fn open(
        store: Store,
        aiding: AidingDesk,
        id: &SessionId,
        change: Option<&SolveRequest>,
    ) -> Result<Self, SessionError> {
        let row = store.session(id.as_str()).await?;
        let row = row.ok_or_else(|| SessionError::NotFound { id: id.to_string() })?;
        let force = match change {
            None => in_force(&store, id.as_str()).await?,
            Some(request) => {
                let options = request.options(&row.settings)?;
                let asked = request.base.clone().try_map(|id| aiding.bases.name(&id))?;
                let base = if asked.is_none() { &row.settings.base } else { &asked };
                let base = base_of(options.mode, base)?;
                let configuration_hash = options.configuration_hash().into();
                let origin = Origin { version: VERSION.into(), configuration_hash, options };
                InForce { origin, base }
            }
        };
        let configuration_hash = force.origin.configuration_hash.clone();
        let state = Some(State::new(&force.origin));
        let course = Course {
            store,
            aiding,
            solvers: Solvers::new(SessionLimits::service().solver_threads),
            key: row.key,
            by: if change.is_some() { By::Options(Arc::new(force)) } else { By::Stored },
            may_differ: false,
        };
        let to_the_end = change.is_some() || row.closed_unix_ms.is_some();
        Ok(Self { course, state, after: None, to_the_end, configuration_hash })
    }

    /// Hash of the configuration in force, or of the one asked for.
    pub fn configuration_hash(&self) -> &str {
        &self.configuration_hash
    }

    /// Leap seconds as far as they are known today.
    pub fn leap_seconds(&self) -> LeapSeconds {
        self.course.aiding.navigation.current().navigation.leap_seconds
    }

    /// The next answers, revisions among them; `None` once all are computed.
    ///
    /// # Errors
    /// Navigation data is kept no more, or the store fails.
    pub async fn next(&mut self) -> Result<Option<Vec<StoredSolution>>, SessionError> {
        let Some(state) = self.state.take() else { return Ok(None) };
        let (mut state, answers) = self.course.next(state, self.after).await?;
        if !answers.is_empty() {
            self.after = state.last.map(|(seq, _)| seq);
            self.state = Some(state);
            return Ok(Some(answers));
        }
        if !self.to_the_end {
            return Ok(None);
        }
        self.course.solvers.estimate(move |scratch| Some(state.finish(scratch))).await
    }

    /// Computes everything and compares it with what is stored.
    ///
    /// # Errors
    /// Navigation data is kept no more, or the store fails.
    pub async fn check(mut self) -> Result<Check, SessionError> {
        let mut check = Check::default();
        let mut stored = Stored::of(&self.course);
        while let Some(answers) = self.next().await? {
            let last = answers.iter().map(|answer| answer.seq).max();
            stored.read_through(last.unwrap_or(0)).await?;
            for answer in answers {
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

/// Whether both are the same solution, whatever version of the program each names.
fn same_bits(stored: &StoredSolution, computed: StoredSolution) -> bool {
    let version = stored.version.clone();
    EncodedSolution::new(stored) == EncodedSolution::new(&StoredSolution { version, ..computed })
}

/// What is stored of a session, read as far as it is needed.
struct Stored {
    store: Store,
    key: SessionKey,
    query: Option<SolutionQuery>,
    /// Read and not yet compared.
    waiting: BTreeMap<(u64, u32), StoredSolution>,
}

impl Stored {
    fn of(course: &Course) -> Self {
        let query = SolutionQuery {
            from: None,
            to: None,
            status: None,
            revisions: Revisions::All,
            page_size: PAGE,
            page_token: None,
        };
        let (store, key) = (course.store.clone(), course.key);
        Self { store, key, query: Some(query), waiting: BTreeMap::new() }
    }

    /// Reads everything up to number `seq`.
    async fn read_through(&mut self, seq: u64) -> Result<(), SessionError> {
        while self.waiting.keys().next_back().is_none_or(|(read, _)| *read <= seq) {
            let Some(query) = &mut self.query else { break };
            let page = self.store.solutions(self.key, query).await?;
            self.waiting
                .extend(page.items.into_iter().map(|item| ((item.seq, item.revision), item)));
            query.page_token = page.next_page_token;
            if query.page_token.is_none() {
                self.query = None;
            }
        }
        Ok(())
    }
}
