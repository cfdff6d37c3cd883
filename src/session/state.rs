//! What a session's estimator stands at, and how it goes on: by epochs that come and by replay
//! alike.

use std::collections::VecDeque;
use std::sync::Arc;

use crate::aiding::bases::BaseGiven;
use crate::config::PositioningOptions;
use crate::gnss::{Epoch, GpsTime, Navigation, Solution};
use crate::positioning::{Aiding, EstimatorState, Scratch};
use crate::snapshot::{Snapshot, SnapshotError, SnapshotReader, SnapshotWriter};
use crate::store::{BaseKey, EncodedSnapshot, StoredSolution};

use super::course::{Against, BaseCourse};

/// Version of this program, which each solution names.
pub(super) const VERSION: &str = env!("CARGO_PKG_VERSION");
/// Layout of the bytes around an estimator's snapshot.
const LAYOUT: u16 = 3;

/// What names the origin of a solution, and makes it.
#[derive(Clone, Debug)]
pub(super) struct Origin {
    pub(super) version: Arc<str>,
    pub(super) configuration_hash: Arc<str>,
    pub(super) options: PositioningOptions,
}

/// A session's estimator after its last epoch.
#[derive(Debug)]
pub(super) struct State {
    pub(super) estimator: EstimatorState,
    /// Of the configuration it was made by.
    pub(super) configuration_hash: Arc<str>,
    /// The base it is relative to.
    course: BaseCourse,
    /// Number and time of the last epoch.
    pub(super) last: Option<(u64, GpsTime)>,
    /// Epochs that the estimator may still answer again, in order.
    unrevised: VecDeque<(u64, GpsTime)>,
    /// Epochs since the state was last stored.
    pub(super) unsaved: usize,
}

/// An epoch's answer, and later answers that it brought to those before it.
pub(super) struct Advanced {
    pub(super) solution: StoredSolution,
    pub(super) revisions: Vec<StoredSolution>,
}

impl State {
    /// The state before the first epoch.
    pub(super) fn new(origin: &Origin) -> Self {
        Self {
            estimator: EstimatorState::new(origin.options.clone(), true),
            configuration_hash: origin.configuration_hash.clone(),
            course: BaseCourse::default(),
            last: None,
            unrevised: VecDeque::new(),
            unsaved: 0,
        }
    }

    /// What the next epoch is given of a base.
    pub(super) fn base_for(
        &self,
        against: &Against,
        epoch: &Epoch,
        navigation: &Navigation,
        origin: &Origin,
    ) -> Option<BaseGiven> {
        let mut course = self.course;
        if !self.goes_on(origin) {
            course.begin_anew();
        }
        course.next(against, epoch, navigation, &origin.options)
    }

    /// The base of the last epoch that had one.
    pub(super) const fn base(&self) -> Option<BaseKey> {
        self.course.base
    }

    /// Whether the estimator is one of `origin`.
    fn goes_on(&self, origin: &Origin) -> bool {
        self.configuration_hash == origin.configuration_hash
    }

    /// Solves the next epoch.
    ///
    /// Where the configuration is not that of the epoch before, the estimator begins anew: what its
    /// window held is answered for the last time, and nothing of it is carried over. Where the base
    /// is another, the estimator does so itself.
    pub(super) fn advance(
        &mut self,
        seq: u64,
        epoch: &Epoch,
        navigation: &Navigation,
        base: Option<&BaseGiven>,
        origin: &Origin,
        scratch: &mut Scratch,
    ) -> Advanced {
        let mut revisions = Vec::new();
        if !self.goes_on(origin) {
            revisions = self.finish(scratch);
            self.estimator = EstimatorState::new(origin.options.clone(), true);
            self.configuration_hash = origin.configuration_hash.clone();
            self.course.begin_anew();
        }
        self.unrevised.push_back((seq, epoch.time));
        let aiding = Aiding { navigation, base: base.and_then(BaseGiven::aiding) };
        let solution = self.estimator.advance(epoch, &aiding, scratch);
        self.course.take(base, &solution);
        let revised = self.estimator.take_revisions();
        revisions.extend(self.numbered(revised, &origin.version));
        let oldest = self.estimator.oldest_unrevised();
        while self.unrevised.front().is_some_and(|(_, time)| oldest.is_none_or(|o| *time < o)) {
            self.unrevised.pop_front();
        }
        self.last = Some((seq, epoch.time));
        self.unsaved += 1;
        let solution = StoredSolution {
            seq,
            revision: 0,
            solution,
            version: origin.version.clone(),
            configuration_hash: self.configuration_hash.clone(),
        };
        Advanced { solution, revisions }
    }

    /// The last answers to what the window holds, which is then empty.
    pub(super) fn finish(&mut self, scratch: &mut Scratch) -> Vec<StoredSolution> {
        let fresh = self.estimator.renewed(true);
        let revised = std::mem::replace(&mut self.estimator, fresh).finish(scratch);
        let revisions = self.numbered(revised, &VERSION.into());
        self.unrevised.clear();
        revisions
    }

    /// Each answer under the number of its epoch; one for each epoch.
    fn numbered(&mut self, revised: Vec<Solution>, version: &Arc<str>) -> Vec<StoredSolution> {
        let number = |solution: Solution| {
            let place = self.unrevised.iter().position(|(_, time)| *time == solution.time)?;
            let (seq, _) = self.unrevised.remove(place)?;
            Some(StoredSolution {
                seq,
                revision: 1,
                solution,
                version: version.clone(),
                configuration_hash: self.configuration_hash.clone(),
            })
        };
        revised.into_iter().filter_map(number).collect()
    }

    /// The state for the store, once there has been an epoch.
    pub(super) fn encoded(&self) -> Option<EncodedSnapshot> {
        let (seq, time) = self.last?;
        let mut writer = SnapshotWriter::new(LAYOUT);
        time.save(&mut writer);
        self.course.save(&mut writer);
        self.unrevised.save(&mut writer);
        writer.bytes(&self.estimator.snapshot());
        Some(EncodedSnapshot::new(seq, self.configuration_hash.clone(), writer.finish()))
    }

    /// The state that [`Self::encoded`] wrote after epoch `seq`, by the options it was made by.
    pub(super) fn decode(seq: u64, content: &[u8], origin: &Origin) -> Result<Self, SnapshotError> {
        let mut reader = SnapshotReader::open(content, LAYOUT)?;
        let time = GpsTime::load(&mut reader)?;
        let course = Snapshot::load(&mut reader)?;
        let unrevised = Snapshot::load(&mut reader)?;
        let estimator = EstimatorState::restore(origin.options.clone(), reader.bytes()?)?;
        reader.finish()?;
        let configuration_hash = origin.configuration_hash.clone();
        let last = Some((seq, time));
        Ok(Self { estimator, configuration_hash, course, last, unrevised, unsaved: 0 })
    }
}

impl Clone for State {
    fn clone(&self) -> Self {
        Self {
            estimator: self.estimator.clone(),
            configuration_hash: self.configuration_hash.clone(),
            course: self.course,
            last: self.last,
            unrevised: self.unrevised.clone(),
            unsaved: self.unsaved,
        }
    }

    /// Copies into the storage already held.
    fn clone_from(&mut self, source: &Self) {
        let Self { estimator, configuration_hash, course, last, unrevised, unsaved } = self;
        estimator.clone_from(&source.estimator);
        configuration_hash.clone_from(&source.configuration_hash);
        *course = source.course;
        *last = source.last;
        unrevised.clone_from(&source.unrevised);
        *unsaved = source.unsaved;
    }
}
