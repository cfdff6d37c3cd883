//! Limits on what the service accepts.

use serde::Deserialize;

/// Limits on what the service accepts; each has its own refusal code.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Limits {
    /// Bytes of a request body or message, after decompression in transit.
    pub body_bytes: usize,
    /// Bytes of memory for all requests together: their bodies, unpacked and decoded, and answers.
    pub request_memory_bytes: usize,
    /// Open connections. At most as many as the process may open files, less a reserve.
    pub connections: usize,
    /// Open connections from one address.
    pub connections_per_address: usize,
    /// Time for the head of a request, from the connection or the previous answer's next byte (s).
    pub head_s: u64,
    /// Longest time without a byte of a body or without progress of an answer (s).
    pub body_silence_s: u64,
    /// Time after which a connection without a request is closed (s).
    pub idle_s: u64,
    /// Bytes of an upload after unpacking.
    pub decompressed_bytes: u64,
    /// Epochs in one push.
    pub epochs_per_push: usize,
    /// Bytes in one chunk of a receiver's stream.
    pub raw_piece_bytes: usize,
    /// Satellites in one epoch.
    pub satellites_per_epoch: usize,
    /// Observations in one epoch.
    pub observations_per_epoch: usize,
    /// Time that an epoch may be ahead of the service's clock (s).
    pub future_s: u64,
    /// For how long epochs and solutions are kept (days), unless a session names a time of its own;
    /// 0 for ever.
    pub retention_days: u32,
    /// For how long entries of the audit log are kept (days); 0 for ever.
    pub audit_days: u32,
    /// For how long the history of hours is kept (days); 0 for ever. It outlives the epochs.
    pub history_days: u32,
    /// Epochs in the window of `Solve` and `SolveOnce`.
    pub solve_window_epochs: usize,
    /// Time that one `Solve` or `SolveOnce` may compute (s).
    pub solve_s: u64,
    /// Sessions with an estimator in memory; idle ones are parked.
    pub active_sessions: usize,
    /// Bytes of the encoded states of parked sessions in memory; others are restored from the
    /// database.
    pub parked_bytes: usize,
    /// Epochs that wait in the mailbox of one session.
    pub mailbox_epochs: usize,
    /// Epochs that wait in all mailboxes together.
    pub waiting_epochs: usize,
    /// Streams that are open.
    pub streams: usize,
    /// Streams of one key that are open.
    pub streams_per_key: usize,
    /// Epochs, or chunks of raw bytes, that may be on their way on one stream.
    pub stream_epochs: usize,
    /// Bytes of messages that may be on their way on one stream.
    pub stream_bytes: usize,
    /// Time after which a stream without a message is ended (s).
    pub stream_idle_s: u64,
    /// Watches that are open.
    pub watches: usize,
    /// Watches of one key that are open.
    pub watches_per_key: usize,
    /// Newly committed solutions in memory for those who watch; who is further behind reads the
    /// database.
    pub live_solutions: usize,
    /// Ephemerides kept in memory for one satellite.
    pub ephemerides_per_satellite: usize,
    /// Number of base stations.
    pub bases: usize,
    /// Epochs kept in memory for one base; newer ones push out the oldest.
    pub epochs_per_base: usize,
    /// Bytes kept in memory for one base: 11 or 12 a signal and epoch from RINEX, up to 42 else.
    /// Newer epochs push out the oldest.
    pub bytes_per_base: usize,
    /// Bytes that the disk of a SQLite database must have left; with fewer `/readyz` answers 503.
    pub disk_free_min_bytes: u64,
    /// Time for which a stopping service still serves while `/readyz` answers 503, so that a load
    /// balancer looks elsewhere (s).
    pub drain_notice_s: u64,
    /// Time that running requests have to finish when the service stops (s).
    pub drain_s: u64,
}

/// Limits on the content of one push.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct IntakeLimits {
    /// Epochs in one push.
    pub epochs_per_push: usize,
    /// Satellites in one epoch.
    pub satellites_per_epoch: usize,
    /// Observations in one epoch.
    pub observations_per_epoch: usize,
}

impl Limits {
    /// Limits for one small machine.
    pub const fn standard() -> Self {
        Self {
            body_bytes: 16 << 20,
            request_memory_bytes: 128 << 20,
            connections: 16_384,
            connections_per_address: 8_192,
            head_s: 10,
            body_silence_s: 10,
            idle_s: 300,
            decompressed_bytes: 128 << 20,
            epochs_per_push: 1024,
            raw_piece_bytes: 256 << 10,
            satellites_per_epoch: 128,
            observations_per_epoch: 512,
            future_s: 86_400,
            retention_days: 90,
            audit_days: 400,
            history_days: 400,
            solve_window_epochs: 300,
            solve_s: 5,
            active_sessions: 4096,
            parked_bytes: 512 << 20,
            mailbox_epochs: 2048,
            waiting_epochs: 32_768,
            streams: 16_384,
            streams_per_key: 12_288,
            stream_epochs: 256,
            stream_bytes: 512 << 10,
            stream_idle_s: 300,
            watches: 1024,
            watches_per_key: 768,
            live_solutions: 4096,
            ephemerides_per_satellite: 480,
            bases: 64,
            epochs_per_base: 100_000,
            bytes_per_base: 32 << 20,
            disk_free_min_bytes: 64 << 20,
            drain_notice_s: 0,
            drain_s: 20,
        }
    }

    /// The limits that apply to one push.
    pub const fn intake(&self) -> IntakeLimits {
        IntakeLimits {
            epochs_per_push: self.epochs_per_push,
            satellites_per_epoch: self.satellites_per_epoch,
            observations_per_epoch: self.observations_per_epoch,
        }
    }

    /// The name of a limit that must not be 0 and is.
    pub(super) fn zero(&self) -> Option<&'static str> {
        let must_be_positive = [
            ("body_bytes", self.body_bytes),
            ("request_memory_bytes", self.request_memory_bytes),
            ("connections", self.connections),
            ("connections_per_address", self.connections_per_address),
            ("head_s", self.head_s as usize),
            ("body_silence_s", self.body_silence_s as usize),
            ("idle_s", self.idle_s as usize),
            ("decompressed_bytes", usize::try_from(self.decompressed_bytes).unwrap_or(usize::MAX)),
            ("epochs_per_push", self.epochs_per_push),
            ("raw_piece_bytes", self.raw_piece_bytes),
            ("satellites_per_epoch", self.satellites_per_epoch),
            ("observations_per_epoch", self.observations_per_epoch),
            ("solve_window_epochs", self.solve_window_epochs),
            ("solve_s", self.solve_s as usize),
            ("active_sessions", self.active_sessions),
            ("mailbox_epochs", self.mailbox_epochs),
            ("waiting_epochs", self.waiting_epochs),
            ("streams", self.streams),
            ("streams_per_key", self.streams_per_key),
            ("stream_epochs", self.stream_epochs),
            ("stream_bytes", self.stream_bytes),
            ("stream_idle_s", self.stream_idle_s as usize),
            ("watches", self.watches),
            ("watches_per_key", self.watches_per_key),
            ("live_solutions", self.live_solutions),
            ("ephemerides_per_satellite", self.ephemerides_per_satellite),
            ("bases", self.bases),
            ("epochs_per_base", self.epochs_per_base),
            ("bytes_per_base", self.bytes_per_base),
        ];
        must_be_positive.into_iter().find(|(_, value)| *value == 0).map(|(name, _)| name)
    }
}

// `serde(default)` asks for `Default`. Nothing else uses it.
impl Default for Limits {
    fn default() -> Self {
        Self::standard()
    }
}
