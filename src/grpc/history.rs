//! `graphfix.v1.History`.

use tonic::{Request, Response, Status, async_trait};

use crate::contract::{calls, v1};

use super::status::carry;
use super::{Door, v1::history_server::History};

#[async_trait]
impl History for Door {
    async fn fleet(
        &self,
        request: Request<v1::FleetHistoryRequest>,
    ) -> Result<Response<v1::FleetHistoryResponse>, Status> {
        carry(calls::history::fleet(&self.0.caller()?, request.into_inner()).await)
    }

    async fn sessions(
        &self,
        request: Request<v1::ListSessionHistoriesRequest>,
    ) -> Result<Response<v1::ListSessionHistoriesResponse>, Status> {
        carry(calls::history::sessions(&self.0.caller()?, request.into_inner()).await)
    }

    async fn session(
        &self,
        request: Request<v1::SessionHistoryRequest>,
    ) -> Result<Response<v1::SessionHistoryResponse>, Status> {
        carry(calls::history::session(&self.0.caller()?, request.into_inner()).await)
    }
}
