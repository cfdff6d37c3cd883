//! The caller of a request, as a parameter of the routes.

use axum::extract::FromRequestParts;
use axum::http::request::Parts;
use axum::response::{IntoResponse, Response};

use crate::contract::{Caller, Service};

use super::problem::Refused;

impl FromRequestParts<Service> for Caller {
    type Rejection = Response;

    async fn from_request_parts(_: &mut Parts, service: &Service) -> Result<Self, Response> {
        service.caller().map_err(|refusal| Refused(refusal).into_response())
    }
}
