//! The client: connects, asks, and hands on what comes.

use std::time::Duration;

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::time::{Instant, timeout, timeout_at};

use crate::feeds::head::HEAD_LIMIT;
use crate::feeds::{Connection, Connector};

use super::chunked::Unchunker;
use super::head;
use super::sourcetable::{TABLE_LIMIT, is_whole};
use super::{NtripError, Sourcetable, StreamRequest};

/// How long a sentence may take to be sent.
const SENDING: Duration = Duration::from_secs(10);
/// Bytes read at once.
const READ_BYTES: usize = 16 << 10;

/// A stream that a caster has granted.
#[derive(Debug)]
pub struct NtripStream {
    connection: Connection,
    unchunker: Option<Unchunker>,
    /// Content that came with the head.
    first: Vec<u8>,
    buffer: Vec<u8>,
}

/// Asks a caster for a stream; with a sentence GGA for one that needs the rover's position.
///
/// # Errors
/// The caster is not asked, does not answer, or refuses.
pub async fn connect(
    connector: &Connector,
    request: &StreamRequest,
    position: Option<&str>,
) -> Result<NtripStream, NtripError> {
    let (mut stream, is_sourcetable) = open(connector, request, position).await?;
    if is_sourcetable {
        let answer = "it answers with its sourcetable".to_owned();
        return Err(NtripError::NoSuchMountpoint { answer });
    }
    // In version 1 the sentence has no place in the request.
    if let Some(position) = position {
        stream.send(position).await?;
    }
    Ok(stream)
}

/// Asks a caster for its sourcetable; `request` names no mountpoint.
///
/// # Errors
/// The caster is not asked, does not answer, refuses, or gives none.
pub async fn sourcetable(
    connector: &Connector,
    request: &StreamRequest,
) -> Result<Sourcetable, NtripError> {
    let listing = connector.patience().listing;
    let deadline = Instant::now() + listing;
    let (mut stream, is_sourcetable) = open(connector, request, None).await?;
    if !is_sourcetable {
        return Err(NtripError::Protocol { why: "it gives no sourcetable".to_owned() });
    }
    let (mut text, mut piece) = (Vec::new(), Vec::new());
    while !is_whole(&text) {
        let read = timeout_at(deadline, stream.read(&mut piece)).await;
        match read {
            Err(_) => return Err(NtripError::Silent { seconds: listing.as_secs() }),
            Ok(Err(NtripError::Closed { .. })) => break,
            Ok(read) => read?,
        }
        text.append(&mut piece);
        if TABLE_LIMIT < text.len() {
            let why = format!("its sourcetable is longer than {TABLE_LIMIT} bytes");
            return Err(NtripError::Protocol { why });
        }
    }
    Ok(Sourcetable::parse(&text))
}

/// Connects, asks, and reads the head; also whether a sourcetable follows.
async fn open(
    connector: &Connector,
    request: &StreamRequest,
    position: Option<&str>,
) -> Result<(NtripStream, bool), NtripError> {
    let caster = &request.caster;
    let mut connection = connector.connect(&caster.host, caster.port, caster.is_tls).await?;
    let text = request.text(position);
    let answering = connector.patience().answering;
    let deadline = Instant::now() + answering;
    let silent = |_| NtripError::Silent { seconds: answering.as_secs() };
    timeout_at(deadline, connection.write_all(text.as_bytes()))
        .await
        .map_err(silent)?
        .map_err(closed)?;
    let mut bytes = Vec::new();
    let mut buffer = vec![0; READ_BYTES];
    let granted = loop {
        if let Some(granted) = head::read(&bytes)? {
            break granted;
        }
        let room = HEAD_LIMIT.min(buffer.len());
        let reading = connection.read(&mut buffer[..room]);
        let length = timeout_at(deadline, reading).await.map_err(silent)?.map_err(closed)?;
        if length == 0 {
            let refusal = head::refusal(&bytes);
            let closed = || NtripError::Closed { why: "before it answered".to_owned() };
            return Err(refusal.unwrap_or_else(closed));
        }
        bytes.extend_from_slice(&buffer[..length]);
    };
    let mut stream = NtripStream {
        connection,
        unchunker: granted.is_chunked.then(Unchunker::new),
        first: Vec::new(),
        buffer,
    };
    let mut first = Vec::new();
    stream.take(&bytes[granted.length..], &mut first)?;
    stream.first = first;
    Ok((stream, granted.is_sourcetable))
}

impl NtripStream {
    /// Adds what comes next to `content`; returns once something has come. A call that is given up
    /// loses nothing.
    ///
    /// # Errors
    /// The stream has ended, or is no stream.
    pub async fn read(&mut self, content: &mut Vec<u8>) -> Result<(), NtripError> {
        if !self.first.is_empty() {
            content.append(&mut self.first);
            return Ok(());
        }
        let before = content.len();
        while content.len() == before {
            if self.unchunker.as_ref().is_some_and(Unchunker::is_at_end) {
                return Err(NtripError::Closed { why: "its last chunk has come".to_owned() });
            }
            let length = self.connection.read(&mut self.buffer).await.map_err(closed)?;
            if length == 0 {
                return Err(NtripError::Closed { why: "the connection has ended".to_owned() });
            }
            let buffer = std::mem::take(&mut self.buffer);
            let taken = self.take(&buffer[..length], content);
            self.buffer = buffer;
            taken?;
        }
        Ok(())
    }

    /// Sends a sentence, such as the rover's position.
    ///
    /// # Errors
    /// The connection has ended, or takes nothing.
    pub async fn send(&mut self, sentence: &str) -> Result<(), NtripError> {
        let sending = self.connection.write_all(sentence.as_bytes());
        let sent = timeout(SENDING, sending).await;
        sent.map_err(|_| NtripError::Silent { seconds: SENDING.as_secs() })?.map_err(closed)
    }

    fn take(&mut self, bytes: &[u8], content: &mut Vec<u8>) -> Result<(), NtripError> {
        match &mut self.unchunker {
            Some(unchunker) => unchunker
                .push(bytes, content)
                .map_err(|unchunked| NtripError::Protocol { why: unchunked.0.to_owned() }),
            None => {
                content.extend_from_slice(bytes);
                Ok(())
            }
        }
    }
}

fn closed(error: std::io::Error) -> NtripError {
    NtripError::Closed { why: error.to_string() }
}
