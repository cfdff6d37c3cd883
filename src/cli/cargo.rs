//! What a device's stream carries: numbered epochs, or the bytes of a receiver.

use prost::Message;
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Request, Status, Streaming};

use crate::contract::v1;
use crate::gnss::GpsTime;

use super::connection::Positioning;

/// A kind of stream.
pub(super) trait Cargo {
    type Request: Message + Clone + Default + 'static;
    type Response: 'static;

    /// What a message is counted in, in the plural.
    const UNIT: &'static str;

    /// The first message.
    fn opening(&self, opening: Opening<'_>) -> Self::Request;

    /// Opens a stream.
    async fn open(
        client: &mut Positioning,
        messages: Request<ReceiverStream<Self::Request>>,
    ) -> Result<tonic::Response<Streaming<Self::Response>>, Status>;

    /// Reads the content of an answer.
    fn read(response: Self::Response) -> Answer;

    /// Whether a message only states that a receiver's stream ends. The answer to the last bytes
    /// has the same number as the answer to this message.
    fn is_bare_end(request: &Self::Request) -> bool;
}

/// What the first message of a stream tells the service.
pub(super) struct Opening<'a> {
    pub(super) session: &'a str,
    pub(super) answers: v1::Answers,
    /// Number of the last answered epoch; 0 before the first answer.
    pub(super) acknowledged: u64,
}

/// An answer to epochs or to bytes.
pub(super) struct Answer {
    /// Time without a message after which the service ends the stream (s); in the first answer.
    pub(super) idle_s: Option<f64>,
    /// Number of the last epoch that is durable or refused, or number of durable bytes.
    pub(super) through: Option<u64>,
    /// What the device may send in all, counted from the beginning of this stream.
    pub(super) credit: Amount,
    pub(super) results: Vec<v1::StreamResult>,
    pub(super) ending: Option<v1::StreamEnding>,
}

/// Epochs or chunks, and the bytes of their messages.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Amount {
    pub(super) count: u64,
    pub(super) bytes: u64,
}

impl Amount {
    /// Whether both numbers are at most those of `credit`.
    pub(super) const fn is_within(self, credit: Self) -> bool {
        self.count <= credit.count && self.bytes <= credit.bytes
    }

    pub(super) const fn plus(self, other: Self) -> Self {
        Self { count: self.count + other.count, bytes: self.bytes + other.bytes }
    }
}

/// Epochs that the device numbers.
pub(super) struct Epochs;

/// Bytes of a receiver.
pub(super) struct RawBytes {
    /// A time near that of the bytes. It dates bytes without a GPS week.
    pub(super) near: Option<GpsTime>,
}

impl Cargo for Epochs {
    type Request = v1::StreamRequest;
    type Response = v1::StreamResponse;

    const UNIT: &'static str = "epochs";

    fn opening(&self, opening: Opening<'_>) -> Self::Request {
        let opening = v1::StreamOpening {
            session: opening.session.to_owned(),
            answers: opening.answers.into(),
            last_acknowledged: Some(opening.acknowledged),
        };
        v1::StreamRequest { opening: Some(opening), epochs: Vec::new() }
    }

    async fn open(
        client: &mut Positioning,
        messages: Request<ReceiverStream<Self::Request>>,
    ) -> Result<tonic::Response<Streaming<Self::Response>>, Status> {
        client.stream(messages).await
    }

    fn read(response: Self::Response) -> Answer {
        let credit = response.credit.unwrap_or_default();
        // A refused epoch is never durable. Its result comes in the order of the epochs.
        let settled = response.results.last().map(|result| result.seq);
        Answer {
            idle_s: response.opened.map(|opened| opened.idle_s),
            through: response.durable_through.max(settled),
            credit: Amount { count: credit.epochs, bytes: credit.bytes },
            results: response.results,
            ending: response.ending,
        }
    }

    fn is_bare_end(_: &Self::Request) -> bool {
        false
    }
}

impl Cargo for RawBytes {
    type Request = v1::StreamRawRequest;
    type Response = v1::StreamRawResponse;

    const UNIT: &'static str = "chunks";

    fn opening(&self, opening: Opening<'_>) -> Self::Request {
        let opening = v1::StreamRawOpening {
            session: opening.session.to_owned(),
            answers: opening.answers.into(),
            last_acknowledged: Some(opening.acknowledged),
            near: self.near.map(Into::into),
            ..Default::default()
        };
        v1::StreamRawRequest { opening: Some(opening), ..Default::default() }
    }

    async fn open(
        client: &mut Positioning,
        messages: Request<ReceiverStream<Self::Request>>,
    ) -> Result<tonic::Response<Streaming<Self::Response>>, Status> {
        client.stream_raw(messages).await
    }

    fn read(response: Self::Response) -> Answer {
        let credit = response.credit.unwrap_or_default();
        Answer {
            idle_s: response.opened.map(|opened| opened.idle_s),
            through: Some(response.raw_through),
            credit: Amount { count: credit.chunks, bytes: credit.bytes },
            results: response.results,
            ending: response.ending,
        }
    }

    fn is_bare_end(request: &Self::Request) -> bool {
        request.end && request.content.is_empty()
    }
}
