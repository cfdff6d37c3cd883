//! The carriers that are followed: their arcs, their integers, and how noisy they are.
//!
//! Shared by the graph and the filter: what turns the differences of an epoch into rows, and what
//! the residuals of an epoch that was solved say of noise and slips.

use nalgebra::{Matrix3, Vector3};

use crate::config::{DopplerUse, PositioningOptions};
use crate::gnss::{Enu, LocalFrame, Reason, SatelliteId};
use crate::graph::{Kernel, SharingRow, shared_offset};
use crate::positioning::differencing::{RangeRate, SingleDifference, SingleDifferences};
use crate::positioning::factors::{DopplerFactor, Sight};
use crate::positioning::setup::{CARRIER_KERNEL, OFFSET_KERNEL};
use crate::snapshot::state_fields;

use super::arcs::{Arc, Arcs};
use super::biases::CodeBiases;
use super::epoch::{Ambiguity, AmbiguityStart, DifferenceFactor, Group, RtkEpoch, Scratch, State};
use super::float::FloatSolution;
use super::heard::HeardRanges;
use super::integers::{Integers, Resolution, Trust, drop_labels};
use super::noise::{NoiseScale, Residuals};
use super::placed::{Placed, place, take_common_cycles_out};

/// Deviation of an ambiguity about its start (cycles): 200 m.
const START_CYCLES: f64 = 1e3;
/// A phase that contradicts the others by more has slipped (standard deviations).
const SLIP_SIGMAS: f64 = 5.0;
/// A fixed position whose phases miss by more (rms, in standard deviations) is none.
const MISFIT_SIGMAS: f64 = 4.0;
/// Nor is one that a satellite astray may have moved by more (m).
const HIDDEN_SHIFT_MAX_M: f64 = 0.1;

/// Arcs, integers and noise of the carriers that rover and base both follow.
#[derive(Debug)]
pub(super) struct Tracking {
    pub(super) arcs: Arcs,
    /// How far the arcs' integers are trusted.
    pub(super) trust: Trust,
    heard: HeardRanges,
    pseudorange_noise: NoiseScale,
    carrier_noise: NoiseScale,
    biases: CodeBiases,
}

state_fields!(Tracking { arcs, trust, heard, pseudorange_noise, carrier_noise, biases });

impl Tracking {
    /// No arcs, noise as stated.
    pub(super) fn new() -> Self {
        Self {
            arcs: Arcs::default(),
            trust: Trust::default(),
            heard: HeardRanges::default(),
            pseudorange_noise: NoiseScale::stated(),
            carrier_noise: NoiseScale::stated(),
            biases: CodeBiases::default(),
        }
    }

    /// Ends all arcs; what is known of the receivers' noise stays.
    pub(super) fn clear(&mut self) {
        self.arcs.clear();
        self.heard.clear();
        self.trust = Trust::default();
    }

    /// Rows of an epoch whose state is about `guess`; arcs go on or begin. `border` holds the
    /// ambiguities and grows by those that begin.
    pub(super) fn fill(
        &mut self,
        epoch: &mut RtkEpoch,
        frame: &LocalFrame,
        guess: &State,
        differences: &SingleDifferences,
        border: &mut Vec<f64>,
        options: &PositioningOptions,
        scratch: &mut Scratch,
    ) {
        let satellites = differences.satellites.iter();
        epoch.sights.extend(satellites.map(|common| Sight::new(frame, common.state.position)));
        epoch.see(guess, scratch);
        if options.graph.doppler != DopplerUse::None {
            add_rates(epoch, frame, guess, differences);
        }
        self.heard.forget_before(epoch.time - options.rtk.pseudorange_correlation_s);
        for group in differences.list.chunk_by(|a, b| a.group() == b.group()) {
            let offset_m = self.add_pseudoranges(epoch, group, options, scratch);
            self.add_carriers(epoch, group, differences, offset_m, border, options, scratch);
        }
    }

    /// Rows of the pseudoranges of one group; returns their offset (m), if there are any.
    fn add_pseudoranges(
        &mut self,
        epoch: &mut RtkEpoch,
        group: &[SingleDifference],
        options: &PositioningOptions,
        scratch: &mut Scratch,
    ) -> Option<f64> {
        let begin = epoch.rows.len();
        let correlation_s = options.rtk.pseudorange_correlation_s;
        for difference in group {
            let Some(pseudorange) = difference.pseudorange else { continue };
            let share = self.heard.share(difference, epoch.time, correlation_s);
            let (bias, place) = self.biases.of(difference);
            let noise_m2 = self.pseudorange_noise.value.powi(2) * pseudorange.variance_m2;
            epoch.rows.push(DifferenceFactor {
                sight: difference.common,
                range_m: pseudorange.range_m - bias.bias_m,
                inverse_sigma: (noise_m2 + bias.variance_m2).sqrt().recip(),
                share,
                ambiguity: None,
                bias: place,
            });
        }
        let rows = Group { begin, end: epoch.rows.len(), is_carrier: false };
        if rows.begin == rows.end {
            return None;
        }
        epoch.groups.push(rows);
        epoch.linearize_group(&rows, &[], scratch);
        let Scratch { rows, numbers, .. } = &mut *scratch;
        Some(shared_offset(rows, &OFFSET_KERNEL, numbers))
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
        border: &mut Vec<f64>,
        options: &PositioningOptions,
        scratch: &mut Scratch,
    ) {
        let (begin, time) = (epoch.rows.len(), epoch.time);
        let scale = self.carrier_noise.value.powi(2);
        for difference in group {
            let Some(carrier) = difference.carrier else { continue };
            let Some(arc) = self.arcs.find(difference) else { continue };
            let correlation_s = options.rtk.carrier_correlation_s;
            let share = ((time - arc.last) / correlation_s).min(1.0);
            arc.last = time;
            arc.epochs += 1;
            arc.elevation_rad = differences.satellites[difference.common].look.elevation_rad;
            let variance_m2 = carrier.variance_m2 * scale;
            let variable = arc.variable;
            push_carrier(epoch, difference, carrier.range_m, variance_m2, share, variable);
        }
        let known = Group { begin, end: epoch.rows.len(), is_carrier: true };
        epoch.linearize_group(&known, border, scratch);
        let Scratch { rows, numbers, .. } = &mut *scratch;
        let offset_m = match rows.is_empty() {
            true => offset_m.unwrap_or(0.0),
            false => shared_offset(rows, &CARRIER_KERNEL, numbers),
        };
        for difference in group {
            let Some(carrier) = difference.carrier else { continue };
            if self.arcs.find(difference).is_some_and(|arc| arc.last == time) {
                continue;
            }
            let elevation_rad = differences.satellites[difference.common].look.elevation_rad;
            let variable = self.arcs.begin(difference, time, elevation_rad).variable;
            let range_m = scratch.range_m(difference.common);
            let mean = (carrier.range_m - range_m - offset_m) / difference.wavelength_m();
            start(epoch, border, variable, mean);
            let variance_m2 = carrier.variance_m2 * scale;
            push_carrier(epoch, difference, carrier.range_m, variance_m2, 1.0, variable);
        }
        if begin < epoch.rows.len() {
            epoch.groups.push(Group { begin, end: epoch.rows.len(), is_carrier: true });
        }
    }

    /// Learns from an epoch how noisy pseudoranges are.
    ///
    /// A pseudorange of leverage h = aᵀCa/σ² and share s, C the position's covariance, leaves a
    /// residual of variance (1 − (2s − 1)·h)·σ²: the sum of (2s − 1)·h is what the epoch has
    /// determined of its position. Where phases tie it to those before, that is little.
    pub(super) fn learn_noise(
        &mut self,
        epoch: &RtkEpoch,
        state: &State,
        border: &[f64],
        covariance: &Matrix3<f64>,
        scratch: &mut Scratch,
    ) {
        let groups = self.gather_residuals(epoch, state, border, false, scratch);
        let by_position = leverage(epoch, state, covariance, scratch, |share| 2.0 * share - 1.0);
        self.pseudorange_noise.learn(&mut scratch.residuals, groups as f64 + by_position);
    }

    /// Whether the phases bear out a position with integers held: they fit, and no satellite astray
    /// may have moved it far. Learns from it how noisy carrier phases are; labels that do not fit
    /// are dropped.
    fn is_borne_out(
        &mut self,
        epoch: &RtkEpoch,
        placed: &Placed,
        border: &[f64],
        scratch: &mut Scratch,
    ) -> bool {
        let mut state = State::zeros();
        state.fixed_rows_mut::<3>(0).copy_from(&placed.position);
        let groups = self.gather_residuals(epoch, &state, border, true, scratch);
        let squares: f64 = scratch.residuals.iter().map(|residual| residual * residual).sum();
        let count = scratch.residuals.len();
        if HIDDEN_SHIFT_MAX_M < placed.hidden_shift_m(squares, count) {
            return false;
        }
        self.carrier_noise.learn(&mut scratch.residuals, (3 + groups) as f64);
        let fits = squares <= MISFIT_SIGMAS.powi(2) * count as f64;
        if !fits {
            drop_labels(&mut self.arcs.list, &mut self.trust, true);
        }
        fits
    }

    /// Learns from a position with integers held what satellites delay codes that differ.
    fn learn_biases(&mut self, epoch: &RtkEpoch, position: &Vector3<f64>, scratch: &mut Scratch) {
        if epoch.rows.iter().all(|factor| factor.bias.is_none()) {
            return;
        }
        let mut state = State::zeros();
        state.fixed_rows_mut::<3>(0).copy_from(position);
        epoch.see(&state, scratch);
        for group in epoch.groups.iter().filter(|group| !group.is_carrier) {
            let factors = &epoch.rows[group.begin..group.end];
            if factors.iter().all(|factor| factor.bias.is_none()) {
                continue;
            }
            epoch.linearize_group(group, &[], scratch);
            let Scratch { rows, numbers, .. } = &mut *scratch;
            for (factor, miss) in factors.iter().zip(misses(rows, &OFFSET_KERNEL, numbers)) {
                let Some(place) = factor.bias else { continue };
                let sigma_m = factor.inverse_sigma.recip();
                self.biases.learn(place, -miss * sigma_m, sigma_m.powi(2), factor.share);
            }
        }
    }

    /// Magnitudes of an epoch's whitened residuals at a position, of pseudoranges or of the carrier
    /// phases with integers; returns the number of their groups.
    fn gather_residuals(
        &self,
        epoch: &RtkEpoch,
        state: &State,
        border: &[f64],
        is_carrier: bool,
        scratch: &mut Scratch,
    ) -> usize {
        scratch.residuals.clear();
        epoch.see(state, scratch);
        let mut groups = 0;
        for group in epoch.groups.iter().filter(|group| group.is_carrier == is_carrier) {
            epoch.linearize_group(group, border, scratch);
            let Scratch { rows, numbers, residuals, .. } = &mut *scratch;
            if is_carrier {
                self.arcs.put_labels(border, rows);
                take_common_cycles_out(rows);
            }
            if rows.len() < 2 {
                continue;
            }
            residuals.extend(misses(rows, &OFFSET_KERNEL, numbers).map(f64::abs));
            groups += 1;
        }
        groups
    }

    /// The pseudoranges' residuals of a window that was solved. They have determined each offset,
    /// and their part of one position for all epochs, which phases tie together: the newest, of
    /// which the covariance is.
    pub(super) fn residuals(
        &self,
        epochs: &[RtkEpoch],
        states: &[State],
        covariance: &Matrix3<f64>,
        scratch: &mut Scratch,
    ) -> Residuals {
        let (mut square, mut freedom) = (0.0, 0.0);
        for (epoch, state) in epochs.iter().zip(states) {
            freedom -= leverage(epoch, state, covariance, scratch, |share| share);
            epoch.see(state, scratch);
            for group in epoch.groups.iter().filter(|group| !group.is_carrier) {
                epoch.linearize_group(group, &[], scratch);
                let Scratch { rows, numbers, .. } = &mut *scratch;
                let left = 1.0 - (rows.len() as f64).recip();
                for (row, miss) in rows.iter().zip(misses(rows, &OFFSET_KERNEL, numbers)) {
                    square += row.share * miss * miss;
                    freedom += row.share * left;
                }
            }
        }
        Residuals { square, freedom: f64::max(freedom, 0.0) }
    }

    /// Looks for the integers of an epoch that was solved. A position whose phases contradict its
    /// integers is none.
    pub(super) fn resolve(
        &mut self,
        integers: &mut Integers,
        epoch: &RtkEpoch,
        border: &[f64],
        float: &FloatSolution,
        residuals: &Residuals,
        options: &PositioningOptions,
        scratch: &mut Scratch,
    ) -> Resolution {
        let (list, trust) = (&mut self.arcs.list, &mut self.trust);
        let is_present = |arc: &Arc| arc.last == epoch.time;
        let noise = self.pseudorange_noise.known(residuals);
        let mut resolution = integers.resolve(list, trust, is_present, float, &options.rtk, &noise);
        let Ok(fixed) = &mut resolution.outcome else { return resolution };
        let placed = place(epoch, &fixed.position, border, &self.arcs, scratch);
        let Some(placed) = placed else {
            return Resolution { outcome: Err(Reason::FixRejected), ..resolution };
        };
        (fixed.position, fixed.covariance) = (placed.position, placed.covariance);
        let resolution = resolution.if_a_place();
        if resolution.outcome.is_err() {
            return resolution;
        }
        if !self.is_borne_out(epoch, &placed, border, scratch) {
            return Resolution { outcome: Err(Reason::FixRejected), ..resolution };
        }
        self.learn_biases(epoch, &placed.position, scratch);
        resolution
    }

    /// Begins the arcs anew whose phase in the newest epoch contradicts the others; returns whether
    /// any did.
    pub(super) fn cut_slips(
        &mut self,
        epoch: &mut RtkEpoch,
        state: &State,
        border: &mut Vec<f64>,
        kernel: &Kernel,
        slipped: &mut Vec<SatelliteId>,
        scratch: &mut Scratch,
    ) -> bool {
        let mut cut = Vec::new();
        epoch.see(state, scratch);
        for group in epoch.groups.iter().filter(|group| group.is_carrier) {
            epoch.linearize_group(group, border, scratch);
            let Scratch { rows, numbers, .. } = &mut *scratch;
            let both = rows.iter().zip(misses(rows, kernel, numbers));
            for (place, (row, miss)) in (group.begin..group.end).zip(both) {
                if SLIP_SIGMAS < miss.abs() {
                    cut.push((place, miss / row.by_offset));
                }
            }
        }
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
            let variable = self.arcs.renew(index);
            slipped.push(self.arcs.list[index].satellite);
            let mean = border[old] - miss_m / ambiguity.wavelength_m;
            start(epoch, border, variable, mean);
            epoch.rows[place].ambiguity = Some(Ambiguity { variable, ..ambiguity });
            epoch.rows[place].share = 1.0;
        }
        any
    }
}

/// Sum of aᵀCa/σ² over an epoch's pseudoranges, offsets eliminated, each times what `of` makes
/// of its share.
fn leverage(
    epoch: &RtkEpoch,
    state: &State,
    covariance: &Matrix3<f64>,
    scratch: &mut Scratch,
    of: impl Fn(f64) -> f64,
) -> f64 {
    epoch.see(state, scratch);
    let mut sum = 0.0;
    for group in epoch.groups.iter().filter(|group| !group.is_carrier) {
        epoch.linearize_group(group, &[], scratch);
        let rows = &scratch.rows;
        let total: f64 = rows.iter().map(|row| row.by_offset.powi(2)).sum();
        let weighted = |row: &SharingRow<3>| Vector3::from(row.row.jacobian) * row.by_offset;
        let mean = rows.iter().map(weighted).sum::<Vector3<f64>>() / total;
        for row in rows.iter().filter(|_| 1 < rows.len()) {
            let slope = Vector3::from(row.row.jacobian) - mean * row.by_offset;
            sum += of(row.share) * slope.dot(&(covariance * slope));
        }
    }
    sum
}

/// Whitened residuals of the rows of a group, whose offset is the one that fits best.
fn misses<'a>(
    rows: &'a [SharingRow<3>],
    kernel: &Kernel,
    numbers: &mut Vec<f64>,
) -> impl Iterator<Item = f64> + use<'a> {
    let offset_m = shared_offset(rows, kernel, numbers);
    rows.iter().map(move |row| row.row.residual + row.by_offset * offset_m)
}

/// Doppler shifts of the rover from the satellites that are differenced.
fn add_rates(
    epoch: &mut RtkEpoch,
    frame: &LocalFrame,
    guess: &State,
    differences: &SingleDifferences,
) {
    let place = frame.to_ecef(Enu(guess.fixed_rows::<3>(0).into_owned()));
    let is_used = |common: &usize| differences.list.iter().any(|d| d.common == *common);
    let used = (0..differences.satellites.len()).filter(is_used);
    epoch.rates.extend(used.filter_map(|common| {
        let satellite = &differences.satellites[common];
        let RangeRate { rate_m_s, variance_m2_s2 } = satellite.range_rate?;
        Some(DopplerFactor::new(frame, place, &satellite.state, rate_m_s, variance_m2_s2.sqrt()))
    }));
}

fn start(epoch: &mut RtkEpoch, border: &mut Vec<f64>, variable: usize, mean: f64) {
    if border.len() <= variable {
        border.resize(variable + 1, 0.0);
    }
    border[variable] = mean;
    let inverse_sigma = START_CYCLES.recip();
    epoch.starts.push(AmbiguityStart { variable, mean, inverse_sigma });
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
        bias: None,
    });
}
