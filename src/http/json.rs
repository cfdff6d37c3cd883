//! Answers that are messages, as JSON.

use axum::response::{IntoResponse, Response};
use prost::Message;
use serde::Serialize;

use crate::contract::off_the_network;

/// A message that is sent as JSON. A long one is encoded off the threads that serve the network.
#[derive(Clone, Debug)]
pub(super) struct Json<T>(pub T);

impl<T: Message + Serialize> IntoResponse for Json<T> {
    fn into_response(self) -> Response {
        off_the_network(self.0.encoded_len(), || axum::Json(self.0).into_response())
    }
}
