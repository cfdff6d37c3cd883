//! Bytes on the disk for each stored epoch, which decide the size of a database after a year.

use std::sync::LazyLock;

use graphfix::aiding::bases::BaseChoice;
use graphfix::aiding::{AidingDesk, AidingLimits};
use graphfix::gnss::{Cycles, Epoch, LocalFrame, Navigation};
use graphfix::session::{NewSession, SequencedEpoch, SessionId, SessionLimits, Sessions};
use graphfix::simulation::{Scenario, Simulator};
use graphfix::store::StoredEpoch;

use crate::support::database::{Database, on_both_databases, whole_session};
use crate::support::sessions::{self as support, desk, epoch};

on_both_databases!(
    an_epoch_takes_little_room,
    columns_are_those_of_the_solutions,
    a_chain_is_read_from_any_epoch,
);

/// Epochs of the longest run.
const EPOCHS: usize = 560;
/// Number of epochs before the measurement begins: each session then has its first snapshot, which
/// later ones replace.
const FROM: usize = 300;
const SESSIONS: usize = 2;

/// A receiver under open sky with two signals of each satellite above an elevation mask. Values are
/// rounded as in RINEX, to thousandths, and C/N0 to quarters of a dB.
struct Device {
    epochs: Vec<SequencedEpoch>,
    navigation: Navigation,
}

impl Device {
    fn above(mask_deg: f64) -> Self {
        let scenario = Scenario { duration_s: EPOCHS as f64 - 1.0, ..Scenario::open_sky() };
        let elevation_mask_rad = mask_deg.to_radians();
        let simulator = Simulator::new(Scenario { base: None, elevation_mask_rad, ..scenario }, 11);
        let navigation = Navigation::clone(simulator.navigation());
        let logged = |(seq, epoch): (u64, Epoch)| SequencedEpoch { seq, epoch: logged(epoch) };
        let epochs = (1..).zip(simulator.map(|epoch| epoch.rover)).map(logged).collect();
        Self { epochs, navigation }
    }
}

/// One receiver has 25 or 26 satellites, the other 33 or more.
static DEVICES: LazyLock<[Device; 2]> = LazyLock::new(|| [15.0, 5.0].map(Device::above));

fn logged(mut epoch: Epoch) -> Epoch {
    let thousandths = |value: f64| (value * 1e3).round() / 1e3;
    for observation in &mut epoch.observations {
        observation.pseudorange_m = observation.pseudorange_m.map(thousandths);
        let phase = observation.carrier_phase.map(|phase| Cycles(thousandths(phase.0)));
        observation.carrier_phase = phase;
        observation.doppler_hz = observation.doppler_hz.map(thousandths);
        observation.cn0_db_hz = observation.cn0_db_hz.map(|cn0| (cn0 * 4.0).round() / 4.0);
    }
    epoch
}

async fn created(sessions: &Sessions) -> SessionId {
    let new = NewSession {
        label: String::new(),
        mode: "fgo".to_owned(),
        profile: "general".to_owned(),
        overrides: Default::default(),
        base: BaseChoice::None,
        antenna: String::new(),
        retention_days: None,
    };
    sessions.create(new).await.unwrap().id
}

/// At most 1200 bytes for an epoch with its solution and revision and all indices, also with a
/// third more satellites.
async fn an_epoch_takes_little_room(database: Database) {
    let store = database.store().await;
    for (device, least, per_calls) in [(&DEVICES[0], 50.0, &[1, 20][..]), (&DEVICES[1], 64.0, &[1])]
    {
        let aiding = AidingDesk::open(store.clone(), AidingLimits::service()).await.unwrap();
        let sessions = Sessions::open(store.clone(), aiding.clone(), SessionLimits::service());
        let Device { epochs, navigation } = device;
        aiding.navigation.push(navigation.clone(), "simulation").await.unwrap();
        let observations: usize = epochs.iter().map(|e| e.epoch.observations.len()).sum();
        let observations = observations as f64 / epochs.len() as f64;
        assert!((least..least + 20.0).contains(&observations), "{observations}");
        for per_call in per_calls {
            let bytes = bytes_per_epoch(&database, &sessions, epochs, *per_call).await;
            println!("{observations:.1} observations, {per_call} epochs a call: {bytes:.0} bytes");
            assert!(bytes <= 1_200.0, "{bytes} bytes an epoch");
        }
        sessions.drain().await;
    }
    store.close().await;
}

/// Bytes of the database for each epoch of new sessions.
async fn bytes_per_epoch(
    database: &Database,
    sessions: &Sessions,
    epochs: &[SequencedEpoch],
    per_call: usize,
) -> f64 {
    let mut ids = Vec::new();
    for _ in 0..SESSIONS {
        ids.push(created(sessions).await);
    }
    let mut before = 0;
    for (index, batch) in epochs.chunks(per_call).enumerate() {
        if index * per_call == FROM {
            before = database.bytes().await.0;
        }
        for id in &ids {
            let submitted = sessions.submit(id, batch.to_vec()).await.unwrap();
            assert!(submitted.outcomes.iter().all(|outcome| outcome.result.is_ok()));
        }
    }
    let stored = SESSIONS * (EPOCHS - FROM);
    (database.bytes().await.0 - before) as f64 / stored as f64
}

/// The columns for readers of SQL agree with the decoded solutions.
async fn columns_are_those_of_the_solutions(database: Database) {
    let store = database.store().await;
    let aiding = AidingDesk::open(store.clone(), AidingLimits::service()).await.unwrap();
    let sessions = Sessions::open(store.clone(), aiding.clone(), SessionLimits::service());
    let Device { epochs, navigation } = &DEVICES[0];
    aiding.navigation.push(navigation.clone(), "simulation").await.unwrap();
    let id = created(&sessions).await;
    sessions.submit(&id, epochs[..40].to_vec()).await.unwrap();
    let solutions = sessions.solutions(&id, &whole_session()).await.unwrap().page.items;
    let revised = solutions.iter().filter(|solution| solution.revision == 1).count();
    assert!(5 < revised && solutions.len() == 40 + revised, "{revised} of {}", solutions.len());
    for stored in &solutions {
        let estimate = stored.solution.estimate.as_ref().unwrap();
        let local = LocalFrame::at(estimate.position).covariance_to_enu(&estimate.covariance);
        let sigma_mm = |axis: usize| (local[(axis, axis)].sqrt() * 1e3).round();
        let (table, revision) = match stored.revision {
            0 => ("epochs", String::new()),
            revision => ("revisions", format!(" AND revision = {revision}")),
        };
        let condition = format!(
            "{table} WHERE seq = {}{revision} AND status > 0 AND x_m = {:?} AND \
             sigma_east_mm = {} AND sigma_north_mm = {} AND sigma_up_mm = {} AND ratio IS NULL",
            stored.seq,
            estimate.position.0.x,
            sigma_mm(0),
            sigma_mm(1),
            sigma_mm(2),
        );
        assert_eq!(database.count(&condition).await, 1, "{condition}");
    }
}

/// Epochs are stored in chains of 16, and any of them can be read. A chain with a gap is corrupt.
async fn a_chain_is_read_from_any_epoch(database: Database) {
    let store = database.store().await;
    let sessions = desk(&store).await;
    let id = support::created(&sessions).await;
    let pushed: Vec<_> = (1..=40).map(|seq| epoch(seq, seq as f64)).collect();
    sessions.submit(&id, pushed.clone()).await.unwrap();
    let key = store.session_of_any(id.as_str()).await.unwrap().unwrap().key;
    let read = |rows: Vec<StoredEpoch>| -> Vec<SequencedEpoch> {
        let sequenced =
            |row: StoredEpoch| SequencedEpoch { seq: row.solution.seq, epoch: row.epoch };
        rows.into_iter().map(sequenced).collect()
    };
    let asked = read(store.epochs(key, &[30, 5, 17, 31, 99]).await.unwrap());
    assert_eq!(asked, [5, 17, 30, 31].map(|seq: usize| pushed[seq - 1].clone()));
    assert_eq!(read(store.epochs_after(key, Some(20), 15).await.unwrap()), pushed[20..35]);
    let last = read(store.last_epochs(key, 2).await.unwrap());
    assert_eq!(last, [pushed[39].clone(), pushed[38].clone()]);

    database.execute("DELETE FROM epochs WHERE seq = 18").await;
    for (seq, is_sound) in [(17, true), (19, false), (32, false), (33, true)] {
        let read = store.epochs(key, &[seq]).await.map_err(|error| error.code().name());
        assert_eq!(read.as_ref().err(), (!is_sound).then_some(&"STORED_DATA_CORRUPT"), "{seq}");
    }
}
