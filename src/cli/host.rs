//! Threads, the log and interruption, for the commands that run a service or call one.

use std::future::Future;
use std::io::{self, IsTerminal, Write};

use crate::aiding::AidingError;
use crate::app::AppError;
use crate::config::{ServiceConfiguration, ServiceConfigurationError};
use crate::refusal::Code;
use crate::store::StoreError;

use super::Failure;

/// Runs asynchronous work to its end on all cores.
///
/// # Errors
/// The work's own failure, or threads that cannot be started.
pub(super) fn block_on<T>(work: impl Future<Output = Result<T, Failure>>) -> Result<T, Failure> {
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build();
    let runtime = runtime.map_err(|error| Failure::of(Code::NoThreads, error))?;
    runtime.block_on(work)
}

/// Waits for the user or the system to ask the process to stop.
pub(super) async fn interrupted() {
    use tokio::signal::unix::{SignalKind, signal};
    let mut terminate = signal(SignalKind::terminate()).expect("SIGTERM can be listened to");
    tokio::select! {
        _ = tokio::signal::ctrl_c() => {}
        _ = terminate.recv() => {}
    }
}

/// Sends the log of `configuration` to standard error.
///
/// # Errors
/// An invalid filter.
pub(super) fn start_log(configuration: &ServiceConfiguration) -> Result<(), Failure> {
    use tracing_subscriber::EnvFilter;
    let filter = EnvFilter::try_new(&configuration.log.filter).map_err(|error| {
        let message = format!("log filter {:?}: {error}", configuration.log.filter);
        Failure::of(Code::LogFilterInvalid, message)
    })?;
    let (node, is_json) = (configuration.node.clone(), configuration.log.json);
    let writer = move || NodeWriter { mark: mark(&node, is_json) };
    let log = tracing_subscriber::fmt().with_env_filter(filter).with_writer(writer);
    let log = log.with_ansi(io::stderr().is_terminal());
    if is_json {
        log.json().init();
    } else {
        log.init();
    }
    Ok(())
}

/// Puts the name of the node at the beginning of a line.
fn mark(node: &str, is_json: bool) -> String {
    match is_json {
        true => format!("{{\"node\":{},", serde_json::Value::from(node)),
        false => format!("{node} "),
    }
}

/// A writer on standard error that puts the node's name before each line. One call of `write`
/// writes one line.
struct NodeWriter {
    mark: String,
}

impl Write for NodeWriter {
    fn write(&mut self, line: &[u8]) -> io::Result<usize> {
        let is_object = self.mark.starts_with('{');
        let rest = if is_object { line.strip_prefix(b"{").unwrap_or(line) } else { line };
        io::stderr().write_all(&[self.mark.as_bytes(), rest].concat())?;
        Ok(line.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        io::stderr().flush()
    }
}

impl From<StoreError> for Failure {
    fn from(error: StoreError) -> Self {
        Self::of(error.code(), &error)
    }
}

impl From<AidingError> for Failure {
    fn from(error: AidingError) -> Self {
        Self::of(error.code(), &error)
    }
}

impl From<AppError> for Failure {
    fn from(error: AppError) -> Self {
        Self::of(error.code(), &error)
    }
}

impl From<ServiceConfigurationError> for Failure {
    fn from(error: ServiceConfigurationError) -> Self {
        Self::of(error.code(), &error)
    }
}
