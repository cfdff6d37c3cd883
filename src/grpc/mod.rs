//! The gRPC door. One file per service; the calls are in `contract`.

mod admission;
mod audit;
mod bases;
mod codec;
mod frame;
mod history;
mod jobs;
mod keys;
mod metadata;
mod navigation;
mod operations;
mod positioning;
mod routes;
mod sessions;
mod solutions;
mod status;
mod stream_body;
mod tenants;

use std::pin::Pin;

use futures::Stream;
use tonic::Status;

use crate::contract::Service;

pub(crate) use admission::is_stream;
pub use codec::Codec;
pub(crate) use routes::routes;
pub(crate) use status::to_status;
pub use status::{code_of, grpc_code};
pub(crate) use stream_body::PREFIX_BYTES;

/// The services of `proto/graphfix/v1`, servers and clients.
#[allow(missing_docs, unreachable_pub, clippy::all)]
pub mod v1 {
    include!(concat!(env!("OUT_DIR"), "/services/graphfix.v1.rs"));
}

/// `google.longrunning` of `proto-google/`, messages, server and client.
#[allow(missing_docs, unreachable_pub, clippy::all)]
pub mod longrunning {
    include!(concat!(env!("OUT_DIR"), "/services/google.longrunning.rs"));
}

/// The schema, for reflection.
pub const DESCRIPTORS: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/descriptors.bin"));

/// The messages of a stream to the client.
type Answered<T> = Pin<Box<dyn Stream<Item = Result<T, Status>> + Send>>;

/// Implements the services of this door.
#[derive(Clone)]
struct Door(Service);
