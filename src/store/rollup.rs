//! Rollups as readers see them: sums and extremes of the first answers of a span of time.

use crate::gnss::{GpsTime, Status};

use super::StoreError;
use super::codec::status_number;

/// Lengths of the buckets of rollups (s). They begin at whole minutes and hours of GPS time.
pub(crate) const MINUTE_S: i64 = 60;
pub(crate) const HOUR_S: i64 = 3_600;
/// The quantities whose spread rollups contain, with the unit at the end of their columns.
pub(super) const QUANTITIES: [(&str, &str); 4] =
    [("height", "_m"), ("sigma", "_m"), ("satellites", ""), ("age", "_s")];

/// The status of a stored number in a row of `what`.
///
/// # Errors
/// No status has this number.
pub(super) fn status_of(number: i64, what: &'static str) -> Result<Status, StoreError> {
    let is_its = |status: &Status| i64::from(status_number(*status)) == number;
    Status::ALL.into_iter().find(is_its).ok_or_else(|| StoreError::CorruptText {
        what,
        why: format!("{number} is not the number of a status"),
    })
}

/// How many epochs have each status.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct StatusCounts([u64; Status::ALL.len()]);

impl StatusCounts {
    /// These counts, in order from the status `NONE` to the best one.
    pub(super) fn of(counts: [i64; Status::ALL.len()]) -> Self {
        Self(counts.map(|count| count.max(0) as u64))
    }

    /// Each status with its count, from the worst to the best.
    pub fn iter(&self) -> impl Iterator<Item = (Status, u64)> {
        Status::ALL.into_iter().zip(self.0)
    }

    /// The number of epochs.
    pub fn total(&self) -> u64 {
        self.0.iter().sum()
    }

    /// The worst and the best status that occur.
    pub fn ends(&self) -> Option<(Status, Status)> {
        let given = || self.iter().filter(|(_, count)| *count != 0).map(|(status, _)| status);
        given().next().zip(given().last())
    }

    /// Adds the counts of other epochs.
    pub(crate) fn add(&mut self, other: &Self) {
        self.0.iter_mut().zip(other.0).for_each(|(count, more)| *count += more);
    }
}

/// The values of a quantity over some epochs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spread {
    /// The smallest value.
    pub min: f64,
    /// The largest value.
    pub max: f64,
    /// The last value.
    pub last: f64,
    /// The sum of the values.
    pub sum: f64,
    /// The number of values.
    pub count: u64,
}

impl Spread {
    /// The mean of the values.
    pub fn mean(&self) -> f64 {
        self.sum / self.count as f64
    }

    fn and_then(self, later: Self) -> Self {
        Self {
            min: self.min.min(later.min),
            max: self.max.max(later.max),
            last: later.last,
            sum: self.sum + later.sum,
            count: self.count + later.count,
        }
    }
}

/// An area between two parallels and two meridians (degrees).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds {
    /// Least latitude.
    pub south_deg: f64,
    /// Western meridian. It lies east of `east_deg` if the area crosses 180°.
    pub west_deg: f64,
    /// Greatest latitude.
    pub north_deg: f64,
    /// Eastern meridian.
    pub east_deg: f64,
}

impl Bounds {
    /// Whether a position lies in the area (degrees).
    pub(super) fn contains(&self, latitude_deg: f64, longitude_deg: f64) -> bool {
        let Self { south_deg, west_deg, north_deg, east_deg } = *self;
        let (is_east, is_west) = (west_deg <= longitude_deg, longitude_deg <= east_deg);
        let is_between = if west_deg <= east_deg { is_east && is_west } else { is_east || is_west };
        south_deg <= latitude_deg && latitude_deg <= north_deg && is_between
    }

    fn around(self, other: Self) -> Self {
        Self {
            south_deg: self.south_deg.min(other.south_deg),
            west_deg: self.west_deg.min(other.west_deg),
            north_deg: self.north_deg.max(other.north_deg),
            east_deg: self.east_deg.max(other.east_deg),
        }
    }
}

/// Sums and extremes of the first answers to the epochs of a bucket, or of several.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rollup {
    /// When its bucket begins.
    pub begin: GpsTime,
    /// Earliest and latest time tag.
    pub span: (GpsTime, GpsTime),
    /// Number of the last epoch.
    pub last_seq: u64,
    /// Number of epochs with each status.
    pub statuses: StatusCounts,
    /// Status of the last epoch.
    pub status: Status,
    /// The last position: latitude and longitude (degrees).
    pub position_deg: Option<(f64, f64)>,
    /// A box around the positions. Its longitudes are the least and the greatest.
    pub bounds: Option<Bounds>,
    /// Height above the ellipsoid (m).
    pub height_m: Option<Spread>,
    /// Standard deviation along the worst horizontal direction (m).
    pub sigma_m: Option<Spread>,
    /// Number of satellites used.
    pub satellites: Option<Spread>,
    /// Age of the base epoch (s).
    pub age_s: Option<Spread>,
}

impl Rollup {
    /// Adds the rollup of another bucket of the same session.
    pub(crate) fn add(&mut self, other: &Self) {
        // Times of an earlier arc may be later than those of a later one; numbers always rise.
        let (earlier, later) =
            if self.last_seq < other.last_seq { (*self, *other) } else { (*other, *self) };
        let spread =
            |of: fn(&Self) -> Option<Spread>| merged(of(&earlier), of(&later), Spread::and_then);
        let mut statuses = earlier.statuses;
        statuses.add(&later.statuses);
        *self = Self {
            begin: earlier.begin.min(later.begin),
            span: (earlier.span.0.min(later.span.0), earlier.span.1.max(later.span.1)),
            statuses,
            position_deg: later.position_deg.or(earlier.position_deg),
            bounds: merged(earlier.bounds, later.bounds, Bounds::around),
            height_m: spread(|rollup| rollup.height_m),
            sigma_m: spread(|rollup| rollup.sigma_m),
            satellites: spread(|rollup| rollup.satellites),
            age_s: spread(|rollup| rollup.age_s),
            ..later
        };
    }
}

/// Both values combined, or the one that exists.
fn merged<T>(earlier: Option<T>, later: Option<T>, both: impl Fn(T, T) -> T) -> Option<T> {
    match (earlier, later) {
        (Some(earlier), Some(later)) => Some(both(earlier, later)),
        (earlier, later) => earlier.or(later),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_area_may_cross_the_antimeridian() {
        let fiji = Bounds { south_deg: -20.0, west_deg: 176.0, north_deg: -12.0, east_deg: -178.0 };
        assert!(fiji.contains(-18.1, 178.4) && fiji.contains(-16.8, -179.9));
        assert!(!fiji.contains(-18.1, 0.0) && !fiji.contains(-21.0, 178.4));
        let whole = Bounds { south_deg: -90.0, west_deg: -180.0, north_deg: 90.0, east_deg: 180.0 };
        assert!(whole.contains(90.0, 180.0) && whole.contains(0.0, -180.0));
    }

    fn rollup(last_seq: u64, second: f64, sigma_m: f64) -> Rollup {
        let time = GpsTime::from_week_seconds(2400, second);
        let spread = Spread { min: sigma_m, max: sigma_m, last: sigma_m, sum: sigma_m, count: 1 };
        Rollup {
            begin: time,
            span: (time, time),
            last_seq,
            statuses: StatusCounts::of([0, 1, 0, 0, 0, 0]),
            status: Status::Single,
            position_deg: Some((1.0, 2.0)),
            bounds: None,
            height_m: None,
            sigma_m: Some(spread),
            satellites: None,
            age_s: None,
        }
    }

    /// The epoch with the higher number is the last one, even if its time is earlier, as after a
    /// reset.
    #[test]
    fn the_last_epoch_is_that_with_the_greatest_number() {
        let mut sum = rollup(1, 120.0, 3.0);
        let last = Rollup { status: Status::Fixed, position_deg: None, ..rollup(2, 60.0, 1.0) };
        sum.add(&Rollup { statuses: StatusCounts::of([0, 0, 0, 0, 0, 1]), ..last });
        assert_eq!(
            (sum.last_seq, sum.status, sum.position_deg),
            (2, Status::Fixed, Some((1.0, 2.0)))
        );
        assert!((sum.span.1 - sum.span.0 - 60.0).abs() < 1e-6);
        assert_eq!(sum.statuses.ends(), Some((Status::Single, Status::Fixed)));
        assert_eq!(sum.statuses.total(), 2);
        let sigma = sum.sigma_m.unwrap();
        assert_eq!((sigma.min, sigma.max, sigma.last, sigma.mean()), (1.0, 3.0, 1.0, 2.0));
    }
}
