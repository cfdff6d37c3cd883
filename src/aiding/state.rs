//! The navigation data in force after a push, and the changes that another push makes.

use std::sync::{Arc, Mutex, PoisonError};

use crate::gnss::{Ephemeris, Navigation};
use crate::store::StoredNavigation;

use super::devices::{Devices, Owned, coefficients, contains_coefficients};
use super::shared::Shared;
use super::trust::{AGREED, Trust, trust};
use super::views::DeviceViews;

/// The navigation data after one push. They never change.
#[derive(Clone, Debug, Default)]
pub struct PushedNavigation {
    /// Number of the push; zero before the first.
    pub push: u64,
    /// All navigation data in force.
    pub navigation: Arc<Navigation>,
}

/// The navigation data in force after a push.
#[derive(Default)]
pub(super) struct State {
    pub(super) push: u64,
    pub(super) shared: Shared,
    pub(super) devices: Devices,
    views: Mutex<DeviceViews>,
}

/// The accepted part of a push of one source, and the data that end because of it.
pub(super) struct Part {
    pub(super) source: Arc<str>,
    pub(super) new: Navigation,
    /// Shared ephemerides that end.
    pub(super) ended: Vec<Ephemeris>,
    /// Ephemerides of single devices that end.
    pub(super) ended_owned: Vec<Owned>,
    /// Coefficients of single devices that end.
    pub(super) ended_coefficients: Vec<(Arc<str>, Navigation)>,
}

/// Ephemerides of one transaction: it then takes some tens of milliseconds, for which commits of
/// epochs wait.
const OF_TRANSACTION: usize = 500;

impl Part {
    /// The same as several parts of a size for one transaction each. The first one has the
    /// coefficients, and ends the shared data.
    pub(super) fn steps(self) -> Vec<Self> {
        let Self { source, mut new, ended, ended_owned, ended_coefficients } = self;
        let list: Vec<Ephemeris> =
            new.satellites().flat_map(|(_, list)| list.iter().cloned()).collect();
        new.retain(|_| false);
        let mut first = Some((new, ended, ended_coefficients));
        let (mut list, mut ended_owned) = (list.into_iter(), ended_owned.into_iter());
        let mut steps = Vec::new();
        while 0 < list.len() + ended_owned.len() || first.is_some() {
            let (mut new, ended, ended_coefficients) = first.take().unwrap_or_default();
            new.insert_all(list.by_ref().take(OF_TRANSACTION));
            let ended_owned = ended_owned.by_ref().take(OF_TRANSACTION).collect();
            steps.push(Self {
                source: source.clone(),
                new,
                ended,
                ended_owned,
                ended_coefficients,
            });
        }
        steps
    }
}

impl State {
    /// The state from the stored data.
    pub(super) fn of(stored: StoredNavigation) -> Self {
        let mut state = Self { push: stored.push, ..Self::default() };
        let mut rows = stored.ephemerides;
        rows.sort_by_key(|row| row.stored_unix_ms);
        for row in rows {
            let source: Arc<str> = row.source.into();
            match trust(&source) {
                Trust::Device => state.devices.insert(&source, row.ephemeris, row.stored_unix_ms),
                _ => state.shared.insert(row.ephemeris, &source, row.stored_unix_ms),
            }
        }
        for row in stored.coefficients {
            let source: Arc<str> = row.source.into();
            match trust(&source) {
                Trust::Device => state.devices.insert_coefficients(&source, row.coefficients),
                _ => state.shared.insert_coefficients(&row.coefficients, &source),
            }
        }
        state
    }

    /// Whether a push changes nothing, because all its data are known from a source of the same or
    /// higher trust, or from the same device.
    pub(super) fn knows(&self, pushed: &Navigation, source: &str) -> bool {
        let own = self.devices.of(source);
        let is_known = |ephemeris: &Ephemeris| {
            let is_own = own.is_some_and(|o| o.of(ephemeris.satellite()).contains(ephemeris));
            let shared = self.shared.same_issue(ephemeris);
            is_own
                || shared.is_some_and(|known| {
                    let known_as = self.shared.trust_in(known);
                    known == ephemeris && trust(source).max(Trust::Agreed) <= known_as
                })
        };
        let mut kinds = coefficients(pushed).into_iter().flatten();
        let knows_kinds = kinds.all(|kind| {
            own.is_some_and(|own| contains_coefficients(own, &kind))
                || contains_coefficients(&self.shared.navigation, &kind)
        });
        knows_kinds && pushed.satellites().flat_map(|(_, list)| list).all(is_known)
    }

    /// The accepted parts of a push, each with the data that end because of it.
    pub(super) fn parts(
        &self,
        pushed: &Navigation,
        source: &Arc<str>,
        limit: usize,
        now: i64,
    ) -> Vec<Part> {
        let parts = match trust(source) {
            Trust::Operator => vec![self.of_operator(pushed, source, limit)],
            _ => {
                let (confirmed, rest) = self.confirmed(pushed, source);
                let rest = match trust(source) {
                    Trust::Device => self.of_device(rest, source, now),
                    _ => self.of_offer(rest, source, limit, now),
                };
                vec![self.of_agreement(confirmed, limit, now), rest]
            }
        };
        let is_empty = |part: &Part| {
            part.new == Navigation::default()
                && part.ended.is_empty()
                && part.ended_owned.is_empty()
                && part.ended_coefficients.is_empty()
        };
        parts.into_iter().filter(|part| !is_empty(part)).collect()
    }

    /// The part of the operator's data, which are always accepted. Data that contradict them end.
    fn of_operator(&self, pushed: &Navigation, source: &Arc<str>, limit: usize) -> Part {
        let mut new = pushed.clone();
        new.retain(|ephemeris| {
            let is_known = self.shared.same_issue(ephemeris) == Some(ephemeris);
            !is_known || self.shared.trust_in(ephemeris) < Trust::Operator
        });
        let mut ended = self.shared.lower(pushed, Trust::Operator);
        let excess = self.shared.excess(&new, limit);
        ended.extend(excess.into_iter().filter(|e| !ended.contains(e)).collect::<Vec<_>>());
        self.shared_part(new, pushed, source.clone(), ended)
    }

    /// The part on which two sources agree. It serves all sessions. Offers that contradict it end.
    fn of_agreement(&self, confirmed: Navigation, limit: usize, now: i64) -> Part {
        let mut new = confirmed.clone();
        let mut ended = self.shared.make_room(&mut new, limit, now);
        let lower = self.shared.lower(&new, Trust::Agreed);
        let is_new = |e: &Ephemeris| !ended.contains(e) && !new.of(e.satellite()).contains(e);
        let lower: Vec<Ephemeris> = lower.into_iter().filter(is_new).collect();
        ended.extend(lower);
        self.shared_part(new, &confirmed, AGREED.into(), ended)
    }

    /// The part of an offer. It must not contradict data of higher trust, and replaces nothing.
    fn of_offer(&self, mut new: Navigation, source: &Arc<str>, limit: usize, now: i64) -> Part {
        let offered = new.clone();
        new.retain(|ephemeris| {
            self.shared.same_issue(ephemeris).is_none()
                && !self.shared.contradicts(ephemeris, Trust::Agreed)
        });
        let ended = self.shared.make_room(&mut new, limit, now);
        let mut part = self.shared_part(new, &offered, source.clone(), ended);
        // For its own session, a device's own data still have priority.
        part.ended_owned.clear();
        part.ended_coefficients.clear();
        part
    }

    /// The part of a device's data, which serve its own session. They must not contradict data of
    /// higher trust than an offer.
    fn of_device(&self, mut rest: Navigation, source: &Arc<str>, now: i64) -> Part {
        rest.retain(|ephemeris| {
            let known = self.shared.same_issue(ephemeris);
            known.is_none_or(|known| {
                known != ephemeris && self.shared.trust_in(known) == Trust::Offer
            }) && !self.shared.contradicts(ephemeris, Trust::Agreed)
        });
        let brought = rest.satellites().flat_map(|(_, list)| list.iter().cloned()).collect();
        let (accepted, ended_owned) = self.devices.accept(source, brought, now);
        let mut new = Navigation::default();
        let own = self.devices.of(source);
        for kind in coefficients(&rest).into_iter().flatten() {
            let is_own = own.is_some_and(|own| contains_coefficients(own, &kind));
            if !is_own && !contains_coefficients(&self.shared.navigation, &kind) {
                new.merge(kind);
            }
        }
        new.insert_all(accepted);
        let (ended, ended_coefficients) = (Vec::new(), Vec::new());
        Part { source: source.clone(), new, ended, ended_owned, ended_coefficients }
    }

    /// The data that another source than `source` has already sent, and the rest.
    fn confirmed(&self, pushed: &Navigation, source: &str) -> (Navigation, Navigation) {
        let (mut confirmed, mut rest) = (Navigation::default(), Navigation::default());
        for ephemeris in pushed.satellites().flat_map(|(_, list)| list) {
            if let Some(offer) = self.shared.confirmed_offer(ephemeris, source) {
                confirmed.insert(offer.clone());
            } else if self.devices.is_confirmed(ephemeris, source)
                && !self.shared.contradicts(ephemeris, Trust::Agreed)
            {
                confirmed.insert(ephemeris.clone());
            } else {
                rest.insert(ephemeris.clone());
            }
        }
        for kind in coefficients(pushed).into_iter().flatten() {
            let is_confirmed = self.devices.has_coefficients(&kind, source)
                || self.shared.offers_coefficients(&kind, source);
            if is_confirmed {
                confirmed.merge(kind)
            } else {
                rest.merge(kind)
            };
        }
        (confirmed, rest)
    }

    /// A part that serves all sessions: `new` ephemerides, and the coefficients of `brought`.
    fn shared_part(
        &self,
        mut new: Navigation,
        brought: &Navigation,
        source: Arc<str>,
        ended: Vec<Ephemeris>,
    ) -> Part {
        let accepted = self.shared.acceptable_coefficients(brought, &source);
        let ephemerides: Vec<Ephemeris> =
            new.satellites().flat_map(|(_, list)| list.iter().cloned()).collect();
        new = accepted;
        new.insert_all(ephemerides.iter().cloned());
        let ended_owned = self.devices.displaced(&ephemerides);
        let ended_coefficients = self.devices.same_coefficients(&new);
        Part { source, new, ended, ended_owned, ended_coefficients }
    }

    /// The data that serve the session of a device.
    pub(super) fn pushed_for(&self, device: &str) -> PushedNavigation {
        let push = self.push;
        let Some(own) = self.devices.of(device) else {
            return PushedNavigation { push, navigation: self.shared.navigation.clone() };
        };
        let views = || self.views.lock().unwrap_or_else(PoisonError::into_inner);
        let known = views().get(device);
        let navigation = known.unwrap_or_else(|| {
            let view = Arc::new(self.shared.view(own));
            views().insert(device, view.clone(), own);
            view
        });
        PushedNavigation { push, navigation }
    }

    /// Adds a part that is stored as push number `push`.
    pub(super) fn take_over(
        &mut self,
        push: u64,
        part: Part,
        new: Vec<Ephemeris>,
        stored_unix_ms: i64,
    ) {
        let Part { source, new: brought, ended, ended_owned, ended_coefficients } = part;
        let views = self.views.get_mut().unwrap_or_else(PoisonError::into_inner);
        self.push = push;
        self.shared.remove(&ended);
        for (owner, ephemeris) in &ended_owned {
            self.devices.remove(owner, ephemeris);
            views.remove(owner);
        }
        for (owner, coefficients) in &ended_coefficients {
            self.devices.remove_coefficients(owner, coefficients);
            views.remove(owner);
        }
        if trust(&source) == Trust::Device {
            new.into_iter().for_each(|e| self.devices.insert(&source, e, stored_unix_ms));
            self.devices.insert_coefficients(&source, brought);
            views.remove(&source);
        } else {
            new.into_iter().for_each(|e| self.shared.insert(e, &source, stored_unix_ms));
            self.shared.insert_coefficients(&brought, &source);
            views.clear();
        }
    }
}
