//! Robust kernels: the loss ρ(s) of a whitened residual s and its weight w(s) = ρ′(s)/s.
//!
//! Iteratively reweighted least squares minimises Σ ρ(sᵢ) by repeated minimisation of Σ w(sᵢ)·sᵢ²
//! with the weights of the iteration before. c is the kernel's width (standard deviations). All
//! losses are s²/2 near zero:
//!
//! | law | ρ(s) | w(s) | for large s |
//! |---|---|---|---|
//! | quadratic | s²/2 | 1 | every row counts in full |
//! | Huber | s²/2, beyond c: c·∣s∣ − c²/2 | min(1, c/∣s∣) | bounded pull, convex |
//! | Cauchy | (c²/2)·ln(1 + (s/c)²) | 1/(1 + (s/c)²) | pull falls as 1/s |
//! | Geman–McClure | (s²/2)/(1 + (s/c)²) | 1/(1 + (s/c)²)² | pull falls as 1/s³, ρ ≤ c²/2 |
//!
//! Sources: Huber (1964), *Robust estimation of a location parameter*; Zhang (1997), *Parameter
//! estimation techniques*, table 1; Barron (2019), *A general and adaptive robust loss function*.

/// Width of Huber's kernel that keeps 95 % efficiency on normal errors.
pub(crate) const HUBER_WIDTH: f64 = 1.345;

/// Shape of a kernel; the [module documentation](self) has the formulas.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Law {
    /// No robustness.
    Quadratic,
    /// Huber's: quadratic inside the width, linear outside.
    Huber,
    /// Cauchy's (Lorentzian): logarithmic.
    Cauchy,
    /// Geman's and McClure's: bounded.
    GemanMcClure,
}

impl Law {
    /// Loss and weight at `s` for width `c`.
    #[inline]
    fn evaluate(self, s: f64, c: f64) -> (f64, f64) {
        let square = s * s;
        match self {
            Self::Quadratic => (0.5 * square, 1.0),
            Self::Huber if s.abs() <= c => (0.5 * square, 1.0),
            Self::Huber => (c * (s.abs() - 0.5 * c), c / s.abs()),
            Self::Cauchy => {
                let ratio = square / (c * c);
                (0.5 * c * c * ratio.ln_1p(), 1.0 / (1.0 + ratio))
            }
            Self::GemanMcClure => {
                // Only one division, because it is the slowest operation.
                let root = c * c / (c * c + square);
                (0.5 * square * root, root * root)
            }
        }
    }
}

/// A robust kernel: a law, its width on either side of zero, and a factor on loss and weight.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Kernel {
    /// The shape.
    pub law: Law,
    /// Width for residuals above zero (standard deviations); unused by [`Law::Quadratic`].
    pub positive_width: f64,
    /// Width for residuals below zero (standard deviations).
    pub negative_width: f64,
    /// Factor on loss and weight: one for rows with independent errors, below one for rows whose
    /// errors are correlated in time. With 1/N, N rows with the same error count as one row.
    pub factor: f64,
}

impl Kernel {
    /// No robustness: ρ = s²/2.
    pub const QUADRATIC: Self = Self::new(Law::Quadratic, 1.0);

    /// A law with the same width on both sides.
    pub(crate) const fn new(law: Law, width: f64) -> Self {
        Self { law, positive_width: width, negative_width: width, factor: 1.0 }
    }

    /// Huber's kernel; a width of 1.345 keeps 95 % efficiency on normal errors.
    pub const fn huber(width: f64) -> Self {
        Self::new(Law::Huber, width)
    }

    /// Cauchy's kernel; a width of 2.385 keeps 95 % efficiency on normal errors.
    pub(crate) const fn cauchy(width: f64) -> Self {
        Self::new(Law::Cauchy, width)
    }

    /// Geman's and McClure's kernel.
    pub const fn geman_mcclure(width: f64) -> Self {
        Self::new(Law::GemanMcClure, width)
    }

    /// The same law with another width for each sign of the residual (model − measured).
    pub const fn one_sided(self, positive_width: f64, negative_width: f64) -> Self {
        Self { positive_width, negative_width, ..self }
    }

    /// The same kernel with this factor on loss and weight, in (0, 1], in place of its own.
    pub(crate) const fn scaled(self, factor: f64) -> Self {
        Self { factor, ..self }
    }

    /// The same kernel, both widths multiplied by `factor`: √μ of graduated non-convexity.
    pub(crate) fn widened(self, factor: f64) -> Self {
        Self {
            positive_width: self.positive_width * factor,
            negative_width: self.negative_width * factor,
            ..self
        }
    }

    /// Width on the side of `s`.
    #[inline]
    const fn width(&self, s: f64) -> f64 {
        if s < 0.0 { self.negative_width } else { self.positive_width }
    }

    /// Loss ρ(s).
    #[cfg(test)]
    pub(crate) fn loss(&self, s: f64) -> f64 {
        self.loss_and_weight(s).0
    }

    /// Weight w(s) = ρ′(s)/s, with its limit `factor` at zero.
    #[inline]
    pub(crate) fn weight(&self, s: f64) -> f64 {
        let width = self.width(s);
        let weight = match self.law {
            // Without its loss, which has a logarithm.
            Law::Cauchy => width * width / (width * width + s * s),
            law => law.evaluate(s, width).1,
        };
        self.factor * weight
    }

    /// Slope ψ′(s) of the influence function ψ(s) = w(s)·s; negative where a kernel redescends.
    pub(crate) fn pull_slope(&self, s: f64) -> f64 {
        let width = self.width(s);
        let ratio = (s / width).powi(2);
        self.factor
            * match self.law {
                Law::Quadratic => 1.0,
                Law::Huber => f64::from(u8::from(ratio <= 1.0)),
                Law::Cauchy => (1.0 - ratio) / (1.0 + ratio).powi(2),
                Law::GemanMcClure => (1.0 - 3.0 * ratio) / (1.0 + ratio).powi(3),
            }
    }

    /// ρ(s) and w(s).
    #[inline]
    pub(crate) fn loss_and_weight(&self, s: f64) -> (f64, f64) {
        let width = self.width(s);
        let (loss, weight) = self.law.evaluate(s, width);
        (self.factor * loss, self.factor * weight)
    }
}

/// Σ ρ(s) over many residuals.
///
/// Cauchy's losses are summed as the logarithm of a product: one multiplication for each loss
/// instead of one logarithm.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LossSum {
    sum: f64,
    /// Factor κ = `factor`·c²/2 of the logarithm.
    scale: f64,
    /// Π (1 + (s/c)²) over the residuals since the sum was updated, all with the same κ.
    product: f64,
}

/// A product above this is added to the sum before it can overflow.
const PRODUCT_LIMIT: f64 = 1e100;

impl LossSum {
    /// The sum over no residuals.
    pub(crate) const ZERO: Self = Self { sum: 0.0, scale: 0.0, product: 1.0 };

    /// Adds ρ(s); returns w(s).
    #[inline]
    pub(crate) fn add(&mut self, s: f64, kernel: &Kernel) -> f64 {
        if kernel.law != Law::Cauchy {
            let (loss, weight) = kernel.loss_and_weight(s);
            self.sum += loss;
            return weight;
        }
        let width = kernel.width(s);
        let (square, limit) = (width * width, width * width + s * s);
        let scale = 0.5 * kernel.factor * square;
        if scale != self.scale || PRODUCT_LIMIT < self.product {
            *self = Self { sum: self.value(), scale, product: 1.0 };
        }
        self.product *= limit / square;
        kernel.factor * square / limit
    }

    /// Adds a known loss.
    #[inline]
    pub(crate) fn add_loss(&mut self, loss: f64) {
        self.sum += loss;
    }

    /// Σ ρ(s).
    pub(crate) fn value(&self) -> f64 {
        self.sum + self.scale * self.product.ln()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// One test module per law: what every kernel must obey.
    macro_rules! laws_of {
        ($($name:ident => $law:expr),+) => {$(
            mod $name {
                use super::*;

                proptest! {
                    #[test]
                    fn weight_is_slope_over_residual(s in -50.0..50.0, c in 0.3..9.0) {
                        prop_assume!(1e-3 < f64::abs(s));
                        let (kernel, h) = (Kernel::new($law, c), 1e-5);
                        let slope = (kernel.loss(s + h) - kernel.loss(s - h)) / (2.0 * h);
                        prop_assert!((slope / s - kernel.weight(s)).abs() < 1e-5);
                    }

                    #[test]
                    fn the_pulls_slope_is_its_derivative(s in -50.0..50.0, c in 0.3..9.0) {
                        prop_assume!(1e-3 < f64::abs(f64::abs(s) - c));
                        let (kernel, h) = (Kernel::new($law, c), 1e-5);
                        let pull = |s: f64| kernel.weight(s) * s;
                        let slope = (pull(s + h) - pull(s - h)) / (2.0 * h);
                        prop_assert!((slope - kernel.pull_slope(s)).abs() < 1e-5);
                    }

                    #[test]
                    fn is_even_and_zero_at_zero(s in 0.0..50.0, c in 0.3..9.0) {
                        let kernel = Kernel::new($law, c);
                        prop_assert_eq!(kernel.loss(s), kernel.loss(-s));
                        prop_assert_eq!(kernel.loss_and_weight(0.0), (0.0, 1.0));
                    }

                    #[test]
                    fn loss_rises_and_weight_falls(s in 0.0..50.0, d in 1e-6..9.0, c in 0.3..9.0) {
                        let kernel = Kernel::new($law, c);
                        prop_assert!(kernel.loss(s) < kernel.loss(s + d) + 1e-12);
                        prop_assert!(kernel.weight(s + d) <= kernel.weight(s));
                        prop_assert!(0.0 < kernel.weight(s + d) && kernel.weight(s) <= 1.0);
                    }

                    /// The parabola w(s)·t²/2 touches ρ at s from above: reweighting descends.
                    #[test]
                    fn parabola_majorises(s in -50.0..50.0, t in -50.0..50.0, c in 0.3..9.0) {
                        let kernel = Kernel::new($law, c);
                        let (loss, weight) = kernel.loss_and_weight(s);
                        let bound = loss + 0.5 * weight * (t * t - s * s);
                        prop_assert!(kernel.loss(t) <= bound + 1e-9 * (1.0 + bound.abs()));
                    }

                    #[test]
                    fn widening_tends_to_the_parabola(s in -50.0..50.0, c in 0.3..9.0) {
                        let wide = Kernel::new($law, c).widened(1e8);
                        prop_assert!((wide.loss(s) - 0.5 * s * s).abs() < 1e-6);
                        prop_assert!((wide.weight(s) - 1.0).abs() < 1e-6);
                    }

                    #[test]
                    fn share_scales_loss_and_weight(s in -50.0..50.0, factor in 0.01..1.0) {
                        let kernel = Kernel::new($law, 2.0);
                        let (loss, weight) = kernel.loss_and_weight(s);
                        let scaled = kernel.scaled(factor).loss_and_weight(s);
                        prop_assert_eq!(scaled, (factor * loss, factor * weight));
                    }
                }
            }
        )+};
    }

    laws_of!(
        quadratic => Law::Quadratic,
        huber => Law::Huber,
        cauchy => Law::Cauchy,
        geman_mcclure => Law::GemanMcClure
    );

    /// Worked by hand at s = 4, c = 2: Huber 2·4 − 2 = 6 and 2/4; Cauchy 2·ln 5 and 1/5;
    /// Geman–McClure 8/5 and 1/25.
    #[test]
    fn values_by_hand() {
        assert_eq!(Kernel::QUADRATIC.loss_and_weight(4.0), (8.0, 1.0));
        assert_eq!(Kernel::huber(2.0).loss_and_weight(-4.0), (6.0, 0.5));
        let (loss, weight) = Kernel::cauchy(2.0).loss_and_weight(4.0);
        assert!((loss - 2.0 * 5f64.ln()).abs() < 1e-15 && (weight - 0.2).abs() < 1e-15);
        let (loss, weight) = Kernel::geman_mcclure(2.0).loss_and_weight(4.0);
        assert!((loss - 1.6).abs() < 1e-15 && (weight - 0.04).abs() < 1e-15);
    }

    /// Many losses of changing kernels, some of them very large.
    #[test]
    fn a_sum_of_losses_is_their_sum() {
        let laws = [Law::Quadratic, Law::Huber, Law::Cauchy, Law::GemanMcClure];
        let kernels = laws.map(|law| Kernel::new(law, 1.5).one_sided(1.5, 3.0).scaled(0.3));
        let (mut sum, mut expected) = (LossSum::ZERO, 0.0);
        for i in 0..400 {
            let (s, kernel) = (1e6 * f64::from(i - 200).powi(3), kernels[(i / 50) as usize % 4]);
            let (loss, weight) = kernel.loss_and_weight(s);
            assert!((sum.add(s, &kernel) - weight).abs() <= 1e-15 * weight);
            expected += loss;
        }
        assert!((sum.value() - expected).abs() < 1e-12 * expected, "{} {expected}", sum.value());
        let mut cauchy = LossSum::ZERO;
        let mut single = 0.0;
        for s in (0..400).map(f64::from) {
            cauchy.add(s, &kernels[2]);
            single += kernels[2].loss(s);
        }
        assert!((cauchy.value() - single).abs() < 1e-12 * single);
    }

    #[test]
    fn each_side_has_its_width() {
        let kernel = Kernel::geman_mcclure(1.0).one_sided(4.0, 2.0);
        assert_eq!(kernel.weight(3.0), Kernel::geman_mcclure(4.0).weight(3.0));
        assert_eq!(kernel.weight(-3.0), Kernel::geman_mcclure(2.0).weight(3.0));
        assert!(kernel.weight(-3.0) < kernel.weight(3.0));
    }
}
