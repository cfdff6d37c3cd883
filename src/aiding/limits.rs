//! Limits of the brokers.

/// Limits of the brokers; with the number of satellites they bound their memory.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AidingLimits {
    /// Ephemerides held of one satellite: further ones push out those of the oldest `toe`, but
    /// never one that came with them.
    pub ephemerides_per_satellite: usize,
    /// Ephemerides no longer in force that are stored for replay: the oldest are forgotten first.
    pub superseded_ephemerides: usize,
    /// Bases.
    pub bases: usize,
    /// Epochs held of one base: further ones push out the oldest.
    pub epochs_per_base: usize,
    /// Bytes that the epochs of one base take: further ones push out the oldest.
    pub bytes_per_base: usize,
    /// Observations of one epoch of a base.
    pub observations_per_epoch: usize,
    /// Characters of a base's label.
    pub label_characters: usize,
}

impl AidingLimits {
    /// Limits of a service: ten days of half-hourly ephemerides of each satellite, and for replay
    /// about another month of 120 satellites; of 64 bases about four hours of 80 signals a second,
    /// or a day of 15 s epochs.
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
