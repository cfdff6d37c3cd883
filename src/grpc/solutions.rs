//! `graphfix.v1.Solutions`.

use futures::StreamExt;
use tonic::{Request, Response, Status, async_trait};

use crate::contract::{calls, v1};

use super::status::{carry, carry_stream};
use super::{Answered, Door, v1::solutions_server::Solutions};

#[async_trait]
impl Solutions for Door {
    async fn list(
        &self,
        request: Request<v1::ListSolutionsRequest>,
    ) -> Result<Response<v1::ListSolutionsResponse>, Status> {
        carry(calls::solutions::list(&self.0.caller()?, request.into_inner()).await)
    }

    type WatchStream = Answered<v1::WatchSolutionsResponse>;

    async fn watch(
        &self,
        request: Request<v1::WatchSolutionsRequest>,
    ) -> Result<Response<Self::WatchStream>, Status> {
        let messages = calls::watch::watch(&self.0.caller()?, request.into_inner()).await?;
        Ok(Response::new(Box::pin(carry_stream(messages))))
    }

    type TrackStream = Answered<v1::TrackResponse>;

    async fn track(
        &self,
        request: Request<v1::TrackRequest>,
    ) -> Result<Response<Self::TrackStream>, Status> {
        let track = calls::track::track(&self.0.caller()?, request.into_inner()).await?;
        let answered = |content| v1::TrackResponse { content };
        let messages = track.map(move |content| content.map(answered));
        Ok(Response::new(Box::pin(carry_stream(messages))))
    }

    async fn series(
        &self,
        request: Request<v1::SolutionSeriesRequest>,
    ) -> Result<Response<v1::SolutionSeriesResponse>, Status> {
        carry(calls::solutions::series(&self.0.caller()?, request.into_inner()).await)
    }

    async fn residuals(
        &self,
        request: Request<v1::ResidualsRequest>,
    ) -> Result<Response<v1::ResidualsResponse>, Status> {
        carry(calls::solutions::residuals(&self.0.caller()?, request.into_inner()).await)
    }

    async fn explain(
        &self,
        request: Request<v1::ExplainEpochRequest>,
    ) -> Result<Response<v1::ExplainEpochResponse>, Status> {
        carry(calls::solutions::explain(&self.0.caller()?, request.into_inner()).await)
    }
}
