//! The sliding window on differences against a base: each epoch answered as it comes.

use crate::config::PositioningOptions;
use crate::gnss::{Ecef, Epoch, GpsTime, Navigation, Reason, SatelliteId, Solution};
use crate::graph::{BorderLife, Covariances, Elimination, System, Workspace};
use crate::positioning::base::BaseAiding;
use crate::positioning::differencing::{BaseSide, SingleDifferences};
use crate::positioning::fgo::SlidingWindow;
use crate::positioning::spp::SinglePoint;
use crate::snapshot::{Snapshot, SnapshotError, SnapshotReader, SnapshotWriter};

use super::answer::{Findings, solution};
use super::arcs::Arc;
use super::base::BaseMemory;
use super::chain::Chain;
use super::epoch::{STATE, State};
use super::integers::{Integers, drop_labels};
use super::settings::Settings;

/// Distance from the frame's origin at which the graph starts anew (m): up has turned by 1°.
const FRAME_LIMIT_M: f64 = 1e5;
/// Differences of tags within this of a limit are within the limit (s).
const TAG_SLACK_S: f64 = 1e-3;
/// A base whose stated position is off by more is doubted (m).
const DOUBTED_M: f64 = 10.0;
/// A base whose stated position is off by more is refused (m).
const REFUSED_M: f64 = 100.0;
/// A fixed position whose phases miss by more (rms, in standard deviations) is none.
const MISFIT_SIGMAS: f64 = 4.0;
/// Times that slips are looked for in one epoch.
const SLIP_ROUNDS: usize = 3;

/// A causal estimator over a sliding window of differences.
#[derive(Debug)]
pub(in crate::positioning) struct RtkWindow {
    settings: Settings,
    chain: Chain,
    base: BaseMemory,
    /// Time of the newest epoch answered.
    last: Option<GpsTime>,
    /// Answers while there is no base to use.
    stand_in: Option<Box<SlidingWindow>>,
    single_point: SinglePoint,
    differences: SingleDifferences,
    integers: Integers,
    slipped: Vec<SatelliteId>,
    workspace: Workspace<STATE>,
    covariances: Covariances<STATE>,
    oldest: (System<STATE>, Elimination<STATE>),
}

impl RtkWindow {
    /// One that has seen nothing.
    pub(in crate::positioning) fn new(options: &PositioningOptions) -> Self {
        Self {
            settings: Settings::new(options),
            chain: Chain::new(),
            base: BaseMemory::new(),
            last: None,
            stand_in: None,
            single_point: SinglePoint::new(options),
            differences: SingleDifferences::default(),
            integers: Integers::new(),
            slipped: Vec::new(),
            workspace: Workspace::new(BorderLife::WholeChain),
            covariances: Covariances::new(),
            oldest: (System::new(BorderLife::WholeChain), Elimination::new()),
        }
    }

    /// Answers one epoch.
    ///
    /// An epoch that is not after the last one is answered by itself and changes nothing. Without a
    /// base that can be used the answer is that of a window without one, with the reason; what is
    /// known of the ambiguities stays for the base's return.
    pub(in crate::positioning) fn advance(
        &mut self,
        epoch: &Epoch,
        navigation: &Navigation,
        base: Option<&BaseAiding<'_>>,
        options: &PositioningOptions,
    ) -> Solution {
        if self.last.is_some_and(|last| epoch.time <= last) {
            return self.single_point.solve(epoch, navigation, options, None);
        }
        self.last = Some(epoch.time);
        if let Some(base) = base {
            self.base.take(base.epochs, epoch.time);
        }
        self.slipped.clear();
        self.end_arcs(epoch, options);
        match self.relative(epoch, navigation, base, options) {
            Ok(solution) => {
                self.stand_in = None;
                solution
            }
            Err(reason) => {
                let stand_in = self
                    .stand_in
                    .get_or_insert_with(|| Box::new(SlidingWindow::new(options, false)));
                let mut solution = stand_in.advance(epoch, navigation, options);
                solution.reasons.push(reason);
                solution
            }
        }
    }

    /// Ends the arcs that either receiver says it lost, and those not seen for long.
    fn end_arcs(&mut self, epoch: &Epoch, options: &PositioningOptions) {
        let lost_by_rover = |satellite, code| {
            epoch.observations.iter().any(|observation| {
                let is_same = observation.satellite == satellite && observation.code == code;
                is_same && observation.loss_of_lock
            })
        };
        let base = &self.base;
        let failed = epoch.power_failure || base.power_failed || options.rtk.single_epoch;
        self.chain.arcs.end(
            |arc| {
                failed
                    || options.rtk.arc_gap_s < epoch.time - arc.last
                    || lost_by_rover(arc.satellite, arc.codes[0])
                    || base.lost.contains(&(arc.satellite, arc.codes[1]))
            },
            &mut self.slipped,
        );
        self.base.settle();
    }

    /// The answer relative to the base, or why there is none.
    fn relative(
        &mut self,
        epoch: &Epoch,
        navigation: &Navigation,
        base: Option<&BaseAiding<'_>>,
        options: &PositioningOptions,
    ) -> Result<Solution, Reason> {
        let station = base.map(|base| base.station).ok_or(Reason::BaseMissing)?;
        let newest = self.base.newest().ok_or(Reason::BaseMissing)?;
        let age_s = epoch.time - newest.time;
        if options.rtk.base_age_max_s + TAG_SLACK_S < age_s {
            return Err(Reason::BaseStale { age_s });
        }
        let single_point = &mut self.single_point;
        let error_m = self.base.position_error_m(station, single_point, navigation, options);
        let doubt = error_m
            .filter(|error_m| DOUBTED_M < *error_m)
            .map(|distance_m| Reason::BasePositionDoubtful { distance_m });
        if let (Some(doubt), true) = (&doubt, error_m.is_some_and(|m| REFUSED_M < m)) {
            return Err(doubt.clone());
        }
        let guess = self.guess(epoch, navigation, options)?;
        let place = self.chain.place(&guess);
        let length_m = place.distance_m(station.antenna_reference_point);
        if options.rtk.baseline_max_m < length_m {
            return Err(Reason::BaselineTooLong { length_m });
        }
        let newest = self.base.newest().ok_or(Reason::BaseMissing)?;
        let side = BaseSide { station, epoch: newest };
        let gathered = self.differences.gather(epoch, place, &side, navigation, options);
        gathered.ok_or(Reason::NotConverged)?;
        let (used, needed) = self.differences.used_and_needed();
        if used < needed {
            return Err(Reason::TooFewCommonSatellites { used, needed });
        }
        self.end_flipped_arcs();
        let (settings, differences) = (&self.settings, &self.differences);
        self.chain.append(epoch.time, guess, differences, options, settings);
        if self.solve(options).is_none() {
            self.chain.clear();
            return Err(Reason::NotConverged);
        }
        self.covariances.newest(&self.workspace.elimination);
        let mut solution = self.answer(epoch.time, station.antenna_reference_point, age_s, options);
        solution.reasons.extend(doubt);
        Ok(solution)
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
                self.chain.begin(self.chain.place(&guess));
                return Ok(State::zeros());
            }
            if epoch.time - last <= options.graph.gap_s && is_near {
                return Ok(guess);
            }
        }
        let alone = self.single_point.solve(epoch, navigation, options, None);
        let estimate = alone.estimate.ok_or(Reason::NotConverged)?;
        self.chain.begin(estimate.position);
        let mut guess = State::zeros();
        if let Some(velocity) = &estimate.velocity {
            let local = self.chain.frame.rotation * velocity.velocity_m_s;
            guess.fixed_rows_mut::<3>(3).copy_from(&local);
        }
        Ok(guess)
    }

    /// Ends arcs whose half-cycle flag changed: the phase may have moved by half a cycle.
    fn end_flipped_arcs(&mut self) {
        let list = &self.differences.list;
        let flipped = |satellite, codes, half_cycle| {
            list.iter().any(|d| {
                d.satellite == satellite
                    && d.codes == codes
                    && d.carrier.is_some()
                    && d.half_cycle != half_cycle
            })
        };
        let is_over = |arc: &Arc| flipped(arc.satellite, arc.codes, arc.half_cycle);
        self.chain.arcs.end(is_over, &mut self.slipped);
    }

    /// Forgets the epochs that leave and solves the window, slips cut out.
    fn solve(&mut self, options: &PositioningOptions) -> Option<()> {
        let Self { chain, settings, workspace, oldest, slipped, .. } = self;
        while options.rtk.window_epochs < chain.epochs.len() {
            chain.forget_oldest(settings, oldest).ok()?;
        }
        for _ in 0..SLIP_ROUNDS {
            chain.solve(settings, workspace).ok()?;
            if !chain.cut_slips(settings, slipped) {
                break;
            }
        }
        chain.learn_noise();
        Some(())
    }

    fn answer(
        &mut self,
        time: GpsTime,
        base: Ecef,
        age_s: f64,
        options: &PositioningOptions,
    ) -> Solution {
        let Chain { arcs, trust, estimate, .. } = &mut self.chain;
        let mut resolution = self.integers.resolve(
            &mut arcs.list,
            trust,
            |arc| arc.last == time,
            estimate,
            &self.covariances,
            &options.rtk,
        );
        if let Ok(fixed) = &resolution.outcome
            && MISFIT_SIGMAS < self.chain.learn_carrier_noise(&fixed.position)
        {
            let Chain { arcs, trust, .. } = &mut self.chain;
            drop_labels(&mut arcs.list, trust);
            resolution.outcome = Err(Reason::FixRejected);
        }
        let chain = &self.chain;
        let mut reasons = Vec::new();
        if !self.differences.without_ephemeris.is_empty() {
            let satellites = self.differences.without_ephemeris.clone();
            reasons.push(Reason::EphemerisMissing { satellites });
        }
        if !self.slipped.is_empty() {
            self.slipped.sort_unstable();
            self.slipped.dedup();
            reasons.push(Reason::CycleSlips { satellites: self.slipped.clone() });
        }
        let mut halves: Vec<_> = chain
            .arcs
            .list
            .iter()
            .filter(|a| a.half_cycle && a.last == time)
            .map(|a| a.satellite)
            .collect();
        if !halves.is_empty() {
            halves.sort_unstable();
            halves.dedup();
            reasons.push(Reason::HalfCycleUnresolved { satellites: halves });
        }
        let findings = Findings {
            differences: &self.differences,
            covariance: self.covariances.state(),
            resolution,
            base,
            age_s,
            reasons,
        };
        solution(chain, findings)
    }
}

impl RtkWindow {
    /// Writes what the next answers depend on, all of which [`Clone`] copies; the settings follow
    /// from the options.
    pub(in crate::positioning) fn save(&self, writer: &mut SnapshotWriter) {
        self.chain.save(writer);
        self.base.save(writer);
        self.last.save(writer);
        self.stand_in.is_some().save(writer);
        if let Some(stand_in) = &self.stand_in {
            stand_in.save(writer);
        }
    }

    /// The window that was written, by the options it was made with.
    pub(in crate::positioning) fn load(
        options: &PositioningOptions,
        reader: &mut SnapshotReader<'_>,
    ) -> Result<Self, SnapshotError> {
        Ok(Self {
            chain: Snapshot::load(reader)?,
            base: Snapshot::load(reader)?,
            last: Snapshot::load(reader)?,
            stand_in: match bool::load(reader)? {
                true => Some(Box::new(SlidingWindow::load(options, reader)?)),
                false => None,
            },
            ..Self::new(options)
        })
    }

    /// Swaps the memory both work in.
    pub(in crate::positioning) fn exchange_memory(&mut self, other: &mut Self) {
        #[rustfmt::skip]
        let Self {
            settings: _, chain, base: _, last: _, stand_in, single_point, differences, integers,
            slipped, workspace, covariances, oldest,
        } = self;
        chain.exchange_memory(&mut other.chain);
        if let (Some(stand_in), Some(other)) = (stand_in, &mut other.stand_in) {
            stand_in.exchange_memory(other);
        }
        single_point.exchange_memory(&mut other.single_point);
        std::mem::swap(differences, &mut other.differences);
        std::mem::swap(integers, &mut other.integers);
        std::mem::swap(slipped, &mut other.slipped);
        std::mem::swap(workspace, &mut other.workspace);
        std::mem::swap(covariances, &mut other.covariances);
        std::mem::swap(oldest, &mut other.oldest);
    }
}

/// Copies what the next answers depend on; scratch memory stays where it is.
impl Clone for RtkWindow {
    fn clone(&self) -> Self {
        Self {
            settings: self.settings.clone(),
            chain: self.chain.clone(),
            base: self.base.clone(),
            last: self.last,
            stand_in: self.stand_in.clone(),
            single_point: self.single_point.with_fresh_memory(),
            differences: SingleDifferences::default(),
            integers: Integers::new(),
            slipped: Vec::new(),
            workspace: Workspace::new(BorderLife::WholeChain),
            covariances: Covariances::new(),
            oldest: (System::new(BorderLife::WholeChain), Elimination::new()),
        }
    }

    fn clone_from(&mut self, source: &Self) {
        self.settings.clone_from(&source.settings);
        self.chain.clone_from(&source.chain);
        self.base.clone_from(&source.base);
        self.last = source.last;
        self.stand_in.clone_from(&source.stand_in);
        self.single_point.answer_like(&source.single_point);
    }
}
