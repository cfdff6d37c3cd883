//! The time since the last pseudorange of each carrier. Errors stay correlated over that time, also
//! if the phase was not tracked meanwhile.

use crate::gnss::{GpsTime, ObservationCode, SatelliteId};
use crate::positioning::differencing::SingleDifference;
use crate::snapshot::{snapshot_fields, state_fields};

/// Maximum number of carriers; pseudoranges of further ones have their full weight.
const CARRIERS_MAX: usize = 1024;

/// When a carrier last had a pseudorange.
#[derive(Clone, Copy, Debug, PartialEq)]
struct LastPseudorange {
    satellite: SatelliteId,
    /// Codes at rover and base.
    codes: [ObservationCode; 2],
    last: GpsTime,
}

/// When each carrier last had a pseudorange.
#[derive(Debug, Default)]
pub(crate) struct LastPseudoranges {
    list: Vec<LastPseudorange>,
}

snapshot_fields!(LastPseudorange { satellite, codes, last });
state_fields!(LastPseudoranges { list });

impl LastPseudoranges {
    /// Records a pseudorange. Returns the fraction of its information that is independent of the
    /// carrier's last one: the time since then over the correlation time of errors, at most one.
    pub(crate) fn record(
        &mut self,
        difference: &SingleDifference,
        time: GpsTime,
        correlation_s: f64,
    ) -> f64 {
        let SingleDifference { satellite, codes, .. } = *difference;
        let is_it =
            |last: &&mut LastPseudorange| (last.satellite, last.codes) == (satellite, codes);
        if let Some(known) = self.list.iter_mut().find(is_it) {
            let independent_share = ((time - known.last) / correlation_s).min(1.0);
            known.last = time;
            return independent_share;
        }
        if self.list.len() < CARRIERS_MAX {
            self.list.push(LastPseudorange { satellite, codes, last: time });
        }
        1.0
    }

    /// Forgets carriers without a pseudorange since `time`.
    pub(crate) fn forget_before(&mut self, time: GpsTime) {
        self.list.retain(|known| time <= known.last);
    }

    /// Forgets all carriers.
    pub(crate) fn clear(&mut self) {
        self.list.clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gnss::{Band, Constellation};

    fn difference(number: u8, code: &str) -> SingleDifference {
        SingleDifference {
            common: 0,
            satellite: SatelliteId::new(Constellation::Gps, number).unwrap(),
            band: Band::L1,
            codes: [code, "1C"].map(|code| ObservationCode::parse(code).unwrap()),
            shares_code: code == "1C",
            frequency_hz: 1_575.42e6,
            pseudorange: None,
            carrier: None,
            half_cycle: false,
        }
    }

    /// With a correlation time of 30 s, a pseudorange 6 s after the last one is one fifth
    /// independent; one 40 s after it is fully independent.
    #[test]
    fn a_pseudorange_soon_after_another_counts_in_part() {
        let mut ages = LastPseudoranges::default();
        let at = |seconds: f64| GpsTime::EPOCH + seconds;
        let mut independent_share =
            |number, code, seconds| ages.record(&difference(number, code), at(seconds), 30.0);
        assert_eq!(independent_share(7, "1C", 0.0), 1.0);
        assert_eq!(independent_share(7, "1C", 6.0), 0.2);
        assert_eq!(independent_share(7, "1W", 6.0), 1.0, "another code");
        assert_eq!(independent_share(8, "1C", 6.0), 1.0, "another satellite");
        assert_eq!(independent_share(7, "1C", 46.0), 1.0);
        ages.forget_before(at(46.0));
        assert_eq!(ages.list.len(), 1);
        ages.clear();
        assert_eq!(ages.record(&difference(7, "1C"), at(47.0), 30.0), 1.0);
    }
}
