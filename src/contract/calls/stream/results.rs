//! Outcomes of epochs in the form that a stream sends.

use crate::contract::{Presenter, Refusal, convert, v1};
use crate::gnss::{Solution, SolutionEstimate};
use crate::session::EpochOutcome;
use crate::store::StoredSolution;

/// The results of epochs that a stream has asked for: all of them, or only the refused ones.
pub(super) fn results(
    outcomes: Vec<EpochOutcome>,
    answers: v1::Answers,
    presenter: &Presenter<'_>,
) -> Vec<v1::StreamResult> {
    let mut results = Vec::new();
    for EpochOutcome { seq, result } in outcomes {
        match result {
            Ok(acknowledged) => {
                results.extend(result_of(&acknowledged.solution, answers, presenter));
            }
            Err(refusal) => {
                let refusal = Some(convert::refusal(&Refusal::from(refusal)));
                results.push(v1::StreamResult { seq, refusal, ..Default::default() });
            }
        }
    }
    results
}

/// The result of a durable epoch, unless only its number is asked for.
pub(super) fn result_of(
    stored: &StoredSolution,
    answers: v1::Answers,
    presenter: &Presenter<'_>,
) -> Option<v1::StreamResult> {
    let (solution, summary) = match answers {
        v1::Answers::Unspecified | v1::Answers::None => return None,
        v1::Answers::Summary => (None, Some(summary(&stored.solution, presenter))),
        v1::Answers::Full => (Some(convert::stored(stored, presenter)), None),
    };
    Some(v1::StreamResult { seq: stored.seq, solution, summary, refusal: None })
}

fn summary(solution: &Solution, presenter: &Presenter<'_>) -> v1::StreamSummary {
    // A stream's result cannot state the frame of its position.
    let presented = presenter.present(solution).without_foreign_position();
    let position = presented.solution.estimate.as_ref().map(|estimate| estimate.position);
    let estimate = solution.estimate.as_ref();
    let sigmas = estimate.map(SolutionEstimate::sigmas_m);
    v1::StreamSummary {
        time: Some(solution.time.into()),
        status: convert::status(solution.status).into(),
        position: position.map(convert::geodetic),
        horizontal_sigma_m: sigmas.map(|(horizontal_m, _)| horizontal_m),
        vertical_sigma_m: sigmas.map(|(_, vertical_m)| vertical_m),
        satellites: estimate.map_or(0, |estimate| estimate.satellites_used.len() as u32),
        orthometric_height_m: presented.orthometric_height_m(),
    }
}
