//! How many rows one statement of SQLite writes.

/// Rows per statement. Few different texts are prepared, and none has more than 32 766 parameters.
pub(super) const ROWS_PER_STATEMENT: [usize; 8] = [128, 64, 32, 16, 8, 4, 2, 1];

/// The text of an insert of `rows` rows.
pub(super) fn with_values(insert: &str, columns: usize, rows: usize, conflict: &str) -> String {
    let row = format!("({})", vec!["?"; columns].join(","));
    format!("{insert} VALUES {}{conflict}", vec![row; rows].join(","))
}
