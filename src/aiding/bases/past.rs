//! Bases for a recording: the suitable ones, and their epochs of its time.

use std::sync::Arc;

use crate::aiding::AidingError;
use crate::gnss::{BaseSite, CoordinateFrame, Ecef, Epoch, GpsTime};
use crate::positioning::{BASE_LATER_S, BasePositionVerdict};
use crate::store::{BaseChoice, StoredBaseEpoch};
use crate::tenant::Tenant;

use super::base::Base;
use super::tenant_bases::TenantBases;
use super::{BaseId, BaseView};

/// A base that may be used for a recording.
pub(crate) struct PastBase {
    base: Arc<Base>,
    /// Its distance from the rover (m); `None` while its position or the rover's is unknown.
    pub(crate) distance_m: Option<f64>,
}

impl TenantBases<'_> {
    /// The bases of a choice that may be used for a rover at `position`. The nearest comes first;
    /// bases with an unknown distance come last. Without named bases they are all that the tenant's
    /// sessions may use. Unless only one base is named, a base must not be farther than
    /// `longest_m`, and its position must not be refused.
    ///
    /// # Errors
    /// The tenant sees no base with an id of the choice.
    pub(crate) fn for_recording(
        &self,
        choice: &BaseChoice<BaseId>,
        position: Option<Ecef>,
        longest_m: f64,
    ) -> Result<Vec<PastBase>, AidingError> {
        let bases: Vec<Arc<Base>> = match choice {
            BaseChoice::One(id) => vec![self.visible(id)?],
            BaseChoice::NearestOf(ids) => {
                ids.iter().map(|id| self.visible(id)).collect::<Result<_, _>>()?
            }
            BaseChoice::Nearest | BaseChoice::None => self.usable(),
        };
        let is_named = matches!(choice, BaseChoice::One(_));
        let mut past = Vec::new();
        for base in bases {
            let (site, is_refused) = {
                let stored = base.stored();
                let verdict = stored.checks.present.verdict();
                (stored.site().cloned(), verdict == BasePositionVerdict::Refused)
            };
            let point = site.map(|site| site.antenna_reference_point());
            let distance_m = position.zip(point).map(|(rover, base)| rover.distance_m(base));
            let is_near = distance_m.is_none_or(|distance_m| distance_m <= longest_m);
            if is_named || is_near && !is_refused {
                past.push(PastBase { base, distance_m });
            }
        }
        let rank = |past: &PastBase| past.distance_m.unwrap_or(f64::INFINITY);
        past.sort_by(|a, b| rank(a).total_cmp(&rank(b)));
        Ok(past)
    }
}

impl PastBase {
    /// Its id.
    pub(crate) fn id(&self) -> &str {
        &self.base.name().id
    }

    /// The frame of its coordinates, if it is known.
    pub(crate) fn frame(&self) -> Option<CoordinateFrame> {
        self.base.description.frame
    }

    /// Tenant that owns it.
    pub(crate) fn tenant(&self) -> &Tenant {
        &self.base.description.tenant
    }

    /// The template of the addresses of its archive's files, if one fills it.
    pub(crate) fn archive(&self) -> Option<&str> {
        self.base.description.archive.as_deref()
    }

    /// Span of the base epochs that rover epochs of a span may need, none older than `age_s`.
    pub(crate) fn needed((from, until): (GpsTime, GpsTime), age_s: f64) -> (GpsTime, GpsTime) {
        (from - age_s, until + BASE_LATER_S)
    }

    /// Its stored epochs for rover epochs of a span, none older than `age_s`. Position and antenna
    /// are those at the last of these epochs; without epochs, those at its newest stored epoch.
    pub(crate) fn stored(
        &self,
        span: (GpsTime, GpsTime),
        age_s: f64,
    ) -> (Option<BaseSite>, Vec<StoredBaseEpoch>) {
        let stored = self.base.stored();
        let (from, until) = Self::needed(span, age_s);
        let epochs = stored.between_times(from, until);
        let view = BaseView { name: self.base.name().clone(), sites: stored.sites.clone(), epochs };
        let site = match view.epochs.last() {
            Some(last) => view.site_at(last.number).cloned(),
            None => stored.site().cloned(),
        };
        (site, view.epochs)
    }

    /// An epoch as it was received.
    pub(crate) fn decoded(stored: &StoredBaseEpoch) -> Epoch {
        stored.epoch().expect("it was encoded here, or read when the desk was opened")
    }
}
