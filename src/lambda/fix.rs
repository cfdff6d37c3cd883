//! The result of a fix: integer combinations of the original entries, and their integers.

use crate::lambda::EXACT_MAX;
use crate::lambda::reduction::Reduction;

/// Integer combinations h = H·a of the original entries a, with their integers.
///
/// A full fix has as many combinations as entries; a partial one fewer.
#[derive(Clone, Debug, PartialEq)]
pub struct Fix {
    size: usize,
    combinations: Vec<f64>,
    values: Vec<i64>,
    entries: Vec<Option<i64>>,
}

impl Fix {
    /// An empty fix with room for `size` entries.
    pub fn with_capacity(size: usize) -> Self {
        Self {
            size: 0,
            combinations: Vec::with_capacity(size * size),
            values: Vec::with_capacity(size),
            entries: Vec::with_capacity(size),
        }
    }

    /// Number of independent integer combinations.
    pub fn len(&self) -> usize {
        self.values.len()
    }

    /// Whether no combination is fixed.
    pub fn is_empty(&self) -> bool {
        self.values.is_empty()
    }

    /// Row `i` of H, 1×n, integral values.
    pub fn combination(&self, i: usize) -> &[f64] {
        &self.combinations[i * self.size..(i + 1) * self.size]
    }

    /// The integers h, one for each combination.
    pub fn values(&self) -> &[i64] {
        &self.values
    }

    /// Each original entry's integer, where the fix determines it on its own.
    ///
    /// A fix in the decorrelated domain may hold combinations without holding any single entry.
    pub fn entries(&self) -> &[Option<i64>] {
        &self.entries
    }

    pub(in crate::lambda) fn clear(&mut self, size: usize) {
        self.size = size;
        self.combinations.clear();
        self.values.clear();
        self.entries.clear();
        self.entries.resize(size, None);
    }

    /// Stores the decorrelated integers `z` of the entries from `start` on.
    ///
    /// `members` are the original entries of the reduction; `base` are their integer parts,
    /// subtracted before decorrelation. Returns whether all integers are exact in an `f64`.
    pub(in crate::lambda) fn hold(
        &mut self,
        reduction: &Reduction,
        members: &[usize],
        base: &[f64],
        start: usize,
        z: &[f64],
    ) -> bool {
        let mut exact = true;
        for (j, integer) in (start..reduction.size()).zip(z) {
            let column = reduction.combination(j);
            let row = self.combinations.len();
            self.combinations.resize(row + self.size, 0.0);
            let mut value = *integer as i64;
            for ((&member, &weight), &whole) in members.iter().zip(column).zip(base) {
                self.combinations[row + member] = weight;
                exact &= (weight * whole).abs() < EXACT_MAX;
                value += (weight as i64).saturating_mul(whole as i64);
            }
            self.values.push(value);
            self.note_single(members, column, value);
        }
        if start == 0 {
            self.restore(reduction, members, base, z);
        }
        exact
    }

    /// A combination of one entry, with weight ±1, fixes that entry.
    fn note_single(&mut self, members: &[usize], column: &[f64], value: i64) {
        let mut present = members.iter().zip(column).filter(|(_, weight)| **weight != 0.0);
        if let (Some((&member, &weight)), None) = (present.next(), present.next()) {
            self.entries[member] = Some(value * weight as i64);
        }
    }

    /// All members' integers, a = base + Z⁻ᵀz.
    fn restore(&mut self, reduction: &Reduction, members: &[usize], base: &[f64], z: &[f64]) {
        members.iter().zip(base).for_each(|(&m, &whole)| self.entries[m] = Some(whole as i64));
        for (j, &integer) in z.iter().enumerate() {
            for (&member, &weight) in members.iter().zip(reduction.restoration(j)) {
                let entry = self.entries[member].get_or_insert(0);
                *entry += (weight as i64).saturating_mul(integer as i64);
            }
        }
    }
}
