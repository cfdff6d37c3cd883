//! The files of archives for any time, fetched once: for jobs, whose recordings may be old.

use std::io::BufRead;
use std::sync::Arc;

use tokio::time::sleep;

use crate::formats::unpack_within;
use crate::gnss::GpsTime;

use super::archive::{PACKED_LIMIT, UNPACKED_LIMIT};
use super::web::{self, Fetched, Url, Validators, WebError};
use super::{ArchiveTemplate, Attempts, Connector};

/// Most files of one request (a month of daily files, or a day of hourly ones), and most bytes of
/// them together, as received.
const FILES_MAX: usize = 32;
const BYTES_MAX: usize = 64 << 20;

/// A file of an archive.
pub(crate) struct ArchivedFile {
    /// Its URL.
    pub(crate) url: Url,
    /// Start of the time that it covers.
    pub(crate) from: GpsTime,
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
    /// Archives, fetched by `connector` from the hosts that it allows.
    pub fn new(templates: Vec<ArchiveTemplate>, connector: Connector) -> Self {
        Self { templates: templates.into(), connector }
    }

    /// The files with ephemerides from one time until another, from the first archive that has any.
    ///
    /// # Errors
    /// No archive has a file, and at least one could not be asked.
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

/// The files of an archive that contain the times from `from` until `until`, as far as the archive
/// has them. If the files have no certain time, the list is empty.
///
/// # Errors
/// The host is not allowed, refuses, or does not send a file in time, or the files together are too
/// large.
pub(crate) async fn files(
    connector: &Connector,
    template: &ArchiveTemplate,
    (from, until): (GpsTime, GpsTime),
) -> Result<Vec<ArchivedFile>, WebError> {
    let (mut found, mut at, mut bytes) = (Vec::new(), from, 0);
    for _ in 0..FILES_MAX {
        let Some((start, end)) = template.span(at).filter(|_| at <= until) else { break };
        let url = template.at(at)?;
        if let Some(content) = tried(connector, &url).await? {
            bytes += content.len();
            if BYTES_MAX < bytes {
                return Err(WebError::TooLarge { limit: BYTES_MAX });
            }
            found.push(ArchivedFile { url, from: start, content });
        }
        at = end;
    }
    Ok(found)
}

/// The content of a file, with several attempts; `None` if the host does not have the file.
async fn tried(connector: &Connector, url: &Url) -> Result<Option<Vec<u8>>, WebError> {
    let (known, mut attempts) = (Validators::default(), Attempts::new());
    loop {
        let error = match web::fetch(connector, url, &known, PACKED_LIMIT).await {
            Ok(Fetched::New { content, .. }) => return Ok(Some(content)),
            Ok(Fetched::Unchanged { .. }) | Err(WebError::NotFound { .. }) => return Ok(None),
            Err(error) => error,
        };
        match attempts.delay_after(&error) {
            Some(delay) => sleep(delay).await,
            None => return Err(error),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicUsize, Ordering};

    use tokio::io::{AsyncReadExt, AsyncWriteExt};
    use tokio::net::TcpListener;

    use super::*;
    use crate::feeds::{FetchPolicy, TimeLimits};

    /// An archive of hourly files of this size, or of none, and the number of requests.
    async fn archive(bytes: Option<usize>) -> (ArchiveTemplate, Arc<AtomicUsize>) {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let port = listener.local_addr().unwrap().port();
        let asked = Arc::<AtomicUsize>::default();
        let count = asked.clone();
        tokio::spawn(async move {
            while let Ok((mut stream, _)) = listener.accept().await {
                let mut head = [0; 4096];
                if stream.read(&mut head).await.unwrap() == 0 {
                    continue; // It was opened in vain.
                }
                count.fetch_add(1, Ordering::SeqCst);
                let status = if bytes.is_some() { "200 OK" } else { "404 Not Found" };
                let length = bytes.unwrap_or_default();
                let head = format!("HTTP/1.1 {status}\r\nContent-Length: {length}\r\n\r\n");
                stream.write_all(head.as_bytes()).await.unwrap();
                // Err: the client takes no more.
                stream.write_all(&vec![b' '; length]).await.ok();
            }
        });
        let template = format!("http://127.0.0.1:{port}/{{yyyy}}{{ddd}}{{hh}}");
        (ArchiveTemplate::new(&template).unwrap(), asked)
    }

    /// The number of files of this many hours.
    async fn hours(template: &ArchiveTemplate, hours: f64) -> Result<usize, WebError> {
        let policy = FetchPolicy::new(&["127.0.0.1".to_owned()], true).unwrap();
        let connector = Connector::new(policy, TimeLimits::standard(), None).unwrap();
        let from = GpsTime::from_week_seconds(2347, 86_400.0);
        let span = (from, from + (hours - 0.5) * 3600.0);
        Ok(files(&connector, template, span).await?.len())
    }

    #[tokio::test]
    async fn files_are_bounded_together() {
        let (template, asked) = archive(Some(24 << 20)).await;
        assert_eq!(hours(&template, 2.0).await, Ok(2));
        let refused = hours(&template, 4.0).await;
        assert_eq!(refused, Err(WebError::TooLarge { limit: BYTES_MAX }));
        assert_eq!(asked.load(Ordering::SeqCst), 2 + 3, "no more are fetched");
    }

    #[tokio::test]
    async fn no_more_files_are_asked_for_than_allowed() {
        let (template, asked) = archive(None).await;
        assert_eq!(hours(&template, 100.0).await, Ok(0));
        assert_eq!(asked.load(Ordering::SeqCst), FILES_MAX);
    }
}
