//! What a chain learns from its newest epoch, and when it moves.

use std::sync::Arc;

use nalgebra::SMatrix;

use crate::gnss::Constellation;
use crate::graph::{Estimate, Prior};
use crate::positioning::clock_jump::CRYSTAL_DRIFT_M_S;
use crate::positioning::factors::{BiasFactor, CLOCK, ComponentFactor, DRIFT, STATE, VELOCITY};
use crate::positioning::receiver::{CodeResidual, PostFit};
use crate::positioning::starts::{START_CLOCK_M, START_M_S};

use super::chain::{BIAS_M, Chain, ChainScratch};
use super::hypotheses::{Offset, Pooled};
use super::watch::Verdict;

/// Standard deviation of a position about the hypothesis that it was moved to (m).
const MOVED_M: f64 = 30.0;

impl Chain {
    /// Learns from the newest epoch, whose state has this covariance.
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
        let code = factors.ranges.iter().zip(&*signals).map(|(range, signal)| CodeResidual {
            satellite: range.satellite,
            signal: *signal,
            sigma_m: range.factor.inverse_sigma.recip(),
            residual_m: range.miss_m(lines, state, border),
        });
        let code: Vec<_> = code.collect();
        let doppler: Vec<_> = factors.rates.iter().map(|r| r.linearize(state).residual).collect();
        let (mut interval_s, mut phase) = (1.0, Vec::new());
        if let ([.., last, _], [.., earlier, _]) = (&*self.epochs, &**states) {
            interval_s = newest.time - last.time;
            last.factors.see(earlier, &mut before.lines);
            let lines = [&*before.lines, &*lines];
            phase = factors.phase_residuals(lines, [earlier, state], numbers);
        }
        let fit = PostFit {
            interval_s,
            code: &code,
            doppler: &doppler,
            phase: &phase,
            state,
            covariance,
        };
        self.receiver.learn(&fit);
    }

    /// Asks whether the position is clearly likelier elsewhere, and moves the window there if it
    /// is;
    /// it must then be solved again.
    pub(super) fn reconsider(&mut self, scratch: &mut ChainScratch) -> bool {
        let Some(now) = self.last_time() else { return false };
        let interval_s = match &*self.epochs {
            [.., before, _] => Some(now - before.time),
            _ => None,
        };
        if !self.watch.is_due(now, interval_s) {
            return false;
        }
        let window = self.pooled(self.watch.unpooled_s(now), scratch);
        let verdict = self.watch.judge(now, &window, &self.receiver);
        match &verdict {
            Verdict::Proven => self.is_proven = true,
            Verdict::Open => {}
            Verdict::Move(offset) => self.move_by(offset),
        }
        matches!(verdict, Verdict::Move(_))
    }

    /// The residuals of the window's last `span_s`: the median of each satellite.
    fn pooled(&self, span_s: f64, scratch: &mut ChainScratch) -> Vec<Pooled> {
        let ChainScratch { lines, .. } = scratch;
        let Some(now) = self.last_time() else { return Vec::new() };
        let Estimate { states, border } = &self.estimate;
        let mut all = Vec::new();
        for (epoch, state) in self.epochs.iter().zip(states) {
            if span_s < now - epoch.time {
                continue;
            }
            epoch.factors.see(state, lines);
            all.extend(epoch.factors.ranges.iter().filter_map(|range| {
                Some(Pooled {
                    satellite: range.satellite,
                    slope: lines[usize::from(range.sight)].1,
                    residual_m: range.miss_m(lines, state, border),
                    error: range.error()?,
                })
            }));
        }
        all.sort_by(|a, b| {
            a.satellite.cmp(&b.satellite).then(a.residual_m.total_cmp(&b.residual_m))
        });
        let middle = |group: &[Pooled]| group[group.len() / 2];
        all.chunk_by(|a, b| a.satellite == b.satellite).map(middle).collect()
    }

    /// Moves the window by an offset of position and clocks; what was before no longer counts.
    fn move_by(&mut self, offset: &Offset) {
        let by_m = offset.position_m();
        let reference_m = offset.clock_m(Constellation::Gps);
        let Estimate { states, border } = &mut self.estimate;
        for state in states.iter_mut() {
            (0..3).for_each(|axis| state[axis] += by_m[axis]);
            state[CLOCK] += reference_m;
        }
        for constellation in Constellation::ALL.into_iter().skip(1) {
            border[constellation.index()] += offset.clock_m(constellation) - reference_m;
        }
        self.watch.follow(offset);
        self.prior = Prior::none();
        let Some((first, later)) = self.epochs.split_first_mut() else { return };
        let factors = Arc::make_mut(&mut first.factors);
        factors.components.clear();
        factors.biases.clear();
        let start = &states[0];
        let mut add = |column: usize, sigma: f64| {
            let (mean, inverse_sigma) = (start[column], sigma.recip());
            factors.components.push(ComponentFactor { column, mean, inverse_sigma });
        };
        (0..3).for_each(|axis| add(axis, MOVED_M));
        (VELOCITY..CLOCK).for_each(|rate| add(rate, START_M_S));
        add(CLOCK, START_CLOCK_M);
        add(DRIFT, CRYSTAL_DRIFT_M_S);
        for constellation in Constellation::ALL.into_iter().skip(1) {
            let variable = constellation.index();
            if self.begun[variable] {
                let (mean_m, inverse_sigma) = (border[variable], BIAS_M.recip());
                factors.biases.push(BiasFactor { variable, mean_m, inverse_sigma });
            }
        }
        for epoch in later.iter_mut().filter(|epoch| !epoch.factors.biases.is_empty()) {
            Arc::make_mut(&mut epoch.factors).biases.clear();
        }
    }
}
