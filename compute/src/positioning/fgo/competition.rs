//! Decides whether a window moves to another position.
//!
//! If the window rejects most pseudoranges of the newest epoch, this epoch is solved again from its
//! own pseudoranges ([`Chain::retry`]). If most of them are then farther off than any multipath, a
//! new chain begins ([`Chain::is_refuted`]): the receiver was moved while it was off, or a repeater
//! or a simulator has led it away. If the window's residuals have agreed on another position
//! for long enough, the whole window moves there ([`Chain::reconsider`]).

use std::sync::Arc;

use crate::gnss::{Constellation, GpsTime};
use crate::graph::{EliminationError, Estimate, Prior, Workspace};
use crate::positioning::clock_jump::CRYSTAL_DRIFT_M_S;
use crate::positioning::factors::{
    BiasFactor, CLOCK, ComponentFactor, DRIFT, Line, STATE, VELOCITY, position,
};
use crate::positioning::ranging::Ranging;
use crate::positioning::rivals::{
    Knowledge, Movable, Offset, Pooled, Rivalry, SPACING_S, Verdict, rivalry,
};
use crate::positioning::setup::GraphSettings;
use crate::positioning::starts::{START_BIAS_M, START_CLOCK_M, START_M_S, are_refuting};

use super::chain::{Chain, ChainScratch};
use super::epoch::{Excess, Source};

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
        self.sum_residuals(settings, scratch);
        Ok(())
    }

    /// Whether the accepted pseudoranges of the newest epoch do not determine its position.
    pub(super) fn lacks_redundancy(&self) -> bool {
        self.epochs.last().is_some_and(|newest| newest.residuals.lacks_redundancy())
    }

    /// Whether the newest epoch's pseudoranges refute its position, so that another one must be
    /// looked for farther away than the search reaches.
    pub(super) fn is_refuted(&self, scratch: &mut ChainScratch) -> bool {
        let Estimate { states, border } = &self.estimate;
        let (Some(newest), Some(state)) = (self.epochs.last(), states.last()) else { return false };
        if !self.lacks_redundancy() {
            return false;
        }
        let ChainScratch { lines, numbers, .. } = scratch;
        newest.factors.see(state, lines);
        numbers.clear();
        let ranges = &newest.factors.ranges;
        numbers.extend(ranges.iter().map(|range| range.excess_m(lines, state, border)));
        are_refuting(numbers)
    }

    /// Moves the newest state to the position on which its own pseudoranges agree; returns whether
    /// this is another position.
    fn start_at_consensus(&mut self, scratch: &mut ChainScratch) -> bool {
        let Some(now) = self.last_time() else { return false };
        let mut pool = self.pooled(0.0, scratch);
        pool.iter_mut().for_each(|pooled| pooled.independent = 1.0);
        let bias_scale_m = self.watch.bias_scale_m(now);
        let knowledge = Knowledge { bias_scale_m, settled: 0.0 };
        let rivalry = rivalry(&pool, knowledge, f64::NEG_INFINITY, now.as_ns() as u64);
        let Rivalry::Rivals(rivals) = rivalry else { return false };
        let (Some(rival), Some(state)) = (rivals.likeliest(), self.estimate.states.last_mut())
        else {
            return false;
        };
        let offset = rival.offset;
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
        self.watch.record_epoch(now, interval_s);
        if !self.watch.is_due(now) {
            return false;
        }
        let window = self.pooled(self.watch.unpooled_s(now), scratch);
        let verdict = self.watch.judge(now, &window, self.unproven_s(now), Movable::Anywhere);
        match &verdict {
            Verdict::Proven => self.is_proven = true,
            Verdict::Open => {}
            Verdict::Move(offset) => self.move_by(offset),
        }
        matches!(verdict, Verdict::Move(_))
    }

    /// The median residual of each satellite over the last `span_s`, of epochs at least
    /// [`SPACING_S`] apart. These may have left the window.
    pub(super) fn pooled(&self, span_s: f64, scratch: &mut ChainScratch) -> Vec<Pooled> {
        let ChainScratch { lines, excesses, .. } = scratch;
        let Some(now) = self.last_time() else { return Vec::new() };
        let Estimate { states, border } = &self.estimate;
        let (mut independent, mut later) = (0.0, None);
        let is_recent = |time: GpsTime| now - time <= span_s;
        excesses.clear();
        let window = self.epochs.iter().zip(states).enumerate().rev();
        for (k, (epoch, state)) in window.take_while(|(_, (epoch, _))| is_recent(epoch.time)) {
            independent += epoch.share;
            if later.is_some_and(|later: GpsTime| later - epoch.time < SPACING_S) {
                continue;
            }
            later = Some(epoch.time);
            epoch.factors.see(state, lines);
            excesses.extend(epoch.factors.ranges.iter().enumerate().map(|(index, range)| Excess {
                satellite: range.satellite,
                excess_m: range.excess_m(lines, state, border),
                source: Source::Window(k, index),
            }));
        }
        let departed = self.watch.departed();
        for (k, epoch) in departed.iter().enumerate().filter(|(_, epoch)| is_recent(epoch.time)) {
            independent += epoch.share;
            excesses.extend(epoch.residuals.iter().enumerate().map(|(index, pooled)| Excess {
                satellite: pooled.satellite,
                excess_m: pooled.excess_m,
                source: Source::Departed(k, index),
            }));
        }
        excesses.sort_unstable_by(|a, b| {
            a.satellite.cmp(&b.satellite).then(a.excess_m.total_cmp(&b.excess_m))
        });
        let independent = f64::min(independent, 1.0);
        // The upper median is the excess of one epoch, whose error model is used.
        let middle = |of_satellite: &[Excess]| {
            let Excess { excess_m, source, .. } = of_satellite[of_satellite.len() / 2];
            let pooled = match source {
                Source::Window(k, index) => self.residual(k, index, excess_m)?,
                Source::Departed(k, index) => departed[k].residuals[index],
            };
            Some(Pooled { independent, ..pooled })
        };
        excesses.chunk_by(|a, b| a.satellite == b.satellite).filter_map(middle).collect()
    }

    /// The residual of pseudorange `index` of epoch `k` with its error model, if one is set.
    fn residual(&self, k: usize, index: usize, excess_m: f64) -> Option<Pooled> {
        let factors = &self.epochs[k].factors;
        let range = &factors.ranges[index];
        let (error, before_learning) = (range.error()?, range.reflection?.before_learning);
        let at = position(&self.estimate.states[k]);
        let (_, slope) = factors.sights[usize::from(range.sight)].range(&at);
        let (satellite, independent) = (range.satellite, self.epochs[k].share);
        Some(Pooled { satellite, slope, excess_m, error, before_learning, independent })
    }

    /// Hands the residuals of the oldest epoch, which leaves the window, to the search for other
    /// positions.
    pub(super) fn keep_residuals(&mut self, lines: &mut Vec<Line>) {
        let (Some(now), Some(oldest)) = (self.last_time(), self.epochs.first()) else { return };
        let mut watch = std::mem::take(&mut self.watch);
        watch.let_leave(now, (oldest.time, oldest.share), || {
            let (state, border) = (&self.estimate.states[0], &self.estimate.border);
            oldest.factors.see(state, lines);
            let ranges = oldest.factors.ranges.iter().enumerate();
            let residual = |(index, range): (usize, &Ranging)| {
                self.residual(0, index, range.excess_m(lines, state, border))
            };
            ranges.filter_map(residual).collect()
        });
        self.watch = watch;
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
            self.receiver.forget_pseudorange_noise();
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
                let (mean_m, inverse_sigma) = (border[variable], START_BIAS_M.recip());
                factors.biases.push(BiasFactor { variable, mean_m, inverse_sigma });
            }
        }
        for epoch in later.iter_mut().filter(|epoch| !epoch.factors.biases.is_empty()) {
            Arc::make_mut(&mut epoch.factors).biases.clear();
        }
    }
}
