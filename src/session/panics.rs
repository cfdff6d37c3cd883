//! Panics of an estimator. They are faults of the program, and must not end a session.

use std::panic::{AssertUnwindSafe, catch_unwind};

use crate::panics::words;

/// The result of `work`, or the message of its panic. After a panic, everything that `work` changed
/// is in an undefined state and must be replaced.
pub(super) fn caught<T>(work: impl FnOnce() -> T) -> Result<T, String> {
    catch_unwind(AssertUnwindSafe(work)).map_err(|panic| words(&*panic).to_owned())
}

#[cfg(test)]
mod tests {
    use tempfile::TempDir;

    use crate::aiding::bases::BaseChoice;
    use crate::aiding::{AidingDesk, AidingLimits};
    use crate::formats::receiver::RawxWriter;
    use crate::gnss::{GpsTime, Status};
    use crate::session::raw::PANICS_AFTER;
    use crate::session::state::PANICS_AT_NS;
    use crate::session::{
        Acknowledged, NewSession, RawChunk, Recomputation, SequencedEpoch, SessionId,
        SessionLimits, Sessions,
    };
    use crate::simulation::{Scenario, Simulator};
    use crate::store::Store;

    use super::*;

    #[test]
    fn a_panic_becomes_its_message() {
        assert_eq!(caught(|| 7), Ok(7));
        assert_eq!(caught::<()>(|| panic!("singular at {}", 3)), Err("singular at 3".to_owned()));
    }

    /// A desk on a new database, which ends with its folder.
    async fn opened() -> (TempDir, Store, Sessions) {
        let folder = tempfile::tempdir().unwrap();
        let url = format!("sqlite://{}", folder.path().join("graphfix.db").display());
        let store = Store::open(&url).await.unwrap();
        let sessions = desk(&store).await;
        (folder, store, sessions)
    }

    async fn desk(store: &Store) -> Sessions {
        let aiding = AidingDesk::open(store.clone(), AidingLimits::service()).await.unwrap();
        Sessions::open(store.clone(), aiding, SessionLimits::service())
    }

    /// A drive on whose epochs 10, 11 and 25 the estimator panics.
    async fn drive(sessions: &Sessions) -> Vec<SequencedEpoch> {
        let simulator = Simulator::new(Scenario { duration_s: 40.0, ..Scenario::open_sky() }, 1);
        let navigation = (**simulator.navigation()).clone();
        sessions.aiding().navigation.push(navigation, "simulation").await.unwrap();
        let numbered = (1..).zip(simulator).map(|(seq, simulated)| {
            let mut epoch = simulated.rover;
            if [10, 11, 25].contains(&seq) {
                epoch.time = GpsTime::from_ns(epoch.time.as_ns() + PANICS_AT_NS);
            }
            SequencedEpoch { seq, epoch }
        });
        numbered.collect()
    }

    async fn created(sessions: &Sessions) -> SessionId {
        let new = NewSession {
            label: String::new(),
            mode: "fgo".to_owned(),
            profile: "general".to_owned(),
            overrides: std::collections::BTreeMap::new(),
            base: BaseChoice::None,
            antenna: String::new(),
            retention_days: None,
        };
        sessions.create(new).await.unwrap().id
    }

    async fn answers(
        sessions: &Sessions,
        id: &SessionId,
        epochs: &[SequencedEpoch],
    ) -> Vec<Acknowledged> {
        let outcomes = sessions.submit(id, epochs.to_vec()).await.unwrap().outcomes;
        outcomes.into_iter().map(|outcome| outcome.result.unwrap()).collect()
    }

    /// Epochs on which the estimator panics are stored and answered, and the epochs around them are
    /// positioned. A restart and a replay give the same answers.
    #[tokio::test]
    async fn an_epoch_that_fails_is_quarantined() {
        let (_folder, store, sessions) = opened().await;
        let (id, epochs) = (created(&sessions).await, drive(&sessions).await);
        let mut first = Vec::new();
        for batch in epochs[..20].chunks(7) {
            first.extend(answers(&sessions, &id, batch).await);
        }
        for Acknowledged { solution, resent } in &first {
            let is_failed = [10, 11].contains(&solution.seq);
            let codes: Vec<_> = solution.solution.reasons.iter().map(|r| r.code()).collect();
            assert_eq!(codes.contains(&"ESTIMATOR_FAILED"), is_failed, "{solution:?}");
            assert_eq!(solution.solution.status == Status::None, is_failed, "{solution:?}");
            assert!(!resent);
        }
        assert_eq!(sessions.counts().quarantined(), 2);
        let resent = answers(&sessions, &id, &epochs[9..10]).await;
        assert!(resent[0].resent && resent[0].solution == first[9].solution);

        // Restored from the store, with the failed epochs after the last snapshot.
        let restarted = desk(&store).await;
        answers(&restarted, &id, &epochs[20..]).await;
        let aiding = restarted.aiding().clone();
        let again = Recomputation::open(store, aiding, &id, None).await.unwrap();
        let check = again.check().await.unwrap();
        assert!(check.is_same() && 40 < check.compared, "{check:?}");
    }

    /// A chunk on which a decoder panics is stored and answered without epochs. Sent again it is
    /// known, and the next chunks bring their epochs.
    #[tokio::test]
    async fn a_chunk_that_fails_is_quarantined() {
        let (_folder, store, sessions) = opened().await;
        let id = created(&sessions).await;
        let mut writer = RawxWriter::default();
        let simulator = Simulator::new(Scenario { duration_s: 30.0, ..Scenario::open_sky() }, 1);
        let frames: Vec<_> = simulator.map(|simulated| writer.frame(&simulated.rover)).collect();
        let failing = [&frames[10..20].concat(), PANICS_AFTER].concat();
        let contents = [frames[..10].concat(), failing, frames[20..].concat()];
        let mut offset = 0;
        let chunks = contents.map(|content| {
            let chunk = RawChunk { offset, content: content.into(), is_end: false, near: None };
            offset += chunk.content.len() as u64;
            chunk
        });
        let mut numbers = Vec::new();
        for (chunk, desk) in chunks.iter().zip([&sessions, &sessions, &desk(&store).await]) {
            let answer = desk.receive(&id, chunk.clone()).await.unwrap();
            assert_eq!(answer.raw_through, chunk.offset + chunk.content.len() as u64);
            numbers.extend(answer.outcomes.iter().map(|outcome| outcome.seq));
            let failed = answer.received.left_out.iter().filter(|part| part.first == chunk.offset);
            let is_failing = chunk.content.ends_with(PANICS_AFTER);
            assert_eq!(failed.count(), usize::from(is_failing), "{answer:?}");
            assert!(desk.receive(&id, chunk.clone()).await.unwrap().resent);
        }
        let positioned: Vec<u64> = (1..=frames.len() as u64 - 10).collect();
        assert_eq!(numbers, positioned);
        assert_eq!(sessions.counts().quarantined(), 1);
    }
}
