//! Finds epoch numbers by time. Within an arc of a session, time rises with the number. So a search
//! in the index of numbers finds a time with few reads, and times need no index.

use crate::gnss::GpsTime;

use super::pool::reading;
use super::{SessionKey, Store, StoreError};

/// The numbers of the epochs in a span of time.
#[derive(Clone, Copy, Debug)]
pub(super) struct Numbers {
    /// The first one.
    pub(super) first: i64,
    /// The last one.
    pub(super) last: i64,
    /// Whether epochs outside the span may lie between them, because they are of several arcs.
    pub(super) has_others: bool,
}

/// An epoch: its number and time (ns).
type Found = (i64, i64);

const FIRST_FROM: &str = "SELECT seq, gps_time_ns FROM epochs \
    WHERE session = $1 AND $2 <= seq AND seq <= $3 ORDER BY seq LIMIT 1";
const LAST_UNTIL: &str = "SELECT seq, gps_time_ns FROM epochs \
    WHERE session = $1 AND $2 <= seq AND seq <= $3 ORDER BY seq DESC LIMIT 1";

impl Store {
    /// The numbers of the first and the last stored epoch of a session above number `after` and in
    /// a span of time, over all arcs. Epochs outside the span may lie between them.
    ///
    /// # Errors
    /// The database fails.
    pub(crate) async fn epoch_numbers(
        &self,
        session: SessionKey,
        after: Option<u64>,
        (from, to): (Option<GpsTime>, Option<GpsTime>),
    ) -> Result<Option<(u64, u64)>, StoreError> {
        let Some(Numbers { first, last, .. }) = self.numbers_between(session, from, to).await?
        else {
            return Ok(None);
        };
        let first = after.map_or(first, |after| first.max(after as i64 + 1));
        let ends = self.found(FIRST_FROM, session, (first, last)).await?;
        let ends = ends.zip(self.found(LAST_UNTIL, session, (first, last)).await?);
        Ok(ends.map(|(first, last)| (first.0 as u64, last.0 as u64)))
    }

    /// The first and last epoch number of a span of time, over all arcs of a session.
    pub(super) async fn numbers_between(
        &self,
        session: SessionKey,
        from: Option<GpsTime>,
        to: Option<GpsTime>,
    ) -> Result<Option<Numbers>, StoreError> {
        if from.is_none() && to.is_none() {
            return Ok(Some(Numbers { first: 0, last: i64::MAX, has_others: false }));
        }
        let ends = self.arcs(session).await?.into_iter().map(|seq| seq as i64).chain([i64::MAX]);
        let (mut span, mut begin) = (None::<Numbers>, 0);
        for end in ends {
            if let Some((first, last)) =
                self.numbers_in_arc(session, (begin, end), from, to).await?
            {
                let has_others = span.is_some();
                let first = span.map_or(first, |earlier| earlier.first);
                span = Some(Numbers { first, last, has_others });
            }
            begin = end.saturating_add(1);
        }
        Ok(span)
    }

    /// Like [`Self::numbers_between`], within an arc that is given by its first and last number.
    async fn numbers_in_arc(
        &self,
        session: SessionKey,
        (first, last): (i64, i64),
        from: Option<GpsTime>,
        to: Option<GpsTime>,
    ) -> Result<Option<(i64, i64)>, StoreError> {
        let ends = self.found(FIRST_FROM, session, (first, last)).await?;
        let ends = ends.zip(self.found(LAST_UNTIL, session, (first, last)).await?);
        let Some((oldest, newest)) = ends else { return Ok(None) };
        let begin = match from {
            None => Some(oldest.0),
            Some(from) => self.first_not_before(session, from.as_ns(), oldest, newest).await?,
        };
        // The first epoch after the span. Without such an epoch, the span reaches to the end of the
        // arc.
        let beyond = match to {
            None => None,
            Some(to) if to.as_ns() == i64::MAX => None,
            Some(to) => self.first_not_before(session, to.as_ns() + 1, oldest, newest).await?,
        };
        let end = beyond.map_or(last, |beyond| beyond - 1);
        Ok(begin.filter(|begin| *begin <= end).map(|begin| (begin, end)))
    }

    /// Number of the first epoch at this time or later, between two epochs of an arc.
    ///
    /// The search alternates between interpolation, in proportion to the time, and halving of the
    /// numbers. So it needs at most two steps per bit of the number of epochs.
    async fn first_not_before(
        &self,
        session: SessionKey,
        time_ns: i64,
        oldest: Found,
        newest: Found,
    ) -> Result<Option<i64>, StoreError> {
        if newest.1 < time_ns {
            return Ok(None);
        }
        // `before` is earlier than the time, `found` is not; the epochs between are not known yet.
        let (mut before, mut found, mut halves) = (oldest, newest, false);
        if time_ns <= oldest.1 {
            return Ok(Some(oldest.0));
        }
        while before.0 + 1 < found.0 {
            let middle = if halves {
                i64::midpoint(before.0, found.0)
            } else {
                interpolated(time_ns, before, found)
            };
            halves = !halves;
            match self.found(FIRST_FROM, session, (middle, found.0 - 1)).await? {
                None => match self.found(LAST_UNTIL, session, (before.0 + 1, middle - 1)).await? {
                    None => break,
                    Some(epoch) if epoch.1 < time_ns => break,
                    Some(epoch) => found = epoch,
                },
                Some(epoch) if epoch.1 < time_ns => before = epoch,
                Some(epoch) => found = epoch,
            }
        }
        Ok(Some(found.0))
    }

    async fn found(
        &self,
        sql: &'static str,
        session: SessionKey,
        (first, last): (i64, i64),
    ) -> Result<Option<Found>, StoreError> {
        let row: Result<Option<Found>, _> = reading!(list &self.pool, pool => {
            sqlx::query_as(sql).bind(session.0).bind(first).bind(last).fetch_optional(pool).await
        });
        row.map_err(StoreError::database("finding a time"))
    }
}

/// A number between those of two epochs, in proportion to the time.
fn interpolated(time_ns: i64, before: Found, found: Found) -> i64 {
    let (numbers, times) = (found.0 - before.0, (found.1 as f64) - (before.1 as f64));
    let fraction = (time_ns as f64 - before.1 as f64) / times.max(1.0);
    before.0 + ((numbers as f64 * fraction) as i64).clamp(1, numbers - 1)
}
