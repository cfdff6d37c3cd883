//! The result of a fix: the integers of the original entries.

use crate::lambda::EXACT_MAX;
use crate::lambda::reduction::Reduction;

/// The integers of the entries; a partial fix has integers for some of them only.
#[derive(Clone, Debug, PartialEq)]
pub struct Fix {
    entries: Vec<Option<i64>>,
}

impl Fix {
    /// An empty fix with room for `size` entries.
    pub fn with_capacity(size: usize) -> Self {
        Self { entries: Vec::with_capacity(size) }
    }

    /// Each original entry's integer, where it is fixed.
    pub fn entries(&self) -> &[Option<i64>] {
        &self.entries
    }

    pub(in crate::lambda) fn clear(&mut self, size: usize) {
        self.entries.clear();
        self.entries.resize(size, None);
    }

    /// Stores the integers of `members`, the entries that were decorrelated together, from their
    /// decorrelated integers `z`: a = base + Z⁻ᵀz.
    ///
    /// `base` are the members' integer parts, subtracted before decorrelation. Returns whether all
    /// products of these with the transformation are exact in an `f64`.
    pub(in crate::lambda) fn hold(
        &mut self,
        reduction: &Reduction,
        members: &[usize],
        base: &[f64],
        z: &[f64],
    ) -> bool {
        members.iter().zip(base).for_each(|(&m, &whole)| self.entries[m] = Some(whole as i64));
        for (j, &integer) in z.iter().enumerate() {
            for (&member, &weight) in members.iter().zip(reduction.restoration(j)) {
                let entry = self.entries[member].get_or_insert(0);
                *entry += (weight as i64).saturating_mul(integer as i64);
            }
        }
        let is_exact = |weight: &f64, whole: &f64| (weight * whole).abs() < EXACT_MAX;
        (0..z.len()).all(|j| reduction.combination(j).iter().zip(base).all(|(w, b)| is_exact(w, b)))
    }
}
