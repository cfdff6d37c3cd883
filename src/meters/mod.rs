//! Counters, gauges and histograms, and the process's own use of the machine.
//!
//! Each desk owns the meters of its work. `contract::metrics` writes the operator's page of all
//! meters. A meter is a number that any task may raise without waiting; its clones share it.

use std::fs;

pub(crate) use prometheus_client::metrics::counter::Counter;
pub(crate) use prometheus_client::metrics::family::Family;
pub(crate) use prometheus_client::metrics::gauge::Gauge;
pub(crate) use prometheus_client::metrics::histogram::Histogram;

/// Upper bounds of the buckets of a time (s): three per decade, from 0.1 ms to 10 s.
const TIMES_S: [f64; 16] =
    [1e-4, 2e-4, 5e-4, 1e-3, 2e-3, 5e-3, 1e-2, 2e-2, 5e-2, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0];
/// Upper bounds of the buckets of a number.
const NUMBERS: [f64; 13] =
    [1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0, 128.0, 256.0, 512.0, 1024.0, 2048.0, 4096.0];
/// Clock ticks of `/proc` (1/s); Linux fixes it for all user programs (proc(5)).
const TICKS_PER_S: f64 = 100.0;

/// The label of a meter: its name and its value, both from fixed lists.
pub(crate) type Label = [(&'static str, &'static str); 1];

/// A histogram of times (s).
pub(crate) fn times() -> Histogram {
    Histogram::new(TIMES_S)
}

/// A histogram of numbers.
pub(crate) fn numbers() -> Histogram {
    Histogram::new(NUMBERS)
}

/// The resources that a process uses, as far as the system reports them.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Usage {
    /// Processor time since the start, of user and system (s).
    pub(crate) processor_s: Option<f64>,
    /// Resident memory (bytes).
    pub(crate) resident_bytes: Option<u64>,
    /// Open file descriptors.
    pub(crate) open_files: Option<u64>,
}

impl Usage {
    /// The present use of this process; proc(5).
    pub(crate) fn now() -> Self {
        Self::of("self")
    }

    /// The present use of the process with this number.
    pub(crate) fn of(process: &str) -> Self {
        let read = |file: &str| fs::read_to_string(format!("/proc/{process}/{file}")).ok();
        let files = fs::read_dir(format!("/proc/{process}/fd"));
        Self {
            processor_s: read("stat").as_deref().and_then(processor_s),
            resident_bytes: read("status").as_deref().and_then(resident_bytes),
            open_files: files.ok().map(|files| files.count() as u64),
        }
    }
}

/// The fields utime and stime, numbers 14 and 15 of `/proc/self/stat`.
fn processor_s(stat: &str) -> Option<f64> {
    // The second field is the program's name in parentheses, which may have spaces.
    let (_, after_name) = stat.rsplit_once(')')?;
    let mut fields = after_name.split_whitespace().skip(11).map(|field| field.parse::<f64>());
    let (user, system) = (fields.next()?.ok()?, fields.next()?.ok()?);
    Some((user + system) / TICKS_PER_S)
}

fn resident_bytes(status: &str) -> Option<u64> {
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"))?;
    let kilobytes: u64 = line.trim().strip_suffix(" kB")?.parse().ok()?;
    Some(kilobytes << 10)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn use_is_read_from_proc() {
        let stat = "42 (a ) b) S 1 42 42 0 -1 4194560 900 0 3 0 150 25 0 0 20 0 9 0 77 1 2";
        assert_eq!(processor_s(stat), Some(1.75));
        assert_eq!(resident_bytes("Name:\tx\nVmRSS:\t    2048 kB\n"), Some(2 << 20));
        assert_eq!((processor_s("42 (x) S"), resident_bytes("Name:\tx\n")), (None, None));
        let own = Usage::now();
        assert!(own.resident_bytes > Some(1 << 20) && own.open_files > Some(2), "{own:?}");
    }
}
