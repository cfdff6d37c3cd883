//! Which sessions a list has.

/// Which sessions a list has, and in which order.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct SessionFilter {
    /// Only closed sessions, or only open ones.
    pub is_closed: Option<bool>,
    /// Only those of this mode; empty for all.
    pub mode: String,
    /// Only those with exactly this label; empty for all.
    pub label: String,
    /// The oldest session first, not the newest.
    pub oldest_first: bool,
}

impl SessionFilter {
    /// Column of `is_closed` that [`condition`] compares: 0 for all, 1 for open, 2 for closed.
    pub(super) fn closed_column(&self) -> i32 {
        self.is_closed.map_or(0, |is_closed| if is_closed { 2 } else { 1 })
    }

    /// Row key before the first session of the list.
    pub(super) const fn start(&self) -> i64 {
        if self.oldest_first { i64::MIN } else { i64::MAX }
    }
}

/// The end of a query of `sessions s` and their heads `h`, from `WHERE` on. It compares the tenant,
/// the key before the page, the number of rows, and the filter's columns.
macro_rules! condition {
    ($after:literal) => {
        concat!(
            "WHERE s.tenant = $1 AND s.deleted_unix_ms IS NULL ",
            "AND ($4 = 0 OR (h.closed_unix_ms IS NULL) = ($4 = 1)) ",
            "AND ($5 = '' OR s.mode = $5) AND ($6 = '' OR s.label = $6) ",
            $after,
            " LIMIT $3"
        )
    };
    (newest_first) => {
        $crate::store::session_filter::condition!("AND s.key < $2 ORDER BY s.key DESC")
    };
    (oldest_first) => {
        $crate::store::session_filter::condition!("AND $2 < s.key ORDER BY s.key")
    };
}
pub(super) use condition;
