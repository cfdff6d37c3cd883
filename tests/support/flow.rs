//! The device's side of a stream, message by message.

use std::time::Duration;

use graphfix::contract::v1;
use graphfix::grpc::v1::positioning_client::PositioningClient;
use tokio::sync::mpsc;
use tokio::time::timeout;
use tokio_stream::wrappers::ReceiverStream;
use tonic::body::Body;
use tonic::client::GrpcService;
use tonic::codegen::{Body as HttpBody, Bytes, StdError};
use tonic::{Status, Streaming};

/// Longer than any answer takes on a busy machine.
const DEADLINE: Duration = Duration::from_secs(60);

/// A stream of messages `Q`, answered by messages `A`.
#[derive(Debug)]
pub(crate) struct Flow<Q, A> {
    /// Dropping it closes the device's side.
    sender: Option<mpsc::Sender<Q>>,
    answers: Streaming<A>,
}

/// A stream of epochs.
pub(crate) type EpochFlow = Flow<v1::StreamRequest, v1::StreamResponse>;

/// Opens a stream of epochs; its first answer is not read yet.
pub(crate) async fn epochs<T>(service: T, opening: v1::StreamOpening) -> EpochFlow
where
    T: GrpcService<Body>,
    T::Error: Into<StdError>,
    T::ResponseBody: HttpBody<Data = Bytes> + Send + 'static,
    <T::ResponseBody as HttpBody>::Error: Into<StdError> + Send,
{
    try_epochs(service, opening).await.unwrap()
}

/// The same for a service that may not answer.
pub(crate) async fn try_epochs<T>(
    service: T,
    opening: v1::StreamOpening,
) -> Result<EpochFlow, Status>
where
    T: GrpcService<Body>,
    T::Error: Into<StdError>,
    T::ResponseBody: HttpBody<Data = Bytes> + Send + 'static,
    <T::ResponseBody as HttpBody>::Error: Into<StdError> + Send,
{
    let (sender, messages) = mpsc::channel(1024);
    let first = v1::StreamRequest { opening: Some(opening), epochs: Vec::new() };
    sender.send(first).await.unwrap();
    let mut client = PositioningClient::new(service);
    let answers = client.stream(ReceiverStream::new(messages)).await?.into_inner();
    Ok(Flow { sender: Some(sender), answers })
}

/// Opens a stream of raw bytes; its first answer is not read yet.
pub(crate) async fn raw<T>(
    service: T,
    opening: v1::StreamRawOpening,
) -> Flow<v1::StreamRawRequest, v1::StreamRawResponse>
where
    T: GrpcService<Body>,
    T::Error: Into<StdError>,
    T::ResponseBody: HttpBody<Data = Bytes> + Send + 'static,
    <T::ResponseBody as HttpBody>::Error: Into<StdError> + Send,
{
    let (sender, messages) = mpsc::channel(1024);
    let first = v1::StreamRawRequest { opening: Some(opening), ..Default::default() };
    sender.send(first).await.unwrap();
    let mut client = PositioningClient::new(service);
    let answers = client.stream_raw(ReceiverStream::new(messages)).await.unwrap().into_inner();
    Flow { sender: Some(sender), answers }
}

impl<Q, A> Flow<Q, A> {
    /// Sends a message; it is lost if the service has ended the stream.
    pub(crate) async fn send(&self, message: Q) {
        self.sender.as_ref().unwrap().send(message).await.ok();
    }

    /// Closes this side.
    pub(crate) fn close(&mut self) {
        self.sender = None;
    }

    /// The next answer; `None` at the end.
    pub(crate) async fn next(&mut self) -> Result<Option<A>, Status> {
        timeout(DEADLINE, self.answers.message()).await.expect("the stream is silent")
    }

    /// The next answer.
    pub(crate) async fn answer(&mut self) -> A {
        self.next().await.unwrap().expect("the stream has ended")
    }

    /// The status with which the service ends the stream. Skips answers before it.
    pub(crate) async fn refusal(&mut self) -> Status {
        loop {
            match self.next().await {
                Ok(Some(_)) => {}
                Ok(None) => panic!("the stream ended without a refusal"),
                Err(status) => return status,
            }
        }
    }
}

impl EpochFlow {
    /// Sends epochs in one message.
    pub(crate) async fn push(&self, epochs: Vec<v1::Epoch>) {
        self.send(v1::StreamRequest { opening: None, epochs }).await;
    }

    /// The results of all answers until epoch `seq` is durable.
    pub(crate) async fn until_durable(&mut self, seq: u64) -> Vec<v1::StreamResult> {
        let mut results = Vec::new();
        loop {
            let answer = self.answer().await;
            results.extend(answer.results);
            if Some(seq) <= answer.durable_through {
                return results;
            }
        }
    }
}
