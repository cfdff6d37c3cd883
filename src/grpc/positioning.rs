//! `graphfix.v1.Positioning`.

use tonic::{Request, Response, Status, Streaming, async_trait};

use crate::contract::{calls, v1};

use super::status::carry;
use super::{Answered, Door, v1::positioning_server::Positioning};

#[async_trait]
impl Positioning for Door {
    async fn push_epochs(
        &self,
        request: Request<v1::PushEpochsRequest>,
    ) -> Result<Response<v1::PushEpochsResponse>, Status> {
        carry(calls::positioning::push_epochs(&self.0.caller()?, request.into_inner()).await)
    }

    async fn push_raw(
        &self,
        request: Request<v1::PushRawRequest>,
    ) -> Result<Response<v1::PushRawResponse>, Status> {
        carry(calls::raw::push(&self.0.caller()?, request.into_inner()).await)
    }

    type StreamStream = Answered<v1::StreamResponse>;

    async fn stream(
        &self,
        request: Request<Streaming<v1::StreamRequest>>,
    ) -> Result<Response<Self::StreamStream>, Status> {
        let answers = calls::stream::epochs(&self.0.caller()?, request.into_inner());
        Ok(Response::new(Box::pin(answers)))
    }

    type StreamRawStream = Answered<v1::StreamRawResponse>;

    async fn stream_raw(
        &self,
        request: Request<Streaming<v1::StreamRawRequest>>,
    ) -> Result<Response<Self::StreamRawStream>, Status> {
        let answers = calls::stream::raw(&self.0.caller()?, request.into_inner());
        Ok(Response::new(Box::pin(answers)))
    }

    async fn solve(
        &self,
        request: Request<v1::SolveRequest>,
    ) -> Result<Response<v1::SolveResponse>, Status> {
        carry(calls::positioning::solve(&self.0.caller()?, request.into_inner()).await)
    }

    async fn solve_once(
        &self,
        request: Request<v1::SolveOnceRequest>,
    ) -> Result<Response<v1::SolveOnceResponse>, Status> {
        carry(calls::positioning::solve_once(&self.0.caller()?, request.into_inner()).await)
    }
}
