//! Options of the factor graph and their defaults; `graph_table` names and explains them.

use super::{DopplerUse, KernelLaw, Profile};

/// What the modes with a factor graph are told beside the options of every mode.
#[derive(Clone, Debug, PartialEq)]
pub struct GraphOptions {
    /// Length of the sliding window (s).
    pub window_s: f64,
    /// Most epochs a window holds, however close they are.
    pub window_epochs_max: usize,
    /// Standard deviation of what orbits and clocks broadcast put into a range, for the covariance
    /// stated (m).
    pub orbit_clock_sigma_m: f64,
    /// Kernel of pseudoranges.
    pub pseudorange_kernel: KernelLaw,
    /// Its width for signals that arrive early (standard deviations).
    pub early_width: f64,
    /// Its width for signals that arrive late, as reflections do (standard deviations).
    pub late_width: f64,
    /// Epochs closer than this share one epoch's pseudorange weight in the estimate (s).
    pub independence_s: f64,
    /// How long a pseudorange's error lasts, for the covariance stated (s).
    pub correlation_s: f64,
    /// How Doppler enters.
    pub doppler: DopplerUse,
    /// Width of Doppler's Cauchy kernel (standard deviations).
    pub doppler_width: f64,
    /// Standard deviation of the velocity from one epoch's Doppler, where that is used (m/s).
    pub doppler_velocity_sigma_m_s: f64,
    /// Whether carrier phase is differenced in time.
    pub phase: bool,
    /// Standard deviation of a strong signal's phase difference, multipath (m).
    pub phase_sigma_m: f64,
    /// Width of the phase differences' Geman–McClure kernel (standard deviations).
    pub phase_width: f64,
    /// Random walk of the horizontal velocity, per axis (m/s/√s).
    pub horizontal_walk_m_s: f64,
    /// Random walk of the vertical velocity (m/s/√s).
    pub vertical_walk_m_s: f64,
    /// Standard deviation of the vertical velocity itself, infinite for none (m/s).
    pub vertical_velocity_m_s: f64,
    /// Whether a standstill found in Doppler ties epochs at rest.
    pub zero_velocity: bool,
    /// Whether velocity and clock tie epochs together; without, only Doppler velocity does.
    pub motion: bool,
    /// Random walk of the receiver clock (m/√s).
    pub clock_walk_m: f64,
    /// Random walk of its drift (m/s/√s).
    pub drift_walk_m_s: f64,
    /// Random walk of the inter-system biases (m/√s).
    pub bias_walk_m: f64,
    /// A pause longer than this starts the graph anew (s).
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
            // The paper prints neither; deviation and width are those of the program it names,
            // GraphGNSSLib.
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
            pseudorange_kernel: KernelLaw::GemanMcclure,
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
