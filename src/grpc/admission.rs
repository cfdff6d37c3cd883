//! Checks of a request before its call: content type, encoding and deadline.
//!
//! Messages are unpacked here and not by tonic. So their compression ratio and memory are checked
//! while they are unpacked, and this happens outside the threads that serve the network.

use std::io::{BufRead, Read};
use std::time::Duration;

use axum::body::{Body, Bytes};
use axum::extract::Request;
use axum::http::{HeaderMap, StatusCode, header};
use axum::middleware::Next;
use axum::response::Response;
use bytes::BytesMut;
use flate2::bufread::MultiGzDecoder;
use http_body_util::BodyExt;

use crate::contract::{Lease, Refusal, in_background};
use crate::refusal::Code;

use super::status::to_status;
use super::stream_body::{PREFIX_BYTES, StreamBody, TooLong};

const ENCODING: &str = "grpc-encoding";
const ACCEPTED_ENCODINGS: &str = "grpc-accept-encoding";
const TIMEOUT: &str = "grpc-timeout";
/// The calls of these services have one message, except the streams.
const SERVICES: [&str; 2] = ["/graphfix.v1.", "/google.longrunning."];
/// Calls with a stream of messages.
const STREAMS: [&str; 3] =
    ["/graphfix.v1.Positioning/Stream", "/graphfix.v1.Positioning/StreamRaw", CREATE_JOB];
const CREATE_JOB: &str = "/graphfix.v1.Jobs/Create";
const BLOCK_BYTES: usize = 64 << 10;
/// Largest window of a Zstandard frame, as a power of two (bytes).
const WINDOW_LOG_MAX: u32 = 23;

/// Calls that answer with a stream of short messages.
const WATCHES: [&str; 3] =
    ["/graphfix.v1.Solutions/Watch", "/graphfix.v1.Jobs/Watch", "/graphfix.v1.Sessions/WatchHeads"];

/// Largest sizes of messages (bytes).
#[derive(Clone, Copy, Debug)]
pub(super) struct MessageLimits {
    pub(super) of_call: usize,
    /// Largest size of each message of a stream.
    pub(super) of_stream: usize,
}

/// Whether the call at this path has a stream of messages.
pub(crate) fn is_stream(path: &str) -> bool {
    STREAMS.contains(&path)
}

/// Serves a request unless it is refused.
pub(super) async fn admit(limits: MessageLimits, request: Request, next: Next) -> Response {
    let kind = request.headers().get(header::CONTENT_TYPE);
    if !kind.is_some_and(|kind| kind.as_bytes().starts_with(b"application/grpc")) {
        let message = "a call of this service takes application/grpc";
        let mut response = refused(&Refusal::new(Code::UnsupportedMediaType, message));
        *response.status_mut() = StatusCode::UNSUPPORTED_MEDIA_TYPE;
        return response;
    }
    let deadline = timeout_of(request.headers());
    let call = async {
        let admitted = match is_stream(request.uri().path()) {
            true => streamed_request(request, limits.of_stream),
            false => unpacked_request(request, limits.of_call).await,
        };
        match admitted {
            Ok(request) => next.run(request).await,
            Err(refusal) => refused(&refusal),
        }
    };
    match deadline {
        None => call.await,
        Some(deadline) => tokio::time::timeout(deadline, call).await.unwrap_or_else(|_| {
            let message = format!("the call was not answered within {} ms", deadline.as_millis());
            refused(&Refusal::new(Code::DeadlineExceeded, message))
        }),
    }
}

fn refused(refusal: &Refusal) -> Response {
    to_status(refusal).into_http::<Body>()
}

/// The value of `grpc-timeout`: up to eight digits and a unit. Invalid values are ignored, as the
/// specification of gRPC demands.
fn timeout_of(headers: &HeaderMap) -> Option<Duration> {
    let text = headers.get(TIMEOUT)?.to_str().ok()?;
    let (digits, unit) = text.split_at_checked(text.len().checked_sub(1)?)?;
    if digits.is_empty() || 8 < digits.len() || !digits.bytes().all(|b| b.is_ascii_digit()) {
        return None;
    }
    let count: u64 = digits.parse().ok()?;
    match unit {
        "H" => Some(Duration::from_secs(3600 * count)),
        "M" => Some(Duration::from_secs(60 * count)),
        "S" => Some(Duration::from_secs(count)),
        "m" => Some(Duration::from_millis(count)),
        "u" => Some(Duration::from_micros(count)),
        "n" => Some(Duration::from_nanos(count)),
        _ => None,
    }
}

/// The compression of a message.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Encoding {
    Gzip,
    Zstd,
}

/// The request for a call with a stream of messages. Its messages and answers are not packed.
fn streamed_request(mut request: Request, limit: usize) -> Result<Request, Refusal> {
    let headers = request.headers_mut();
    headers.remove(ACCEPTED_ENCODINGS);
    if headers.get(ENCODING).is_some_and(|encoding| encoding.as_bytes() != b"identity") {
        let message = "the messages of a stream are not packed: use the encoding identity";
        return Err(Refusal::new(Code::UnsupportedMediaType, message));
    }
    let too_long = match request.uri().path() {
        CREATE_JOB => TooLong::Chunk,
        _ => TooLong::Credit,
    };
    Ok(request.map(|body| Body::new(StreamBody::new(body, limit, too_long))))
}

/// The request with its message unpacked.
async fn unpacked_request(mut request: Request, limit: usize) -> Result<Request, Refusal> {
    if WATCHES.contains(&request.uri().path()) {
        request.headers_mut().remove(ACCEPTED_ENCODINGS);
    }
    let path = request.uri().path();
    if !SERVICES.iter().any(|service| path.starts_with(service)) {
        return Ok(request);
    }
    let encoding = match request.headers().get(ENCODING).map(|name| name.as_bytes()) {
        None | Some(b"identity") => return Ok(request),
        Some(b"gzip") => Encoding::Gzip,
        Some(b"zstd") => Encoding::Zstd,
        Some(other) => {
            let other = String::from_utf8_lossy(other);
            let message = format!("encoding {other:?}; this service takes identity, gzip, zstd");
            return Err(Refusal::new(Code::UnsupportedMediaType, message));
        }
    };
    request.headers_mut().remove(ENCODING);
    request.headers_mut().remove(header::CONTENT_LENGTH);
    let (parts, body) = request.into_parts();
    let packed = collected(body, limit).await?;
    let lease = Lease::current();
    let work = move || unpacked(packed, encoding, limit, lease.as_ref());
    let message = in_background(work).await??;
    Ok(Request::from_parts(parts, Body::from(message)))
}

async fn collected(mut body: Body, limit: usize) -> Result<Bytes, Refusal> {
    let mut packed = BytesMut::new();
    while let Some(frame) = body.frame().await {
        let frame = frame.map_err(|error| Refusal::of_body(&error))?;
        let Ok(data) = frame.into_data() else { continue };
        packed.extend_from_slice(&data);
        if limit + PREFIX_BYTES < packed.len() {
            let message = format!("the message has more than {limit} bytes");
            return Err(Refusal::new(Code::BodyTooLarge, message));
        }
    }
    Ok(packed.freeze())
}

/// The same message, unpacked. Bytes that are not exactly one packed message are returned
/// unchanged, and tonic then reads or refuses them.
fn unpacked(
    packed: Bytes,
    encoding: Encoding,
    limit: usize,
    lease: Option<&Lease>,
) -> Result<Bytes, Refusal> {
    let Some((prefix, content)) = packed.split_at_checked(PREFIX_BYTES) else { return Ok(packed) };
    let length = u32::from_be_bytes([prefix[1], prefix[2], prefix[3], prefix[4]]);
    if prefix[0] != 1 || length as usize != content.len() {
        return Ok(packed);
    }
    let damaged = |error: std::io::Error| {
        Refusal::new(Code::MalformedBody, format!("the message cannot be unpacked: {error}"))
    };
    let mut message = match encoding {
        Encoding::Gzip => read(&mut MultiGzDecoder::new(content), content.len(), limit, lease)?,
        Encoding::Zstd => {
            let mut reader = zstd::Decoder::with_buffer(content).map_err(damaged)?;
            reader.window_log_max(WINDOW_LOG_MAX).map_err(damaged)?;
            read(&mut reader, content.len(), limit, lease)?
        }
    };
    let length = u32::try_from(message.len() - PREFIX_BYTES).unwrap_or(u32::MAX);
    message[1..PREFIX_BYTES].copy_from_slice(&length.to_be_bytes());
    Ok(message.into())
}

/// Reads a message to its end. The result begins with [`PREFIX_BYTES`] zeros for its prefix.
fn read(
    reader: &mut dyn Read,
    packed: usize,
    limit: usize,
    lease: Option<&Lease>,
) -> Result<Vec<u8>, Refusal> {
    let mut reader = std::io::BufReader::with_capacity(BLOCK_BYTES, reader);
    let mut message = vec![0; PREFIX_BYTES];
    loop {
        let block = reader.fill_buf().map_err(|error| {
            let message = format!("the message cannot be unpacked: {error}");
            Refusal::new(Code::MalformedBody, message)
        })?;
        let length = block.len();
        if length == 0 {
            return Ok(message);
        }
        // The message is copied once more when tonic reads it.
        lease.map_or(Ok(()), |lease| lease.reserve(2 * length))?;
        message.extend_from_slice(block);
        reader.consume(length);
        let unpacked = message.len() - PREFIX_BYTES;
        if limit < unpacked {
            let message = format!("unpacked, the message has more than {limit} bytes");
            return Err(Refusal::new(Code::BodyTooLarge, message));
        }
        crate::contract::check_ratio(packed, unpacked)?;
    }
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use super::*;

    fn gzip(content: &[u8]) -> Bytes {
        let mut packer = flate2::write::GzEncoder::new(Vec::new(), Default::default());
        packer.write_all(content).unwrap();
        framed(&packer.finish().unwrap())
    }

    fn framed(packed: &[u8]) -> Bytes {
        [&[1][..], &(packed.len() as u32).to_be_bytes(), packed].concat().into()
    }

    #[test]
    fn messages_are_unpacked_up_to_a_limit_and_a_ratio() {
        let content: Vec<u8> = (0..70_000_u32).flat_map(|n| n.to_string().into_bytes()).collect();
        let zstd = framed(&zstd::encode_all(&content[..], 3).unwrap());
        for (packed, encoding) in [(gzip(&content), Encoding::Gzip), (zstd, Encoding::Zstd)] {
            let message = unpacked(packed.clone(), encoding, 1 << 20, None).unwrap();
            assert_eq!(message[..5], [&[0][..], &(content.len() as u32).to_be_bytes()].concat());
            assert_eq!(message[5..], content);
            let refusal = unpacked(packed.clone(), encoding, 300_000, None).unwrap_err();
            assert_eq!(refusal.code, Code::BodyTooLarge);
            let mut damaged = packed.to_vec();
            damaged[PREFIX_BYTES] ^= 0xff; // The magic number.
            assert!(unpacked(damaged.into(), encoding, 1 << 20, None).is_err());
        }
        let bomb = gzip(&vec![0; 16 << 20]);
        let refusal = unpacked(bomb, Encoding::Gzip, 16 << 20, None).unwrap_err();
        assert_eq!(refusal.code, Code::CompressedTooMuch);
    }

    #[test]
    fn timeouts_are_read_as_the_specification_says() {
        let given = |text: &str| {
            let mut headers = HeaderMap::new();
            headers.insert(TIMEOUT, text.parse().unwrap());
            timeout_of(&headers)
        };
        assert_eq!(given("250m"), Some(Duration::from_millis(250)));
        assert_eq!(given("99999999H"), Some(Duration::from_secs(99_999_999 * 3600)));
        for invalid in ["", "m", "5", "5x", "-1S", "123456789S"] {
            assert_eq!(given(invalid), None, "{invalid:?}");
        }
    }
}
