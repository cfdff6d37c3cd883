//! The state of a session's estimator, and how an epoch advances it. New epochs and replay use the
//! same code.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;

use crate::aiding::bases::BaseInput;
use crate::gnss::{AntennaCalibration, Epoch, GpsTime, Navigation, Reason, Solution};
use crate::positioning::{Aiding, EstimatorState, PreparedOptions, Scratch};
use crate::recording::ApproximatePosition;
use crate::snapshot::{
    Snapshot, SnapshotError, SnapshotReader, SnapshotWriter, clone_fields, seal,
};
use crate::store::{
    BaseKey, EncodedEpoch, EncodedSnapshot, EncodedSolution, EpochReference, FirstAnswer,
    StoredSolution,
};

use super::antenna;
use super::base_selection::{BaseSelection, BaseSource};
use super::panics::caught;

/// Version of this program, stored with each solution.
pub(super) const VERSION: &str = env!("CARGO_PKG_VERSION");
/// Version of the layout, with an estimator's state in it.
const LAYOUT: u16 = 5;
/// The previous layout, with an estimator's snapshot that has a hash of its own. It is still read.
const LAYOUT_BEFORE: u16 = 4;
/// Capacity of a new buffer for each epoch in the window (bytes).
const BYTES_PER_EPOCH: usize = 8 << 10;

/// In unit tests the estimator panics on epochs of this fraction of a second (ns).
#[cfg(test)]
pub(super) const PANICS_AT_NS: i64 = 123_456_789;
#[cfg(test)]
use crate::gnss::constants::NS_PER_SECOND;

/// Replaces the time of the last epoch at the start of an arc, so the next epoch may be earlier.
const BEFORE_ALL: GpsTime = GpsTime::from_ns(i64::MIN);

/// The program version and options that compute a solution.
#[derive(Clone, Debug)]
pub(super) struct Configuration {
    pub(super) version: Arc<str>,
    pub(super) hash: Arc<str>,
    pub(super) options: PreparedOptions,
    /// Calibration of the rover's antenna, if the session corrects for antennas.
    pub(super) antenna: Option<Arc<AntennaCalibration>>,
}

/// A session's estimator after its last epoch.
#[derive(Debug)]
pub(super) struct State {
    pub(super) estimator: EstimatorState,
    /// Hash of the configuration with which the estimator was made.
    pub(super) configuration_hash: Arc<str>,
    /// The base that the estimator uses.
    base_selection: BaseSelection,
    /// The rover's approximate position, for antenna corrections.
    antenna_position: ApproximatePosition,
    /// Number and time of the last epoch.
    pub(super) last: Option<(u64, GpsTime)>,
    /// Epochs that the estimator may still revise, in order.
    unrevised: VecDeque<(u64, GpsTime)>,
    /// Number of epochs since the state was last stored.
    pub(super) unsaved: usize,
    /// Processor time in which they were computed. A replay would need it again.
    pub(super) unsaved_time: Duration,
    /// All epochs since the state was last stored are in partitions of the log that begin on this
    /// day (since 1970-01-01 UTC) or later; `None` if such a day is not known.
    pub(super) since_day: Option<i64>,
    /// The last epoch, to which the next is encoded relative. It is not part of snapshots; the
    /// epoch after a restore is stored whole.
    pub(super) reference: Option<EpochReference>,
    /// The encoded first answers of epochs that may be revised. They are not part of snapshots. A
    /// revision without a first answer here is stored whole.
    first_answers: VecDeque<(u64, FirstAnswer)>,
}

/// The values of a state in memory that its snapshot does not contain.
#[derive(Clone, Debug)]
pub(super) struct Carried {
    unsaved: usize,
    unsaved_time: Duration,
    since_day: Option<i64>,
    reference: Option<EpochReference>,
    first_answers: VecDeque<(u64, FirstAnswer)>,
}

impl Carried {
    /// Processor time that a replay of the epochs since the state was stored would take.
    pub(super) fn unsaved_time(&self) -> Duration {
        self.unsaved_time
    }

    /// See [`State::since_day`].
    pub(super) fn since_day(&self) -> Option<i64> {
        self.since_day
    }

    /// Bytes of memory.
    pub(super) fn bytes(&self) -> usize {
        let reference = self.reference.as_ref().map_or(0, EpochReference::bytes);
        let first_answers = self.first_answers.iter().map(|(_, first)| first.bytes());
        reference + first_answers.sum::<usize>()
    }
}

clone_fields!(State {
    estimator,
    configuration_hash,
    base_selection,
    antenna_position,
    last,
    unrevised,
    unsaved,
    unsaved_time,
    since_day,
    reference,
    first_answers,
});

/// The solution of an epoch, and the revisions of earlier epochs that it led to.
pub(super) struct Advanced {
    pub(super) solution: StoredSolution,
    pub(super) revisions: Vec<StoredSolution>,
}

impl State {
    /// The state before the first epoch.
    pub(super) fn new(configuration: &Configuration) -> Self {
        Self {
            estimator: EstimatorState::prepared(&configuration.options, true),
            configuration_hash: configuration.hash.clone(),
            base_selection: BaseSelection::default(),
            antenna_position: ApproximatePosition::default(),
            last: None,
            unrevised: VecDeque::new(),
            unsaved: 0,
            unsaved_time: Duration::ZERO,
            since_day: None,
            reference: None,
            first_answers: VecDeque::new(),
        }
    }

    /// The base epochs that the estimator receives with the next rover epoch.
    pub(super) fn base_for(
        &self,
        source: &BaseSource,
        epoch: &Epoch,
        navigation: &Navigation,
        configuration: &Configuration,
    ) -> Option<BaseInput> {
        let mut selection = self.base_selection;
        if !self.continues_with(configuration) {
            selection.restart();
        }
        selection.next(source, epoch, navigation, &configuration.options)
    }

    /// The base of the last epoch that used one.
    pub(super) const fn base(&self) -> Option<BaseKey> {
        self.base_selection.base
    }

    /// Number of the last epoch.
    pub(super) fn last_seq(&self) -> Option<u64> {
        self.last.map(|(seq, _)| seq)
    }

    /// Mean processor time of the epochs since the state was stored, if there are any.
    pub(super) fn epoch_time(&self) -> Option<Duration> {
        let epochs = u32::try_from(self.unsaved).ok().filter(|epochs| *epochs != 0)?;
        Some(self.unsaved_time / epochs)
    }

    /// Number of the epochs that may be revised.
    pub(super) fn window_epochs(&self) -> usize {
        self.unrevised.len()
    }

    /// Whether the estimator has this configuration.
    fn continues_with(&self, configuration: &Configuration) -> bool {
        self.configuration_hash == configuration.hash
    }

    /// Solves the next epoch.
    ///
    /// A new estimator starts if the configuration differs from that of the previous epoch, or if
    /// the base's antenna has another calibration. The epochs in the old window get their last
    /// revision, and nothing is carried over. If only the base differs, the estimator itself
    /// restarts what is relative to the base.
    pub(super) fn advance(
        &mut self,
        seq: u64,
        epoch: &Epoch,
        navigation: &Navigation,
        base: Option<&BaseInput>,
        configuration: &Configuration,
        scratch: &mut Scratch,
    ) -> Advanced {
        #[cfg(test)]
        assert!(epoch.time.as_ns() % NS_PER_SECOND != PANICS_AT_NS, "on purpose");
        let mut revisions = Vec::new();
        let is_corrected = configuration.antenna.is_some();
        let is_recalibrated = is_corrected && base.is_some_and(BaseInput::is_recalibrated);
        if !self.continues_with(configuration) || is_recalibrated {
            revisions = self.finish(scratch);
            self.estimator = EstimatorState::prepared(&configuration.options, true);
            self.configuration_hash = configuration.hash.clone();
            self.base_selection.restart();
        }
        self.unrevised.push_back((seq, epoch.time));
        let position = &mut self.antenna_position;
        let corrected = configuration
            .antenna
            .as_ref()
            .map(|antenna| antenna::corrected(antenna, position, epoch, navigation, base));
        let (epoch, base) = match &corrected {
            None => (epoch, base),
            Some((epoch, base)) => (epoch, base.as_ref()),
        };
        let aiding = Aiding { navigation, base: base.and_then(BaseInput::aiding) };
        let solution = self.estimator.advance(epoch, &aiding, scratch);
        self.base_selection.update(base, &solution);
        let revised = self.estimator.take_revisions();
        revisions.extend(self.numbered(revised, &configuration.version));
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
            version: configuration.version.clone(),
            configuration_hash: self.configuration_hash.clone(),
        };
        Advanced { solution, revisions }
    }

    /// Whether an arc has begun since the last epoch.
    pub(super) fn begins_arc(&self) -> bool {
        self.last.is_some_and(|(_, time)| time == BEFORE_ALL)
    }

    /// Begins a new arc after the last epoch, so the next epoch may be earlier. Returns the last
    /// revisions of the epochs in the window.
    pub(super) fn begin_arc(
        &mut self,
        configuration: &Configuration,
        scratch: &mut Scratch,
    ) -> Vec<StoredSolution> {
        let revisions = self.finish(scratch);
        let last = self.last.map(|(seq, _)| (seq, BEFORE_ALL));
        *self = Self { last, ..Self::new(configuration) };
        revisions
    }

    /// Answers an epoch on which the estimator panicked: without a position, with the reason. The
    /// estimator starts again, and the epochs in its window get no revision. A replay recognises
    /// such an answer and does the same.
    pub(super) fn quarantine(
        &mut self,
        seq: u64,
        epoch: &Epoch,
        configuration: &Configuration,
    ) -> Advanced {
        *self = Self {
            last: Some((seq, epoch.time)),
            unsaved: self.unsaved + 1,
            unsaved_time: self.unsaved_time,
            ..Self::new(configuration)
        };
        let solution = StoredSolution {
            seq,
            revision: 0,
            solution: Solution::none(epoch.time, vec![Reason::EstimatorFailed]),
            version: configuration.version.clone(),
            configuration_hash: self.configuration_hash.clone(),
        };
        Advanced { solution, revisions: Vec::new() }
    }

    /// The last revisions of the epochs in the window, which is then empty. None if the estimator
    /// panics.
    pub(super) fn finish(&mut self, scratch: &mut Scratch) -> Vec<StoredSolution> {
        let fresh = self.estimator.renewed(true);
        let estimator = std::mem::replace(&mut self.estimator, fresh);
        let finished = caught(|| estimator.finish(&mut *scratch));
        let revised = finished.unwrap_or_else(|panic| {
            tracing::error!(panic, "the epochs of a window get no revision");
            *scratch = Scratch::default();
            Vec::new()
        });
        let revisions = self.numbered(revised, &VERSION.into());
        self.unrevised.clear();
        revisions
    }

    /// The revisions, with the numbers of their epochs.
    fn numbered(&mut self, revised: Vec<Solution>, version: &Arc<str>) -> Vec<StoredSolution> {
        let number = |solution: Solution| {
            let index = self.unrevised.iter().position(|(_, time)| *time == solution.time)?;
            let (seq, _) = self.unrevised.remove(index)?;
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

    /// Remembers an epoch as it is stored. The next epoch and its own revision are encoded relative
    /// to it.
    pub(super) fn remember(&mut self, stored: &EncodedEpoch) {
        self.reference = Some(stored.reference().clone());
        let newest = self.unrevised.back().map(|(seq, _)| *seq);
        if let Some(seq) = newest.filter(|newest| self.last_seq() == Some(*newest)) {
            self.first_answers.push_back((seq, stored.first_answer()));
        }
    }

    /// Encodes revisions, relative to the first answers that are remembered.
    pub(super) fn encoded_revisions(
        &mut self,
        revisions: &[StoredSolution],
    ) -> Vec<EncodedSolution> {
        let encode = |revision: &StoredSolution| {
            let index = self.first_answers.binary_search_by_key(&revision.seq, |(seq, _)| *seq);
            match index.ok().and_then(|index| self.first_answers.get(index)) {
                Some((_, first)) => EncodedSolution::revision(revision, first),
                None => EncodedSolution::new(revision),
            }
        };
        let encoded = revisions.iter().map(encode).collect();
        let oldest = self.unrevised.front().map(|(seq, _)| *seq);
        while self.first_answers.front().is_some_and(|(seq, _)| oldest.is_none_or(|o| *seq < o)) {
            self.first_answers.pop_front();
        }
        encoded
    }

    /// Notes that the state is stored. The next epoch is stored whole, so that a restore reads no
    /// earlier epoch, and retention may remove those. It takes few bytes compared with the state.
    pub(super) fn note_stored(&mut self) {
        (self.unsaved, self.unsaved_time) = (0, Duration::ZERO);
        self.reference = None;
    }

    /// The values that [`Self::unsealed`] leaves out.
    pub(super) fn carried(&self) -> Carried {
        Carried {
            unsaved: self.unsaved,
            unsaved_time: self.unsaved_time,
            since_day: self.since_day,
            reference: self.reference.clone(),
            first_answers: self.first_answers.clone(),
        }
    }

    /// The decoded state, with the values that were carried besides it.
    pub(super) fn with(self, carried: Carried) -> Self {
        let Carried { unsaved, unsaved_time, since_day, reference, first_answers } = carried;
        Self { unsaved, unsaved_time, since_day, reference, first_answers, ..self }
    }

    /// The encoded state; `None` before the first epoch.
    pub(super) fn encoded(&self) -> Option<EncodedSnapshot> {
        let (seq, content) = self.unsealed(Vec::new())?;
        let hash = self.configuration_hash.clone();
        Some(EncodedSnapshot::new(seq, hash, seal(content), self.since_day))
    }

    /// The content of the encoded state, not yet sealed, in a buffer, and the number of its last
    /// epoch.
    pub(super) fn unsealed(&self, mut buffer: Vec<u8>) -> Option<(u64, Vec<u8>)> {
        let (seq, time) = self.last?;
        if buffer.capacity() == 0 {
            buffer.reserve(BYTES_PER_EPOCH * (self.unrevised.len() + 1));
        }
        let mut writer = SnapshotWriter::within(LAYOUT, buffer);
        time.save(&mut writer);
        self.base_selection.save(&mut writer);
        self.antenna_position.save(&mut writer);
        self.unrevised.save(&mut writer);
        self.estimator.save_in(&mut writer);
        Some((seq, writer.finish_unsealed()))
    }

    /// Decodes the state that [`Self::encoded`] returned after epoch `seq`, with its configuration.
    pub(super) fn decode(
        seq: u64,
        content: &[u8],
        configuration: &Configuration,
    ) -> Result<Self, SnapshotError> {
        let reader = match SnapshotReader::open(content, LAYOUT) {
            Err(SnapshotError::UnknownLayout { found: LAYOUT_BEFORE, .. }) => {
                let reader = SnapshotReader::open(content, LAYOUT_BEFORE)?;
                return Self::read(seq, reader, configuration, |options, reader| {
                    EstimatorState::restore((**options).clone(), reader.bytes()?)
                });
            }
            opened => opened?,
        };
        Self::read(seq, reader, configuration, EstimatorState::load_in)
    }

    /// Decodes a state that [`Self::unsealed`] returned.
    pub(super) fn decode_unsealed(
        seq: u64,
        content: &[u8],
        configuration: &Configuration,
    ) -> Result<Self, SnapshotError> {
        let reader = SnapshotReader::open_unsealed(content, LAYOUT)?;
        Self::read(seq, reader, configuration, EstimatorState::load_in)
    }

    /// Reads a state. `estimator` reads its estimator.
    fn read(
        seq: u64,
        mut reader: SnapshotReader<'_>,
        configuration: &Configuration,
        estimator: impl FnOnce(
            &PreparedOptions,
            &mut SnapshotReader<'_>,
        ) -> Result<EstimatorState, SnapshotError>,
    ) -> Result<Self, SnapshotError> {
        let time = GpsTime::load(&mut reader)?;
        let base_selection = Snapshot::load(&mut reader)?;
        let antenna_position = Snapshot::load(&mut reader)?;
        let unrevised = Snapshot::load(&mut reader)?;
        let estimator = estimator(&configuration.options, &mut reader)?;
        reader.finish()?;
        let configuration_hash = configuration.hash.clone();
        let last = Some((seq, time));
        Ok(Self {
            estimator,
            configuration_hash,
            base_selection,
            antenna_position,
            last,
            unrevised,
            unsaved: 0,
            unsaved_time: Duration::ZERO,
            since_day: None,
            reference: None,
            first_answers: VecDeque::new(),
        })
    }
}

#[cfg(test)]
mod tests {
    use crate::config::{Mode, PositioningOptions, Profile};
    use crate::simulation::{Scenario, Simulator};

    use super::*;

    /// A state in the previous layout is read and continues with the same bits. So does one that
    /// never left the memory.
    #[test]
    fn states_of_both_layouts_go_on_with_the_same_bits() {
        let simulator = Simulator::new(Scenario { duration_s: 20.0, ..Scenario::open_sky() }, 1);
        let navigation = Navigation::clone(simulator.navigation());
        let options = PositioningOptions::new(Mode::Fgo, Profile::General);
        let configuration = Configuration {
            version: VERSION.into(),
            hash: "hash".into(),
            options: PreparedOptions::new(options),
            antenna: None,
        };
        let mut scratch = Scratch::default();
        let mut advance = |state: &mut State, (seq, epoch): (u64, &Epoch)| {
            let advanced =
                state.advance(seq, epoch, &navigation, None, &configuration, &mut scratch);
            format!("{:?} {:?}", advanced.solution, advanced.revisions)
        };
        let epochs: Vec<Epoch> = simulator.map(|epoch| epoch.rover).collect();
        let (before, after) = epochs.split_at(15);
        let mut state = State::new(&configuration);
        for epoch in (1..).zip(before) {
            advance(&mut state, epoch);
        }
        let (seq, time) = state.last.unwrap();
        let mut writer = SnapshotWriter::new(LAYOUT_BEFORE);
        time.save(&mut writer);
        state.base_selection.save(&mut writer);
        state.antenna_position.save(&mut writer);
        state.unrevised.save(&mut writer);
        writer.bytes(&state.estimator.snapshot());
        let earlier = writer.finish();
        let (_, unsealed) = state.unsealed(vec![7; 9]).unwrap();
        let mut states = vec![
            State::decode(seq, &earlier, &configuration).unwrap(),
            State::decode(seq, &seal(unsealed.clone()), &configuration).unwrap(),
            State::decode_unsealed(seq, &unsealed, &configuration).unwrap(),
        ];
        assert!(5 <= after.len());
        for epoch in (seq + 1..).zip(after) {
            let expected = advance(&mut state, epoch);
            for state in &mut states {
                assert_eq!(advance(state, epoch), expected);
            }
        }
    }
}
