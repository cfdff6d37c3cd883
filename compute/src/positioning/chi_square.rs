//! Quantiles of the chi-square distribution.

/// Largest tabulated number of degrees of freedom, above the number of satellites in view.
const DEGREES_MAX: usize = 64;

/// From FAR + FAR_PER_DEGREE·k on, a chi-square variable of k degrees of freedom is exceeded with a
/// probability below 10⁻⁴⁰.
const FAR: f64 = 200.0;
const FAR_PER_DEGREE: f64 = 5.0;

/// Values that a chi-square variable exceeds with a given probability, by degrees of freedom.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct ChiSquareLimits([f64; DEGREES_MAX]);

impl ChiSquareLimits {
    /// The limits that are exceeded with the probability `upper_tail`, 0 < `upper_tail` < 1.
    pub(crate) fn new(upper_tail: f64) -> Self {
        let mut limits = [0.0; DEGREES_MAX];
        let mut guess = 0.0;
        for (index, limit) in limits.iter_mut().enumerate() {
            guess = quantile(index + 1, 1.0 - upper_tail, guess + 1.0);
            *limit = guess;
        }
        Self(limits)
    }

    /// The limit for `degrees` degrees of freedom, 1 or more. Above 64 it is that of 64, scaled in
    /// proportion.
    pub(crate) fn at(&self, degrees: usize) -> f64 {
        let tabulated = degrees.clamp(1, DEGREES_MAX);
        self.0[tabulated - 1] * (degrees.max(1) as f64 / tabulated as f64)
    }
}

/// Probability that a chi-square variable of `degrees` degrees of freedom, 1 or more, exceeds `x`.
pub(crate) fn probability_above(degrees: usize, x: f64) -> f64 {
    if x <= 0.0 {
        1.0
    } else if FAR + FAR_PER_DEGREE * degrees as f64 <= x {
        0.0
    } else {
        1.0 - distribution(degrees, x).0
    }
}

/// The value at which the distribution function is `probability`, by Newton's method from `guess`.
fn quantile(degrees: usize, probability: f64, guess: f64) -> f64 {
    let mut x = guess;
    for _ in 0..50 {
        let (distribution, density) = distribution(degrees, x);
        let step = (distribution - probability) / density;
        // Far from the solution Newton's steps are too long: x stays positive and changes at most
        // by a factor of two.
        let next = (x - step).clamp(0.5 * x, 2.0 * x + 1.0);
        if (next - x).abs() < 1e-9 * x {
            return next;
        }
        x = next;
    }
    x
}

/// Distribution function and density at x > 0.
///
/// P(k/2, x/2) by the series of Abramowitz & Stegun (1964), 6.5.29:
/// P(a, y) = y^a e^(−y)/Γ(a+1)·(1 + y/(a+1) + y²/((a+1)(a+2)) + …).
fn distribution(degrees: usize, x: f64) -> (f64, f64) {
    let (a, y) = (degrees as f64 / 2.0, x / 2.0);
    // y^a e^(−y)/Γ(a+1), computed upwards from a = 0 or 1/2, Γ(3/2) = √π/2.
    let mut reached = if degrees.is_multiple_of(2) { 0.0 } else { 0.5 };
    let mut leading = match degrees.is_multiple_of(2) {
        true => (-y).exp(),
        false => 2.0 * (y / std::f64::consts::PI).sqrt() * (-y).exp(),
    };
    while reached < a {
        reached += 1.0;
        leading *= y / reached;
    }
    let (mut term, mut sum, mut n) = (1.0, 1.0, a);
    while 1e-16 * sum < term {
        n += 1.0;
        term *= y / n;
        sum += term;
    }
    (leading * sum, leading * a / x)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Abramowitz & Stegun (1964), table 26.8.
    #[test]
    fn tabulated_quantiles() {
        let limits = ChiSquareLimits::new(0.001);
        for (degrees, value) in [(1, 10.828), (2, 13.816), (5, 20.515), (10, 29.588), (30, 59.703)]
        {
            assert!((limits.at(degrees) - value).abs() < 6e-4, "{degrees}: {}", limits.at(degrees));
        }
        assert!((ChiSquareLimits::new(0.05).at(4) - 9.487_73).abs() < 1e-5);
    }

    /// The same table, and far beyond it.
    #[test]
    fn probabilities_of_tabulated_values() {
        for (degrees, x, above) in [(1, 10.828, 1e-3), (7, 14.067, 0.05), (30, 59.703, 1e-3)] {
            let found = probability_above(degrees, x);
            assert!((found / above - 1.0).abs() < 1e-3, "{degrees}: {found}");
        }
        assert_eq!(
            [0.0, 519.9, 520.0, 1e9].map(|x| probability_above(64, x) < 1e-12),
            [false, true, true, true]
        );
    }

    #[test]
    fn extreme_probabilities_converge() {
        for tail in [1e-6, 0.5] {
            let limits = ChiSquareLimits::new(tail);
            for degrees in 1..64 {
                assert!(limits.at(degrees) < limits.at(degrees + 1));
                let (reached, _) = distribution(degrees, limits.at(degrees));
                assert!((1.0 - reached - tail).abs() < 1e-9, "{degrees} {tail}");
            }
        }
    }
}
