//! The median of a list.

/// The median: of an even number of values, the mean of the two in the middle. `None` of an empty
/// list. Reorders the list.
///
/// One of the two alone is biased: for n normal values by about 1.25 σ/n. Where medians are
/// summed, as changes of a clock are, such a bias grows with every epoch.
pub(crate) fn median(values: &mut [f64]) -> Option<f64> {
    let upper = values.len() / 2;
    if values.is_empty() {
        return None;
    }
    let (below, upper_value, _) = values.select_nth_unstable_by(upper, f64::total_cmp);
    let upper_value = *upper_value;
    if below.len() * 2 + 1 == values.len() {
        return Some(upper_value);
    }
    let lower_value = values[..upper].iter().copied().fold(f64::NEG_INFINITY, f64::max);
    Some(0.5 * (lower_value + upper_value))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_median_is_in_the_middle() {
        assert_eq!(median(&mut [3.0, -1.0, 7.0, 2.0]), Some(2.5));
        assert_eq!(median(&mut [3.0, -1.0, 7.0]), Some(3.0));
        assert_eq!(median(&mut [5.0, 1.0]), Some(3.0));
        assert_eq!(median(&mut [5.0]), Some(5.0));
        assert_eq!(median(&mut []), None);
    }
}
