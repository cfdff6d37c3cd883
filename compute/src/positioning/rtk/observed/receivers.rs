//! The estimated noise and code biases of the pair of receivers.

use nalgebra::{Matrix3, Vector3};

use crate::lambda::KnownScale;
use crate::positioning::setup::OFFSET_KERNEL;
use crate::snapshot::state_fields;

use super::code_biases::CodeBiases;
use super::epoch::{RowScratch, RtkEpoch, State};
use super::noise::{NoiseScale, Residuals};
use super::pseudorange_age::LastPseudoranges;
use super::residuals::{leverage, pseudorange_residuals, whitened};

/// Noise and biases of the pair of receivers.
#[derive(Debug)]
pub(crate) struct Receivers {
    pub(crate) last_pseudoranges: LastPseudoranges,
    pub(crate) pseudorange_noise: NoiseScale,
    pub(crate) carrier_noise: NoiseScale,
    pub(crate) biases: CodeBiases,
}

state_fields!(Receivers { last_pseudoranges, pseudorange_noise, carrier_noise, biases });

impl Receivers {
    /// A-priori noise, no biases.
    pub(crate) fn new() -> Self {
        Self {
            last_pseudoranges: LastPseudoranges::default(),
            pseudorange_noise: NoiseScale::stated(),
            carrier_noise: NoiseScale::stated(),
            biases: CodeBiases::default(),
        }
    }

    /// Noise scale of the pseudoranges, updated with the residuals of a solved window.
    pub(crate) fn known_noise(&self, residuals: &Residuals) -> KnownScale {
        self.pseudorange_noise.known(residuals)
    }

    /// Updates the pseudorange noise from a solved epoch.
    ///
    /// A pseudorange with leverage h = aᵀCa/σ² and independent share s, C the position's
    /// covariance, has a residual of variance (1 − (2s − 1)·h)·σ². So the sum of (2s − 1)·h is the
    /// number of parameters that the epoch has determined. It is small if phases tie the position
    /// to earlier epochs.
    pub(crate) fn learn_noise(
        &mut self,
        epoch: &RtkEpoch,
        state: &State,
        covariance: &Matrix3<f64>,
        scratch: &mut RowScratch,
    ) {
        let groups = pseudorange_residuals(epoch, state, scratch);
        let by_position =
            leverage(epoch, state, covariance, scratch, |fraction| 2.0 * fraction - 1.0);
        self.pseudorange_noise.learn(&mut scratch.residuals, groups as f64 + by_position);
    }

    /// Updates the code biases from a position with held integers.
    pub(crate) fn learn_biases(
        &mut self,
        epoch: &RtkEpoch,
        position: &Vector3<f64>,
        scratch: &mut RowScratch,
    ) {
        if epoch.rows.iter().all(|factor| factor.bias.is_none()) {
            return;
        }
        let mut state = State::zeros();
        state.fixed_rows_mut::<3>(0).copy_from(position);
        epoch.see(&state, scratch);
        for group in epoch.groups.iter().filter(|group| !group.is_carrier) {
            let factors = &epoch.rows[group.begin..group.end];
            if factors.iter().all(|factor| factor.bias.is_none()) {
                continue;
            }
            epoch.linearize_group(group, &[], scratch);
            let RowScratch { rows, numbers, .. } = &mut *scratch;
            for (factor, residual) in factors.iter().zip(whitened(rows, &OFFSET_KERNEL, numbers)) {
                let Some(index) = factor.bias else { continue };
                let sigma_m = factor.inverse_sigma.recip();
                self.biases.learn(
                    index,
                    -residual * sigma_m,
                    sigma_m.powi(2),
                    factor.independent_share,
                );
            }
        }
    }
}
