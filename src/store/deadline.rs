//! Longest times of statements. A database that does not answer must not block its callers.

use std::future::Future;
use std::io;
use std::time::Duration;

use tokio::time::timeout;

/// Deadline of a statement, and of a transaction of the committer.
pub(super) const DEADLINE: Duration = Duration::from_secs(5);
/// Deadline of a transaction of many statements, such as a file of navigation data, and of a read
/// of many rows, such as all epochs of a base.
pub(super) const BULK_DEADLINE: Duration = Duration::from_secs(30);

/// The result of `work`, or an error if it takes longer than `limit`.
pub(super) async fn within<T>(
    limit: Duration,
    work: impl Future<Output = Result<T, sqlx::Error>>,
) -> Result<T, sqlx::Error> {
    timeout(limit, work).await.unwrap_or_else(|_| {
        let message = format!("the database did not answer within {} s", limit.as_secs_f64());
        Err(sqlx::Error::Io(io::Error::new(io::ErrorKind::TimedOut, message)))
    })
}
