//! Velocity and clock drift from Doppler, equations (2) to (6) of Wen & Hsu (2021).
//!
//! A Doppler shift D on wavelength λ is the range rate −λD = ρ̇ + c·δṫ_r − c·δṫˢ (RINEX's D is
//! positive on approach, so the paper's (3) needs the sign). ρ̇ is linear in the receiver's
//! velocity with gradient −e (the paper's (5) prints +e), so one step of least squares solves. The
//! step is repeated with Huber's weights (Huber 1964) to bound the effect of reflections. One clock
//! drift serves all constellations. The Doppler velocity of the `paper` profile is plain least
//! squares with equal weights, as in the paper and in RTKLIB.

use nalgebra::{Matrix4, Vector3, Vector4};

use crate::config::{DopplerUse, PositioningOptions, REFERENCE_CN0_DB_HZ};
use crate::gnss::{Ecef, Velocity};
use crate::graph::HUBER_WIDTH;
use crate::models::{SatelliteState, range_rate};

use super::Measurement;

/// C/N0 assumed where none is reported (dB-Hz).
pub(super) const CN0_IF_MISSING_DB_HZ: f64 = REFERENCE_CN0_DB_HZ;
/// Largest number of solutions; the weights settle to a millimetre per second within it.
const ITERATIONS_MAX: usize = 20;
/// Change of velocity below which the weights have settled (m/s).
const CONVERGED_M_S: f64 = 1e-4;
/// Smallest ratio of the smallest to the largest pivot at which the velocity is determined.
const PIVOT_RATIO_MIN: f64 = 1e-10;

/// A Doppler measurement, linear in velocity and drift.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Row {
    /// Design row, ∂/∂[v; c·δṫ_r].
    design: Vector4<f64>,
    /// Model − measured for a receiver at rest without drift (m/s).
    residual_m_s: f64,
    /// Square root of the weight, 1/σ (s/m).
    root_weight: f64,
}

/// Rows of the Doppler equations; the memory is reused.
#[derive(Clone, Debug, Default)]
pub(super) struct VelocityEstimator {
    rows: Vec<Row>,
}

impl VelocityEstimator {
    /// Velocity by the Doppler of all measurements above the mask, where the options use it as a
    /// whole rather than satellite by satellite.
    pub(super) fn estimate_whole(
        &mut self,
        position: Ecef,
        measurements: &[Measurement],
        options: &PositioningOptions,
    ) -> Option<Velocity> {
        let is_used = |index: usize| measurements[index].is_above_mask;
        match options.graph.doppler {
            DopplerUse::Velocity => self.estimate(position, measurements, is_used, options),
            DopplerUse::None | DopplerUse::Satellites => None,
        }
    }

    /// Velocity at `position` from the measurements that `is_used` accepts; `None` if their Doppler
    /// does not determine it.
    pub(super) fn estimate(
        &mut self,
        position: Ecef,
        measurements: &[Measurement],
        is_used: impl Fn(usize) -> bool,
        options: &PositioningOptions,
    ) -> Option<Velocity> {
        let used = measurements.iter().enumerate().filter(|(index, _)| is_used(*index));
        let rates = used.filter_map(|(_, m)| Some((&m.state, m.range_rate_m_s?, m.cn0_db_hz)));
        self.estimate_rates(position, rates, options)
    }

    /// Velocity at `position` from satellites with their range rates, corrected for the satellites'
    /// clocks (m/s), and C/N0 (dB-Hz); `None` if these do not determine it.
    pub(super) fn estimate_rates<'a>(
        &mut self,
        position: Ecef,
        rates: impl Iterator<Item = (&'a SatelliteState, f64, Option<f64>)>,
        options: &PositioningOptions,
    ) -> Option<Velocity> {
        self.rows.clear();
        self.rows.extend(rates.map(|rate| row(position, rate, options)));
        match options.graph.doppler {
            DopplerUse::Velocity => {
                let root_weight = options.doppler_sigma_m_s.recip();
                self.rows.iter_mut().for_each(|row| row.root_weight = root_weight);
                solve(&self.rows, f64::INFINITY)
            }
            DopplerUse::None | DopplerUse::Satellites => solve(&self.rows, HUBER_WIDTH),
        }
    }
}

fn row(
    position: Ecef,
    (state, measured_m_s, cn0_db_hz): (&SatelliteState, f64, Option<f64>),
    options: &PositioningOptions,
) -> Row {
    let rate = range_rate(state.position, &state.velocity_m_s, position, &Vector3::zeros());
    let slope = rate.by_velocity;
    let cn0_db_hz = cn0_db_hz.unwrap_or(CN0_IF_MISSING_DB_HZ);
    Row {
        design: Vector4::new(slope.x, slope.y, slope.z, 1.0),
        residual_m_s: rate.rate_m_s - measured_m_s,
        root_weight: variance_m2_s2(options.doppler_sigma_m_s, cn0_db_hz).sqrt().recip(),
    }
}

/// σ² = s²·(1 + 10^(−(S−42)/10)) (m²/s²): the variance of a strong signal, and thermal noise.
pub(super) fn variance_m2_s2(sigma_m_s: f64, cn0_db_hz: f64) -> f64 {
    let decades = (REFERENCE_CN0_DB_HZ - cn0_db_hz) / 10.0;
    sigma_m_s * sigma_m_s * (1.0 + (std::f64::consts::LN_10 * decades).exp())
}

/// Reweighted least squares: residuals beyond `huber` deviations have the influence of `huber`
/// deviations.
fn solve(rows: &[Row], huber: f64) -> Option<Velocity> {
    if rows.len() < 4 {
        return None;
    }
    let mut state = Vector4::zeros();
    let mut inverse = Matrix4::zeros();
    for iteration in 0..ITERATIONS_MAX {
        let (mut normal, mut right) = (Matrix4::zeros(), Vector4::zeros());
        for row in rows {
            let whitened = whitened(row, &state).abs();
            let kernel = if iteration == 0 { 1.0 } else { (huber / whitened).min(1.0) };
            let weighted = row.design * (row.root_weight * row.root_weight * kernel);
            normal += weighted * row.design.transpose();
            right -= weighted * row.residual_m_s;
        }
        inverse = invert_positive(&normal)?;
        let next = inverse * right;
        let change = (next - state).norm();
        state = next;
        if change < CONVERGED_M_S {
            break;
        }
    }
    let degrees = rows.len() - 4;
    let squares: f64 = rows.iter().map(|row| huber_square(whitened(row, &state), huber)).sum();
    let scale = if degrees == 0 { 1.0 } else { (squares / degrees as f64).max(1.0) };
    Some(Velocity {
        velocity_m_s: state.xyz(),
        covariance: inverse.fixed_view::<3, 3>(0, 0) * scale,
        clock_drift_m_s: state.w,
    })
}

fn whitened(row: &Row, state: &Vector4<f64>) -> f64 {
    row.root_weight * (row.design.dot(state) + row.residual_m_s)
}

/// w(r)·r²: the square of a residual times its Huber weight.
fn huber_square(whitened: f64, huber: f64) -> f64 {
    whitened.abs().min(huber) * whitened.abs()
}

fn invert_positive(normal: &Matrix4<f64>) -> Option<Matrix4<f64>> {
    let factor = normal.cholesky()?;
    let pivots = factor.l_dirty().diagonal();
    (PIVOT_RATIO_MIN * pivots.max().powi(2) < pivots.min().powi(2)).then(|| factor.inverse())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Satellites along the axes, three of them on one, whose first Doppler is 6 m/s off. The
    /// normal equations 4v + 2d = 6, 2v + 8d = 6 of that axis give v = 9/7 and d = 3/7; Huber's
    /// weights bound what one Doppler can do.
    #[test]
    fn plain_least_squares_believes_every_doppler_alike() {
        let slopes =
            [(1.0, 0), (1.0, 0), (1.0, 0), (-1.0, 0), (1.0, 1), (-1.0, 1), (1.0, 2), (-1.0, 2)];
        let mut rows = slopes.map(|(sign, axis)| {
            let mut design = Vector4::w();
            design[axis] = sign;
            Row { design, residual_m_s: 0.0, root_weight: 10.0 }
        });
        rows[0].residual_m_s = -6.0;
        let plain = solve(&rows, f64::INFINITY).unwrap();
        assert!((plain.velocity_m_s - Vector3::new(9.0 / 7.0, 0.0, 0.0)).norm() < 1e-12);
        assert!((plain.clock_drift_m_s - 3.0 / 7.0).abs() < 1e-12);
        let robust = solve(&rows, HUBER_WIDTH).unwrap();
        assert!(robust.velocity_m_s.norm() < 0.2, "{}", robust.velocity_m_s.norm());
    }
}
