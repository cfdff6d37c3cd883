//! Which source of navigation data has precedence when sources contradict each other.
//!
//! The operator's archives and streams have precedence. Uploads, devices and the streams of bases
//! only offer data. An offer that contradicts the operator's ephemerides is refused, or dropped
//! when these arrive later. An offer replaces no data of the operator. If a satellite has as many
//! ephemerides as allowed, a new offer takes the place of an offer of more than a day ago.

use std::collections::BTreeMap;

use crate::gnss::{Ephemeris, GpsTime, Navigation, NavigationMessage, SatelliteId};
use crate::models::{satellite_state, validity_s};

/// Source of uploaded files, as the navigation status names it.
pub const UPLOAD: &str = "upload";
/// Source of ephemerides from devices.
pub const DEVICE: &str = "device";
/// Prefix of the sources that are streams of bases.
pub(crate) const OF_BASE: &str = "base ";
/// Largest difference of the satellite's positions and clocks by two ephemerides that agree (m).
/// Consecutive broadcasts differ by some metres at times for which both are valid.
const AGREEMENT_M: f64 = 100.0;
/// Age below which an offered ephemeris is not dropped for another offer (ms).
const LASTING_MS: i64 = 86_400_000;

/// Whether a source is the operator's.
pub(super) fn is_of_operator(source: &str) -> bool {
    source != UPLOAD && source != DEVICE && !source.starts_with(OF_BASE)
}

/// Whether two ephemerides of one satellite give different orbits or clocks at a time for which
/// both are valid. False if there is no such time, or if they are of different messages.
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

/// The offered ephemerides in force, by issue, each with the time at which it was stored (ms since
/// 1970-01-01 UTC).
#[derive(Clone, Debug, Default)]
pub(super) struct Offered(BTreeMap<Issue, i64>);

/// Identifies one issue of an ephemeris: satellite, message, toe, toc, issue of data.
type Issue = (SatelliteId, NavigationMessage, GpsTime, GpsTime, u32);

/// The accepted part of an offer, and the older offers that are dropped for it.
pub(super) struct Accepted {
    pub(super) navigation: Navigation,
    pub(super) dropped: Vec<Ephemeris>,
}

impl Offered {
    /// Records that `ephemeris` of `source` is in force since `stored_unix_ms`.
    pub(super) fn note(&mut self, ephemeris: &Ephemeris, source: &str, stored_unix_ms: i64) {
        if is_of_operator(source) {
            self.0.remove(&issue(ephemeris));
        } else {
            self.0.insert(issue(ephemeris), stored_unix_ms);
        }
    }

    /// Records that `ephemeris` is no longer in force.
    pub(super) fn forget(&mut self, ephemeris: &Ephemeris) {
        self.0.remove(&issue(ephemeris));
    }

    /// Whether this ephemeris was offered, and not brought by the operator.
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

    /// The part of an offer that is new and does not contradict the operator's data in `known`. If
    /// a satellite has `limit` ephemerides, only offers of more than a day ago are dropped for it.
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
