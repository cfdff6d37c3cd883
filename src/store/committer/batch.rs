//! A batch: the changes of one session that are committed together, encoded for the store.

use std::sync::Arc;

use crate::gnss::{Epoch, Observation};
use crate::store::chain::CHAIN;
use crate::store::codec::{
    Distances, Measures, SolutionSummary, encode_epoch, encode_relative_epoch, encode_revision,
    encode_solution, solution_columns, solution_measures, solution_summary, status_number,
};
use crate::store::{Arrival, AuditEntry, BaseUse, RawChange, SessionKey, StoredSolution};

/// The changes of one session that are committed together.
#[derive(Clone, Debug)]
pub struct Batch {
    /// Primary key of the session.
    pub session: SessionKey,
    /// Number of the session's last epoch before the batch.
    pub previous: Option<u64>,
    /// Epochs with their real-time answers.
    pub epochs: Vec<EncodedEpoch>,
    /// Revisions of these and earlier epochs. A stored revision is not replaced.
    pub revisions: Vec<EncodedSolution>,
    /// The session's state after the last of the epochs.
    pub snapshot: Option<EncodedSnapshot>,
    /// When it arrived; `None` if it is not known.
    pub arrival: Option<Arrival>,
    /// Whether the snapshot is also kept for replay, if it is the first of its day.
    pub keeps_snapshot: bool,
    /// The chunk of raw bytes from which the epochs were decoded.
    pub raw: Option<Box<RawChange>>,
    /// Begins a new arc of the session.
    pub arc: Option<Box<ArcStart>>,
    /// Closes the session at this time (ms since 1970-01-01 UTC), if it is open.
    pub closed_unix_ms: Option<i64>,
    /// The entry of the audit log for the act that this batch commits.
    pub entry: Option<Box<AuditEntry>>,
    /// Whether the clients that sent its epochs continue without waiting for the answer. Such a
    /// batch may wait longer, so that a transaction has more batches.
    pub is_patient: bool,
}

impl Batch {
    /// A batch without changes, which continues a session after number `previous`.
    pub fn new(session: SessionKey, previous: Option<u64>) -> Self {
        Self {
            session,
            previous,
            epochs: Vec::new(),
            revisions: Vec::new(),
            snapshot: None,
            arrival: None,
            keeps_snapshot: false,
            raw: None,
            arc: None,
            closed_unix_ms: None,
            entry: None,
            is_patient: false,
        }
    }

    /// Whether there is nothing to commit.
    pub(crate) fn is_empty(&self) -> bool {
        self.epochs.is_empty()
            && self.revisions.is_empty()
            && self.snapshot.is_none()
            && self.raw.is_none()
            && self.arc.is_none()
            && self.closed_unix_ms.is_none()
    }

    /// Length of the content that it stores (bytes).
    pub(super) fn bytes(&self) -> usize {
        let snapshot = self.snapshot.iter().map(|snapshot| snapshot.content.len());
        let raw = self.raw.iter().map(|raw| raw.content.len());
        self.added_bytes() + snapshot.chain(raw).sum::<usize>()
    }

    /// Length of its epochs and solutions (bytes). They replace no stored ones.
    pub(super) fn added_bytes(&self) -> usize {
        let epochs =
            self.epochs.iter().map(|epoch| epoch.content.len() + epoch.solution.content.len());
        let revisions = self.revisions.iter().map(|revision| revision.content.len());
        epochs.chain(revisions).sum()
    }

    /// The day of arrival as it is stored; `None` if it is not known.
    pub(super) fn day(&self) -> Option<i32> {
        self.arrival.and_then(Arrival::stored_day)
    }

    /// First day of its partition; `None` if the day is unknown or has no partition.
    pub(super) fn partition(&self) -> Option<i32> {
        self.arrival.and_then(Arrival::stored_partition)
    }
}

/// The beginning of an arc. Its epochs are positioned without those of earlier arcs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ArcStart {
    /// Number of the last epoch of the arc before.
    pub after_seq: u64,
    /// When it was requested (ms since 1970-01-01 UTC).
    pub unix_ms: i64,
}

/// A session's last epoch. The next epoch is encoded relative to it.
#[derive(Clone, Debug)]
pub struct EpochReference {
    epoch: Arc<Epoch>,
    seq: u64,
    /// Number of the whole epoch with which its chain begins.
    first: u64,
    /// Epochs in its chain so far.
    length: usize,
}

impl EpochReference {
    /// Memory that it takes (bytes).
    pub(crate) fn bytes(&self) -> usize {
        size_of::<Epoch>() + self.epoch.observations.len() * size_of::<Observation>()
    }
}

/// An encoded epoch with its real-time answer.
#[derive(Clone, Debug)]
pub struct EncodedEpoch {
    pub(super) seq: i64,
    pub(super) gps_time_ns: i64,
    pub(super) navigation: i64,
    base: Option<BaseUse>,
    reference: EpochReference,
    pub(super) content: Vec<u8>,
    pub(super) solution: EncodedSolution,
    /// The values of the solution that rollups add up.
    pub(super) measures: Option<Measures>,
}

impl EncodedEpoch {
    /// Encodes an epoch and its `solution`, computed with the navigation data of push number
    /// `navigation` and with `base`. `last` must be the session's last epoch. The epoch is encoded
    /// relative to `last`, unless it begins a new chain.
    pub fn new(
        epoch: Arc<Epoch>,
        solution: &StoredSolution,
        navigation: u64,
        base: Option<BaseUse>,
        last: Option<&EpochReference>,
    ) -> Self {
        let seq = solution.seq;
        let last = last.filter(|last| last.length < CHAIN && last.seq < seq);
        let (content, first, length) = match last {
            None => (encode_epoch(&epoch), seq, 1),
            Some(last) => {
                let distances = Distances { reference: seq - last.seq, first: seq - last.first };
                let content = encode_relative_epoch(&epoch, &last.epoch, distances);
                (content, last.first, last.length + 1)
            }
        };
        Self {
            seq: number(seq),
            gps_time_ns: epoch.time.as_ns(),
            navigation: number(navigation),
            base,
            reference: EpochReference { epoch, seq, first, length },
            content,
            solution: EncodedSolution::new(solution),
            measures: solution_measures(&solution.solution),
        }
    }

    /// This epoch as the reference to which the next one is encoded.
    pub(crate) fn reference(&self) -> &EpochReference {
        &self.reference
    }

    /// The first answer, to which a revision is encoded relative.
    pub(crate) fn first_answer(&self) -> FirstAnswer {
        self.solution.first_answer()
    }

    /// Key of the base and the numbers of [`BaseUse`], as columns.
    pub(super) fn base_columns(&self) -> [Option<i64>; 3] {
        let column = |of: fn(&BaseUse) -> i64| self.base.as_ref().map(of);
        [column(|b| b.base.0), column(|b| number(b.after)), column(|b| number(b.through))]
    }

    /// Whether `epoch` equals this one, bit by bit.
    pub(crate) fn is(&self, epoch: &Epoch) -> bool {
        encode_epoch(&self.reference.epoch) == encode_epoch(epoch)
    }
}

/// Origin of a solution: version of the program, and hash of the configuration.
pub(super) type Origin = (Arc<str>, Arc<str>);

/// An encoded solution. Equal solutions have equal bytes.
#[derive(Clone, Debug, PartialEq)]
pub struct EncodedSolution {
    pub(super) seq: i64,
    pub(super) revision: i16,
    pub(super) gps_time_ns: i64,
    pub(super) status: i16,
    pub(super) position_m: [Option<f64>; 3],
    pub(super) summary: SolutionSummary,
    pub(super) origin: Origin,
    pub(super) content: Arc<[u8]>,
}

/// The encoded first answer of an epoch, to which its revision is encoded relative.
#[derive(Clone, Debug)]
pub struct FirstAnswer(Arc<[u8]>);

impl FirstAnswer {
    /// Memory that it takes (bytes).
    pub(crate) fn bytes(&self) -> usize {
        self.0.len()
    }
}

impl EncodedSolution {
    /// Encodes a solution.
    pub fn new(stored: &StoredSolution) -> Self {
        Self::with_content(stored, encode_solution(&stored.solution))
    }

    /// Encodes a revision relative to the first answer of its epoch.
    pub(crate) fn revision(stored: &StoredSolution, FirstAnswer(first): &FirstAnswer) -> Self {
        Self::with_content(stored, encode_revision(&stored.solution, first))
    }

    fn with_content(stored: &StoredSolution, content: Vec<u8>) -> Self {
        let StoredSolution { seq, revision, solution, version, configuration_hash } = stored;
        Self {
            seq: number(*seq),
            revision: i16::try_from(*revision).expect("revisions are few"),
            gps_time_ns: solution.time.as_ns(),
            status: status_number(solution.status),
            position_m: solution_columns(solution).position_m,
            summary: solution_summary(solution),
            origin: (version.clone(), configuration_hash.clone()),
            content: content.into(),
        }
    }

    fn first_answer(&self) -> FirstAnswer {
        FirstAnswer(self.content.clone())
    }
}

/// An encoded state of a session after an epoch.
#[derive(Clone, Debug, PartialEq)]
pub struct EncodedSnapshot {
    pub(super) seq: i64,
    pub(super) configuration_hash: Arc<str>,
    pub(super) content: Vec<u8>,
    pub(super) since_day: Option<i64>,
}

impl EncodedSnapshot {
    /// The state after epoch `seq`, with the hash of its configuration. All later epochs are in
    /// partitions that begin on `since_day` (since 1970-01-01 UTC) or later, if it is known.
    pub fn new(
        seq: u64,
        configuration_hash: Arc<str>,
        content: Vec<u8>,
        since_day: Option<i64>,
    ) -> Self {
        Self { seq: number(seq), configuration_hash, content, since_day }
    }

    /// The day as it is stored.
    pub(super) fn stored_day(&self) -> Option<i32> {
        self.since_day.and_then(|day| i32::try_from(day).ok())
    }
}

fn number(value: u64) -> i64 {
    i64::try_from(value).expect("the desk refuses numbers above i64::MAX")
}
