//! Updates the receiver model from the newest epoch of a chain.

use nalgebra::SMatrix;

use crate::graph::Estimate;
use crate::positioning::factors::STATE;
use crate::positioning::receiver::{PostFit, PseudorangeExcess};

use super::chain::{Chain, ChainScratch};

impl Chain {
    /// Updates the receiver model from the newest epoch, whose state has this covariance.
    pub(super) fn learn(
        &mut self,
        covariance: &SMatrix<f64, STATE, STATE>,
        scratch: &mut ChainScratch,
    ) {
        let ChainScratch { numbers, lines, signals, seen: [before, _], .. } = scratch;
        let Estimate { states, border } = &self.estimate;
        let ([.., newest], [.., state]) = (&*self.epochs, &**states) else { return };
        let factors = &newest.factors;
        factors.see(state, lines);
        let pseudorange =
            factors.ranges.iter().zip(&*signals).map(|(range, signal)| PseudorangeExcess {
                satellite: range.satellite,
                signal: *signal,
                sigma_m: range.factor.inverse_sigma.recip(),
                excess_m: range.excess_m(lines, state, border),
            });
        let pseudorange: Vec<_> = pseudorange.collect();
        let doppler: Vec<_> = factors.rates.iter().map(|r| r.linearize(state).residual).collect();
        let mut phase = Vec::new();
        if let ([.., last, _], [.., earlier, _]) = (&*self.epochs, &**states) {
            last.factors.see(earlier, &mut before.lines);
            let lines = [&*before.lines, &*lines];
            phase = factors.phase_residuals(lines, [earlier, state], numbers);
        }
        let fit = PostFit {
            time: newest.time,
            pseudorange: &pseudorange,
            doppler: &doppler,
            phase: &phase,
            state,
            covariance,
        };
        self.receiver.learn(&fit);
    }
}
