//! The body of an answer that another node sends. If it breaks, a gRPC call ends with a status that
//! makes clients try again.

use std::pin::Pin;
use std::task::{Context, Poll};

use axum::BoxError;
use axum::body::{Body, Bytes, HttpBody};
use hyper::body::{Frame, Incoming, SizeHint};

use crate::contract::Refusal;
use crate::grpc;
use crate::refusal::Code;

use super::peers::Permit;

type Ending = Pin<Box<dyn Future<Output = Refusal> + Send>>;

/// The body of an answer of another node.
pub(super) struct Forwarded {
    body: Incoming,
    /// The cause that ends the answer before its body ends.
    ending: Ending,
    is_grpc: bool,
    is_over: bool,
    _permit: Permit,
}

impl Forwarded {
    /// The body of an answer. It ends early when the other node ends (`ended`), or when this node
    /// stops (`stopping`).
    pub(super) fn new(
        body: Incoming,
        permit: Permit,
        is_grpc: bool,
        (ended, stopping): (
            impl Future<Output = ()> + Send + 'static,
            impl Future<Output = ()> + Send + 'static,
        ),
    ) -> Self {
        let ending = Box::pin(async move {
            tokio::select! {
                () = ended => {
                    Refusal::new(Code::NodeUnreachable, "the node of the session has ended")
                }
                () = stopping, if is_grpc => {
                    Refusal::new(Code::Draining, "the service is shutting down")
                }
            }
        });
        Self { body, ending, is_grpc, is_over: false, _permit: permit }
    }

    /// Ends the answer with a refusal.
    fn end(&mut self, refusal: &Refusal) -> Option<Result<Frame<Bytes>, BoxError>> {
        self.is_over = true;
        if !self.is_grpc {
            return Some(Err(refusal.clone().into()));
        }
        let trailers = grpc::to_status(refusal).into_http::<Body>().into_parts().0.headers;
        Some(Ok(Frame::trailers(trailers)))
    }
}

impl HttpBody for Forwarded {
    type Data = Bytes;
    type Error = BoxError;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, BoxError>>> {
        let this = &mut *self;
        if this.is_over {
            return Poll::Ready(None);
        }
        match Pin::new(&mut this.body).poll_frame(context) {
            Poll::Ready(Some(Ok(frame))) => return Poll::Ready(Some(Ok(frame))),
            Poll::Ready(Some(Err(error))) => {
                let message = format!("the node of the session has ended: {error}");
                return Poll::Ready(this.end(&Refusal::new(Code::NodeUnreachable, message)));
            }
            Poll::Ready(None) => return Poll::Ready(None),
            Poll::Pending => {}
        }
        match this.ending.as_mut().poll(context) {
            Poll::Ready(refusal) => Poll::Ready(this.end(&refusal)),
            Poll::Pending => Poll::Pending,
        }
    }

    fn is_end_stream(&self) -> bool {
        self.is_over || self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}
