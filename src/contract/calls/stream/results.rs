//! Outcomes of epochs as a stream sends them back.

use crate::contract::{Refusal, convert, v1};
use crate::session::{EpochOutcome, sigmas_m};
use crate::store::StoredSolution;

/// The results of epochs for these answers: of all of them, or of the refused ones.
pub(super) fn results(outcomes: Vec<EpochOutcome>, answers: v1::Answers) -> Vec<v1::StreamResult> {
    let mut results = Vec::new();
    for EpochOutcome { seq, result } in outcomes {
        match result {
            Ok(acknowledged) => results.extend(result_of(&acknowledged.solution, answers)),
            Err(refusal) => {
                let refusal = Some(convert::refusal(&Refusal::from(refusal)));
                results.push(v1::StreamResult { seq, refusal, ..Default::default() });
            }
        }
    }
    results
}

/// The result of a durable epoch, unless only its number is asked for.
pub(super) fn result_of(stored: &StoredSolution, answers: v1::Answers) -> Option<v1::StreamResult> {
    let (solution, summary) = match answers {
        v1::Answers::Unspecified | v1::Answers::None => return None,
        v1::Answers::Summary => (None, Some(summary(stored))),
        v1::Answers::Full => (Some(convert::stored(stored)), None),
    };
    Some(v1::StreamResult { seq: stored.seq, solution, summary, refusal: None })
}

fn summary(stored: &StoredSolution) -> v1::StreamSummary {
    let solution = &stored.solution;
    let estimate = solution.estimate.as_ref();
    let sigmas = estimate.map(sigmas_m);
    v1::StreamSummary {
        time: Some(solution.time.into()),
        status: convert::status(solution.status).into(),
        position: estimate.map(|estimate| convert::geodetic(estimate.position)),
        horizontal_sigma_m: sigmas.map(|(horizontal_m, _)| horizontal_m),
        vertical_sigma_m: sigmas.map(|(_, vertical_m)| vertical_m),
        satellites: estimate.map_or(0, |estimate| estimate.satellites_used.len() as u32),
    }
}
