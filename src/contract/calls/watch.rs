//! Watches of the solutions that a session commits, when it commits them.
//!
//! Each watch has a task. It reads the ring of newly committed solutions, or the store if it is
//! behind the ring.

use std::time::Duration;

use futures::Stream;
use tokio::time::timeout;

use crate::config::OutputOptions;
use crate::contract::places::Place;
use crate::contract::{Caller, Lease, Refusal, convert, v1};
use crate::refusal::Code;
use crate::session::{SessionError, SessionId, Watch, WatchCursor, WatchEvent, WatchPage};
use crate::store::{Revisions, StoredSolution};

use super::outlet::{Outlet, outlet};
use super::session_id;

/// Most solutions in one message.
const SOLUTIONS: usize = 32;
/// Memory of a watch: its waiting messages and a page from the store (bytes).
const WATCH_BYTES: usize = 96 << 10;
/// Time without solutions after which an empty message is sent, so that no proxy closes the watch
/// as idle.
const KEEPALIVE: Duration = Duration::from_secs(15);

/// Watches the solutions of a session. The first message is empty and is sent at once.
///
/// # Errors
/// The session does not exist, the cursor is invalid or beyond what is stored, as after a restore
/// from a backup, or the limit of open watches is reached.
pub async fn watch(
    caller: &Caller,
    request: v1::WatchSolutionsRequest,
) -> Result<impl Stream<Item = Result<v1::WatchSolutionsResponse, Refusal>> + Send + use<>, Refusal>
{
    let id = session_id(&request.session)?;
    let start = start(&request)?;
    let with_revisions = match v1::Revisions::try_from(request.revisions) {
        Ok(v1::Revisions::Unspecified) => true,
        _ => match convert::revisions(request.revisions)? {
            Revisions::First => false,
            Revisions::All => true,
            Revisions::Last | Revisions::Later => {
                let message = "a watch has all revisions of each epoch, or the first";
                return Err(Refusal::new(Code::InvalidField, message).at("revisions"));
            }
        },
    };
    if caller.is_draining() {
        return Err(SessionError::Draining.into());
    }
    let place = caller.watch_place()?;
    Lease::current().map_or(Ok(()), |lease| lease.reserve(WATCH_BYTES))?;
    let (watch, now) = caller.sessions().watch(&id).await?;
    let cursor = start.unwrap_or(now);
    if !request.cursor.is_empty() && now.answers < cursor.answers {
        let (through, last) = (cursor.answers, now.answers);
        let message = format!("the cursor is of solution {through}, and the last one is {last}");
        return Err(Refusal::new(Code::CursorInvalid, message).at("cursor"));
    }
    let (outlet, reader) = outlet(caller);
    let (caller, oldest_available) = (caller.clone(), None);
    let output = OutputOptions::as_computed();
    let watching =
        Watching { caller, id, watch, cursor, with_revisions, oldest_available, output, outlet };
    Ok(reader.read(watching.run(place)))
}

/// The cursor from which a watch begins; `None` for the present.
fn start(request: &v1::WatchSolutionsRequest) -> Result<Option<WatchCursor>, Refusal> {
    let (cursor, after_seq) = (&*request.cursor, request.after_seq);
    match (cursor, after_seq) {
        ("", after) => Ok(after.map(|seq| WatchCursor { answers: seq, revisions: seq })),
        (_, Some(_)) => {
            let message = "cursor and afterSeq are both given";
            Err(Refusal::new(Code::InvalidField, message).at("afterSeq"))
        }
        (text, None) => parse(text).map(Some).ok_or_else(|| {
            let message = "this is not the cursor of a watch";
            Refusal::new(Code::CursorInvalid, message).at("cursor")
        }),
    }
}

/// A cursor as a text: the number of the last answer, and that of the last revision.
pub(crate) fn text_of(cursor: WatchCursor) -> String {
    format!("{}.{}", cursor.answers, cursor.revisions)
}

fn parse(text: &str) -> Option<WatchCursor> {
    let number = |text: &str| {
        let is_plain = text.len() <= 16 && text.bytes().all(|byte| byte.is_ascii_digit());
        text.parse().ok().filter(|_| is_plain)
    };
    let (answers, revisions) = text.split_once('.')?;
    Some(WatchCursor { answers: number(answers)?, revisions: number(revisions)? })
}

/// The task of a watch.
struct Watching {
    caller: Caller,
    id: SessionId,
    watch: Watch,
    cursor: WatchCursor,
    with_revisions: bool,
    oldest_available: Option<u64>,
    /// Output options, as last read from the store. They are read before the first solution, and
    /// again after each change of the session.
    output: OutputOptions,
    outlet: Outlet<v1::WatchSolutionsResponse>,
}

impl Watching {
    /// Sends solutions until the session is closed or the reader disconnects.
    async fn run(mut self, _place: Place) -> Result<(), Refusal> {
        let mut drained = Box::pin(self.caller.drained());
        self.send(Vec::new(), false).await?;
        let mut is_closed = self.catch_up().await?;
        while !is_closed {
            let news = tokio::select! {
                news = timeout(KEEPALIVE, self.watch.next()) => news,
                () = &mut drained => return Err(SessionError::Draining.into()),
                () = self.outlet.closed() => return Ok(()),
            };
            is_closed = match news {
                Err(_) => self.send(Vec::new(), false).await.map(|()| false)?,
                Ok(WatchEvent::Unknown) => self.catch_up().await?,
                Ok(WatchEvent::Solutions { solutions, is_closed }) => {
                    self.send_new(solutions.iter().map(|solution| &**solution)).await?;
                    is_closed
                }
            };
        }
        self.send(Vec::new(), true).await
    }

    /// Sends the stored solutions after the cursor. Returns whether the session is closed after
    /// them; also `true` if the reader has disconnected.
    async fn catch_up(&mut self) -> Result<bool, Refusal> {
        while !self.outlet.is_closed() {
            if self.caller.is_draining() {
                return Err(SessionError::Draining.into());
            }
            let asked = (SOLUTIONS / 2, self.with_revisions);
            let page = self.caller.sessions().watched(&self.id, self.cursor, asked).await?;
            let WatchPage { solutions, has_more, oldest_available, is_closed, output } = page;
            (self.oldest_available, self.output) = (oldest_available, output);
            self.send_new(solutions.iter()).await?;
            if !has_more {
                return Ok(is_closed);
            }
        }
        Ok(true)
    }

    /// Sends the solutions that are after the cursor.
    async fn send_new<'a>(
        &mut self,
        solutions: impl Iterator<Item = &'a StoredSolution>,
    ) -> Result<(), Refusal> {
        let mut messages = Vec::new();
        for solution in solutions {
            let is_wanted = self.with_revisions || solution.revision == 0;
            if is_wanted && self.cursor.see(solution) {
                messages.push(convert::stored(solution, &self.caller.presenter(&self.output)));
            }
            if messages.len() == SOLUTIONS {
                self.send(std::mem::take(&mut messages), false).await?;
            }
        }
        if messages.is_empty() { Ok(()) } else { self.send(messages, false).await }
    }

    async fn send(&self, solutions: Vec<v1::Solution>, closed: bool) -> Result<(), Refusal> {
        let cursor = text_of(self.cursor);
        let oldest_available_seq = self.oldest_available;
        let message =
            v1::WatchSolutionsResponse { solutions, cursor, oldest_available_seq, closed };
        self.outlet.send(message).await
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cursor_is_read_as_it_is_written() {
        let cursor = WatchCursor { answers: (1 << 53) - 1, revisions: 0 };
        assert_eq!(parse(&text_of(cursor)), Some(cursor));
        for wrong in ["", "1", "1.", ".1", "1.2.3", "-1.2", "+1.2", "1.99999999999999999", "a.b"] {
            assert_eq!(parse(wrong), None, "{wrong:?}");
        }
    }
}
