//! The navigation data of single devices, which serve their own sessions only, and those of
//! tenants, which serve the sessions of the tenant only. Both are called devices here.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use crate::gnss::{Ephemeris, LeapSeconds, Navigation};
use crate::store::TENANT_PREFIX;

use super::trust::{Issue, agree, contradict, issue};

/// Most ephemerides of one device. A receiver of all constellations decodes some 40 an hour.
const OF_DEVICE_MAX: usize = 256;
/// Most ephemerides of one tenant: more than those of all constellations of two days.
const OF_TENANT_MAX: usize = 16_384;
/// Most ephemerides of all devices together.
const OF_ALL_MAX: usize = 100_000;
/// Age from which the data of one device may be removed to make room for others (ms).
const LASTING_MS: i64 = 86_400_000;

/// The data of all devices that no other source confirms, by source.
#[derive(Clone, Debug, Default)]
pub(super) struct Devices {
    devices: BTreeMap<Arc<str>, OwnData>,
    /// The devices that have an issue, and when it was stored (ms since 1970-01-01 UTC).
    owners: BTreeMap<Issue, Vec<(Arc<str>, i64)>>,
    count: usize,
}

/// The data of one device.
#[derive(Clone, Debug, Default)]
struct OwnData {
    navigation: Navigation,
    /// The issues in the order in which they were stored.
    order: Vec<Issue>,
}

/// An ephemeris of a device.
pub(super) type Owned = (Arc<str>, Ephemeris);

impl Devices {
    /// The data that only this device has sent; most devices have none.
    pub(super) fn of(&self, source: &str) -> Option<&Navigation> {
        self.devices.get(source).map(|own| &own.navigation)
    }

    /// All devices with data of their own.
    pub(super) fn all(&self) -> impl Iterator<Item = (&Arc<str>, &Navigation)> {
        self.devices.iter().map(|(source, own)| (source, &own.navigation))
    }

    /// Whether another device than `source` has the same ephemeris.
    pub(super) fn is_confirmed(&self, ephemeris: &Ephemeris, source: &str) -> bool {
        let owners = self.owners.get(&issue(ephemeris)).into_iter().flatten();
        let others = owners.filter(|(owner, _)| &**owner != source);
        let mut theirs = others.filter_map(|(owner, _)| self.find(owner, ephemeris));
        theirs.any(|other| agree(other, ephemeris))
    }

    /// Whether another device than `source` has the same coefficients.
    pub(super) fn has_coefficients(&self, coefficients: &Navigation, source: &str) -> bool {
        let mut others = self.all().filter(|(owner, _)| &***owner != source);
        others.any(|(_, own)| contains_coefficients(own, coefficients))
    }

    /// The ephemerides of devices that end when `shared` begin to serve all sessions: those of the
    /// same issues, and those that contradict `shared`.
    pub(super) fn displaced(&self, shared: &[Ephemeris]) -> Vec<Owned> {
        let mut displaced = Vec::new();
        for (source, own) in &self.devices {
            for ephemeris in shared {
                let list = own.navigation.of(ephemeris.satellite()).iter();
                let ends =
                    |e: &&Ephemeris| issue(e) == issue(ephemeris) || contradict(e, ephemeris);
                let ended = list.filter(ends).map(|e| (source.clone(), e.clone()));
                displaced
                    .extend(ended.filter(|owned| !displaced.contains(owned)).collect::<Vec<_>>());
            }
        }
        displaced
    }

    /// The ephemerides of a device that are stored, and those that end to make room for them: its
    /// own oldest ones, and those of others that are older than a day.
    pub(super) fn accept(
        &self,
        source: &Arc<str>,
        brought: Vec<Ephemeris>,
        now_unix_ms: i64,
    ) -> (Vec<Ephemeris>, Vec<Owned>) {
        let is_new = |e: &Ephemeris| self.find(source, e) != Some(e);
        let mut new: Vec<Ephemeris> = brought.into_iter().filter(is_new).collect();
        let most = most_of(source);
        new.truncate(most);
        let replaced = |e: &&Ephemeris| self.find(source, e).is_some();
        let added = new.len() - new.iter().filter(replaced).count();
        let mut ended = Vec::new();
        let present = self.devices.get(source).map_or(&[][..], |own| &own.order[..]);
        let surplus = (present.len() + added).saturating_sub(most);
        let issues: BTreeSet<Issue> = new.iter().map(issue).collect();
        let stays = |issued: &&Issue| !issues.contains(*issued);
        for oldest in present.iter().filter(stays).take(surplus) {
            ended.extend(self.get(source, oldest).map(|e| (source.clone(), e.clone())));
        }
        let surplus = (self.count + added).saturating_sub(OF_ALL_MAX + ended.len());
        if 0 < surplus {
            let old = self.older_than(now_unix_ms - LASTING_MS, source, surplus);
            new.truncate(new.len() - (surplus - old.len()).min(new.len()));
            ended.extend(old);
        }
        (new, ended)
    }

    /// Up to `count` ephemerides of other devices that were stored before this time.
    fn older_than(&self, unix_ms: i64, source: &str, count: usize) -> Vec<Owned> {
        let all = self.owners.iter().flat_map(|(issued, owners)| {
            owners.iter().map(move |(owner, stored)| (issued, owner, *stored))
        });
        let old = all.filter(|(_, owner, stored)| *stored < unix_ms && &***owner != source);
        let owned = |(issued, owner, _): (&Issue, &Arc<str>, i64)| {
            Some((owner.clone(), self.get(owner, issued)?.clone()))
        };
        old.filter_map(owned).take(count).collect()
    }

    /// Adds a stored ephemeris of a device.
    pub(super) fn insert(&mut self, source: &Arc<str>, ephemeris: Ephemeris, stored_unix_ms: i64) {
        self.remove(source, &ephemeris);
        let issued = issue(&ephemeris);
        let own = self.devices.entry(source.clone()).or_default();
        own.navigation.insert(ephemeris);
        own.order.push(issued);
        self.owners.entry(issued).or_default().push((source.clone(), stored_unix_ms));
        self.count += 1;
    }

    /// Adds coefficients of a device.
    pub(super) fn insert_coefficients(&mut self, source: &Arc<str>, coefficients: Navigation) {
        for kind in self::coefficients(&coefficients).into_iter().flatten() {
            self.devices.entry(source.clone()).or_default().navigation.merge(kind);
        }
    }

    /// Removes an ephemeris that is no longer in force.
    pub(super) fn remove(&mut self, source: &str, ephemeris: &Ephemeris) {
        let issued = issue(ephemeris);
        let mut owners = self.owners.get(&issued).into_iter().flatten();
        if !owners.any(|(owner, _)| &**owner == source) {
            return;
        }
        let Some(own) = self.devices.get_mut(source) else { return };
        own.order.retain(|other| *other != issued);
        own.navigation.retain(|other| issue(other) != issued);
        if own.navigation == Navigation::default() {
            self.devices.remove(source);
        }
        self.count -= 1;
        if let Some(owners) = self.owners.get_mut(&issued) {
            owners.retain(|(owner, _)| &**owner != source);
            if owners.is_empty() {
                self.owners.remove(&issued);
            }
        }
    }

    /// The coefficients of devices that are equal to `shared` ones.
    pub(super) fn same_coefficients(&self, shared: &Navigation) -> Vec<(Arc<str>, Navigation)> {
        let kinds: Vec<Navigation> = coefficients(shared).into_iter().flatten().collect();
        let mut same = Vec::new();
        for (source, own) in self.all() {
            let known = kinds.iter().filter(|kind| contains_coefficients(own, kind));
            same.extend(known.map(|kind| (source.clone(), kind.clone())));
        }
        same
    }

    /// Removes coefficients that are no longer in force.
    pub(super) fn remove_coefficients(&mut self, source: &str, ended: &Navigation) {
        let Some(own) = self.devices.get_mut(source) else { return };
        remove_coefficients(&mut own.navigation, ended);
        if own.navigation == Navigation::default() {
            self.devices.remove(source);
        }
    }

    fn find(&self, source: &str, ephemeris: &Ephemeris) -> Option<&Ephemeris> {
        self.get(source, &issue(ephemeris))
    }

    fn get(&self, source: &str, issued: &Issue) -> Option<&Ephemeris> {
        let own = self.devices.get(source)?;
        own.navigation.of(issued.0).iter().find(|e| issue(e) == *issued)
    }
}

/// Most ephemerides of a source.
fn most_of(source: &str) -> usize {
    if source.starts_with(TENANT_PREFIX) { OF_TENANT_MAX } else { OF_DEVICE_MAX }
}

/// The parts of navigation data besides the ephemerides: the ionosphere coefficients of each
/// system, and the leap seconds. A missing part is `None`.
pub(super) fn coefficients(navigation: &Navigation) -> [Option<Navigation>; 5] {
    let mut kinds: [Navigation; 5] = Default::default();
    kinds[0].klobuchar_gps = navigation.klobuchar_gps;
    kinds[1].klobuchar_beidou = navigation.klobuchar_beidou;
    kinds[2].klobuchar_qzss = navigation.klobuchar_qzss;
    kinds[3].nequick = navigation.nequick;
    kinds[4].leap_seconds = navigation.leap_seconds;
    kinds.map(|kind| (kind != Navigation::default()).then_some(kind))
}

/// Whether `whole` has all coefficients of `part`, with the same values.
pub(super) fn contains_coefficients(whole: &Navigation, part: &Navigation) -> bool {
    let (whole, part) = (coefficients(whole), coefficients(part));
    whole.iter().zip(&part).all(|(whole, part)| part.is_none() || whole == part)
}

/// Removes coefficients and leap seconds that are equal to those of `ended`.
pub(super) fn remove_coefficients(navigation: &mut Navigation, ended: &Navigation) {
    fn remove<T: PartialEq>(known: &mut Option<T>, ended: &Option<T>) {
        *known = known.take().filter(|known| Some(known) != ended.as_ref());
    }
    remove(&mut navigation.klobuchar_gps, &ended.klobuchar_gps);
    remove(&mut navigation.klobuchar_beidou, &ended.klobuchar_beidou);
    remove(&mut navigation.klobuchar_qzss, &ended.klobuchar_qzss);
    remove(&mut navigation.nequick, &ended.nequick);
    if navigation.leap_seconds == ended.leap_seconds {
        navigation.leap_seconds = LeapSeconds::table();
    }
}
