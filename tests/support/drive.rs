//! A simulated drive, for tests without data: observations and their navigation data.

use std::sync::LazyLock;

use graphfix::formats::rinex::write_navigation;
use graphfix::gnss::{Constellation, Epoch, Navigation};
use graphfix::session::SequencedEpoch;
use graphfix::simulation::{Scenario, Simulator};

pub(crate) struct Drive {
    /// Numbered from 1.
    pub(crate) epochs: Vec<SequencedEpoch>,
    pub(crate) navigation: Navigation,
}

/// Six minutes among tall buildings, an epoch a second, with one epoch without observations and a
/// gap of two and a half minutes.
pub(crate) static DRIVE: LazyLock<Drive> = LazyLock::new(|| {
    let canyon = Scenario::by_name("urban-canyon").unwrap();
    let simulator = Simulator::new(Scenario { duration_s: 510.0, ..canyon }, 7);
    let navigation = Navigation::clone(simulator.navigation());
    let mut epochs: Vec<Epoch> = simulator.map(|epoch| epoch.rover).collect();
    epochs[90].observations.clear();
    epochs.drain(200..350);
    let number = |(index, epoch)| SequencedEpoch { seq: index as u64 + 1, epoch };
    Drive { epochs: epochs.into_iter().enumerate().map(number).collect(), navigation }
});

impl Drive {
    /// The navigation data as a file.
    pub(crate) fn navigation_file(&self) -> Vec<u8> {
        let mut file = Vec::new();
        write_navigation(&mut file, &self.navigation).unwrap();
        file
    }

    /// The navigation data without Galileo's ephemerides.
    pub(crate) fn navigation_without_galileo(&self) -> Navigation {
        let mut navigation = self.navigation.clone();
        navigation.retain(|e| e.satellite().constellation != Constellation::Galileo);
        navigation
    }
}
