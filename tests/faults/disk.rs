//! The disk, the clock and the descriptors of a running service fail.

#![cfg(target_os = "linux")]

use std::process::{self, Command};
use std::time::Duration;

use sqlx::{Connection, PgConnection};
use tokio::time::timeout;

use crate::support::database::{Database, on_both_databases};
use crate::support::failing::Failing;
use crate::support::wait::stays;

on_both_databases!(a_clock_that_steps_loses_nothing, descriptors_that_run_out_are_refused);

/// The disk is full, broken, or does not synchronise.
#[tokio::test]
async fn a_disk_that_fails_is_refused_and_served_again() {
    let database = Database::sqlite();
    let mut service = Failing::start(&database.url).await;
    for (index, fault) in ["full", "broken", "unsynced", "full"].into_iter().enumerate() {
        service.fails_and_recovers(fault, 10 * index as u64 + 1).await;
    }
    service.finish().await;
}

/// A commit that takes longer than its deadline is refused. It still ends, and a resent epoch is
/// then answered from the store.
#[tokio::test]
async fn a_slow_disk_is_refused_and_served_again() {
    let database = Database::sqlite();
    let mut service = Failing::start(&database.url).await;
    service.fails_and_recovers("slow 7", 1).await;
    service.finish().await;
}

/// The commit of a reset takes longer than its deadline and still ends. Epochs that are sent
/// meanwhile begin the new arc, as a replay does.
#[tokio::test]
async fn a_reset_that_ends_late_is_seen_by_the_next_epochs() {
    let database = Database::sqlite();
    let mut service = Failing::start_drive(&database.url).await;
    for seq in 1..=20 {
        service.push(seq).await.unwrap();
    }
    service.set("slow 7");
    assert_eq!(service.reset().await.unwrap_err(), "DATABASE_FAILED");
    service.set("none");
    service.serves_again("slow reset", 21).await;
    for seq in 22..=30 {
        service.push(seq).await.unwrap();
    }
    service.finish().await;
}

/// The commit of a closing takes longer than its deadline and still ends. A watch then ends, too.
#[tokio::test]
async fn a_closing_that_ends_late_ends_the_watches() {
    let database = Database::sqlite();
    let mut service = Failing::start(&database.url).await;
    let mut watch = service.watch().await;
    service.push(1).await.unwrap();
    while watch.message().await.unwrap().unwrap().solutions.is_empty() {}
    service.set("slow 7");
    assert_eq!(service.close().await.unwrap_err(), "DATABASE_FAILED");
    service.set("none");
    let last = async {
        let mut last = None;
        while let Some(message) = watch.message().await.unwrap() {
            last = Some(message);
        }
        last
    };
    let last = timeout(Duration::from_secs(30), last).await.expect("the watch has not ended");
    assert!(last.unwrap().closed);
    service.finish().await;
}

/// The clock steps by 20 years back, and by hours and a day: no epoch is refused.
async fn a_clock_that_steps_loses_nothing(database: Database) {
    let mut service = Failing::start(&database.url).await;
    service.push(1).await.unwrap();
    // Twenty years behind: what is stored tells that the clock is wrong, and that the epoch is not.
    for (seq, clock) in
        [(2, "clock -630720000"), (3, "clock 86400"), (4, "clock -7200"), (5, "none")]
    {
        service.set(clock);
        service.push(seq).await.unwrap();
        service.is_ready(200).await;
    }
    service.finish().await;
}

/// Limits the file descriptors of a running service.
fn limit_descriptors(service: &Failing, limit: u64) {
    let process = service.server.process().to_string();
    let mut command = Command::new("prlimit");
    let limited = command.args(["--pid", &process, &format!("--nofile={limit}:")]).status();
    assert!(limited.expect("prlimit is installed").success());
}

/// The committer's connection is lost while no other can be opened.
async fn descriptors_that_run_out_are_refused(database: Database) {
    let (is_file, name) = (database.url.starts_with("sqlite"), format!("few_{}", process::id()));
    let url =
        if is_file { database.url } else { format!("{}&application_name={name}", database.url) };
    let mut service = Failing::start(&url).await;
    service.push(1).await.unwrap();
    if is_file {
        service.set("broken");
        service.refuses("broken", 2).await;
    }
    limit_descriptors(&service, 3);
    if is_file {
        // If a connection is just being opened, the broken disk makes it fail. No other is opened
        // afterwards.
        let refused = async || service.push(2).await;
        stays("refused", Duration::from_secs(2), refused, Result::is_err).await;
    }
    service.set("none");
    if !is_file {
        let mut server = PgConnection::connect(&url).await.unwrap();
        let end = "SELECT pg_terminate_backend(pid) FROM pg_stat_activity
                   WHERE starts_with(application_name, $1 || ' committer')";
        let ended = sqlx::query(end).bind(&name).execute(&mut server).await.unwrap();
        assert_eq!(ended.rows_affected(), 1);
    }
    service.refuses("no descriptors", 2).await;
    service.refuses("no descriptors", 2).await;
    limit_descriptors(&service, 1_024);
    service.serves_again("no descriptors", 2).await;
    service.finish().await;
}
