//! Calls of a service that are repeated while it does not answer.

use std::path::Path;
use std::time::{Duration, Instant};

use bytes::Bytes;
use hyper::Uri;
use hyper_util::rt::TokioIo;
use tonic::service::interceptor::InterceptedService;
use tonic::transport::{Channel, Endpoint};
use tonic::{Code as GrpcCode, Status};
use tonic_types::StatusExt;
use uuid::Uuid;

use crate::contract::v1;
use crate::grpc::v1::bases_client::BasesClient;
use crate::grpc::v1::jobs_client::JobsClient;
use crate::grpc::v1::positioning_client::PositioningClient;
use crate::grpc::v1::sessions_client::SessionsClient;
use crate::grpc::v1::solutions_client::SolutionsClient;
use crate::grpc::{self, v1::navigation_client::NavigationClient};
use crate::refusal::Code;

use super::Failure;
use super::bearer::Bearer;
use super::trust::{TrustArguments, address, tls_failure};

const FIRST_DELAY: Duration = Duration::from_millis(100);
const LONGEST_DELAY: Duration = Duration::from_secs(5);
/// A service that does not answer a ping within `PING_TIMEOUT` counts as gone.
const PING_INTERVAL: Duration = Duration::from_secs(20);
const PING_TIMEOUT: Duration = Duration::from_secs(10);

/// Bytes of a file in one message.
const CHUNK_BYTES: usize = 64 << 10;

/// A file of a batch job.
#[derive(Clone)]
pub(super) struct JobFile {
    /// What the file is for: rover, navigation or base.
    pub(super) part: &'static str,
    pub(super) name: &'static str,
    pub(super) content: Vec<u8>,
}

impl JobFile {
    /// The messages that carry the file.
    fn messages(self) -> Vec<v1::CreateJobRequest> {
        use v1::create_job_request::Content;
        let (part, name) = (self.part.to_owned(), self.name.to_owned());
        let begin = std::iter::once(Content::Part(v1::JobPart { part, name }));
        let chunks = self.content.chunks(CHUNK_BYTES).map(|chunk| Content::Chunk(chunk.to_vec()));
        let message = |content| v1::CreateJobRequest { content: Some(content) };
        begin.chain(chunks).map(message).collect()
    }
}

/// A channel whose requests carry a key.
type Wire = InterceptedService<Channel, Bearer>;

/// A client of the positioning calls.
pub(super) type Positioning = PositioningClient<Wire>;

/// A connection to a service.
#[derive(Clone)]
pub(super) struct Connection {
    channel: Wire,
    /// How long attempts to reach a service go on while it does not answer.
    patience: Duration,
}

impl Connection {
    /// A connection to the service at `server`, such as `http://127.0.0.1:8080`. Its requests carry
    /// `key`. It connects at its first use.
    ///
    /// # Errors
    /// `server` is not an address, `key` not a key, or a file of `trust` cannot be used.
    pub(super) fn to(
        server: &str,
        key: Option<&str>,
        trust: &TrustArguments,
        patience: Duration,
    ) -> Result<Self, Failure> {
        let invalid = |error: String| {
            Failure::new(Code::Usage, format!("--server: {error}"), Code::Usage.remedy())
        };
        let url = address(server).map_err(invalid)?;
        let endpoint = Endpoint::from_shared(server.to_owned());
        let endpoint = endpoint.map_err(|error| invalid(error.to_string()))?;
        let endpoint = endpoint
            .connect_timeout(Duration::from_secs(5))
            .timeout(Duration::from_secs(60))
            .http2_keep_alive_interval(PING_INTERVAL)
            .keep_alive_timeout(PING_TIMEOUT)
            .keep_alive_while_idle(true)
            .initial_stream_window_size(4 << 20)
            .initial_connection_window_size(8 << 20)
            .tcp_nodelay(true);
        let tls = trust.client(b"h2")?;
        let connector = tower::service_fn(move |_: Uri| {
            let (tls, url) = (tls.clone(), url.clone());
            async move {
                let name = url.is_tls.then_some(&*url.host);
                tls.connect((&url.host, url.port), name).await.map(TokioIo::new)
            }
        });
        let channel = endpoint.connect_with_connector_lazy(connector);
        Ok(Self { channel: InterceptedService::new(channel, Bearer::of(key)?), patience })
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
        let mut retry = self.retry();
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
        let mut retry = self.retry();
        loop {
            match client.create(request.clone()).await {
                Ok(answer) => return Ok(answer.into_inner().base),
                Err(status) => retry.wait(&status).await?,
            }
        }
    }

    /// Pushes epochs of a base.
    ///
    /// # Errors
    /// The service refuses them.
    pub(super) async fn push_base(
        &self,
        base: &str,
        epochs: Vec<v1::Epoch>,
    ) -> Result<(), Failure> {
        let mut client = BasesClient::new(self.channel.clone());
        let mut retry = self.retry();
        let request = v1::PushBaseEpochsRequest { base: base.to_owned(), epochs };
        loop {
            match client.push_epochs(request.clone()).await {
                Ok(_) => return Ok(()),
                Err(status) => retry.wait(&status).await?,
            }
        }
    }

    /// Creates a batch job; returns its id.
    ///
    /// # Errors
    /// The service refuses it.
    pub(super) async fn create_job(
        &self,
        options: v1::JobOptions,
        files: Vec<JobFile>,
    ) -> Result<String, Failure> {
        use v1::create_job_request::Content;
        let mut client = JobsClient::new(self.channel.clone());
        let options = v1::CreateJobRequest { content: Some(Content::Options(options)) };
        let files = files.into_iter().flat_map(JobFile::messages);
        let messages: Vec<_> = std::iter::once(options).chain(files).collect();
        let mut retry = self.retry();
        loop {
            match client.create(futures::stream::iter(messages.clone())).await {
                Ok(answer) => return Ok(answer.into_inner().job),
                Err(status) => retry.wait(&status).await?,
            }
        }
    }

    /// Creates a session, or returns the one named.
    ///
    /// # Errors
    /// The configuration is refused, or the session does not exist.
    pub(super) async fn session(
        &self,
        existing: Option<&str>,
        new: v1::CreateSessionRequest,
    ) -> Result<v1::Session, Failure> {
        let mut client = SessionsClient::new(self.channel.clone());
        let mut retry = self.retry();
        // With a request id, an attempt whose answer is lost opens no second session.
        let new = v1::CreateSessionRequest { request_id: Uuid::new_v4().to_string(), ..new };
        loop {
            let answer = match existing {
                Some(id) => client.get(v1::GetSessionRequest { session: id.to_owned() }).await,
                None => client.create(new.clone()).await,
            };
            match answer {
                Ok(answer) => return Ok(answer.into_inner()),
                Err(status) => retry.wait(&status).await?,
            }
        }
    }

    /// A page of the stored solutions of a session.
    ///
    /// # Errors
    /// The service refuses it.
    pub(super) async fn solutions(
        &self,
        request: v1::ListSolutionsRequest,
    ) -> Result<v1::ListSolutionsResponse, Failure> {
        let mut client =
            SolutionsClient::new(self.channel.clone()).max_decoding_message_size(usize::MAX);
        let mut retry = self.retry();
        loop {
            match client.list(request.clone()).await {
                Ok(answer) => return Ok(answer.into_inner()),
                Err(status) => retry.wait(&status).await?,
            }
        }
    }

    /// A client of the positioning calls.
    pub(super) fn positioning(&self) -> Positioning {
        PositioningClient::new(self.channel.clone()).max_decoding_message_size(usize::MAX)
    }

    /// The attempts of a call that begins now.
    pub(super) const fn retry(&self) -> Retry {
        Retry::new(self.patience)
    }
}

/// Exponential backoff within a device's patience; a delay in the answer takes precedence.
pub(super) struct Retry {
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
    pub(super) async fn wait(&mut self, status: &Status) -> Result<(), Failure> {
        let asked = status.get_details_retry_info().and_then(|info| info.retry_delay);
        // A connection that breaks within a stream is reported as an internal error without a code
        // of the service.
        let passing = match status.code() {
            GrpcCode::Unavailable
            | GrpcCode::Unknown
            | GrpcCode::Cancelled
            | GrpcCode::DeadlineExceeded => true,
            GrpcCode::Internal => grpc::code_of(status).is_none(),
            _ => false,
        };
        // A refusal without a delay, such as an exceeded limit, is permanent.
        let since = *self.since.get_or_insert_with(Instant::now);
        if let Some(refused) = tls_failure(status) {
            return Err(refused);
        }
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
