//! Durable epochs per second: commits of the store alone, and sessions that send batches to the
//! desk, on SQLite in a temporary folder or on the database in `GRAPHFIX_BENCH_DATABASE`.
//!
//! `cargo bench --bench store`

use std::collections::BTreeMap;
use std::future::Future;
use std::sync::Arc;
use std::time::Instant;

use graphfix::aiding::{AidingDesk, AidingLimits};
use graphfix::gnss::{
    Constellation, Cycles, Dops, Ecef, EphemerisIssue, Epoch, GpsTime, Observation,
    ObservationCode, Provenance, SatelliteId, Solution, SolutionEstimate, Status,
};
use graphfix::session::{NewSession, SequencedEpoch, SessionLimits, Sessions};
use graphfix::store::{
    BaseChoice, Batch, EncodedEpoch, SessionKey, SessionSettings, Store, StoredSolution,
};
use graphfix::tenant::Tenant;
use nalgebra::Matrix3;

const SESSIONS: usize = 8;
const EPOCHS: u64 = 10_000;

fn main() {
    let runtime = tokio::runtime::Runtime::new().expect("a runtime starts");
    runtime.block_on(async {
        let folder = tempfile::tempdir().expect("the temporary folder is writable");
        let url = std::env::var("GRAPHFIX_BENCH_DATABASE")
            .unwrap_or_else(|_| format!("sqlite://{}", folder.path().join("bench.db").display()));
        let store = Store::open(&url).await.expect("the database opens");
        println!("{SESSIONS} sessions of {EPOCHS} epochs with 40 observations on {store:?}");
        for size in [1, 10, 100, 1_000] {
            let epochs = if size == 1 { EPOCHS / 10 } else { EPOCHS };
            store_alone(&store, size, epochs).await;
        }
        for size in [1, 10, 100, 1_000] {
            let epochs = if size == 1 { EPOCHS / 10 } else { EPOCHS };
            whole_desk(&store, size, epochs).await;
        }
        store.close().await;
    });
}

/// Runs one future for each session concurrently and prints the epochs per second.
async fn measure<F>(what: &str, size: u64, epochs: u64, run: impl Fn(usize) -> F)
where
    F: Future<Output = ()> + Send + 'static,
{
    let start = Instant::now();
    let running: Vec<_> = (0..SESSIONS).map(|index| tokio::spawn(run(index))).collect();
    for session in running {
        session.await.expect("no session panics");
    }
    let elapsed_s = start.elapsed().as_secs_f64();
    let rate = (SESSIONS as u64 * epochs) as f64 / elapsed_s;
    println!("{what:>6}, batches of {size:>4}: {rate:>9.0} epochs/s");
}

async fn store_alone(store: &Store, size: u64, epochs: u64) {
    let mut keys = Vec::new();
    for index in 0..SESSIONS {
        keys.push(session(store, &format!("bench-{size}-{index}")).await);
    }
    let rows = |seq: u64| {
        let solution = StoredSolution {
            seq,
            revision: 0,
            solution: solution(seq),
            version: "0.1.0".into(),
            configuration_hash: "c0ffee".into(),
        };
        EncodedEpoch::new(Arc::new(epoch(seq)), &solution, 0, None, None)
    };
    measure("store", size, epochs, |index| {
        let (store, session) = (store.clone(), keys[index]);
        async move {
            for first in (0..epochs).step_by(size as usize) {
                let epochs = (first..first + size).map(rows).collect();
                let batch = Batch { epochs, ..Batch::new(session, first.checked_sub(1)) };
                store.commit(batch).await.expect("the commit succeeds");
            }
        }
    })
    .await;
}

async fn whole_desk(store: &Store, size: u64, epochs: u64) {
    let aiding = AidingDesk::open(store.clone(), AidingLimits::service())
        .await
        .expect("navigation data are read");
    let sessions = Sessions::open(store.clone(), aiding, SessionLimits::service());
    measure("desk", size, epochs, |_| {
        let sessions = sessions.clone();
        async move {
            let new = NewSession {
                label: String::new(),
                mode: "spp".to_owned(),
                profile: "general".to_owned(),
                overrides: BTreeMap::new(),
                base: BaseChoice::None,
                antenna: String::new(),
                retention_days: None,
            };
            let id = sessions.create(new).await.expect("the session is created").id;
            for first in (0..epochs).step_by(size as usize) {
                let batch = (first..first + size)
                    .map(|seq| SequencedEpoch { seq, epoch: epoch(seq) })
                    .collect();
                sessions.submit(&id, batch).await.expect("the batch is committed");
            }
        }
    })
    .await;
    sessions.drain().await;
}

async fn session(store: &Store, id: &str) -> SessionKey {
    let unique = format!("{id}-{}", std::process::id());
    let settings = SessionSettings {
        label: String::new(),
        mode: "spp".to_owned(),
        profile: "general".to_owned(),
        overrides: BTreeMap::new(),
        configuration: BTreeMap::new(),
        configuration_hash: "c0ffee".into(),
        base: BaseChoice::None,
        antenna: None,
        retention_days: None,
    };
    store
        .create_session(&Tenant::operator(), &unique, &settings, 0)
        .await
        .expect("the session is stored")
        .key
}

/// Twenty satellites with two signals each.
fn epoch(seq: u64) -> Epoch {
    let mut epoch = Epoch::new(GpsTime::from_week_seconds(2051, seq as f64));
    for satellite in satellites() {
        for code in ["1C", "2W"] {
            let code = ObservationCode::parse(code).expect("the code is one");
            let count = f64::from(satellite.number) + seq as f64;
            epoch.observations.push(Observation {
                pseudorange_m: Some(((22e6 + 613.2 * count) * 1e3).round() / 1e3),
                carrier_phase: Some(Cycles(((115e6 + 3_213.7 * count) * 1e3).round() / 1e3)),
                doppler_hz: Some(((-1_200.0 - 1.7 * count) * 1e3).round() / 1e3),
                cn0_db_hz: Some(44.25),
                ..Observation::empty(satellite, code)
            });
        }
    }
    epoch
}

fn satellites() -> impl Iterator<Item = SatelliteId> {
    (1..=20).map(|number| SatelliteId { constellation: Constellation::Gps, number })
}

fn solution(seq: u64) -> Solution {
    let time = GpsTime::from_week_seconds(2051, seq as f64);
    let issue = |satellite| EphemerisIssue { satellite, toe: time, issue: 45 };
    Solution {
        time,
        status: Status::Single,
        estimate: Some(SolutionEstimate {
            position: Ecef::new(-2_414_266.9, 5_386_768.9, 2_407_460.0 + seq as f64),
            covariance: Matrix3::identity(),
            velocity: None,
            clock_m: 123.4,
            inter_system_biases_m: Vec::new(),
            reception_time: time - 4e-7,
            dops: Dops { gdop: 2.1, pdop: 1.8, hdop: 0.9, vdop: 1.5, tdop: 1.1 },
            satellites_used: satellites().collect(),
            relative: None,
        }),
        protection: None,
        reasons: Vec::new(),
        provenance: Provenance { ephemerides: satellites().map(issue).collect(), base: None },
    }
}
