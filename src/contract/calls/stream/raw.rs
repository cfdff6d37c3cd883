//! `Positioning.StreamRaw`: the bytes of a receiver.

use crate::contract::calls::raw::{left_out, offset, total};
use crate::contract::calls::session_id;
use crate::contract::{Caller, Presenter, Refusal, intake, v1};
use crate::gnss::GpsTime;
use crate::refusal::Code;
use crate::session::{Answers, RawChunk, RawReceived, SessionInfo};
use crate::store::StoredSolution;

use super::epochs::{answers, check_acknowledged, misplaced};
use super::flow::{Carried, Opening, Push};
use super::ledger::Amount;
use super::results::{result_of, results};

/// Memory of a chunk and its answer besides the chunk's bytes (bytes).
const CHUNK_BYTES: usize = 2 << 10;
/// Memory of the decoded content for each byte of a chunk (bytes).
const DECODED: usize = 4;

/// A stream of raw bytes.
pub(super) struct OfRaw {
    answers: v1::Answers,
    last_acknowledged: Option<u64>,
    raw_acknowledged: Option<u64>,
    near: Option<GpsTime>,
    durable_through: Option<u64>,
    raw_through: u64,
}

impl Carried for OfRaw {
    type Request = v1::StreamRawRequest;
    type Response = v1::StreamRawResponse;
    type Answer = RawReceived;

    fn open(request: v1::StreamRawRequest) -> Result<Opening<Self>, Refusal> {
        let v1::StreamRawRequest { opening, content, .. } = request;
        let opening = opening.ok_or_else(|| misplaced("the first message must have an opening"))?;
        if !content.is_empty() {
            let message = "the message with the opening has no content";
            return Err(Refusal::new(Code::InvalidField, message).at("content"));
        }
        let answers = answers(opening.answers)?;
        let has_answers = matches!(answers, v1::Answers::Summary | v1::Answers::Full);
        let near = opening.near.map(|near| intake::time(near.week, near.ns_of_week)).transpose();
        let carried = Self {
            answers,
            last_acknowledged: opening.last_acknowledged,
            raw_acknowledged: opening.raw_acknowledged,
            near: near.map_err(|refusal| refusal.at("opening.near"))?,
            durable_through: None,
            raw_through: 0,
        };
        let session = session_id(&opening.session);
        let session = session.map_err(|refusal| refusal.within("opening"))?;
        let after = opening.last_acknowledged.filter(|_| has_answers);
        Ok(Opening { session, carried, after })
    }

    fn opened(
        &mut self,
        info: &SessionInfo,
        idle_s: f64,
    ) -> Result<v1::StreamRawResponse, Refusal> {
        let named = ("epoch", "opening.lastAcknowledged");
        check_acknowledged(self.last_acknowledged, info.durable_through, named)?;
        let named = ("byte", "opening.rawAcknowledged");
        check_acknowledged(self.raw_acknowledged, info.raw_through, named)?;
        self.durable_through = info.durable_through;
        self.raw_through = info.raw_through.unwrap_or(0);
        let opened = v1::StreamRawOpened {
            raw_through: self.raw_through,
            durable_through: info.durable_through,
            oldest_available_seq: info.oldest_available,
            idle_s,
        };
        Ok(v1::StreamRawResponse { opened: Some(opened), ..Default::default() })
    }

    fn push(
        &self,
        caller: &Caller,
        request: v1::StreamRawRequest,
        answers: &Answers<RawReceived>,
    ) -> Result<Option<Push>, Refusal> {
        let v1::StreamRawRequest { opening, offset: at, content, end } = request;
        if opening.is_some() {
            return Err(misplaced("only the first message has an opening"));
        }
        if content.is_empty() && !end {
            return Ok(None);
        }
        let memory = CHUNK_BYTES + DECODED * content.len();
        let offset = offset(at, content.len())?;
        let chunk = RawChunk { offset, content, is_end: end, near: self.near };
        let push = caller.sessions().streamed_chunk(chunk, answers)?;
        Ok(Some(Push { push, memory }))
    }

    fn count(request: &v1::StreamRawRequest) -> u64 {
        u64::from(!request.content.is_empty() || request.end)
    }

    fn known_epochs(_: &v1::StreamRawRequest) -> usize {
        0
    }

    fn answer(
        &mut self,
        caller: &Caller,
        answer: RawReceived,
        response: &mut v1::StreamRawResponse,
    ) {
        let RawReceived { outcomes, durable_through, raw_through, received, resent, output } =
            answer;
        let presenter = caller.presenter(&output);
        (self.durable_through, self.raw_through) = (durable_through, raw_through);
        response.results.extend(results(outcomes, self.answers, &presenter));
        if matches!(self.answers, v1::Answers::Summary | v1::Answers::Full) {
            response.reports.push(v1::StreamRawReport {
                resent,
                format: received.format.map(|format| format.name().to_owned()).unwrap_or_default(),
                messages: received.messages.iter().map(total).collect(),
                left_out: received.left_out.into_iter().map(left_out).collect(),
                garbage_bytes: received.garbage_bytes,
                ephemerides: received.navigation.len() as u64,
            });
        }
    }

    fn missed(
        &self,
        solution: &StoredSolution,
        presenter: &Presenter<'_>,
        response: &mut v1::StreamRawResponse,
    ) {
        response.results.extend(result_of(solution, self.answers, presenter));
    }

    fn complete(&self, response: &mut v1::StreamRawResponse, credit: Amount) {
        response.durable_through = self.durable_through;
        response.raw_through = self.raw_through;
        response.credit = Some(v1::StreamRawCredit { chunks: credit.count, bytes: credit.bytes });
    }

    fn end(response: &mut v1::StreamRawResponse, ending: v1::StreamEnding) {
        response.ending = Some(ending);
    }
}
