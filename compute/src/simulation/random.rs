//! Reproducible random numbers: the same seed gives the same bits.
//!
//! xoshiro256++ (Blackman & Vigna 2021, *Scrambled linear pseudorandom number generators*), its
//! state filled by SplitMix64 (Steele, Lea & Flood 2014); normal deviates by Box & Muller (1958).

/// A stream of pseudorandom numbers.
#[derive(Clone, Debug)]
pub(super) struct Random {
    state: [u64; 4],
    spare_normal: Option<f64>,
}

/// One step of SplitMix64.
fn split_mix(state: &mut u64) -> u64 {
    *state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let mut z = *state;
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// The upper 53 bits as a number in 0 … 1, 1 excluded.
fn unit(bits: u64) -> f64 {
    (bits >> 11) as f64 / (1_u64 << 53) as f64
}

/// A number in 0 … 1 for cell (x, y) of a grid. It depends on its arguments only, not on previous
/// draws.
pub(super) fn of_cell(seed: u64, x: i64, y: i64, what: u64) -> f64 {
    let mut state = seed;
    for part in [x as u64, y as u64, what] {
        state ^= part.wrapping_mul(0xd6e8_feb8_6659_fd93);
        state = split_mix(&mut state);
    }
    unit(split_mix(&mut state))
}

/// A standard normal number for cell (x, y) of a grid; it depends on its arguments only.
pub(super) fn normal_of_cell(seed: u64, x: i64, y: i64, what: u64) -> f64 {
    let radius = (-2.0 * (1.0 - of_cell(seed, x, y, what)).ln()).sqrt();
    radius * (std::f64::consts::TAU * of_cell(seed, x, y, !what)).cos()
}

impl Random {
    /// Stream number `stream` of a seed.
    pub(super) fn new(seed: u64, stream: u64) -> Self {
        let mut filler = seed;
        filler = split_mix(&mut filler) ^ stream;
        let state = std::array::from_fn(|_| split_mix(&mut filler));
        Self { state, spare_normal: None }
    }

    fn next_bits(&mut self) -> u64 {
        let s = &mut self.state;
        let result = s[0].wrapping_add(s[3]).rotate_left(23).wrapping_add(s[0]);
        let shifted = s[1] << 17;
        s[2] ^= s[0];
        s[3] ^= s[1];
        s[1] ^= s[2];
        s[0] ^= s[3];
        s[2] ^= shifted;
        s[3] = s[3].rotate_left(45);
        result
    }

    /// A uniform number in `low` … `high`.
    pub(super) fn uniform(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * unit(self.next_bits())
    }

    /// Draws an event of this probability.
    pub(super) fn chance(&mut self, probability: f64) -> bool {
        unit(self.next_bits()) < probability
    }

    /// A standard normal number.
    pub(super) fn normal(&mut self) -> f64 {
        if let Some(spare) = self.spare_normal.take() {
            return spare;
        }
        let radius = (-2.0 * (1.0 - unit(self.next_bits())).ln()).sqrt();
        let (sin, cos) = (std::f64::consts::TAU * unit(self.next_bits())).sin_cos();
        self.spare_normal = Some(radius * sin);
        radius * cos
    }
}

/// A first-order Gauss–Markov process of unit variance; Gelb (1974), *Applied Optimal Estimation*,
/// 3.8: x₊ = e^(−Δt/τ)·x + √(1 − e^(−2Δt/τ))·w.
#[derive(Clone, Copy, Debug)]
pub(super) struct GaussMarkov(f64);

impl GaussMarkov {
    /// A process in its steady state.
    pub(super) fn new(random: &mut Random) -> Self {
        Self(random.normal())
    }

    /// The value `elapsed_s` later, for a correlation time (s).
    pub(super) fn advance(
        &mut self,
        elapsed_s: f64,
        correlation_s: f64,
        random: &mut Random,
    ) -> f64 {
        let kept = (-elapsed_s / correlation_s).exp();
        self.0 = kept * self.0 + (1.0 - kept * kept).sqrt() * random.normal();
        self.0
    }

    /// The present value, in standard deviations.
    pub(super) const fn value(&self) -> f64 {
        self.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_generators_published_outputs() {
        let mut state = 1_234_567;
        assert_eq!(split_mix(&mut state), 6_457_827_717_110_365_317);
        assert_eq!(split_mix(&mut state), 3_203_168_211_198_807_973);
        let mut random = Random { state: [1, 2, 3, 4], spare_normal: None };
        let outputs: Vec<_> = (0..4).map(|_| random.next_bits()).collect();
        assert_eq!(outputs, [41_943_041, 58_720_359, 3_588_806_011_781_223, 3_591_011_842_654_386]);
    }

    #[test]
    fn normal_deviates_have_their_moments() {
        let mut random = Random::new(1, 2);
        let n = 100_000;
        let values: Vec<_> = (0..n).map(|_| random.normal()).collect();
        let moment = |power: i32| values.iter().map(|v| v.powi(power)).sum::<f64>() / f64::from(n);
        assert!(moment(1).abs() < 0.01 && (moment(2) - 1.0).abs() < 0.02);
        assert!(moment(3).abs() < 0.05 && (moment(4) - 3.0).abs() < 0.1);
    }

    #[test]
    fn a_gauss_markov_process_keeps_variance_and_correlation() {
        let mut random = Random::new(3, 0);
        let mut process = GaussMarkov::new(&mut random);
        let values: Vec<_> =
            (0..200_000).map(|_| process.advance(1.0, 10.0, &mut random)).collect();
        let products = |lag: usize| {
            let pairs = values.iter().zip(&values[lag..]);
            pairs.map(|(a, b)| a * b).sum::<f64>() / (values.len() - lag) as f64
        };
        assert!((products(0) - 1.0).abs() < 0.05);
        assert!((products(10) - (-1.0_f64).exp()).abs() < 0.05);
    }
}
