//! The task's part in raw bytes: decoded, positioned and committed in one go.

use crate::clock::unix_ms;
use crate::gnss::Navigation;
use crate::reception::{Needed, Received, Stream};
use crate::session::raw::{Order, RawPiece, RawReceived, Reception};
use crate::session::{Acknowledged, EpochOutcome, SequencedEpoch, SessionError};
use crate::store::{Batch, RawChange, RawPosition, StoredEpoch};

use super::{Active, Task};

/// Who brings ephemerides this way, as the status of navigation data names them.
const SOURCE: &str = "device";

impl Task {
    /// Takes a piece: decodes it, gives its ephemerides to the broker, positions its epochs and
    /// commits all of it. After a failure the stream is restored from the store.
    pub(super) async fn receive(
        &self,
        active: &mut Option<Active>,
        piece: RawPiece,
    ) -> Result<RawReceived, SessionError> {
        let mut held = self.activated(active.take()).await?;
        let reception = match held.raw.take() {
            Some(reception) => reception,
            None => Box::new(self.reception().await?),
        };
        let order = reception.order(&piece);
        let known = match order {
            Order::New(known) => known,
            Order::Resent => piece.content.len(),
            Order::Gap => 0,
        };
        let checked = match known {
            0 => Ok(()),
            _ => self.check_known(piece.offset, &piece.content[..known]).await,
        };
        if checked.is_err() || !matches!(order, Order::New(_)) {
            let answer = match checked {
                Ok(()) => self.answer_known(&reception, &piece, order, held.last_seq()).await,
                Err(error) => Err(error),
            };
            *active = Some(Active { raw: Some(reception), ..held });
            return answer;
        }
        self.receive_new(active, held, reception, piece, known).await
    }

    /// Takes a piece of which all but the first `known` bytes are new.
    async fn receive_new(
        &self,
        active: &mut Option<Active>,
        held: Active,
        mut reception: Box<Reception>,
        piece: RawPiece,
        known: usize,
    ) -> Result<RawReceived, SessionError> {
        let now = unix_ms();
        reception.date(&piece, now);
        let content = piece.content.slice(known..);
        let channels = self.aiding.navigation.current().navigation;
        let work = move || {
            let received = reception.take(&piece, known, &channels);
            (received, reception, piece)
        };
        let (received, mut reception, piece) = self.solvers.run(work).await?;
        let taken = match received {
            Ok(received) => self.brought(received).await,
            Err(error) => Err(SessionError::Raw(error)),
        };
        let mut received = match taken {
            Ok(received) => received,
            Err(error) => {
                *active = Some(held);
                return Err(error);
            }
        };
        let epochs = std::mem::take(&mut received.epochs);
        let first_seq = held.last_seq().unwrap_or(0) + 1;
        reception.advance(&piece, first_seq, epochs.len(), now);
        let raw_through = reception.position.through;
        let change = Box::new(RawChange { position: reception.position.clone(), content });
        let number = |(seq, epoch)| SequencedEpoch { seq, epoch };
        let epochs: Vec<_> = (first_seq..).zip(epochs).map(number).collect();
        let (outcomes, durable_through) = if epochs.is_empty() {
            self.store.commit(Batch { raw: Some(change), ..Batch::new(self.key) }).await?;
            let durable_through = held.last_seq();
            *active = Some(held);
            (Vec::new(), durable_through)
        } else {
            self.process(active, held, epochs, Some(change)).await?
        };
        if let Some(active) = active {
            active.raw = Some(reception);
        }
        Ok(RawReceived { outcomes, durable_through, raw_through, received, resent: false })
    }

    /// Hands ephemerides on to the broker; what it returns is durable.
    async fn brought(&self, received: Received) -> Result<Received, SessionError> {
        let (epochs, limit) = (received.epochs.len(), self.epochs_per_batch);
        if limit < epochs {
            return Err(SessionError::TooManyEpochs { epochs, limit });
        }
        if received.navigation != Navigation::default() {
            self.aiding.navigation.push(received.navigation.clone(), SOURCE).await?;
        }
        Ok(received)
    }

    /// Compares bytes that came before with what is kept of them.
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

    /// The answer to a piece without a new byte.
    async fn answer_known(
        &self,
        reception: &Reception,
        piece: &RawPiece,
        order: Order,
        durable_through: Option<u64>,
    ) -> Result<RawReceived, SessionError> {
        let RawPosition { through, piece: last, .. } = reception.position;
        if matches!(order, Order::Gap) {
            return Err(SessionError::RawGap { offset: piece.offset, through });
        }
        let end = piece.offset + piece.content.len() as u64;
        let is_last = piece.offset == last.start && end == through;
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
        let received = Received::default();
        Ok(RawReceived { outcomes, durable_through, raw_through: through, received, resent: true })
    }

    /// The stream as it is stored.
    async fn reception(&self) -> Result<Reception, SessionError> {
        let Some(position) = self.store.raw_position(self.key).await? else {
            return Ok(Reception::fresh(unix_ms()));
        };
        let RawPosition { stream, header_end, tail, through, time, .. } = position;
        let whole = |pieces: Vec<(u64, Vec<u8>)>| {
            pieces.into_iter().flat_map(|(_, bytes)| bytes).collect::<Vec<u8>>()
        };
        let header = whole(self.store.raw_bytes(self.key, stream, header_end).await?);
        let bytes = whole(self.store.raw_bytes(self.key, tail, through).await?);
        let needed = Needed { header: stream..header_end, tail: tail..through };
        let restore = move || Stream::restore(&needed, &header, &bytes, time);
        let stream = self.solvers.run(restore).await?.map_err(SessionError::Raw)?;
        Ok(Reception { stream, position })
    }
}
