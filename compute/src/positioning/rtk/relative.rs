//! The driver of an estimator relative to a base: the steps of one epoch, for both solvers.
//!
//! First the new base epochs are taken in. If the base can be used, the rover's approximate
//! position is found, its observations are differenced, and the solver solves them. If not, an
//! estimator without a base answers. The solver keeps its ambiguities while the base is missing.

use nalgebra::Vector3;

use crate::gnss::{
    Ecef, Enu, GpsTime, LocalFrame, Observation, Reason, SatelliteId, Solution, Status,
};
use crate::positioning::differencing::SingleDifferences;
use crate::positioning::engine::{Engine, EpochInputs};
use crate::positioning::factors::VELOCITY;
use crate::positioning::setup::Setup;
use crate::positioning::starts::FRAME_LIMIT_M;
use crate::snapshot::state_fields;

use super::answer::{AnswerParts, better_known, solution};
use super::companion::{Companion, CompanionScratch};
use super::observed::{
    Arcs, BaseTracking, Intake, Judged, PseudorangeWatch, Received, RowScratch, State, UsableBase,
};
use super::pause::Pause;
use super::relative_solver::{NewEpoch, RelativeSolver, Resolved};

/// An estimator relative to a base.
#[derive(Debug)]
pub(crate) struct Relative<S: RelativeSolver> {
    solver: S,
    base: BaseTracking,
    /// Tests positions without integers.
    watch: PseudorangeWatch,
    /// Where the solver starts again at the next epoch, relative to its prediction (m, local).
    move_m: Option<Vector3<f64>>,
    /// Answers while no base can be used.
    alone: Option<Box<S::Alone>>,
    companion: Option<Box<Companion>>,
    past: S::Past,
}

state_fields!(
    generic [S: RelativeSolver] Relative<S> {
        solver,
        base,
        watch,
        move_m,
        alone,
        companion,
        past,
    }
);

/// Scratch of the estimator.
#[derive(Debug)]
pub(crate) struct RelativeScratch<S: RelativeSolver> {
    intake: Intake,
    rows: RowScratch,
    alone: <S::Alone as Engine>::Scratch,
    companion: CompanionScratch,
    solver: S::Scratch,
}

impl<S: RelativeSolver> Default for RelativeScratch<S> {
    fn default() -> Self {
        Self {
            intake: Intake::default(),
            rows: RowScratch::default(),
            alone: Default::default(),
            companion: CompanionScratch::default(),
            solver: S::Scratch::default(),
        }
    }
}

/// Whether a chain without ambiguities accompanies a solver. Not if the options request single
/// epochs or real-valued ambiguities.
fn is_accompanied<S: RelativeSolver>(setup: &Setup) -> bool {
    let options = &setup.options.rtk;
    S::IS_ACCOMPANIED && options.resolve && !options.single_epoch
}

/// An epoch that was differenced against a base.
struct DifferencedEpoch<'a> {
    guess: State,
    base: UsableBase<'a>,
    reasons: Vec<Reason>,
}

impl<S: RelativeSolver> Engine for Relative<S> {
    type Scratch = RelativeScratch<S>;

    fn new(setup: &Setup, revises: bool) -> Self {
        let (solver, past) = (S::new(), S::past(revises));
        let (base, watch) = (BaseTracking::default(), PseudorangeWatch::default());
        let companion = is_accompanied::<S>(setup).then(|| Box::new(Companion::new(setup)));
        Self { solver, base, watch, move_m: None, alone: None, companion, past }
    }

    fn fits(&self, setup: &Setup) -> bool {
        self.alone.as_ref().is_none_or(|alone| alone.fits(setup))
            && self.companion.as_ref().is_none_or(|companion| companion.fits(setup))
            && self.companion.is_some() == is_accompanied::<S>(setup)
    }

    /// An epoch that is not after the last one is answered alone and does not change the state.
    fn advance(
        &mut self,
        inputs: &EpochInputs<'_>,
        scratch: &mut RelativeScratch<S>,
        revisions: &mut Vec<Solution>,
    ) -> Solution {
        let Some(received) = self.base.receive(inputs) else {
            return scratch.intake.single_point.solve(inputs, None);
        };
        let differenced = self.difference(inputs, &received, scratch, revisions);
        let answered = differenced.and_then(|epoch| self.solve(inputs, epoch, scratch, revisions));
        let is_relative = answered.is_ok();
        let solution = match answered {
            Ok(solution) => {
                self.alone = None;
                self.accompany(solution, inputs, scratch)
            }
            Err(reason) => {
                let alone = match &mut self.alone {
                    Some(alone) => alone,
                    None => {
                        let begun = self.begun_alone(inputs, scratch);
                        self.alone.insert(begun)
                    }
                };
                let mut solution = alone.advance(inputs, &mut scratch.alone, &mut Vec::new());
                solution.reasons.extend(received.reasons().chain([reason]));
                solution
            }
        };
        let answer = (&solution, is_relative);
        self.solver.remember(answer, inputs, &mut self.past, &mut scratch.solver, revisions);
        solution
    }

    fn finish(
        &mut self,
        setup: &Setup,
        scratch: &mut RelativeScratch<S>,
        revisions: &mut Vec<Solution>,
    ) {
        self.solver.answer_all(setup, &mut self.past, &mut scratch.solver, revisions);
    }

    fn oldest_unrevised(&self) -> Option<GpsTime> {
        S::oldest(&self.past)
    }
}

impl<S: RelativeSolver> Relative<S> {
    /// Differences the epoch against the base, or gives the reason why that is impossible.
    fn difference<'a>(
        &mut self,
        inputs: &EpochInputs<'a>,
        received: &Received,
        scratch: &mut RelativeScratch<S>,
        revisions: &mut Vec<Solution>,
    ) -> Result<DifferencedEpoch<'a>, Reason> {
        if let (true, Some(companion)) = (received.is_moved(), &mut self.companion) {
            companion.forget();
        }
        if received.is_moved() {
            let (past, solver) = (&mut self.past, &mut scratch.solver);
            self.solver.answer_all(inputs.setup, past, solver, revisions);
        }
        if received.base_changed_m.is_some() {
            self.solver.forget();
        }
        let (time, rtk) = (inputs.epoch.time, &inputs.options().rtk);
        let Intake { single_point, slipped, .. } = &mut scratch.intake;
        slipped.clear();
        if let Some(companion) = &mut self.companion {
            companion.note_lost(received.losses.rover.iter().copied());
        }
        let tracking = self.solver.tracking();
        tracking.arcs.end_lost(&received.losses, time, rtk.arc_gap_s, slipped);
        tracking.pause = Pause::of(&received.losses, &tracking.pause, &tracking.arcs);
        if received.base_moved_m.is_some() {
            // The position so far refers to the base's earlier one.
            self.solver.clear();
        }
        let base = self.base.usable(inputs, single_point)?;
        let mut guess = self.locate(inputs, scratch, revisions)?;
        let mut rover = position(self.solver.frame(), &guess);
        self.base.difference(inputs, rover, base.station, &mut scratch.intake.differences)?;
        if self.solver.last_time().is_some() && scratch.intake.refutes(rover) {
            guess = self.begin(inputs, own_start(inputs, scratch)?, scratch, revisions);
            rover = position(self.solver.frame(), &guess);
            self.base.difference(inputs, rover, base.station, &mut scratch.intake.differences)?;
        }
        let Intake { differences, slipped, .. } = &mut scratch.intake;
        let arcs = &mut self.solver.tracking().arcs;
        arcs.end_flipped(&differences.list, slipped);
        arcs.follow_code_clock(&mut differences.list);
        let mut reasons = Vec::new();
        if !differences.without_ephemeris.is_empty() {
            let satellites = differences.without_ephemeris.clone();
            reasons.push(Reason::EphemerisMissing { satellites });
        }
        reasons.extend(received.reasons());
        Ok(DifferencedEpoch { guess, base, reasons })
    }

    /// The approximate state of the rover. Restarts the solver if it cannot predict one, or if all
    /// arcs have ended in a long pause: the prediction is then worse than the epoch's own position.
    fn locate(
        &mut self,
        inputs: &EpochInputs<'_>,
        scratch: &mut RelativeScratch<S>,
        revisions: &mut Vec<Solution>,
    ) -> Result<State, Reason> {
        let (time, options) = (inputs.epoch.time, inputs.options());
        let (mut start, move_m) = (None, self.move_m.take());
        let has_arcs = !self.solver.tracking().arcs.list().is_empty();
        let longest_s = match has_arcs {
            true => options.graph.gap_s,
            false => options.graph.gap_s.min(options.rtk.arc_gap_s),
        };
        if let Some(last) = self.solver.last_time() {
            let mut guess = self.solver.predicted(time);
            let is_near = guess.fixed_rows::<3>(0).norm() < FRAME_LIMIT_M;
            if options.rtk.single_epoch {
                start = Some((position(self.solver.frame(), &guess), State::zeros()));
            } else if time - last <= longest_s && is_near {
                let Some(move_m) = move_m else { return Ok(guess) };
                let mut local = guess.fixed_rows_mut::<3>(0);
                local += move_m;
                let from = position(self.solver.frame(), &guess);
                guess.fixed_rows_mut::<3>(0).fill(0.0);
                start = Some((from, guess));
            }
        }
        let start = start.map_or_else(|| own_start(inputs, scratch), Ok)?;
        Ok(self.begin(inputs, start, scratch, revisions))
    }

    /// Restarts the solver at a position with an approximate state, which it returns.
    fn begin(
        &mut self,
        inputs: &EpochInputs<'_>,
        (start, guess): (Ecef, State),
        scratch: &mut RelativeScratch<S>,
        revisions: &mut Vec<Solution>,
    ) -> State {
        self.solver.answer_all(inputs.setup, &mut self.past, &mut scratch.solver, revisions);
        self.solver.begin(start, &guess);
        // Residuals of the position before say nothing of this one.
        self.watch = PseudorangeWatch::default();
        guess
    }

    /// An estimator without a base. It goes on from the last epoch, if that had integers: phases
    /// that were not interrupted keep the position while a correction stream is.
    fn begun_alone(
        &self,
        inputs: &EpochInputs<'_>,
        scratch: &mut RelativeScratch<S>,
    ) -> Box<S::Alone> {
        let mut alone = Box::new(S::Alone::new(inputs.setup, false));
        let last = self.companion.as_ref().and_then(|companion| companion.last_fixed());
        let longest_s = inputs.options().graph.gap_s;
        if let Some((epoch, known)) = last
            && inputs.epoch.time - epoch.time <= longest_s
        {
            let then = EpochInputs { epoch, base: None, ..*inputs };
            S::begin_alone(&mut alone, &known, &then, &mut scratch.alone);
        }
        alone
    }

    /// Solves and answers a differenced epoch.
    fn solve(
        &mut self,
        inputs: &EpochInputs<'_>,
        epoch: DifferencedEpoch<'_>,
        scratch: &mut RelativeScratch<S>,
        revisions: &mut Vec<Solution>,
    ) -> Result<Solution, Reason> {
        let DifferencedEpoch { guess, base, mut reasons } = epoch;
        let Intake { differences, slipped, .. } = &mut scratch.intake;
        let (time, setup) = (inputs.epoch.time, inputs.setup);
        let new = NewEpoch { time, guess, differences, setup, slipped };
        let mut resolved = self.solver.solve(new, &mut self.past, &mut scratch.solver);
        if resolved.is_err() && self.solver.tracking().pause.is_refuted() {
            S::leave_all(&mut self.past, revisions);
            resolved = self.solve_afresh(inputs, &base, scratch, revisions);
        }
        let resolved = resolved.inspect_err(|_| S::leave_all(&mut self.past, revisions))?;
        self.reconsider(&resolved, setup.options.rtk.single_epoch, scratch);
        let Intake { differences, slipped, .. } = &mut scratch.intake;
        reasons.extend(slip_reasons(slipped, &self.solver.tracking().arcs, time));
        let float_factor = self.solver.float_factor();
        Ok(solution(AnswerParts {
            float_factor,
            frame: self.solver.frame(),
            epoch: self.solver.epoch(&scratch.solver),
            state: &resolved.state,
            covariance: &resolved.covariance,
            has_velocity: resolved.has_velocity,
            differences,
            resolution: resolved.resolution,
            reasons,
            base,
            options: &setup.options.rtk,
        }))
    }

    /// Solves an epoch from its own position without earlier arcs, because these have more likely
    /// slipped than not.
    fn solve_afresh(
        &mut self,
        inputs: &EpochInputs<'_>,
        base: &UsableBase<'_>,
        scratch: &mut RelativeScratch<S>,
        revisions: &mut Vec<Solution>,
    ) -> Result<Resolved, Reason> {
        let guess = self.begin(inputs, own_start(inputs, scratch)?, scratch, revisions);
        let rover = position(self.solver.frame(), &guess);
        let Intake { differences, slipped, .. } = &mut scratch.intake;
        self.base.difference(inputs, rover, base.station, differences)?;
        let tracking = self.solver.tracking();
        tracking.arcs.follow_code_clock(&mut differences.list);
        tracking.pause.end();
        let (time, setup) = (inputs.epoch.time, inputs.setup);
        let new = NewEpoch { time, guess, differences, setup, slipped };
        self.solver.solve(new, &mut self.past, &mut scratch.solver)
    }

    /// The answer to an epoch that was solved. If it has no integers and the companion has a
    /// smaller covariance, it is the companion's answer.
    fn accompany(
        &mut self,
        solution: Solution,
        inputs: &EpochInputs<'_>,
        scratch: &mut RelativeScratch<S>,
    ) -> Solution {
        let (base, options) = (&self.base, &inputs.options().rtk);
        let Some(companion) = &mut self.companion else { return solution };
        if solution.status == Status::Fixed {
            companion.rest_at(inputs.epoch, &solution);
            return solution;
        }
        let (Some(setup), Some(aiding)) = (&inputs.setup.corrected, inputs.base) else {
            return solution;
        };
        let RelativeScratch { intake, companion: memory, .. } = scratch;
        if self.solver.tracking().pause.may_hide_slips(inputs.options().rtk.probability_min) {
            let carrier = |o: &Observation| (o.satellite, o.code);
            companion.note_lost(inputs.epoch.observations.iter().map(carrier));
        }
        let inputs = EpochInputs { setup, ..*inputs };
        let difference_at =
            |inputs: &EpochInputs<'_>, at: Ecef, differences: &mut SingleDifferences| {
                base.difference(inputs, at, aiding.station, differences).is_ok()
            };
        let other = companion.advance(&inputs, &mut intake.differences, difference_at, memory);
        better_known(solution, other, options)
    }

    /// Adds a solution; if it has no integers, tests whether another position is clearly likelier.
    ///
    /// The solver starts there at the next epoch, because this epoch is already part of its window
    /// and of the answers that may be revised.
    fn reconsider(
        &mut self,
        resolved: &Resolved,
        is_single_epoch: bool,
        scratch: &mut RelativeScratch<S>,
    ) {
        if resolved.resolution.outcome.is_ok() || is_single_epoch || !S::TESTS_RIVALS {
            self.watch = PseudorangeWatch::default();
            return;
        }
        let RelativeScratch { intake, rows, solver: memory, .. } = scratch;
        let (epoch, differences) = (self.solver.epoch(memory), &intake.differences);
        let judged = Judged { epoch, state: &resolved.state, differences };
        self.move_m = self.watch.reconsider(&judged, rows);
    }
}

/// The epoch's own position, and a state there with its own velocity.
fn own_start<S: RelativeSolver>(
    inputs: &EpochInputs<'_>,
    scratch: &mut RelativeScratch<S>,
) -> Result<(Ecef, State), Reason> {
    let alone = scratch.intake.single_point.solve(inputs, None);
    let estimate = alone.estimate.ok_or(Reason::NotConverged)?;
    let mut guess = State::zeros();
    if let Some(velocity) = &estimate.velocity {
        let local = LocalFrame::at(estimate.position).rotation * velocity.velocity_m_s;
        guess.fixed_rows_mut::<3>(VELOCITY).copy_from(&local);
    }
    Ok((estimate.position, guess))
}

/// The ECEF position of a state.
fn position(frame: &LocalFrame, state: &State) -> Ecef {
    frame.to_ecef(Enu(state.fixed_rows::<3>(0).into_owned()))
}

/// Reasons for the satellites whose arcs ended, and for those with a half-cycle ambiguity.
fn slip_reasons(slipped: &mut Vec<SatelliteId>, arcs: &Arcs, time: GpsTime) -> Vec<Reason> {
    let mut reasons = Vec::new();
    if !slipped.is_empty() {
        slipped.sort_unstable();
        slipped.dedup();
        reasons.push(Reason::CycleSlips { satellites: slipped.clone() });
    }
    let halves = arcs.present(time).filter(|arc| arc.half_cycle);
    let mut satellites: Vec<_> = halves.map(|arc| arc.satellite).collect();
    if !satellites.is_empty() {
        satellites.sort_unstable();
        satellites.dedup();
        reasons.push(Reason::HalfCycleUnresolved { satellites });
    }
    reasons
}
