//! Doppler values that repeat the last epoch's to the last digit.
//!
//! Some chips report an old Doppler value again if they have no new one. The range rate of a
//! satellite in a medium orbit changes by up to 0.1 m/s each second even for a receiver at rest. So
//! a repeated value is an old one, and is left out.

use crate::gnss::{ObservationCode, SatelliteId};
use crate::positioning::Measurement;
use crate::snapshot::snapshot_fields;

/// Rates closer than this are the same (m/s): a twentieth of RINEX's last digit, 0.001 Hz.
const SAME_M_S: f64 = 1e-5;

/// Range rate of one signal in the last epoch.
#[derive(Clone, Copy, Debug)]
struct Rate {
    satellite: SatelliteId,
    code: ObservationCode,
    rate_m_s: f64,
    /// Whether it repeated the value before.
    repeats: bool,
}

snapshot_fields!(Rate { satellite, code, rate_m_s, repeats });

/// Range rates of the last epoch.
#[derive(Debug, Default)]
pub(super) struct RepeatedRates {
    rates: Vec<Rate>,
}

crate::snapshot::state_fields!(RepeatedRates { rates });

impl RepeatedRates {
    /// Compares the measurements of an epoch with those of the last one.
    pub(super) fn observe(&mut self, list: &[Measurement]) {
        let rate = |m: &Measurement| {
            let rate_m_s = m.range_rate_m_s?;
            let before = self.find(m);
            let repeats = before.is_some_and(|b| (b.rate_m_s - rate_m_s).abs() < SAME_M_S);
            Some(Rate { satellite: m.satellite, code: m.code, rate_m_s, repeats })
        };
        self.rates = list.iter().filter_map(rate).collect();
    }

    /// Whether the newest Doppler of a measurement's signal is an old value.
    pub(super) fn repeats(&self, measurement: &Measurement) -> bool {
        self.find(measurement).is_some_and(|rate| rate.repeats)
    }

    fn find(&self, m: &Measurement) -> Option<&Rate> {
        self.rates.iter().find(|rate| rate.satellite == m.satellite && rate.code == m.code)
    }
}
