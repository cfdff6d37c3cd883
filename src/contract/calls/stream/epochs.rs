//! `Positioning.Stream`: epochs with the device's numbers.

use crate::contract::calls::positioning::{Numbered, read_epochs};
use crate::contract::calls::session_id;
use crate::contract::{Caller, Presenter, Refusal, v1};
use crate::gnss::Observation;
use crate::refusal::Code;
use crate::session::{Answers, SequencedEpoch, SessionInfo, Submitted};
use crate::store::StoredSolution;

use super::flow::{Carried, Opening, Push};
use super::ledger::Amount;
use super::results::{result_of, results};

/// Memory of the answer to an epoch until it is sent (bytes).
const ANSWER_BYTES: usize = 2 << 10;

/// A stream of epochs.
pub(super) struct OfEpochs {
    answers: v1::Answers,
    last_acknowledged: Option<u64>,
    durable_through: Option<u64>,
}

/// Reads which answers a stream is to send.
pub(super) fn answers(number: i32) -> Result<v1::Answers, Refusal> {
    v1::Answers::try_from(number).map_err(|_| {
        let message = format!("{number} is not a choice of answers; known are 1, 2 and 3");
        Refusal::new(Code::InvalidField, message).at("opening.answers")
    })
}

/// Refuses an acknowledged number that the session has not acknowledged.
pub(super) fn check_acknowledged(
    claimed: Option<u64>,
    given: Option<u64>,
    (what, field): (&str, &str),
) -> Result<(), Refusal> {
    let Some(claimed) = claimed.filter(|claimed| given.unwrap_or(0) < *claimed) else {
        return Ok(());
    };
    let given = given.map_or_else(|| "nothing".to_owned(), |given| given.to_string());
    let message = format!("{what} {claimed} is said to be acknowledged, and {given} is stored");
    Err(Refusal::new(Code::AcknowledgementUnknown, message).at(field))
}

/// The refusal of a first message without an opening, or of a later message with one.
pub(super) fn misplaced(message: &str) -> Refusal {
    Refusal::new(Code::InvalidField, message).at("opening")
}

impl Carried for OfEpochs {
    type Request = v1::StreamRequest;
    type Response = v1::StreamResponse;
    type Answer = Submitted;

    fn open(request: v1::StreamRequest) -> Result<Opening<Self>, Refusal> {
        let v1::StreamRequest { opening, epochs } = request;
        let opening = opening.ok_or_else(|| misplaced("the first message must have an opening"))?;
        if !epochs.is_empty() {
            let message = "the message with the opening has no epochs";
            return Err(Refusal::new(Code::InvalidField, message).at("epochs"));
        }
        let within = |refusal: Refusal| refusal.within("opening");
        let answers = answers(opening.answers)?;
        let has_answers = matches!(answers, v1::Answers::Summary | v1::Answers::Full);
        let last_acknowledged = opening.last_acknowledged;
        Ok(Opening {
            session: session_id(&opening.session).map_err(within)?,
            carried: Self { answers, last_acknowledged, durable_through: None },
            after: last_acknowledged.filter(|_| has_answers),
        })
    }

    fn opened(&mut self, info: &SessionInfo, idle_s: f64) -> Result<v1::StreamResponse, Refusal> {
        let named = ("epoch", "opening.lastAcknowledged");
        check_acknowledged(self.last_acknowledged, info.durable_through, named)?;
        self.durable_through = info.durable_through;
        let opened = v1::StreamOpened {
            durable_through: info.durable_through,
            oldest_available_seq: info.oldest_available,
            idle_s,
        };
        Ok(v1::StreamResponse { opened: Some(opened), ..Default::default() })
    }

    fn push(
        &self,
        caller: &Caller,
        request: v1::StreamRequest,
        answers: &Answers<Submitted>,
    ) -> Result<Option<Push>, Refusal> {
        let v1::StreamRequest { opening, epochs } = request;
        if opening.is_some() {
            return Err(misplaced("only the first message has an opening"));
        }
        if epochs.is_empty() {
            return Ok(None);
        }
        let epochs = read_epochs(&epochs, &caller.limits().intake(), Numbered::Yes)?;
        let observations: usize = epochs.iter().map(|read| read.epoch.observations.len()).sum();
        let memory = epochs.len() * (size_of::<SequencedEpoch>() + ANSWER_BYTES)
            + observations * size_of::<Observation>();
        let push = caller.sessions().streamed_epochs(epochs, answers)?;
        Ok(Some(Push { push, memory }))
    }

    fn count(request: &v1::StreamRequest) -> u64 {
        request.epochs.len() as u64
    }

    fn known_epochs(request: &v1::StreamRequest) -> usize {
        request.epochs.len()
    }

    fn answer(&mut self, caller: &Caller, answer: Submitted, response: &mut v1::StreamResponse) {
        self.durable_through = answer.durable_through;
        let presenter = caller.presenter(&answer.output);
        response.results.extend(results(answer.outcomes, self.answers, &presenter));
    }

    fn missed(
        &self,
        solution: &StoredSolution,
        presenter: &Presenter<'_>,
        response: &mut v1::StreamResponse,
    ) {
        response.results.extend(result_of(solution, self.answers, presenter));
    }

    fn complete(&self, response: &mut v1::StreamResponse, credit: Amount) {
        response.durable_through = self.durable_through;
        response.credit = Some(v1::StreamCredit { epochs: credit.count, bytes: credit.bytes });
    }

    fn end(response: &mut v1::StreamResponse, ending: v1::StreamEnding) {
        response.ending = Some(ending);
    }
}
