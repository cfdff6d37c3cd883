//! `graphfix.v1.Keys`.

use tonic::{Request, Response, Status, async_trait};

use crate::contract::{calls, v1};

use super::status::carry;
use super::{Door, v1::keys_server::Keys};

#[async_trait]
impl Keys for Door {
    async fn create(
        &self,
        request: Request<v1::CreateKeyRequest>,
    ) -> Result<Response<v1::CreateKeyResponse>, Status> {
        carry(calls::keys::create(&self.0.caller()?, request.into_inner()).await)
    }

    async fn list(
        &self,
        request: Request<v1::ListKeysRequest>,
    ) -> Result<Response<v1::ListKeysResponse>, Status> {
        carry(calls::keys::list(&self.0.caller()?, request.into_inner()).await)
    }

    async fn get(&self, request: Request<v1::GetKeyRequest>) -> Result<Response<v1::Key>, Status> {
        carry(calls::keys::get(&self.0.caller()?, request.into_inner()).await)
    }

    async fn revoke(
        &self,
        request: Request<v1::RevokeKeyRequest>,
    ) -> Result<Response<v1::Key>, Status> {
        carry(calls::keys::revoke(&self.0.caller()?, request.into_inner()).await)
    }
}
