//! Solves each epoch together with those before it, and revises the epochs that leave the graph.

use nalgebra::{Matrix3, SMatrix, Vector3};

use crate::gnss::{Ecef, Enu, GpsTime, LocalFrame, Reason, Solution};
use crate::graph::{BorderLife, Elimination, Estimate, System, Workspace};
use crate::positioning::engine::EpochInputs;
use crate::positioning::factors::{DopplerFactor, DopplerVelocityFactor, VELOCITY};
use crate::positioning::fgo::SlidingWindow;
use crate::positioning::rtk::ambiguity::Resolution;
use crate::positioning::rtk::observed::{RtkEpoch, State as RtkState};
use crate::positioning::rtk::relative_solver::{NewEpoch, RelativeSolver, Resolved};
use crate::positioning::rtk::tracking::Tracking;
use crate::positioning::setup::Setup;
use crate::positioning::velocity::VelocityEstimator;

use super::chain::{PaperChain, solved, starting_prior};
use super::epoch::{PaperEpoch, Rows, STATE, State, doppler_velocity};
use super::integers::PaperIntegers;
use super::past::{Known, PaperPast};

/// Scratch of the chain.
#[derive(Debug)]
pub(crate) struct PaperScratch {
    integers: PaperIntegers,
    velocity: VelocityEstimator,
    workspace: Workspace<STATE>,
    oldest: (System<STATE>, Elimination<STATE>),
}

impl Default for PaperScratch {
    fn default() -> Self {
        Self {
            integers: PaperIntegers::default(),
            velocity: VelocityEstimator::default(),
            workspace: Workspace::new(BorderLife::WholeChain),
            oldest: (System::new(BorderLife::WholeChain), Elimination::new()),
        }
    }
}

impl RelativeSolver for PaperChain {
    type Alone = SlidingWindow;
    type Past = Option<PaperPast>;
    type Scratch = PaperScratch;

    const TESTS_RIVALS: bool = false;

    fn new() -> Self {
        Self::empty()
    }

    fn past(revises: bool) -> Option<PaperPast> {
        revises.then(PaperPast::default)
    }

    fn last_time(&self) -> Option<GpsTime> {
        self.epochs.last().map(|epoch| epoch.time)
    }

    fn predicted(&self, time: GpsTime) -> RtkState {
        let mut state = RtkState::zeros();
        state.fixed_rows_mut::<STATE>(0).copy_from(&self.expected(time));
        state.fixed_rows_mut::<3>(VELOCITY).copy_from(&self.velocity_m_s.unwrap_or_default());
        state
    }

    fn frame(&self) -> &LocalFrame {
        &self.frame
    }

    fn tracking(&mut self) -> &mut Tracking {
        &mut self.tracking
    }

    fn float_factor(&mut self) -> f64 {
        1.0
    }

    fn clear(&mut self) {
        self.epochs.clear();
        self.estimate.states.clear();
        self.prior = starting_prior();
        self.velocity_m_s = None;
    }

    fn begin(&mut self, start: Ecef, _guess: &RtkState) {
        self.clear();
        self.frame = LocalFrame::at(start);
    }

    fn forget(&mut self) {
        self.clear();
    }

    fn solve(
        &mut self,
        new: NewEpoch<'_>,
        past: &mut Option<PaperPast>,
        scratch: &mut PaperScratch,
    ) -> Result<Resolved, Reason> {
        let setup = new.setup;
        let velocity = self.append(&new, &mut scratch.velocity);
        let Self { epochs, estimate, prior, .. } = self;
        let rows = Rows { epochs, prior };
        let covariances = solved(rows, estimate, &setup.alone.whole, &mut scratch.workspace);
        let Ok(covariances) = covariances else {
            self.clear();
            return Err(Reason::NotConverged);
        };
        let rtk = &setup.options.rtk;
        let newest = epochs.last().expect("the new epoch was appended");
        let position = *estimate.states.last().expect("one state for each epoch");
        let covariance = *covariances.last().expect("one covariance for each epoch");
        let resolution = scratch.integers.resolve(newest, (&position, &covariance), rtk);
        for oldest in &covariances {
            if !self.is_over(&setup.options.graph) {
                break;
            }
            let position = self.estimate.states[0];
            if let Some(past) = past.as_mut().filter(|_| !setup.is_batch) {
                let (frame, epoch) = (&self.frame, &self.epochs[0]);
                let known = Known { frame, epoch, position: &position, covariance: oldest };
                past.revise(&known, rtk, &mut scratch.integers);
            }
            let Ok(epoch) = self.forget_oldest(&mut scratch.oldest) else {
                self.clear();
                return Err(Reason::NotConverged);
            };
            if let Some(past) = past.as_mut().filter(|_| setup.is_batch) {
                past.keep(epoch, position);
            }
        }
        Ok(resolved(&position, &covariance, velocity, resolution))
    }

    fn epoch<'a>(&'a self, _scratch: &'a PaperScratch) -> &'a RtkEpoch {
        &self.newest
    }

    fn remember(
        &self,
        (solution, is_relative): (&Solution, bool),
        inputs: &EpochInputs<'_>,
        past: &mut Option<PaperPast>,
        _scratch: &mut PaperScratch,
        revisions: &mut Vec<Solution>,
    ) {
        let Some(past) = past else { return };
        past.push(solution.clone(), is_relative);
        if !inputs.setup.is_batch {
            revisions.extend(past.leave());
        }
    }

    fn answer_all(
        &self,
        setup: &Setup,
        past: &mut Option<PaperPast>,
        scratch: &mut PaperScratch,
        revisions: &mut Vec<Solution>,
    ) {
        let Some(past) = past else { return };
        self.revise_all(setup, past, scratch);
        revisions.extend(past.leave_all());
    }

    fn leave_all(past: &mut Option<PaperPast>, revisions: &mut Vec<Solution>) {
        revisions.extend(past.iter_mut().flat_map(PaperPast::leave_all));
    }

    fn oldest(past: &Option<PaperPast>) -> Option<GpsTime> {
        past.as_ref()?.oldest_time()
    }
}

impl PaperChain {
    /// Adds an epoch; returns its local velocity by Doppler with its covariance.
    fn append(
        &mut self,
        new: &NewEpoch<'_>,
        estimator: &mut VelocityEstimator,
    ) -> Option<(Vector3<f64>, Matrix3<f64>)> {
        let (differences, options) = (new.differences, &new.setup.options);
        let mut epoch = PaperEpoch::new(new.time, &self.frame, differences, options);
        if let (Some(last), Some(velocity_m_s)) = (self.epochs.last(), self.velocity_m_s) {
            let interval_s = new.time - last.time;
            let inverse_sigma = options.graph.doppler_velocity_sigma_m_s.recip();
            epoch.tie = Some(DopplerVelocityFactor { velocity_m_s, interval_s, inverse_sigma });
        }
        let guess: State = new.guess.fixed_rows::<STATE>(0).into_owned();
        let velocity = doppler_velocity(&self.frame, &guess, differences, options, estimator);
        self.velocity_m_s = velocity.map(|(velocity_m_s, _)| velocity_m_s);
        self.newest.clear();
        self.newest.time = new.time;
        self.newest.sights.extend_from_slice(&epoch.sights);
        let at = self.frame.to_ecef(Enu(guess));
        self.newest.rates.extend(differences.satellites.iter().filter_map(|common| {
            let rate = common.range_rate?;
            let sigma_m_s = rate.variance_m2_s2.sqrt();
            Some(DopplerFactor::new(&self.frame, at, &common.state, rate.rate_m_s, sigma_m_s))
        }));
        self.epochs.push(epoch);
        self.estimate.states.push(guess);
        velocity
    }

    /// Revises every epoch that is not revised yet. In a batch all epochs are solved together, else
    /// those in the graph. If they do not determine their positions, the answers stay.
    fn revise_all(&self, setup: &Setup, past: &mut PaperPast, scratch: &mut PaperScratch) {
        let (mut epochs, states) = past.take_left();
        let prior = if epochs.is_empty() { self.prior.clone() } else { starting_prior() };
        epochs.extend(self.epochs.iter().cloned());
        let mut estimate = Estimate { states, border: Vec::new() };
        estimate.states.extend_from_slice(&self.estimate.states);
        if epochs.is_empty() {
            return;
        }
        let rows = Rows { epochs: &epochs, prior: &prior };
        let workspace = &mut scratch.workspace;
        let Ok(covariances) = solved(rows, &mut estimate, &setup.alone.whole, workspace) else {
            return;
        };
        let states = epochs.iter().zip(&estimate.states).zip(&covariances);
        for ((epoch, position), covariance) in states {
            let known = Known { frame: &self.frame, epoch, position, covariance };
            past.revise(&known, &setup.options.rtk, &mut scratch.integers);
        }
    }
}

/// The state of an epoch for its answer.
fn resolved(
    position: &State,
    covariance: &Matrix3<f64>,
    velocity: Option<(Vector3<f64>, Matrix3<f64>)>,
    resolution: Resolution,
) -> Resolved {
    let (mut state, mut whole) = (RtkState::zeros(), SMatrix::<f64, 6, 6>::zeros());
    state.fixed_rows_mut::<STATE>(0).copy_from(position);
    whole.fixed_view_mut::<STATE, STATE>(0, 0).copy_from(covariance);
    if let Some((velocity_m_s, covariance)) = &velocity {
        state.fixed_rows_mut::<3>(VELOCITY).copy_from(velocity_m_s);
        whole.fixed_view_mut::<3, 3>(VELOCITY, VELOCITY).copy_from(covariance);
    }
    Resolved { state, covariance: whole, has_velocity: velocity.is_some(), resolution }
}
