//! Why a system has no unique solution.

/// A scalar unknown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Variable {
    /// A coordinate of a state.
    State {
        /// Index of the state in the chain.
        index: usize,
        /// Index of the coordinate in the state.
        coordinate: usize,
    },
    /// A border variable.
    Border(usize),
}

/// Why a system has no unique solution.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum EliminationError {
    /// The rows do not determine some direction. The variable is the first one, in the order of
    /// elimination, with too small a pivot.
    #[error("{variable:?} is undetermined: pivot {pivot:e} of a diagonal of {diagonal:e}")]
    Singular {
        /// The variable.
        variable: Variable,
        /// Its pivot: its diagonal entry after elimination of the variables before it.
        pivot: f64,
        /// Its diagonal entry before elimination.
        diagonal: f64,
    },
    /// A row has a value that is not finite.
    #[error("{variable:?} has pivot {pivot}: a row is not finite")]
    NotFinite {
        /// The first variable, in the order of elimination, whose pivot is not finite.
        variable: Variable,
        /// That pivot.
        pivot: f64,
    },
}

impl EliminationError {
    pub(super) fn new(variable: Variable, pivot: f64, diagonal: f64) -> Self {
        if pivot.is_finite() {
            Self::Singular { variable, pivot, diagonal }
        } else {
            Self::NotFinite { variable, pivot }
        }
    }
}
