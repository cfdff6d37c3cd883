//! The number of open connections, in total and from one address.

use std::collections::HashMap;
use std::net::IpAddr;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::contract::Refusal;
use crate::meters::Gauge;
use crate::refusal::Code;

/// File descriptors that are reserved for the database, the feeds and the log.
const OTHER_FILES: usize = 256;
/// The file in which Linux reports how many file descriptors the process may open.
const PROCESS_LIMITS: &str = "/proc/self/limits";

/// The connections that may be open. All clones share them.
#[derive(Clone)]
pub(super) struct ConnectionSlots(Arc<Shared>);

struct Shared {
    /// The connections that are open.
    open: Gauge,
    most: usize,
    most_of_address: usize,
    taken: Mutex<Taken>,
}

#[derive(Default)]
struct Taken {
    all: usize,
    of_address: HashMap<IpAddr, usize>,
}

/// An open connection. Dropping it frees its slot.
pub(super) struct ConnectionSlot {
    slots: ConnectionSlots,
    address: IpAddr,
}

impl ConnectionSlots {
    /// Slots for `most` connections, at most `most_of_address` from one address. Both are lower if
    /// the process may open fewer files. `open` counts the connections that are open.
    pub(super) fn new(most: usize, most_of_address: usize, open: Gauge) -> Self {
        let files = open_files(&std::fs::read_to_string(PROCESS_LIMITS).unwrap_or_default());
        let by_files = files.map_or(usize::MAX, |files| files.saturating_sub(OTHER_FILES).max(16));
        if by_files < most {
            tracing::info!(connections = by_files, "the limit of open files bounds connections");
        }
        let most = most.min(by_files);
        let most_of_address = match by_files {
            usize::MAX => most_of_address,
            _ => most_of_address.min(most.div_ceil(2).max(16)),
        };
        Self(Arc::new(Shared { open, most, most_of_address, taken: Mutex::default() }))
    }

    /// A slot for a connection from `address`.
    pub(super) fn take(&self, address: IpAddr) -> Result<ConnectionSlot, Refusal> {
        let mut taken = self.taken();
        let Shared { most, most_of_address, .. } = &*self.0;
        let full = |message: String| Err(Refusal::new(Code::TooManyConnections, message));
        if *most <= taken.all {
            return full(format!("{most} connections are open, as many as allowed"));
        }
        let of_address = taken.of_address.entry(address).or_default();
        if *most_of_address <= *of_address {
            let message = format!("{address} has {of_address} connections, as many as allowed");
            return full(message);
        }
        *of_address += 1;
        taken.all += 1;
        self.0.open.inc();
        Ok(ConnectionSlot { slots: self.clone(), address })
    }

    fn taken(&self) -> MutexGuard<'_, Taken> {
        self.0.taken.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for ConnectionSlot {
    fn drop(&mut self) {
        let mut taken = self.slots.taken();
        taken.all -= 1;
        self.slots.0.open.dec();
        if let Some(count) = taken.of_address.get_mut(&self.address) {
            *count -= 1;
            if *count == 0 {
                taken.of_address.remove(&self.address);
            }
        }
    }
}

/// The soft limit of open files in a text like `/proc/self/limits`; `None` if there is no limit.
fn open_files(text: &str) -> Option<usize> {
    let line = text.lines().find_map(|line| line.strip_prefix("Max open files"))?;
    line.split_whitespace().next()?.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn connections_are_counted_in_all_and_by_address() {
        let (here, there) = (IpAddr::from([127, 0, 0, 1]), IpAddr::from([127, 0, 0, 2]));
        let open = Gauge::default();
        let slots = ConnectionSlots::new(3, 2, open.clone());
        let taken: Vec<ConnectionSlot> = (0..2).map(|_| slots.take(here).unwrap()).collect();
        assert_eq!(slots.take(here).err().unwrap().code, Code::TooManyConnections);
        let other = slots.take(there).unwrap();
        assert!(slots.take(there).is_err(), "a fourth of three");
        assert_eq!(open.get(), 3);
        drop(taken);
        assert!(slots.take(here).is_ok());
        drop(other);
        let taken = slots.taken();
        assert_eq!((taken.all, taken.of_address.len(), open.get()), (0, 0, 0));
    }

    #[test]
    fn the_limit_of_files_is_read() {
        let text = "Limit  Soft Limit  Hard Limit  Units\n\
                    Max open files            1024                 4096                 files\n";
        assert_eq!(open_files(text), Some(1024));
        assert_eq!(open_files("Max open files  unlimited unlimited files"), None);
    }
}
