//! The contract of both doors: messages, calls and refusals.
//!
//! One schema serves gRPC and REST. The messages are generated from `proto/`, together with their
//! JSON form. Each call is a function from a request to an answer or a [`Refusal`]. A door only
//! transports both: gRPC as protobuf and `google.rpc.Status`, REST as JSON and problem documents.

pub mod access;
mod audit;
mod body_rate;
mod budget;
mod caller;
pub mod calls;
pub mod convert;
mod extent;
mod failure_log;
mod hang_up;
mod header_or_field;
pub(crate) mod intake;
pub(crate) mod json;
mod metrics;
pub(crate) mod nodes;
mod observation;
mod origin;
mod places;
mod presenter;
mod readiness;
pub(crate) mod reason;
mod refusal;
mod refused_acts;
mod request_meters;
mod routing;
mod service;
mod short_text;
mod sign_in;
mod texts;
mod threads;
mod web_origins;

pub(crate) use body_rate::BodyRate;
pub use budget::Budget;
pub(crate) use budget::{Lease, check_ratio};
pub use caller::Caller;
pub(crate) use extent::{Extent, extent_of};
pub(crate) use failure_log::log_failure;
pub(crate) use hang_up::finished;
pub(crate) use header_or_field::header_or_field;
pub use presenter::Presenter;
pub use refusal::Refusal;
pub(crate) use request_meters::{Outcome, RequestMeters};
pub use service::Service;
pub(crate) use service::Tiles;
pub(crate) use sign_in::SignedIn;
#[cfg(test)]
pub(crate) use threads::probe;
pub(crate) use threads::{in_background, off_the_network};
pub use web_origins::{WebOriginError, WebOrigins};

/// The messages of `proto/graphfix/v1`. Their documentation is in the proto files.
#[allow(missing_docs, unreachable_pub, clippy::all)]
pub mod v1 {
    pub use super::observation::Observation;
    pub use super::short_text::ShortText;

    include!(concat!(env!("OUT_DIR"), "/messages/graphfix.v1.rs"));
}
