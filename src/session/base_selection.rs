//! Which base an estimator has used, and which base it uses next.

use crate::aiding::bases::{BaseBroker, BaseChoice, BaseInput, BaseView, Candidates};
use crate::config::{Mode, PositioningOptions};
use crate::gnss::{Ecef, Epoch, GpsTime, Navigation, Solution};
use crate::positioning::{Aiding, Estimator};
use crate::snapshot::snapshot_fields;
use crate::snapshot::{Snapshot, SnapshotError, SnapshotReader, SnapshotWriter};
use crate::store::BaseKey;
use crate::tenant::Tenant;

/// Age from which the rover's last position is not used to select a base (s).
const POSITION_LIFETIME_S: f64 = 60.0;

/// The bases that provide base epochs for the next rover epochs.
pub(super) enum BaseSource {
    /// None: the mode is not relative to a base.
    None,
    /// One base, and its epochs for the times of the rover epochs.
    One(BaseView),
    /// The nearest of several bases.
    Nearest(Candidates),
}

impl BaseSource {
    /// The bases of `choice` for rover epochs of a tenant. `span` is their first and last time.
    pub(super) fn new(
        bases: &BaseBroker,
        tenant: &Tenant,
        choice: &BaseChoice,
        span: Option<(GpsTime, GpsTime)>,
        options: &PositioningOptions,
    ) -> Self {
        match (choice, span) {
            (BaseChoice::None, _) | (_, None) => Self::None,
            (BaseChoice::One(name), Some((from, until))) => {
                Self::One(bases.view(name, from, until, options.rtk.base_span_s()))
            }
            (BaseChoice::NearestOf(names), _) => Self::Nearest(bases.candidates(names)),
            (BaseChoice::Nearest, _) => Self::Nearest(bases.of(tenant).candidates()),
        }
    }
}

/// The base that an estimator has used so far, and the rover's last position.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct BaseSelection {
    /// The base of the last epoch that had one.
    pub(super) base: Option<BaseKey>,
    /// Number of the newest base epoch that the estimator has received.
    received_through: u64,
    /// The last position of the rover, and its time.
    position: Option<(GpsTime, Ecef)>,
}

snapshot_fields!(BaseSelection { base, received_through, position });

impl Snapshot for BaseKey {
    fn save(&self, writer: &mut SnapshotWriter) {
        self.number().save(writer);
    }

    fn load(reader: &mut SnapshotReader<'_>) -> Result<Self, SnapshotError> {
        i64::load(reader).map(Self::of_number)
    }
}

impl BaseSelection {
    /// Prepares for a new estimator, which has received no base epochs.
    pub(super) const fn restart(&mut self) {
        self.received_through = 0;
    }

    /// The base epochs that the estimator receives with the next rover epoch.
    pub(super) fn next(
        &self,
        source: &BaseSource,
        epoch: &Epoch,
        navigation: &Navigation,
        options: &PositioningOptions,
    ) -> Option<BaseInput> {
        match source {
            BaseSource::None => None,
            BaseSource::One(view) => Some(self.input_of(view, epoch.time, options)),
            BaseSource::Nearest(candidates) => {
                let position = self.position_at(epoch, navigation, options);
                let view = candidates.choose(self.base, position, epoch.time, &options.rtk)?;
                Some(self.input_of(&view, epoch.time, options))
            }
        }
    }

    fn input_of(&self, view: &BaseView, time: GpsTime, options: &PositioningOptions) -> BaseInput {
        let after = if self.base == Some(view.name().key) { self.received_through } else { 0 };
        view.input_at(time, after, options.rtk.base_span_s())
    }

    /// The rover's approximate position: its last position if that is recent, otherwise the
    /// single-point position of this epoch, otherwise the last position, however old.
    fn position_at(
        &self,
        epoch: &Epoch,
        navigation: &Navigation,
        options: &PositioningOptions,
    ) -> Option<Ecef> {
        let last = self.position.map(|(_, position)| position);
        let is_recent = |(time, _): (GpsTime, Ecef)| epoch.time - time <= POSITION_LIFETIME_S;
        if self.position.is_some_and(is_recent) {
            return last;
        }
        let options = PositioningOptions { mode: Mode::Spp, ..options.clone() };
        let alone = Estimator::new(options).advance(epoch, &Aiding::alone(navigation));
        alone.estimate.map(|estimate| estimate.position).or(last)
    }

    /// Updates the selection with an epoch's base epochs.
    pub(super) fn received(&mut self, input: Option<&BaseInput>) {
        if let Some(BaseInput { used, .. }) = input {
            (self.base, self.received_through) = (Some(used.base), used.through);
        }
    }

    /// Updates the selection with an epoch's base epochs and solution.
    pub(super) fn update(&mut self, input: Option<&BaseInput>, solution: &Solution) {
        self.received(input);
        if let Some(estimate) = &solution.estimate {
            self.position = Some((solution.time, estimate.position));
        }
    }
}
