//! How well pseudoranges agree with the answered positions, over a span of time.

use crate::gnss::{GpsTime, SatelliteId};

use super::desk::Sessions;
use super::explanation::{Explaining, SatelliteRole};
use super::{SessionError, SessionId};

/// Most epochs of an answer. To read an epoch, those before it in its chain are read, too.
pub const RESIDUAL_POINTS: usize = 500;

/// The epochs whose residuals are asked for.
#[derive(Clone, Debug, PartialEq)]
pub struct ResidualQuery {
    /// First time tag; `None` for the first stored epoch.
    pub from: Option<GpsTime>,
    /// Last time tag; `None` for the last stored epoch.
    pub to: Option<GpsTime>,
    /// Number of epochs at most, 1 to [`RESIDUAL_POINTS`]. Their numbers are evenly spaced.
    pub points: usize,
}

/// The residuals of one epoch's pseudoranges: each minus the model at the answered position,
/// against the median of its constellation.
#[derive(Clone, Debug, PartialEq)]
pub struct EpochResiduals {
    /// Number of the epoch.
    pub seq: u64,
    /// Its time tag.
    pub time: GpsTime,
    /// Used satellites with a residual.
    pub satellites: usize,
    /// Root mean square of the residuals (m); `None` without any.
    pub rms_m: Option<f64>,
    /// The satellite with the largest absolute residual, and that residual (m).
    pub largest: Option<(SatelliteId, f64)>,
}

impl Sessions {
    /// The residuals of evenly spaced epochs, in order of their numbers. Where a number is missing,
    /// the epoch with the next number is taken, so there may be fewer epochs than asked for.
    ///
    /// # Errors
    /// No session has this id, the number of points is out of range, the tenant has used up its
    /// processor time, or the store fails.
    pub async fn residuals(
        &self,
        id: &SessionId,
        query: &ResidualQuery,
    ) -> Result<Vec<EpochResiduals>, SessionError> {
        let (points, limit) = (query.points, RESIDUAL_POINTS);
        if !(1..=limit).contains(&points) {
            return Err(SessionError::TooManyPoints { points, limit });
        }
        let key = self.row(id).await?.key;
        self.meter().admit_computation()?;
        let span = (query.from, query.to);
        let Some((first, last)) = self.store().epoch_numbers(key, None, span).await? else {
            return Ok(Vec::new());
        };
        let mut explaining = Explaining::of(self, id);
        let mut all: Vec<EpochResiduals> = Vec::new();
        for seq in spaced(first, last, points) {
            if all.last().is_some_and(|before| seq <= before.seq) {
                continue; // The epoch before was the next one behind this number, too.
            }
            let stored = self.store().listed_epochs_after(key, seq.checked_sub(1), 1).await?;
            let Some(stored) = stored.into_iter().next() else { break };
            if last < stored.solution.seq {
                break;
            }
            let views = explaining.satellites(&stored).await?;
            let used = views.iter().filter(|view| view.role == SatelliteRole::Used);
            let residuals = used.filter_map(|view| Some((view.satellite, view.residual_m?)));
            let (seq, time) = (stored.solution.seq, stored.epoch.time);
            all.push(EpochResiduals::of(seq, time, residuals.collect()));
        }
        Ok(all)
    }
}

impl EpochResiduals {
    fn of(seq: u64, time: GpsTime, residuals: Vec<(SatelliteId, f64)>) -> Self {
        let squares: f64 = residuals.iter().map(|(_, metres)| metres * metres).sum();
        let satellites = residuals.len();
        let rms_m = (0 < satellites).then(|| (squares / satellites as f64).sqrt());
        let largest = residuals.into_iter().max_by(|(_, a), (_, b)| a.abs().total_cmp(&b.abs()));
        Self { seq, time, satellites, rms_m, largest }
    }
}

/// At most `points` numbers from `first` to `last`, evenly spaced. Two or more include both ends.
fn spaced(first: u64, last: u64, points: usize) -> impl Iterator<Item = u64> {
    let span = last - first;
    let steps = (points as u64 - 1).min(span);
    (0..=steps).map(move |step| {
        let share = u128::from(span) * u128::from(step) / u128::from(steps.max(1));
        first + share as u64
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_evenly_spaced() {
        let numbers = |first, last, points| Vec::from_iter(spaced(first, last, points));
        assert_eq!(numbers(1, 9, 3), [1, 5, 9]);
        assert_eq!(numbers(1, 9, 1), [1]);
        assert_eq!(numbers(7, 7, 200), [7]);
        assert_eq!(numbers(3, 5, 200), [3, 4, 5]);
        assert_eq!(numbers(0, u64::MAX, 2), [0, u64::MAX]);
    }

    /// 3, -4 and 0 m: the mean square is 25/3 m².
    #[test]
    fn residuals_are_summed_up() {
        let satellite = |text: &str| text.parse::<SatelliteId>().expect("a satellite");
        let time = GpsTime::from_week_seconds(2400, 0.0);
        let [one, two, three] = ["G01", "G02", "E03"].map(satellite);
        let of = EpochResiduals::of(5, time, vec![(one, 3.0), (two, -4.0), (three, 0.0)]);
        assert_eq!(of.largest, Some((two, -4.0)));
        assert_eq!(of.rms_m, Some((25.0_f64 / 3.0).sqrt()));
        let none = EpochResiduals::of(6, time, Vec::new());
        assert_eq!((none.satellites, none.rms_m, none.largest), (0, None, None));
    }
}
