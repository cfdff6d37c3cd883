//! The estimators that sessions and the command line run.

use std::sync::Arc;

use crate::config::{Mode, PositioningOptions};
use crate::gnss::{Epoch, GpsTime, Solution};
use crate::snapshot::{Snapshot, SnapshotError, SnapshotReader, SnapshotWriter, clone_fields};

use super::aiding::Aiding;
use super::ekf::KalmanFilter;
use super::engine::{Engine, EpochInputs};
use super::fgo::{SlidingWindow, WholeChain};
use super::integrity::complete;
use super::rtk::{RtkFilter, RtkWindow};
use super::setup::Setup;
use super::spp::SinglePoints;

/// Layout of the snapshots: raised whenever what is in them changes.
const LAYOUT: u16 = 12;

/// Writes the state of any mode and the memory of all of them, from one table: the mode's number in
/// snapshots, its name, its engine, and where its memory is.
macro_rules! modes {
    ($($number:literal => $mode:ident($engine:ty), $scratch:ident;)*) => {
        /// The state of one mode.
        #[derive(Debug)]
        enum ModeState {
            $($mode(Box<$engine>),)*
        }

        /// Memory that an estimator of any mode computes in; no answer depends on what is in it.
        #[derive(Debug, Default)]
        pub struct Scratch {
            $($scratch: <$engine as Engine>::Scratch,)*
        }

        impl ModeState {
            fn new(setup: &Setup, revises: bool) -> Self {
                match setup.options.mode {
                    $(Mode::$mode => Self::$mode(Box::new(<$engine>::new(setup, revises))),)*
                }
            }

            fn fits(&self, setup: &Setup) -> bool {
                match (self, setup.options.mode) {
                    $((Self::$mode(state), Mode::$mode) => state.fits(setup),)*
                    _ => false,
                }
            }

            fn advance(
                &mut self,
                inputs: &EpochInputs<'_>,
                scratch: &mut Scratch,
                revisions: &mut Vec<Solution>,
            ) -> Solution {
                match self {
                    $(Self::$mode(state) => {
                        state.advance(inputs, &mut scratch.$scratch, revisions)
                    })*
                }
            }

            fn finish(
                &mut self,
                setup: &Setup,
                scratch: &mut Scratch,
                revisions: &mut Vec<Solution>,
            ) {
                match self {
                    $(Self::$mode(state) => {
                        state.finish(setup, &mut scratch.$scratch, revisions);
                    })*
                }
            }

            fn oldest_unrevised(&self) -> Option<GpsTime> {
                match self {
                    $(Self::$mode(state) => state.oldest_unrevised(),)*
                }
            }
        }

        impl Snapshot for ModeState {
            fn save(&self, writer: &mut SnapshotWriter) {
                match self {
                    $(Self::$mode(state) => {
                        writer.u8($number);
                        state.save(writer);
                    })*
                }
            }

            fn load(reader: &mut SnapshotReader<'_>) -> Result<Self, SnapshotError> {
                match reader.u8()? {
                    $($number => Snapshot::load(reader).map(Self::$mode),)*
                    _ => Err(reader.invalid("mode")),
                }
            }
        }

        impl Clone for ModeState {
            fn clone(&self) -> Self {
                match self {
                    $(Self::$mode(state) => Self::$mode(state.clone()),)*
                }
            }

            /// Copies into the storage already held, where both are of one mode.
            fn clone_from(&mut self, source: &Self) {
                match (self, source) {
                    $((Self::$mode(state), Self::$mode(from)) => state.clone_from(from),)*
                    (state, _) => *state = source.clone(),
                }
            }
        }
    };
}

modes! {
    0 => Spp(SinglePoints), single_point;
    1 => Fgo(SlidingWindow), window;
    2 => Ekf(KalmanFilter), filter;
    3 => RtkFgo(RtkWindow), rtk_window;
    4 => RtkEkf(RtkFilter), rtk_filter;
}

/// The state of an estimator, apart from the memory it computes in: plain data, of which copies and
/// snapshots go on with the same bits.
///
/// In mode `spp` it is the last position, from which the next epoch is solved: this saves
/// iterations and moves the answer by less than 0.1 mm. In mode `fgo` it is a window of epochs; in
/// mode `ekf` a mean with its covariance and the last epoch's carrier phases. The `rtk` modes add
/// the ambiguities against the base.
#[derive(Debug)]
pub struct EstimatorState {
    setup: Arc<Setup>,
    mode: ModeState,
    /// Later answers not yet taken.
    revisions: Vec<Solution>,
}

clone_fields!(EstimatorState { setup, mode, revisions });

impl EstimatorState {
    /// The state before the first epoch; with `revises`, a mode with a window answers epochs again
    /// as they leave it.
    pub fn new(options: PositioningOptions, revises: bool) -> Self {
        let setup = Setup::new(options);
        let mode = ModeState::new(&setup, revises);
        Self { setup: Arc::new(setup), mode, revisions: Vec::new() }
    }

    /// The state with these options before the first epoch again.
    pub fn renewed(&self, revises: bool) -> Self {
        let mode = ModeState::new(&self.setup, revises);
        Self { setup: Arc::clone(&self.setup), mode, revisions: Vec::new() }
    }

    /// The options it was made with.
    pub fn options(&self) -> &PositioningOptions {
        &self.setup.options
    }

    /// Solves one epoch. No position is an answer too, with its reasons.
    pub fn advance(
        &mut self,
        epoch: &Epoch,
        aiding: &Aiding<'_>,
        scratch: &mut Scratch,
    ) -> Solution {
        let Aiding { navigation, base } = *aiding;
        let inputs = EpochInputs { epoch, navigation, base, setup: &self.setup };
        let due = self.revisions.len();
        let mut solution = self.mode.advance(&inputs, scratch, &mut self.revisions);
        let integrity = &self.setup.options.integrity;
        self.revisions[due..].iter_mut().for_each(|revision| complete(revision, integrity));
        complete(&mut solution, integrity);
        solution
    }

    /// Answers of the epochs that have left the window since the last call, smoothed by what came
    /// after them. None unless it revises.
    pub fn take_revisions(&mut self) -> Vec<Solution> {
        std::mem::take(&mut self.revisions)
    }

    /// The revisions not yet taken, and those of the epochs still in the window.
    pub fn finish(mut self, scratch: &mut Scratch) -> Vec<Solution> {
        let due = self.revisions.len();
        self.mode.finish(&self.setup, scratch, &mut self.revisions);
        let integrity = &self.setup.options.integrity;
        self.revisions[due..].iter_mut().for_each(|revision| complete(revision, integrity));
        self.revisions
    }

    /// Time of the oldest epoch that [`Self::take_revisions`] may still answer again.
    pub fn oldest_unrevised(&self) -> Option<GpsTime> {
        self.mode.oldest_unrevised()
    }

    /// The state as bytes: what the next answers depend on, options and navigation data apart.
    /// Revisions not yet taken are no part of it: take them first.
    pub fn snapshot(&self) -> Vec<u8> {
        let mut writer = SnapshotWriter::new(LAYOUT);
        self.mode.save(&mut writer);
        writer.finish()
    }

    /// The state that goes on where [`Self::snapshot`] was taken, with the same bits. `options`
    /// must be those of the state it was taken of.
    ///
    /// # Errors
    /// The bytes are not such a snapshot, or of another layout.
    pub fn restore(options: PositioningOptions, snapshot: &[u8]) -> Result<Self, SnapshotError> {
        let setup = Arc::new(Setup::new(options));
        let mut reader = SnapshotReader::open(snapshot, LAYOUT)?;
        let mode = ModeState::load(&mut reader)?;
        if !mode.fits(&setup) {
            return Err(reader.invalid("mode"));
        }
        reader.finish()?;
        Ok(Self { setup, mode, revisions: Vec::new() })
    }
}

/// Turns epochs into solutions, one at a time: a state with memory of its own.
///
/// # Example
/// Half a minute of a simulated receiver; each answer is within 10 m of the truth:
///
/// ```
/// use graphfix::config::{Mode, PositioningOptions, Profile};
/// use graphfix::positioning::{Aiding, Estimator};
/// use graphfix::simulation::{Scenario, Simulator};
///
/// let receiver = Simulator::new(Scenario { duration_s: 30.0, ..Scenario::open_sky() }, 1);
/// let navigation = receiver.navigation().clone();
/// let mut estimator = Estimator::new(PositioningOptions::new(Mode::Fgo, Profile::General));
/// for truth in receiver {
///     let solution = estimator.advance(&truth.rover, &Aiding::alone(&navigation));
///     let estimate = solution.estimate.expect("the sky is open");
///     assert!(estimate.position.distance_m(truth.position) < 10.0);
/// }
/// ```
#[derive(Debug)]
pub struct Estimator {
    state: EstimatorState,
    scratch: Box<Scratch>,
}

impl Estimator {
    /// An estimator that has seen nothing yet.
    pub fn new(options: PositioningOptions) -> Self {
        Self::of(EstimatorState::new(options, false))
    }

    /// One that, in a mode with a window, answers epochs again as they leave it.
    pub fn revising(options: PositioningOptions) -> Self {
        Self::of(EstimatorState::new(options, true))
    }

    fn of(state: EstimatorState) -> Self {
        Self { state, scratch: Box::default() }
    }

    /// See [`EstimatorState::advance`].
    pub fn advance(&mut self, epoch: &Epoch, aiding: &Aiding<'_>) -> Solution {
        self.state.advance(epoch, aiding, &mut self.scratch)
    }

    /// See [`EstimatorState::take_revisions`].
    pub fn take_revisions(&mut self) -> Vec<Solution> {
        self.state.take_revisions()
    }

    /// See [`EstimatorState::finish`].
    pub fn finish(mut self) -> Vec<Solution> {
        self.state.finish(&mut self.scratch)
    }

    /// See [`EstimatorState::oldest_unrevised`].
    pub fn oldest_unrevised(&self) -> Option<GpsTime> {
        self.state.oldest_unrevised()
    }

    /// See [`EstimatorState::snapshot`].
    pub fn snapshot(&self) -> Vec<u8> {
        self.state.snapshot()
    }

    /// See [`EstimatorState::restore`].
    ///
    /// # Errors
    /// The bytes are not such a snapshot, or of another layout.
    pub fn restore(options: PositioningOptions, snapshot: &[u8]) -> Result<Self, SnapshotError> {
        EstimatorState::restore(options, snapshot).map(Self::of)
    }
}

/// Copies the state; each has memory of its own.
impl Clone for Estimator {
    fn clone(&self) -> Self {
        Self::of(self.state.clone())
    }
}

/// Smooths all epochs of a recording at once, in modes with a window.
///
/// # Example
/// A rover relative to a base 8 km away; the last epoch is fixed:
///
/// ```
/// use graphfix::config::{Mode, PositioningOptions, Profile};
/// use graphfix::gnss::{BaseStation, Status};
/// use graphfix::positioning::{Aiding, BaseAiding, Batch};
/// use graphfix::simulation::{Scenario, Simulator};
///
/// let receivers = Simulator::new(Scenario { duration_s: 60.0, ..Scenario::rtk_open() }, 1);
/// let navigation = receivers.navigation().clone();
/// let station = BaseStation {
///     name: "base".into(),
///     antenna_reference_point: receivers.base_position().expect("the scenario has a base"),
/// };
/// let mut batch = Batch::new(PositioningOptions::new(Mode::RtkFgo, Profile::General));
/// for truth in receivers {
///     let epochs = truth.base.as_slice();
///     let base = Some(BaseAiding { station: &station, epochs });
///     batch.push(&truth.rover, &Aiding { navigation: &navigation, base });
/// }
/// let solutions = batch.finish();
/// assert_eq!(solutions.last().map(|solution| solution.status), Some(Status::Fixed));
/// ```
#[derive(Debug)]
pub struct Batch {
    setup: Setup,
    chain: Whole,
    /// Answers of chains that have ended.
    solutions: Vec<Solution>,
}

#[derive(Debug)]
enum Whole {
    Alone(Box<WholeChain>),
    Relative(Box<(RtkWindow, <RtkWindow as Engine>::Scratch)>),
}

impl Batch {
    /// A batch without epochs yet.
    pub fn new(options: PositioningOptions) -> Self {
        let setup = Setup::batch(options);
        let chain = match setup.options.mode.is_relative() {
            true => Whole::Relative(Box::new((RtkWindow::new(&setup, true), Default::default()))),
            false => Whole::Alone(Box::new(WholeChain::new(&setup))),
        };
        Self { setup, chain, solutions: Vec::new() }
    }

    /// Takes one epoch.
    pub fn push(&mut self, epoch: &Epoch, aiding: &Aiding<'_>) {
        let Aiding { navigation, base } = *aiding;
        let inputs = EpochInputs { epoch, navigation, base, setup: &self.setup };
        match &mut self.chain {
            Whole::Alone(chain) => chain.push(&inputs),
            Whole::Relative(relative) => {
                let (window, scratch) = &mut **relative;
                window.advance(&inputs, scratch, &mut self.solutions);
            }
        }
    }

    /// Solves everything; one solution for each epoch, in order of time.
    pub fn finish(self) -> Vec<Solution> {
        let mut solutions = match self.chain {
            Whole::Alone(chain) => chain.finish(&self.setup),
            Whole::Relative(relative) => {
                let (mut window, mut scratch) = *relative;
                let mut solutions = self.solutions;
                window.finish(&self.setup, &mut scratch, &mut solutions);
                solutions
            }
        };
        let integrity = &self.setup.options.integrity;
        solutions.iter_mut().for_each(|solution| complete(solution, integrity));
        solutions
    }
}
