//! The contract of both doors: its messages, the calls over them, and the refusals.
//!
//! One schema serves gRPC and REST. The messages are generated from `proto/`, with their JSON
//! twins; each call is one function from a request to an answer or a [`Refusal`], and a door only
//! carries them: protobuf and `google.rpc.Status` there, JSON and problem documents here.

pub mod calls;
pub mod convert;
pub mod intake;
pub mod json;
mod origin;
pub mod reason;
mod refusal;
mod service;

pub use refusal::Refusal;
pub use service::Service;

/// The messages of `proto/graphfix/v1`; their documentation is the comments there.
#[allow(missing_docs, unreachable_pub, clippy::all)]
pub mod v1 {
    include!(concat!(env!("OUT_DIR"), "/messages/graphfix.v1.rs"));
}
