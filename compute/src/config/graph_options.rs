//! Options of the factor graph and their defaults; `graph_table` names and explains them.

use super::{DopplerUse, KernelLaw, Profile};

/// Options of the modes with a factor graph, besides those of every mode.
#[derive(Clone, Debug, PartialEq)]
pub struct GraphOptions {
    /// Length of the sliding window (s); older epochs are marginalised.
    pub window_s: f64,
    /// Largest number of epochs in the window, at any rate.
    pub window_epochs_max: usize,
    /// Standard deviation of the range error of broadcast orbits and clocks, used in the reported
    /// covariance (m).
    pub orbit_clock_sigma_m: f64,
    /// Robust kernel of pseudoranges.
    pub pseudorange_kernel: KernelLaw,
    /// Kernel width for pseudoranges shorter than predicted (standard deviations).
    pub early_width: f64,
    /// Kernel width for pseudoranges longer than predicted, as reflected signals are (standard
    /// deviations).
    pub late_width: f64,
    /// Epochs closer than this share the pseudorange weight of one epoch in the estimate (s).
    pub independence_s: f64,
    /// Correlation time of pseudorange errors, used in the reported covariance (s).
    pub correlation_s: f64,
    /// How Doppler enters the graph.
    pub doppler: DopplerUse,
    /// Width of the Cauchy kernel of Doppler (standard deviations).
    pub doppler_width: f64,
    /// Standard deviation of the velocity solved from one epoch's Doppler, per axis (m/s).
    pub doppler_velocity_sigma_m_s: f64,
    /// Whether time-differenced carrier phase is used.
    pub phase: bool,
    /// Standard deviation of a strong signal's phase difference, multipath included (m).
    pub phase_sigma_m: f64,
    /// Width of the Geman–McClure kernel of phase differences (standard deviations).
    pub phase_width: f64,
    /// Random walk of the horizontal velocity, per axis (m/s/√s).
    pub horizontal_walk_m_s: f64,
    /// Random walk of the vertical velocity (m/s/√s).
    pub vertical_walk_m_s: f64,
    /// Standard deviation of the vertical velocity about zero (m/s); infinite: no such factor.
    pub vertical_velocity_m_s: f64,
    /// Whether epochs at rest, detected in Doppler, are tied by zero-velocity factors.
    pub zero_velocity: bool,
    /// Whether motion and clock factors tie epochs; if not, only the Doppler velocity does.
    pub motion: bool,
    /// Random walk of the receiver clock (m/√s).
    pub clock_walk_m: f64,
    /// Random walk of the receiver clock drift (m/s/√s).
    pub drift_walk_m_s: f64,
    /// Random walk of each inter-system bias (m/√s).
    pub bias_walk_m: f64,
    /// A pause longer than this restarts the graph (s).
    pub gap_s: f64,
}

impl GraphOptions {
    /// The defaults of `profile`.
    pub(super) fn new(profile: Profile) -> Self {
        let general = Self::general();
        match profile {
            Profile::General => general,
            Profile::UrbanVehicle => Self {
                horizontal_walk_m_s: 1.0,
                zero_velocity: true,
                // A reflection as strong as the signal shifts its phase by a quarter wavelength.
                phase_sigma_m: 0.05,
                ..general
            },
            Profile::Static => Self {
                horizontal_walk_m_s: 0.001,
                vertical_walk_m_s: 0.001,
                vertical_velocity_m_s: 0.001,
                ..general
            },
            Profile::Phone => Self { phase_sigma_m: 0.1, ..general },
            // The paper gives neither; both values are those of GraphGNSSLib, the program it
            // names.
            Profile::Paper => Self {
                doppler_velocity_sigma_m_s: 0.6,
                pseudorange_kernel: KernelLaw::Huber,
                early_width: 1.0,
                late_width: 1.0,
                doppler: DopplerUse::Velocity,
                phase: false,
                motion: false,
                ..general
            },
        }
    }

    fn general() -> Self {
        Self {
            window_s: 10.0,
            window_epochs_max: 30,
            orbit_clock_sigma_m: 1.0,
            pseudorange_kernel: KernelLaw::Mixture,
            early_width: 4.0,
            late_width: 2.0,
            independence_s: 1.0,
            correlation_s: 30.0,
            doppler: DopplerUse::Satellites,
            doppler_width: 2.0,
            doppler_velocity_sigma_m_s: 0.1,
            phase: true,
            // Phases at permanent stations leave 5 mm, 3 cm at worst in hostile surroundings:
            // Yunck (1995), *GPS data, acquisition, environmental effects*, Rev. Geophys. 33.
            phase_sigma_m: 0.01,
            phase_width: 3.0,
            horizontal_walk_m_s: 2.0,
            vertical_walk_m_s: 1.0,
            vertical_velocity_m_s: f64::INFINITY,
            zero_velocity: false,
            motion: true,
            clock_walk_m: 0.3,
            drift_walk_m_s: 0.3,
            bias_walk_m: 0.02,
            gap_s: 120.0,
        }
    }
}
