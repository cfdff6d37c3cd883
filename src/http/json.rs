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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::contract::probe::{Probe, is_served_during};

    async fn encode(probe: Probe) {
        drop(Json(probe).into_response());
    }

    #[test]
    fn a_long_answer_is_encoded_off_the_threads_of_the_network() {
        assert_eq!(is_served_during(encode), [true, false], "long, short");
    }
}
