//! Parameters of prepared statements, bound one after another.

use rusqlite::{Statement, ToSql};

/// A statement while its parameters are bound.
pub(super) struct Binding<'s, 'c> {
    statement: &'s mut Statement<'c>,
    bound: usize,
}

impl<'s, 'c> Binding<'s, 'c> {
    /// A statement without bound parameters.
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

/// The text of a statement that is shared with Postgres, with numbered parameters. SQLite would
/// treat `$2` as a name, and number names in the order in which they occur.
pub(super) fn by_number(sql: &str) -> String {
    sql.replace('$', "?")
}

/// The text of an insert of one row.
pub(super) fn with_values(insert: &str, columns: usize, conflict: &str) -> String {
    format!("{insert} VALUES ({}){conflict}", vec!["?"; columns].join(","))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The second parameter comes first in the text.
    #[test]
    fn parameters_have_their_numbers() {
        let connection = rusqlite::Connection::open_in_memory().unwrap();
        let difference = by_number("SELECT $2 - $1");
        let difference: i64 = connection.query_row(&difference, (3, 10), |row| row.get(0)).unwrap();
        assert_eq!(difference, 7);
    }
}
