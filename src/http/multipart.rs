//! Bodies of several parts (RFC 7578), read as they arrive.

use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::task::{Context, Poll};

use axum::BoxError;
use axum::body::BodyDataStream;
use axum::extract::Request;
use axum::http::header;
use bytes::{Bytes, BytesMut};
use futures::Stream;

use crate::contract::Refusal;
use crate::refusal::Code;

/// Most bytes that may arrive without completing a chunk or the head of a part. The parser keeps
/// them in memory.
const PENDING_BYTES: usize = 1 << 20;
/// Most parts of a body.
const PARTS: usize = 64;

/// A body of several parts.
pub(super) struct Multipart {
    parts: multer::Multipart<'static>,
    pending: Pending,
    count: usize,
}

/// One part.
pub(super) struct Part {
    field: multer::Field<'static>,
    pending: Pending,
}

/// Number of bytes that have arrived and are not passed to the reader yet.
#[derive(Clone, Default)]
struct Pending(Arc<AtomicUsize>);

impl Pending {
    fn clear(&self) {
        self.0.store(0, Ordering::Release);
    }

    /// Adds bytes.
    ///
    /// # Errors
    /// They are more than any head of a part needs.
    fn add(&self, bytes: usize) -> Result<(), BoxError> {
        let pending = self.0.fetch_add(bytes, Ordering::AcqRel) + bytes;
        if pending <= PENDING_BYTES {
            return Ok(());
        }
        let message = format!("{pending} bytes without the head of a part");
        Err(Refusal::new(Code::MalformedBody, message).into())
    }
}

/// A body that gives one chunk each time it is polled. Otherwise the parser would poll until
/// nothing more has arrived, and keep everything in memory.
struct Paced {
    body: BodyDataStream,
    pending: Pending,
    has_given: bool,
}

impl Stream for Paced {
    type Item = Result<Bytes, BoxError>;

    fn poll_next(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<Self::Item>> {
        if std::mem::take(&mut self.has_given) {
            context.waker().wake_by_ref();
            return Poll::Pending;
        }
        let polled = Pin::new(&mut self.body).poll_next(context);
        polled.map(|chunk| {
            let bytes = match chunk? {
                Ok(bytes) => bytes,
                Err(error) => return Some(Err(error.into())),
            };
            self.has_given = true;
            Some(self.pending.add(bytes.len()).map(|()| bytes))
        })
    }
}

impl Multipart {
    /// The parts of a request's body.
    ///
    /// # Errors
    /// The body is not `multipart/form-data` with a boundary.
    pub(super) fn of(request: Request) -> Result<Self, Refusal> {
        let kind = request.headers().get(header::CONTENT_TYPE);
        let kind = kind.and_then(|value| value.to_str().ok()).unwrap_or("none");
        let boundary = multer::parse_boundary(kind).map_err(|error| {
            let kind = kind.get(..80).unwrap_or(kind);
            let message =
                format!("content type {kind}: {error}; this call takes multipart/form-data");
            Refusal::new(Code::UnsupportedMediaType, message)
        })?;
        let pending = Pending::default();
        let body = request.into_body().into_data_stream();
        let paced = Paced { body, pending: pending.clone(), has_given: false };
        Ok(Self { parts: multer::Multipart::new(paced, boundary), pending, count: 0 })
    }

    /// The next part; `None` at the end.
    ///
    /// # Errors
    /// The body is malformed or breaks off, or has too many parts.
    pub(super) async fn next(&mut self) -> Result<Option<Part>, Refusal> {
        let field = self.parts.next_field().await.map_err(|error| refusal(&error))?;
        self.pending.clear();
        self.count += 1;
        if PARTS < self.count {
            let message = format!("the body has more than {PARTS} parts");
            return Err(Refusal::new(Code::JobTooLarge, message));
        }
        Ok(field.map(|field| Part { field, pending: self.pending.clone() }))
    }
}

impl Part {
    /// Its name.
    ///
    /// # Errors
    /// It has none.
    pub(super) fn name(&self) -> Result<&str, Refusal> {
        self.field.name().ok_or_else(|| {
            let message = "a part has no name in its Content-Disposition";
            Refusal::new(Code::MalformedBody, message)
        })
    }

    /// The name of its file on the sender's side; empty if absent.
    pub(super) fn file_name(&self) -> String {
        self.field.file_name().unwrap_or_default().to_owned()
    }

    /// Its next bytes; `None` at its end.
    ///
    /// # Errors
    /// The body is malformed or breaks off.
    pub(super) async fn chunk(&mut self) -> Result<Option<Bytes>, Refusal> {
        let chunk = self.field.chunk().await.map_err(|error| refusal(&error))?;
        self.pending.clear();
        Ok(chunk)
    }

    /// All its bytes, which are the options of a job.
    ///
    /// # Errors
    /// It has more than `limit` bytes, or the body is malformed or breaks off.
    pub(super) async fn whole_options(&mut self, limit: usize) -> Result<Bytes, Refusal> {
        let mut whole = BytesMut::new();
        while let Some(chunk) = self.chunk().await? {
            if limit < whole.len() + chunk.len() {
                let message = format!("the options have more than {limit} bytes");
                return Err(Refusal::new(Code::JobOptionsTooLarge, message).at("options"));
            }
            whole.extend_from_slice(&chunk);
        }
        Ok(whole.freeze())
    }
}

/// The refusal of a body, or the one that ended it.
fn refusal(error: &multer::Error) -> Refusal {
    match error {
        multer::Error::StreamReadFailed(source) => Refusal::of_body(&**source),
        error => Refusal::new(Code::MalformedBody, error.to_string()),
    }
}
