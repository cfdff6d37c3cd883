//! `graphfix.v1.Jobs`.

use futures::StreamExt;
use tonic::{Request, Response, Status, Streaming, async_trait};

use crate::contract::v1::create_job_request::Content;
use crate::contract::{calls, v1};

use super::metadata::idempotency_key;
use super::status::{carry, carry_stream};
use super::{Answered, Door, v1::jobs_server::Jobs};

#[async_trait]
impl Jobs for Door {
    async fn create(
        &self,
        request: Request<Streaming<v1::CreateJobRequest>>,
    ) -> Result<Response<v1::Job>, Status> {
        let key = idempotency_key(request.metadata())?.map(Content::IdempotencyKey);
        // Treated as the first message of the stream. A key in the stream belongs to the request.
        let named = key.map(|key| Ok(v1::CreateJobRequest { content: Some(key) }));
        let messages = futures::stream::iter(named).chain(request.into_inner());
        Ok(Response::new(calls::jobs::create(&self.0.caller()?, messages).await?))
    }

    async fn get(&self, request: Request<v1::GetJobRequest>) -> Result<Response<v1::Job>, Status> {
        carry(calls::jobs::get(&self.0.caller()?, request.into_inner()).await)
    }

    async fn list(
        &self,
        request: Request<v1::ListJobsRequest>,
    ) -> Result<Response<v1::ListJobsResponse>, Status> {
        carry(calls::jobs::list(&self.0.caller()?, request.into_inner()).await)
    }

    async fn cancel(
        &self,
        request: Request<v1::CancelJobRequest>,
    ) -> Result<Response<v1::Job>, Status> {
        carry(calls::jobs::cancel(&self.0.caller()?, request.into_inner()).await)
    }

    async fn delete(
        &self,
        request: Request<v1::DeleteJobRequest>,
    ) -> Result<Response<v1::Job>, Status> {
        carry(calls::jobs::delete(&self.0.caller()?, request.into_inner()).await)
    }

    type WatchStream = Answered<v1::Job>;

    async fn watch(
        &self,
        request: Request<v1::GetJobRequest>,
    ) -> Result<Response<Self::WatchStream>, Status> {
        let messages = calls::job_watch::watch(&self.0.caller()?, request.into_inner()).await?;
        Ok(Response::new(Box::pin(carry_stream(messages))))
    }

    type ResultStream = Answered<v1::JobResultResponse>;

    async fn result(
        &self,
        request: Request<v1::GetJobRequest>,
    ) -> Result<Response<Self::ResultStream>, Status> {
        let result = calls::jobs::result(&self.0.caller()?, request.into_inner()).await?;
        let answered = |content| v1::JobResultResponse { content };
        let messages = result.content().map(move |content| content.map(answered));
        Ok(Response::new(Box::pin(carry_stream(messages))))
    }

    async fn report(
        &self,
        request: Request<v1::GetJobRequest>,
    ) -> Result<Response<v1::JobReport>, Status> {
        carry(calls::jobs::report(&self.0.caller()?, request.into_inner()).await)
    }

    async fn deliveries(
        &self,
        request: Request<v1::GetJobRequest>,
    ) -> Result<Response<v1::JobDeliveries>, Status> {
        carry(calls::job_deliveries::list(&self.0.caller()?, request.into_inner()).await)
    }
}
