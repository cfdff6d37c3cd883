//! Detects cycle slips from the residuals of an epoch.

use crate::gnss::SatelliteId;
use crate::graph::Kernel;

use super::arcs::Arcs;
use super::epoch::{EpochAmbiguity, RowScratch, RtkEpoch, State};
use super::residuals::whitened;

/// A phase with a larger whitened residual has slipped.
pub(super) const SLIP_SIGMAS: f64 = 5.0;

/// Maximum number of searches for slips in one epoch.
pub(crate) const SLIP_ROUNDS: usize = 3;

/// What a slip changes.
pub(crate) struct Slips<'a> {
    pub(crate) arcs: &'a mut Arcs,
    /// Ambiguities by variable (cycles).
    pub(crate) border: &'a mut Vec<f64>,
    /// Kernel of the offset of the phases.
    pub(crate) kernel: Kernel,
    /// Satellites whose arcs ended.
    pub(crate) slipped: &'a mut Vec<SatelliteId>,
}

/// Restarts the arcs whose phase in the newest epoch has slipped; returns whether any did.
pub(crate) fn cut_slips(
    epoch: &mut RtkEpoch,
    state: &State,
    slips: Slips<'_>,
    scratch: &mut RowScratch,
) -> bool {
    let Slips { arcs, border, kernel, slipped } = slips;
    let mut found = Vec::new();
    epoch.see(state, scratch);
    epoch.linearize_carriers(border, scratch);
    let RowScratch { rows, numbers, .. } = &mut *scratch;
    let both = rows.iter().zip(whitened(rows, &kernel, numbers));
    for (index, (row, residual)) in epoch.carriers().zip(both) {
        if SLIP_SIGMAS < residual.abs() {
            found.push((index, residual / row.by_offset));
        }
    }
    let mut any = false;
    for (index, residual_m) in found {
        let Some(ambiguity) = epoch.rows[index].ambiguity else { continue };
        let Some((satellite, variable)) = arcs.restart(ambiguity.variable) else { continue };
        any = true;
        slipped.push(satellite);
        let mean = border[ambiguity.variable] - residual_m / ambiguity.wavelength_m;
        epoch.start_ambiguity(border, variable, mean);
        epoch.rows[index].ambiguity = Some(EpochAmbiguity { variable, ..ambiguity });
        epoch.rows[index].independent_share = 1.0;
    }
    any
}
