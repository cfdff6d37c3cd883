//! A receiver, a satellite and central differences for the tests of factors.

use crate::gnss::{Ecef, LocalFrame};
use crate::graph::{Link, Row};

use super::{STATE, State};

/// A frame in Hong Kong.
pub(super) fn frame() -> LocalFrame {
    LocalFrame::at(Ecef::new(-2_414_266.9, 5_386_768.9, 2_407_460.0))
}

pub(super) const SATELLITE: Ecef = Ecef::new(-10_000_000.0, 20_000_000.0, 14_000_000.0);
pub(super) const LATER: Ecef = Ecef::new(-9_998_000.0, 20_001_000.0, 14_002_500.0);

pub(super) fn state() -> State {
    State::from([120.0, -40.0, 7.0, 8.0, -3.0, 0.2, 1_500.0, 12.0])
}

pub(super) fn next_state() -> State {
    State::from([128.5, -43.0, 7.1, 8.4, -2.5, 0.1, 1_512.0, 11.5])
}

/// Checks a row's Jacobian against central differences on every column of the state.
pub(super) fn check_row<const N: usize>(at: &State, linearize: impl Fn(&State) -> Row<N>) {
    let row = linearize(at);
    for column in 0..STATE {
        let mut step = State::zeros();
        step[column] = 0.5;
        let slope = linearize(&(at + step)).residual - linearize(&(at - step)).residual;
        let named = row.columns.iter().position(|c| *c == column);
        let stated = named.map_or(0.0, |place| row.jacobian[place]);
        assert!((slope - stated).abs() < 1e-6 * (1.0 + slope.abs()), "{column}: {slope} {stated}");
    }
}

/// Checks a link's Jacobians on both states.
pub(super) fn check_link<const N: usize, const M: usize>(
    linearize: impl Fn(&State, &State) -> Link<N, M>,
) {
    let (a, b) = (state(), next_state());
    check_row(&a, |a| {
        let link = linearize(a, &b);
        Row { residual: link.residual, columns: link.columns, jacobian: link.jacobian }
    });
    check_row(&b, |b| {
        let link = linearize(&a, b);
        Row { residual: link.residual, columns: link.next_columns, jacobian: link.next_jacobian }
    });
}
