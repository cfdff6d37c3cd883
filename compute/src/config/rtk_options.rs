//! Options of positions relative to a base and their defaults; `rtk_table` names and explains them.

use super::Profile;

/// Options of the modes relative to a base, besides those of every mode.
#[derive(Clone, Debug, PartialEq)]
pub struct RtkOptions {
    /// Initial standard deviation of a strong signal's pseudorange at zenith (m); a factor on it is
    /// learnt.
    pub pseudorange_sigma_m: f64,
    /// Standard deviation added to a pseudorange of the strongest signals of the rover, and at
    /// 42 dB-Hz of the base (m); ten times larger at 20 dB less.
    pub pseudorange_cn0_sigma_m: f64,
    /// Standard deviation of a carrier phase: this, and this over sin(elevation), added in squares
    /// (m).
    pub carrier_sigma_m: f64,
    /// The same for a carrier phase (m).
    pub carrier_cn0_sigma_m: f64,
    /// Horizontal gradient of the ionosphere's vertical delay on L1 (m/m).
    pub ionosphere_gradient: f64,
    /// Correlation time of pseudorange errors (s).
    pub pseudorange_correlation_s: f64,
    /// Correlation time of carrier-phase errors (s).
    pub carrier_correlation_s: f64,
    /// Largest age of a base epoch (s).
    pub base_age_max_s: f64,
    /// Longest baseline of a usable base (m).
    pub baseline_max_m: f64,
    /// Handover to another base: smallest decrease of the distance, as a share of the present one
    /// (0 to 1).
    pub handover_distance_share: f64,
    /// Handover to another base: smallest decrease of the distance (m).
    pub handover_distance_m: f64,
    /// Handover to another base: time for which its stream must be free of gaps (s).
    pub handover_gap_free_s: f64,
    /// An ambiguity not observed for longer than this restarts (s).
    pub arc_gap_s: f64,
    /// Largest number of epochs in the window.
    pub window_epochs: usize,
    /// Whether all ambiguities restart at each epoch.
    pub single_epoch: bool,
    /// Whether integer ambiguities are searched for.
    pub resolve: bool,
    /// Smallest accepted ratio of second-best to best squared norm.
    pub ratio_min: f64,
    /// Smallest posterior probability of integers that a search finds.
    pub probability_min: f64,
    /// Smallest posterior probability of integers that are held over epochs, or that join held
    /// ones.
    pub hold_probability_min: f64,
    /// Smallest bootstrapped success rate of the ambiguities to be fixed.
    pub success_rate_min: f64,
    /// Number of epochs in a row that must find the same integers before they are held.
    pub hold_epochs: u32,
    /// Smallest number of fixed double differences in a fix.
    pub fixed_min: usize,
    /// Ambiguities of satellites below this elevation stay real-valued (rad).
    pub elevation_mask_rad: f64,
}

impl RtkOptions {
    /// How far back the epochs of a base matter (s). Older ones serve no differencing, and a slip
    /// in them ends no ambiguity that is still alive.
    pub const fn base_span_s(&self) -> f64 {
        self.base_age_max_s.max(self.arc_gap_s)
    }

    /// Smallest posterior probability of integers that a search finds. Where ambiguities restart at
    /// each epoch no later epoch tests the integers, so the threshold is that of held ones.
    pub(crate) fn found_probability_min(&self) -> f64 {
        match self.single_epoch {
            true => self.probability_min.max(self.hold_probability_min),
            false => self.probability_min,
        }
    }

    /// The defaults of `profile`.
    pub(super) fn new(profile: Profile) -> Self {
        let general = Self::general();
        match profile {
            // The paper gives none; that of RTKLIB.
            Profile::Paper => Self { ratio_min: 3.0, ..general },
            _ => general,
        }
    }

    fn general() -> Self {
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
            handover_distance_share: 0.2,
            handover_distance_m: 1_000.0,
            handover_gap_free_s: 60.0,
            arc_gap_s: 35.0,
            window_epochs: 10,
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
