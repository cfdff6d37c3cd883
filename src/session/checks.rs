//! Checks of a request before anything changes.

use crate::aiding::bases::{BaseChoice, BaseId};
use crate::config::RETENTION_MAX_DAYS;
use crate::store::AntennaName;

use super::desk::Sessions;
use super::{SequencedEpoch, SessionError};

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
        Ok(choice.try_map(|id| self.aiding().bases.name(&id))?)
    }

    /// The calibrated antenna of a name; none for an empty name.
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
