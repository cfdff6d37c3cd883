//! The navigation data that serve all sessions, and how far each of them is trusted.

use std::collections::BTreeMap;
use std::sync::Arc;

use crate::gnss::{Ephemeris, Navigation, SatelliteId};

use super::devices::{coefficients, remove_coefficients};
use super::trust::{Issue, Trust, agree, contradict, issue, trust};

/// Age from which an ephemeris that is not the operator's may be removed to make room (ms).
const LASTING_MS: i64 = 86_400_000;

/// The data that serve all sessions.
#[derive(Clone, Debug, Default)]
pub(super) struct Shared {
    /// All ephemerides, coefficients and leap seconds.
    pub(super) navigation: Arc<Navigation>,
    /// The ephemerides that are not the operator's, by satellite. Clones share them until one
    /// changes.
    ranks: BTreeMap<SatelliteId, Arc<BTreeMap<Issue, Rank>>>,
    /// Sources of the coefficients, by kind.
    coefficients: [Option<Arc<str>>; 5],
}

/// Source and time of an ephemeris.
#[derive(Clone, Debug)]
struct Rank {
    source: Arc<str>,
    /// When it was stored (ms since 1970-01-01 UTC).
    stored_unix_ms: i64,
}

impl Shared {
    /// Adds an ephemeris.
    pub(super) fn insert(&mut self, ephemeris: Ephemeris, source: &Arc<str>, stored_unix_ms: i64) {
        match trust(source) {
            Trust::Operator => self.remove_rank(&issue(&ephemeris)),
            _ => {
                let rank = Rank { source: source.clone(), stored_unix_ms };
                let ranks = self.ranks.entry(ephemeris.satellite()).or_default();
                Arc::make_mut(ranks).insert(issue(&ephemeris), rank);
            }
        }
        Arc::make_mut(&mut self.navigation).insert(ephemeris);
    }

    /// Adds coefficients and leap seconds.
    pub(super) fn insert_coefficients(&mut self, brought: &Navigation, source: &Arc<str>) {
        let known = self.coefficients.iter_mut().zip(coefficients(brought));
        for (known, kind) in known {
            if let Some(kind) = kind {
                *known = Some(source.clone());
                Arc::make_mut(&mut self.navigation).merge(kind);
            }
        }
    }

    /// Removes ephemerides that are no longer in force.
    pub(super) fn remove(&mut self, ended: &[Ephemeris]) {
        for ephemeris in ended {
            Arc::make_mut(&mut self.navigation).remove(ephemeris);
            self.remove_rank(&issue(ephemeris));
        }
    }

    /// Removes coefficients and leap seconds that are no longer in force.
    pub(super) fn remove_coefficients(&mut self, ended: &Navigation) {
        let known = self.coefficients.iter_mut().zip(coefficients(ended));
        known.for_each(|(known, ended)| *known = known.take().filter(|_| ended.is_none()));
        remove_coefficients(Arc::make_mut(&mut self.navigation), ended);
    }

    fn rank(&self, issued: &Issue) -> Option<&Rank> {
        self.ranks.get(&issued.0)?.get(issued)
    }

    fn remove_rank(&mut self, issued: &Issue) {
        let Some(ranks) = self.ranks.get_mut(&issued.0) else { return };
        if ranks.contains_key(issued) {
            Arc::make_mut(ranks).remove(issued);
        }
        if ranks.is_empty() {
            self.ranks.remove(&issued.0);
        }
    }

    /// The ephemeris of the same issue.
    pub(super) fn same_issue(&self, ephemeris: &Ephemeris) -> Option<&Ephemeris> {
        let list = self.navigation.of(ephemeris.satellite());
        list.iter().find(|other| issue(other) == issue(ephemeris))
    }

    /// Number of these ephemerides that are not in force.
    pub(super) fn missing(&self, navigation: &Navigation) -> usize {
        let all = navigation.satellites().flat_map(|(_, list)| list);
        all.filter(|ephemeris| self.same_issue(ephemeris).is_none()).count()
    }

    /// The trust in an ephemeris that is in force.
    pub(super) fn trust_in(&self, ephemeris: &Ephemeris) -> Trust {
        self.rank(&issue(ephemeris)).map_or(Trust::Operator, |rank| trust(&rank.source))
    }

    /// Whether an ephemeris contradicts one whose trust is `least` or higher.
    pub(super) fn contradicts(&self, ephemeris: &Ephemeris, least: Trust) -> bool {
        let list = self.navigation.of(ephemeris.satellite());
        list.iter().any(|other| least <= self.trust_in(other) && contradict(other, ephemeris))
    }

    /// The offer of another source than `source` with the same broadcast as `ephemeris`.
    pub(super) fn confirmed_offer(
        &self,
        ephemeris: &Ephemeris,
        source: &str,
    ) -> Option<&Ephemeris> {
        let known = self.same_issue(ephemeris).filter(|known| agree(known, ephemeris))?;
        let rank = self.rank(&issue(known))?;
        (trust(&rank.source) == Trust::Offer && &*rank.source != source).then_some(known)
    }

    /// The ephemerides of lower trust that contradict one of `new`, or that have the same issue as
    /// one of `new` but differ from it.
    pub(super) fn lower(&self, new: &Navigation, than: Trust) -> Vec<Ephemeris> {
        let mut found = Vec::new();
        for (satellite, list) in new.satellites() {
            let lower = self.navigation.of(satellite).iter().filter(|e| self.trust_in(e) < than);
            let contradicted = |e: &&Ephemeris| list.iter().any(|other| contradict(e, other));
            found.extend(lower.filter(contradicted).cloned());
        }
        found
    }

    /// Makes room for `new`, with at most `limit` ephemerides for each satellite. Removes from
    /// `new` those for which there is no room, the oldest first. Data that are not the operator's
    /// end only others of their kind that are older than a day. Returns the ended ones.
    pub(super) fn make_room(
        &self,
        new: &mut Navigation,
        limit: usize,
        now_unix_ms: i64,
    ) -> Vec<Ephemeris> {
        let (mut ended, mut without_room) = (Vec::new(), Vec::new());
        for (satellite, list) in new.satellites() {
            let present = self.navigation.of(satellite);
            let is_old = |e: &&Ephemeris| {
                let rank = self.rank(&issue(e));
                rank.is_some_and(|rank| rank.stored_unix_ms + LASTING_MS < now_unix_ms)
            };
            let mut old = present.iter().filter(is_old);
            let mut free = limit.saturating_sub(present.len());
            for ephemeris in list.iter().rev().filter(|e| self.same_issue(e).is_none()) {
                if free == 0 {
                    match old.next() {
                        None => without_room.push(issue(ephemeris)),
                        Some(oldest) => ended.push(oldest.clone()),
                    }
                } else {
                    free -= 1;
                }
            }
        }
        new.retain(|ephemeris| !without_room.contains(&issue(ephemeris)));
        ended
    }

    /// The ephemerides beyond `limit` of each satellite, once `pushed` is added. None of `pushed`
    /// is among them. Those that are not the operator's come first, the oldest of them before.
    pub(super) fn excess(&self, pushed: &Navigation, limit: usize) -> Vec<Ephemeris> {
        let mut excess = Vec::new();
        for (satellite, brought) in pushed.satellites() {
            let present = self.navigation.of(satellite);
            let is_brought = |e: &Ephemeris| brought.iter().any(|b| issue(b) == issue(e));
            let mut others: Vec<&Ephemeris> = present.iter().filter(|e| !is_brought(e)).collect();
            others.sort_by_key(|ephemeris| Trust::Operator == self.trust_in(ephemeris));
            let surplus = (others.len() + brought.len()).saturating_sub(limit);
            excess.extend(others.into_iter().take(surplus).cloned());
        }
        excess
    }

    /// The coefficients of `brought` that are accepted from `source`. All are accepted from the
    /// operator. Two sources that agree may replace what is not the operator's. Other sources may
    /// only add kinds that are missing.
    pub(super) fn acceptable_coefficients(&self, brought: &Navigation, source: &str) -> Navigation {
        let mut accepted = Navigation::default();
        let known = coefficients(&self.navigation).into_iter().zip(&self.coefficients);
        for ((known, from), brought) in known.zip(coefficients(brought)) {
            let from = from.as_ref().map(|from| trust(from));
            let is_replaceable = match (from, trust(source)) {
                (None, _) | (_, Trust::Operator) => true,
                (Some(from), Trust::Agreed) => from <= Trust::Agreed,
                _ => false,
            };
            let is_new = known != brought || from.is_some_and(|from| from < trust(source));
            if let Some(brought) = brought.filter(|_| is_replaceable && is_new) {
                accepted.merge(brought);
            }
        }
        accepted
    }

    /// Whether another source than `source` has offered the same coefficients of a kind.
    pub(super) fn offers_coefficients(&self, brought: &Navigation, source: &str) -> bool {
        let known = coefficients(&self.navigation).into_iter().zip(&self.coefficients);
        known.zip(coefficients(brought)).any(|((known, from), brought)| {
            let is_offer =
                from.as_ref().is_some_and(|f| trust(f) == Trust::Offer && &**f != source);
            brought.is_some() && known == brought && is_offer
        })
    }

    /// The data that serve a session whose device has data of its own. Its own data have priority
    /// over offers of others, but not over data of higher trust.
    pub(super) fn view(&self, own: &Navigation) -> Navigation {
        let mut view = (*self.navigation).clone();
        let mut yielding: Vec<Issue> = Vec::new();
        for (satellite, list) in own.satellites() {
            let offers = self.navigation.of(satellite).iter();
            let offers = offers.filter(|e| self.trust_in(e) == Trust::Offer);
            let yields = |offer: &&Ephemeris| {
                list.iter().any(|e| issue(e) == issue(offer) || contradict(e, offer))
            };
            yielding.extend(offers.filter(yields).map(issue));
        }
        if !yielding.is_empty() {
            view.retain(|ephemeris| !yielding.contains(&issue(ephemeris)));
        }
        view.insert_all(own.satellites().flat_map(|(_, list)| list.iter().cloned()));
        for (from, own) in self.coefficients.iter().zip(coefficients(own)) {
            let yields = from.as_ref().is_none_or(|from| trust(from) == Trust::Offer);
            if let (true, Some(own)) = (yields, own) {
                view.merge(own);
            }
        }
        view
    }
}
