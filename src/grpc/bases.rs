//! `graphfix.v1.Bases`.

use tonic::{Request, Response, Status, async_trait};

use crate::contract::{calls, v1};

use super::metadata::request_id;
use super::status::carry;
use super::{Door, v1::bases_server::Bases};

#[async_trait]
impl Bases for Door {
    async fn create(
        &self,
        request: Request<v1::CreateBaseRequest>,
    ) -> Result<Response<v1::Base>, Status> {
        let (metadata, _, mut request) = request.into_parts();
        request.request_id = request_id(&metadata, request.request_id)?;
        let created = calls::bases::create(&self.0.caller()?, request).await;
        carry(created.map(|(base, _)| base))
    }

    async fn get(
        &self,
        request: Request<v1::GetBaseRequest>,
    ) -> Result<Response<v1::Base>, Status> {
        carry(calls::bases::get(&self.0.caller()?, request.into_inner()).await)
    }

    async fn list(
        &self,
        request: Request<v1::ListBasesRequest>,
    ) -> Result<Response<v1::ListBasesResponse>, Status> {
        carry(calls::bases::list(&self.0.caller()?, request.into_inner()).await)
    }

    async fn delete(
        &self,
        request: Request<v1::DeleteBaseRequest>,
    ) -> Result<Response<v1::DeleteBaseResponse>, Status> {
        carry(calls::bases::delete(&self.0.caller()?, request.into_inner()).await)
    }

    async fn push_epochs(
        &self,
        request: Request<v1::PushBaseEpochsRequest>,
    ) -> Result<Response<v1::PushBaseEpochsResponse>, Status> {
        carry(calls::bases::push_epochs(&self.0.caller()?, request.into_inner()).await)
    }

    async fn upload(
        &self,
        request: Request<v1::UploadBaseRequest>,
    ) -> Result<Response<v1::UploadBaseResponse>, Status> {
        carry(calls::bases::upload(&self.0.caller()?, request.into_inner()).await)
    }
}
