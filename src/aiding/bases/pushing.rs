//! Pushes to a base: epochs in order of time, and positions.

use std::sync::Arc;

use crate::aiding::AidingError;
use crate::clock::unix_ms;
use crate::gnss::{BaseSite, Epoch, Navigation};
use crate::positioning::BasePositionVerdict;
use crate::store::{BaseChange, StoredBaseEpoch};

use super::base::Base;
use super::base_epochs::BaseEpochs;
use super::broker::BaseBroker;
use super::check::PositionChecks;
use super::{BaseEpochRefusal, BaseId, BasePush};

/// New epochs that are committed in one transaction, so that commits of sessions wait for few
/// milliseconds.
const EPOCHS_PER_STEP: usize = 500;

/// An epoch of a push, without its number, or why it is refused.
type PushedEpoch = Result<StoredBaseEpoch, BaseEpochRefusal>;

/// The site of a push.
enum PushedSite<'a> {
    /// Replaces the present site.
    Stated(&'a BaseSite),
    /// Is used only if the base has no site.
    IfUnknown(&'a BaseSite),
}

impl<'a> PushedSite<'a> {
    /// The site, if it applies to a base whose site is `present`.
    fn over(self, present: Option<&BaseSite>) -> Option<&'a BaseSite> {
        match self {
            Self::Stated(site) => Some(site),
            Self::IfUnknown(site) => present.is_none().then_some(site),
        }
    }
}

impl BaseBroker {
    /// Sets the position and antenna of a base, valid from its next epoch on. The same site again
    /// changes nothing.
    ///
    /// # Errors
    /// No base has this id, or the store fails.
    pub async fn set_site(&self, id: &BaseId, site: &BaseSite) -> Result<(), AidingError> {
        let site = Some(PushedSite::Stated(site));
        self.push_with_site(id, Vec::new(), site).await.map(drop)
    }

    /// Stores epochs of a base, in order of time. When it returns, the accepted epochs are durable,
    /// and later views contain them. Odometry is dropped, because a base does not move.
    ///
    /// # Errors
    /// No base has this id, its position is unknown or contradicts its observations, the epochs
    /// exceed what a base may have, or the store fails. Nothing of the push is then kept; if the
    /// store fails, the first of its epochs may be, and the same push adds the others.
    pub async fn push(&self, id: &BaseId, epochs: Vec<Epoch>) -> Result<BasePush, AidingError> {
        let limit = self.limits.observations_per_epoch;
        let encoded = |mut epoch: Epoch| {
            let (time, observations) = (epoch.time, epoch.observations.len());
            if limit < observations {
                return Err(BaseEpochRefusal::TooManyObservations { time, observations, limit });
            }
            epoch.odometry = None;
            Ok(StoredBaseEpoch::new(0, &epoch))
        };
        self.push_with_site(id, epochs.into_iter().map(encoded).collect(), None).await
    }

    /// As [`Self::push`], for the epochs of a [`BaseFile`](super::BaseFile). If the base has no
    /// position yet, it takes the one of the file's header.
    ///
    /// # Errors
    /// As [`Self::push`].
    pub async fn upload(
        &self,
        id: &BaseId,
        epochs: Vec<StoredBaseEpoch>,
        header_site: Option<&BaseSite>,
    ) -> Result<BasePush, AidingError> {
        let epochs = epochs.into_iter().map(Ok).collect();
        self.push_with_site(id, epochs, header_site.map(PushedSite::IfUnknown)).await
    }

    async fn push_with_site(
        &self,
        id: &BaseId,
        epochs: Vec<PushedEpoch>,
        site: Option<PushedSite<'_>>,
    ) -> Result<BasePush, AidingError> {
        let base = self.base(id)?;
        let _turn = base.pushing.lock().await;
        self.base(id)?; // Not deleted meanwhile.
        self.refresh(id, &base).await?;
        // Decided here, because another push may have set the position meanwhile.
        let site = site.and_then(|site| site.over(base.stored().site()));
        let site = site.map(|site| self.antennas.calibrated(site, base.stored().site()));
        let (new_site, in_force, mut checks, mut new) = {
            let stored = base.stored();
            let new_site = stored.new_site(site.as_ref());
            let checks = if new_site.is_some() { PositionChecks::new() } else { stored.checks };
            let in_force = new_site.map(|(_, site)| site).or(stored.site()).cloned();
            (new_site, in_force, checks, Vec::new())
        };
        let outcomes = {
            let stored = base.stored();
            let accept = |epoch: &PushedEpoch| {
                stored.accept(&mut new, epoch.as_ref().map_err(Clone::clone)?)
            };
            epochs.iter().map(accept).collect()
        };
        if !epochs.is_empty() {
            let site =
                in_force.ok_or_else(|| AidingError::BasePositionMissing { id: id.to_string() })?;
            checks =
                self.checked(&base, checks, site, epochs.into_iter().flatten().collect()).await;
        }
        let check = checks.present;
        if let (BasePositionVerdict::Refused, Some(distance_m)) =
            (check.verdict(), check.distance_m())
        {
            return Err(AidingError::BasePositionRefused { distance_m, epochs: check.epochs });
        }
        let limits = (self.limits.epochs_per_base, self.limits.bytes_per_base);
        if base.stored().first_kept(&new, limits.0, limits.1).is_none() {
            return Err(AidingError::BaseTooLarge {
                epochs: new.len(),
                epochs_max: limits.0,
                bytes: new.iter().map(StoredBaseEpoch::size).sum(),
                bytes_max: limits.1,
            });
        }
        self.commit(&base, new_site, new).await?;
        base.stored().checks = checks;
        Ok(BasePush { outcomes, check })
    }

    /// Commits the changes of a push in steps. Each step is visible when it is committed. The
    /// epochs are in order of time, so after a failure the same push repeats those that are
    /// stored, and adds the others.
    async fn commit(
        &self,
        base: &Base,
        site: Option<(u64, &BaseSite)>,
        epochs: Vec<StoredBaseEpoch>,
    ) -> Result<(), AidingError> {
        let (mut site, mut rest) = (site, epochs);
        while site.is_some() || !rest.is_empty() {
            let later = rest.split_off(rest.len().min(EPOCHS_PER_STEP));
            self.commit_step(base, site.take(), rest).await?;
            rest = later;
        }
        Ok(())
    }

    async fn commit_step(
        &self,
        base: &Base,
        site: Option<(u64, &BaseSite)>,
        epochs: Vec<StoredBaseEpoch>,
    ) -> Result<(), AidingError> {
        let stored_unix_ms = unix_ms();
        let (epochs_max, bytes_max) = (self.limits.epochs_per_base, self.limits.bytes_per_base);
        let first_kept = base.stored().first_kept(&epochs, epochs_max, bytes_max);
        let first_kept = first_kept.expect("a part of a push is not larger than the push");
        let change = BaseChange { site, epochs: &epochs, first_kept, stored_unix_ms };
        // If the connection breaks or the caller leaves during the commit, its outcome is unknown.
        base.stored().outdated = true;
        self.store.push_base(base.name().key, &change).await?;
        let mut stored = base.stored();
        if let Some((since, site)) = site {
            stored.add_site(since, site.clone());
        }
        stored.add(epochs, first_kept, stored_unix_ms);
        stored.outdated = false;
        Ok(())
    }

    /// Loads a base again from the store, if a commit has left its stored state unknown.
    ///
    /// # Errors
    /// The commit has deleted it, or the store fails.
    async fn refresh(&self, id: &BaseId, base: &Base) -> Result<(), AidingError> {
        if !base.stored().outdated {
            return Ok(());
        }
        let rows = self.store.bases().await?;
        let Some(row) = rows.into_iter().find(|row| row.key == base.name().key) else {
            self.write().remove(id);
            return self.base(id).map(drop);
        };
        let (epochs, stored_unix_ms) = self.store.base_epochs(base.name().key).await?;
        *base.stored() = BaseEpochs::new(row.sites, epochs, stored_unix_ms);
        Ok(())
    }

    /// Continues the position checks with `epochs`. Single-point positioning runs on a blocking
    /// thread.
    pub(super) async fn checked(
        &self,
        base: &Base,
        checks: PositionChecks,
        site: BaseSite,
        epochs: Vec<StoredBaseEpoch>,
    ) -> PositionChecks {
        if !epochs.last().is_some_and(|epoch| checks.is_due(epoch.time)) {
            return checks;
        }
        let tenant = &base.description.tenant;
        let navigation: Arc<Navigation> = self.navigation.of(tenant).current().navigation;
        let work = move || {
            let epochs = epochs.iter().filter_map(|stored| stored.epoch().ok());
            checks.advance(&site, epochs, &navigation)
        };
        // Err: it panicked; the checks stay as they were.
        tokio::task::spawn_blocking(work).await.unwrap_or(checks)
    }
}
