//! The sliding window on differences against a base: each epoch answered as it comes, and again.

use std::ops::Range;

use nalgebra::Matrix3;

use crate::config::PositioningOptions;
use crate::gnss::{Ecef, Epoch, GpsTime, Navigation, Reason, Solution};
use crate::graph::{BorderLife, Covariances, Elimination, Smoother, System, Workspace};
use crate::positioning::base::BaseAiding;
use crate::positioning::fgo::SlidingWindow;
use crate::snapshot::{Snapshot, SnapshotError, SnapshotReader, SnapshotWriter};

use super::answer::{Findings, solution};
use super::chain::Chain;
use super::epoch::{STATE, State};
use super::float::FloatSolution;
use super::front::{Front, UsableBase};
use super::history::{History, Revises, Window};
use super::integers::Integers;
use super::settings::Settings;
use super::tracking::Tracking;

/// Distance from the frame's origin at which the graph starts anew (m): up has turned by 1°.
pub(super) const FRAME_LIMIT_M: f64 = 1e5;
/// Times that slips are looked for in one epoch.
pub(super) const SLIP_ROUNDS: usize = 3;

/// An estimator over a sliding window of differences.
#[derive(Debug)]
pub(in crate::positioning) struct RtkWindow {
    settings: Settings,
    chain: Chain,
    front: Front,
    /// Answers while there is no base to use.
    stand_in: Option<Box<SlidingWindow>>,
    revises: Revises,
    /// Of the epochs to be answered again, if any are.
    history: Option<History>,
    revisions: Vec<Solution>,
    integers: Integers,
    workspace: Workspace<STATE>,
    covariances: Covariances<STATE>,
    smoother: Smoother<STATE>,
    oldest: (System<STATE>, Elimination<STATE>),
}

impl RtkWindow {
    /// One that has seen nothing.
    pub(in crate::positioning) fn new(options: &PositioningOptions, revises: Revises) -> Self {
        Self {
            settings: Settings::new(options),
            chain: Chain::new(),
            front: Front::new(options),
            stand_in: None,
            revises,
            history: (revises != Revises::Never).then(History::default),
            revisions: Vec::new(),
            integers: Integers::new(),
            workspace: Workspace::new(BorderLife::WholeChain),
            covariances: Covariances::new(),
            smoother: Smoother::new(),
            oldest: (System::new(BorderLife::WholeChain), Elimination::new()),
        }
    }

    /// Answers one epoch.
    ///
    /// An epoch that is not after the last one is answered by itself and changes nothing. Without a
    /// base that can be used the answer is that of a window without one, with the reason; what is
    /// known of the ambiguities stays for the base's return. With another base the window begins
    /// anew.
    pub(in crate::positioning) fn advance(
        &mut self,
        epoch: &Epoch,
        navigation: &Navigation,
        base: Option<&BaseAiding<'_>>,
        options: &PositioningOptions,
    ) -> Solution {
        if self.front.changes_base(epoch.time, base) {
            self.revise(self.history.as_ref().map_or(0..0, History::all), options);
            self.leave_all();
            self.chain.clear();
            self.chain.tracking = Tracking::new();
        }
        let arcs = &mut self.chain.tracking.arcs;
        if let Some(alone) = self.front.receive(epoch, navigation, base, arcs, options) {
            return alone;
        }
        let solution = match self.relative(epoch, navigation, base, options) {
            Ok(solution) => {
                self.stand_in = None;
                if let Some(history) = &mut self.history {
                    history.push(solution.clone(), &self.chain.tracking, &options.rtk);
                }
                solution
            }
            Err(reason) => {
                let stand_in = self
                    .stand_in
                    .get_or_insert_with(|| Box::new(SlidingWindow::new(options, false)));
                let mut solution = stand_in.advance(epoch, navigation, options);
                solution.reasons.extend(self.front.reasons_alone(reason));
                if let Some(history) = &mut self.history {
                    history.push_alone(solution.clone());
                }
                solution
            }
        };
        if let Some(history) = &self.history {
            let due = history.due(epoch.time, &options.graph);
            self.revise(due.clone(), options);
            if self.revises == Revises::WhenTheyLeave {
                self.leave(due.end);
            }
        }
        solution
    }

    /// Answers some epochs again, where the window can be gone back from.
    fn revise(&mut self, epochs: Range<usize>, options: &PositioningOptions) {
        let Self { history, chain, settings, workspace, smoother, integers, .. } = self;
        let Some(history) = history else { return };
        if history.has_graph(epochs.clone()) && chain.factor(settings, workspace).is_ok() {
            let Chain { estimate, frame, .. } = &*chain;
            let (elimination, resolver) = (&workspace.elimination, &mut integers.resolver);
            let window = Window { elimination, estimate, frame, smoother, resolver };
            history.revise(epochs, window, &options.rtk);
        }
    }

    /// Answers the oldest epochs for good.
    fn leave(&mut self, count: usize) {
        let history = self.history.as_mut().filter(|_| 0 < count);
        self.revisions.extend(history.map(|history| history.leave(count)).unwrap_or_default());
    }

    /// Answers all epochs for good: nothing of the chain will be gone back to.
    fn leave_all(&mut self) {
        self.leave(self.history.as_ref().map_or(0, |history| history.all().end));
        self.history = (self.revises != Revises::Never).then(History::default);
    }

    /// Revises every epoch not yet revised; returns all revisions not yet taken.
    pub(in crate::positioning) fn finish(&mut self, options: &PositioningOptions) -> Vec<Solution> {
        self.revise(self.history.as_ref().map_or(0..0, History::all), options);
        self.leave_all();
        self.take_revisions()
    }

    /// Answers of the epochs that have left the window since the last call.
    pub(in crate::positioning) fn take_revisions(&mut self) -> Vec<Solution> {
        std::mem::take(&mut self.revisions)
    }

    /// Time of the oldest epoch not yet revised.
    pub(in crate::positioning) fn oldest_time(&self) -> Option<GpsTime> {
        self.history.as_ref()?.oldest_time()
    }

    /// Begins the chain anew with its origin at `start`.
    fn begin(&mut self, start: Ecef, options: &PositioningOptions) {
        self.revise(self.history.as_ref().map_or(0..0, History::all), options);
        self.leave_all();
        self.chain.begin(start);
    }

    /// The answer relative to the base, or why there is none.
    fn relative(
        &mut self,
        epoch: &Epoch,
        navigation: &Navigation,
        base: Option<&BaseAiding<'_>>,
        options: &PositioningOptions,
    ) -> Result<Solution, Reason> {
        let base = self.front.usable_base(epoch.time, navigation, base, options)?;
        let guess = self.guess(epoch, navigation, options)?;
        let place = self.chain.place(&guess);
        let arcs = &mut self.chain.tracking.arcs;
        self.front.difference(epoch, place, base.station, navigation, arcs, options)?;
        let (settings, differences) = (&self.settings, &self.front.differences);
        self.chain.append(epoch.time, guess, differences, options, settings);
        if self.solve(options).is_none() {
            self.chain.clear();
            self.leave_all();
            return Err(Reason::NotConverged);
        }
        self.covariances.newest(&self.workspace.elimination);
        self.chain.learn_noise(&self.position_covariance());
        Ok(self.answer(base, options))
    }

    /// Where the rover is about now; the chain begins anew where it cannot tell.
    fn guess(
        &mut self,
        epoch: &Epoch,
        navigation: &Navigation,
        options: &PositioningOptions,
    ) -> Result<State, Reason> {
        if let Some(last) = self.chain.last_time() {
            let guess = self.chain.predicted(epoch.time);
            let is_near = guess.fixed_rows::<3>(0).norm() < FRAME_LIMIT_M;
            if options.rtk.single_epoch {
                self.begin(self.chain.place(&guess), options);
                return Ok(State::zeros());
            }
            if epoch.time - last <= options.graph.gap_s && is_near {
                return Ok(guess);
            }
        }
        let alone = self.front.single_point.solve(epoch, navigation, options, None);
        let estimate = alone.estimate.ok_or(Reason::NotConverged)?;
        self.begin(estimate.position, options);
        let mut guess = State::zeros();
        if let Some(velocity) = &estimate.velocity {
            let local = self.chain.frame.rotation * velocity.velocity_m_s;
            guess.fixed_rows_mut::<3>(3).copy_from(&local);
        }
        Ok(guess)
    }

    /// Forgets the epochs that leave and solves the window, slips cut out.
    fn solve(&mut self, options: &PositioningOptions) -> Option<()> {
        let Self { chain, settings, workspace, oldest, front, history, .. } = self;
        while options.rtk.window_epochs < chain.epochs.len() {
            chain.forget_oldest(settings, oldest, history.as_mut()).ok()?;
        }
        for _ in 0..SLIP_ROUNDS {
            chain.solve(settings, workspace).ok()?;
            if !chain.cut_slips(settings, &mut front.slipped) {
                break;
            }
        }
        Some(())
    }

    /// Of the newest position (m²).
    fn position_covariance(&self) -> Matrix3<f64> {
        self.covariances.state().fixed_view::<3, 3>(0, 0).into_owned()
    }

    fn answer(&mut self, base: UsableBase<'_>, options: &PositioningOptions) -> Solution {
        let covariance = self.position_covariance();
        let Chain { tracking, estimate, epochs, frame, .. } = &mut self.chain;
        let epoch = epochs.last().expect("a window that was solved has an epoch");
        let state = estimate.states.last().expect("one state for each epoch");
        let variables = self.covariances.variables().iter();
        let ambiguities = variables.map(|&variable| estimate.border[variable]).collect();
        let float = FloatSolution::of_graph(state, ambiguities, &self.covariances);
        let residuals = tracking.residuals(epochs, &estimate.states, &covariance);
        let resolution = tracking.resolve(
            &mut self.integers,
            epoch,
            &estimate.border,
            &float,
            &residuals,
            options,
        );
        let reasons = self.front.reasons(epoch.time, &tracking.arcs);
        let findings = Findings {
            frame,
            epoch,
            state,
            covariance: self.covariances.state(),
            differences: &self.front.differences,
            resolution,
            reasons,
            base,
            options: &options.rtk,
        };
        solution(findings)
    }
}

impl RtkWindow {
    /// Writes what the next answers depend on, all of which [`Clone`] copies; the settings follow
    /// from the options.
    pub(in crate::positioning) fn save(&self, writer: &mut SnapshotWriter) {
        self.chain.save(writer);
        self.front.save(writer);
        self.stand_in.is_some().save(writer);
        if let Some(stand_in) = &self.stand_in {
            stand_in.save(writer);
        }
        self.history.save(writer);
    }

    /// The window that was written, by the options it was made with.
    pub(in crate::positioning) fn load(
        options: &PositioningOptions,
        reader: &mut SnapshotReader<'_>,
    ) -> Result<Self, SnapshotError> {
        let fresh = Self::new(options, Revises::Never);
        let window = Self {
            chain: Snapshot::load(reader)?,
            front: Front::load(options, reader)?,
            stand_in: match bool::load(reader)? {
                true => Some(Box::new(SlidingWindow::load(options, reader)?)),
                false => None,
            },
            history: Snapshot::load(reader)?,
            ..fresh
        };
        let revises = match window.history {
            Some(_) => Revises::WhenTheyLeave,
            None => Revises::Never,
        };
        Ok(Self { revises, ..window })
    }

    /// Swaps the memory both work in.
    pub(in crate::positioning) fn exchange_memory(&mut self, other: &mut Self) {
        #[rustfmt::skip]
        let Self {
            settings: _, chain, front, stand_in, revises: _, history: _, revisions: _, integers,
            workspace, covariances, smoother, oldest,
        } = self;
        chain.exchange_memory(&mut other.chain);
        if let (Some(stand_in), Some(other)) = (stand_in, &mut other.stand_in) {
            stand_in.exchange_memory(other);
        }
        front.exchange_memory(&mut other.front);
        std::mem::swap(integers, &mut other.integers);
        std::mem::swap(workspace, &mut other.workspace);
        std::mem::swap(covariances, &mut other.covariances);
        std::mem::swap(smoother, &mut other.smoother);
        std::mem::swap(oldest, &mut other.oldest);
    }
}

/// Copies what the next answers depend on; scratch memory stays where it is.
impl Clone for RtkWindow {
    fn clone(&self) -> Self {
        Self {
            settings: self.settings.clone(),
            chain: self.chain.clone(),
            front: self.front.clone(),
            stand_in: self.stand_in.clone(),
            revises: self.revises,
            history: self.history.clone(),
            revisions: self.revisions.clone(),
            integers: Integers::new(),
            workspace: Workspace::new(BorderLife::WholeChain),
            covariances: Covariances::new(),
            smoother: Smoother::new(),
            oldest: (System::new(BorderLife::WholeChain), Elimination::new()),
        }
    }

    fn clone_from(&mut self, source: &Self) {
        self.settings.clone_from(&source.settings);
        self.chain.clone_from(&source.chain);
        self.front.clone_from(&source.front);
        self.stand_in.clone_from(&source.stand_in);
        self.revises = source.revises;
        self.history.clone_from(&source.history);
        self.revisions.clone_from(&source.revisions);
    }
}
