//! Carrier arcs. Only this file changes them.
//!
//! An arc is one carrier of one satellite, tracked by rover and base without a slip. It has one
//! border variable of the graph for all its epochs. The variable is free again once no arc and no
//! epoch refers to it.

use crate::gnss::{Band, GpsTime, ObservationCode, SatelliteId};
use crate::graph::median;
use crate::positioning::clock_jump::whole_milliseconds_m;
use crate::positioning::differencing::{DifferenceGroup, SingleDifference};
use crate::positioning::pseudorange_error::WILD_M;
use crate::snapshot::{snapshot_fields, state_fields};

use super::losses::Losses;

/// An arc that has not ended.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct CarrierArc {
    pub(crate) satellite: SatelliteId,
    pub(crate) band: Band,
    /// Codes at rover and base.
    pub(crate) codes: [ObservationCode; 2],
    /// Border variable of its ambiguity.
    pub(crate) variable: usize,
    /// Number of arcs that began before it. Unlike the variable, it is never used again.
    pub(crate) serial: u64,
    pub(crate) frequency_hz: f64,
    /// Time of its newest phase.
    pub(crate) last: GpsTime,
    /// Time since then in which epochs of the rover are missing (s).
    pub(crate) unobserved_s: f64,
    /// Number of its phases so far.
    pub(crate) epochs: u32,
    /// Whether the newest phase may be off by half a cycle.
    pub(crate) half_cycle: bool,
    /// Elevation at the newest phase (rad).
    pub(crate) elevation_rad: f64,
    /// Pseudorange minus phase, when both were last measured (m).
    pub(crate) code_minus_phase_m: Option<f64>,
    /// Its integer, once found.
    pub(crate) held: Option<HeldInteger>,
    /// Epochs in a row whose searches have found this integer.
    pub(crate) found: u32,
    /// Whether these epochs are enough: the integer is then not searched again.
    pub(crate) is_proven: bool,
}

/// The ambiguity of an arc relative to a datum (cycles). Only differences between arcs of one datum
/// have a meaning.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct HeldInteger {
    /// Number of the datum: one arc of the group, with the integer zero when the datum began.
    pub(crate) datum: u32,
    pub(crate) cycles: i64,
}

impl HeldInteger {
    /// The integer between two arcs; `None` where they refer to different datums.
    pub(crate) fn minus(self, other: Self) -> Option<i64> {
        (self.datum == other.datum).then(|| self.cycles - other.cycles)
    }
}

/// What an epoch keeps of an arc that it used.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ArcReference {
    pub(crate) serial: u64,
    /// Border variable the arc had at that epoch.
    pub(crate) variable: usize,
    pub(crate) group: DifferenceGroup,
}

impl CarrierArc {
    fn forget_integer(&mut self) {
        (self.held, self.found, self.is_proven) = (None, 0, false);
    }

    /// The group of this arc: the ambiguities of a group differ by integers.
    pub(crate) fn group(&self) -> DifferenceGroup {
        DifferenceGroup::of(self.satellite, self.band, self.codes)
    }

    /// Reference to this arc, as epochs keep it.
    pub(crate) fn reference(&self) -> ArcReference {
        ArcReference { serial: self.serial, variable: self.variable, group: self.group() }
    }

    fn is_of(&self, difference: &SingleDifference) -> bool {
        self.satellite == difference.satellite && self.codes == difference.codes
    }
}

/// All arcs that have not ended, and which border variables are free.
#[derive(Debug, Default)]
pub(crate) struct Arcs {
    /// In the order they began.
    list: Vec<CarrierArc>,
    /// Border variables in use, by arcs or by epochs still in the window.
    in_use: Vec<bool>,
    /// Number of arcs that have begun.
    begun: u64,
    /// The arcs that ended at the newest epoch because their half cycle was resolved.
    flipped: Vec<Flipped>,
    /// Sum of the clock steps that the pseudoranges have made and the phases have not (m).
    code_steps_m: f64,
}

/// An arc that ended because its half cycle was resolved.
#[derive(Clone, Copy, Debug)]
struct Flipped {
    satellite: SatelliteId,
    codes: [ObservationCode; 2],
    variable: usize,
    /// Time of its newest phase.
    last: GpsTime,
}

/// An arc that continues another one of the same carrier, whose half cycle was unresolved.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Flip {
    /// Border variables, the earlier arc first.
    pub(crate) variables: [usize; 2],
    /// From the last phase of the earlier arc to the first one of the later (s).
    pub(crate) interval_s: f64,
}

snapshot_fields!(HeldInteger { datum, cycles });
snapshot_fields!(ArcReference { serial, variable, group });
snapshot_fields!(CarrierArc {
    satellite,
    band,
    codes,
    variable,
    serial,
    frequency_hz,
    last,
    unobserved_s,
    epochs,
    half_cycle,
    elevation_rad,
    code_minus_phase_m,
    held,
    found,
    is_proven,
});
snapshot_fields!(Flipped { satellite, codes, variable, last });
state_fields!(Arcs { list, in_use, begun, flipped, code_steps_m });

impl Arcs {
    /// Arcs as given, for tests.
    #[cfg(test)]
    pub(crate) fn of(list: Vec<CarrierArc>) -> Self {
        let (in_use, begun) = (vec![true; list.len()], list.len() as u64);
        Self { in_use, begun, list, flipped: Vec::new(), code_steps_m: 0.0 }
    }

    /// The arcs in the order they began.
    pub(crate) fn list(&self) -> &[CarrierArc] {
        &self.list
    }

    /// The arcs with a phase at `time`.
    pub(crate) fn present(&self, time: GpsTime) -> impl Iterator<Item = &CarrierArc> {
        self.list.iter().filter(move |arc| arc.last == time)
    }

    /// Whether every arc has one of the first `border` variables.
    pub(crate) fn is_within(&self, border: usize) -> bool {
        let present = self.list.iter().map(|arc| arc.variable);
        let mut all = present.chain(self.flipped.iter().map(|flipped| flipped.variable));
        all.all(|variable| variable < border.min(self.in_use.len()))
    }

    /// Whether an arc has the variable.
    pub(crate) fn has(&self, variable: usize) -> bool {
        self.list.iter().any(|arc| arc.variable == variable)
    }

    /// Ends all arcs.
    pub(crate) fn clear(&mut self) {
        self.list.clear();
        self.in_use.clear();
        self.flipped.clear();
    }

    /// Ends the arcs with a loss of lock, reported or likely, and those without a phase for `gap_s`
    /// of observed time before `time`; appends their satellites to `ended`.
    pub(crate) fn end_lost(
        &mut self,
        losses: &Losses,
        time: GpsTime,
        gap_s: f64,
        ended: &mut Vec<SatelliteId>,
    ) {
        self.list.iter_mut().for_each(|arc| arc.unobserved_s += losses.unobserved_s);
        let is_over = |arc: &CarrierArc| {
            gap_s < time - arc.last - arc.unobserved_s || losses.has(arc.satellite, arc.codes)
        };
        self.end(is_over, ended);
    }

    /// Ends the arcs whose half-cycle indicator changed: the phase may have moved by half a cycle.
    /// [`Self::flips`] returns the arcs that begin in their place.
    pub(crate) fn end_flipped(
        &mut self,
        differences: &[SingleDifference],
        ended: &mut Vec<SatelliteId>,
    ) {
        let is_over = |arc: &CarrierArc| {
            let flips =
                |d: &SingleDifference| d.carrier.is_some() && d.half_cycle != arc.half_cycle;
            differences.iter().any(|d| arc.is_of(d) && flips(d))
        };
        self.flipped.clear();
        for arc in self.list.iter().filter(|arc| arc.half_cycle && is_over(arc)) {
            let CarrierArc { satellite, codes, variable, last, .. } = *arc;
            self.flipped.push(Flipped { satellite, codes, variable, last });
        }
        self.end(is_over, ended);
    }

    /// The arcs that began at `time` in place of an arc of the same carrier that had ended because
    /// its half cycle was resolved.
    pub(crate) fn flips(&self, time: GpsTime) -> impl Iterator<Item = Flip> + '_ {
        self.flipped.iter().filter_map(move |flipped| {
            let follows = |arc: &&CarrierArc| {
                let began = arc.epochs == 1 && arc.last == time;
                began && (arc.satellite, arc.codes) == (flipped.satellite, flipped.codes)
            };
            let variables = [flipped.variable, self.list.iter().find(follows)?.variable];
            Some(Flip { variables, interval_s: time - flipped.last })
        })
    }

    /// Moves the phases of an epoch by the clock steps that the pseudoranges have made and the
    /// phases have not. A new step is found from the arcs that continue.
    ///
    /// Receivers keep their clocks within a millisecond by steps of one millisecond. If the phases
    /// make no step, a new arc would refer to another clock than the earlier ones. For GPS the step
    /// is a common offset. For GLONASS a millisecond is 562.5 cycles more for each channel number,
    /// so the differences would not be integers.
    pub(crate) fn follow_code_clock(&mut self, differences: &mut [SingleDifference]) {
        lengthen_phases(differences, self.code_steps_m);
        let change_m = |difference: &SingleDifference| {
            let arc = self.list.iter().find(|arc| arc.is_of(difference))?;
            Some(code_minus_phase_m(difference)? - arc.code_minus_phase_m?)
        };
        let mut changes_m: Vec<f64> = differences.iter().filter_map(change_m).collect();
        let Some(middle_m) = median(&mut changes_m) else { return };
        let step_m = whole_milliseconds_m(middle_m);
        let agree = changes_m.iter().filter(|m| (**m - step_m).abs() <= WILD_M).count();
        if step_m != 0.0 && changes_m.len() < 2 * agree {
            self.code_steps_m += step_m;
            lengthen_phases(differences, step_m);
        }
    }

    fn end(&mut self, is_over: impl Fn(&CarrierArc) -> bool, ended: &mut Vec<SatelliteId>) {
        self.list.retain(|arc| {
            let over = is_over(arc);
            if over {
                ended.push(arc.satellite);
            }
            !over
        });
    }

    /// Whether the arc of a difference has a phase at `time` already.
    pub(crate) fn has_phase(&self, difference: &SingleDifference, time: GpsTime) -> bool {
        let arc = self.list.iter().find(|arc| arc.is_of(difference));
        arc.is_some_and(|arc| arc.last == time)
    }

    /// Adds the phase of a difference at `time` to its arc. Returns the arc's variable and the time
    /// since its last phase (s). `None` if there is no arc to continue.
    pub(crate) fn go_on(
        &mut self,
        difference: &SingleDifference,
        time: GpsTime,
        elevation_rad: f64,
    ) -> Option<(usize, f64)> {
        let arc = self.list.iter_mut().find(|arc| arc.is_of(difference))?;
        let since_s = time - arc.last;
        (arc.last, arc.unobserved_s, arc.elevation_rad) = (time, 0.0, elevation_rad);
        arc.code_minus_phase_m = code_minus_phase_m(difference).or(arc.code_minus_phase_m);
        arc.epochs += 1;
        Some((arc.variable, since_s))
    }

    /// Begins an arc; returns its variable, which nothing else refers to.
    pub(crate) fn begin(
        &mut self,
        difference: &SingleDifference,
        time: GpsTime,
        elevation_rad: f64,
    ) -> usize {
        let variable = self.take_variable();
        let serial = self.take_serial();
        self.list.push(CarrierArc {
            satellite: difference.satellite,
            band: difference.band,
            codes: difference.codes,
            variable,
            serial,
            frequency_hz: difference.frequency_hz,
            last: time,
            unobserved_s: 0.0,
            epochs: 1,
            half_cycle: difference.half_cycle,
            elevation_rad,
            code_minus_phase_m: code_minus_phase_m(difference),
            held: None,
            found: 0,
            is_proven: false,
        });
        variable
    }

    /// Replaces the arc that has this variable by a new arc of the same carrier, after a slip.
    /// Returns its satellite and its new variable; `None` if no arc has the variable or the arc
    /// began at this epoch.
    pub(crate) fn restart(&mut self, variable: usize) -> Option<(SatelliteId, usize)> {
        let index = self.list.iter().position(|arc| arc.variable == variable)?;
        if self.list[index].epochs == 1 {
            return None;
        }
        let (variable, serial) = (self.take_variable(), self.take_serial());
        let arc = &mut self.list[index];
        (arc.variable, arc.serial, arc.epochs) = (variable, serial, 1);
        arc.forget_integer();
        Some((arc.satellite, variable))
    }

    /// Records that the search of this epoch has found the integer of one arc, which is proven
    /// after `proven_after` such epochs in a row.
    pub(crate) fn record_integer(&mut self, index: usize, integer: HeldInteger, proven_after: u32) {
        let arc = &mut self.list[index];
        if arc.held != Some(integer) {
            arc.forget_integer();
        }
        arc.held = Some(integer);
        arc.found += 1;
        arc.is_proven |= proven_after <= arc.found;
    }

    /// Forgets the integer of one arc.
    pub(crate) fn forget(&mut self, index: usize) {
        self.list[index].forget_integer();
    }

    /// Forgets the integers of all arcs.
    pub(crate) fn forget_integers(&mut self) {
        self.list.iter_mut().for_each(CarrierArc::forget_integer);
    }

    fn take_serial(&mut self) -> u64 {
        self.begun += 1;
        self.begun - 1
    }

    /// A border variable that nothing refers to.
    fn take_variable(&mut self) -> usize {
        let free = self.in_use.iter().position(|used| !used);
        let variable = free.unwrap_or(self.in_use.len());
        if variable == self.in_use.len() {
            self.in_use.push(true);
        }
        self.in_use[variable] = true;
        variable
    }

    /// Frees the variables that no arc has and for which `is_named` is false.
    pub(crate) fn release(&mut self, is_named: impl Fn(usize) -> bool) {
        for variable in 0..self.in_use.len() {
            if self.in_use[variable] && !self.has(variable) && !is_named(variable) {
                self.in_use[variable] = false;
            }
        }
    }
}

fn code_minus_phase_m(difference: &SingleDifference) -> Option<f64> {
    Some(difference.pseudorange?.range_m - difference.carrier?.range_m)
}

fn lengthen_phases(differences: &mut [SingleDifference], by_m: f64) {
    let carriers = differences.iter_mut().filter_map(|difference| difference.carrier.as_mut());
    carriers.for_each(|carrier| carrier.range_m += by_m);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gnss::Constellation;
    use crate::gnss::constants::LIGHT_MILLISECOND_M;
    use crate::positioning::differencing::Differenced;

    fn difference(number: u8, half_cycle: bool) -> SingleDifference {
        let code = ObservationCode::parse("1C").unwrap();
        let differenced = Differenced { range_m: 2e7, variance_m2: 1e-5 };
        SingleDifference {
            common: 0,
            satellite: SatelliteId::new(Constellation::Gps, number).unwrap(),
            band: Band::L1,
            codes: [code; 2],
            shares_code: true,
            frequency_hz: 1_575.42e6,
            pseudorange: None,
            carrier: Some(differenced),
            half_cycle,
        }
    }

    fn at(seconds: f64) -> GpsTime {
        GpsTime::EPOCH + seconds
    }

    /// One epoch: arcs end, go on or begin.
    fn track(arcs: &mut Arcs, seconds: f64, losses: &Losses, differences: &[SingleDifference]) {
        let ended = &mut Vec::new();
        arcs.end_lost(losses, at(seconds), 35.0, ended);
        arcs.end_flipped(differences, ended);
        for difference in differences {
            if arcs.go_on(difference, at(seconds), 1.0).is_none() {
                arcs.begin(difference, at(seconds), 1.0);
            }
        }
    }

    /// Of two carriers whose half cycle is resolved, the one that also lost lock does not continue
    /// its arc.
    #[test]
    fn a_resolved_half_cycle_continues_its_arc_unless_lock_was_lost() {
        let mut arcs = Arcs::default();
        track(&mut arcs, 0.0, &Losses::default(), &[difference(1, true), difference(2, true)]);
        assert_eq!(arcs.flips(at(0.0)).count(), 0);
        let lost = difference(2, false);
        let losses = Losses { rover: vec![(lost.satellite, lost.codes[0])], ..Losses::default() };
        track(&mut arcs, 1.0, &losses, &[difference(1, false), lost]);
        let flip = Flip { variables: [0, 2], interval_s: 1.0 };
        assert_eq!(arcs.flips(at(1.0)).collect::<Vec<_>>(), [flip]);
        assert!(arcs.is_within(4) && !arcs.is_within(3));
        track(&mut arcs, 2.0, &Losses::default(), &[difference(1, false), lost]);
        assert_eq!(arcs.flips(at(2.0)).count(), 0);
    }

    /// The clock of the pseudoranges steps forward by 1 ms and back by 2 ms; the phases continue. A
    /// wild pseudorange of one of three arcs is not taken for a step. At the end the phases refer
    /// to the clock of the pseudoranges.
    #[test]
    fn phases_follow_the_steps_of_the_codes_clock() {
        let mut arcs = Arcs::default();
        let epoch = |late_m: [f64; 3]| {
            let of = |number: u8, late_m: f64| {
                let range_m = 2e7 + 5.0 * f64::from(number) + late_m;
                let pseudorange = Some(Differenced { range_m, variance_m2: 1.0 });
                SingleDifference { pseudorange, ..difference(number, false) }
            };
            [of(1, late_m[0]), of(2, late_m[1]), of(3, late_m[2])]
        };
        let mut moved_ms = |seconds: f64, late_m: [f64; 3]| {
            let mut differences = epoch(late_m);
            arcs.follow_code_clock(&mut differences);
            track(&mut arcs, seconds, &Losses::default(), &differences);
            let moved_ms = (differences[0].carrier.unwrap().range_m - 2e7) / LIGHT_MILLISECOND_M;
            assert!((moved_ms - moved_ms.round()).abs() < 1e-9, "{moved_ms}");
            moved_ms.round()
        };
        assert_eq!(moved_ms(0.0, [0.0; 3]), 0.0);
        assert_eq!(moved_ms(1.0, [1e6, 3.0, -2.0]), 0.0);
        assert_eq!(moved_ms(2.0, [LIGHT_MILLISECOND_M; 3]), 1.0);
        assert_eq!(moved_ms(3.0, [LIGHT_MILLISECOND_M + 20.0; 3]), 1.0);
        assert_eq!(moved_ms(4.0, [-LIGHT_MILLISECOND_M; 3]), -1.0);
    }

    /// Pauses of 30 and 20 s with an epoch without its phase between them are no observed time.
    #[test]
    fn an_arc_goes_on_over_two_pauses_without_a_phase_between() {
        let mut arcs = Arcs::default();
        let paused = |unobserved_s: f64| Losses { unobserved_s, ..Losses::default() };
        track(&mut arcs, 0.0, &paused(0.0), &[difference(1, false)]);
        track(&mut arcs, 31.0, &paused(30.0), &[]);
        track(&mut arcs, 52.0, &paused(20.0), &[difference(1, false)]);
        assert_eq!((arcs.list()[0].epochs, arcs.list()[0].unobserved_s), (2, 0.0));
        track(&mut arcs, 88.0, &paused(0.0), &[]);
        assert!(arcs.list().is_empty());
    }

    /// A phase that lost lock while its half cycle is unknown is not used, so its carrier has no
    /// difference. The loss still ends its arc.
    #[test]
    fn a_loss_without_a_phase_ends_the_arc() {
        let mut arcs = Arcs::default();
        track(&mut arcs, 0.0, &Losses::default(), &[difference(1, false)]);
        let silent = SingleDifference { carrier: None, ..difference(1, true) };
        let losses =
            Losses { rover: vec![(silent.satellite, silent.codes[0])], ..Losses::default() };
        let ended = &mut Vec::new();
        arcs.end_lost(&losses, at(1.0), 35.0, ended);
        arcs.end_flipped(&[silent], ended);
        assert!(arcs.list().is_empty() && ended.len() == 1);
        assert_eq!(arcs.flips(at(1.0)).count(), 0);
    }
}
