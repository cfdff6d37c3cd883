//! The estimators that sessions, jobs and the command line run.

use std::sync::Arc;

use crate::config::{Mode, PositioningOptions};
use crate::gnss::{Ecef, Epoch, GpsTime, Navigation, Solution};
use crate::snapshot::{Snapshot, SnapshotError, SnapshotReader, SnapshotWriter};

use super::base::BaseAiding;
use super::ekf::KalmanFilter;
use super::fgo::{SlidingWindow, WholeChain};
use super::rtk::{Revises, RtkFilter, RtkWindow};
use super::spp::SinglePoint;

/// Layout of the snapshots: raised whenever what is in them changes.
const LAYOUT: u16 = 8;

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
/// That position is all the state there is. In mode `fgo` the state is a window of epochs.
///
/// In mode `ekf` the state is a mean with its covariance and the last epoch's carrier phases; in
/// mode `rtk-ekf` the ambiguities against the base are in it.
///
/// [`Self::snapshot`] and [`Self::restore`] carry the state over a restart, bit by bit.
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
    RelativeFilter(Box<RtkFilter>),
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
            Mode::RtkEkf => Engine::RelativeFilter(Box::new(RtkFilter::new(&options))),
            Mode::RtkFgo => {
                let revises = if revises { Revises::WhenTheyLeave } else { Revises::Never };
                Engine::Relative(Box::new(RtkWindow::new(&options, revises)))
            }
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
            Engine::RelativeFilter(filter) => {
                filter.advance(epoch, navigation, aiding.base.as_ref(), options)
            }
        }
    }

    /// Answers of the epochs that have left the window since the last call, smoothed by what came
    /// after them. None unless [`Self::revising`].
    pub fn take_revisions(&mut self) -> Vec<Solution> {
        match &mut self.engine {
            Engine::FactorGraph(window) => window.take_revisions(),
            Engine::Relative(window) => window.take_revisions(),
            _ => Vec::new(),
        }
    }

    /// The revisions not yet taken, and those of the epochs still in the window.
    pub fn finish(mut self) -> Vec<Solution> {
        match &mut self.engine {
            Engine::FactorGraph(window) => window.finish(),
            Engine::Relative(window) => window.finish(&self.options),
            _ => Vec::new(),
        }
    }

    /// Time of the oldest epoch that [`Self::take_revisions`] may still answer again.
    pub fn oldest_unrevised(&self) -> Option<GpsTime> {
        match &self.engine {
            Engine::FactorGraph(window) => window.oldest_time(),
            Engine::Relative(window) => window.oldest_time(),
            _ => None,
        }
    }

    /// The state as bytes: what the next answers depend on, options and navigation data apart.
    /// Revisions not yet taken are no part of it: take them first.
    pub fn snapshot(&self) -> Vec<u8> {
        let mut writer = SnapshotWriter::new(LAYOUT);
        self.engine.save(&mut writer);
        writer.finish()
    }

    /// An estimator that goes on where [`Self::snapshot`] was taken, with the same bits. `options`
    /// must be those of the estimator it was taken of.
    ///
    /// # Errors
    /// The bytes are not such a snapshot, or of another layout.
    pub fn restore(options: PositioningOptions, snapshot: &[u8]) -> Result<Self, SnapshotError> {
        let mut reader = SnapshotReader::open(snapshot, LAYOUT)?;
        let engine = Engine::load(&options, &mut reader)?;
        reader.finish()?;
        Ok(Self { options: Arc::new(options), engine })
    }

    /// Swaps the memory that both work in, which no answer depends on. Between different modes
    /// nothing happens.
    ///
    /// An estimator at rest so holds its state and nothing else, and those that work share the
    /// memory of as many as work at the same time.
    pub fn exchange_memory(&mut self, other: &mut Self) {
        match (&mut self.engine, &mut other.engine) {
            (
                Engine::SinglePoint { single_point, .. },
                Engine::SinglePoint { single_point: other, .. },
            ) => single_point.exchange_memory(other),
            (Engine::FactorGraph(window), Engine::FactorGraph(other)) => {
                window.exchange_memory(other);
            }
            (Engine::KalmanFilter(filter), Engine::KalmanFilter(other)) => {
                filter.exchange_memory(other);
            }
            (Engine::Relative(window), Engine::Relative(other)) => window.exchange_memory(other),
            (Engine::RelativeFilter(filter), Engine::RelativeFilter(other)) => {
                filter.exchange_memory(other);
            }
            _ => {}
        }
    }
}

impl Estimator {
    /// Gives back the room that the state of an estimator at rest does not need.
    pub fn release_surplus(&mut self) {
        if let Engine::FactorGraph(window) = &mut self.engine {
            window.release_surplus();
        }
    }
}

impl Engine {
    fn save(&self, writer: &mut SnapshotWriter) {
        match self {
            Self::SinglePoint { start, single_point: _ } => {
                writer.u8(0);
                start.save(writer);
            }
            Self::KalmanFilter(filter) => {
                writer.u8(2);
                filter.save(writer);
            }
            Self::FactorGraph(window) => {
                writer.u8(1);
                window.save(writer);
            }
            Self::Relative(window) => {
                writer.u8(3);
                window.save(writer);
            }
            Self::RelativeFilter(filter) => {
                writer.u8(4);
                filter.save(writer);
            }
        }
    }

    fn load(
        options: &PositioningOptions,
        reader: &mut SnapshotReader<'_>,
    ) -> Result<Self, SnapshotError> {
        match (reader.u8()?, options.mode) {
            (0, Mode::Spp) => Ok(Self::SinglePoint {
                start: Snapshot::load(reader)?,
                single_point: Box::new(SinglePoint::new(options)),
            }),
            (1, Mode::Fgo) => {
                SlidingWindow::load(options, reader).map(Box::new).map(Self::FactorGraph)
            }
            (2, Mode::Ekf) => {
                KalmanFilter::load(options, reader).map(Box::new).map(Self::KalmanFilter)
            }
            (3, Mode::RtkFgo) => RtkWindow::load(options, reader).map(Box::new).map(Self::Relative),
            (4, Mode::RtkEkf) => {
                RtkFilter::load(options, reader).map(Box::new).map(Self::RelativeFilter)
            }
            _ => Err(reader.invalid("mode")),
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
            Engine::RelativeFilter(filter) => Engine::RelativeFilter(filter.clone()),
        };
        Self { options: Arc::clone(&self.options), engine }
    }

    /// Copies into the storage already held, where both are of one mode.
    fn clone_from(&mut self, source: &Self) {
        match (&mut self.engine, &source.engine) {
            (
                Engine::SinglePoint { start, single_point },
                Engine::SinglePoint { start: from, single_point: other },
            ) => {
                *start = *from;
                single_point.answer_like(other);
            }
            (Engine::KalmanFilter(filter), Engine::KalmanFilter(from)) => {
                (**filter).clone_from(from);
            }
            (Engine::FactorGraph(window), Engine::FactorGraph(from)) => {
                (**window).clone_from(from);
            }
            (Engine::Relative(window), Engine::Relative(from)) => (**window).clone_from(from),
            (Engine::RelativeFilter(filter), Engine::RelativeFilter(from)) => {
                (**filter).clone_from(from);
            }
            (engine, _) => *engine = source.clone().engine,
        }
        self.options = Arc::clone(&source.options);
    }
}

/// Smooths all epochs of a recording at once, in modes with a window.
#[derive(Debug)]
pub struct Batch {
    options: PositioningOptions,
    chain: Whole,
}

#[derive(Debug)]
enum Whole {
    Alone(Box<WholeChain>),
    Relative(Box<RtkWindow>),
}

impl Batch {
    /// A batch without epochs yet.
    pub fn new(options: PositioningOptions) -> Self {
        let chain = match options.mode.is_relative() {
            true => Whole::Relative(Box::new(RtkWindow::new(&options, Revises::AtTheEnd))),
            false => Whole::Alone(Box::new(WholeChain::new(&options))),
        };
        Self { options, chain }
    }

    /// Takes one epoch.
    pub fn push(&mut self, epoch: &Epoch, aiding: &Aiding<'_>) {
        let (options, navigation) = (&self.options, aiding.navigation);
        match &mut self.chain {
            Whole::Alone(chain) => chain.push(epoch, navigation, options),
            Whole::Relative(window) => {
                window.advance(epoch, navigation, aiding.base.as_ref(), options);
            }
        }
    }

    /// Solves everything; one solution for each epoch, in order of time.
    pub fn finish(self) -> Vec<Solution> {
        match self.chain {
            Whole::Alone(mut chain) => chain.finish(),
            Whole::Relative(mut window) => window.finish(&self.options),
        }
    }
}
