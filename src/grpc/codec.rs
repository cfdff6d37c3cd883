//! Protobuf as in tonic, except that an undecodable message is the client's fault.

use std::any::TypeId;
use std::marker::PhantomData;

use bytes::Buf;
use prost::Message;
use tonic::codec::{BufferSettings, DecodeBuf, Decoder, EncodeBuf, Encoder};
use tonic_prost::{ProstCodec, ProstEncoder};

use crate::contract::{Lease, Refusal, extent_of, off_the_network, v1};
use crate::refusal::Code;

use super::status::to_status;
use super::stream_body::PREFIX_BYTES;

/// Buffers of a device's stream for messages to read, and to write (bytes). A longer message
/// enlarges them while it is processed.
const STREAM_BUFFER_BYTES: [usize; 2] = [2 << 10, 512];
/// Bytes after which encoded messages of a stream are sent.
const STREAM_YIELD_BYTES: usize = 32 << 10;

/// Encodes like [`ProstCodec`]. A message that cannot be decoded is refused as `MALFORMED_BODY`,
/// with the byte at which decoding stopped. The service, but not a client, first counts the content
/// and reserves the memory of the decoded message.
#[derive(Clone, Debug)]
pub struct Codec<T, U>(PhantomData<(T, U)>);

impl<T, U> Default for Codec<T, U> {
    fn default() -> Self {
        Self(PhantomData)
    }
}

impl<T, U> tonic::codec::Codec for Codec<T, U>
where
    T: Message + Send + 'static,
    U: Message + Default + Send + 'static,
{
    type Encode = T;
    type Decode = U;
    type Encoder = MessageEncoder<T>;
    type Decoder = MessageDecoder<U>;

    fn encoder(&mut self) -> Self::Encoder {
        let [_, to_write] = STREAM_BUFFER_BYTES;
        MessageEncoder(ProstCodec::<T, U>::raw_encoder(settings_for::<T>(to_write)))
    }

    fn decoder(&mut self) -> Self::Decoder {
        MessageDecoder { lease: Lease::current(), message: PhantomData }
    }
}

/// Buffers for messages of this type. They are small for streams of devices, because there are
/// thousands of them.
fn settings_for<M: 'static>(bytes: usize) -> BufferSettings {
    let of_streams = [
        TypeId::of::<v1::StreamRequest>(),
        TypeId::of::<v1::StreamRawRequest>(),
        TypeId::of::<v1::StreamResponse>(),
        TypeId::of::<v1::StreamRawResponse>(),
    ];
    match of_streams.contains(&TypeId::of::<M>()) {
        true => BufferSettings::new(bytes, STREAM_YIELD_BYTES),
        false => BufferSettings::default(),
    }
}

/// Encodes the messages of a call, long ones off the threads that serve the network.
#[derive(Clone, Debug)]
pub struct MessageEncoder<T>(ProstEncoder<T>);

impl<T: Message> Encoder for MessageEncoder<T> {
    type Item = T;
    type Error = tonic::Status;

    fn encode(&mut self, message: T, buffer: &mut EncodeBuf<'_>) -> Result<(), tonic::Status> {
        off_the_network(message.encoded_len(), || self.0.encode(message, buffer))
    }

    fn buffer_settings(&self) -> BufferSettings {
        self.0.buffer_settings()
    }
}

/// Decodes the messages of a call.
#[derive(Clone, Debug)]
pub struct MessageDecoder<U> {
    /// The lease of the request; `None` outside a service.
    lease: Option<Lease>,
    message: PhantomData<U>,
}

impl<U: Message + Default + 'static> Decoder for MessageDecoder<U> {
    type Item = U;
    type Error = tonic::Status;

    fn decode(&mut self, buffer: &mut DecodeBuf<'_>) -> Result<Option<U>, tonic::Status> {
        let length = buffer.remaining();
        if let Some(lease) = &self.lease {
            let extent = off_the_network(length, || extent_of::<U>(buffer.chunk()));
            extent.reserve(length, lease).map_err(|refusal| to_status(&refusal))?;
            lease.note_decoded(length, length + PREFIX_BYTES);
        }
        off_the_network(length, || U::decode(&mut *buffer)).map(Some).map_err(|error| {
            let offset = length - buffer.remaining();
            let refusal = Refusal::new(Code::MalformedBody, error.to_string());
            to_status(&refusal.on_byte(offset as u64))
        })
    }

    fn buffer_settings(&self) -> BufferSettings {
        let [to_read, _] = STREAM_BUFFER_BYTES;
        settings_for::<U>(to_read)
    }
}

#[cfg(test)]
mod tests {
    use futures::stream;
    use http_body_util::BodyExt;
    use tonic::codec::{Codec as _, EncodeBody, SingleMessageCompressionOverride};

    use super::*;
    use crate::contract::probe::{Probe, is_served_during};

    async fn encode(probe: Probe) {
        let encoder = Codec::<Probe, Probe>::default().encoder();
        let (messages, inherit) =
            (stream::iter([Ok(probe)]), SingleMessageCompressionOverride::Inherit);
        let body = EncodeBody::new_server(encoder, messages, None, inherit, None);
        body.collect().await.unwrap();
    }

    #[test]
    fn a_long_answer_is_encoded_off_the_threads_of_the_network() {
        assert_eq!(is_served_during(encode), [true, false], "long, short");
    }
}
