//! The rover's pseudoranges, corrected by those of the base.
//!
//! The single difference z = P_rover − P_base is free of the errors of orbit, satellite clock and
//! atmosphere, but it contains −c·δt_b, the clock offset of the base (m). The rover's Doppler and
//! phases do not contain it. So the offset is added to z, and pseudoranges, Doppler and phases then
//! have one clock, that of the rover:
//!
//! P = z + c·δt_b
//!
//! The offset is estimated from the base's residuals, which are its pseudoranges less range,
//! satellite clock and troposphere. A residual is the clock offset plus the ionospheric delay, and
//! the delay differs between satellites. So only the change of each satellite's residual counts:
//!
//! c·δt_b(t) = c·δt_b(t − Δt) + median of the changes of the residuals since t − Δt
//!
//! The offset therefore makes no step when a satellite comes or goes.

use crate::gnss::SatelliteId;
use crate::graph::median;
use crate::positioning::measurements::CorrectedRanges;
use crate::snapshot::state_fields;

use super::SingleDifferences;

/// The clock offset of the base, and its residuals at the last epoch.
#[derive(Debug, Default)]
pub(crate) struct BaseClock {
    /// c·δt_b (m).
    clock_m: f64,
    /// In order of the satellites.
    residuals_m: Vec<(SatelliteId, f64)>,
}

state_fields!(BaseClock { clock_m, residuals_m });

impl BaseClock {
    /// Follows the clock to an epoch that was differenced.
    pub(crate) fn follow(&mut self, differences: &SingleDifferences, numbers: &mut Vec<f64>) {
        let residuals_m = differences.satellites.iter().map(|s| (s.satellite, s.base_offset_m));
        self.follow_residuals(residuals_m, numbers);
    }

    /// Without a satellite of the last epoch the clock starts again, at the median of the
    /// residuals.
    fn follow_residuals(
        &mut self,
        residuals_m: impl Iterator<Item = (SatelliteId, f64)> + Clone,
        numbers: &mut Vec<f64>,
    ) {
        let before = &self.residuals_m;
        let change_m = |(satellite, residual_m): (SatelliteId, f64)| {
            let index = before.binary_search_by_key(&satellite, |known| known.0).ok()?;
            Some(residual_m - before[index].1)
        };
        numbers.clear();
        numbers.extend(residuals_m.clone().filter_map(change_m));
        match median(numbers) {
            Some(change_m) => self.clock_m += change_m,
            None => {
                numbers.extend(residuals_m.clone().map(|(_, residual_m)| residual_m));
                self.clock_m = median(numbers).unwrap_or(0.0);
            }
        }
        self.residuals_m.clear();
        self.residuals_m.extend(residuals_m);
        self.residuals_m.sort_unstable_by_key(|known| known.0);
    }

    /// The pseudoranges of the rover at an epoch that was differenced.
    pub(crate) fn correct(&self, differences: &SingleDifferences, ranges: &mut CorrectedRanges) {
        ranges.clear();
        for difference in &differences.list {
            if let Some(pseudorange) = difference.pseudorange {
                let range_m = pseudorange.range_m + self.clock_m;
                ranges.push(difference.satellite, difference.codes[0], range_m);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gnss::Constellation;

    /// Residuals of 10, 20 and 30 m: the clock starts at 20 m. All grow by 1 m and a satellite with
    /// 100 m is added: 21 m. The clock stays when the residual of that satellite grows by 5 m and
    /// another satellite is lost. With other satellites the clock starts again.
    #[test]
    fn a_satellite_that_comes_does_not_move_the_clock() {
        let satellite = |n| SatelliteId::new(Constellation::Gps, n).unwrap();
        let (mut clock, mut numbers) = (BaseClock::default(), Vec::new());
        let mut follow = |seen: &[(u8, f64)]| {
            let residuals_m = seen.iter().map(|(n, residual_m)| (satellite(*n), *residual_m));
            clock.follow_residuals(residuals_m, &mut numbers);
            clock.clock_m
        };
        assert_eq!(follow(&[(3, 30.0), (1, 10.0), (2, 20.0)]), 20.0);
        assert_eq!(follow(&[(1, 11.0), (2, 21.0), (3, 31.0), (4, 100.0)]), 21.0);
        assert_eq!(follow(&[(1, 11.0), (2, 21.0), (4, 105.0)]), 21.0);
        assert_eq!(follow(&[(5, 7.0)]), 7.0);
        assert_eq!(follow(&[]), 0.0);
    }
}
