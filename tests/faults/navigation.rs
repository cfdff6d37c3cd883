//! The navigation data in memory are always the stored ones, however a push ends. A replay gets the
//! data that were in force.

use futures::poll;
use graphfix::aiding::{AidingDesk, AidingLimits, UPLOAD, device};
use graphfix::gnss::{Ephemeris, KlobucharCoefficients, Navigation};
use graphfix::store::StoreError;
use graphfix::tenant::Tenant;

use crate::support::database::{Database, on_both_databases};
use crate::support::drive::DRIVE;
use crate::support::wait::until;

on_both_databases!(
    past_navigation_data_are_those_that_were_in_force,
    a_push_whose_caller_has_gone_is_known,
    a_push_that_was_not_confirmed_becomes_known,
    what_a_tenant_pushes_removes_nothing_of_others,
);

const OPERATOR: &str = "https://archive.example/brdc.rnx";
const BASE: &str = "base ntrip://caster.example/BASE";

async fn desk(database: &Database) -> AidingDesk {
    AidingDesk::open(database.store().await, AidingLimits::service()).await.unwrap()
}

/// Ephemerides of some satellites, later than those of the drive. The reference times of different
/// numbers are far apart, so they do not contradict each other. Every fourth number also has
/// ionosphere coefficients.
fn later(number: u32) -> Navigation {
    let mut later = Navigation::default();
    for (index, (_, list)) in DRIVE.navigation.satellites().enumerate() {
        let Ephemeris::Keplerian(mut orbit) = list[0].clone() else { continue };
        if index as u32 % 5 == number % 5 {
            let shift_s = 20_000.0 * f64::from(number);
            (orbit.toe, orbit.toc) = (orbit.toe + shift_s, orbit.toc + shift_s);
            later.insert(Ephemeris::Keplerian(orbit));
        }
    }
    if number.is_multiple_of(4) {
        let alpha = [1e-8 * f64::from(number), 0.0, 0.0, 0.0];
        later.klobuchar_gps = Some(KlobucharCoefficients { alpha, beta: [9e4, 0.0, 0.0, 0.0] });
    }
    later
}

/// A newly opened desk finds the data after each push, in any order of pushes. They are as they
/// were, for devices with data of their own and for one without.
async fn past_navigation_data_are_those_that_were_in_force(database: Database) {
    let (live, devices) = (desk(&database).await, [device("A"), device("B"), device("none")]);
    let mut expected = Vec::new();
    let sources = [&*devices[0], UPLOAD, &*devices[1], OPERATOR, &*devices[0], &*devices[1], BASE];
    for (round, source) in (0..60).zip(sources.into_iter().cycle()) {
        live.navigation.push(later(round / 2), source).await.unwrap();
        let current = devices.each_ref().map(|device| live.navigation.current_for(device));
        if expected.len() < current[0].push as usize {
            expected.push(current);
        }
    }
    assert!(20 < expected.len(), "{}", expected.len());
    let own = expected.iter().filter(|[a, _, none]| a.navigation != none.navigation).count();
    assert!(3 < own, "a device had data of its own after {own} pushes");
    let again = desk(&database).await;
    let count = expected.len();
    for index in (0..2 * count).map(|index| index * 17 % count) {
        for (device, then) in devices.iter().zip(&expected[index]) {
            let known = again.navigation.after(then.push, device).await.unwrap();
            assert_eq!(known.push, then.push);
            assert!(known.navigation == then.navigation, "{device} after push {}", then.push);
        }
    }
}

/// The caller drops a push at any moment. If the push is stored, it is also in memory.
async fn a_push_whose_caller_has_gone_is_known(database: Database) {
    let live = desk(&database).await;
    for polls in 1..30 {
        {
            let mut push = Box::pin(live.navigation.push(later(polls), OPERATOR));
            for _ in 0..polls * polls {
                if poll!(&mut push).is_ready() {
                    break;
                }
                tokio::task::yield_now().await;
            }
        }
        let stored = desk(&database).await.navigation.current().push;
        let known = async || live.navigation.current().push;
        until("the stored push is known", known, |known| stored <= *known).await;
    }
    let known = async || live.navigation.current();
    let stored = desk(&database).await.navigation.current();
    until("all is known", known, |known| known.navigation == stored.navigation).await;
}

/// Another desk on the same database stores a push that the first desk does not know. For the first
/// desk this is like a push of its own whose commit was not confirmed.
async fn a_push_that_was_not_confirmed_becomes_known(database: Database) {
    let (live, other) = (desk(&database).await, desk(&database).await);
    live.navigation.push(later(1), OPERATOR).await.unwrap();
    other.navigation.push(later(2), OPERATOR).await.unwrap();
    live.navigation.push(later(3), OPERATOR).await.unwrap();
    let (known, stored) = (live.navigation.current(), desk(&database).await.navigation.current());
    assert_eq!((known.push, known.navigation.len()), (3, stored.navigation.len()));
    assert!(known.navigation == stored.navigation);
}

/// The same issues as those of other numbers, with other orbits and coefficients, so each replaces
/// the previous ones of its source.
fn reissued(number: u32) -> Navigation {
    let mut reissued = Navigation::default();
    for (_, list) in DRIVE.navigation.satellites() {
        let Ephemeris::Keplerian(mut orbit) = list[0].clone() else { continue };
        (orbit.toe, orbit.toc) = (orbit.toe + 1e6, orbit.toc + 1e6);
        orbit.m0_rad += 1e-3 * f64::from(number);
        reissued.insert(Ephemeris::Keplerian(orbit));
    }
    let alpha = [1e-8 * f64::from(number), 0.0, 0.0, 0.0];
    reissued.klobuchar_gps = Some(KlobucharCoefficients { alpha, beta: [9e4, 0.0, 0.0, 0.0] });
    reissued
}

/// Of the data that one tenant pushes the oldest are forgotten, for its own sessions only. All
/// others still get what was in force, in any order of pushes.
async fn what_a_tenant_pushes_removes_nothing_of_others(database: Database) {
    const LIMIT: usize = 100;
    let few = AidingLimits { superseded_ephemerides: LIMIT, ..AidingLimits::service() };
    let open = async || AidingDesk::open(database.store().await, few.clone()).await.unwrap();
    let tenant = |name: &str| Tenant::parse(name).unwrap();
    let live = open().await;
    let [quiet, flooding] = ["quiet", "flooding"].map(|name| live.navigation.of(&tenant(name)));
    let devices = ["device tenant quiet", "device tenant flooding", &*device("A")];
    let mut expected = Vec::new();
    let mut note = || {
        let current = devices.map(|device| live.navigation.current_for(device));
        expected.push(current);
    };
    for number in 0..2 {
        live.navigation.push(later(number), OPERATOR).await.unwrap();
        quiet.push(reissued(1000 + number)).await.unwrap();
        live.navigation.push(reissued(2000 + number), devices[2]).await.unwrap();
        note();
    }
    let in_force = live.navigation.current_for(devices[0]).navigation.len();
    for number in 0..40 {
        flooding.push(reissued(number)).await.unwrap();
        note();
    }
    // Each account has data in force, and what a push adds before it is counted again.
    let rows_max = 4 * in_force as i64 + 3 * (LIMIT + in_force) as i64;
    assert!(database.count("ephemerides").await <= rows_max);
    for number in 0..70 {
        let mut coefficients = reissued(100 + number);
        coefficients.retain(|_| false);
        flooding.push(coefficients).await.unwrap();
    }
    let again = open().await;
    let (count, mut forgotten) = (expected.len(), 0);
    for index in (0..2 * count).map(|index| index * 17 % count) {
        for (device, then) in devices.iter().zip(&expected[index]) {
            match again.navigation.after(then.push, device).await {
                Ok(known) => {
                    assert!(known.navigation == then.navigation, "{device} after {}", then.push)
                }
                Err(StoreError::NavigationForgotten { .. }) if *device == devices[1] => {
                    forgotten += 1;
                }
                Err(error) => panic!("{device} after {}: {error}", then.push),
            }
        }
    }
    assert!((1..2 * count).contains(&forgotten), "{forgotten} states of the tenant are forgotten");
    let records = database.count("navigation_records").await;
    assert!(records <= LIMIT as i64 + 10, "{records} coefficients are stored");
}
