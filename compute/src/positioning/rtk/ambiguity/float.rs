//! The float solution: position and real-valued ambiguities.

use nalgebra::{DMatrix, Vector3};

use crate::graph::Covariances;
use crate::positioning::rtk::observed::{STATE, State};

/// Position and float ambiguities of one epoch with their joint covariance.
#[derive(Clone, Debug)]
pub(crate) struct FloatSolution {
    /// Local (m).
    pub(crate) position: Vector3<f64>,
    /// Border variables of the ambiguities.
    pub(crate) variables: Vec<usize>,
    /// The ambiguities (cycles), in that order.
    pub(crate) ambiguities: Vec<f64>,
    /// (3 + n)×(3 + n), the position first.
    pub(crate) covariance: DMatrix<f64>,
}

impl FloatSolution {
    /// The float solution of the state whose `covariances` are given; `ambiguities` are in the
    /// order of their border variables there.
    pub(crate) fn of_graph(
        state: &State,
        ambiguities: Vec<f64>,
        covariances: &Covariances<STATE>,
    ) -> Self {
        let variables = covariances.variables().to_vec();
        let n = variables.len();
        let mut covariance = DMatrix::zeros(3 + n, 3 + n);
        covariance
            .fixed_view_mut::<3, 3>(0, 0)
            .copy_from(&covariances.state().fixed_view::<3, 3>(0, 0));
        for b in 0..n {
            let cross = covariances.cross_at(b);
            for axis in 0..3 {
                covariance[(axis, 3 + b)] = cross[axis];
                covariance[(3 + b, axis)] = cross[axis];
            }
            for a in 0..=b {
                let value = covariances.border_at(a, b);
                covariance[(3 + a, 3 + b)] = value;
                covariance[(3 + b, 3 + a)] = value;
            }
        }
        Self { position: state.fixed_rows::<3>(0).into_owned(), ambiguities, variables, covariance }
    }

    /// Index of a border variable among the ambiguities.
    pub(crate) fn index(&self, variable: usize) -> Option<usize> {
        self.variables.iter().position(|&known| known == variable)
    }

    /// Covariance of two ambiguities, by their indices.
    pub(crate) fn between(&self, a: usize, b: usize) -> f64 {
        self.covariance[(3 + a, 3 + b)]
    }
}
