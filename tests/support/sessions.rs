//! Sessions on a store, without the doors.

use std::collections::BTreeMap;

use graphfix::aiding::bases::BaseChoice;
use graphfix::aiding::{AidingDesk, AidingLimits};
use graphfix::gnss::{Epoch, GpsTime, Observation, ObservationCode, SatelliteId};
use graphfix::session::{NewSession, SequencedEpoch, SessionId, SessionLimits, Sessions};
use graphfix::store::Store;

pub(crate) async fn desk(store: &Store) -> Sessions {
    desk_with(store, SessionLimits::service()).await
}

pub(crate) async fn desk_with(store: &Store, limits: SessionLimits) -> Sessions {
    let aiding = AidingDesk::open(store.clone(), AidingLimits::service()).await.unwrap();
    Sessions::open(store.clone(), aiding, limits)
}

/// A session for single points.
pub(crate) fn new_session() -> NewSession {
    NewSession {
        label: "rover".to_owned(),
        mode: "spp".to_owned(),
        profile: "general".to_owned(),
        overrides: BTreeMap::new(),
        base: BaseChoice::None,
        antenna: String::new(),
        retention_days: None,
    }
}

/// The id of a new session for single points.
pub(crate) async fn created(sessions: &Sessions) -> SessionId {
    sessions.create(new_session()).await.unwrap().id
}

/// An epoch at a second of week 2051 with one pseudorange and without an ephemeris: the answer has
/// no position, and states the reason.
pub(crate) fn epoch(seq: u64, second: f64) -> SequencedEpoch {
    let satellite: SatelliteId = "G05".parse().unwrap();
    let code = ObservationCode::parse("1C").unwrap();
    let pseudorange_m = Some(22e6 + second);
    let observation = Observation { pseudorange_m, ..Observation::empty(satellite, code) };
    let time = GpsTime::from_week_seconds(2051, second);
    SequencedEpoch { seq, epoch: Epoch { observations: vec![observation], ..Epoch::new(time) } }
}
