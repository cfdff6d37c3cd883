//! The answer from a fit: covariance, clocks, dilutions of precision, reasons.

use crate::config::PositioningOptions;
use crate::gnss::constants::SPEED_OF_LIGHT;
use crate::gnss::{
    Constellation, Dops, Epoch, LocalFrame, Provenance, Reason, SatelliteId, SolutionEstimate,
};

use super::least_squares::Step;
use super::{Fit, SinglePoint};

impl SinglePoint {
    /// The estimate of a fit, with the local frame at its position; the reason if its geometry is
    /// too weak.
    pub(super) fn estimate(
        &mut self,
        epoch: &Epoch,
        frame: &LocalFrame,
        fit: &Fit,
        options: &PositioningOptions,
    ) -> Result<SolutionEstimate, Reason> {
        let position = fit.position();
        let dops = self.dops(frame).ok_or(Reason::GeometryTooWeak { gdop: f64::INFINITY })?;
        // If clocks are tied and there is a residual test, the covariance shows a weak geometry.
        let is_tested = fit.step.is_tied() && fit.test_ratio.is_some();
        if options.gdop_limit < dops.gdop && !is_tested {
            return Err(Reason::GeometryTooWeak { gdop: dops.gdop });
        }
        let (clock_m, inter_system_biases_m) = clocks(&fit.step);
        let list = &self.measurements.list;
        let is_used = |index: usize| {
            list[index].is_above_mask && !list[index].is_excluded && !self.wild[index]
        };
        let velocity = match options.velocity {
            true => self.velocity.estimate(position, list, is_used, options),
            false => None,
        };
        Ok(SolutionEstimate {
            position,
            covariance: fit.step.covariance * fit.variance_factor,
            velocity,
            clock_m,
            inter_system_biases_m,
            reception_time: epoch.time - clock_m / SPEED_OF_LIGHT,
            dops,
            satellites_used: self.satellites_used(),
            relative: None,
        })
    }

    /// Satellites of the rows in use, sorted.
    fn satellites_used(&self) -> Vec<SatelliteId> {
        let used = self.rows.iter().filter(|row| row.is_used);
        let mut satellites: Vec<_> =
            used.map(|row| self.measurements.list[row.index].satellite).collect();
        satellites.sort_unstable();
        satellites
    }

    /// Ephemerides of the satellites of the rows in use, in the order of [`Self::satellites_used`].
    pub(super) fn provenance(&self) -> Provenance {
        let used = self.rows.iter().filter(|row| row.is_used);
        let mut ephemerides: Vec<_> =
            used.map(|row| self.measurements.list[row.index].ephemeris).collect();
        ephemerides.sort_unstable_by_key(|issue| issue.satellite);
        Provenance { ephemerides, base: None }
    }

    /// Dilutions of precision of the rows in use, with equal weights.
    fn dops(&self, frame: &LocalFrame) -> Option<Dops> {
        let mut alike = self.rows.clone();
        alike.iter_mut().for_each(|row| row.weight = 1.0);
        if self.priors.is_some() {
            // One clock for all.
            let first = alike.first()?.constellation;
            alike.iter_mut().for_each(|row| row.constellation = first);
        }
        let step = Step::solve(&alike)?;
        let enu = frame.covariance_to_enu(&step.covariance);
        let first = first_clock(&step)?;
        let time = step.clock_variance_m2(first);
        Some(Dops {
            gdop: (enu.trace() + time).sqrt(),
            pdop: enu.trace().sqrt(),
            hdop: (enu[(0, 0)] + enu[(1, 1)]).sqrt(),
            vdop: enu[(2, 2)].sqrt(),
            tdop: time.sqrt(),
        })
    }

    /// Reasons that are known before the position, such as missing ephemerides.
    pub(super) fn aiding_reasons(&self) -> Vec<Reason> {
        let mut reasons = Vec::new();
        self.measurements.aiding_reasons(&mut reasons);
        reasons
    }

    /// Reasons that follow from the fit.
    pub(super) fn quality_reasons(&self, fit: &Fit) -> impl Iterator<Item = Reason> {
        let list = self.measurements.list.iter().zip(&self.wild);
        let excluded = list.filter(|(measurement, is_wild)| measurement.is_excluded || **is_wild);
        let mut satellites: Vec<_> = excluded.map(|(m, _)| m.satellite).collect();
        satellites.sort_unstable();
        let exclusions =
            (!satellites.is_empty()).then_some(Reason::SatellitesExcluded { satellites });
        let test = match fit.test_ratio {
            None => Some(Reason::NoRedundancy),
            Some(ratio) if 1.0 < ratio => Some(Reason::ResidualsTooLarge { ratio }),
            Some(_) => None,
        };
        exclusions.into_iter().chain(test)
    }
}

/// The first constellation that has a clock, in the order of [`Constellation::ALL`].
fn first_clock(step: &Step) -> Option<Constellation> {
    Constellation::ALL.into_iter().find(|c| step.has_clock(*c))
}

/// The first clock, and each further one minus it (m).
fn clocks(step: &Step) -> (f64, Vec<(Constellation, f64)>) {
    let Some(first) = first_clock(step) else {
        return (0.0, Vec::new());
    };
    let clock_m = step.clock_m(first);
    let further = Constellation::ALL.into_iter().skip(first.index() + 1);
    let present = further.filter(|c| step.has_clock(*c));
    (clock_m, present.map(|c| (c, step.clock_m(c) - clock_m)).collect())
}
