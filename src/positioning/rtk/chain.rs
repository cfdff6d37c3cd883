//! The window of epochs in the graph: how it begins, grows and forgets.

use nalgebra::Vector3;

use crate::config::PositioningOptions;
use crate::gnss::{Ecef, Enu, GpsTime, LocalFrame, SatelliteId};
use crate::graph::{
    Elimination, EliminationError, Estimate, Kernel, Phase, Prior, SharingRow, System, Workspace,
    optimize, shared_offset,
};
use crate::positioning::differencing::{SingleDifference, SingleDifferences};
use crate::positioning::factors::{ComponentFactor, MotionFactor, Sight, VELOCITY};
use crate::snapshot::{Snapshot, SnapshotError, SnapshotReader, SnapshotWriter};

use super::arcs::Arcs;
use super::epoch::{
    Ambiguity, AmbiguityStart, DifferenceFactor, Group, Rows, RtkEpoch, STATE, Scratch, State,
};
use super::integers::Trust;
use super::settings::Settings;

/// Deviation of the first position about its start (m): says nearly nothing.
const START_M: f64 = 1e4;
/// Deviation of the first velocity about zero, per axis (m/s).
const START_M_S: f64 = 100.0;
/// Deviation of an ambiguity about its start (cycles): 200 m.
const START_CYCLES: f64 = 1e3;
/// Epochs that the noise learnt is a mean of.
const NOISE_EPOCHS: f64 = 20.0;
/// Epochs that the stated noise counts for.
const NOISE_PRIOR_EPOCHS: f64 = 2.0;
/// Factors on the stated noise, lest few satellites or a street say nonsense.
const NOISE_SCALES: std::ops::RangeInclusive<f64> = 0.25..=4.0;
/// A normal variable's standard deviation over its median magnitude.
const NORMAL_OVER_MEDIAN: f64 = 1.482_6;
/// A phase that contradicts the others by more has slipped (standard deviations).
const SLIP_SIGMAS: f64 = 5.0;

/// The epochs in the graph, their estimate, and the prior of those before.
#[derive(Debug)]
pub(super) struct Chain {
    pub(super) frame: LocalFrame,
    pub(super) epochs: Vec<RtkEpoch>,
    pub(super) estimate: Estimate<STATE>,
    pub(super) prior: Prior<STATE>,
    pub(super) arcs: Arcs,
    /// Standard deviation of the pseudoranges seen over that stated.
    noise_scale: f64,
    /// The same of carrier phases.
    carrier_scale: f64,
    /// Epochs that the scales were learnt from.
    learnt: [f64; 2],
    /// How far the arcs' integers are trusted.
    pub(super) trust: Trust,
    spare: Vec<RtkEpoch>,
    scratch: Scratch,
    misses: Vec<f64>,
}

impl Clone for Chain {
    fn clone(&self) -> Self {
        let mut clone = Self::new();
        clone.clone_from(self);
        clone
    }

    /// Copies into the storage already held.
    fn clone_from(&mut self, source: &Self) {
        self.frame = source.frame;
        self.epochs.clone_from(&source.epochs);
        self.estimate.clone_from(&source.estimate);
        self.prior.clone_from(&source.prior);
        self.arcs.clone_from(&source.arcs);
        self.noise_scale = source.noise_scale;
        self.carrier_scale = source.carrier_scale;
        self.learnt = source.learnt;
        self.trust = source.trust;
    }
}

impl Snapshot for Chain {
    fn save(&self, writer: &mut SnapshotWriter) {
        let Self { frame, epochs, estimate, prior, arcs, .. } = self;
        let Self {
            noise_scale, carrier_scale, learnt, trust, spare: _, scratch: _, misses: _, ..
        } = self;
        frame.save(writer);
        epochs.save(writer);
        estimate.save(writer);
        prior.save(writer);
        arcs.save(writer);
        (*noise_scale, *carrier_scale).save(writer);
        learnt.save(writer);
        trust.save(writer);
    }

    fn load(reader: &mut SnapshotReader<'_>) -> Result<Self, SnapshotError> {
        let chain = Self {
            frame: Snapshot::load(reader)?,
            epochs: Snapshot::load(reader)?,
            estimate: Snapshot::load(reader)?,
            prior: Snapshot::load(reader)?,
            arcs: Snapshot::load(reader)?,
            noise_scale: Snapshot::load(reader)?,
            carrier_scale: Snapshot::load(reader)?,
            learnt: Snapshot::load(reader)?,
            trust: Snapshot::load(reader)?,
            spare: Vec::new(),
            scratch: Scratch::default(),
            misses: Vec::new(),
        };
        let border = chain.estimate.border.len();
        let is_whole = chain.epochs.len() == chain.estimate.states.len()
            && chain.epochs.iter().all(|epoch| epoch.is_within(border))
            && chain.prior.variables().all(|variable| variable < border)
            && chain.arcs.is_within(border);
        if is_whole { Ok(chain) } else { Err(reader.invalid("chain")) }
    }
}

impl Chain {
    /// Swaps the memory both work in.
    pub(super) fn exchange_memory(&mut self, other: &mut Self) {
        std::mem::swap(&mut self.spare, &mut other.spare);
        std::mem::swap(&mut self.scratch, &mut other.scratch);
    }

    /// An empty chain.
    pub(super) fn new() -> Self {
        Self {
            frame: LocalFrame::at(Ecef::new(6_378_137.0, 0.0, 0.0)),
            epochs: Vec::new(),
            estimate: Estimate::new(),
            prior: Prior::none(),
            arcs: Arcs::default(),
            noise_scale: 1.0,
            carrier_scale: 1.0,
            learnt: [0.0; 2],
            trust: Trust::default(),
            spare: Vec::new(),
            scratch: Scratch::default(),
            misses: Vec::new(),
        }
    }

    /// Time of the newest epoch.
    pub(super) fn last_time(&self) -> Option<GpsTime> {
        self.epochs.last().map(|epoch| epoch.time)
    }

    /// Forgets everything and puts the origin at `start`.
    pub(super) fn begin(&mut self, start: Ecef) {
        self.clear();
        self.frame = LocalFrame::at(start);
    }

    /// Forgets everything.
    pub(super) fn clear(&mut self) {
        self.spare.append(&mut self.epochs);
        self.estimate.states.clear();
        self.estimate.border.clear();
        self.prior = Prior::none();
        self.arcs.clear();
        self.trust = Trust::default();
    }

    /// Where the newest state will be at `time`, if nothing happens.
    pub(super) fn predicted(&self, time: GpsTime) -> State {
        let (Some(last), Some(state)) = (self.last_time(), self.estimate.states.last()) else {
            return State::zeros();
        };
        let interval_s = time - last;
        let mut next = *state;
        for axis in 0..3 {
            next[axis] += interval_s * state[VELOCITY + axis];
        }
        next
    }

    /// The ECEF position of a state.
    pub(super) fn place(&self, state: &State) -> Ecef {
        self.frame.to_ecef(Enu(state.fixed_rows::<3>(0).into_owned()))
    }

    /// Adds an epoch whose state is about `guess`.
    pub(super) fn append(
        &mut self,
        time: GpsTime,
        guess: State,
        differences: &SingleDifferences,
        options: &PositioningOptions,
        settings: &Settings,
    ) {
        let mut epoch = self.spare.pop().unwrap_or_else(RtkEpoch::new);
        epoch.clear();
        epoch.time = time;
        let interval_s = self.last_time().map(|last| time - last);
        epoch.motion = interval_s.map(|interval_s| MotionFactor::new(&settings.motion, interval_s));
        if interval_s.is_none() {
            let mut add = |column: usize, sigma: f64| {
                let (mean, inverse_sigma) = (guess[column], sigma.recip());
                epoch.components.push(ComponentFactor { column, mean, inverse_sigma });
            };
            (0..3).for_each(|axis| add(axis, START_M));
            (VELOCITY..STATE).for_each(|rate| add(rate, START_M_S));
        }
        let satellites = differences.satellites.iter();
        epoch.sights.extend(satellites.map(|common| Sight::new(&self.frame, common.position)));
        epoch.see(&guess, &mut self.scratch);
        for group in differences.list.chunk_by(|a, b| a.group() == b.group()) {
            let offset_m = self.add_pseudoranges(&mut epoch, group, interval_s, options);
            self.add_carriers(&mut epoch, group, differences, offset_m, options);
        }
        self.estimate.states.push(guess);
        self.epochs.push(epoch);
    }

    /// Rows of the pseudoranges of one group; returns their offset (m), if there are any.
    fn add_pseudoranges(
        &mut self,
        epoch: &mut RtkEpoch,
        group: &[SingleDifference],
        interval_s: Option<f64>,
        options: &PositioningOptions,
    ) -> Option<f64> {
        let begin = epoch.rows.len();
        let correlation_s = options.rtk.pseudorange_correlation_s;
        for difference in group {
            let Some(pseudorange) = difference.pseudorange else { continue };
            let continues = self.arcs.find(difference).is_some();
            let share = match interval_s {
                Some(interval_s) if continues => (interval_s / correlation_s).min(1.0),
                _ => 1.0,
            };
            epoch.rows.push(DifferenceFactor {
                sight: difference.common,
                range_m: pseudorange.range_m,
                inverse_sigma: (self.noise_scale * pseudorange.variance_m2.sqrt()).recip(),
                share,
                ambiguity: None,
            });
        }
        let rows = Group { begin, end: epoch.rows.len(), is_carrier: false };
        if rows.begin == rows.end {
            return None;
        }
        epoch.groups.push(rows);
        epoch.linearize_group(&rows, &[], &mut self.scratch);
        let Scratch { rows, numbers, .. } = &mut self.scratch;
        Some(shared_offset(rows, &Kernel::huber(1.345), numbers))
    }

    /// Rows of the carriers of one group; arcs go on or begin.
    ///
    /// A new ambiguity starts where the offset of the group's known ones puts it, else that of its
    /// pseudoranges: all of a group then differ by little, as they will for good.
    fn add_carriers(
        &mut self,
        epoch: &mut RtkEpoch,
        group: &[SingleDifference],
        differences: &SingleDifferences,
        offset_m: Option<f64>,
        options: &PositioningOptions,
    ) {
        let begin = epoch.rows.len();
        let time = epoch.time;
        for difference in group {
            let Some(carrier) = difference.carrier else { continue };
            let Some(arc) = self.arcs.find(difference) else { continue };
            let correlation_s = options.rtk.carrier_correlation_s;
            let share = ((time - arc.last) / correlation_s).min(1.0);
            arc.last = time;
            arc.epochs += 1;
            arc.elevation_rad = differences.satellites[difference.common].look.elevation_rad;
            let variable = arc.variable;
            let variance_m2 = carrier.variance_m2 * self.carrier_scale.powi(2);
            push_carrier(epoch, difference, carrier.range_m, variance_m2, share, variable);
        }
        let known = Group { begin, end: epoch.rows.len(), is_carrier: true };
        epoch.linearize_group(&known, &self.estimate.border, &mut self.scratch);
        let Scratch { rows, numbers, .. } = &mut self.scratch;
        let offset_m = match rows.is_empty() {
            true => offset_m.unwrap_or(0.0),
            false => shared_offset(rows, &Kernel::geman_mcclure(4.0), numbers),
        };
        for difference in group {
            let Some(carrier) = difference.carrier else { continue };
            if self.arcs.find(difference).is_some_and(|arc| arc.last == time) {
                continue;
            }
            let elevation_rad = differences.satellites[difference.common].look.elevation_rad;
            let arc = self.arcs.begin(difference, time, elevation_rad);
            let range_m = self.scratch.range_m(difference.common);
            let mean = (carrier.range_m - range_m - offset_m) / difference.wavelength_m();
            self.start(epoch, arc.variable, mean);
            let variance_m2 = carrier.variance_m2 * self.carrier_scale.powi(2);
            let variable = arc.variable;
            push_carrier(epoch, difference, carrier.range_m, variance_m2, 1.0, variable);
        }
        if begin < epoch.rows.len() {
            epoch.groups.push(Group { begin, end: epoch.rows.len(), is_carrier: true });
        }
    }

    fn start(&mut self, epoch: &mut RtkEpoch, variable: usize, mean: f64) {
        if self.estimate.border.len() <= variable {
            self.estimate.border.resize(variable + 1, 0.0);
        }
        self.estimate.border[variable] = mean;
        let inverse_sigma = START_CYCLES.recip();
        epoch.starts.push(AmbiguityStart { variable, mean, inverse_sigma });
    }

    /// Solves the window.
    pub(super) fn solve(
        &mut self,
        settings: &Settings,
        workspace: &mut Workspace<STATE>,
    ) -> Result<(), EliminationError> {
        let is_young = self.epochs.iter().any(|epoch| epoch.motion.is_none());
        let how = if is_young { &settings.whole } else { &settings.update };
        let mut estimate = std::mem::take(&mut self.estimate);
        let mut rows = Rows {
            epochs: &self.epochs,
            prior: &self.prior,
            kernels: &settings.kernels,
            scratch: &mut self.scratch,
        };
        let solved = optimize(&mut rows, &mut estimate, how, workspace);
        self.estimate = estimate;
        solved.map(|_| ())
    }

    /// Learns from the newest epoch how noisy pseudoranges are.
    ///
    /// Receivers differ by a factor of five for the same C/N0. m = 1.4826·median∣s∣, s the whitened
    /// residuals of all groups, widened for the numbers they have determined; the scale's square is
    /// a running mean of m² that begins with one.
    pub(super) fn learn_noise(&mut self) {
        let Some(state) = self.estimate.states.last().copied() else { return };
        let groups = self.misses(&state, false);
        let [learnt, _] = &mut self.learnt;
        learn(&mut self.misses, 3 + groups, &mut self.noise_scale, learnt);
    }

    /// Learns from a position with integers held how noisy carrier phases are; returns the rms of
    /// the phases' whitened residuals there.
    pub(super) fn learn_carrier_noise(&mut self, position: &Vector3<f64>) -> f64 {
        let mut state = State::zeros();
        state.fixed_rows_mut::<3>(0).copy_from(position);
        let groups = self.misses(&state, true);
        let square: f64 = self.misses.iter().map(|miss| miss * miss).sum();
        let rms = (square / self.misses.len().max(1) as f64).sqrt();
        let [_, learnt] = &mut self.learnt;
        learn(&mut self.misses, 3 + groups, &mut self.carrier_scale, learnt);
        rms
    }

    /// Magnitudes of the newest epoch's whitened residuals at a position, of pseudoranges or of the
    /// carrier phases with integers; returns the number of their groups.
    fn misses(&mut self, state: &State, is_carrier: bool) -> usize {
        let Self { epochs, misses, scratch, estimate, arcs, .. } = self;
        misses.clear();
        let Some(epoch) = epochs.last() else { return 0 };
        epoch.see(state, scratch);
        let mut groups = 0;
        for group in epoch.groups.iter().filter(|group| group.is_carrier == is_carrier) {
            epoch.linearize_group(group, &estimate.border, scratch);
            let Scratch { rows, numbers, .. } = &mut *scratch;
            if is_carrier {
                arcs.put_labels(&estimate.border, rows);
            }
            if rows.len() < 2 {
                continue;
            }
            let offset_m = shared_offset(rows, &Kernel::huber(1.345), numbers);
            let miss = |row: &SharingRow<3>| row.row.residual + row.by_offset * offset_m;
            misses.extend(rows.iter().map(|row| miss(row).abs()));
            groups += 1;
        }
        groups
    }

    /// Begins the arcs anew whose newest phase contradicts the others; returns whether any did.
    pub(super) fn cut_slips(
        &mut self,
        settings: &Settings,
        slipped: &mut Vec<SatelliteId>,
    ) -> bool {
        let (Some(epoch), Some(state)) = (self.epochs.last(), self.estimate.states.last()) else {
            return false;
        };
        let kernel = settings.kernels.at(Phase::Graduated(1.0))[1];
        let mut cut = Vec::new();
        epoch.see(state, &mut self.scratch);
        for group in epoch.groups.iter().filter(|group| group.is_carrier) {
            epoch.linearize_group(group, &self.estimate.border, &mut self.scratch);
            let Scratch { rows, numbers, .. } = &mut self.scratch;
            let offset_m = shared_offset(rows, &kernel, numbers);
            for (place, row) in (group.begin..group.end).zip(rows.iter()) {
                let miss = row.row.residual + row.by_offset * offset_m;
                if SLIP_SIGMAS < miss.abs() {
                    cut.push((place, miss / row.by_offset));
                }
            }
        }
        let mut epoch = self.epochs.pop().expect("there is a newest epoch");
        let mut any = false;
        for (place, miss_m) in cut {
            let Some(ambiguity) = epoch.rows[place].ambiguity else { continue };
            let old = ambiguity.variable;
            let Some(index) = self.arcs.list.iter().position(|arc| arc.variable == old) else {
                continue;
            };
            if self.arcs.list[index].epochs == 1 {
                continue;
            }
            any = true;
            let variable = self.arcs.take_variable();
            let arc = &mut self.arcs.list[index];
            (arc.variable, arc.epochs, arc.label) = (variable, 1, None);
            slipped.push(arc.satellite);
            let mean = self.estimate.border[old] - miss_m / ambiguity.wavelength_m;
            self.start(&mut epoch, variable, mean);
            epoch.rows[place].ambiguity = Some(Ambiguity { variable, ..ambiguity });
            epoch.rows[place].share = 1.0;
        }
        self.epochs.push(epoch);
        any
    }

    /// Marginalises the oldest epoch into the prior, and with it the ambiguities nothing names.
    pub(super) fn forget_oldest(
        &mut self,
        settings: &Settings,
        workspace: &mut (System<STATE>, Elimination<STATE>),
    ) -> Result<(), EliminationError> {
        let (system, elimination) = workspace;
        let kernels = settings.kernels.at(Phase::Graduated(1.0));
        system.reset(2, self.estimate.border.len());
        self.prior.add_to(0, &self.estimate, system);
        self.epochs[0].add_to(0, &self.estimate, &kernels, &mut self.scratch, system);
        self.epochs[1].add_tie_to(0, &self.estimate, system);
        let (arcs, later) = (&self.arcs, &self.epochs[1..]);
        let over =
            |variable: usize| !arcs.has(variable) && !later.iter().any(|e| e.names(variable));
        self.prior.marginalize(system, &self.estimate, over, elimination)?;
        let oldest = self.epochs.remove(0);
        self.spare.push(oldest);
        self.estimate.states.remove(0);
        let Self { arcs, epochs, prior, .. } = self;
        arcs.release(|variable| {
            epochs.iter().any(|epoch| epoch.names(variable))
                || prior.variables().any(|known| known == variable)
        });
        Ok(())
    }

    /// Slopes of the ranges to the satellites of the newest epoch, local.
    pub(super) fn slopes(&self) -> Vec<Vector3<f64>> {
        let (Some(epoch), Some(state)) = (self.epochs.last(), self.estimate.states.last()) else {
            return Vec::new();
        };
        let position = state.fixed_rows::<3>(0).into_owned();
        epoch.sights.iter().map(|sight| sight.range(&position).1).collect()
    }
}

/// Takes the residuals of one epoch, which have determined so many numbers, into a noise scale.
fn learn(misses: &mut [f64], determined: usize, scale: &mut f64, learnt: &mut f64) {
    let n = misses.len();
    if n < 2 * determined {
        return;
    }
    let (_, median, _) = misses.select_nth_unstable_by(n / 2, f64::total_cmp);
    let freedom = n as f64 / (n - determined) as f64;
    let stated = scale.powi(2);
    let seen = (*median * NORMAL_OVER_MEDIAN).powi(2) * stated * freedom;
    *learnt = (*learnt + 1.0).min(NOISE_EPOCHS);
    let mean = stated + (seen - stated) / (*learnt + NOISE_PRIOR_EPOCHS);
    *scale = mean.sqrt().clamp(*NOISE_SCALES.start(), *NOISE_SCALES.end());
}

fn push_carrier(
    epoch: &mut RtkEpoch,
    difference: &SingleDifference,
    range_m: f64,
    variance_m2: f64,
    share: f64,
    variable: usize,
) {
    let wavelength_m = difference.wavelength_m();
    epoch.rows.push(DifferenceFactor {
        sight: difference.common,
        range_m,
        inverse_sigma: variance_m2.sqrt().recip(),
        share,
        ambiguity: Some(Ambiguity { variable, wavelength_m }),
    });
}
