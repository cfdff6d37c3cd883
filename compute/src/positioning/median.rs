//! The median of a list.

/// The lower median; `None` of an empty list. Reorders the list.
pub(super) fn median(values: &mut [f64]) -> Option<f64> {
    let middle = values.len().checked_sub(1)? / 2;
    Some(*values.select_nth_unstable_by(middle, f64::total_cmp).1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_median_is_one_of_the_values() {
        assert_eq!(median(&mut [3.0, -1.0, 7.0, 2.0]), Some(2.0));
        assert_eq!(median(&mut [3.0, -1.0, 7.0]), Some(3.0));
        assert_eq!(median(&mut []), None);
    }
}
