//! Broadcast data of all satellites: ephemerides, ionosphere coefficients, leap seconds.

use std::collections::BTreeMap;
use std::sync::Arc;

use super::{Ephemeris, GpsTime, LeapSeconds, NavigationMessage, SatelliteId};

/// Coefficients of a Klobuchar model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KlobucharCoefficients {
    /// Amplitude α_0 … α_3 (s, s/semicircle, s/semicircle², s/semicircle³).
    pub alpha: [f64; 4],
    /// Period β_0 … β_3 (s, s/semicircle, s/semicircle², s/semicircle³).
    pub beta: [f64; 4],
}

/// Effective ionisation level coefficients of NeQuick-G; Galileo OS SIS ICD 2.1, 5.1.6.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NeQuickCoefficients {
    /// a_i0 (sfu), a_i1 (sfu/degree), a_i2 (sfu/degree²).
    pub ai: [f64; 3],
}

/// Broadcast data that positioning needs, for all satellites.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Navigation {
    /// Ephemerides of each satellite, in order of `toe`. Clones share the lists until one changes.
    ephemerides: BTreeMap<SatelliteId, Arc<Vec<Ephemeris>>>,
    /// Klobuchar coefficients that GPS broadcast.
    pub klobuchar_gps: Option<KlobucharCoefficients>,
    /// Klobuchar coefficients that BeiDou broadcast, for BeiDou's own model.
    pub klobuchar_beidou: Option<KlobucharCoefficients>,
    /// Klobuchar coefficients that QZSS broadcast.
    pub klobuchar_qzss: Option<KlobucharCoefficients>,
    /// NeQuick-G coefficients that Galileo broadcast.
    pub nequick: Option<NeQuickCoefficients>,
    /// Leap seconds, with the broadcast value if there is one.
    pub leap_seconds: LeapSeconds,
}

impl Navigation {
    /// Adds an ephemeris and returns whether it is new. An ephemeris with the same message, `toe`,
    /// `toc` and issue is replaced only if the content differs.
    pub fn insert(&mut self, ephemeris: Ephemeris) -> bool {
        let list = self.ephemerides.entry(ephemeris.satellite()).or_default();
        match list.binary_search_by_key(&key(&ephemeris), key) {
            Ok(index) if list[index] == ephemeris => false,
            Ok(index) => {
                Arc::make_mut(list)[index] = ephemeris;
                true
            }
            Err(index) => {
                Arc::make_mut(list).insert(index, ephemeris);
                true
            }
        }
    }

    /// Removes an ephemeris; `false` if it is not among them.
    pub fn remove(&mut self, ephemeris: &Ephemeris) -> bool {
        let satellite = ephemeris.satellite();
        let Some(list) = self.ephemerides.get_mut(&satellite) else { return false };
        match list.binary_search_by_key(&key(ephemeris), key) {
            Ok(index) if list[index] == *ephemeris => drop(Arc::make_mut(list).remove(index)),
            _ => return false,
        }
        if list.is_empty() {
            self.ephemerides.remove(&satellite);
        }
        true
    }

    /// Adds ephemerides.
    pub fn insert_all(&mut self, ephemerides: impl IntoIterator<Item = Ephemeris>) {
        for ephemeris in ephemerides {
            self.insert(ephemeris);
        }
    }

    /// Ephemerides of one satellite, in order of `toe`.
    pub fn of(&self, satellite: SatelliteId) -> &[Ephemeris] {
        self.ephemerides.get(&satellite).map_or(&[], |list| list.as_slice())
    }

    /// All satellites with an ephemeris, and their ephemerides.
    pub fn satellites(&self) -> impl Iterator<Item = (SatelliteId, &[Ephemeris])> {
        self.ephemerides.iter().map(|(satellite, list)| (*satellite, list.as_slice()))
    }

    /// Number of ephemerides.
    pub fn len(&self) -> usize {
        self.ephemerides.values().map(|list| list.len()).sum()
    }

    /// Whether there is no ephemeris.
    pub fn is_empty(&self) -> bool {
        self.ephemerides.is_empty()
    }

    /// Removes the ephemerides for which `keep` is false.
    pub fn retain(&mut self, mut keep: impl FnMut(&Ephemeris) -> bool) {
        self.ephemerides.retain(|_, list| {
            let mut kept = list.iter().map(&mut keep).collect::<Vec<bool>>().into_iter();
            if kept.as_slice().contains(&false) {
                Arc::make_mut(list).retain(|_| kept.next().unwrap_or(true));
            }
            !list.is_empty()
        });
    }

    /// Adds all of `other`; its coefficients and leap seconds replace those here. Returns the
    /// number of new ephemerides.
    pub fn merge(&mut self, other: Self) -> usize {
        self.klobuchar_gps = other.klobuchar_gps.or(self.klobuchar_gps);
        self.klobuchar_beidou = other.klobuchar_beidou.or(self.klobuchar_beidou);
        self.klobuchar_qzss = other.klobuchar_qzss.or(self.klobuchar_qzss);
        self.nequick = other.nequick.or(self.nequick);
        if other.leap_seconds != LeapSeconds::table() {
            self.leap_seconds = other.leap_seconds;
        }
        let lists = other.ephemerides.values();
        lists.flat_map(|list| list.iter()).filter(|e| self.insert((*e).clone())).count()
    }
}

/// The order of a satellite's ephemerides. It tells one from another.
fn key(ephemeris: &Ephemeris) -> (GpsTime, Option<NavigationMessage>, GpsTime, u32) {
    let message = match ephemeris {
        Ephemeris::Keplerian(keplerian) => Some(keplerian.message),
        Ephemeris::Glonass(_) => None,
    };
    (ephemeris.toe(), message, ephemeris.toc(), ephemeris.issue())
}
