//! The TLS handshake of a connection, bounded in time and in bytes.

use std::future::poll_fn;
use std::io;
use std::pin::{Pin, pin};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::task::{Context, Poll};
use std::time::Duration;

use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt, ReadBuf};
use tokio::net::TcpStream;
use tokio::time::timeout;
use tokio_rustls::server::TlsStream;

use crate::contract::Refusal;
use crate::refusal::Code;
use crate::tls::ServerTls;

use super::problem::Problem;

/// Most bytes that a peer may send for its handshake. Chains of certificates have up to some 6 kB.
const HANDSHAKE_BYTES: usize = 16 << 10;
/// First byte of a TLS connection: a record of a handshake (RFC 8446, section 5.1).
const HANDSHAKE_RECORD: u8 = 22;
/// Time, and bytes, that a refused peer has to read the refusal.
const FAREWELL: Duration = Duration::from_secs(1);
const FAREWELL_BYTES: usize = 64 << 10;
/// The first bytes of an HTTP/2 connection (RFC 9113, section 3.4). Its peer reads only frames.
const HTTP2_PREFACE: &[u8] = b"PRI ";
/// Types of frames, and a reason to end a connection (RFC 9113, sections 6.5, 6.8 and 7).
const SETTINGS: u8 = 4;
const GOAWAY: u8 = 7;
const INADEQUATE_SECURITY: u32 = 12;

/// A connection with TLS.
pub(super) type Encrypted = TlsStream<Bounded>;

/// A connection that stops reading when its peer has sent the most that it may.
pub(super) struct Bounded {
    stream: TcpStream,
    /// Bytes that may still be read.
    left: Arc<AtomicUsize>,
}

/// The connection after the handshake. `None` if the handshake failed, took longer than `patience`,
/// or had too many bytes. The peer then gets a refusal, if it can read one.
pub(super) async fn agree(
    stream: TcpStream,
    tls: &ServerTls,
    patience: Duration,
) -> Option<Encrypted> {
    let outcome = match timeout(patience, agreed(stream, tls)).await {
        Ok(outcome) => outcome,
        Err(_) => Err((io::ErrorKind::TimedOut.into(), None)),
    };
    match outcome {
        Ok(stream) => Some(stream),
        Err((error, stream)) => {
            tls.meters().failed_handshakes.inc();
            // A debug line, so that hostile peers do not fill the log.
            tracing::debug!(%error, "no TLS handshake");
            if let Some(stream) = stream {
                take_leave(stream).await;
            }
            None
        }
    }
}

/// Why the handshake failed, and the connection if its peer is still there.
type NotAgreed = (io::Error, Option<TcpStream>);

async fn agreed(stream: TcpStream, tls: &ServerTls) -> Result<Encrypted, NotAgreed> {
    let mut first = [0; HTTP2_PREFACE.len()];
    match stream.peek(&mut first).await {
        Ok(0) => return Err((io::ErrorKind::UnexpectedEof.into(), None)),
        Ok(length) if first[0] != HANDSHAKE_RECORD => {
            let error = io::Error::new(io::ErrorKind::InvalidData, "not TLS");
            return Err((error, refuse_plain(stream, &first[..length]).await));
        }
        Ok(_) => {}
        Err(error) => return Err((error, None)),
    }
    let left = Arc::new(AtomicUsize::new(HANDSHAKE_BYTES));
    let bounded = Bounded { stream, left: left.clone() };
    let mut handshake = pin!(tls.acceptor().accept(bounded).into_fallible());
    let outcome = poll_fn(|context| match handshake.as_mut().poll(context) {
        Poll::Pending if left.load(Ordering::Relaxed) == 0 => Poll::Ready(None),
        outcome => outcome.map(Some),
    });
    match outcome.await {
        Some(Ok(stream)) => {
            left.store(usize::MAX, Ordering::Relaxed);
            Ok(stream)
        }
        Some(Err((error, bounded))) => Err((error, Some(bounded.stream))),
        None => Err((io::Error::new(io::ErrorKind::InvalidData, "a long handshake"), None)),
    }
}

/// Answers a peer that does not use TLS, if it uses HTTP.
async fn refuse_plain(mut stream: TcpStream, first: &[u8]) -> Option<TcpStream> {
    let refusal = Refusal::new(Code::TlsRequired, "this port takes TLS only");
    let answer = match first {
        HTTP2_PREFACE => goodbye(&refusal),
        // A method of HTTP/1.1.
        [first, ..] if first.is_ascii_uppercase() => Problem::closing_answer(&refusal).into(),
        _ => return None,
    };
    stream.write_all(&answer).await.ok()?;
    Some(stream)
}

/// The end of an HTTP/2 connection, with a refusal for the log of the peer.
fn goodbye(refusal: &Refusal) -> Vec<u8> {
    let text = format!("{}: {} ({})", refusal.code, refusal.message, refusal.code.remedy());
    let content = [&[0; 4][..], &INADEQUATE_SECURITY.to_be_bytes(), text.as_bytes()].concat();
    [frame(SETTINGS, &[]), frame(GOAWAY, &content)].concat()
}

/// A frame of the connection itself, without flags (RFC 9113, section 4.1).
fn frame(kind: u8, content: &[u8]) -> Vec<u8> {
    let [_, length @ ..] = (content.len() as u32).to_be_bytes();
    [&length[..], &[kind, 0, 0, 0, 0, 0], content].concat()
}

/// Ends a connection so that its peer can read the last bytes sent. If bytes of the peer were
/// unread, the system would discard what was sent.
async fn take_leave(mut stream: TcpStream) {
    let discard = async {
        stream.shutdown().await?;
        let mut rest = stream.take(FAREWELL_BYTES as u64);
        tokio::io::copy(&mut rest, &mut tokio::io::sink()).await
    };
    // Err: the peer has ended the connection, or does not end it in time.
    drop(timeout(FAREWELL, discard).await);
}

impl AsyncRead for Bounded {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        let left = self.left.load(Ordering::Relaxed);
        if left == 0 {
            // Nothing wakes the task here: `agreed` checks the remaining bytes, and ends the
            // handshake.
            return Poll::Pending;
        }
        let before = buffer.filled().len();
        let outcome = Pin::new(&mut self.stream).poll_read(context, buffer);
        let read = buffer.filled().len() - before;
        if left != usize::MAX {
            self.left.store(left.saturating_sub(read), Ordering::Relaxed);
        }
        outcome
    }
}

impl AsyncWrite for Bounded {
    fn poll_write(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        Pin::new(&mut self.stream).poll_write(context, bytes)
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_flush(context)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_shutdown(context)
    }

    fn is_write_vectored(&self) -> bool {
        self.stream.is_write_vectored()
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        slices: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        Pin::new(&mut self.stream).poll_write_vectored(context, slices)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_peer_of_http_2_reads_why() {
        let bytes = goodbye(&Refusal::new(Code::TlsRequired, "no"));
        let text = "TLS_REQUIRED: no (begin the address with https://)";
        let head = [0, 0, 0, 4, 0, 0, 0, 0, 0, 0, 0, 8 + text.len() as u8, 7, 0, 0, 0, 0, 0];
        let end = [&[0, 0, 0, 0, 0, 0, 0, 12], text.as_bytes()].concat();
        assert_eq!(bytes, [&head[..], &end].concat());
    }
}
