//! The estimators that sessions and the command line run.

use std::ops::Deref;
use std::sync::Arc;

use crate::config::{Mode, PositioningOptions};
use crate::gnss::{Epoch, GpsTime, Solution};
use crate::snapshot::{Snapshot, SnapshotError, SnapshotReader, SnapshotWriter, clone_fields};

use super::aiding::Aiding;
use super::ekf::KalmanFilter;
use super::engine::{Engine, EpochInputs};
use super::fgo::{SlidingWindow, WholeChain};
use super::integrity::{complete, complete_all};
use super::measurements::ReceiverBands;
use super::rtk::{RtkFilter, RtkPaper, RtkWindow};
use super::setup::Setup;
use super::spp::SinglePoints;

/// Layout of the snapshots. Raise it when their content changes.
const LAYOUT: u16 = 26;

/// Defines the state and the scratch of all modes from one table: the mode's number in snapshots,
/// its name, its engine, and its field in the scratch.
macro_rules! modes {
    ($($number:literal => $mode:ident($engine:ty), $scratch:ident;)*) => {
        /// The state of one mode.
        #[derive(Debug)]
        enum ModeState {
            $($mode(Box<$engine>),)*
        }

        /// Scratch for an estimator of any mode. No answer depends on its content.
        #[derive(Debug, Default)]
        pub struct Scratch {
            $($scratch: <$engine as Engine>::Scratch,)*
        }

        impl ModeState {
            fn new(setup: &Setup, revises: bool) -> Self {
                match Kind::of(&setup.options) {
                    $(Kind::$mode => Self::$mode(Box::new(<$engine>::new(setup, revises))),)*
                }
            }

            fn fits(&self, setup: &Setup) -> bool {
                match (self, Kind::of(&setup.options)) {
                    $((Self::$mode(state), Kind::$mode) => state.fits(setup),)*
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

            /// Reuses the storage of `self` if both are of one mode.
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
    5 => RtkPaper(RtkPaper), rtk_paper;
}

/// An estimator: that of a mode, or the published one of mode `rtk-fgo`.
#[derive(Clone, Copy, Debug)]
enum Kind {
    Spp,
    Fgo,
    Ekf,
    RtkFgo,
    RtkEkf,
    RtkPaper,
}

impl Kind {
    const fn of(options: &PositioningOptions) -> Self {
        match options.mode {
            Mode::Spp => Self::Spp,
            Mode::Fgo => Self::Fgo,
            Mode::Ekf => Self::Ekf,
            Mode::RtkFgo if options.graph.motion => Self::RtkFgo,
            // Without motion the Doppler velocity alone links the epochs.
            Mode::RtkFgo => Self::RtkPaper,
            Mode::RtkEkf => Self::RtkEkf,
        }
    }
}

/// Options with the tests and models that follow from them. To compute these takes as long as an
/// epoch. Clones share them.
#[derive(Clone, Debug)]
pub struct PreparedOptions(Arc<Setup>);

impl PreparedOptions {
    /// Prepares options.
    pub fn new(options: PositioningOptions) -> Self {
        Self(Arc::new(Setup::new(options)))
    }
}

impl Deref for PreparedOptions {
    type Target = PositioningOptions;

    fn deref(&self) -> &PositioningOptions {
        &self.0.options
    }
}

/// The state of an estimator, separate from its scratch. It is plain data: copies and snapshots
/// continue with the same bits.
///
/// In mode `spp` it is the last position, where the next solution starts; this saves iterations and
/// changes the answer by less than 0.1 mm. In mode `fgo` it is a window of epochs, and in mode
/// `ekf` a mean with its covariance and the last epoch's carrier phases. The `rtk` modes add the
/// ambiguities against the base.
#[derive(Debug)]
pub struct EstimatorState {
    setup: Arc<Setup>,
    mode: ModeState,
    bands: ReceiverBands,
    /// Revisions that have not been taken yet.
    revisions: Vec<Solution>,
}

clone_fields!(EstimatorState { setup, mode, bands, revisions });

impl EstimatorState {
    /// The state before the first epoch. With `revises`, a mode with a window revises epochs when
    /// they leave it.
    pub fn new(options: PositioningOptions, revises: bool) -> Self {
        Self::prepared(&PreparedOptions::new(options), revises)
    }

    /// The same with prepared options.
    pub fn prepared(options: &PreparedOptions, revises: bool) -> Self {
        let setup = options.0.clone();
        let mode = ModeState::new(&setup, revises);
        Self { setup, mode, bands: ReceiverBands::default(), revisions: Vec::new() }
    }

    /// A new state with the same options, before the first epoch.
    pub fn renewed(&self, revises: bool) -> Self {
        let mode = ModeState::new(&self.setup, revises);
        let (setup, bands) = (Arc::clone(&self.setup), ReceiverBands::default());
        Self { setup, mode, bands, revisions: Vec::new() }
    }

    /// Solves one epoch. A solution without a position states the reasons.
    pub fn advance(
        &mut self,
        epoch: &Epoch,
        aiding: &Aiding<'_>,
        scratch: &mut Scratch,
    ) -> Solution {
        let Aiding { navigation, base } = *aiding;
        self.bands.learn(epoch);
        let (setup, bands) = (&*self.setup, self.bands);
        let inputs = EpochInputs { epoch, navigation, base, corrected: None, setup, bands };
        let due = self.revisions.len();
        let mut solution = self.mode.advance(&inputs, scratch, &mut self.revisions);
        let integrity = &self.setup.options.integrity;
        complete_all(&mut self.revisions[due..], integrity);
        complete(&mut solution, integrity);
        solution
    }

    /// The revisions of the epochs that have left the window since the last call, smoothed by later
    /// epochs. Empty unless the state was made with `revises`.
    pub fn take_revisions(&mut self) -> Vec<Solution> {
        std::mem::take(&mut self.revisions)
    }

    /// The revisions not yet taken, and those of the epochs still in the window.
    pub fn finish(mut self, scratch: &mut Scratch) -> Vec<Solution> {
        let due = self.revisions.len();
        self.mode.finish(&self.setup, scratch, &mut self.revisions);
        complete_all(&mut self.revisions[due..], &self.setup.options.integrity);
        self.revisions
    }

    /// Time of the oldest epoch that [`Self::take_revisions`] may still revise.
    pub fn oldest_unrevised(&self) -> Option<GpsTime> {
        self.mode.oldest_unrevised()
    }

    /// The state as bytes. They contain all that the next answers depend on, except options and
    /// navigation data. Take the revisions first: the bytes do not contain them.
    pub fn snapshot(&self) -> Vec<u8> {
        let mut writer = SnapshotWriter::new(LAYOUT);
        self.write(&mut writer);
        writer.finish()
    }

    /// The state that [`Self::snapshot`] stored; it continues with the same bits. `options` must be
    /// the same as those of the stored state.
    ///
    /// # Errors
    /// The bytes are not such a snapshot, or have another layout.
    pub fn restore(options: PositioningOptions, snapshot: &[u8]) -> Result<Self, SnapshotError> {
        Self::opened(&PreparedOptions::new(options), snapshot)
    }

    fn opened(options: &PreparedOptions, snapshot: &[u8]) -> Result<Self, SnapshotError> {
        let mut reader = SnapshotReader::open(snapshot, LAYOUT)?;
        let state = Self::read(options, &mut reader)?;
        reader.finish()?;
        Ok(state)
    }

    /// The same as [`Self::snapshot`], as a part of another snapshot. Only the whole has a hash.
    pub fn save_in(&self, writer: &mut SnapshotWriter) {
        LAYOUT.save(writer);
        self.write(writer);
    }

    fn write(&self, writer: &mut SnapshotWriter) {
        self.bands.save(writer);
        self.mode.save(writer);
    }

    /// The state that [`Self::save_in`] stored, with the same options.
    ///
    /// # Errors
    /// The bytes are not such a part, or have another layout.
    pub fn load_in(
        options: &PreparedOptions,
        reader: &mut SnapshotReader<'_>,
    ) -> Result<Self, SnapshotError> {
        match u16::load(reader)? {
            LAYOUT => Self::read(options, reader),
            found => Err(SnapshotError::UnknownLayout { found, known: LAYOUT }),
        }
    }

    fn read(
        options: &PreparedOptions,
        reader: &mut SnapshotReader<'_>,
    ) -> Result<Self, SnapshotError> {
        let setup = options.0.clone();
        let bands = ReceiverBands::load(reader)?;
        let mode = ModeState::load(reader)?;
        if !mode.fits(&setup) {
            return Err(reader.invalid("mode"));
        }
        Ok(Self { setup, mode, bands, revisions: Vec::new() })
    }
}

/// Turns epochs into solutions, one at a time: a state with its own scratch.
///
/// # Example
/// Half a minute of a simulated receiver; each answer is within 10 m of the truth:
///
/// ```
/// use graphfix_compute::config::{Mode, PositioningOptions, Profile};
/// use graphfix_compute::positioning::{Aiding, Estimator};
/// use graphfix_compute::simulation::{Scenario, Simulator};
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
    /// An estimator before its first epoch.
    pub fn new(options: PositioningOptions) -> Self {
        Self::of(EstimatorState::new(options, false))
    }

    /// An estimator that, in a mode with a window, revises epochs when they leave it.
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
    /// The bytes are not such a snapshot, or have another layout.
    pub fn restore(options: PositioningOptions, snapshot: &[u8]) -> Result<Self, SnapshotError> {
        EstimatorState::restore(options, snapshot).map(Self::of)
    }

    /// The same with the options of this estimator.
    ///
    /// # Errors
    /// The bytes are not such a snapshot, or have another layout.
    pub fn restored(&self, snapshot: &[u8]) -> Result<Self, SnapshotError> {
        EstimatorState::opened(&PreparedOptions(self.state.setup.clone()), snapshot).map(Self::of)
    }
}

/// Copies the state; the copy has its own scratch.
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
/// use graphfix_compute::config::{Mode, PositioningOptions, Profile};
/// use graphfix_compute::gnss::{BaseStation, Status};
/// use graphfix_compute::positioning::{Aiding, BaseAiding, Batch};
/// use graphfix_compute::simulation::{Scenario, Simulator};
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
    bands: ReceiverBands,
    /// Solutions of chains that have ended.
    solutions: Vec<Solution>,
}

#[derive(Debug)]
enum Whole {
    Alone(Box<WholeChain>),
    Relative(Box<(ModeState, Scratch)>),
}

impl Batch {
    /// A batch without epochs yet.
    pub fn new(options: PositioningOptions) -> Self {
        let setup = Setup::batch(options);
        let relative = |state| Whole::Relative(Box::new((state, Scratch::default())));
        let chain = match Kind::of(&setup.options) {
            Kind::Spp | Kind::Fgo | Kind::Ekf => Whole::Alone(Box::new(WholeChain::new(&setup))),
            Kind::RtkFgo | Kind::RtkEkf => {
                relative(ModeState::RtkFgo(Box::new(RtkWindow::new(&setup, true))))
            }
            Kind::RtkPaper => relative(ModeState::RtkPaper(Box::new(RtkPaper::new(&setup, true)))),
        };
        Self { setup, chain, bands: ReceiverBands::default(), solutions: Vec::new() }
    }

    /// Takes one epoch.
    pub fn push(&mut self, epoch: &Epoch, aiding: &Aiding<'_>) {
        let Aiding { navigation, base } = *aiding;
        self.bands.learn(epoch);
        let (setup, bands) = (&self.setup, self.bands);
        let inputs = EpochInputs { epoch, navigation, base, corrected: None, setup, bands };
        match &mut self.chain {
            Whole::Alone(chain) => chain.push(&inputs),
            Whole::Relative(relative) => {
                let (state, scratch) = &mut **relative;
                state.advance(&inputs, scratch, &mut self.solutions);
            }
        }
    }

    /// Solves everything; one solution for each epoch, in order of time.
    pub fn finish(self) -> Vec<Solution> {
        let mut solutions = match self.chain {
            Whole::Alone(chain) => chain.finish(&self.setup),
            Whole::Relative(relative) => {
                let (mut state, mut scratch) = *relative;
                let mut solutions = self.solutions;
                state.finish(&self.setup, &mut scratch, &mut solutions);
                solutions
            }
        };
        complete_all(&mut solutions, &self.setup.options.integrity);
        solutions
    }
}
