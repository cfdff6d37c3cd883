//! Refusals as `google.rpc.Status` with `ErrorInfo`, `BadRequest` and `RetryInfo`.

use std::collections::HashMap;

use futures::{Stream, StreamExt};
use prost::Message;
use tonic::{Code as GrpcCode, Response, Status};
use tonic_types::{ErrorDetails, StatusExt};

use crate::contract::{Lease, Refusal, log_failure};
use crate::refusal::{Class, Code};

/// Length from which answers are compressed (bytes). For shorter ones it is not worth the time.
const COMPRESSED_FROM_BYTES: usize = 1 << 10;
/// Domain of the codes in `ErrorInfo`.
const DOMAIN: &str = "graphfix";

/// The gRPC status of a class.
pub const fn grpc_code(class: Class) -> GrpcCode {
    match class {
        // Clients retry `ResourceExhausted`, but a request that is too large stays too large.
        Class::Malformed | Class::MediaType | Class::TooLarge => GrpcCode::InvalidArgument,
        Class::Exhausted => GrpcCode::ResourceExhausted,
        Class::NotFound => GrpcCode::NotFound,
        Class::Route | Class::Method => GrpcCode::Unimplemented,
        Class::Conflict => GrpcCode::AlreadyExists,
        Class::Changed => GrpcCode::Aborted,
        Class::Precondition => GrpcCode::FailedPrecondition,
        Class::Unavailable => GrpcCode::Unavailable,
        Class::Unauthenticated => GrpcCode::Unauthenticated,
        Class::Forbidden => GrpcCode::PermissionDenied,
        Class::Timeout => GrpcCode::DeadlineExceeded,
        Class::Internal | Class::NoCall => GrpcCode::Internal,
    }
}

impl From<Refusal> for Status {
    fn from(refusal: Refusal) -> Self {
        to_status(&refusal)
    }
}

/// A refusal in the form of gRPC. Failures of the service are logged here, once. A service that is
/// stopping has not failed.
pub(crate) fn to_status(refusal: &Refusal) -> Status {
    let is_failure = matches!(refusal.code.class(), Class::Internal | Class::Unavailable);
    if is_failure && refusal.code != Code::Draining {
        log_failure(refusal, "");
    }
    status_of(refusal)
}

/// Like [`to_status`], without a line in the log.
pub(super) fn status_of(refusal: &Refusal) -> Status {
    let mut metadata = HashMap::from([
        ("remedy".to_owned(), refusal.code.remedy().to_owned()),
        ("link".to_owned(), refusal.code.link()),
    ]);
    let at_fault = [
        ("field", refusal.field.clone()),
        ("line", refusal.line.map(|line| line.to_string())),
        ("byteOffset", refusal.byte_offset.map(|offset| offset.to_string())),
    ];
    metadata.extend(at_fault.into_iter().filter_map(|(key, value)| Some((key.to_owned(), value?))));
    let mut details = ErrorDetails::new();
    details.set_error_info(refusal.code.name(), DOMAIN, metadata);
    if let Some(field) = &refusal.field {
        details.add_bad_request_violation(field, &refusal.message);
    }
    if refusal.retry_after.is_some() {
        details.set_retry_info(refusal.retry_after);
    }
    Status::with_error_details(grpc_code(refusal.code.class()), &refusal.message, details)
}

/// The outcome of a call in the form of tonic. Short answers are not compressed.
pub(super) fn carry<T: Message>(outcome: Result<T, Refusal>) -> Result<Response<T>, Status> {
    let answer = |message: T| {
        let is_short = message.encoded_len() < COMPRESSED_FROM_BYTES;
        let mut response = Response::new(message);
        if is_short {
            response.disable_compression();
        }
        response
    };
    outcome.map(answer).map_err(|refusal| to_status(&refusal))
}

/// The messages of a stream in the form of tonic. The log of a failure names the request.
pub(super) fn carry_stream<T>(
    messages: impl Stream<Item = Result<T, Refusal>>,
) -> impl Stream<Item = Result<T, Status>> {
    let lease = Lease::current();
    let status = move |refusal| match &lease {
        Some(lease) => lease.during(|| to_status(&refusal)),
        None => to_status(&refusal),
    };
    messages.map(move |message| message.map_err(&status))
}

/// For clients: the stable code of a status from this service.
pub fn code_of(status: &Status) -> Option<String> {
    status.get_details_error_info().map(|info| info.reason)
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    #[test]
    fn a_refusal_keeps_its_values() {
        let refusal = Refusal::new(Code::MailboxFull, "64 pushes wait")
            .at("epochs")
            .retry_after(Some(Duration::from_millis(250)));
        let status = to_status(&refusal);
        assert_eq!(status.code(), GrpcCode::ResourceExhausted);
        let details = status.get_error_details();
        assert_eq!(details.error_info().unwrap().reason, "MAILBOX_FULL");
        assert_eq!(details.error_info().unwrap().metadata["field"], "epochs");
        assert_eq!(details.error_info().unwrap().metadata["link"], "/docs/errors#MAILBOX_FULL");
        assert_eq!(details.retry_info().unwrap().retry_delay, Some(Duration::from_millis(250)));
        assert_eq!(details.bad_request().unwrap().field_violations[0].field, "epochs");
    }
}
