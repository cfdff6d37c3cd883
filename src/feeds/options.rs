//! Timing of streams and of file requests.

use std::time::Duration;

/// Timing of streams and of file requests.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FeedOptions {
    /// A stream without a byte for this long is requested again.
    pub silence: Duration,
    /// A stream without an epoch for this long is requested again.
    pub no_epochs: Duration,
    /// First delay before a stream is requested again.
    pub delay: Duration,
    /// Longest delay before a stream is requested again.
    pub delay_ceiling: Duration,
    /// First delay if the stream cannot succeed before somebody changes something.
    pub lasting_delay: Duration,
    /// Longest delay if the stream cannot succeed before somebody changes something.
    pub lasting_ceiling: Duration,
    /// After a stream has lasted this long, its delays start again from the first delay.
    pub steady: Duration,
    /// Time between two position reports to a caster that computes the stream for a position.
    pub position_interval: Duration,
    /// First delay before a missing file of a base is requested again.
    pub file_delay: Duration,
    /// Longest delay before a missing file of a base is requested again.
    pub file_ceiling: Duration,
    /// Delay before a file that may still grow is requested again.
    pub file_refresh: Duration,
}

impl FeedOptions {
    /// Suitable for public casters and archives.
    pub(crate) const fn standard() -> Self {
        Self {
            silence: Duration::from_secs(30),
            no_epochs: Duration::from_secs(120),
            delay: Duration::from_secs(1),
            delay_ceiling: Duration::from_secs(60),
            lasting_delay: Duration::from_secs(60),
            lasting_ceiling: Duration::from_secs(900),
            steady: Duration::from_secs(60),
            position_interval: Duration::from_secs(10),
            file_delay: Duration::from_secs(30),
            file_ceiling: Duration::from_secs(3600),
            file_refresh: Duration::from_secs(900),
        }
    }
}
