//! Ambiguities and the arcs they live on.
//!
//! An arc is one carrier of one satellite, tracked by rover and base without a slip. It has one
//! border variable of the graph for all its epochs, which is given away when nothing names it any
//! more.

use crate::gnss::{Band, GpsTime, ObservationCode, SatelliteId};
use crate::graph::SharingRow;
use crate::positioning::differencing::{DifferenceGroup, SingleDifference};
use crate::snapshot::{snapshot_fields, state_fields};

/// An arc that has not ended.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Arc {
    pub(super) satellite: SatelliteId,
    pub(super) band: Band,
    /// Codes at rover and base.
    pub(super) codes: [ObservationCode; 2],
    /// Border variable of its ambiguity.
    pub(super) variable: usize,
    /// How many began before it: variables are given again, this is not.
    pub(super) serial: u64,
    pub(super) frequency_hz: f64,
    /// Time of its newest phase.
    pub(super) last: GpsTime,
    /// Phases so far.
    pub(super) epochs: u32,
    /// Whether the newest phase may be off by half a cycle.
    pub(super) half_cycle: bool,
    /// Elevation at the newest phase (rad).
    pub(super) elevation_rad: f64,
    /// Its integer, once found.
    pub(super) label: Option<Label>,
}

/// An integer less one that all arcs share whose labels are of one origin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Label {
    /// Which arc of which group began the count, at which time.
    pub(super) origin: u32,
    pub(super) integer: i64,
}

impl Label {
    /// The integer between two arcs, where it is known.
    pub(super) fn less(self, other: Self) -> Option<i64> {
        (self.origin == other.origin).then(|| self.integer - other.integer)
    }
}

impl Arc {
    /// What the ambiguities share whose differences are integers.
    pub(super) fn group(&self) -> DifferenceGroup {
        DifferenceGroup::of(self.satellite, self.band, self.codes)
    }

    fn is_of(&self, difference: &SingleDifference) -> bool {
        self.satellite == difference.satellite && self.codes == difference.codes
    }
}

/// All arcs that have not ended, and which border variables are free.
#[derive(Debug, Default)]
pub(super) struct Arcs {
    /// In the order they began.
    pub(super) list: Vec<Arc>,
    /// Border variables in use, by arcs or by epochs still in the window.
    in_use: Vec<bool>,
    /// How many have begun.
    begun: u64,
}

snapshot_fields!(Label { origin, integer });
snapshot_fields!(Arc {
    satellite,
    band,
    codes,
    variable,
    serial,
    frequency_hz,
    last,
    epochs,
    half_cycle,
    elevation_rad,
    label,
});
state_fields!(Arcs { list, in_use, begun });

impl Arcs {
    /// Whether no arc has a variable that is not among the first `border`.
    pub(super) fn is_within(&self, border: usize) -> bool {
        self.list.iter().all(|arc| arc.variable < border && arc.variable < self.in_use.len())
    }

    /// Ends all.
    pub(super) fn clear(&mut self) {
        self.list.clear();
        self.in_use.clear();
    }

    /// Ends the arcs that `is_over` names; returns whose.
    pub(super) fn end(&mut self, is_over: impl Fn(&Arc) -> bool, ended: &mut Vec<SatelliteId>) {
        self.list.retain(|arc| {
            let over = is_over(arc);
            if over {
                ended.push(arc.satellite);
            }
            !over
        });
    }

    /// The arc that a difference goes on with.
    pub(super) fn find(&mut self, difference: &SingleDifference) -> Option<&mut Arc> {
        self.list.iter_mut().find(|arc| arc.is_of(difference))
    }

    /// Begins an arc; its variable is one that nothing else names.
    pub(super) fn begin(
        &mut self,
        difference: &SingleDifference,
        time: GpsTime,
        elevation_rad: f64,
    ) -> Arc {
        let variable = self.take_variable();
        let arc = Arc {
            satellite: difference.satellite,
            band: difference.band,
            codes: difference.codes,
            variable,
            serial: self.take_serial(),
            frequency_hz: difference.frequency_hz,
            last: time,
            epochs: 1,
            half_cycle: difference.half_cycle,
            elevation_rad,
            label: None,
        };
        self.list.push(arc);
        arc
    }

    /// Begins the arc at a place of the list anew; returns its variable.
    pub(super) fn renew(&mut self, place: usize) -> usize {
        let (variable, serial) = (self.take_variable(), self.take_serial());
        let arc = &mut self.list[place];
        (arc.variable, arc.serial, arc.epochs, arc.label) = (variable, serial, 1, None);
        variable
    }

    fn take_serial(&mut self) -> u64 {
        self.begun += 1;
        self.begun - 1
    }

    /// A border variable that nothing names.
    fn take_variable(&mut self) -> usize {
        let free = self.in_use.iter().position(|used| !used);
        let variable = free.unwrap_or(self.in_use.len());
        if variable == self.in_use.len() {
            self.in_use.push(true);
        }
        self.in_use[variable] = true;
        variable
    }

    /// Whether an arc has the variable.
    pub(super) fn has(&self, variable: usize) -> bool {
        self.list.iter().any(|arc| arc.variable == variable)
    }

    /// Puts the labels of the newest origin in the place of the ambiguities in rows of one group,
    /// and drops the other rows. The count all labels begin with is the ambiguities' own, in the
    /// mean: where wavelengths differ, what is common to all is no offset.
    pub(super) fn put_labels(&self, border: &[f64], rows: &mut Vec<SharingRow<3>>) {
        let label = |row: &SharingRow<3>| {
            let (variable, _) = row.border?;
            self.list.iter().find(|arc| arc.variable == variable)?.label
        };
        let newest = rows.iter().filter_map(label).map(|label| label.origin).max();
        let (mut common, mut count) = (0.0, 0.0);
        for row in rows.iter() {
            if let Some((own, (variable, _))) = label(row).zip(row.border)
                && Some(own.origin) == newest
            {
                common += border[variable] - own.integer as f64;
                count += 1.0;
            }
        }
        common /= f64::max(count, 1.0);
        rows.retain_mut(|row| {
            let own = label(row).filter(|label| Some(label.origin) == newest);
            let (Some(label), Some((variable, slope))) = (own, row.border) else { return false };
            row.row.residual += (label.integer as f64 + common - border[variable]) * slope;
            true
        });
    }

    /// Gives back the variables that no arc has and `is_named` does not name.
    pub(super) fn release(&mut self, is_named: impl Fn(usize) -> bool) {
        for variable in 0..self.in_use.len() {
            if self.in_use[variable] && !self.has(variable) && !is_named(variable) {
                self.in_use[variable] = false;
            }
        }
    }
}
