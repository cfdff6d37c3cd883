//! Options of protection levels and their defaults; `integrity_table` names and explains them.

use super::choices::Beyond;

/// Options of the protection levels of a position.
#[derive(Clone, Debug, PartialEq)]
pub struct IntegrityOptions {
    /// Probability that an error exceeds its protection level.
    pub risk: f64,
    /// Limit of the horizontal protection level (m); infinite without a limit.
    pub limit_h_m: f64,
    /// Limit of the vertical protection level (m); infinite without a limit.
    pub limit_v_m: f64,
    /// What becomes of a position beyond a limit.
    pub beyond: Beyond,
}

impl IntegrityOptions {
    /// Levels at 10⁻³ without limits.
    pub(super) fn new() -> Self {
        Self {
            risk: 1e-3,
            limit_h_m: f64::INFINITY,
            limit_v_m: f64::INFINITY,
            beyond: Beyond::Flag,
        }
    }
}
