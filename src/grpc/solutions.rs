//! `graphfix.v1.Solutions`.

use tonic::{Request, Response, Status, async_trait};

use crate::contract::{calls, v1};

use super::status::carry;
use super::{Door, v1::solutions_server::Solutions};

#[async_trait]
impl Solutions for Door {
    async fn list(
        &self,
        request: Request<v1::ListSolutionsRequest>,
    ) -> Result<Response<v1::ListSolutionsResponse>, Status> {
        carry(calls::solutions::list(&self.0, request.into_inner()).await)
    }
}
