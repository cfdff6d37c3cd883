//! Creates sessions, and changes their settings.

use std::time::Instant;

use tokio::time::sleep;

use crate::config::PositioningOptions;
use crate::store::{Author, Created, NamedRequest, SessionKey, SessionSettings};

use super::configuration::{base_of, settings, stored_options};
use super::desk::Sessions;
use super::info::etag_of;
use super::updates_to_confirm::LOOK_INTERVAL;
use super::{NewSession, SessionError, SessionId, SessionInfo, SessionUpdate};

impl Sessions {
    /// Creates a session and stores it.
    ///
    /// # Errors
    /// A configuration, base or antenna does not exist, the label is too long, or the store fails.
    pub async fn create(&self, new: NewSession) -> Result<SessionInfo, SessionError> {
        Ok(self.create_once(new, None).await?.0)
    }

    /// Creates a session by a request that may have a name. Returns the session, and whether it is
    /// new: a repetition of a named request returns the session that the first one has created.
    ///
    /// # Errors
    /// As for [`Self::create`]; or a request with this name had other content.
    pub async fn create_once(
        &self,
        new: NewSession,
        request: Option<NamedRequest>,
    ) -> Result<(SessionInfo, bool), SessionError> {
        if let Some(request) = &request
            && let Some(before) = self.created_by(request).await?
        {
            return Ok((before, false));
        }
        self.check_label(&new.label)?;
        self.check_retention(new.retention_days)?;
        let base = self.base_names(new.base)?;
        let antenna = self.antenna_name(&new.antenna).await?;
        let NewSession { label, mode, profile, overrides, retention_days, .. } = new;
        let settings = settings(label, mode, profile, overrides, base, antenna)?;
        self.check_settings(&settings)?;
        let settings = SessionSettings { retention_days, ..settings };
        let id = SessionId::random();
        let (store, named) = (self.store(), request.as_ref());
        let _creating = self.admit_session().await?;
        let (tenant, now) = (self.tenant(), self.unix_ms());
        loop {
            let row = store.create_session_once(tenant, id.as_str(), &settings, now, named);
            if let Some(row) = row.await? {
                return Ok((self.info(id, row)?, true));
            }
            // Another call with this name came first. If its session was deleted meanwhile, the
            // name is free again.
            let named = named.expect("only a named request can meet another of its name");
            if let Some(before) = self.created_by(named).await? {
                return Ok((before, false));
            }
        }
    }

    /// Checks that the service can provide the output that the settings ask for.
    fn check_settings(&self, settings: &SessionSettings) -> Result<(), SessionError> {
        let options = stored_options(settings)?;
        self.check_output(&options, &base_of(options.mode, &settings.base)?)
    }

    /// The session that a request with this name has created.
    async fn created_by(
        &self,
        request: &NamedRequest,
    ) -> Result<Option<SessionInfo>, SessionError> {
        let created = self.store().session_created_by(self.tenant(), &request.name).await?;
        let Some(Created { id, hash }) = created else { return Ok(None) };
        if hash != request.hash {
            return Err(SessionError::RequestConflict { id });
        }
        let id = SessionId::parse(&id).ok_or(SessionError::NotFound { id })?;
        match self.get(&id).await {
            // The session was deleted meanwhile, so the name is free again.
            Err(SessionError::NotFound { .. }) => Ok(None),
            found => found.map(Some),
        }
    }

    /// Changes the label, configuration or base of a session. Epochs sent after this call returns
    /// are positioned with the new configuration; epochs already in the mailbox may be, too.
    ///
    /// # Errors
    /// No session has this id, the session is closed, it has another etag than the one given, a
    /// configuration, base or antenna does not exist, or the session has changed too often.
    pub async fn update(
        &self,
        id: &SessionId,
        update: SessionUpdate,
    ) -> Result<SessionInfo, SessionError> {
        self.update_by(id, update, None).await
    }

    /// Like [`Self::update`], as an act of `author`.
    ///
    /// # Errors
    /// As for [`Self::update`].
    pub(crate) async fn update_by(
        &self,
        id: &SessionId,
        update: SessionUpdate,
        author: Option<&Author>,
    ) -> Result<SessionInfo, SessionError> {
        if let Some(label) = &update.label {
            self.check_label(label)?;
        }
        self.check_retention(update.retention_days)?;
        let _starting = self.starting(id).await;
        let mut row = self.claimed(self.open_row(id).await?, id).await?;
        if update.etag.is_some_and(|etag| etag != etag_of(&row.settings)) {
            return Err(SessionError::Changed { id: id.to_string() });
        }
        let before = row.settings.clone();
        for name in &update.clear_overrides {
            // An earlier version may have stored an override that no longer exists.
            if !before.overrides.contains_key(name) {
                PositioningOptions::check_name(name).map_err(SessionError::UnknownCleared)?;
            }
        }
        let mut overrides = row.settings.overrides;
        overrides.retain(|name, _| !update.clear_overrides.contains(name));
        overrides.extend(update.overrides);
        let base = match update.base {
            None => row.settings.base,
            Some(base) => self.base_names(base)?,
        };
        let antenna = match update.antenna {
            None => row.settings.antenna,
            Some(antenna) => self.antenna_name(&antenna).await?,
        };
        let retention_days = update.retention_days.or(row.settings.retention_days);
        let settings = settings(
            update.label.unwrap_or(row.settings.label),
            update.mode.unwrap_or(row.settings.mode),
            update.profile.unwrap_or(row.settings.profile),
            overrides,
            base,
            antenna,
        )?;
        self.check_settings(&settings)?;
        row.settings = SessionSettings { retention_days, ..settings };
        if row.settings == before {
            // An update before may have stored these settings without knowing it.
            self.outdated(id, row.key);
            return self.info(id.clone(), row); // Nothing to write, and no act for the audit log.
        }
        self.desk().update_rates.admit(id, Instant::now())?;
        let entry = author.map(|author| {
            self.entry(author, "Sessions.Update", id, changes(&before, &row.settings))
        });
        let stored = self.store().update_session(row.key, &row.settings, entry.as_deref()).await;
        // Even after an error, because only the answer to the commit may be lost.
        self.outdated(id, row.key);
        stored.inspect_err(|_| self.confirm_later(id, row.key))?;
        self.info(id.clone(), row)
    }

    /// Has the session's task and its watches read the store again every second after an update or
    /// a closing that failed, because the database may still commit it.
    pub(super) fn confirm_later(&self, id: &SessionId, key: SessionKey) {
        if self.desk().updates_to_confirm.note(id) {
            tokio::spawn(self.clone().look_again(id.clone(), key));
        }
    }

    /// The task of [`Self::confirm_later`]. The answer to an epoch that comes meanwhile does not
    /// show whether the settings are stored.
    async fn look_again(self, id: SessionId, key: SessionKey) {
        loop {
            sleep(LOOK_INTERVAL).await;
            if self.is_draining() {
                return;
            }
            let is_answered = self.store().session_of_any(id.as_str()).await.is_ok();
            if is_answered {
                self.outdated(&id, key);
            }
            if !self.desk().updates_to_confirm.count(&id, is_answered) {
                return;
            }
        }
    }

    /// The session's task and its watches read the settings again.
    fn outdated(&self, id: &SessionId, key: SessionKey) {
        self.live().publish_unknown(key);
        self.tasks().outdate(id);
    }
}

/// The changed settings as text for the audit log.
fn changes(before: &SessionSettings, now: &SessionSettings) -> String {
    let mut changes = Vec::new();
    let days = |days: Option<u32>| days.map_or("the service's".to_owned(), |days| days.to_string());
    for (name, before, now) in [
        ("label", format!("{:?}", before.label), format!("{:?}", now.label)),
        ("mode", before.mode.clone(), now.mode.clone()),
        ("profile", before.profile.clone(), now.profile.clone()),
        ("retentionDays", days(before.retention_days), days(now.retention_days)),
    ] {
        if before != now {
            changes.push(format!("{name} {before} → {now}"));
        }
    }
    for (name, is_changed) in [
        ("overrides", before.overrides != now.overrides),
        ("base", before.base != now.base),
        ("antenna", before.antenna != now.antenna),
    ] {
        if is_changed {
            changes.push(name.to_owned());
        }
    }
    match changes.is_empty() {
        true => "values of the profile in this version".to_owned(),
        false => changes.join(", "),
    }
}
