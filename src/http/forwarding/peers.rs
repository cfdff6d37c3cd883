//! Connections to the other nodes: HTTP/2, as many as the open requests need.

use std::collections::HashMap;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use axum::body::Body;
use axum::extract::Request;
use axum::http::Response;
use hyper::body::Incoming;
use hyper::client::conn::http2::{Builder, SendRequest};
use hyper_util::rt::{TokioExecutor, TokioIo, TokioTimer};
use tokio::time::timeout;

use crate::contract::Refusal;
use crate::contract::nodes::{Nodes, OtherNode};
use crate::refusal::Code;

/// Most requests of one connection. The other end allows 128.
const REQUESTS: usize = 100;
/// Time to connect.
const CONNECT: Duration = Duration::from_secs(2);
/// A node that does not answer a ping within these times counts as gone.
const PING_INTERVAL: Duration = Duration::from_secs(2);
const PING_TIMEOUT: Duration = Duration::from_secs(3);
/// Flow-control windows (bytes): of a connection, and of a request.
const CONNECTION_WINDOW: u32 = 4 << 20;
const REQUEST_WINDOW: u32 = 256 << 10;

/// Connections to the other nodes. All clones share them.
#[derive(Clone)]
pub(in crate::http) struct Peers(Option<Arc<Connections>>);

struct Connections {
    nodes: Nodes,
    links: Mutex<HashMap<i64, Vec<Link>>>,
}

/// One connection, and the number of its requests.
struct Link {
    sender: SendRequest<Body>,
    open: Arc<AtomicUsize>,
}

/// The place of one request in a connection, until it is dropped.
pub(super) struct Permit(Arc<AtomicUsize>);

impl Drop for Permit {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::AcqRel);
    }
}

impl Peers {
    /// No connections yet.
    pub(in crate::http) fn new(nodes: Option<&Nodes>) -> Self {
        let connections =
            |nodes: &Nodes| Connections { nodes: nodes.clone(), links: Mutex::default() };
        Self(nodes.map(connections).map(Arc::new))
    }

    /// Waits until a node is no longer alive.
    pub(super) fn ended(&self, fence: i64) -> impl Future<Output = ()> + Send + use<> {
        let connections = self.0.clone();
        async move {
            match connections {
                Some(connections) => connections.nodes.cluster.wait_for_end(fence).await,
                None => std::future::pending().await,
            }
        }
    }

    /// Sends a request to a node.
    ///
    /// # Errors
    /// It cannot be reached.
    pub(super) async fn send(
        &self,
        node: &OtherNode,
        request: Request,
    ) -> Result<(Response<Incoming>, Permit), Refusal> {
        let unreachable = |why: String| {
            let message = format!("node {} does not answer: {why}", node.name);
            Refusal::new(Code::NodeUnreachable, message)
        };
        let Some(connections) = &self.0 else {
            return Err(unreachable("there is no cluster".to_owned()));
        };
        let meters = connections.nodes.cluster.meters();
        meters.forwarded.inc();
        let sent = connections.sent(node, request).await;
        sent.map_err(|why| {
            meters.unanswered.inc();
            unreachable(why)
        })
    }
}

impl Connections {
    async fn sent(
        self: &Arc<Self>,
        node: &OtherNode,
        request: Request,
    ) -> Result<(Response<Incoming>, Permit), String> {
        let (mut sender, permit) = match self.free(node.fence) {
            Some(link) => link,
            None => self.connect(node).await?,
        };
        sender.ready().await.map_err(|error| error.to_string())?;
        let ended = self.nodes.cluster.wait_for_end(node.fence);
        tokio::select! {
            response = sender.send_request(request) => {
                Ok((response.map_err(|error| error.to_string())?, permit))
            }
            () = ended => Err("its lease has ended".to_owned()),
        }
    }

    /// A connection with room for one more request.
    fn free(&self, fence: i64) -> Option<(SendRequest<Body>, Permit)> {
        let mut links = self.links.lock().unwrap_or_else(PoisonError::into_inner);
        links.retain(|fence, _| self.nodes.cluster.other(*fence).is_some());
        let links = links.get_mut(&fence)?;
        links.retain(|link| !link.sender.is_closed());
        let link = links.iter().find(|link| link.open.load(Ordering::Acquire) < REQUESTS)?;
        link.open.fetch_add(1, Ordering::AcqRel);
        Some((link.sender.clone(), Permit(link.open.clone())))
    }

    /// Opens another connection.
    async fn connect(
        self: &Arc<Self>,
        node: &OtherNode,
    ) -> Result<(SendRequest<Body>, Permit), String> {
        let (scheme, authority) = node.address.split_once("://").unwrap_or_default();
        let (host, port) = authority.rsplit_once(':').unwrap_or_default();
        let port: u16 = port.parse().map_err(|_| format!("its address is {:?}", node.address))?;
        let name = (scheme == "https").then_some(host);
        let connecting = async {
            let stream = self.nodes.tls.connect((host, port), name).await;
            let stream = stream.map_err(|error| error.to_string())?;
            let mut builder = Builder::new(TokioExecutor::new());
            builder
                .timer(TokioTimer::new())
                .keep_alive_interval(PING_INTERVAL)
                .keep_alive_timeout(PING_TIMEOUT)
                .keep_alive_while_idle(true)
                .initial_connection_window_size(CONNECTION_WINDOW)
                .initial_stream_window_size(REQUEST_WINDOW);
            builder.handshake(TokioIo::new(stream)).await.map_err(|error| error.to_string())
        };
        let opened = timeout(CONNECT, connecting).await;
        let (sender, connection) = opened.map_err(|_| "no connection in time".to_owned())??;
        let (cluster, fence) = (self.nodes.cluster.clone(), node.fence);
        tokio::spawn(async move {
            tokio::select! {
                // Err: its requests have also failed.
                _ = connection => {}
                () = cluster.wait_for_end(fence) => {}
            }
        });
        let open = Arc::new(AtomicUsize::new(1));
        let link = Link { sender: sender.clone(), open: open.clone() };
        let mut links = self.links.lock().unwrap_or_else(PoisonError::into_inner);
        links.entry(fence).or_default().push(link);
        Ok((sender, Permit(open)))
    }
}
