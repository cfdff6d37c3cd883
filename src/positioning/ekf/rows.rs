//! The rows of one epoch, and how they enter the filter.

use crate::config::GraphOptions;
use crate::gnss::SatelliteId;
use crate::positioning::factors::{
    ComponentFactor, DopplerFactor, OdometryFactor, PhaseDifferenceFactor, VELOCITY,
    ZeroVelocityFactor,
};
use crate::positioning::ranging::Ranging;

use super::belief::{Belief, Innovation};

/// One epoch's rows; the memory is used again.
#[derive(Debug, Default)]
pub(super) struct Rows {
    pub(super) ranges: Vec<Ranging>,
    /// Satellites whose pseudoranges passed the test, sorted.
    pub(super) used: Vec<SatelliteId>,
    pub(super) rates: Vec<DopplerFactor>,
    pub(super) phases: Vec<PhaseDifferenceFactor>,
    pub(super) odometry: Option<OdometryFactor>,
    pub(super) standstill: Option<ZeroVelocityFactor>,
    /// Scratch of medians.
    pub(super) misses_m: Vec<f64>,
}

impl Rows {
    /// Empties the lists; their memory stays.
    pub(super) fn clear(&mut self) {
        self.ranges.clear();
        self.used.clear();
        self.rates.clear();
        self.phases.clear();
        self.odometry = None;
        self.standstill = None;
    }

    /// Takes the rows in, kind by kind, the sharpest kinds first.
    ///
    /// `limit` is that of the innovation test, `share` how much of their information pseudoranges
    /// keep.
    pub(super) fn enter(
        &mut self,
        belief: &mut Belief,
        limit: f64,
        share: f64,
        graph: &GraphOptions,
    ) {
        if graph.vertical_velocity_m_s.is_finite() && graph.motion {
            let inverse_sigma = graph.vertical_velocity_m_s.recip();
            let level = ComponentFactor { column: VELOCITY + 2, mean: 0.0, inverse_sigma };
            let row = Innovation::row(&level.linearize(&belief.state()), None);
            belief.update(&row, f64::INFINITY);
        }
        if let Some(standstill) = &self.standstill {
            for axis in 0..3 {
                let place = standstill.place(axis, &belief.past(), &belief.state());
                belief.update(&Innovation::link(&place), f64::INFINITY);
                let pace = standstill.pace(axis, &belief.state());
                belief.update(&Innovation::row(&pace, None), f64::INFINITY);
            }
        }
        if let Some(odometry) = &self.odometry {
            for row in 0..3 {
                let link = odometry.linearize(row, &belief.past(), &belief.state());
                belief.update(&Innovation::link(&link), limit);
            }
        }
        for phase in &self.phases {
            let link = phase.linearize(&belief.past(), &belief.state());
            belief.update(&Innovation::link(&link), limit);
        }
        for rate in &self.rates {
            belief.update(&Innovation::row(&rate.linearize(&belief.state()), None), limit);
        }
        for range in &self.ranges {
            let row = range.factor.linearize(&belief.state(), range.bias_m(belief.biases_m()));
            let bias = range.bias.map(|place| (place, range.factor.inverse_sigma));
            if belief.update(&Innovation::row(&row, bias).tempered(share), limit) {
                self.used.push(range.satellite);
            }
        }
        self.used.sort_unstable();
    }
}
