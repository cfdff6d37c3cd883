//! How far the C/N0 of each signal is below the signal's own level.
//!
//! An obstacle at the edge of the direct path weakens a signal and bends its phase. A reflection
//! that is received instead of the direct signal does the same. C/N0 alone does not show this,
//! because a low satellite is as weak without either. So C/N0 S enters the variances as
//! S − α·max(0, Δ − 3 dB), where Δ is how far S is below the signal's own level and α = 2 (Brunner,
//! Hartinger & Troyer 1999, *GPS signal diffraction modelling: the stochastic SIGMA-Δ model*, J.
//! Geodesy 73, where the level is a template of C/N0 by elevation). The level here is the larger of
//! two values. One is the greatest recent C/N0 of the signal, which fades. The other is the usual
//! C/N0 of the strongest satellites on that signal minus 10 dB, the spread of antenna gain and path
//! loss between zenith and horizon.

use crate::gnss::{Epoch, GpsTime, Observation, ObservationCode, SatelliteId};
use crate::snapshot::{snapshot_fields, state_fields};

/// α.
const WEIGHT: f64 = 2.0;
/// The C/N0 of an unobstructed signal varies by this much (dB).
const STEADY_DB: f64 = 3.0;
/// How fast a level fades (dB/s): 4 dB a minute.
const FADING_DB_S: f64 = 4.0 / 60.0;
/// The lowest level of a signal is this far below the strongest satellites' C/N0 (dB).
const SPREAD_DB: f64 = 10.0;
/// Steps of the running 95 % quantile (dB): up if an observation exceeds it, down if not.
const QUANTILE_STEPS_DB: (f64, f64) = (0.19, 0.01);

/// One signal of one satellite.
type Signal = (SatelliteId, ObservationCode);

/// The level of a signal.
#[derive(Clone, Debug)]
struct Level {
    signal: Signal,
    db_hz: f64,
    at: GpsTime,
}

impl Level {
    fn faded_db_hz(&self, now: GpsTime) -> f64 {
        self.db_hz - FADING_DB_S * (now - self.at)
    }
}

/// The C/N0 of the strongest satellites on one signal: a running quantile of 95 %.
#[derive(Clone, Debug)]
struct Strongest {
    code: ObservationCode,
    db_hz: f64,
}

/// The levels of a receiver's signals.
#[derive(Debug, Default)]
pub(crate) struct SignalLevels {
    /// In order of their signals.
    levels: Vec<Level>,
    strongest: Vec<Strongest>,
}

snapshot_fields!(Level { signal, db_hz, at });
snapshot_fields!(Strongest { code, db_hz });
state_fields!(SignalLevels { levels, strongest });

impl SignalLevels {
    /// Takes in the C/N0 of an epoch.
    pub(crate) fn learn(&mut self, epoch: &Epoch) {
        let now = epoch.time;
        self.levels.retain(|level| 0.0 < level.faded_db_hz(now));
        for observation in &epoch.observations {
            let Some(db_hz) = observation.cn0_db_hz.filter(|db_hz| db_hz.is_finite()) else {
                continue;
            };
            self.raise((observation.satellite, observation.code), db_hz, now);
            self.count(observation.code, db_hz);
        }
    }

    fn raise(&mut self, signal: Signal, db_hz: f64, now: GpsTime) {
        match self.levels.binary_search_by_key(&signal, |level| level.signal) {
            Ok(index) => {
                let level = &mut self.levels[index];
                (level.db_hz, level.at) = (db_hz.max(level.faded_db_hz(now)), now);
            }
            Err(index) => self.levels.insert(index, Level { signal, db_hz, at: now }),
        }
    }

    fn count(&mut self, code: ObservationCode, db_hz: f64) {
        match self.strongest.iter_mut().find(|strongest| strongest.code == code) {
            Some(strongest) if strongest.db_hz < db_hz => strongest.db_hz += QUANTILE_STEPS_DB.0,
            Some(strongest) => strongest.db_hz -= QUANTILE_STEPS_DB.1,
            None => self.strongest.push(Strongest { code, db_hz }),
        }
    }

    /// The C/N0 to use in the variance of an observation (dB-Hz); `None` without C/N0.
    pub(crate) fn effective_db_hz(&self, observation: &Observation) -> Option<f64> {
        let db_hz = observation.cn0_db_hz?;
        let Observation { satellite, code, .. } = *observation;
        let known = self.levels.binary_search_by_key(&(satellite, code), |level| level.signal);
        let own_db_hz = known.map_or(db_hz, |index| self.levels[index].db_hz);
        let strongest = self.strongest.iter().find(|strongest| strongest.code == code);
        let least_db_hz = strongest.map_or(db_hz, |strongest| strongest.db_hz - SPREAD_DB);
        let below_db = own_db_hz.max(least_db_hz) - db_hz;
        Some(db_hz - WEIGHT * (below_db - STEADY_DB).max(0.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gnss::Constellation;

    fn observation(number: u8, cn0_db_hz: f64) -> Observation {
        let satellite = SatelliteId::new(Constellation::Gps, number).unwrap();
        let code = ObservationCode::new(b'1', b'C').unwrap();
        Observation { cn0_db_hz: Some(cn0_db_hz), ..Observation::empty(satellite, code) }
    }

    fn levels(epochs: &[(f64, &[(u8, f64)])]) -> SignalLevels {
        let mut levels = SignalLevels::default();
        for (seconds, seen) in epochs {
            let mut epoch = Epoch::new(GpsTime::from_week_seconds(2400, *seconds));
            epoch.observations = seen.iter().map(|(n, cn0)| observation(*n, *cn0)).collect();
            levels.learn(&epoch);
        }
        levels
    }

    /// 45 dB-Hz, 30 s later 33: the level has faded to 43, Δ = 10 dB, S′ = 33 − 2·7 = 19 dB-Hz. A
    /// signal 2 dB below its level keeps its C/N0.
    #[test]
    fn a_dimmed_signal_worked_by_hand() {
        let levels = levels(&[(0.0, &[(1, 45.0)]), (30.0, &[(1, 33.0)])]);
        let effective = |cn0| levels.effective_db_hz(&observation(1, cn0)).unwrap();
        assert!((effective(33.0) - 19.0).abs() < 1e-9, "{}", effective(33.0));
        assert_eq!(effective(41.0), 41.0);
    }

    /// A satellite that was never strong is measured against the strongest ones: 45 − 10 = 35 dB-Hz
    /// at least, so that 30 dB-Hz are 5 dB below.
    #[test]
    fn a_signal_that_was_never_strong_is_dimmed_too() {
        let levels = levels(&[(0.0, &[(1, 45.0), (2, 30.0)])]);
        let effective = levels.effective_db_hz(&observation(2, 30.0)).unwrap();
        assert!((effective - 26.0).abs() < 0.1, "{effective}");
    }

    #[test]
    fn without_cn0_there_is_nothing_to_say() {
        let mut silent = observation(1, 0.0);
        silent.cn0_db_hz = None;
        assert_eq!(SignalLevels::default().effective_db_hz(&silent), None);
        assert_eq!(SignalLevels::default().effective_db_hz(&observation(1, 20.0)), Some(20.0));
    }
}
