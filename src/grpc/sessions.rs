//! `graphfix.v1.Sessions`.

use futures::StreamExt;
use tonic::{Request, Response, Status, async_trait};

use crate::contract::{calls, v1};

use super::metadata::request_id;
use super::status::{carry, carry_stream};
use super::{Answered, Door, v1::sessions_server::Sessions};

#[async_trait]
impl Sessions for Door {
    async fn create(
        &self,
        request: Request<v1::CreateSessionRequest>,
    ) -> Result<Response<v1::Session>, Status> {
        let (metadata, _, mut request) = request.into_parts();
        request.request_id = request_id(&metadata, request.request_id)?;
        let created = calls::sessions::create(&self.0.caller()?, request).await;
        carry(created.map(|(session, _)| session))
    }

    async fn get(
        &self,
        request: Request<v1::GetSessionRequest>,
    ) -> Result<Response<v1::Session>, Status> {
        carry(calls::sessions::get(&self.0.caller()?, request.into_inner()).await)
    }

    async fn list(
        &self,
        request: Request<v1::ListSessionsRequest>,
    ) -> Result<Response<v1::ListSessionsResponse>, Status> {
        carry(calls::sessions::list(&self.0.caller()?, request.into_inner()).await)
    }

    async fn heads(
        &self,
        request: Request<v1::ListHeadsRequest>,
    ) -> Result<Response<v1::ListHeadsResponse>, Status> {
        carry(calls::sessions::heads(&self.0.caller()?, request.into_inner()).await)
    }

    type WatchHeadsStream = Answered<v1::WatchHeadsResponse>;

    async fn watch_heads(
        &self,
        request: Request<v1::WatchHeadsRequest>,
    ) -> Result<Response<Self::WatchHeadsStream>, Status> {
        let messages = calls::head_watch::watch(&self.0.caller()?, request.into_inner()).await?;
        Ok(Response::new(Box::pin(carry_stream(messages))))
    }

    async fn update(
        &self,
        request: Request<v1::UpdateSessionRequest>,
    ) -> Result<Response<v1::Session>, Status> {
        carry(calls::sessions::update(&self.0.caller()?, request.into_inner()).await)
    }

    async fn reset(
        &self,
        request: Request<v1::ResetSessionRequest>,
    ) -> Result<Response<v1::Session>, Status> {
        carry(calls::sessions::reset(&self.0.caller()?, request.into_inner()).await)
    }

    async fn close(
        &self,
        request: Request<v1::CloseSessionRequest>,
    ) -> Result<Response<v1::Session>, Status> {
        carry(calls::sessions::close(&self.0.caller()?, request.into_inner()).await)
    }

    async fn delete(
        &self,
        request: Request<v1::DeleteSessionRequest>,
    ) -> Result<Response<v1::Session>, Status> {
        carry(calls::sessions::delete(&self.0.caller()?, request.into_inner()).await)
    }

    type ObservationsStream = Answered<v1::SessionObservationsResponse>;

    async fn observations(
        &self,
        request: Request<v1::SessionObservationsRequest>,
    ) -> Result<Response<Self::ObservationsStream>, Status> {
        let file =
            calls::observations::observations(&self.0.caller()?, request.into_inner()).await?;
        let answered = |content| v1::SessionObservationsResponse { content };
        let messages = file.map(move |content| content.map(answered));
        Ok(Response::new(Box::pin(carry_stream(messages))))
    }
}
