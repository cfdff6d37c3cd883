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

    async fn series(
        &self,
        request: Request<v1::SolutionSeriesRequest>,
    ) -> Result<Response<v1::SolutionSeriesResponse>, Status> {
        carry(calls::solutions::series(&self.0, request.into_inner()).await)
    }

    async fn explain(
        &self,
        request: Request<v1::ExplainEpochRequest>,
    ) -> Result<Response<v1::ExplainEpochResponse>, Status> {
        carry(calls::solutions::explain(&self.0, request.into_inner()).await)
    }
}
