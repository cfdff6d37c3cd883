//! A client as a device uses it: pushes to one session in order, and connects again if the
//! connection is lost.

use std::path::Path;
use std::time::{Duration, Instant};

use bytes::Bytes;
use tonic::transport::{Channel, Endpoint};
use tonic::{Code as GrpcCode, Status};
use tonic_types::StatusExt;

use crate::contract::v1;
use crate::grpc::v1::bases_client::BasesClient;
use crate::grpc::v1::positioning_client::PositioningClient;
use crate::grpc::v1::sessions_client::SessionsClient;
use crate::grpc::{self, v1::navigation_client::NavigationClient};
use crate::refusal::Code;

use super::Failure;

const FIRST_DELAY: Duration = Duration::from_millis(100);
const LONGEST_DELAY: Duration = Duration::from_secs(5);

/// A connection to a service.
#[derive(Clone)]
pub(super) struct Connection {
    channel: Channel,
    /// Duration of the attempts to reach a service that does not answer.
    patience: Duration,
}

/// One session of a device. A push is sent after the answer to the previous one.
pub(super) struct Device {
    connection: Connection,
    positioning: PositioningClient<Channel>,
    session: v1::Session,
}

/// The result of a push.
#[derive(Debug, Default)]
pub(super) struct Pushed {
    /// Solutions of epochs acknowledged in this answer.
    pub(super) solutions: Vec<v1::Solution>,
    /// Refusals of single epochs.
    pub(super) refusals: Vec<(u64, String)>,
    /// Epochs found committed after a connection was lost before their answer.
    pub(super) recovered: usize,
    /// Number of further attempts.
    pub(super) retries: usize,
    /// Number of the last committed epoch: the device may delete epochs up to it.
    pub(super) durable_through: Option<u64>,
}

impl Connection {
    /// A connection to the service at `server`, such as `http://127.0.0.1:8080`; it connects when
    /// it is first used.
    ///
    /// # Errors
    /// `server` is not an address.
    pub(super) fn to(server: &str, patience: Duration) -> Result<Self, Failure> {
        let endpoint = Endpoint::from_shared(server.to_owned()).map_err(|error| {
            let message = format!("--server {server:?}: {error}");
            Failure::new(Code::Usage, message, "write an address such as http://127.0.0.1:8080")
        })?;
        let endpoint = endpoint
            .connect_timeout(Duration::from_secs(5))
            .timeout(Duration::from_secs(60))
            .initial_stream_window_size(4 << 20)
            .initial_connection_window_size(8 << 20)
            .tcp_nodelay(true);
        Ok(Self { channel: endpoint.connect_lazy(), patience })
    }

    /// Pushes a navigation file; returns the number of new ephemerides.
    ///
    /// # Errors
    /// The file cannot be read, or the service refuses it.
    pub(super) async fn push_navigation(&self, path: &Path) -> Result<u64, Failure> {
        let content = std::fs::read(path).map_err(|error| {
            let message = format!("{}: {error}", path.display());
            Failure::of(Code::FileNotReadable, message)
        })?;
        self.push_navigation_bytes(content.into()).await
    }

    /// Pushes navigation data as RINEX; returns the number of new ephemerides.
    ///
    /// # Errors
    /// The service refuses the content.
    pub(super) async fn push_navigation_bytes(&self, content: Bytes) -> Result<u64, Failure> {
        let mut client = NavigationClient::new(self.channel.clone());
        let mut retry = Retry::new(self.patience);
        loop {
            let request = v1::PushNavigationRequest { content: content.clone() };
            match client.push(request).await {
                Ok(answer) => return Ok(answer.into_inner().new_ephemerides),
                Err(status) => retry.wait(&status).await?,
            }
        }
    }

    /// Creates a base; returns its id.
    ///
    /// # Errors
    /// The service refuses it.
    pub(super) async fn create_base(
        &self,
        request: v1::CreateBaseRequest,
    ) -> Result<String, Failure> {
        let mut client = BasesClient::new(self.channel.clone());
        let mut retry = Retry::new(self.patience);
        loop {
            match client.create(request.clone()).await {
                Ok(answer) => return Ok(answer.into_inner().base),
                Err(status) => retry.wait(&status).await?,
            }
        }
    }

    /// Pushes an epoch of a base.
    ///
    /// # Errors
    /// The service refuses it.
    pub(super) async fn push_base(&self, base: &str, epoch: v1::Epoch) -> Result<(), Failure> {
        let mut client = BasesClient::new(self.channel.clone());
        let mut retry = Retry::new(self.patience);
        let request = v1::PushBaseEpochsRequest { base: base.to_owned(), epochs: vec![epoch] };
        loop {
            match client.push_epochs(request.clone()).await {
                Ok(_) => return Ok(()),
                Err(status) => retry.wait(&status).await?,
            }
        }
    }

    /// Opens a new session, or continues the one named.
    ///
    /// # Errors
    /// The configuration is refused, or the session does not exist.
    pub(super) async fn open(
        &self,
        existing: Option<&str>,
        new: v1::CreateSessionRequest,
    ) -> Result<Device, Failure> {
        let mut client = SessionsClient::new(self.channel.clone());
        let mut retry = Retry::new(self.patience);
        loop {
            let answer = match existing {
                Some(id) => client.get(v1::GetSessionRequest { session: id.to_owned() }).await,
                None => client.create(new.clone()).await,
            };
            match answer {
                Ok(answer) => {
                    let positioning = PositioningClient::new(self.channel.clone())
                        .max_decoding_message_size(usize::MAX);
                    let session = answer.into_inner();
                    return Ok(Device { connection: self.clone(), positioning, session });
                }
                Err(status) => retry.wait(&status).await?,
            }
        }
    }
}

impl Device {
    /// The session.
    pub(super) const fn session(&self) -> &v1::Session {
        &self.session
    }

    /// Pushes epochs and waits until they are committed. After a lost connection it connects again
    /// and sends the epochs that the service has not committed.
    ///
    /// # Errors
    /// The whole push is refused, or the service does not answer again.
    pub(super) async fn push(&mut self, mut epochs: Vec<v1::Epoch>) -> Result<Pushed, Failure> {
        let mut pushed = Pushed::default();
        let mut retry = Retry::new(self.connection.patience);
        while !epochs.is_empty() {
            let session = self.session.session.clone();
            let request = v1::PushEpochsRequest { session, epochs: epochs.clone() };
            match self.positioning.push_epochs(request).await {
                Ok(answer) => {
                    pushed.take(answer.into_inner());
                    break;
                }
                Err(status) if refuses_epochs(&status) => {
                    let words = status.message().to_owned();
                    pushed.refusals.extend(epochs.drain(..).map(|e| (e.seq, words.clone())));
                }
                Err(status) => {
                    retry.wait(&status).await?;
                    pushed.retries += 1;
                    let durable = self.durable_through(&mut retry).await?;
                    let before = epochs.len();
                    epochs.retain(|epoch| durable.is_none_or(|durable| durable < epoch.seq));
                    pushed.recovered += before - epochs.len();
                    pushed.durable_through = durable;
                }
            }
        }
        Ok(pushed)
    }

    /// Pushes bytes of a receiver and waits until they are stored. Bytes that are sent again after
    /// a lost connection change nothing.
    ///
    /// # Errors
    /// The bytes are refused, or the service does not answer again.
    pub(super) async fn push_raw(&mut self, chunk: v1::PushRawRequest) -> Result<Pushed, Failure> {
        let mut pushed = Pushed::default();
        let mut retry = Retry::new(self.connection.patience);
        loop {
            match self.positioning.push_raw(chunk.clone()).await {
                Ok(answer) => {
                    let v1::PushRawResponse { results, durable_through, .. } = answer.into_inner();
                    pushed.take(v1::PushEpochsResponse { results, durable_through });
                    return Ok(pushed);
                }
                Err(status) => {
                    retry.wait(&status).await?;
                    pushed.retries += 1;
                }
            }
        }
    }

    /// The session as committed, once the service answers again.
    async fn durable_through(&self, retry: &mut Retry) -> Result<Option<u64>, Failure> {
        let mut client = SessionsClient::new(self.connection.channel.clone());
        loop {
            let session = self.session.session.clone();
            match client.get(v1::GetSessionRequest { session }).await {
                Ok(answer) => return Ok(answer.into_inner().durable_through),
                Err(status) => retry.wait(&status).await?,
            }
        }
    }
}

impl Pushed {
    fn take(&mut self, answer: v1::PushEpochsResponse) {
        self.durable_through = answer.durable_through;
        for result in answer.results {
            match (result.solution, result.refusal) {
                (Some(solution), _) => self.solutions.push(solution),
                (None, Some(refusal)) => {
                    self.refusals
                        .push((result.seq, format!("{}: {}", refusal.code, refusal.message)));
                }
                (None, None) => self.refusals.push((result.seq, "no answer".to_owned())),
            }
        }
    }
}

/// Whether the session refused every epoch of a push; the device then skips them.
fn refuses_epochs(status: &Status) -> bool {
    let all = [
        Code::SequenceConflict,
        Code::SequenceSuperseded,
        Code::AlreadyAcknowledged,
        Code::OutOfOrder,
    ];
    grpc::code_of(status).is_some_and(|name| all.iter().any(|code| code.name() == name))
}

/// Exponential backoff within a device's patience; a delay in the answer takes precedence.
struct Retry {
    patience: Duration,
    since: Option<Instant>,
    delay: Duration,
}

impl Retry {
    const fn new(patience: Duration) -> Self {
        Self { patience, since: None, delay: FIRST_DELAY }
    }

    /// Waits before the next attempt.
    ///
    /// # Errors
    /// The refusal itself, if waiting does not help or the patience has ended.
    async fn wait(&mut self, status: &Status) -> Result<(), Failure> {
        let asked = status.get_details_retry_info().and_then(|info| info.retry_delay);
        let passing = matches!(
            status.code(),
            GrpcCode::Unavailable
                | GrpcCode::Unknown
                | GrpcCode::Cancelled
                | GrpcCode::DeadlineExceeded
        );
        // A refusal without a delay, such as an exceeded limit, is permanent.
        let since = *self.since.get_or_insert_with(Instant::now);
        if asked.is_none() && (!passing || self.patience < since.elapsed()) {
            return Err(failure(status));
        }
        tokio::time::sleep(asked.unwrap_or(self.delay)).await;
        self.delay = (self.delay * 2).min(LONGEST_DELAY);
        Ok(())
    }
}

/// The service's refusal with its code and remedy.
fn failure(status: &Status) -> Failure {
    let Some(name) = grpc::code_of(status) else {
        return Failure::of(Code::ServiceUnreachable, status.message());
    };
    let remedy = status
        .get_details_error_info()
        .and_then(|info| info.metadata.get("remedy").cloned())
        .unwrap_or_else(|| Code::ServiceRefused.remedy().to_owned());
    match Code::ALL.iter().find(|code| code.name() == name) {
        Some(code) => Failure::new(*code, status.message(), remedy),
        None => {
            let message = format!("{name}: {}", status.message());
            Failure::new(Code::ServiceRefused, message, remedy)
        }
    }
}

#[cfg(test)]
mod tests {
    use std::collections::HashMap;

    use tonic_types::ErrorDetails;

    use super::*;

    #[test]
    fn a_refusal_keeps_the_services_code_and_remedy() {
        let refused = |reason: &str| {
            let metadata = HashMap::from([("remedy".to_owned(), "wait".to_owned())]);
            let details = ErrorDetails::with_error_info(reason, "graphfix", metadata);
            failure(&Status::with_error_details(GrpcCode::NotFound, "no such", details))
        };
        assert_eq!(
            refused("SESSION_NOT_FOUND"),
            Failure::new(Code::SessionNotFound, "no such", "wait")
        );
        let newer = Failure::new(Code::ServiceRefused, "OF_LATER: no such", "wait");
        assert_eq!(refused("OF_LATER"), newer);
        let silent = failure(&Status::unavailable("connection refused"));
        assert_eq!(silent, Failure::of(Code::ServiceUnreachable, "connection refused"));
    }
}
