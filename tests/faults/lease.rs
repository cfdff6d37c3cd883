//! One service writes to a database: a second one is refused by the name of the first.

use graphfix::store::{Store, StoreError};
use sqlx::{Connection, PgConnection};

use crate::support::database::{Database, on_both_databases, on_postgres};
use crate::support::sessions::{created, desk, epoch};
use crate::support::wait::until;

on_both_databases!(
    a_second_service_is_refused_by_name,
    a_session_closed_elsewhere_takes_no_epoch,
    nothing_is_committed_below_the_fence,
);

async fn alone(url: &str, node: &str) -> Result<Store, StoreError> {
    Store::open_alone(url, node).await
}

/// Opens the store once the lease is free. A process that another test starts inherits the open
/// files of this process, and with them the lock, for a moment.
async fn alone_at_last(url: &str, node: &str) -> Store {
    until("free", async || alone(url, node).await.map_err(|error| error.to_string()), Result::is_ok)
        .await
        .unwrap()
}

async fn a_second_service_is_refused_by_name(database: Database) {
    let first = alone(&database.url, "first").await.unwrap();
    let refused = alone(&database.url, "second").await.unwrap_err();
    assert_eq!(refused.code().name(), "DATABASE_IN_USE");
    assert!(refused.to_string().contains("first"), "{refused}");
    // A replay may read while a service has the lease.
    Store::open_read_only(&database.url).await.unwrap().close().await;
    let sessions = desk(&first).await;
    let id = created(&sessions).await;
    sessions.submit(&id, vec![epoch(1, 1.0)]).await.unwrap();
    first.close().await;
    let second = alone_at_last(&database.url, "second").await;
    let third = alone(&database.url, "third").await.unwrap_err();
    assert!(third.to_string().contains("second"), "{third}");
    second.close().await;
}

/// Two writers without a lease: the head of the session shows one writer that the other has closed
/// the session.
async fn a_session_closed_elsewhere_takes_no_epoch(database: Database) {
    let one = desk(&database.store().await).await;
    let other = desk(&database.store().await).await;
    let id = created(&one).await;
    other.submit(&id, vec![epoch(1, 1.0)]).await.unwrap();
    one.close(&id).await.unwrap();
    let code = async || {
        let refused = other.submit(&id, vec![epoch(2, 2.0)]).await.unwrap_err();
        refused.code().name()
    };
    assert_eq!(code().await, "WRITTEN_ELSEWHERE");
    assert_eq!(code().await, "SESSION_CLOSED");
    assert_eq!(one.get(&id).await.unwrap().durable_through, Some(1));
}

/// After a service with a higher fence has committed to a session, one with a lower fence cannot
/// commit to it any more.
async fn nothing_is_committed_below_the_fence(database: Database) {
    let store = alone(&database.url, "first").await.unwrap();
    let sessions = desk(&store).await;
    let (id, free) = (created(&sessions).await, created(&sessions).await);
    sessions.submit(&id, vec![epoch(1, 1.0)]).await.unwrap();
    database.execute("UPDATE session_heads SET fence = 1000 WHERE last_seq = 1").await;
    let refused = sessions.submit(&id, vec![epoch(2, 2.0)]).await.unwrap_err();
    assert_eq!(refused.code().name(), "WRITTEN_ELSEWHERE");
    sessions.submit(&free, vec![epoch(1, 1.0)]).await.unwrap();
    assert_eq!(sessions.get(&id).await.unwrap().durable_through, Some(1));
    store.close().await;
}

/// Only the holder of the lease commits: a service whose connection the server has ended cannot
/// commit once another service has taken the lease.
#[tokio::test]
async fn a_service_that_lost_the_lease_commits_nothing() {
    on_postgres(async |database| {
        let name = format!("lost_{}", std::process::id());
        let url = format!("{}&application_name={name}", database.url);
        let first = alone(&url, "first").await.unwrap();
        let sessions = desk(&first).await;
        let id = created(&sessions).await;
        sessions.submit(&id, vec![epoch(1, 1.0)]).await.unwrap();
        // The second service already waits for the lease when the first loses its connection.
        let url = database.url.clone();
        let second = tokio::spawn(async move { alone(&url, "second").await });
        let mut server = PgConnection::connect(&database.url).await.unwrap();
        let waits = async || {
            let query = "SELECT COUNT(*) FROM pg_stat_activity
                         WHERE query LIKE '%pg_try_advisory_lock%' AND state = 'idle'
                           AND starts_with(application_name, 'graphfix committer')";
            sqlx::query_scalar::<_, i64>(query).fetch_one(&mut server).await.unwrap()
        };
        until("waiting", waits, |waiting| 0 < *waiting).await;
        let end = "SELECT pg_terminate_backend(pid) FROM pg_stat_activity
                   WHERE starts_with(application_name, $1 || ' committer')";
        let mut ended = false;
        while !second.is_finished() {
            ended |= sqlx::query(end).bind(&name).execute(&mut server).await.is_ok();
            tokio::task::yield_now().await;
        }
        assert!(ended);
        let second = second.await.unwrap().unwrap();
        let refused = sessions.submit(&id, vec![epoch(2, 2.0)]).await.unwrap_err();
        assert_eq!(refused.code().name(), "DATABASE_FAILED", "{refused}");
        let others = desk(&second).await;
        let answer = others.submit(&id, vec![epoch(2, 2.0)]).await.unwrap();
        assert!(!answer.outcomes[0].result.as_ref().unwrap().resent);
        second.close().await;
        // The first service gets the lease again, but its data in memory are outdated.
        let lost = first.lease_lost().await;
        assert_eq!(lost.code().name(), "LEASE_LOST");
        assert!(lost.to_string().contains("second"), "{lost}");
        let refused = sessions.submit(&id, vec![epoch(3, 3.0)]).await.unwrap_err();
        assert_eq!(refused.code().name(), "DATABASE_FAILED", "{refused}");
        assert!(refused.to_string().contains("second"), "{refused}");
        first.close().await;
        let third = alone(&database.url, "third").await.unwrap();
        third.close().await;
    })
    .await;
}
