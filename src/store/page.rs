//! Lists in bounded pages.

use super::StoreError;

/// A part of a list.
#[derive(Clone, Debug, PartialEq)]
pub struct Page<T> {
    /// What is on the page.
    pub items: Vec<T>,
    /// Names the next page; `None` on the last.
    pub next_page_token: Option<String>,
}

impl<T> Page<T> {
    /// The page of `rows`, of which one more than `size` was asked for; `token` names the page
    /// after its item.
    pub(super) fn of(mut rows: Vec<T>, size: usize, token: impl FnOnce(&T) -> String) -> Self {
        let more = size < rows.len();
        rows.truncate(size);
        let next_page_token = if more { rows.last().map(token) } else { None };
        Self { items: rows, next_page_token }
    }

    /// The same page of other items.
    ///
    /// # Errors
    /// The first item that cannot be turned.
    pub fn try_map<U, E>(self, turn: impl FnMut(T) -> Result<U, E>) -> Result<Page<U>, E> {
        let items = self.items.into_iter().map(turn).collect::<Result<_, _>>()?;
        Ok(Page { items, next_page_token: self.next_page_token })
    }
}

/// Refuses a page size that is zero or above `limit`; returns the rows to ask for.
pub(super) fn rows_asked(size: usize, limit: usize) -> Result<i64, StoreError> {
    let allowed = (1..=limit).contains(&size);
    if allowed { Ok(size as i64 + 1) } else { Err(StoreError::PageSize { size, limit }) }
}
