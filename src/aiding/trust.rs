//! Which source of navigation data has precedence when sources contradict each other.
//!
//! The operator's archives and streams come first. Uploads, devices and the streams of bases only
//! offer data: an offer that contradicts the operator's ephemerides is refused, and is dropped when
//! these arrive later. An offer replaces nothing, and makes room only where older offers end.

use std::collections::BTreeMap;

use crate::gnss::{Ephemeris, GpsTime, Navigation, NavigationMessage, SatelliteId};
use crate::models::{satellite_state, validity_s};

/// Source of uploaded files, as the navigation status names it.
pub const UPLOAD: &str = "upload";
/// Source of ephemerides from devices.
pub const DEVICE: &str = "device";
/// How the name of a base's stream begins, as a source.
pub const OF_BASE: &str = "base ";
/// Distance between the satellite's positions, and between its clocks, of two ephemerides that
/// agree (m). Consecutive broadcasts differ by some metres at times that both are valid for.
const AGREEMENT_M: f64 = 100.0;
/// Time for which an offered ephemeris makes room for no other offer (ms).
const LASTING_MS: i64 = 86_400_000;

/// Whether a source is the operator's.
pub(super) fn is_of_operator(source: &str) -> bool {
    source != UPLOAD && source != DEVICE && !source.starts_with(OF_BASE)
}

/// Whether two ephemerides of one satellite give the same orbit and clock, as far as both are valid
/// at one time. Ephemerides of different times neither agree nor contradict.
fn contradict(one: &Ephemeris, other: &Ephemeris) -> bool {
    let apart_s = (one.toe() - other.toe()).abs();
    if message(one) != message(other) || validity_s(one).min(validity_s(other)) < apart_s {
        return false;
    }
    let time = one.toe() + (other.toe() - one.toe()) / 2.0;
    let (a, b) = (satellite_state(one, time), satellite_state(other, time));
    let apart_m = a.position.distance_m(b.position).max((a.clock_m - b.clock_m).abs());
    !apart_m.is_finite() || AGREEMENT_M < apart_m
}

/// The ephemerides in force that others than the operator have brought, by issue.
#[derive(Clone, Debug, Default)]
pub(super) struct Offered(BTreeMap<Issue, i64>);

/// What names one issue of an ephemeris.
type Issue = (SatelliteId, NavigationMessage, GpsTime, GpsTime, u32);

/// What an offer adds, and what makes room for it.
pub(super) struct Accepted {
    pub(super) navigation: Navigation,
    pub(super) dropped: Vec<Ephemeris>,
}

impl Offered {
    /// Notes that `ephemeris` is in force since `stored_unix_ms`, brought by `source`.
    pub(super) fn note(&mut self, ephemeris: &Ephemeris, source: &str, stored_unix_ms: i64) {
        if is_of_operator(source) {
            self.0.remove(&issue(ephemeris));
        } else {
            self.0.insert(issue(ephemeris), stored_unix_ms);
        }
    }

    /// Notes that `ephemeris` is no longer in force.
    pub(super) fn forget(&mut self, ephemeris: &Ephemeris) {
        self.0.remove(&issue(ephemeris));
    }

    /// Whether others than the operator have brought this ephemeris.
    pub(super) fn contains(&self, ephemeris: &Ephemeris) -> bool {
        self.0.contains_key(&issue(ephemeris))
    }

    fn stored_unix_ms(&self, ephemeris: &Ephemeris) -> Option<i64> {
        self.0.get(&issue(ephemeris)).copied()
    }

    /// The offered ephemerides of `known` that contradict `pushed`, which the operator brings.
    pub(super) fn contradicted(&self, known: &Navigation, pushed: &Navigation) -> Vec<Ephemeris> {
        let mut found = Vec::new();
        for (satellite, list) in pushed.satellites() {
            let offered = known.of(satellite).iter().filter(|e| self.contains(e));
            let contradicted = |e: &&Ephemeris| list.iter().any(|other| contradict(e, other));
            found.extend(offered.filter(contradicted).cloned());
        }
        found
    }

    /// The part of an offer that adds to `known` without contradiction. If a satellite has `limit`
    /// ephemerides, only offers of more than a day ago make room.
    pub(super) fn accept(
        &self,
        known: &Navigation,
        offer: &Navigation,
        limit: usize,
        now_unix_ms: i64,
    ) -> Accepted {
        let mut accepted = Navigation::default();
        let mut dropped = Vec::new();
        for (satellite, list) in offer.satellites() {
            let present = known.of(satellite);
            let mut free = limit.saturating_sub(present.len());
            let is_old = |e: &&Ephemeris| {
                self.stored_unix_ms(e).is_some_and(|stored| stored + LASTING_MS < now_unix_ms)
            };
            let mut old = present.iter().filter(is_old);
            for ephemeris in list {
                let is_known = present.iter().any(|other| issue(other) == issue(ephemeris));
                let is_refused = present.iter().any(|other| {
                    self.stored_unix_ms(other).is_none() && contradict(other, ephemeris)
                });
                if is_known || is_refused {
                    continue;
                }
                if free == 0 {
                    let Some(oldest) = old.next() else { break };
                    dropped.push(oldest.clone());
                    free = 1;
                }
                accepted.insert(ephemeris.clone());
                free -= 1;
            }
        }
        accepted.klobuchar_gps = offer.klobuchar_gps.filter(|_| known.klobuchar_gps.is_none());
        accepted.klobuchar_beidou =
            offer.klobuchar_beidou.filter(|_| known.klobuchar_beidou.is_none());
        accepted.klobuchar_qzss = offer.klobuchar_qzss.filter(|_| known.klobuchar_qzss.is_none());
        accepted.nequick = offer.nequick.filter(|_| known.nequick.is_none());
        if known.leap_seconds == Navigation::default().leap_seconds {
            accepted.leap_seconds = offer.leap_seconds;
        }
        Accepted { navigation: accepted, dropped }
    }
}

fn issue(ephemeris: &Ephemeris) -> Issue {
    let (toe, toc) = (ephemeris.toe(), ephemeris.toc());
    (ephemeris.satellite(), message(ephemeris), toe, toc, ephemeris.issue())
}

const fn message(ephemeris: &Ephemeris) -> NavigationMessage {
    match ephemeris {
        Ephemeris::Keplerian(keplerian) => keplerian.message,
        Ephemeris::Glonass(_) => NavigationMessage::Fdma,
    }
}
