//! `graphfix.v1.Audit`.

use tonic::{Request, Response, Status, async_trait};

use crate::contract::{calls, v1};

use super::status::carry;
use super::{Door, v1::audit_server::Audit};

#[async_trait]
impl Audit for Door {
    async fn list(
        &self,
        request: Request<v1::ListAuditRequest>,
    ) -> Result<Response<v1::ListAuditResponse>, Status> {
        carry(calls::audit::list(&self.0.caller()?, request.into_inner()).await)
    }
}
