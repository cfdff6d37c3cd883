//! Brings fixed integers back to the real-valued parameters estimated with them.
//!
//! b̌ = b̂ + Q_bh Q_h⁻¹ (h − Hâ), Q_b̌ = Q_b − Q_bh Q_h⁻¹ Q_hb, Q_h = HQ_âHᵀ, Q_bh = Q_bâHᵀ
//!
//! With H = I this is b̂ − Q_bâ Q_â⁻¹ (â − ǎ).
//!
//! Source: Teunissen (1995).

use nalgebra::DMatrix;
use nalgebra::DVector;

use crate::lambda::Fix;
use crate::lambda::LambdaError;

/// Real-valued parameters b with their covariance and that with the integer entries a.
#[derive(Clone, Debug, PartialEq)]
pub struct RealParameters {
    /// Estimate b, p×1.
    pub estimate: DVector<f64>,
    /// Covariance Q_b, p×p.
    pub covariance: DMatrix<f64>,
    /// Covariance Q_bâ of b with the float entries, p×n.
    pub cross: DMatrix<f64>,
}

/// Workspace to condition real-valued parameters on a fix.
#[derive(Clone, Debug)]
pub struct Conditioning {
    /// Lower Cholesky factor C of Q_h = CCᵀ, m×m row by row.
    factor: Vec<f64>,
    /// (HQ_â) row by row, m×n.
    projected: Vec<f64>,
    /// C⁻¹Q_hb, m×p row by row.
    gain: Vec<f64>,
    /// C⁻¹(h − Hâ), m.
    misclosure: Vec<f64>,
}

impl Conditioning {
    /// A workspace with room for `size` entries and `parameters` real-valued ones.
    pub fn with_capacity(size: usize, parameters: usize) -> Self {
        Self {
            factor: Vec::with_capacity(size * size),
            projected: Vec::with_capacity(size * size),
            gain: Vec::with_capacity(size * parameters),
            misclosure: Vec::with_capacity(size),
        }
    }

    /// Conditions `real` in place on `fix` of `float` (n) with `covariance` (n×n).
    ///
    /// Afterwards estimate and covariance are the fixed ones; `cross` is unchanged.
    ///
    /// # Errors
    /// `Dimension`; `NotPositiveDefinite` when the fixed combinations are not independent.
    pub fn apply(
        &mut self,
        fix: &Fix,
        float: &[f64],
        covariance: &DMatrix<f64>,
        real: &mut RealParameters,
    ) -> Result<(), LambdaError> {
        check(fix, float, covariance, real)?;
        self.project(fix, float, covariance, real);
        self.factorize(fix.len())?;
        let p = real.estimate.len();
        for i in 0..fix.len() {
            self.substitute(i, p);
            let gain = &self.gain[i * p..(i + 1) * p];
            for (c, weight) in gain.iter().enumerate() {
                real.estimate[c] += weight * self.misclosure[i];
                real.covariance
                    .column_mut(c)
                    .iter_mut()
                    .zip(gain)
                    .for_each(|(q, g)| *q -= g * weight);
            }
        }
        Ok(())
    }

    /// HQ_â, the lower part of HQ_âHᵀ, HQ_âb and h − Hâ, before any solving.
    fn project(
        &mut self,
        fix: &Fix,
        float: &[f64],
        covariance: &DMatrix<f64>,
        real: &RealParameters,
    ) {
        let (m, n) = (fix.len(), float.len());
        for buffer in [&mut self.projected, &mut self.factor, &mut self.gain, &mut self.misclosure]
        {
            buffer.clear();
        }
        for i in 0..m {
            let row = fix.combination(i);
            self.projected.extend((0..n).map(|j| dot(row, covariance.column(j).iter())));
            self.gain.extend(real.cross.row_iter().map(|cross| dot(row, cross.iter())));
            let known = fix.values()[i] as f64;
            self.misclosure.push(row.iter().zip(float).fold(known, |rest, (h, a)| rest - h * a));
            for j in 0..m {
                let projected = &self.projected[i * n..(i + 1) * n];
                let entry = if j <= i { dot(projected, fix.combination(j).iter()) } else { 0.0 };
                self.factor.push(entry);
            }
        }
    }

    /// Cholesky in place, row by row.
    fn factorize(&mut self, m: usize) -> Result<(), LambdaError> {
        for i in 0..m {
            let (before, row) = self.factor.split_at_mut(i * m);
            for j in 0..i {
                let other = &before[j * m..j * m + j + 1];
                row[j] = (row[j] - dot(&row[..j], other[..j].iter())) / other[j];
            }
            let variance = row[i];
            let pivot = variance - dot(&row[..i], row[..i].iter());
            if pivot.is_nan() || pivot <= 1e-14 * variance {
                return Err(LambdaError::NotPositiveDefinite { index: i, pivot });
            }
            row[i] = pivot.sqrt();
        }
        Ok(())
    }

    /// Row `i` of C⁻¹Q_hb and of C⁻¹(h − Hâ), those above being done.
    fn substitute(&mut self, i: usize, p: usize) {
        let m = self.misclosure.len();
        let (done, gain) = self.gain.split_at_mut(i * p);
        let row = &self.factor[i * m..i * m + i + 1];
        for j in 0..i {
            let solved = &done[j * p..(j + 1) * p];
            gain[..p].iter_mut().zip(solved).for_each(|(g, s)| *g -= row[j] * s);
            self.misclosure[i] -= row[j] * self.misclosure[j];
        }
        gain[..p].iter_mut().for_each(|g| *g /= row[i]);
        self.misclosure[i] /= row[i];
    }
}

fn dot<'a>(a: &[f64], b: impl Iterator<Item = &'a f64>) -> f64 {
    a.iter().zip(b).map(|(x, y)| x * y).sum()
}

fn check(
    fix: &Fix,
    float: &[f64],
    covariance: &DMatrix<f64>,
    real: &RealParameters,
) -> Result<(), LambdaError> {
    let (n, p) = (float.len(), real.estimate.len());
    let sizes = [
        ("fix", fix.entries().len(), n),
        ("covariance rows", covariance.nrows(), n),
        ("covariance columns", covariance.ncols(), n),
        ("real covariance rows", real.covariance.nrows(), p),
        ("real covariance columns", real.covariance.ncols(), p),
        ("cross covariance rows", real.cross.nrows(), p),
        ("cross covariance columns", real.cross.ncols(), n),
    ];
    match sizes.into_iter().find(|(_, actual, expected)| actual != expected) {
        Some((what, actual, expected)) => Err(LambdaError::Dimension { what, actual, expected }),
        None => Ok(()),
    }
}
