//! Carrier phases of the last epoch, and their differences to the next.

use crate::gnss::{LocalFrame, ObservationCode, SatelliteId};
use crate::snapshot::snapshot_fields;

use super::Measurement;
use super::clock_jump::whole_milliseconds_m;
use super::factors::{PhaseDifferenceFactor, Sight, State};
use super::ranging::median;

/// C/N0 to which the deviations refer, and which is taken where none is reported (dB-Hz).
const REFERENCE_DB_HZ: f64 = 42.0;
/// What thermal noise adds to a phase difference at that C/N0 (m).
const THERMAL_M: f64 = 0.004;
/// Differences that miss whole milliseconds by more than this have another clock (m): 0.1 ms.
const CLOCK_DIFFERS_M: f64 = 3e4;

/// A carrier phase to be continued.
#[derive(Clone, Copy, Debug)]
struct Kept {
    satellite: SatelliteId,
    code: ObservationCode,
    sight: Sight,
    /// Free of satellite clock, troposphere and ionosphere (m).
    corrected_m: f64,
    half_cycle: bool,
}

/// The phases of the last epoch; the memory is used again.
#[derive(Debug, Default)]
pub(super) struct Phases {
    kept: Vec<Kept>,
    scratch: Vec<f64>,
}

snapshot_fields!(Kept { satellite, code, sight, corrected_m, half_cycle });
snapshot_fields!(Phases { kept } memory { scratch: Vec::new() });

impl Clone for Phases {
    fn clone(&self) -> Self {
        Self { kept: self.kept.clone(), scratch: Vec::new() }
    }

    fn clone_from(&mut self, source: &Self) {
        self.kept.clone_from(&source.kept);
    }
}

impl Phases {
    /// Forgets them: no difference spans what follows.
    pub(super) fn clear(&mut self) {
        self.kept.clear();
    }

    /// Keeps the phases of `list` for the next epoch.
    pub(super) fn keep(&mut self, frame: &LocalFrame, list: &[Measurement]) {
        self.kept.clear();
        self.kept.extend(list.iter().filter_map(|measurement| kept(frame, measurement)));
    }

    /// Differences from the phases kept to those of `list`.
    ///
    /// A satellite is left out after a loss of lock, and where only one end may be off by half a
    /// cycle; where both may, the half cycle is most likely the same and the kernel judges.
    pub(super) fn differences(
        &self,
        frame: &LocalFrame,
        list: &[Measurement],
        sigma_m: f64,
        factors: &mut Vec<PhaseDifferenceFactor>,
    ) {
        factors.clear();
        for measurement in list {
            let Some(after) = kept(frame, measurement) else { continue };
            let lost = measurement.phase.is_none_or(|phase| phase.loss_of_lock);
            let before = self.kept.iter().find(|before| {
                before.satellite == after.satellite
                    && before.code == after.code
                    && before.half_cycle == after.half_cycle
            });
            let (Some(before), false) = (before, lost) else { continue };
            let cn0_db_hz = measurement.cn0_db_hz.unwrap_or(REFERENCE_DB_HZ);
            let decades = (REFERENCE_DB_HZ - cn0_db_hz) / 20.0;
            let thermal_m = THERMAL_M * (std::f64::consts::LN_10 * decades).exp();
            factors.push(PhaseDifferenceFactor {
                before: before.sight,
                after: after.sight,
                change_m: after.corrected_m - before.corrected_m,
                inverse_sigma: sigma_m.hypot(thermal_m).recip(),
            });
        }
    }

    /// Some receivers step the clock in the pseudoranges alone: where the differences miss the
    /// prediction by whole milliseconds that all share, takes those off; where by anything else,
    /// leaves the differences out.
    pub(super) fn follow_clock(
        &mut self,
        factors: &mut Vec<PhaseDifferenceFactor>,
        state: &State,
        next: &State,
    ) {
        self.scratch.clear();
        let misses = factors.iter().map(|f| f.linearize(state, next).residual / f.inverse_sigma);
        self.scratch.extend(misses);
        let Some(miss_m) = median(&mut self.scratch) else { return };
        let whole_m = whole_milliseconds_m(miss_m);
        if CLOCK_DIFFERS_M < (miss_m - whole_m).abs() {
            factors.clear();
        }
        factors.iter_mut().for_each(|factor| factor.change_m += whole_m);
    }
}

fn kept(frame: &LocalFrame, measurement: &Measurement) -> Option<Kept> {
    let phase = measurement.phase.filter(|_| measurement.is_above_mask)?;
    Some(Kept {
        satellite: measurement.satellite,
        code: measurement.code,
        sight: Sight::new(frame, measurement.state.position),
        corrected_m: phase.range_m - measurement.troposphere_m + measurement.ionosphere_m,
        half_cycle: phase.half_cycle,
    })
}
