//! `google.longrunning.Operations`: batch jobs with a standard interface.

use std::time::Duration;

use prost::Message;
use prost_types::Any;
use tonic::{Code as GrpcCode, Request, Response, Status, async_trait};

use crate::contract::calls::operations::{self, Operation};
use crate::contract::{Refusal, v1};
use crate::refusal::{Class, Code};

use super::Door;
use super::longrunning::operation::Result as Outcome;
use super::longrunning::operations_server::Operations;
use super::longrunning::{self as messages, Operation as OperationMessage};
use super::status::{carry, grpc_code, status_of};

#[async_trait]
impl Operations for Door {
    async fn list_operations(
        &self,
        request: Request<messages::ListOperationsRequest>,
    ) -> Result<Response<messages::ListOperationsResponse>, Status> {
        let messages::ListOperationsRequest { name, filter, page_size, page_token } =
            request.into_inner();
        if !name.is_empty() {
            let message = "jobs have one collection, whose name is empty";
            return Err(Refusal::new(Code::InvalidField, message).at("name").into());
        }
        let page = operations::list(&self.0.caller()?, &filter, page_size, page_token).await;
        carry(page.map(|(operations, next_page_token)| messages::ListOperationsResponse {
            operations: operations.into_iter().map(message).collect(),
            next_page_token,
        }))
    }

    async fn get_operation(
        &self,
        request: Request<messages::GetOperationRequest>,
    ) -> Result<Response<OperationMessage>, Status> {
        let name = request.into_inner().name;
        carry(operations::get(&self.0.caller()?, &name).await.map(message))
    }

    async fn delete_operation(
        &self,
        request: Request<messages::DeleteOperationRequest>,
    ) -> Result<Response<()>, Status> {
        let name = request.into_inner().name;
        carry(operations::delete(&self.0.caller()?, &name).await)
    }

    async fn cancel_operation(
        &self,
        request: Request<messages::CancelOperationRequest>,
    ) -> Result<Response<()>, Status> {
        let name = request.into_inner().name;
        carry(operations::cancel(&self.0.caller()?, &name).await)
    }

    async fn wait_operation(
        &self,
        request: Request<messages::WaitOperationRequest>,
    ) -> Result<Response<OperationMessage>, Status> {
        let messages::WaitOperationRequest { name, timeout } = request.into_inner();
        // Err: it is negative.
        let timeout = timeout.map(|timeout| Duration::try_from(timeout).unwrap_or_default());
        carry(operations::wait(&self.0.caller()?, &name, timeout).await.map(message))
    }
}

/// A job as an operation.
fn message(operation: Operation) -> OperationMessage {
    let Operation { job, is_done, report } = operation;
    let outcome = match report {
        _ if !is_done => None,
        Some(report) => Some(Outcome::Response(any("JobReport", &report))),
        None => Some(Outcome::Error(error(&job))),
    };
    OperationMessage {
        name: job.job.clone(),
        metadata: Some(any("Job", &job)),
        done: is_done,
        result: outcome,
    }
}

/// A message of this service, with its type.
fn any(name: &str, message: &impl Message) -> Any {
    let type_url = format!("type.googleapis.com/graphfix.v1.{name}");
    Any { type_url, value: message.encode_to_vec() }
}

/// Why a job has no report.
fn error(job: &v1::Job) -> tonic_types::Status {
    let plain = |code: GrpcCode, message: &str| tonic_types::Status {
        code: code as i32,
        message: message.to_owned(),
        details: Vec::new(),
    };
    let Some(failure) = &job.failure else {
        return plain(GrpcCode::Cancelled, "the job was cancelled");
    };
    // A code of an earlier version may no longer exist.
    let Some(code) = Code::ALL.iter().find(|code| code.name() == failure.code) else {
        return plain(GrpcCode::Unknown, &format!("{}: {}", failure.code, failure.message));
    };
    let mut refusal = Refusal::new(*code, &*failure.message);
    if !failure.field.is_empty() {
        refusal = refusal.at(&*failure.field);
    }
    // The call itself has not failed: there is nothing to retry, and nothing to log.
    refusal.retry_after = None;
    let status = tonic_types::Status::decode(status_of(&refusal).details()).unwrap_or_default();
    let code = match code.class() {
        Class::NoCall => GrpcCode::FailedPrecondition,
        class => grpc_code(class),
    };
    tonic_types::Status { code: code as i32, ..status }
}

#[cfg(test)]
mod tests {
    use tonic_types::StatusExt;

    use super::*;

    fn ended(failure: Option<(&str, &str)>) -> tonic_types::Status {
        let failure = failure.map(|(code, field)| v1::Refusal {
            code: code.to_owned(),
            message: "why".to_owned(),
            field: field.to_owned(),
            ..Default::default()
        });
        let job = v1::Job { job: "job_1".to_owned(), failure, ..Default::default() };
        let operation = Operation { job, is_done: true, report: None };
        match message(operation).result {
            Some(Outcome::Error(error)) => error,
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn a_failure_is_a_status_with_its_code() {
        for (code, expected) in [
            ("MALFORMED_BODY", GrpcCode::InvalidArgument),
            ("JOB_TOO_LONG", GrpcCode::FailedPrecondition),
            ("OF_ANOTHER_VERSION", GrpcCode::Unknown),
        ] {
            assert_eq!(ended(Some((code, "rover"))).code, expected as i32, "{code}");
        }
        let error = ended(Some(("MALFORMED_BODY", "rover")));
        let details = Status::with_details(
            GrpcCode::from_i32(error.code),
            error.message.clone(),
            error.encode_to_vec().into(),
        );
        let info = details.get_details_error_info().unwrap();
        assert_eq!((&*info.reason, &*info.metadata["field"]), ("MALFORMED_BODY", "rover"));
        assert_eq!(ended(None).code, GrpcCode::Cancelled as i32);
    }

    #[test]
    fn a_job_that_runs_has_no_outcome() {
        let job = v1::Job { job: "job_1".to_owned(), ..Default::default() };
        let running = message(Operation { job, is_done: false, report: None });
        assert_eq!((&*running.name, running.done, running.result), ("job_1", false, None));
        let metadata = running.metadata.unwrap();
        assert_eq!(metadata.type_url, "type.googleapis.com/graphfix.v1.Job");
        assert_eq!(v1::Job::decode(&*metadata.value).unwrap().job, "job_1");
    }
}
