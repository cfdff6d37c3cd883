//! The rows of one epoch, and their order in the filter.

use crate::config::GraphOptions;
use crate::gnss::SatelliteId;
use crate::positioning::factors::{
    ComponentFactor, DopplerFactor, Line, OdometryFactor, PhaseDifferenceFactor, Sight, State,
    VELOCITY, ZeroVelocityFactor, position,
};
use crate::positioning::ranging::Ranging;

use super::gaussian::{Gaussian, Innovation};

/// The rows of one epoch; the memory is reused.
#[derive(Debug, Default)]
pub(super) struct Rows {
    /// Satellites above the mask.
    pub(super) sights: Vec<Sight>,
    /// Lines of sight from the state of the latest linearisation.
    pub(super) lines: Vec<Line>,
    pub(super) ranges: Vec<Ranging>,
    /// Satellites whose pseudoranges passed the test, sorted.
    pub(super) used: Vec<SatelliteId>,
    pub(super) rates: Vec<DopplerFactor>,
    pub(super) phases: Vec<PhaseDifferenceFactor>,
    pub(super) odometry: Option<OdometryFactor>,
    pub(super) standstill: Option<ZeroVelocityFactor>,
    /// Weight of each pseudorange: 1 if it passed the test, else 0.
    pub(super) weights: Vec<f64>,
    /// Scratch for medians (m).
    pub(super) numbers: Vec<f64>,
}

impl Rows {
    /// Empties the lists and keeps their memory.
    pub(super) fn clear(&mut self) {
        self.sights.clear();
        self.ranges.clear();
        self.used.clear();
        self.rates.clear();
        self.phases.clear();
        self.odometry = None;
        self.standstill = None;
    }

    /// Applies the rows in this order: vertical prior, standstill, odometry, phases, Doppler,
    /// pseudoranges.
    ///
    /// `before` contains the satellites of the previous epoch, `limit` is the limit of the
    /// innovation test, and `independent_share` is the fraction of their information that
    /// pseudoranges keep.
    pub(super) fn enter(
        &mut self,
        gaussian: &mut Gaussian,
        before: &[Sight],
        limit: f64,
        independent_share: f64,
        graph: &GraphOptions,
    ) {
        if graph.vertical_velocity_m_s.is_finite() && graph.motion {
            let inverse_sigma = graph.vertical_velocity_m_s.recip();
            let level = ComponentFactor { column: VELOCITY + 2, mean: 0.0, inverse_sigma };
            let row = Innovation::row(&level.linearize(&gaussian.state()), None);
            gaussian.update(&row, f64::INFINITY);
        }
        if let Some(standstill) = &self.standstill {
            for axis in 0..3 {
                let position = standstill.position_row(axis, &gaussian.past(), &gaussian.state());
                gaussian.update(&Innovation::link(&position), f64::INFINITY);
                let velocity = standstill.velocity_row(axis, &gaussian.state());
                gaussian.update(&Innovation::row(&velocity, None), f64::INFINITY);
            }
        }
        if let Some(odometry) = &self.odometry {
            for row in 0..3 {
                let link = odometry.linearize(row, &gaussian.past(), &gaussian.state());
                gaussian.update(&Innovation::link(&link), limit);
            }
        }
        for phase in &self.phases {
            let (past, state) = (gaussian.past(), gaussian.state());
            let from = before[usize::from(phase.before)].range(&position(&past));
            let to = self.sights[usize::from(phase.after)].range(&position(&state));
            let link = phase.linearize((&from, &past), (&to, &state));
            gaussian.update(&Innovation::link(&link), limit);
        }
        for rate in &self.rates {
            gaussian.update(&Innovation::row(&rate.linearize(&gaussian.state()), None), limit);
        }
        for range in &self.ranges {
            let state = gaussian.state();
            let line = self.sights[usize::from(range.sight)].range(&position(&state));
            let row = range.factor.linearize(&line, &state, range.bias_m(gaussian.biases_m()));
            let bias = range.bias.map(|index| (index as usize, range.factor.inverse_sigma));
            if gaussian.update(&Innovation::row(&row, bias).scaled(independent_share), limit) {
                self.used.push(range.satellite);
            }
        }
        self.used.sort_unstable();
    }

    /// Computes the lines of sight from a state's position to all satellites.
    pub(super) fn see(&mut self, state: &State) {
        self.lines.clear();
        self.lines.extend(self.sights.iter().map(|sight| sight.range(&position(state))));
    }
}
