//! The files of archives for any time, fetched once: for jobs, whose recordings may be old.

use std::io::BufRead;
use std::sync::Arc;
use std::time::Duration;

use tokio::time::sleep;

use crate::formats::unpack_within;
use crate::gnss::GpsTime;
use crate::refusal::Code;

use super::archive::{PACKED_LIMIT, UNPACKED_LIMIT};
use super::web::{self, Fetched, Url, Validators, WebError};
use super::{ArchiveTemplate, Backoff, Connector};

/// Most files of one request, a month of daily ones or a day of hourly ones, and most bytes of them
/// together, as they are in memory.
const FILES_MAX: usize = 32;
const BYTES_MAX: usize = 64 << 20;
/// Times that a file is tried, and the delays between them.
const TRIES: usize = 3;
const DELAY: Duration = Duration::from_secs(2);
const DELAY_CEILING: Duration = Duration::from_secs(30);

/// A file of an archive.
pub(crate) struct ArchivedFile {
    /// Where it is.
    pub(crate) url: Url,
    /// Its bytes, plain or gzip.
    pub(crate) content: Vec<u8>,
}

impl ArchivedFile {
    /// Its bytes unpacked, within the limit of all files of archives.
    pub(crate) fn unpacked(&self) -> impl BufRead + '_ {
        unpack_within(&self.content, UNPACKED_LIMIT)
    }
}

/// The operator's archives of ephemerides.
#[derive(Clone)]
pub struct NavigationArchives {
    templates: Arc<[ArchiveTemplate]>,
    connector: Connector,
}

impl NavigationArchives {
    /// Archives whose hosts the connector contacts.
    pub fn new(templates: Vec<ArchiveTemplate>, connector: Connector) -> Self {
        Self { templates: templates.into(), connector }
    }

    /// The files with ephemerides from one time until another, of the first archive that has any.
    ///
    /// # Errors
    /// No archive has one, and one of them could not be asked.
    pub(crate) async fn files(
        &self,
        span: (GpsTime, GpsTime),
    ) -> Result<Vec<ArchivedFile>, WebError> {
        let mut failed = None;
        for template in self.templates.iter() {
            match files(&self.connector, template, span).await {
                Ok(found) if found.is_empty() => {}
                Ok(found) => return Ok(found),
                Err(error) => drop(failed.get_or_insert(error)),
            }
        }
        failed.map_or(Ok(Vec::new()), Err)
    }
}

/// The files of an archive that contain the times from `from` until `until`, as far as it has them.
/// An archive whose files are not of a certain time has none.
///
/// # Errors
/// The host is not contacted, refuses, or does not send a file in time, or the files are too large
/// together.
pub(crate) async fn files(
    connector: &Connector,
    template: &ArchiveTemplate,
    (from, until): (GpsTime, GpsTime),
) -> Result<Vec<ArchivedFile>, WebError> {
    let (mut found, mut at, mut bytes) = (Vec::new(), from, 0);
    for _ in 0..FILES_MAX {
        let Some((_, end)) = template.span(at).filter(|_| at <= until) else { break };
        let url = template.at(at)?;
        if let Some(content) = tried(connector, &url).await? {
            bytes += content.len();
            if BYTES_MAX < bytes {
                return Err(WebError::TooLarge { limit: BYTES_MAX });
            }
            found.push(ArchivedFile { url, content });
        }
        at = end;
    }
    Ok(found)
}

/// The content of a file, with several tries; `None` if the host does not have it.
async fn tried(connector: &Connector, url: &Url) -> Result<Option<Vec<u8>>, WebError> {
    let (known, mut backoff) = (Validators::default(), Backoff::new(DELAY, DELAY_CEILING));
    for attempt in 1.. {
        let error = match web::fetch(connector, url, &known, PACKED_LIMIT).await {
            Ok(Fetched::New { content, .. }) => return Ok(Some(content)),
            Ok(Fetched::Unchanged) | Err(WebError::NotFound { .. }) => return Ok(None),
            Err(error) => error,
        };
        if attempt == TRIES || !error.is_passing() {
            return Err(error);
        }
        let asked = error.retry_after().filter(|asked| *asked <= DELAY_CEILING);
        sleep(backoff.next(asked)).await;
    }
    unreachable!("the last try returns")
}

impl WebError {
    /// Whether another try may succeed.
    pub(crate) fn is_passing(&self) -> bool {
        let passing = [
            Code::HostUnresolved,
            Code::HostUnreachable,
            Code::HostSlow,
            Code::HostRefuses,
            Code::HostProtocol,
            Code::FileCut,
        ];
        passing.contains(&self.code())
    }
}
