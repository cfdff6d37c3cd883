//! The C/N0 of each signal relative to the receiver's strongest signals, and to its own level.
//!
//! Receivers state C/N0 on scales that differ by several decibels, and antennas differ by as much.
//! So variances depend on S, the C/N0 relative to that of the strongest satellites with the same
//! code. Those of all constellations count together: the few satellites of one do not show what the
//! receiver states for an unobstructed signal.
//!
//! An obstacle at the edge of the direct path weakens a signal and bends its phase. A reflection
//! that is received instead of the direct signal does the same. C/N0 alone does not show this,
//! because a low satellite is as weak without either. So S enters the variances as
//! S − α·max(0, Δ − 3 dB), where Δ is how far S is below the signal's own level and α = 2 (Brunner,
//! Hartinger & Troyer 1999, *GPS signal diffraction modelling: the stochastic SIGMA-Δ model*, J.
//! Geodesy 73, where the level is a template of C/N0 by elevation). The level here is the larger of
//! two values. One is the greatest recent C/N0 of the signal, which fades. The other is the usual
//! C/N0 of the strongest satellites with that code minus 10 dB, the spread of antenna gain and path
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
/// Steps of the running 95 % quantile for each observation (dB): up if it exceeds the quantile,
/// down if not.
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

/// The C/N0 of the strongest satellites with one code: a running quantile of 95 %.
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
    /// Takes in the C/N0 of an epoch. The order of its observations changes nothing.
    pub(crate) fn learn(&mut self, epoch: &Epoch) {
        let now = epoch.time;
        self.levels.retain(|level| 0.0 < level.faded_db_hz(now));
        let mut stated = Vec::with_capacity(epoch.observations.len());
        for observation in &epoch.observations {
            let Some(db_hz) = observation.cn0_db_hz.filter(|db_hz| db_hz.is_finite()) else {
                continue;
            };
            self.raise((observation.satellite, observation.code), db_hz, now);
            stated.push((observation.code, db_hz));
        }
        stated.sort_unstable_by(|(a, a_db_hz), (b, b_db_hz)| {
            a.cmp(b).then(a_db_hz.total_cmp(b_db_hz))
        });
        for of_code in stated.chunk_by(|(a, _), (b, _)| a == b) {
            self.count(of_code);
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

    /// Takes in the C/N0 of all satellites with one code, in ascending order. The quantile begins
    /// with the median, which holds whatever the first few satellites are.
    fn count(&mut self, of_code: &[(ObservationCode, f64)]) {
        let (code, median_db_hz) = of_code[of_code.len() / 2];
        match self.strongest.iter_mut().find(|strongest| strongest.code == code) {
            Some(strongest) => {
                let below = of_code.partition_point(|(_, db_hz)| *db_hz <= strongest.db_hz);
                let (up_db, down_db) = QUANTILE_STEPS_DB;
                strongest.db_hz += up_db * (of_code.len() - below) as f64 - down_db * below as f64;
            }
            None => self.strongest.push(Strongest { code, db_hz: median_db_hz }),
        }
    }

    /// The C/N0 to use in the variance of an observation, relative to that of the strongest
    /// satellites (dB); `None` without C/N0.
    pub(crate) fn relative_db(&self, observation: &Observation) -> Option<f64> {
        let db_hz = observation.cn0_db_hz?;
        let Observation { satellite, code, .. } = *observation;
        let strongest = self.strongest.iter().find(|strongest| strongest.code == code);
        let strongest_db_hz = strongest.map_or(db_hz, |strongest| strongest.db_hz);
        let known = self.levels.binary_search_by_key(&(satellite, code), |level| level.signal);
        let own_db_hz = known.map_or(db_hz, |index| self.levels[index].db_hz);
        let below_db = own_db_hz.max(strongest_db_hz - SPREAD_DB) - db_hz;
        Some(db_hz - strongest_db_hz - WEIGHT * (below_db - STEADY_DB).max(0.0))
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

    /// 45 dB-Hz, 30 s later 33: the level has faded to 43, Δ = 10 dB, and S = 33 − 45 dB counts as
    /// −12 − 2·7 = −26 dB. A signal 2 dB below its level keeps S = −4 dB.
    #[test]
    fn a_dimmed_signal_worked_by_hand() {
        let levels = levels(&[(0.0, &[(1, 45.0)]), (30.0, &[(1, 33.0)])]);
        let relative = |cn0| levels.relative_db(&observation(1, cn0)).unwrap();
        let strongest = 45.0 - QUANTILE_STEPS_DB.1; // One step down.
        assert!((relative(33.0) - (33.0 - strongest - 14.0)).abs() < 1e-9, "{}", relative(33.0));
        assert!((relative(41.0) - (41.0 - strongest)).abs() < 1e-9, "{}", relative(41.0));
    }

    /// A satellite that was never strong is measured against the strongest ones: 45 − 10 = 35 dB-Hz
    /// at least, so that 30 dB-Hz are 5 dB below, and −15 dB count as −15 − 2·2 dB.
    #[test]
    fn a_signal_that_was_never_strong_is_dimmed_too() {
        let levels = levels(&[(0.0, &[(1, 45.0), (2, 30.0)])]);
        let relative = levels.relative_db(&observation(2, 30.0)).unwrap();
        assert!((relative + 19.0).abs() < 0.1, "{relative}");
    }

    /// The median of 45, 30 and 40 dB-Hz, then one of three above it: 40 + 0.19 − 2·0.01 = 40.17
    /// dB-Hz, in any order of the satellites.
    #[test]
    fn the_strongest_worked_by_hand() {
        let mut seen = [(1, 45.0), (2, 30.0), (3, 40.0)];
        for _ in 0..2 {
            let levels = levels(&[(0.0, &seen), (1.0, &seen)]);
            let relative = levels.relative_db(&observation(1, 45.0)).unwrap();
            assert!((relative - (45.0 - 40.17)).abs() < 1e-9, "{relative}");
            seen.reverse();
        }
    }

    /// A receiver that states C/N0 8 dB higher has the same variances.
    #[test]
    fn another_scale_of_cn0_changes_nothing() {
        let seen = |shift_db: f64| {
            let epochs = [(0.0, [(1, 45.0), (2, 30.0)]), (1.0, [(1, 40.0), (2, 38.0)])];
            let shifted =
                epochs.map(|(at, seen)| (at, seen.map(|(number, cn0)| (number, cn0 + shift_db))));
            let epochs = shifted.each_ref().map(|(at, seen)| (*at, &seen[..]));
            let levels = levels(&epochs);
            [(1, 33.0), (2, 38.0)]
                .map(|(number, cn0)| levels.relative_db(&observation(number, cn0 + shift_db)))
        };
        for (stated, shifted) in seen(0.0).into_iter().zip(seen(8.0)) {
            assert!((stated.unwrap() - shifted.unwrap()).abs() < 1e-9, "{stated:?} {shifted:?}");
        }
    }

    #[test]
    fn without_cn0_there_is_nothing_to_say() {
        let mut silent = observation(1, 0.0);
        silent.cn0_db_hz = None;
        assert_eq!(SignalLevels::default().relative_db(&silent), None);
        assert_eq!(SignalLevels::default().relative_db(&observation(1, 20.0)), Some(0.0));
    }
}
