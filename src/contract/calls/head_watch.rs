//! Watches of a fleet: the heads of all sessions, then those that change.
//!
//! Each watch has a task. It reads the heads from the store at an interval, and sends those that
//! differ from what it has sent. The store has the sessions of all nodes.

use std::collections::HashMap;
use std::collections::hash_map::DefaultHasher;
use std::hash::{Hash, Hasher};
use std::time::Duration;

use futures::Stream;
use tokio::time::{Instant, sleep};

use crate::clock::gps_time;
use crate::contract::places::Place;
use crate::contract::{Caller, Lease, Refusal, v1};
use crate::session::SessionError;
use crate::store::{Page, SessionFilter, SessionHead, StoreError};

use super::outlet::{Outlet, outlet};
use super::sessions::{HEAD_BYTES, filter, head_message};
use super::utc;

/// Most heads in one message.
const HEADS: usize = 500;
/// Memory of a watch: the page that it reads and the messages that wait (bytes).
const WATCH_BYTES: usize = 6 * HEADS * HEAD_BYTES;
/// Memory for what a watch remembers of each session (bytes).
const SENT_BYTES: usize = 128;
/// Shortest pause between two readings.
const PAUSE: Duration = Duration::from_secs(1);
/// The pause is at least this many times as long as the reading before it, so that a watch of a
/// large fleet takes at most a thirtieth of a processor.
const PAUSE_OF_READING: u32 = 30;
/// Time without changes after which an empty message is sent, so that no proxy closes the watch as
/// idle.
const KEEPALIVE: Duration = Duration::from_secs(15);

/// Watches the heads of the sessions that match. The first messages have all of them.
///
/// # Errors
/// The filter is invalid, the service is stopping, or the limit of open watches is reached.
pub async fn watch(
    caller: &Caller,
    request: v1::WatchHeadsRequest,
) -> Result<impl Stream<Item = Result<v1::WatchHeadsResponse, Refusal>> + Send + use<>, Refusal> {
    let v1::WatchHeadsRequest { closed, mode, label } = request;
    let filter = filter(closed, mode, label, v1::Order::Unspecified.into())?;
    if caller.is_draining() {
        return Err(SessionError::Draining.into());
    }
    let place = caller.watch_place()?;
    let lease = Lease::current();
    lease.as_ref().map_or(Ok(()), |lease| lease.reserve(WATCH_BYTES))?;
    let (outlet, reader) = outlet(caller);
    let watching = Watching {
        caller: caller.clone(),
        filter,
        lease,
        sent: HashMap::new(),
        reserved: 0,
        reading: 0,
        is_complete: false,
        sent_at: Instant::now(),
        outlet,
    };
    Ok(reader.read(watching.run(place)))
}

/// The task of a watch.
struct Watching {
    caller: Caller,
    filter: SessionFilter,
    /// Memory of the request; it grows with the fleet.
    lease: Option<Lease>,
    /// The last sent head of each session.
    sent: HashMap<String, Sent>,
    /// Number of sessions for which memory is reserved: the most that there were.
    reserved: usize,
    /// Number of the present reading.
    reading: u64,
    /// Whether all heads were sent once.
    is_complete: bool,
    /// When the last message was sent.
    sent_at: Instant,
    outlet: Outlet<v1::WatchHeadsResponse>,
}

/// What a watch remembers of a session.
struct Sent {
    /// Hash of the parts of its head that can change.
    hash: u64,
    /// The last reading in which the session was found.
    reading: u64,
}

impl Watching {
    /// Sends heads until the reader disconnects.
    async fn run(mut self, _place: Place) -> Result<(), Refusal> {
        let mut drained = Box::pin(self.caller.drained());
        loop {
            let begun = Instant::now();
            self.read().await?;
            let pause = PAUSE.max(begun.elapsed() * PAUSE_OF_READING);
            tokio::select! {
                () = sleep(pause) => {}
                () = &mut drained => return Err(SessionError::Draining.into()),
                () = self.outlet.closed() => return Ok(()),
            }
        }
    }

    /// Reads all heads, and sends the new ones.
    async fn read(&mut self) -> Result<(), Refusal> {
        self.reading += 1;
        let mut token = None::<String>;
        while !self.outlet.is_closed() {
            let sessions = self.caller.sessions();
            let page = sessions.heads(&self.filter, None, HEADS, token.as_deref()).await;
            let (Page { items, next_page_token }, now_ms) = match page {
                // The last session of the previous page was deleted. The next reading finds the
                // rest.
                Err(SessionError::Store(StoreError::PageToken { .. })) => return Ok(()),
                page => page?,
            };
            let mut message = v1::WatchHeadsResponse { now_utc: utc(now_ms), ..Default::default() };
            let now = gps_time(now_ms);
            for head in items {
                if self.note(&head)? {
                    message.heads.push(head_message(head, now));
                }
            }
            token = next_page_token;
            if token.is_none() {
                message.gone = self.take_gone();
                return self.send_last(message).await;
            }
            message.complete = self.is_complete;
            if !message.heads.is_empty() {
                self.send(message).await?;
            }
        }
        Ok(())
    }

    /// Notes that a head was read. Returns whether it differs from the last sent one.
    fn note(&mut self, head: &SessionHead) -> Result<bool, Refusal> {
        let mut hasher = DefaultHasher::new();
        // Status and position change with the last epoch.
        (&head.label, &head.mode, head.is_closed, head.last_seq).hash(&mut hasher);
        let sent = Sent { hash: hasher.finish(), reading: self.reading };
        if let Some(before) = self.sent.get_mut(&head.id) {
            let is_new = before.hash != sent.hash;
            *before = sent;
            return Ok(is_new);
        }
        if self.reserved == self.sent.len() {
            self.lease.as_ref().map_or(Ok(()), |lease| lease.reserve(SENT_BYTES))?;
            self.reserved += 1;
        }
        self.sent.insert(head.id.clone(), sent);
        Ok(true)
    }

    /// The sessions that were not found in this reading.
    fn take_gone(&mut self) -> Vec<String> {
        let reading = self.reading;
        let gone = self.sent.extract_if(|_, sent| sent.reading < reading);
        gone.map(|(id, _)| id).collect()
    }

    /// Sends the last message of a reading, unless it is empty and a message was sent recently.
    async fn send_last(&mut self, mut message: v1::WatchHeadsResponse) -> Result<(), Refusal> {
        let has_changes =
            !message.heads.is_empty() || !message.gone.is_empty() || !self.is_complete;
        (message.complete, self.is_complete) = (true, true);
        if has_changes || KEEPALIVE <= self.sent_at.elapsed() {
            self.send(message).await?;
        }
        Ok(())
    }

    async fn send(&mut self, message: v1::WatchHeadsResponse) -> Result<(), Refusal> {
        self.outlet.send(message).await?;
        self.sent_at = Instant::now();
        Ok(())
    }
}
