//! `graphfix health`: whether a service is ready, for those that supervise it.

use std::pin::pin;
use std::time::Duration;

use bytes::Bytes;
use clap::Args;
use futures::future::{Either, select};
use http_body_util::{BodyExt, Empty, Limited};
use hyper::client::conn::http1;
use hyper::{Request, header};
use hyper_util::rt::TokioIo;
use serde::Deserialize;

use crate::feeds::Url;
use crate::refusal::Code;

use super::Failure;
use super::host;
use super::output::print;
use super::trust::{TrustArguments, address, tls_failure};

/// Largest answer that is read (bytes).
const ANSWER_BYTES: usize = 256 << 10;

/// Asks a service whether it is ready; ends with exit code 0 if it is.
///
/// No key is needed. A service that cannot commit or is about to stop is not ready.
#[derive(Clone, Debug, Args)]
pub(super) struct HealthArguments {
    /// The service.
    #[arg(value_name = "URL", default_value = "http://127.0.0.1:8080", value_parser = address)]
    #[arg(env = "GRAPHFIX_HEALTH_URL")]
    url: Url,
    /// Name that the certificate of the service must have. Default: the one in the URL.
    #[arg(long, value_name = "NAME", env = "GRAPHFIX_HEALTH_NAME")]
    name: Option<String>,
    #[command(flatten)]
    trust: TrustArguments,
    /// Longest time until the answer (s).
    #[arg(long, value_name = "SECONDS", default_value_t = 5)]
    timeout: u64,
}

/// The part of the answer of `/readyz` that this command needs.
#[derive(Deserialize)]
#[serde(untagged)]
enum Answer {
    Readiness {
        ready: bool,
        problems: Vec<String>,
    },
    /// Error code of a refusal, for instance of the host name.
    Problem {
        code: String,
        detail: String,
        remedy: String,
    },
}

/// Asks the service.
///
/// # Errors
/// The service does not answer, or is not ready.
pub(super) fn run(arguments: &HealthArguments) -> Result<(), Failure> {
    let limit = Duration::from_secs(arguments.timeout);
    let asked = host::block_on(async {
        let late = |_| unreachable(arguments, "no answer in time");
        tokio::time::timeout(limit, asked(arguments)).await.map_err(late)?
    });
    match asked? {
        Answer::Readiness { ready: true, .. } => print("ready\n"),
        Answer::Readiness { problems, .. } => {
            Err(Failure::of(Code::ServiceNotReady, problems.join("; ")))
        }
        Answer::Problem { code, detail, remedy } => {
            Err(Failure::new(Code::ServiceRefused, format!("{code}: {detail}"), remedy))
        }
    }
}

/// The answer of the service.
async fn asked(arguments: &HealthArguments) -> Result<Answer, Failure> {
    let HealthArguments { url, name, trust, .. } = arguments;
    let failed = |error: &(dyn std::error::Error + 'static)| {
        tls_failure(error).unwrap_or_else(|| unreachable(arguments, &error.to_string()))
    };
    let name = name.as_deref().unwrap_or(&url.host);
    let expected = url.is_tls.then_some(name);
    let client = trust.client(b"http/1.1")?;
    let stream = client.connect((&url.host, url.port), expected).await.map_err(|e| failed(&e))?;
    let (mut sender, connection) =
        http1::handshake(TokioIo::new(stream)).await.map_err(|error| failed(&error))?;
    let answer = async {
        let request = Request::get("/readyz").header(header::HOST, name);
        let request = request.body(Empty::<Bytes>::new()).map_err(|error| failed(&error))?;
        let body = sender.send_request(request).await.map_err(|error| failed(&error))?.into_body();
        let read = Limited::new(body, ANSWER_BYTES).collect().await;
        let text = read.map_err(|error| unreachable(arguments, &error.to_string()))?.to_bytes();
        serde_json::from_slice(&text).map_err(|error| failed(&error))
    };
    match select(pin!(answer), connection).await {
        Either::Left((answer, _)) => answer,
        // Err of the connection: the answer reports the same.
        Either::Right((_, answer)) => answer.await,
    }
}

fn unreachable(arguments: &HealthArguments, why: &str) -> Failure {
    let remedy = "check that the service runs at this address";
    Failure::new(Code::ServiceUnreachable, format!("{}: {why}", arguments.url), remedy)
}
