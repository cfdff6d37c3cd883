//! The NTRIP client: connects, requests, and reads the stream.

use std::time::Duration;

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::time::{Instant, timeout, timeout_at};

use crate::feeds::head::HEAD_LIMIT;
use crate::feeds::{Connection, Connector};

use super::chunked::Unchunker;
use super::head;
use super::sourcetable::{TABLE_LIMIT, is_whole};
use super::{NtripError, Sourcetable, StreamRequest};

/// Longest time for sending a sentence.
const SENDING: Duration = Duration::from_secs(10);
/// Most bytes per read.
const READ_BYTES: usize = 16 << 10;

/// A stream that a caster has granted.
#[derive(Debug)]
pub struct NtripStream {
    connection: Connection,
    unchunker: Option<Unchunker>,
    /// Content that arrived with the head.
    first: Vec<u8>,
    buffer: Vec<u8>,
}

/// Requests a stream. `position` is a GGA sentence for casters that need the rover's position.
///
/// # Errors
/// The caster is not contacted, does not answer, or refuses.
pub async fn connect(
    connector: &Connector,
    request: &StreamRequest,
    position: Option<&str>,
) -> Result<NtripStream, NtripError> {
    let (mut stream, is_sourcetable) = open(connector, request, position).await?;
    if is_sourcetable {
        let answer = "the answer is the sourcetable".to_owned();
        return Err(NtripError::NoSuchMountpoint { answer });
    }
    // A request of version 1 has no field for the sentence.
    if let Some(position) = position {
        stream.send(position).await?;
    }
    Ok(stream)
}

/// Requests a caster's sourcetable. The mountpoint of `request` is empty.
///
/// # Errors
/// The caster is not contacted, does not answer, refuses, or sends no sourcetable.
pub async fn sourcetable(
    connector: &Connector,
    request: &StreamRequest,
) -> Result<Sourcetable, NtripError> {
    let listing = connector.time_limits().listing;
    let deadline = Instant::now() + listing;
    let (mut stream, is_sourcetable) = open(connector, request, None).await?;
    if !is_sourcetable {
        return Err(NtripError::Protocol { why: "the answer is not a sourcetable".to_owned() });
    }
    let (mut text, mut chunk) = (Vec::new(), Vec::new());
    while !is_whole(&text) {
        let read = timeout_at(deadline, stream.read(&mut chunk)).await;
        match read {
            Err(_) => return Err(NtripError::Silent { seconds: listing.as_secs() }),
            Ok(Err(NtripError::Closed { .. })) => break,
            Ok(read) => read?,
        }
        text.append(&mut chunk);
        if TABLE_LIMIT < text.len() {
            let why = format!("its sourcetable is longer than {TABLE_LIMIT} bytes");
            return Err(NtripError::Protocol { why });
        }
    }
    Ok(Sourcetable::parse(&text))
}

/// Connects, sends the request, and reads the head. Also returns whether a sourcetable follows.
async fn open(
    connector: &Connector,
    request: &StreamRequest,
    position: Option<&str>,
) -> Result<(NtripStream, bool), NtripError> {
    let caster = &request.caster;
    let mut connection = connector.connect(&caster.host, caster.port, caster.is_tls).await?;
    let text = request.text(position);
    let answering = connector.time_limits().answering;
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
            let closed = || NtripError::Closed { why: "before the answer".to_owned() };
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
    /// Appends the next bytes of the stream to `content`; returns once there are some. Cancelling
    /// the call loses no byte.
    ///
    /// # Errors
    /// The stream has ended, or its chunks are invalid.
    pub async fn read(&mut self, content: &mut Vec<u8>) -> Result<(), NtripError> {
        if !self.first.is_empty() {
            content.append(&mut self.first);
            return Ok(());
        }
        let before = content.len();
        while content.len() == before {
            if self.unchunker.as_ref().is_some_and(Unchunker::is_at_end) {
                return Err(NtripError::Closed { why: "the last chunk has arrived".to_owned() });
            }
            let length = self.connection.read(&mut self.buffer).await.map_err(closed)?;
            if length == 0 {
                return Err(NtripError::Closed { why: "the connection ended".to_owned() });
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
    /// The connection has ended, or accepts no data.
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
