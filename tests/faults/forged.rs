//! Forged ephemerides: they replace, contradict and evict nothing that the operator's sources bring.

use graphfix::aiding::{AidingDesk, AidingLimits, DEVICE, NavigationPush, UPLOAD};
use graphfix::gnss::{Constellation, Ephemeris, Navigation};

use crate::support::database::{Database, on_both_databases};
use crate::support::drive::DRIVE;

on_both_databases!(
    forged_ephemerides_move_nobody,
    forged_ephemerides_evict_nothing,
    the_operators_data_end_forged_ones,
);

const OPERATOR: &str = "https://archive.example/brdc.rnx";

/// GPS ephemerides of the drive, one for each satellite.
fn real() -> Navigation {
    let mut real = DRIVE.navigation.clone();
    let mut seen = std::collections::BTreeSet::new();
    real.retain(|ephemeris| {
        let satellite = ephemeris.satellite();
        satellite.constellation == Constellation::Gps && seen.insert(satellite)
    });
    real
}

/// The same with orbits 2.7 km off, `shift_s` later.
fn forged(shift_s: f64) -> Navigation {
    let mut forged = Navigation::default();
    for ephemeris in real().satellites().flat_map(|(_, list)| list) {
        let Ephemeris::Keplerian(mut orbit) = ephemeris.clone() else { continue };
        orbit.m0_rad += 1e-4;
        (orbit.toe, orbit.toc) = (orbit.toe + shift_s, orbit.toc + shift_s);
        forged.insert(Ephemeris::Keplerian(orbit));
    }
    forged
}

async fn desk(database: &Database) -> AidingDesk {
    AidingDesk::open(database.store().await, AidingLimits::service()).await.unwrap()
}

async fn pushed(desk: &AidingDesk, navigation: Navigation, source: &str) -> NavigationPush {
    desk.navigation.push(navigation, source).await.unwrap()
}

async fn forged_ephemerides_move_nobody(database: Database) {
    let aiding = desk(&database).await;
    let first = pushed(&aiding, real(), OPERATOR).await;
    assert!(8 < first.new, "{first:?}");
    for source in [UPLOAD, DEVICE, "base ntrip://caster.example/BASE"] {
        // The same issue, and one beside it that would be nearer to some epochs.
        for shift_s in [0.0, 16.0, 1800.0] {
            let refused = pushed(&aiding, forged(shift_s), source).await;
            assert_eq!((refused.new, refused.dropped), (0, 0), "{source} {shift_s}");
        }
    }
    let push = aiding.navigation.current().push;
    assert_eq!((push, &*aiding.navigation.current().navigation), (1, &real()));
    // Who brought what is known after a restart.
    let again = desk(&database).await;
    assert_eq!(pushed(&again, forged(16.0), UPLOAD).await.new, 0);
}

async fn forged_ephemerides_evict_nothing(database: Database) {
    let aiding = desk(&database).await;
    pushed(&aiding, real(), UPLOAD).await;
    let mut many = Navigation::default();
    for index in 1..480 {
        many.merge(forged(f64::from(index) * 20_000.0));
    }
    pushed(&aiding, many, DEVICE).await;
    let more = pushed(&aiding, forged(480.0 * 20_000.0), DEVICE).await;
    assert_eq!((more.new, more.dropped), (0, 0));
    let current = aiding.navigation.current().navigation;
    let is_there = |ephemeris: &Ephemeris| current.of(ephemeris.satellite()).contains(ephemeris);
    assert!(real().satellites().flat_map(|(_, list)| list).all(is_there));
    // The operator's data are taken all the same: forged ones make room.
    let mut later = real();
    later.merge(forged(500.0 * 20_000.0));
    let taken = pushed(&aiding, later, OPERATOR).await;
    // The same ephemerides become the operator's, and one more of each satellite comes.
    assert!(taken.new == 2 * taken.dropped && 8 < taken.dropped, "{taken:?}");
    let current = aiding.navigation.current().navigation;
    assert!(
        real()
            .satellites()
            .flat_map(|(_, list)| list)
            .all(|real| { current.of(real.satellite()).contains(real) })
    );
}

async fn the_operators_data_end_forged_ones(database: Database) {
    let aiding = desk(&database).await;
    let offered = pushed(&aiding, forged(16.0), UPLOAD).await;
    let taken = pushed(&aiding, real(), OPERATOR).await;
    assert_eq!((taken.new, taken.dropped), (offered.new, offered.new));
    assert_eq!(*aiding.navigation.current().navigation, real());
    // What earlier solutions were computed with is known.
    assert_eq!(*aiding.navigation.after(1).await.unwrap().navigation, forged(16.0));
    assert_eq!(*desk(&database).await.navigation.current().navigation, real());
}
