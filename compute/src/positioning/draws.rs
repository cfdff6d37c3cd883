//! Uniform pseudo-random numbers from a seed, so that a replay draws the same ones.

/// Steele, Lea & Flood (2014), *Fast splittable pseudorandom number generators*, OOPSLA:
/// SplitMix64.
#[derive(Debug)]
pub(super) struct Draws(u64);

impl Draws {
    pub(super) fn new(seed: u64) -> Self {
        Self(seed)
    }

    /// A number below `bound`, which is small: lower numbers are more probable by bound/2⁶⁴ at
    /// most.
    pub(super) fn below(&mut self, bound: usize) -> usize {
        (self.next_bits() % bound as u64) as usize
    }

    /// A number from 0 up to 1, in steps of 2⁻⁵³.
    pub(super) fn unit(&mut self) -> f64 {
        (self.next_bits() >> 11) as f64 / (1_u64 << 53) as f64
    }

    fn next_bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Moves `count` randomly drawn items to the front of `items`.
    pub(super) fn shuffle_front<T>(&mut self, items: &mut [T], count: usize) {
        for front in 0..count.min(items.len()) {
            items.swap(front, front + self.below(items.len() - front));
        }
    }
}

/// ln of the probability that no subset of those drawn contains only sound items: 0.1 %.
const LN_MISSED: f64 = -6.907_755_278_982_137;

/// Number of subsets of `size` items after which at least one contains only sound items with a
/// probability of 99.9 %. `sound` is the fraction of items that are sound (Fischler & Bolles 1981,
/// *Random sample consensus*, CACM 24). Infinite if that is zero.
pub(super) fn subsets_needed(sound: f64, size: usize) -> f64 {
    let chance = sound.powi(size as i32);
    LN_MISSED / (-chance).ln_1p()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The first output of SplitMix64 with seed 0 is 0xe220a8397b1dcdaf; modulo 1000 that is 535.
    #[test]
    fn the_first_draw_is_the_published_one() {
        assert_eq!(Draws::new(0).below(1000), 535);
    }

    /// 0.9⁴ = 0.656, and ln 0.001/ln 0.344 = 6.5; 0.5⁴ = 1/16, and ln 0.001/ln(15/16) = 107.
    #[test]
    fn subsets_are_needed_until_one_is_sound() {
        assert!((subsets_needed(0.9, 4) - 6.47).abs() < 0.01, "{}", subsets_needed(0.9, 4));
        assert_eq!(subsets_needed(0.5, 4).ceil(), 108.0);
        assert_eq!(subsets_needed(1.0, 4), 0.0);
        assert_eq!(subsets_needed(0.0, 4), f64::INFINITY);
    }

    #[test]
    fn a_shuffle_keeps_all_items() {
        let mut items: Vec<usize> = (0..20).collect();
        Draws::new(7).shuffle_front(&mut items, 5);
        assert_ne!(items[..5], [0, 1, 2, 3, 4]);
        items.sort_unstable();
        assert_eq!(items, (0..20).collect::<Vec<_>>());
    }
}
