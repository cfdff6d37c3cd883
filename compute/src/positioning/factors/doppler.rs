//! The Doppler factor of one satellite.

use nalgebra::Vector3;

use crate::gnss::{Ecef, LocalFrame};
use crate::graph::{Row, SharingRow};
use crate::models::{SatelliteState, range_rate};
use crate::snapshot::snapshot_fields;

use super::{DRIFT, State, VELOCITY, VELOCITY_AND_DRIFT};

/// Doppler factor on the velocity and the clock drift of one state.
///
/// r = (ρ̇₀ + gᵀv + d − z) / σ
///
/// ρ̇₀ range rate of a receiver at rest (m/s), g = ∂ρ̇/∂v, v local velocity (m/s), d clock drift
/// (m/s), z = −λD + c·δṫˢ the measured rate (m/s). ρ̇₀ and g refer to the approximate position: 100
/// m from it, ρ̇₀ differs by less than 2 cm/s.
///
/// Source: Wen & Hsu (2021), equations (3) to (6), with the signs of `models::range_rate`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct DopplerFactor {
    slope: Vector3<f64>,
    /// z − ρ̇₀ (m/s).
    rate_m_s: f64,
    inverse_sigma: f64,
    /// Index of its satellite among the epoch's sights.
    pub(in crate::positioning) sight: u16,
}

impl DopplerFactor {
    /// From a rate measured approximately at `receiver`.
    pub(crate) fn new(
        frame: &LocalFrame,
        receiver: Ecef,
        satellite: &SatelliteState,
        measured_m_s: f64,
        sigma_m_s: f64,
    ) -> Self {
        let velocity = &satellite.velocity_m_s;
        let rate = range_rate(satellite.position, velocity, receiver, &Vector3::zeros());
        Self {
            slope: frame.rotation * rate.by_velocity.transpose(),
            rate_m_s: measured_m_s - rate.rate_m_s,
            inverse_sigma: sigma_m_s.recip(),
            sight: 0,
        }
    }

    /// The same, of the satellite with index `sight` among the epoch's sights.
    pub(in crate::positioning) fn of_sight(self, sight: u16) -> Self {
        Self { sight, ..self }
    }

    /// The same with its standard deviation multiplied.
    pub(in crate::positioning) fn scaled(self, factor: f64) -> Self {
        Self { inverse_sigma: self.inverse_sigma / factor, ..self }
    }

    /// Whitened residual and its Jacobian on [v; d].
    #[inline]
    pub(crate) fn linearize(&self, state: &State) -> Row<4> {
        let (g, w) = (&self.slope, self.inverse_sigma);
        let along = g.x * state[VELOCITY] + g.y * state[VELOCITY + 1] + g.z * state[VELOCITY + 2];
        Row {
            residual: (along + state[DRIFT] - self.rate_m_s) * w,
            columns: VELOCITY_AND_DRIFT,
            jacobian: [g.x * w, g.y * w, g.z * w, w],
        }
    }

    /// The same on the velocity alone. The drift is the offset that all satellites share.
    pub(crate) fn linearize_sharing(&self, velocity: &Vector3<f64>) -> SharingRow<3> {
        let (g, w) = (&self.slope, self.inverse_sigma);
        let row = Row {
            residual: (g.dot(velocity) - self.rate_m_s) * w,
            columns: [VELOCITY, VELOCITY + 1, VELOCITY + 2],
            jacobian: [g.x * w, g.y * w, g.z * w],
        };
        SharingRow { row, by_offset: w, border: None, independent_share: 1.0 }
    }
}

snapshot_fields!(DopplerFactor { slope, rate_m_s, inverse_sigma, sight });

#[cfg(test)]
mod tests {
    use super::*;
    use crate::positioning::factors::sample::{SATELLITE, check_row, frame, state};

    fn satellite() -> SatelliteState {
        SatelliteState {
            position: SATELLITE,
            velocity_m_s: Vector3::new(1_500.0, -1_200.0, 2_400.0),
            clock_m: 0.0,
            clock_drift_m_s: 0.0,
            variance_m2: 0.0,
        }
    }

    /// Towards a satellite overhead at rest: the range shrinks by the speed; drift adds.
    #[test]
    fn a_residual_worked_by_hand() {
        let frame = LocalFrame::at(Ecef::new(6_378_137.0, 0.0, 0.0));
        let position = Ecef::new(26_378_137.0, 0.0, 0.0);
        let still = SatelliteState { position, velocity_m_s: Vector3::zeros(), ..satellite() };
        let factor = DopplerFactor::new(&frame, frame.origin, &still, 1.0, 0.5);
        let state = State::from([0.0, 0.0, 0.0, 0.0, 0.0, 5.0, 0.0, 8.0]);
        assert!((factor.linearize(&state).residual - (8.0 - 5.0 - 1.0) / 0.5).abs() < 1e-9);
    }

    #[test]
    fn the_jacobian_is_the_derivative() {
        let factor = DopplerFactor::new(&frame(), frame().origin, &satellite(), -300.0, 0.1);
        check_row(&state(), |state| factor.linearize(state));
    }

    /// Both forms give the same velocity, and the same drift.
    #[test]
    fn a_shared_drift_is_the_drift() {
        let factor = DopplerFactor::new(&frame(), frame().origin, &satellite(), -300.0, 0.1);
        let (own, state) = (factor.linearize(&state()), state());
        let shared = factor.linearize_sharing(&state.fixed_rows::<3>(VELOCITY).into_owned());
        let residual = shared.row.residual + shared.by_offset * state[DRIFT];
        assert!((residual - own.residual).abs() < 1e-9);
        assert_eq!(shared.row.jacobian[..], own.jacobian[..3]);
        assert_eq!(shared.row.columns[..], own.columns[..3]);
    }

    /// The satellite's own motion must be included.
    #[test]
    fn the_satellite_moves() {
        let still = SatelliteState { velocity_m_s: Vector3::zeros(), ..satellite() };
        let of = |s: &SatelliteState| {
            DopplerFactor::new(&frame(), frame().origin, s, 0.0, 1.0).linearize(&state()).residual
        };
        assert!(10.0 < (of(&satellite()) - of(&still)).abs());
    }
}
