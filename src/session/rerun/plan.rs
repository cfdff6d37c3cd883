//! Which epochs of a session are positioned again, and with which options.

use crate::aiding::AidingDesk;
use crate::aiding::bases::{BaseChoice, BaseId};
use crate::config::{Mode, PositioningOptions};
use crate::gnss::GpsTime;
use crate::recording::AnswerKind;
use crate::session::configuration::{base_of, stored_options};
use crate::session::{SessionError, SessionId, SolveRequest};
use crate::store::{SessionRow, Store};
use crate::tenant::Tenant;

/// How a stored session is to be positioned again.
#[derive(Clone, Debug)]
pub struct RerunRequest {
    /// The options and bases that differ from the session's.
    pub change: SolveRequest,
    /// Whether the epochs of the base come from a file.
    pub has_base_file: bool,
    /// First and last time of the epochs; `None` for no limit.
    pub span: (Option<GpsTime>, Option<GpsTime>),
    /// The kind of the answers.
    pub answer: AnswerKind,
}

/// The epochs and options that result from a request, for the session as it is now.
#[derive(Clone, Debug, PartialEq)]
pub struct RerunPlan {
    /// Numbers of the first and the last epoch.
    pub numbers: (u64, u64),
    /// The options in force.
    pub options: PositioningOptions,
    /// Whether the request changes nothing: each epoch is positioned with the options and base
    /// epochs with which it was answered.
    pub is_as_answered: bool,
}

impl RerunRequest {
    /// The plan of this request for a session of a tenant, as the session is now.
    ///
    /// # Errors
    /// The tenant has no session with this id, an option or base does not exist, the mode needs a
    /// base, the session has no epoch in the span, or the store fails.
    pub async fn plan(
        &self,
        store: &Store,
        aiding: &AidingDesk,
        tenant: &Tenant,
        id: &SessionId,
    ) -> Result<RerunPlan, SessionError> {
        let row = session(store, tenant, id).await?;
        let own = stored_options(&row.settings)?;
        let change = SolveRequest { mode: self.mode(own.mode), ..self.change.clone() };
        let options = change.options(&row.settings)?;
        let bases = self.bases(aiding, &row, options.mode)?;
        let is_same = options == own && bases == base_of(own.mode, &row.settings.base)?;
        let is_begun = self.span.0.is_none() && self.answer != AnswerKind::Batch;
        let numbers = store.epoch_numbers(row.key, row.removed_through, self.span).await?;
        let id = id.to_string();
        let none = match self.span {
            (None, None) => SessionError::Empty { id },
            _ => SessionError::NoEpochInSpan { id },
        };
        Ok(RerunPlan {
            numbers: numbers.ok_or(none)?,
            options,
            is_as_answered: is_same && is_begun && !self.has_base_file,
        })
    }

    /// The mode: that of the request, otherwise the session's. If the request adds a base to a
    /// session without one, it is the best mode relative to a base.
    fn mode(&self, of_session: Mode) -> Option<String> {
        let has_base = self.has_base_file || !self.change.base.is_none();
        match &self.change.mode {
            None if has_base && !of_session.is_relative() => {
                Some(Mode::of_recording(has_base).name().to_owned())
            }
            named => named.clone(),
        }
    }

    /// The bases whose stored epochs are used: those of the request, otherwise the session's,
    /// otherwise the nearest one.
    pub(super) fn bases(
        &self,
        aiding: &AidingDesk,
        row: &SessionRow,
        mode: Mode,
    ) -> Result<BaseChoice, SessionError> {
        if self.has_base_file {
            return Ok(BaseChoice::None);
        }
        let visible = aiding.bases.of(&row.tenant);
        let asked = self.change.base.clone().try_map(|id: BaseId| visible.name(&id))?;
        let nearest = match visible.has_usable() {
            true => BaseChoice::Nearest,
            false => BaseChoice::None,
        };
        let choices = [asked, row.settings.base.clone(), nearest];
        let chosen = choices.into_iter().find(|choice| !choice.is_none());
        base_of(mode, &chosen.unwrap_or_default())
    }
}

/// A session of a tenant.
pub(super) async fn session(
    store: &Store,
    tenant: &Tenant,
    id: &SessionId,
) -> Result<SessionRow, SessionError> {
    let row = store.session(tenant, id.as_str()).await?;
    row.ok_or_else(|| SessionError::NotFound { id: id.to_string() })
}
