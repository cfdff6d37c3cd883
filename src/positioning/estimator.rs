//! The estimators that sessions, jobs and the command line run.

use std::sync::Arc;

use crate::config::{Mode, PositioningOptions};
use crate::gnss::{Ecef, Epoch, Navigation, Solution};

use super::base::BaseAiding;
use super::ekf::KalmanFilter;
use super::fgo::{SlidingWindow, WholeChain};
use super::rtk::RtkWindow;
use super::spp::SinglePoint;

/// What an epoch needs beside its own observations.
#[derive(Clone, Copy, Debug)]
pub struct Aiding<'a> {
    /// Ephemerides and ionosphere coefficients.
    pub navigation: &'a Navigation,
    /// The base, for modes relative to one.
    pub base: Option<BaseAiding<'a>>,
}

impl<'a> Aiding<'a> {
    /// Without a base.
    pub const fn alone(navigation: &'a Navigation) -> Self {
        Self { navigation, base: None }
    }
}

/// Turns epochs into solutions, one at a time.
///
/// In mode `spp` an epoch is solved from its own observations alone. The previous position serves
/// as the point to start from, which saves iterations and moves the answer by less than 0.1 mm.
/// That position is all the state there is: [`Self::resume`] restores it bit by bit.
///
/// In mode `ekf` the state is a mean with its covariance and the last epoch's carrier phases, in
/// mode `fgo` a window of epochs; no solution restores them: [`Mode::is_resumable`] tells them
/// apart.
#[derive(Debug)]
pub struct Estimator {
    options: Arc<PositioningOptions>,
    engine: Engine,
}

#[derive(Debug)]
enum Engine {
    SinglePoint { start: Option<Ecef>, single_point: Box<SinglePoint> },
    KalmanFilter(Box<KalmanFilter>),
    FactorGraph(Box<SlidingWindow>),
    Relative(Box<RtkWindow>),
}

impl Estimator {
    /// An estimator that has seen nothing yet.
    pub fn new(options: PositioningOptions) -> Self {
        Self::with_revisions(options, false)
    }

    /// One that, in a mode with a window, answers epochs again as they leave it.
    pub fn revising(options: PositioningOptions) -> Self {
        Self::with_revisions(options, true)
    }

    fn with_revisions(options: PositioningOptions, revises: bool) -> Self {
        let engine = match options.mode {
            Mode::Spp => {
                let single_point = Box::new(SinglePoint::new(&options));
                Engine::SinglePoint { start: None, single_point }
            }
            Mode::Ekf => Engine::KalmanFilter(Box::new(KalmanFilter::new(&options))),
            Mode::Fgo => Engine::FactorGraph(Box::new(SlidingWindow::new(&options, revises))),
            Mode::RtkFgo => Engine::Relative(Box::new(RtkWindow::new(&options))),
        };
        Self { options: Arc::new(options), engine }
    }

    /// What it was told.
    pub fn options(&self) -> &PositioningOptions {
        &self.options
    }

    /// Solves one epoch. No position is an answer too, with its reasons.
    pub fn advance(&mut self, epoch: &Epoch, aiding: &Aiding<'_>) -> Solution {
        let (options, navigation) = (&*self.options, aiding.navigation);
        match &mut self.engine {
            Engine::SinglePoint { start, single_point } => {
                let solution = single_point.solve(epoch, navigation, options, *start);
                *start = solution.estimate.as_ref().map(|estimate| estimate.position);
                solution
            }
            Engine::KalmanFilter(filter) => filter.advance(epoch, navigation, options),
            Engine::FactorGraph(window) => window.advance(epoch, navigation, options),
            Engine::Relative(window) => {
                window.advance(epoch, navigation, aiding.base.as_ref(), options)
            }
        }
    }

    /// Answers of the epochs that have left the window since the last call, smoothed by what came
    /// after them. None unless [`Self::revising`].
    pub fn take_revisions(&mut self) -> Vec<Solution> {
        match &mut self.engine {
            Engine::SinglePoint { .. } | Engine::KalmanFilter(_) | Engine::Relative(_) => {
                Vec::new()
            }
            Engine::FactorGraph(window) => window.take_revisions(),
        }
    }

    /// The revisions not yet taken, and those of the epochs still in the window.
    pub fn finish(mut self) -> Vec<Solution> {
        match &mut self.engine {
            Engine::SinglePoint { .. } | Engine::KalmanFilter(_) | Engine::Relative(_) => {
                Vec::new()
            }
            Engine::FactorGraph(window) => window.finish(),
        }
    }

    /// Goes on as if `last` had been its own last answer.
    ///
    /// Only where [`Mode::is_resumable`]: a window begins anew, which gives other answers.
    pub fn resume(&mut self, last: &Solution) {
        match &mut self.engine {
            Engine::SinglePoint { start, .. } => {
                *start = last.estimate.as_ref().map(|estimate| estimate.position);
            }
            Engine::KalmanFilter(filter) => **filter = KalmanFilter::new(&self.options),
            Engine::FactorGraph(window) => **window = SlidingWindow::new(&self.options, false),
            Engine::Relative(window) => **window = RtkWindow::new(&self.options),
        }
    }
}

/// Copies what the next answers depend on; scratch memory stays where it is.
impl Clone for Estimator {
    fn clone(&self) -> Self {
        let engine = match &self.engine {
            Engine::SinglePoint { start, single_point } => Engine::SinglePoint {
                start: *start,
                single_point: Box::new(single_point.with_fresh_memory()),
            },
            Engine::KalmanFilter(filter) => Engine::KalmanFilter(filter.clone()),
            Engine::FactorGraph(window) => Engine::FactorGraph(window.clone()),
            Engine::Relative(window) => Engine::Relative(window.clone()),
        };
        Self { options: Arc::clone(&self.options), engine }
    }

    fn clone_from(&mut self, source: &Self) {
        if !Arc::ptr_eq(&self.options, &source.options) {
            *self = source.clone();
            return;
        }
        match (&mut self.engine, &source.engine) {
            (Engine::SinglePoint { start, .. }, Engine::SinglePoint { start: from, .. }) => {
                *start = *from;
            }
            (Engine::KalmanFilter(filter), Engine::KalmanFilter(from)) => {
                (**filter).clone_from(from);
            }
            (Engine::FactorGraph(window), Engine::FactorGraph(from)) => {
                (**window).clone_from(from);
            }
            (Engine::Relative(window), Engine::Relative(from)) => (**window).clone_from(from),
            _ => *self = source.clone(),
        }
    }
}

/// Smooths all epochs of a recording at once, mode `fgo` only.
#[derive(Debug)]
pub struct Batch {
    options: PositioningOptions,
    chain: WholeChain,
}

impl Batch {
    /// A batch without epochs yet.
    pub fn new(options: PositioningOptions) -> Self {
        let chain = WholeChain::new(&options);
        Self { options, chain }
    }

    /// Takes one epoch.
    pub fn push(&mut self, epoch: &Epoch, aiding: &Aiding<'_>) {
        self.chain.push(epoch, aiding.navigation, &self.options);
    }

    /// Solves everything; one solution for each epoch, in order of time.
    pub fn finish(mut self) -> Vec<Solution> {
        self.chain.finish()
    }
}
