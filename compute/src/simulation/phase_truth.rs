//! The truth of a simulated carrier phase.

/// The true values of a carrier phase.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PhaseTruth {
    /// Its ambiguity N (cycles): an integer, or a half-integer while the half cycle is unresolved.
    /// A slip changes it.
    pub ambiguity_cycles: f64,
    /// Elevation of the satellite (rad).
    pub elevation_rad: f64,
    /// Whether the phase is that of a reflection, whose path changes as the rover moves.
    pub is_reflected: bool,
}
