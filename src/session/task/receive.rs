//! The task's handling of raw bytes: decodes, positions and commits them in one step.

use crate::config::OutputOptions;
use crate::gnss::Navigation;
use crate::reception::{Needed, Received, Stream};
use crate::session::panics::caught;
use crate::session::raw::{Order, RawChunk, RawReceived, Reception};
use crate::session::solvers::Lane;
use crate::session::{Acknowledged, EpochOutcome, SequencedEpoch, SessionError};
use crate::store::{RawChange, RawPosition, StoredEpoch};

use super::{Active, Arrived, MailboxPermit, Task};

/// Chunks of frames up to this length are decoded on this thread (bytes), which takes some 50 µs.
const SHORT_BYTES: usize = 16 << 10;

/// A chunk with new bytes.
struct Chunk<'a> {
    reception: Box<Reception>,
    chunk: RawChunk,
    /// Number of bytes at its beginning that are already stored.
    known: usize,
    /// Its permit in the mailbox, which it keeps until it is answered.
    permit: &'a mut Option<MailboxPermit>,
}

impl Task {
    /// Takes a chunk: decodes it, pushes its ephemerides to the broker, positions its epochs, and
    /// commits everything. After a failure the stream is restored from the store.
    pub(super) async fn receive(
        &self,
        active: &mut Option<Active>,
        chunk: RawChunk,
        permit: &mut Option<MailboxPermit>,
    ) -> Result<RawReceived, SessionError> {
        let loaded = self.activate(active).await?;
        let reception = match loaded.raw.take() {
            Some(reception) => reception,
            None => Box::new(self.reception().await?),
        };
        let order = reception.order(&chunk);
        let known = match order {
            Order::New(known) => known,
            Order::Resent => chunk.content.len(),
            Order::Gap => 0,
        };
        let checked = match known {
            0 => Ok(()),
            _ => self.check_known(chunk.offset, &chunk.content[..known]).await,
        };
        if checked.is_err() || !matches!(order, Order::New(_)) {
            let answer = match checked {
                Ok(()) => self.answer_known(loaded, &reception, &chunk, order).await,
                Err(error) => Err(error),
            };
            loaded.raw = Some(reception);
            return answer;
        }
        let chunk = Chunk { reception, chunk, known, permit };
        self.receive_new(active, chunk).await
    }

    /// Takes a chunk with new bytes. A chunk on which a decoder fails is stored without its epochs,
    /// and ends its stream.
    async fn receive_new(
        &self,
        active: &mut Option<Active>,
        arrived: Chunk<'_>,
    ) -> Result<RawReceived, SessionError> {
        let Chunk { mut reception, chunk, known, permit } = arrived;
        let now = self.arrival_ms();
        reception.date(&chunk, now);
        let content = chunk.content.slice(known..);
        let channels = self.aiding.navigation.current_for(&self.device).navigation;
        let is_short = reception.stream.is_of_frames() && content.len() <= SHORT_BYTES;
        let work = move || {
            let received = caught(|| reception.take(&chunk, known, &channels));
            (received, reception, chunk)
        };
        let (received, mut reception, chunk) = match is_short {
            true => work(),
            false => self.solvers.run(Lane::RealTime, work).await?,
        };
        let received = match received {
            Ok(received) => received.map_err(SessionError::Raw)?,
            Err(panic) => {
                let first = chunk.offset + known as u64;
                self.count_failed_decoder(first, &panic);
                reception.begin_after(&chunk);
                Received::of_failed_decoder(first)
            }
        };
        let count = received.epochs.len();
        let count_refused = |_: &SessionError| self.counters.count_refused(count);
        self.check_decoded(count).inspect_err(count_refused)?;
        let mut received = self.brought(received).await.inspect_err(count_refused)?;
        self.admit_decoded(count).inspect_err(count_refused)?;
        let epochs = std::mem::take(&mut received.epochs);
        let is_patient = MailboxPermit::is_of_stream(permit);
        if let Some(permit) = permit {
            permit.raise_to(epochs.len());
        }
        let last_seq = active.as_ref().and_then(Active::last_seq);
        let first_seq = last_seq.unwrap_or(0) + 1;
        reception.advance(&chunk, first_seq, epochs.len(), now);
        let raw_through = reception.position.through;
        let change = Box::new(RawChange { position: reception.position.clone(), content });
        let number = |(seq, epoch)| SequencedEpoch { seq, epoch };
        let epochs: Vec<_> = (first_seq..).zip(epochs).map(number).collect();
        let arrived = Arrived { epochs, raw: Some(change), is_patient };
        let processed = self.process(active, arrived).await;
        let (outcomes, durable_through) = processed.inspect_err(count_refused)?;
        let output = active.as_ref().map_or_else(OutputOptions::as_computed, Active::output);
        if let Some(active) = active {
            active.raw = Some(reception);
        }
        let resent = false;
        Ok(RawReceived { outcomes, durable_through, raw_through, received, resent, output })
    }

    /// Checks the number of epochs of a decoded chunk and the tenant's quotas. Other epochs of the
    /// tenant may have used one up since the chunk arrived.
    fn check_decoded(&self, epochs: usize) -> Result<(), SessionError> {
        match (epochs, self.epochs_per_push) {
            (0, _) => Ok(()),
            (_, limit) if limit < epochs => Err(SessionError::TooManyEpochs { epochs, limit }),
            _ => Ok(self.solvers.meter().check_epochs()?),
        }
    }

    /// Counts the epochs of a decoded chunk for the tenant's quotas, if these still admit them. It
    /// follows all that may refuse the chunk but its commit: what is sent again counts again.
    fn admit_decoded(&self, epochs: usize) -> Result<(), SessionError> {
        match epochs {
            0 => Ok(()),
            _ => Ok(self.solvers.meter().admit_epochs(epochs)?),
        }
    }

    /// Pushes ephemerides to the broker. They are durable when it returns.
    async fn brought(&self, received: Received) -> Result<Received, SessionError> {
        if received.navigation != Navigation::default() {
            self.aiding.navigation.push(received.navigation.clone(), &self.device).await?;
        }
        Ok(received)
    }

    /// Compares repeated bytes with the stored ones.
    async fn check_known(&self, offset: u64, known: &[u8]) -> Result<(), SessionError> {
        let end = offset + known.len() as u64;
        let is_same =
            |(at, bytes): &(u64, Vec<u8>)| known[(at - offset) as usize..].starts_with(bytes);
        let kept = self.store.raw_bytes(self.key, offset, end).await?;
        if kept.iter().all(is_same) {
            return Ok(());
        }
        Err(SessionError::RawConflict { offset, end })
    }

    /// The answer to a chunk without new bytes.
    async fn answer_known(
        &self,
        active: &Active,
        reception: &Reception,
        chunk: &RawChunk,
        order: Order,
    ) -> Result<RawReceived, SessionError> {
        let RawPosition { through, last_chunk: last, .. } = reception.position;
        if matches!(order, Order::Gap) {
            return Err(SessionError::RawGap { offset: chunk.offset, through });
        }
        let end = chunk.offset + chunk.content.len() as u64;
        let is_last = chunk.offset == last.start && end == through;
        let asked: Vec<u64> = match is_last {
            true => (last.first_seq..=last.last_seq).collect(),
            false => Vec::new(),
        };
        let found =
            if asked.is_empty() { Vec::new() } else { self.store.epochs(self.key, &asked).await? };
        let outcome = |stored: StoredEpoch| EpochOutcome {
            seq: stored.solution.seq,
            result: Ok(Acknowledged { solution: stored.solution, resent: true }),
        };
        let mut outcomes: Vec<_> = found.into_iter().map(outcome).collect();
        outcomes.sort_by_key(|outcome| outcome.seq);
        Ok(RawReceived {
            outcomes,
            durable_through: active.last_seq(),
            raw_through: through,
            received: Received::default(),
            resent: true,
            output: active.output(),
        })
    }

    /// Restores the stream from the store. If a decoder fails on the stored bytes, another stream
    /// begins after them.
    async fn reception(&self) -> Result<Reception, SessionError> {
        let Some(position) = self.store.raw_position(self.key).await? else {
            return Ok(Reception::fresh(self.arrival_ms()));
        };
        let RawPosition { stream, header_end, tail, through, time, .. } = position;
        let whole = |parts: Vec<(u64, Vec<u8>)>| {
            parts.into_iter().flat_map(|(_, bytes)| bytes).collect::<Vec<u8>>()
        };
        let _admitted = self.solvers.admitted_stream(through - tail + header_end - stream).await;
        let header = whole(self.store.raw_bytes(self.key, stream, header_end).await?);
        let bytes = whole(self.store.raw_bytes(self.key, tail, through).await?);
        let needed = Needed { header: stream..header_end, tail: tail..through };
        let restore = move || caught(|| Stream::restore(&needed, &header, &bytes, time));
        let stream = match self.solvers.run(Lane::Restore, restore).await? {
            Ok(stream) => stream.map_err(SessionError::Raw)?,
            Err(panic) => {
                self.count_failed_decoder(tail, &panic);
                Stream::new(through, time)
            }
        };
        Ok(Reception { stream, position })
    }

    fn count_failed_decoder(&self, offset: u64, panic: &str) {
        tracing::error!(session = %self.id, offset, panic, "a decoder failed on raw bytes");
        self.counters.meters.quarantined.inc();
    }
}
