//! Parameters of prepared statements, bound one after another.

use rusqlite::{Statement, ToSql};

/// A statement whose parameters are being bound.
pub(super) struct Binding<'s, 'c> {
    statement: &'s mut Statement<'c>,
    bound: usize,
}

impl<'s, 'c> Binding<'s, 'c> {
    /// A statement of which none are bound yet.
    pub(super) const fn of(statement: &'s mut Statement<'c>) -> Self {
        Self { statement, bound: 0 }
    }

    /// Binds the next parameter.
    pub(super) fn bind(mut self, value: impl ToSql) -> rusqlite::Result<Self> {
        self.bound += 1;
        self.statement.raw_bind_parameter(self.bound, value)?;
        Ok(self)
    }

    /// Binds the next parameters.
    pub(super) fn bind_all(
        self,
        values: impl IntoIterator<Item = impl ToSql>,
    ) -> rusqlite::Result<Self> {
        values.into_iter().try_fold(self, Self::bind)
    }

    /// Runs the statement. Returns the number of rows that it has changed.
    pub(super) fn execute(self) -> rusqlite::Result<usize> {
        debug_assert_eq!(self.bound, self.statement.parameter_count());
        self.statement.raw_execute()
    }
}

/// The text of an insert of one row.
pub(super) fn with_values(insert: &str, columns: usize, conflict: &str) -> String {
    format!("{insert} VALUES ({}){conflict}", vec!["?"; columns].join(","))
}
