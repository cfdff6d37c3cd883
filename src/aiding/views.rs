//! Views: the navigation data for the session of a device that has data of its own. Only the views
//! that were made last are kept.

use std::collections::BTreeMap;
use std::mem::size_of;
use std::sync::Arc;

use crate::gnss::{Ephemeris, Navigation};

/// Most memory of the lists that views do not share with the common data (bytes).
const BYTES_MAX: usize = 64 << 20;
/// Memory of a view besides its lists (bytes).
const OVERHEAD: usize = 8 << 10;

/// The navigation data for one device.
struct View {
    navigation: Arc<Navigation>,
    bytes: usize,
    /// When it was made: views are numbered.
    number: u64,
}

/// Views by device, up to a limit of their memory.
#[derive(Default)]
pub(super) struct DeviceViews {
    views: BTreeMap<Arc<str>, View>,
    /// The devices by the numbers of their views: the oldest view first.
    by_number: BTreeMap<u64, Arc<str>>,
    /// Number of views made so far.
    made: u64,
    bytes: usize,
}

impl DeviceViews {
    pub(super) fn get(&self, device: &str) -> Option<Arc<Navigation>> {
        self.views.get(device).map(|view| view.navigation.clone())
    }

    /// Adds the view of a device with data `own`. The oldest views are removed to make room.
    pub(super) fn insert(&mut self, device: &str, navigation: Arc<Navigation>, own: &Navigation) {
        self.remove(device);
        let lists = own.satellites().map(|(satellite, _)| navigation.of(satellite).len());
        let bytes = OVERHEAD + lists.sum::<usize>() * size_of::<Ephemeris>();
        let (device, number): (Arc<str>, u64) = (device.into(), self.made);
        self.made += 1;
        self.bytes += bytes;
        self.by_number.insert(number, device.clone());
        self.views.insert(device, View { navigation, bytes, number });
        while BYTES_MAX < self.bytes {
            let Some((_, oldest)) = self.by_number.pop_first() else { break };
            self.remove(&oldest);
        }
    }

    /// Removes the view of a device because its data, or the common data, have changed.
    pub(super) fn remove(&mut self, device: &str) {
        if let Some(view) = self.views.remove(device) {
            self.bytes -= view.bytes;
            self.by_number.remove(&view.number);
        }
    }

    /// Removes all views.
    pub(super) fn clear(&mut self) {
        *self = Self::default();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn views_have_a_limit() {
        let mut views = DeviceViews::default();
        let own = Navigation::default();
        let most = BYTES_MAX / OVERHEAD;
        for number in 0..2 * most {
            views.insert(&format!("device {number}"), Arc::default(), &own);
            views.insert("device again", Arc::default(), &own);
        }
        assert!(views.bytes <= BYTES_MAX && views.views.len() <= most);
        assert_eq!(views.by_number.len(), views.views.len());
        let newest = format!("device {}", 2 * most - 1);
        assert!(views.get(&newest).is_some() && views.get("device 0").is_none());
        views.remove(&newest);
        assert!(views.get(&newest).is_none());
    }

    /// A device whose data change again and again has one view, and keeps it while older ones of
    /// other devices are removed.
    #[test]
    fn a_device_has_one_view() {
        let (mut views, own) = (DeviceViews::default(), Navigation::default());
        let most = BYTES_MAX / OVERHEAD;
        views.insert("other", Arc::default(), &own);
        for _ in 0..4 * most {
            views.insert("device", Arc::default(), &own);
        }
        assert_eq!((views.views.len(), views.by_number.len()), (2, 2));
        assert_eq!(views.bytes, 2 * OVERHEAD);
        for number in 0..most - 1 {
            views.insert(&format!("device {number}"), Arc::default(), &own);
        }
        assert!(views.get("other").is_none() && views.get("device").is_some());
    }
}
