//! Whether the store has every acknowledged epoch, once.

use std::collections::BTreeMap;
use std::sync::Arc;

use tokio::sync::Semaphore;
use tokio::task::JoinSet;

use crate::cli::Failure;
use crate::cli::connection::Connection;
use crate::contract::v1;

use super::AT_ONCE;
use super::device::Sent;

/// Solutions on a page.
const PAGE: u32 = 1000;

/// All devices together.
#[derive(Debug, Default, PartialEq)]
pub(super) struct Verified {
    /// Acknowledged epochs.
    pub(super) epochs: usize,
    /// Epochs that were acknowledged and are not stored.
    pub(super) lost: usize,
    /// Epochs that are stored twice.
    pub(super) doubled: usize,
    /// Answers that were sent again after a break.
    pub(super) repeated: usize,
    /// Epochs that were never acknowledged.
    pub(super) unanswered: usize,
    pub(super) delays_ms: Vec<f32>,
    pub(super) errors: Vec<String>,
    pub(super) breaks: usize,
}

/// Reads the stored solutions of each device.
///
/// # Errors
/// The service does not answer.
pub(super) async fn verify(
    sent: Vec<Sent>,
    connections: &[Connection],
) -> Result<Verified, Failure> {
    let at_once = Arc::new(Semaphore::new(AT_ONCE));
    let mut reading = JoinSet::new();
    for (index, sent) in sent.into_iter().enumerate() {
        let connection = connections[index % connections.len()].clone();
        let at_once = Arc::clone(&at_once);
        reading.spawn(async move {
            let _permit = at_once.acquire_owned().await;
            let stored = stored(&connection, &sent.session).await?;
            Ok::<_, Failure>((sent, stored))
        });
    }
    let mut verified = Verified::default();
    for read in reading.join_all().await {
        let (sent, stored) = read?;
        verified.add(sent, &stored);
    }
    Ok(verified)
}

/// How often each number of a session is stored.
async fn stored(connection: &Connection, session: &str) -> Result<BTreeMap<u64, usize>, Failure> {
    let mut stored = BTreeMap::new();
    let mut request = v1::ListSolutionsRequest {
        session: session.to_owned(),
        page_size: PAGE,
        revisions: v1::Revisions::First.into(),
        ..Default::default()
    };
    loop {
        let page = connection.solutions(request.clone()).await?;
        for solution in page.solutions {
            *stored.entry(solution.seq).or_default() += 1;
        }
        if page.next_page_token.is_empty() {
            return Ok(stored);
        }
        request.page_token = page.next_page_token;
    }
}

impl Verified {
    fn add(&mut self, sent: Sent, stored: &BTreeMap<u64, usize>) {
        let numbered = (1_u64..).zip(&sent.acknowledged);
        let acknowledged = numbered.filter(|(_, is_acknowledged)| **is_acknowledged);
        let (found, lost): (Vec<u64>, Vec<u64>) =
            acknowledged.map(|(seq, _)| seq).partition(|seq| stored.contains_key(seq));
        let epochs = found.len() + lost.len();
        self.epochs += epochs;
        self.lost += lost.len();
        self.unanswered += sent.acknowledged.len() - epochs;
        self.doubled += stored.values().map(|count| count - 1).sum::<usize>();
        self.repeated += sent.repeated;
        self.breaks += sent.breaks;
        self.delays_ms.extend(sent.delays_ms);
        self.errors.extend(sent.errors);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_lost_doubled_and_unanswered() {
        let mut verified = Verified::default();
        let sent = Sent { acknowledged: vec![true, true, false, true], ..Sent::default() };
        verified.add(sent, &BTreeMap::from([(1, 1), (3, 1), (4, 2)]));
        let expected =
            Verified { epochs: 3, lost: 1, doubled: 1, unanswered: 1, ..Verified::default() };
        assert_eq!(verified, expected);
    }
}
