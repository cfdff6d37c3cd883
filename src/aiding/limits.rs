//! Limits of the brokers.

/// Limits of the brokers. Together with the number of satellites they bound the memory.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AidingLimits {
    /// Ephemerides in force per satellite. Above this number, the oldest by `toe` are dropped, but
    /// none of the same push.
    pub ephemerides_per_satellite: usize,
    /// Superseded ephemerides of each account that are stored for replay: of those that serve all
    /// sessions, of those of the operator's devices, and of those of each other tenant. Above this
    /// number, the oldest of the account are deleted. As many superseded ionosphere coefficients
    /// and leap seconds are stored.
    pub superseded_ephemerides: usize,
    /// Number of bases.
    pub bases: usize,
    /// Epochs per base. Above this number, the oldest are deleted.
    pub epochs_per_base: usize,
    /// Bytes of the encoded epochs of one base. Above this size, the oldest are deleted.
    pub bytes_per_base: usize,
    /// Observations in one epoch of a base.
    pub observations_per_epoch: usize,
    /// Characters of a base's label.
    pub label_characters: usize,
}

impl AidingLimits {
    /// Limits of a service: ten days of half-hourly ephemerides per satellite, and for replay about
    /// one more month of 120 satellites; 64 bases, each with about four hours of 80 signals at 1
    /// Hz, or a day of epochs at 15 s.
    pub fn service() -> Self {
        Self {
            ephemerides_per_satellite: 480,
            superseded_ephemerides: 200_000,
            bases: 64,
            epochs_per_base: 100_000,
            bytes_per_base: 32 << 20,
            observations_per_epoch: 512,
            label_characters: 200,
        }
    }
}
