//! Options of positions relative to a base and their defaults; `rtk_table` names and explains them.

use super::Profile;

/// What the modes that difference against a base are told beside the options of every mode.
#[derive(Clone, Debug, PartialEq)]
pub struct RtkOptions {
    /// Standard deviation of a strong signal's pseudorange at zenith (m); scaled by what is seen.
    pub pseudorange_sigma_m: f64,
    /// Standard deviation that C/N0 adds to a pseudorange at 42 dB-Hz (m).
    pub pseudorange_cn0_sigma_m: f64,
    /// Standard deviation of a carrier phase at the zenith, and of what grows to the horizon (m).
    pub carrier_sigma_m: f64,
    /// Standard deviation that C/N0 adds to a carrier phase at 42 dB-Hz (m).
    pub carrier_cn0_sigma_m: f64,
    /// Vertical gradient of the ionosphere's delay on L1 (m/m).
    pub ionosphere_gradient: f64,
    /// How long a pseudorange's error lasts (s).
    pub pseudorange_correlation_s: f64,
    /// How long a carrier phase's error lasts (s).
    pub carrier_correlation_s: f64,
    /// A base epoch older than this is not used (s).
    pub base_age_max_s: f64,
    /// A base further away is not used (m).
    pub baseline_max_m: f64,
    /// Of several bases another is taken where it is nearer by this share of the present one's
    /// distance (0 to 1) …
    pub nearer_share: f64,
    /// … and by this much (m) …
    pub nearer_m: f64,
    /// … and has been heard for so long without a gap (s).
    pub steady_s: f64,
    /// An ambiguity not seen for longer begins anew (s).
    pub arc_gap_s: f64,
    /// Epochs that stay nonlinear in the window.
    pub window_epochs: usize,
    /// Whether ambiguities are forgotten after each epoch.
    pub single_epoch: bool,
    /// Whether integers are looked for.
    pub resolve: bool,
    /// Least ratio of second-best to best squared norm, whatever the model's strength.
    pub ratio_min: f64,
    /// Least posterior probability that integers found are right.
    pub probability_min: f64,
    /// Least probability of integers that are kept from one epoch to the next, or join such.
    pub hold_probability_min: f64,
    /// Least bootstrapped success rate of what is fixed.
    pub success_rate_min: f64,
    /// Epochs in a row that must find the same integers before they are kept.
    pub hold_epochs: u32,
    /// Fewest double differences a fix holds.
    pub fixed_min: usize,
    /// Ambiguities of satellites lower than this stay real-valued (rad).
    pub elevation_mask_rad: f64,
}

impl RtkOptions {
    /// How far back the epochs of a base matter (s): older ones are neither differenced against,
    /// nor can a slip in them end an ambiguity that still lives.
    pub const fn base_span_s(&self) -> f64 {
        self.base_age_max_s.max(self.arc_gap_s)
    }

    /// Least probability of integers that are found. Where ambiguities are forgotten after each
    /// epoch no later one tests them, and they need what those that are kept need.
    pub(crate) fn found_probability_min(&self) -> f64 {
        match self.single_epoch {
            true => self.probability_min.max(self.hold_probability_min),
            false => self.probability_min,
        }
    }

    /// The defaults of `profile`.
    pub(super) fn new(_profile: Profile) -> Self {
        Self {
            pseudorange_sigma_m: 0.3,
            pseudorange_cn0_sigma_m: 1.0,
            carrier_sigma_m: 0.002,
            carrier_cn0_sigma_m: 0.002,
            ionosphere_gradient: 2e-6,
            pseudorange_correlation_s: 30.0,
            carrier_correlation_s: 5.0,
            base_age_max_s: 30.0,
            baseline_max_m: 50_000.0,
            nearer_share: 0.2,
            nearer_m: 1_000.0,
            steady_s: 60.0,
            arc_gap_s: 35.0,
            window_epochs: 2,
            single_epoch: false,
            resolve: true,
            ratio_min: 2.0,
            probability_min: 0.95,
            hold_probability_min: 0.997,
            success_rate_min: 0.05,
            hold_epochs: 10,
            fixed_min: 4,
            elevation_mask_rad: 15_f64.to_radians(),
        }
    }
}
