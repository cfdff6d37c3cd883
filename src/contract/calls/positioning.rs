//! Positioning: epochs are pushed, solutions are returned.

use crate::config::IntakeLimits;
use crate::contract::convert::{self, Stored};
use crate::contract::{
    Caller, Lease, Presenter, Refusal, finished, intake, off_the_network, texts, v1,
};
use crate::gnss::Observation;
use crate::session::{Burst, Computed, EpochOutcome, SequencedEpoch, SolveRequest, Submitted};

use super::{MODE, PROFILE, base_choice, or_standard, session_id};

/// Positions the epochs of a push; returns when they are committed.
///
/// # Errors
/// An epoch is malformed, or the session refuses the push. If the session refuses every epoch, the
/// error is the refusal of the first one.
pub async fn push_epochs(
    caller: &Caller,
    request: v1::PushEpochsRequest,
) -> Result<v1::PushEpochsResponse, Refusal> {
    let count = request.epochs.len();
    let read = session_id(&request.session)
        .and_then(|id| Ok((id, epochs(request.epochs, &caller.limits().intake(), Numbered::Yes)?)));
    let sessions = caller.sessions().clone();
    // The session counts the refusals that it makes itself.
    let (id, epochs) = read.inspect_err(|_| sessions.counts().count_refused(count))?;
    let submitted = finished(async move { sessions.submit(&id, epochs).await }).await?;
    answer(caller, submitted)
}

/// Solves the session's present window.
///
/// # Errors
/// The session does not exist or has no epoch, or the configuration does not exist.
pub async fn solve(
    caller: &Caller,
    request: v1::SolveRequest,
) -> Result<v1::SolveResponse, Refusal> {
    let id = session_id(&request.session)?;
    texts::check_names([("mode", &*request.mode), ("profile", &*request.profile)])?;
    texts::check_overrides(&request.overrides)?;
    let given = |text: String| Some(text).filter(|text| !text.is_empty());
    let request = SolveRequest {
        mode: given(request.mode),
        profile: given(request.profile),
        overrides: request.overrides,
        base: base_choice(caller, &request.base, &request.bases)?,
    };
    let computed = caller.sessions().solve(&id, &request).await?;
    Ok(v1::SolveResponse { solution: Some(message(caller, &computed)) })
}

/// Positions a few epochs without a session.
///
/// # Errors
/// An epoch is malformed, the epochs are out of order, or the configuration does not exist.
pub async fn solve_once(
    caller: &Caller,
    request: v1::SolveOnceRequest,
) -> Result<v1::SolveOnceResponse, Refusal> {
    texts::check_names([("mode", &*request.mode), ("profile", &*request.profile)])?;
    texts::check_overrides(&request.overrides)?;
    let burst = Burst {
        mode: or_standard(request.mode, MODE),
        profile: or_standard(request.profile, PROFILE),
        overrides: request.overrides,
        epochs: epochs(request.epochs, &caller.limits().intake(), Numbered::No)?,
        navigation: None,
        base: base_choice(caller, &request.base, &request.bases)?,
        antenna: request.antenna,
    };
    let computed = caller.sessions().solve_once(burst).await?;
    let solutions = computed.iter().map(|computed| message(caller, computed)).collect();
    Ok(v1::SolveOnceResponse { solutions })
}

/// Whether epochs must have a number.
#[derive(Clone, Copy, PartialEq)]
pub(super) enum Numbered {
    Yes,
    No,
}

/// Memory of the answer to an epoch, as a message and encoded (bytes).
const ANSWER_BYTES: usize = 8 << 10;

/// Reads the epochs of a request. The memory of their messages is returned to the budget.
pub(super) fn epochs(
    messages: Vec<v1::Epoch>,
    limits: &IntakeLimits,
    numbered: Numbered,
) -> Result<Vec<SequencedEpoch>, Refusal> {
    let epochs = read_epochs(&messages, limits, numbered)?;
    drop(messages);
    if let Some(lease) = Lease::current() {
        let observations: usize = epochs.iter().map(|read| read.epoch.observations.len()).sum();
        let of_epochs = epochs.len() * (size_of::<SequencedEpoch>() + ANSWER_BYTES);
        lease.shrink_to(of_epochs + observations * size_of::<Observation>());
    }
    Ok(epochs)
}

/// Reads and checks the epochs of a message.
pub(super) fn read_epochs(
    messages: &[v1::Epoch],
    limits: &IntakeLimits,
    numbered: Numbered,
) -> Result<Vec<SequencedEpoch>, Refusal> {
    intake::epoch_count(messages.len(), limits)?;
    let observations: usize = messages.iter().map(|epoch| epoch.observations.len()).sum();
    let read = |(index, message): (usize, &v1::Epoch)| {
        let within = |refusal: Refusal| refusal.within(&format!("epochs[{index}]"));
        let seq = match numbered {
            Numbered::Yes => intake::sequence(message.seq).map_err(within)?,
            Numbered::No => message.seq,
        };
        Ok(SequencedEpoch { seq, epoch: convert::epoch(message, limits).map_err(within)? })
    };
    let bytes = observations * size_of::<v1::Observation>();
    off_the_network(bytes, || messages.iter().enumerate().map(read).collect())
}

fn answer(caller: &Caller, submitted: Submitted) -> Result<v1::PushEpochsResponse, Refusal> {
    let (results, refused) = results(submitted.outcomes, &caller.presenter(&submitted.output));
    match refused {
        Some(first) if results.iter().all(|result| result.solution.is_none()) => Err(first),
        _ => Ok(v1::PushEpochsResponse { results, durable_through: submitted.durable_through }),
    }
}

fn message(caller: &Caller, computed: &Computed) -> v1::Solution {
    let stored = Stored {
        seq: computed.seq,
        revision: 0,
        configuration_hash: &computed.configuration_hash,
        version: &computed.version,
    };
    let presenter = caller.presenter(&computed.output);
    convert::solution(&presenter.present(&computed.solution), stored)
}

/// The answer to each epoch, and the first refusal.
pub(super) fn results(
    outcomes: Vec<EpochOutcome>,
    presenter: &Presenter<'_>,
) -> (Vec<v1::EpochResult>, Option<Refusal>) {
    let mut refused = None;
    let mut results = Vec::with_capacity(outcomes.len());
    for (index, EpochOutcome { seq, result }) in outcomes.into_iter().enumerate() {
        let mut message = v1::EpochResult { seq, solution: None, refusal: None };
        match result {
            Ok(acknowledged) => {
                message.solution = Some(convert::stored(&acknowledged.solution, presenter));
            }
            Err(refusal) => {
                let refusal = Refusal::from(refusal).within(&format!("epochs[{index}]"));
                message.refusal = Some(convert::refusal(&refusal));
                refused.get_or_insert(refusal);
            }
        }
        results.push(message);
    }
    (results, refused)
}
