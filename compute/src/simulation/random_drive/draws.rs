//! Draws of a choice and of a number on a logarithmic scale.

use crate::simulation::random::Random;

/// Draws one choice by its probability; the last choice takes the rest.
pub(super) fn pick<T: Copy>(random: &mut Random, choices: &[(f64, T)]) -> T {
    let mut left = random.uniform(0.0, 1.0);
    for (probability, choice) in choices {
        left -= probability;
        if left < 0.0 {
            return *choice;
        }
    }
    choices[choices.len() - 1].1
}

/// Draws a number whose logarithm is uniform.
pub(super) fn log_uniform(random: &mut Random, low: f64, high: f64) -> f64 {
    random.uniform(low.ln(), high.ln()).exp()
}
