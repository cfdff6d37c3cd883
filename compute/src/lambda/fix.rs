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

    /// The integer of each original entry; `None` if the entry is not fixed.
    pub fn entries(&self) -> &[Option<i64>] {
        &self.entries
    }

    pub(in crate::lambda) fn clear(&mut self, size: usize) {
        self.entries.clear();
        self.entries.resize(size, None);
    }

    /// Stores the integers of `members`, those of the decorrelated entries that are not left out,
    /// from their decorrelated integers `z`: a = base + Z⁻ᵀz. `z` becomes Z⁻ᵀz.
    ///
    /// `base` are the integer parts of all entries, subtracted before decorrelation. Returns
    /// whether all intermediate numbers are exact in an `f64`.
    pub(in crate::lambda) fn hold(
        &mut self,
        reduction: &Reduction,
        members: &[usize],
        base: &[f64],
        z: &mut Vec<f64>,
    ) -> bool {
        let is_restored = reduction.restore(z);
        members.iter().fold(is_restored, |is_exact, &member| {
            let integer = base[member] + z[member];
            self.entries[member] = Some(integer as i64);
            is_exact && integer.abs() < EXACT_MAX
        })
    }
}
