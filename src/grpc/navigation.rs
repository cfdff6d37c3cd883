//! `graphfix.v1.Navigation`.

use tonic::{Request, Response, Status, async_trait};

use crate::contract::{calls, v1};

use super::status::carry;
use super::{Door, v1::navigation_server::Navigation};

#[async_trait]
impl Navigation for Door {
    async fn push(
        &self,
        request: Request<v1::PushNavigationRequest>,
    ) -> Result<Response<v1::PushNavigationResponse>, Status> {
        carry(calls::navigation::push(&self.0.caller()?, request.into_inner()).await)
    }

    async fn status(
        &self,
        _: Request<v1::NavigationStatusRequest>,
    ) -> Result<Response<v1::NavigationStatusResponse>, Status> {
        carry(Ok(calls::navigation::status(&self.0.caller()?)))
    }
}
