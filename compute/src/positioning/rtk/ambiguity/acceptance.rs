//! What a search for integers accepts, and why it refuses.

use crate::config::RtkOptions;
use crate::gnss::Reason;
use crate::lambda::{KnownScale, Options, Outcome, Rejection};

/// Candidates whose likelihoods make up the posterior probability.
const CANDIDATES: usize = 4;
/// Largest number of nodes of the search tree in one epoch.
const NODES_MAX: usize = 20_000;
/// Largest number of subsets tried in one epoch.
const ATTEMPTS_MAX: usize = 12;

/// Options of the search, given the scale of the noise.
pub(crate) fn lambda_options(options: &RtkOptions, scale: KnownScale) -> Options {
    Options {
        success_rate_min: options.success_rate_min,
        ratio_min: options.ratio_min,
        probability_min: options.found_probability_min(),
        scale: Some(scale),
        fixed_min: options.fixed_min,
        candidates: CANDIDATES,
        nodes_max: NODES_MAX,
        attempts_max: ATTEMPTS_MAX,
    }
}

/// Why integers were not accepted, if they were not.
pub(crate) fn refusal(outcome: &Outcome, options: &Options) -> Option<Reason> {
    Some(match outcome.rejection? {
        Rejection::Ratio => Reason::RatioBelowThreshold {
            ratio: outcome.ratio.unwrap_or(1.0),
            threshold: options.ratio_min,
        },
        Rejection::Probability | Rejection::SuccessRate | Rejection::SearchLimit => {
            Reason::SuccessRateTooLow { success_rate: outcome.success_rate }
        }
        Rejection::TooFew | Rejection::Magnitude => Reason::FixRejected,
    })
}
