//! Whether a receiver's pseudoranges of two bands have one clock.
//!
//! L5 is another path through the receiver's electronics. Most receivers are calibrated to some
//! nanoseconds, but in a Pixel 4 pseudoranges of L5 are 2.1 to 2.4 km shorter than those of L1. A
//! satellite that is received on L5 alone does not show this; satellites received on both bands do.
//! The ionosphere changes the difference by less than 100 m, and multipath by W = 440 m at the most
//! (`pseudorange_error`), so a median above W is a delay of the receiver.

use crate::gnss::{Band, Constellation, Epoch, Observation, Signal};
use crate::graph::median;
use crate::positioning::pseudorange_error::WILD_M;
use crate::snapshot::snapshot_fields;

use super::PSEUDORANGES_M;

/// The delay between L5 and L1, from the satellites received on both.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(in crate::positioning) struct ReceiverBands {
    /// L5 minus L1 of GPS and QZSS: the median of the newest epoch that had both (m).
    l5_late_m: Option<f64>,
}

snapshot_fields!(ReceiverBands { l5_late_m });

impl ReceiverBands {
    /// Bands with one clock, for a view of all signals.
    pub(in crate::positioning) const AGREEING: Self = Self { l5_late_m: Some(0.0) };

    /// The delay that one epoch shows.
    pub(in crate::positioning) fn of(epoch: &Epoch) -> Self {
        let mut bands = Self::default();
        bands.learn(epoch);
        bands
    }

    /// Updates with the satellites of an epoch that have both bands.
    pub(in crate::positioning) fn learn(&mut self, epoch: &Epoch) {
        let shared = epoch.by_satellite().filter(|(satellite, _)| {
            matches!(satellite.constellation, Constellation::Gps | Constellation::Qzss)
        });
        let mut late_m: Vec<f64> = shared
            .filter_map(|(_, observations)| {
                let range_m = |band| first_m(observations, band);
                Some(range_m(Band::L5)? - range_m(Band::L1)?)
            })
            .collect();
        self.l5_late_m = median(&mut late_m).or(self.l5_late_m);
    }

    /// Whether a satellite received on L5 alone measures the same clock as those on L1. False
    /// before a satellite had both bands.
    pub(in crate::positioning) fn agree(&self) -> bool {
        self.l5_late_m.is_some_and(|late_m| late_m.abs() <= WILD_M)
    }
}

/// The first valid pseudorange in a band (m).
fn first_m(observations: &[Observation], band: Band) -> Option<f64> {
    observations.iter().find_map(|observation| {
        let signal = Signal::of(observation.satellite, observation.code);
        let range_m = observation.pseudorange_m?;
        let is_usable = signal.band() == Some(band) && PSEUDORANGES_M.contains(&range_m);
        is_usable.then_some(range_m)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gnss::{GpsTime, ObservationCode, SatelliteId};

    /// An epoch of satellites with the pseudoranges (m) that they have on L1 and L5.
    fn epoch(satellites: &[(&str, Option<f64>, Option<f64>)]) -> Epoch {
        let observation = |name: &str, code, range_m: Option<f64>| {
            let code = ObservationCode::parse(code).unwrap();
            let satellite: SatelliteId = name.parse().unwrap();
            Some(Observation {
                pseudorange_m: Some(range_m?),
                ..Observation::empty(satellite, code)
            })
        };
        let of_satellite = |(name, first_m, fifth_m): &(&str, _, _)| {
            [observation(name, "1C", *first_m), observation(name, "5Q", *fifth_m)]
        };
        Epoch {
            observations: satellites.iter().flat_map(of_satellite).flatten().collect(),
            ..Epoch::new(GpsTime::from_week_seconds(2158, 0.0))
        }
    }

    /// As in a Pixel 4 (L5 2345 m early), and as in a P40 Pro (7 m late).
    #[test]
    fn satellites_with_both_bands_show_whether_the_bands_agree() {
        let l5_alone = ("G03", None, Some(2.2e7));
        assert!(!ReceiverBands::of(&epoch(&[l5_alone, ("G05", Some(2.1e7), None)])).agree());
        let early = [("J02", Some(3.7e7), Some(3.7e7 - 2_345.0)), l5_alone];
        assert!(!ReceiverBands::of(&epoch(&early)).agree());
        let mut bands = ReceiverBands::of(&epoch(&[("J02", Some(3.7e7), Some(3.7e7 + 7.0))]));
        assert!(bands.agree());
        // Nothing is learnt from an epoch without both bands, nor from other constellations.
        bands.learn(&epoch(&[l5_alone, ("E11", Some(2.5e7), Some(2.5e7 - 2_125.0))]));
        assert!(bands.agree());
    }

    /// One wild pseudorange of three decides nothing; 440 m is the most that multipath can do.
    #[test]
    fn the_median_decides() {
        let epoch = epoch(&[
            ("G01", Some(2.0e7), Some(2.0e7 + 90_000.0)),
            ("G06", Some(2.1e7), Some(2.1e7 - 439.0)),
            ("G09", Some(2.2e7), Some(2.2e7 - 441.0)),
        ]);
        assert_eq!(ReceiverBands::of(&epoch), ReceiverBands { l5_late_m: Some(-439.0) });
        assert!(ReceiverBands::of(&epoch).agree());
    }
}
