//! How streams are kept up, and files asked for.

use std::time::Duration;

/// How streams are kept up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FeedOptions {
    /// A stream that is silent so long is asked for anew.
    pub silence: Duration,
    /// A stream whose bytes hold no epoch for so long is asked for anew.
    pub no_epochs: Duration,
    /// First delay before it is asked for again.
    pub delay: Duration,
    /// Longest delay.
    pub delay_ceiling: Duration,
    /// First delay where somebody must change something before it can succeed.
    pub lasting_delay: Duration,
    /// Longest of these.
    pub lasting_ceiling: Duration,
    /// A stream that came so long begins with the first delay again.
    pub steady: Duration,
    /// How often a caster that computes a stream for a place is told it.
    pub position_interval: Duration,
    /// First delay before a file of a base that is not there is asked for again.
    pub file_delay: Duration,
    /// Longest of these.
    pub file_ceiling: Duration,
    /// A file that still grows is asked for again after so long.
    pub file_refresh: Duration,
}

impl FeedOptions {
    /// What casters of the internet ask for.
    pub const fn standard() -> Self {
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
