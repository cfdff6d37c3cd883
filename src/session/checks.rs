//! Checks of a request before anything changes.

use std::time::Duration;

use crate::aiding::bases::{BaseChoice, BaseId};
use crate::config::{PositioningOptions, RETENTION_MAX_DAYS};
use crate::quotas::QuotaError;
use crate::store::{AntennaName, BaseName};

use super::desk::Sessions;
use super::{RawChunk, SequencedEpoch, SessionError};

/// Raw bytes that count as one waiting epoch in a mailbox. No receiver uses fewer bytes per epoch.
const BYTES_PER_EPOCH: usize = 256;
/// Delay before a retry when the quota of sessions is used up: sessions may be deleted meanwhile.
const STORED_DELAY: Duration = Duration::from_secs(60);

impl Sessions {
    /// The chosen bases, as the store names them.
    pub(super) fn base_names(
        &self,
        choice: BaseChoice<BaseId>,
    ) -> Result<BaseChoice, SessionError> {
        if let BaseChoice::NearestOf(ids) = &choice {
            let (bases, limit) = (ids.len(), self.limits().candidate_bases);
            if limit < bases {
                return Err(SessionError::TooManyCandidates { bases, limit });
            }
            let is_again = |index: &usize| ids[..*index].contains(&ids[*index]);
            if let Some(index) = (0..ids.len()).find(is_again) {
                return Err(SessionError::BaseNamedTwice { index });
            }
            if ids.is_empty() {
                return Ok(BaseChoice::None);
            }
        }
        let bases = self.aiding().bases.of(self.tenant());
        Ok(choice.try_map(|id| bases.name(&id))?)
    }

    /// Checks that the service can provide the output that the options ask for: positions relative
    /// to each named base must be transformable to the frame. With the nearest of all bases, it is
    /// not known yet which base is used.
    pub(super) fn check_output(
        &self,
        options: &PositioningOptions,
        base: &BaseChoice,
    ) -> Result<(), SessionError> {
        if options.output.geoid && self.aiding().geoid.is_none() {
            return Err(SessionError::GeoidMissing);
        }
        let presentation = options.output.presentation(None);
        let check = |base: &BaseName| presentation.check(self.aiding().bases.frame(&base.id));
        base.named().iter().try_for_each(check).map_err(SessionError::Frame)
    }

    /// The calibrated antenna with this name; none for an empty name.
    pub(super) async fn antenna_name(
        &self,
        name: &str,
    ) -> Result<Option<AntennaName>, SessionError> {
        if name.trim().is_empty() {
            return Ok(None);
        }
        Ok(Some(self.aiding().antennas.keep(name).await?))
    }

    pub(super) fn check_push(&self, epochs: &[SequencedEpoch]) -> Result<(), SessionError> {
        let (epochs, limit) = (epochs.len(), self.limits().epochs_per_push);
        match epochs {
            0 => Err(SessionError::NoEpochs),
            _ if limit < epochs => Err(SessionError::TooManyEpochs { epochs, limit }),
            _ => Ok(()),
        }
    }

    /// Checks a push and the tenant's quotas. Its epochs are counted when a mailbox has taken it.
    pub(super) fn admit_push(&self, epochs: &[SequencedEpoch]) -> Result<(), SessionError> {
        self.check_push(epochs)?;
        Ok(self.meter().check_epochs()?)
    }

    /// Checks a chunk and the tenant's quotas. Its epochs are checked again and counted when it is
    /// decoded. Returns the number of epochs that it takes in the mailbox. This is an estimate from
    /// its length, because the true number is not known before.
    pub(super) fn admit_chunk(&self, chunk: &RawChunk) -> Result<usize, SessionError> {
        let (bytes, limit) = (chunk.content.len(), self.limits().raw_chunk_bytes);
        if limit < bytes {
            return Err(SessionError::ChunkTooLarge { bytes, limit });
        }
        if 0 < bytes {
            self.meter().check_epochs()?;
        }
        Ok((bytes / BYTES_PER_EPOCH + 1).min(self.limits().epochs_per_push))
    }

    /// Checks the tenant's quota of sessions. No other session of the tenant is created while the
    /// guard is held.
    pub(super) async fn admit_session(
        &self,
    ) -> Result<Option<tokio::sync::MutexGuard<'_, ()>>, SessionError> {
        let Some((creating, limit)) = self.meter().creating_session().await else {
            return Ok(None);
        };
        let used = self.store().tenant_use(self.tenant()).await?.sessions;
        let retry_after = STORED_DELAY;
        match used < limit {
            true => Ok(Some(creating)),
            false => Err(QuotaError::Sessions { used, limit, retry_after }.into()),
        }
    }

    pub(super) fn check_retention(&self, days: Option<u32>) -> Result<(), SessionError> {
        match days {
            Some(days) if RETENTION_MAX_DAYS < days => {
                Err(SessionError::RetentionTooLong { days, limit: RETENTION_MAX_DAYS })
            }
            _ => Ok(()),
        }
    }

    pub(super) fn check_label(&self, label: &str) -> Result<(), SessionError> {
        let (length, limit) = (label.chars().count(), self.limits().label_characters);
        if limit < length { Err(SessionError::LabelTooLong { length, limit }) } else { Ok(()) }
    }
}
