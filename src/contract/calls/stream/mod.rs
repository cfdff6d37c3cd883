//! Streams of a device: messages are received, and answers are sent when the acknowledged epochs
//! are durable.
//!
//! A stream has no task of its own. The sender of its answers polls it. So the service does not
//! read from a device that reads no answers.

mod epochs;
mod flow;
mod ledger;
mod raw;
mod results;

use futures::Stream;

use crate::contract::{Caller, Refusal, v1};

use epochs::OfEpochs;
use flow::Flow;
use raw::OfRaw;

/// The answers to a stream of epochs. The last one is an error if the stream ends with a refusal.
pub fn epochs<I, E>(
    caller: &Caller,
    messages: I,
) -> impl Stream<Item = Result<v1::StreamResponse, E>> + Send + use<I, E>
where
    I: Stream<Item = Result<v1::StreamRequest, E>> + Send + Unpin + 'static,
    E: From<Refusal> + Send + 'static,
{
    Flow::<OfEpochs, I, E>::answers(caller, messages)
}

/// The answers to a stream of raw bytes. The last one is an error if the stream ends with a
/// refusal.
pub fn raw<I, E>(
    caller: &Caller,
    messages: I,
) -> impl Stream<Item = Result<v1::StreamRawResponse, E>> + Send + use<I, E>
where
    I: Stream<Item = Result<v1::StreamRawRequest, E>> + Send + Unpin + 'static,
    E: From<Refusal> + Send + 'static,
{
    Flow::<OfRaw, I, E>::answers(caller, messages)
}
