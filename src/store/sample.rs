//! A store with one session, for tests.

use std::collections::BTreeMap;

use tempfile::TempDir;

use crate::gnss::{GpsTime, Solution};
use crate::tenant::Tenant;

use super::{BaseChoice, Batch, EncodedEpoch, SessionKey, SessionSettings, Store, StoredSolution};

/// A new SQLite store.
pub(super) async fn store(folder: &TempDir) -> Store {
    let url = format!("sqlite://{}", folder.path().join("graphfix.db").display());
    Store::open(&url).await.unwrap()
}

/// A session with these epochs.
pub(super) async fn session(store: &Store, epochs: Vec<EncodedEpoch>) -> SessionKey {
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
    let operator = Tenant::operator();
    let key = store.create_session(&operator, "one", &settings, 0).await.unwrap().key;
    store.commit(Batch { epochs, ..Batch::new(key, None) }).await.unwrap();
    key
}

/// An answer without a position, one epoch a second.
pub(super) fn answer(seq: u64, revision: u32) -> StoredSolution {
    let solution = Solution::none(GpsTime::from_week_seconds(2300, seq as f64), vec![]);
    let (version, configuration_hash) = ("0.1.0".into(), "c0ffee".into());
    StoredSolution { seq, revision, solution, version, configuration_hash }
}
