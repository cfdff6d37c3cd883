//! Losses of lock of the receivers, reported or possible.

use crate::gnss::{Epoch, ObservationCode, SatelliteId};
use crate::snapshot::state_fields;

/// A carrier that a receiver tracks.
pub(crate) type Tracked = (SatelliteId, ObservationCode);

/// Carriers on which either receiver may have slipped since the last epoch.
#[derive(Debug, Default)]
pub(crate) struct Losses {
    /// All carriers: a receiver lost power, the base moved, or each epoch is solved alone.
    pub(crate) all: bool,
    pub(crate) rover: Vec<Tracked>,
    pub(crate) base: Vec<Tracked>,
}

impl Losses {
    /// Whether the carrier with these codes at rover and base is among them.
    pub(crate) fn has(&self, satellite: SatelliteId, codes: [ObservationCode; 2]) -> bool {
        self.all
            || self.rover.contains(&(satellite, codes[0]))
            || self.base.contains(&(satellite, codes[1]))
    }
}

/// Whether one receiver reports losses of lock, and which carriers it tracked in its last epoch.
///
/// An indicator that is not set means "OK or not known" (RINEX 2 and 3, loss of lock indicator). So
/// until a receiver has reported a loss, a carrier without a phase in the last epoch may have
/// slipped.
#[derive(Debug, Default)]
pub(crate) struct LockWatch {
    /// Whether the receiver has ever reported a loss.
    reports: bool,
    /// Carriers with a phase in its last epoch.
    tracked: Vec<Tracked>,
}

state_fields!(LockWatch { reports, tracked });

impl LockWatch {
    /// Takes in an epoch; appends the carriers that may have slipped since the last one.
    pub(crate) fn take(&mut self, epoch: &Epoch, lost: &mut Vec<Tracked>) {
        let Self { reports, tracked } = self;
        *reports |= epoch.observations.iter().any(|observation| observation.loss_of_lock);
        for observation in &epoch.observations {
            let carrier = (observation.satellite, observation.code);
            let returns = !*reports && !tracked.contains(&carrier);
            if observation.loss_of_lock || (returns && observation.carrier_phase.is_some()) {
                lost.push(carrier);
            }
        }
        tracked.clear();
        if !*reports {
            let with_phase = epoch.observations.iter().filter(|o| o.carrier_phase.is_some());
            tracked.extend(with_phase.map(|o| (o.satellite, o.code)));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gnss::{Constellation, Cycles, GpsTime, Observation};

    /// A satellite with a phase, with its flag.
    fn observed(number: u8, loss_of_lock: bool) -> Observation {
        let satellite = SatelliteId::new(Constellation::Gps, number).unwrap();
        let code = ObservationCode::parse("1C").unwrap();
        let carrier_phase = Some(Cycles(1e8));
        Observation { carrier_phase, loss_of_lock, ..Observation::empty(satellite, code) }
    }

    /// The numbers of the satellites that may have slipped at each epoch.
    fn lost(epochs: &[&[Observation]]) -> Vec<Vec<u8>> {
        let mut watch = LockWatch::default();
        let slipped = |observations: &&[Observation]| {
            let mut epoch = Epoch::new(GpsTime::EPOCH);
            epoch.observations = observations.to_vec();
            let mut lost = Vec::new();
            watch.take(&epoch, &mut lost);
            lost.iter().map(|(satellite, _)| satellite.number).collect()
        };
        epochs.iter().map(slipped).collect()
    }

    #[test]
    fn without_any_flag_a_carrier_that_was_missing_may_have_slipped() {
        let [one, two] = [1, 2].map(|number| observed(number, false));
        let no_phase = Observation { carrier_phase: None, ..two };
        let epochs: [&[_]; 6] =
            [&[one, two], &[one], &[one, two], &[one, no_phase], &[one, two], &[one, two]];
        assert_eq!(lost(&epochs), [vec![1, 2], vec![], vec![2], vec![], vec![2], vec![]]);
    }

    #[test]
    fn a_receiver_that_has_flagged_a_loss_is_believed() {
        let [one, two, flagged] = [observed(1, false), observed(2, false), observed(2, true)];
        let epochs: [&[_]; 4] = [&[one, flagged], &[one], &[one, two], &[one, flagged]];
        assert_eq!(lost(&epochs), [vec![2], vec![], vec![], vec![2]]);
    }
}
