//! Views: the navigation data for the session of a device that has data of its own. Only the views
//! that were made last are kept.

use std::collections::{BTreeMap, VecDeque};
use std::mem::size_of;
use std::sync::Arc;

use crate::gnss::{Ephemeris, Navigation};

/// Most memory of the lists that views do not share with the common data (bytes).
const BYTES_MAX: usize = 64 << 20;
/// Memory of a view besides its lists (bytes).
const OVERHEAD: usize = 8 << 10;

/// Views by device, up to a limit of their memory.
#[derive(Default)]
pub(super) struct Views {
    views: BTreeMap<Arc<str>, (Arc<Navigation>, usize)>,
    /// The devices in the order in which their views were made. Devices whose views have been
    /// removed since are skipped.
    order: VecDeque<Arc<str>>,
    bytes: usize,
}

impl Views {
    pub(super) fn get(&self, device: &str) -> Option<Arc<Navigation>> {
        self.views.get(device).map(|(view, _)| view.clone())
    }

    /// Adds the view of a device with data `own`. The oldest views are removed to make room.
    pub(super) fn insert(&mut self, device: &str, view: Arc<Navigation>, own: &Navigation) {
        self.remove(device);
        let lists = own.satellites().map(|(satellite, _)| view.of(satellite).len());
        let bytes = OVERHEAD + lists.sum::<usize>() * size_of::<Ephemeris>();
        let device: Arc<str> = device.into();
        self.bytes += bytes;
        self.views.insert(device.clone(), (view, bytes));
        self.order.push_back(device);
        while BYTES_MAX < self.bytes {
            let Some(oldest) = self.order.pop_front() else { break };
            self.remove(&oldest);
        }
        if 2 * self.views.len() + 16 < self.order.len() {
            self.order.retain(|device| self.views.contains_key(device));
        }
    }

    /// Removes the view of a device because its data, or the common data, have changed.
    pub(super) fn remove(&mut self, device: &str) {
        let removed = self.views.remove(device);
        self.bytes -= removed.map_or(0, |(_, bytes)| bytes);
    }

    pub(super) fn clear(&mut self) {
        *self = Self::default();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn views_have_a_limit() {
        let mut views = Views::default();
        let own = Navigation::default();
        let most = BYTES_MAX / OVERHEAD;
        for number in 0..2 * most {
            views.insert(&format!("device {number}"), Arc::default(), &own);
            views.insert("device again", Arc::default(), &own);
        }
        assert!(views.bytes <= BYTES_MAX && views.views.len() <= most);
        assert!(views.order.len() <= 2 * most + 16);
        let newest = format!("device {}", 2 * most - 1);
        assert!(views.get(&newest).is_some() && views.get("device 0").is_none());
        views.remove(&newest);
        assert!(views.get(&newest).is_none());
    }
}
