//! `graphfix.v1.Positioning`.

use tonic::{Request, Response, Status, async_trait};

use crate::contract::{calls, v1};

use super::status::carry;
use super::{Door, v1::positioning_server::Positioning};

#[async_trait]
impl Positioning for Door {
    async fn push_epochs(
        &self,
        request: Request<v1::PushEpochsRequest>,
    ) -> Result<Response<v1::PushEpochsResponse>, Status> {
        carry(calls::positioning::push_epochs(&self.0, request.into_inner()).await)
    }

    async fn push_raw(
        &self,
        request: Request<v1::PushRawRequest>,
    ) -> Result<Response<v1::PushRawResponse>, Status> {
        carry(calls::raw::push(&self.0, request.into_inner()).await)
    }

    async fn solve(
        &self,
        request: Request<v1::SolveRequest>,
    ) -> Result<Response<v1::SolveResponse>, Status> {
        carry(calls::positioning::solve(&self.0, request.into_inner()).await)
    }

    async fn solve_once(
        &self,
        request: Request<v1::SolveOnceRequest>,
    ) -> Result<Response<v1::SolveOnceResponse>, Status> {
        carry(calls::positioning::solve_once(&self.0, request.into_inner()).await)
    }
}
