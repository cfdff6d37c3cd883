//! Raw bytes of a receiver are pushed, solutions are returned.

use crate::contract::{Caller, Refusal, finished, intake, v1};
use crate::formats::receiver::{RefusalEntry, Statistics};
use crate::reception::{LeftOut, MessageTotal};
use crate::refusal::Code;
use crate::session::{RawChunk, RawReceived, SEQUENCES};

use super::positioning::results;
use super::session_id;

/// Stores a chunk of a receiver's stream; returns when its bytes and the epochs that they complete
/// are committed.
///
/// # Errors
/// The chunk is too large, does not continue the stored stream or has an unknown format, or the
/// session refuses it. The refusal of a single epoch is part of the answer.
pub async fn push(
    caller: &Caller,
    request: v1::PushRawRequest,
) -> Result<v1::PushRawResponse, Refusal> {
    let id = session_id(&request.session)?;
    let at_near = |refusal: Refusal| refusal.at("near");
    let near = request.near.map(|near| intake::time(near.week, near.ns_of_week).map_err(at_near));
    let chunk = RawChunk {
        offset: offset(request.offset, request.content.len())?,
        content: request.content,
        is_end: request.end,
        near: near.transpose()?,
    };
    let sessions = caller.sessions().clone();
    let received = finished(async move { sessions.receive(&id, chunk).await }).await?;
    Ok(answer(caller, received))
}

/// Checks that the offsets of a chunk are integers which every JSON reader represents exactly.
pub(super) fn offset(offset: u64, length: usize) -> Result<u64, Refusal> {
    if offset <= SEQUENCES.end() - length as u64 {
        return Ok(offset);
    }
    let message = format!("{offset} is above {}", SEQUENCES.end());
    Err(Refusal::new(Code::InvalidField, message).at("offset"))
}

fn answer(caller: &Caller, received: RawReceived) -> v1::PushRawResponse {
    let RawReceived { outcomes, durable_through, raw_through, received, resent, output } = received;
    v1::PushRawResponse {
        results: results(outcomes, &caller.presenter(&output)).0,
        durable_through,
        raw_through,
        resent,
        format: received.format.map(|format| format.name().to_owned()).unwrap_or_default(),
        messages: received.messages.iter().map(total).collect(),
        left_out: received.left_out.into_iter().map(left_out).collect(),
        garbage_bytes: received.garbage_bytes,
        ephemerides: received.navigation.len() as u64,
    }
}

/// The counts of one type of message.
pub(super) fn total(MessageTotal { kind, count }: &MessageTotal) -> v1::MessageTotal {
    v1::MessageTotal {
        kind: kind.to_string(),
        decoded: count.decoded,
        passed_over: count.passed_over,
        refused: count.refused,
    }
}

/// One kind of content that was skipped.
pub(super) fn left_out(LeftOut { kind, why, count, first }: LeftOut) -> v1::LeftOut {
    let kind = kind.map(|kind| kind.to_string()).unwrap_or_default();
    v1::LeftOut { kind, why, count, first }
}

/// The counts of a decoder, as messages.
pub(super) fn statistics(counted: &Statistics) -> (Vec<v1::MessageTotal>, Vec<v1::LeftOut>) {
    let messages = counted.messages().map(|(kind, count)| total(&MessageTotal { kind, count }));
    let entry = |entry: &RefusalEntry| v1::LeftOut {
        kind: entry.kind.map(|kind| kind.to_string()).unwrap_or_default(),
        why: entry.reason.to_string(),
        count: entry.count,
        first: entry.offsets.first().copied().unwrap_or_default(),
    };
    (messages.collect(), counted.refusals().iter().map(entry).collect())
}
