//! Decides whether a window moves to another position.
//!
//! If the window rejects most pseudoranges of the newest epoch, this epoch is solved again from its
//! own pseudoranges ([`Chain::retry`]). If most of them are then farther off than any multipath, a
//! new chain begins ([`Chain::is_refuted`]): the receiver was moved while it was off, or a repeater
//! or a simulator has led it away. If the window's residuals have agreed on another position
//! for long enough, the whole window moves there ([`Chain::reconsider`]).

use std::sync::Arc;

use crate::gnss::Constellation;
use crate::graph::{EliminationError, Estimate, Prior, Workspace};
use crate::positioning::clock_jump::CRYSTAL_DRIFT_M_S;
use crate::positioning::factors::{
    BiasFactor, CLOCK, ComponentFactor, DRIFT, STATE, VELOCITY, position,
};
use crate::positioning::rivals::{Knowledge, Offset, Pooled, Rivalry, Verdict, rivalry};
use crate::positioning::setup::GraphSettings;
use crate::positioning::starts::{START_CLOCK_M, START_M_S, are_refuting};

use super::chain::{BIAS_M, Chain, ChainScratch};
use super::epoch::Miss;

/// Standard deviation of the first position's prior after a move (m).
const MOVED_M: f64 = 30.0;

impl Chain {
    /// Solves again, starting from the position of the newest epoch's own pseudoranges, and keeps
    /// the minimum of lower cost. `cost` is the cost of the present minimum.
    pub(super) fn retry(
        &mut self,
        cost: f64,
        settings: &GraphSettings,
        scratch: &mut ChainScratch,
        workspace: &mut Workspace<STATE>,
    ) -> Result<(), EliminationError> {
        let first = self.estimate.clone();
        if !self.start_at_consensus(scratch) {
            return Ok(());
        }
        let again = self.solve(settings, &settings.update, scratch, workspace);
        if again.is_ok_and(|again| again < cost) {
            return Ok(());
        }
        self.estimate = first;
        self.factor(settings, scratch, workspace)?;
        self.weigh_residuals(settings, scratch);
        Ok(())
    }

    /// Whether the accepted pseudoranges of the newest epoch do not determine its position.
    pub(super) fn is_lost(&self) -> bool {
        self.epochs.last().is_some_and(|newest| newest.residuals.is_lost())
    }

    /// Whether the newest epoch's pseudoranges refute its position, so that another one must be
    /// looked for farther away than the search reaches.
    pub(super) fn is_refuted(&self, scratch: &mut ChainScratch) -> bool {
        let Estimate { states, border } = &self.estimate;
        let (Some(newest), Some(state)) = (self.epochs.last(), states.last()) else { return false };
        if !self.is_lost() {
            return false;
        }
        let ChainScratch { lines, numbers, .. } = scratch;
        newest.factors.see(state, lines);
        numbers.clear();
        let ranges = &newest.factors.ranges;
        numbers.extend(ranges.iter().map(|range| range.miss_m(lines, state, border)));
        are_refuting(numbers)
    }

    /// Moves the newest state to the position on which its own pseudoranges agree; returns whether
    /// this is another position.
    fn start_at_consensus(&mut self, scratch: &mut ChainScratch) -> bool {
        let Some(now) = self.last_time() else { return false };
        let mut pool = self.pooled(0.0, scratch);
        pool.iter_mut().for_each(|pooled| pooled.independent = 1.0);
        let bias_sigma_m = self.watch.bias_sigma_m(now);
        let knowledge = Knowledge { bias_sigma_m, settled: 0.0 };
        let rivalry = rivalry(&pool, knowledge, f64::NEG_INFINITY, now.as_ns() as u64);
        let (Rivalry::Rival { offset, .. }, Some(state)) =
            (rivalry, self.estimate.states.last_mut())
        else {
            return false;
        };
        let by_m = offset.position_m();
        (0..3).for_each(|axis| state[axis] += by_m[axis]);
        // The biases are those of all epochs, so they stay: the clock moves by one of its offsets.
        let first = pool.iter().map(|pooled| pooled.satellite.constellation).min();
        state[CLOCK] += first.map_or(0.0, |constellation| offset.clock_m(constellation));
        true
    }

    /// Tests whether another position is clearly likelier, and moves the window there. Returns
    /// whether it moved; it must then be solved again.
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
        let verdict = self.watch.judge(now, &window, self.unproven_s(now));
        match &verdict {
            Verdict::Proven => self.is_proven = true,
            Verdict::Open => {}
            Verdict::Move(offset) => self.move_by(offset),
        }
        matches!(verdict, Verdict::Move(_))
    }

    /// The median residual of each satellite over the window's last `span_s`.
    pub(super) fn pooled(&self, span_s: f64, scratch: &mut ChainScratch) -> Vec<Pooled> {
        let ChainScratch { lines, misses, .. } = scratch;
        let Some(now) = self.last_time() else { return Vec::new() };
        let Estimate { states, border } = &self.estimate;
        let mut independent = 0.0;
        misses.clear();
        for (k, (epoch, state)) in self.epochs.iter().zip(states).enumerate() {
            if span_s < now - epoch.time {
                continue;
            }
            independent += epoch.share;
            epoch.factors.see(state, lines);
            misses.extend(epoch.factors.ranges.iter().enumerate().map(|(index, range)| Miss {
                satellite: range.satellite,
                residual_m: range.miss_m(lines, state, border),
                range: (k, index),
            }));
        }
        misses.sort_unstable_by(|a, b| {
            a.satellite.cmp(&b.satellite).then(a.residual_m.total_cmp(&b.residual_m))
        });
        let independent = f64::min(independent, 1.0);
        let middle = |of_satellite: &[Miss]| {
            let Miss { satellite, residual_m, range: (k, index) } =
                of_satellite[of_satellite.len() / 2];
            let factors = &self.epochs[k].factors;
            let range = &factors.ranges[index];
            let (_, slope) = factors.sights[usize::from(range.sight)].range(&position(&states[k]));
            let (error, before_learning) = (range.error()?, range.reflection?.before_learning);
            Some(Pooled { satellite, slope, residual_m, error, before_learning, independent })
        };
        misses.chunk_by(|a, b| a.satellite == b.satellite).filter_map(middle).collect()
    }

    /// Moves the window by an offset of position and clocks, and drops the prior.
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
        if offset.is_before_learning() {
            self.receiver.forget_code();
        }
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
