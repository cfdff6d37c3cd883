//! Sums of logarithms. A dozen or more terms need one logarithm only: that of their product.

/// A smaller or larger product is replaced by its logarithm.
const SMALL: f64 = 1e-50;
const LARGE: f64 = 1e150;

/// Σ ln x of positive numbers between 10⁻²⁵⁰ and 10¹⁵⁰.
#[derive(Clone, Copy, Debug)]
pub(super) struct LogProduct {
    sum: f64,
    product: f64,
}

impl LogProduct {
    /// The sum of no terms.
    pub(super) const ZERO: Self = Self { sum: 0.0, product: 1.0 };

    /// Adds ln `x`.
    #[inline]
    pub(super) fn add(&mut self, x: f64) {
        self.product *= x;
        if self.product < SMALL || LARGE < self.product {
            *self = Self { sum: self.value(), product: 1.0 };
        }
    }

    /// Σ ln x.
    pub(super) fn value(&self) -> f64 {
        self.sum + self.product.ln()
    }
}

/// Σ ln x; see [`LogProduct`].
pub(super) fn log_product(numbers: impl Iterator<Item = f64>) -> f64 {
    let mut product = LogProduct::ZERO;
    numbers.for_each(|x| product.add(x));
    product.value()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The product of each list overflows or is zero.
    #[test]
    fn products_beyond_all_numbers_have_a_logarithm() {
        let ten = 10.0_f64.ln();
        let large = log_product([2.0, 1e100, 1e100, 1e100, 1e100, 1.0].into_iter());
        assert!((large - (2.0_f64.ln() + 400.0 * ten)).abs() < 1e-9, "{large}");
        let small = log_product([5e-5; 100].into_iter());
        assert!((small - 100.0 * 5e-5_f64.ln()).abs() < 1e-9, "{small}");
        assert_eq!(log_product(std::iter::empty()), 0.0);
    }
}
