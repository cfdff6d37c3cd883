//! Protobuf as tonic does it, except that an undecodable message is the client's fault.

use std::marker::PhantomData;

use bytes::Buf;
use prost::Message;
use tonic::codec::{BufferSettings, DecodeBuf, Decoder};
use tonic_prost::{ProstCodec, ProstEncoder};

use crate::contract::{Lease, Refusal, extent_of, off_the_network};
use crate::refusal::Code;

use super::status::to_status;

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
    type Encoder = ProstEncoder<T>;
    type Decoder = MessageDecoder<U>;

    fn encoder(&mut self) -> Self::Encoder {
        ProstCodec::<T, U>::raw_encoder(BufferSettings::default())
    }

    fn decoder(&mut self) -> Self::Decoder {
        MessageDecoder(PhantomData)
    }
}

/// Decodes one message.
#[derive(Clone, Debug)]
pub struct MessageDecoder<U>(PhantomData<U>);

impl<U: Message + Default + 'static> Decoder for MessageDecoder<U> {
    type Item = U;
    type Error = tonic::Status;

    fn decode(&mut self, buffer: &mut DecodeBuf<'_>) -> Result<Option<U>, tonic::Status> {
        let length = buffer.remaining();
        if let Some(lease) = Lease::current() {
            let extent = off_the_network(length, || extent_of::<U>(buffer.chunk()));
            extent.reserve(length, &lease).map_err(|refusal| to_status(&refusal))?;
        }
        off_the_network(length, || U::decode(&mut *buffer)).map(Some).map_err(|error| {
            let offset = length - buffer.remaining();
            let refusal = Refusal::new(Code::MalformedBody, error.to_string());
            to_status(&refusal.on_byte(offset as u64))
        })
    }
}
