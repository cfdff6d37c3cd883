//! Errors outside the calls: refusals that tonic makes itself, and panics.

use std::any::Any;

use axum::body::Body;
use axum::response::Response;
use tonic::{Code as GrpcCode, Status};

use crate::contract::Refusal;
use crate::panics::words;
use crate::refusal::Code;

use super::status::to_status;

const STATUS: &str = "grpc-status";
const DETAILS: &str = "grpc-status-details-bin";

/// Adds a code and remedy to a status that tonic made itself.
pub(super) fn explain(response: Response) -> Response {
    if !response.headers().contains_key(STATUS) || response.headers().contains_key(DETAILS) {
        return response;
    }
    let Some(status) = Status::from_header_map(response.headers()) else { return response };
    let code = match status.code() {
        // Tonic's answer to a message beyond the limit, packed or unpacked.
        GrpcCode::OutOfRange | GrpcCode::ResourceExhausted => Code::BodyTooLarge,
        GrpcCode::Unimplemented => Code::RouteNotFound,
        GrpcCode::Internal | GrpcCode::InvalidArgument => Code::MalformedBody,
        _ => return response,
    };
    to_status(&Refusal::new(code, status.message())).into_http::<Body>()
}

/// The answer to a panic.
pub(super) fn panicked(panic: Box<dyn Any + Send + 'static>) -> Response {
    tracing::error!(panic = words(&*panic), "a call panicked");
    let refusal = Refusal::new(Code::Internal, "the call failed inside the service");
    to_status(&refusal).into_http::<Body>()
}
