//! `graphfix.v1.Tenants`.

use tonic::{Request, Response, Status, async_trait};

use crate::contract::{calls, v1};

use super::status::carry;
use super::{Door, v1::tenants_server::Tenants};

#[async_trait]
impl Tenants for Door {
    async fn get(
        &self,
        request: Request<v1::GetTenantRequest>,
    ) -> Result<Response<v1::Tenant>, Status> {
        carry(calls::tenants::get(&self.0.caller()?, request.into_inner()).await)
    }

    async fn list(
        &self,
        request: Request<v1::ListTenantsRequest>,
    ) -> Result<Response<v1::ListTenantsResponse>, Status> {
        carry(calls::tenants::list(&self.0.caller()?, request.into_inner()).await)
    }

    async fn set(
        &self,
        request: Request<v1::SetTenantRequest>,
    ) -> Result<Response<v1::Tenant>, Status> {
        carry(calls::tenants::set(&self.0.caller()?, request.into_inner()).await)
    }
}
