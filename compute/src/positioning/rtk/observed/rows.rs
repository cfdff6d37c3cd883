//! The rows of one epoch from the differences of rover and base.

use crate::config::{DopplerUse, PositioningOptions};
use crate::gnss::{Enu, LocalFrame};
use crate::graph::shared_offset;
use crate::positioning::differencing::{
    Differenced, RangeRate, SingleDifference, SingleDifferences,
};
use crate::positioning::factors::{DopplerFactor, Sight};
use crate::positioning::setup::{CARRIER_KERNEL, OFFSET_KERNEL};

use super::arcs::Arcs;
use super::epoch::{DifferenceFactor, EpochAmbiguity, Group, RowScratch, RtkEpoch, State};
use super::receivers::Receivers;

/// Inputs for the rows of an epoch.
pub(crate) struct NewRows<'a> {
    pub(crate) frame: &'a LocalFrame,
    /// The approximate state of the epoch.
    pub(crate) guess: &'a State,
    pub(crate) differences: &'a SingleDifferences,
    pub(crate) options: &'a PositioningOptions,
    pub(crate) arcs: &'a mut Arcs,
    pub(crate) receivers: &'a mut Receivers,
    /// Ambiguities by variable (cycles); new ones are appended.
    pub(crate) border: &'a mut Vec<f64>,
    pub(crate) scratch: &'a mut RowScratch,
}

/// Fills an epoch with its rows. Arcs continue or begin.
pub(crate) fn fill(epoch: &mut RtkEpoch, mut new: NewRows<'_>) {
    let NewRows { frame, guess, differences, options, .. } = new;
    let satellites = differences.satellites.iter();
    epoch.sights.extend(satellites.map(|common| Sight::new(frame, common.state.position)));
    epoch.see(guess, new.scratch);
    if options.graph.doppler != DopplerUse::None {
        add_rates(epoch, frame, guess, differences);
    }
    let correlation_s = options.rtk.pseudorange_correlation_s;
    new.receivers.last_pseudoranges.forget_before(epoch.time - correlation_s);
    let mut offset_m = None;
    for group in differences.list.chunk_by(|a, b| a.group() == b.group()) {
        // Where a group has no pseudorange, the offset of another is closer than none.
        offset_m = new.add_pseudoranges(epoch, group).or(offset_m);
        new.add_carriers(epoch, group, offset_m);
    }
}

impl NewRows<'_> {
    /// Rows of the pseudoranges of one group; returns their offset (m), if there are any.
    fn add_pseudoranges(
        &mut self,
        epoch: &mut RtkEpoch,
        group: &[SingleDifference],
    ) -> Option<f64> {
        let Receivers { last_pseudoranges, pseudorange_noise, biases, .. } = &mut *self.receivers;
        let begin = epoch.rows.len();
        let correlation_s = self.options.rtk.pseudorange_correlation_s;
        for difference in group {
            let Some(pseudorange) = difference.pseudorange else { continue };
            let independent_share = last_pseudoranges.record(difference, epoch.time, correlation_s);
            let (bias, index) = biases.find_or_begin(difference);
            let noise_m2 = pseudorange_noise.value.powi(2) * pseudorange.variance_m2;
            epoch.rows.push(DifferenceFactor {
                sight: difference.common,
                range_m: pseudorange.range_m - bias.bias_m,
                inverse_sigma: (noise_m2 + bias.variance_m2).sqrt().recip(),
                independent_share,
                ambiguity: None,
                bias: index,
            });
        }
        let rows = Group { begin, end: epoch.rows.len(), is_carrier: false };
        if rows.begin == rows.end {
            return None;
        }
        epoch.groups.push(rows);
        epoch.linearize_group(&rows, &[], self.scratch);
        let RowScratch { rows, numbers, .. } = &mut *self.scratch;
        Some(shared_offset(rows, &OFFSET_KERNEL, numbers))
    }

    /// Adds the rows of the carriers of one group. Arcs continue or begin.
    ///
    /// A new ambiguity starts at the value that the group's offset gives: the offset of the known
    /// ambiguities, or else of the pseudoranges. So the ambiguities of a group are of similar size.
    fn add_carriers(
        &mut self,
        epoch: &mut RtkEpoch,
        group: &[SingleDifference],
        offset_m: Option<f64>,
    ) {
        let (begin, time) = (epoch.rows.len(), epoch.time);
        let satellites = &self.differences.satellites;
        let elevation_rad = |d: &SingleDifference| satellites[d.common].look.elevation_rad;
        let correlation_s = self.options.rtk.carrier_correlation_s;
        for difference in group {
            let Some(carrier) = difference.carrier else { continue };
            let arc = self.arcs.go_on(difference, time, elevation_rad(difference));
            let Some((variable, since_s)) = arc else { continue };
            let independent_share = (since_s / correlation_s).min(1.0);
            epoch.rows.push(self.carrier(difference, carrier, independent_share, variable));
        }
        let known = Group { begin, end: epoch.rows.len(), is_carrier: true };
        epoch.linearize_group(&known, self.border, self.scratch);
        let RowScratch { rows, numbers, .. } = &mut *self.scratch;
        let offset_m = match rows.is_empty() {
            true => offset_m.unwrap_or(0.0),
            false => shared_offset(rows, &CARRIER_KERNEL, numbers),
        };
        for difference in group {
            let Some(carrier) = difference.carrier else { continue };
            if self.arcs.has_phase(difference, time) {
                continue;
            }
            let variable = self.arcs.begin(difference, time, elevation_rad(difference));
            let range_m = self.scratch.range_m(difference.common);
            let mean = (carrier.range_m - range_m - offset_m) / difference.wavelength_m();
            epoch.start_ambiguity(self.border, variable, mean);
            epoch.rows.push(self.carrier(difference, carrier, 1.0, variable));
        }
        if begin < epoch.rows.len() {
            epoch.groups.push(Group { begin, end: epoch.rows.len(), is_carrier: true });
        }
    }

    fn carrier(
        &self,
        difference: &SingleDifference,
        carrier: Differenced,
        independent_share: f64,
        variable: usize,
    ) -> DifferenceFactor {
        let wavelength_m = difference.wavelength_m();
        let variance_m2 = carrier.variance_m2 * self.receivers.carrier_noise.value.powi(2);
        DifferenceFactor {
            sight: difference.common,
            range_m: carrier.range_m,
            inverse_sigma: variance_m2.sqrt().recip(),
            independent_share,
            ambiguity: Some(EpochAmbiguity { variable, wavelength_m }),
            bias: None,
        }
    }
}

/// Adds the rover's Doppler of the satellites that are differenced.
fn add_rates(
    epoch: &mut RtkEpoch,
    frame: &LocalFrame,
    guess: &State,
    differences: &SingleDifferences,
) {
    let rover = frame.to_ecef(Enu(guess.fixed_rows::<3>(0).into_owned()));
    let is_used = |common: &usize| differences.list.iter().any(|d| d.common == *common);
    let used = (0..differences.satellites.len()).filter(is_used);
    epoch.rates.extend(used.filter_map(|common| {
        let satellite = &differences.satellites[common];
        let RangeRate { rate_m_s, variance_m2_s2 } = satellite.range_rate?;
        Some(DopplerFactor::new(frame, rover, &satellite.state, rate_m_s, variance_m2_s2.sqrt()))
    }));
}
