//! Lists in pages of bounded size.

use super::StoreError;

/// A page of a list.
#[derive(Clone, Debug, PartialEq)]
pub struct Page<T> {
    /// The items on the page.
    pub items: Vec<T>,
    /// Token of the next page; `None` on the last page.
    pub next_page_token: Option<String>,
}

impl<T> Page<T> {
    /// A page of `rows`, which were read with one row more than `size`. `token` returns the token
    /// of the page after an item.
    pub(super) fn of(mut rows: Vec<T>, size: usize, token: impl FnOnce(&T) -> String) -> Self {
        let more = size < rows.len();
        rows.truncate(size);
        let next_page_token = if more { rows.last().map(token) } else { None };
        Self { items: rows, next_page_token }
    }

    /// The same page with each item converted.
    ///
    /// # Errors
    /// The first error of a conversion.
    pub fn try_map<U, E>(self, turn: impl FnMut(T) -> Result<U, E>) -> Result<Page<U>, E> {
        let items = self.items.into_iter().map(turn).collect::<Result<_, _>>()?;
        Ok(Page { items, next_page_token: self.next_page_token })
    }
}

/// Checks a page size against 1 to `limit`. Returns the number of rows to query.
pub(super) fn rows_asked(size: usize, limit: usize) -> Result<i64, StoreError> {
    let allowed = (1..=limit).contains(&size);
    if allowed { Ok(size as i64 + 1) } else { Err(StoreError::PageSize { size, limit }) }
}
