//! Since when a pseudorange is heard: its error lasts, whether its phase is followed or not.

use crate::gnss::{GpsTime, ObservationCode, SatelliteId};
use crate::positioning::differencing::SingleDifference;
use crate::snapshot::{snapshot_fields, state_fields};

/// Carriers remembered; the pseudoranges of those beyond them count as new.
const HEARD_MAX: usize = 1024;

/// The newest pseudorange of one carrier.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Heard {
    satellite: SatelliteId,
    /// Codes at rover and base.
    codes: [ObservationCode; 2],
    last: GpsTime,
}

/// The newest pseudoranges of all carriers heard of late.
#[derive(Debug, Default)]
pub(super) struct HeardRanges {
    list: Vec<Heard>,
}

snapshot_fields!(Heard { satellite, codes, last });
state_fields!(HeardRanges { list });

impl HeardRanges {
    /// The share of a pseudorange's information that is new: what time has passed since the last
    /// one, over the time `correlation_s` that errors last; one where none was heard for so long.
    pub(super) fn share(
        &mut self,
        difference: &SingleDifference,
        time: GpsTime,
        correlation_s: f64,
    ) -> f64 {
        let SingleDifference { satellite, codes, .. } = *difference;
        let is_it = |heard: &&mut Heard| (heard.satellite, heard.codes) == (satellite, codes);
        if let Some(heard) = self.list.iter_mut().find(is_it) {
            let share = ((time - heard.last) / correlation_s).min(1.0);
            heard.last = time;
            return share;
        }
        if self.list.len() < HEARD_MAX {
            self.list.push(Heard { satellite, codes, last: time });
        }
        1.0
    }

    /// Forgets what was not heard since `time`.
    pub(super) fn forget_before(&mut self, time: GpsTime) {
        self.list.retain(|heard| time <= heard.last);
    }

    /// Forgets all.
    pub(super) fn clear(&mut self) {
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
            rover_lost_lock: false,
            half_cycle: false,
        }
    }

    /// Errors of 30 s: what comes 6 s after the last is a fifth new, what comes 40 s after it all new.
    #[test]
    fn what_is_heard_again_is_new_in_part() {
        let mut heard = HeardRanges::default();
        let at = |seconds: f64| GpsTime::EPOCH + seconds;
        let mut share =
            |number, code, seconds| heard.share(&difference(number, code), at(seconds), 30.0);
        assert_eq!(share(7, "1C", 0.0), 1.0);
        assert_eq!(share(7, "1C", 6.0), 0.2);
        assert_eq!(share(7, "1W", 6.0), 1.0, "another code");
        assert_eq!(share(8, "1C", 6.0), 1.0, "another satellite");
        assert_eq!(share(7, "1C", 46.0), 1.0);
        heard.forget_before(at(46.0));
        assert_eq!(heard.list.len(), 1);
        heard.clear();
        assert_eq!(heard.share(&difference(7, "1C"), at(47.0), 30.0), 1.0);
    }
}
