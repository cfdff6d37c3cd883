//! Threads, the log and interruption, for the commands that run a service or call one.

use std::future::Future;
use std::io::{self, IsTerminal, Write};
use std::sync::atomic::{AtomicU64, Ordering};

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
    static LOST: AtomicU64 = AtomicU64::new(0);
    let writer = move || NodeWriter { mark: mark(&node, is_json), to: io::stderr(), lost: &LOST };
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

/// A writer that puts the node's name before each line. One call of `write` writes one line.
///
/// A line that cannot be written, on a full disk or without a reader, is counted and left out: the
/// service does not depend on its log. The next line that can be written is preceded by the number.
struct NodeWriter<'a, W> {
    mark: String,
    to: W,
    /// Lines left out since the last one that was written.
    lost: &'a AtomicU64,
}

impl<W: Write> NodeWriter<'_, W> {
    fn write_line(&mut self, line: &[u8]) -> io::Result<()> {
        let is_object = self.mark.starts_with('{');
        let rest = if is_object { line.strip_prefix(b"{").unwrap_or(line) } else { line };
        self.to.write_all(&[self.mark.as_bytes(), rest].concat())
    }

    fn loss(&self, lines: u64) -> String {
        let words = format!("lines of the log that could not be written: {lines}");
        match self.mark.starts_with('{') {
            true => serde_json::json!({"level": "WARN", "message": words}).to_string() + "\n",
            false => format!("WARN {words}\n"),
        }
    }
}

impl<W: Write> Write for NodeWriter<'_, W> {
    fn write(&mut self, line: &[u8]) -> io::Result<usize> {
        let lost = self.lost.swap(0, Ordering::Relaxed);
        let loss = (0 < lost).then(|| self.loss(lost));
        let told = loss.map_or(Ok(()), |loss| self.write_line(loss.as_bytes()));
        let untold = if told.is_err() { lost } else { 0 };
        if told.and_then(|()| self.write_line(line)).is_err() {
            self.lost.fetch_add(untold + 1, Ordering::Relaxed);
        }
        Ok(line.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        self.to.flush().ok(); // Err: as a line that cannot be written.
        Ok(())
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

#[cfg(test)]
mod tests {
    use super::*;

    /// A disk with room for this many more lines.
    struct Disk(Vec<u8>, usize);

    impl Write for Disk {
        fn write(&mut self, line: &[u8]) -> io::Result<usize> {
            self.1 = self.1.checked_sub(1).ok_or(io::ErrorKind::StorageFull)?;
            self.0.extend_from_slice(line);
            Ok(line.len())
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn lines_that_cannot_be_written_are_counted() {
        for (is_json, line, first) in [
            (false, "INFO one\n", "a INFO one\n"),
            (true, "{\"m\":1}\n", "{\"node\":\"a\",\"m\":1}\n"),
        ] {
            let lost = AtomicU64::new(0);
            let to = Disk(Vec::new(), 1);
            let mut writer = NodeWriter { mark: mark("a", is_json), to, lost: &lost };
            (0..3).for_each(|_| writer.write_all(line.as_bytes()).unwrap());
            writer.to.1 = 1; // Room for the number of lost lines only.
            writer.write_all(line.as_bytes()).unwrap();
            writer.to.1 = 9;
            (0..2).for_each(|_| writer.write_all(line.as_bytes()).unwrap());
            let text = String::from_utf8(writer.to.0).unwrap();
            let lines: Vec<&str> = text.split_inclusive('\n').collect();
            assert_eq!((lines[0], lines[4], lines.len()), (first, first, 5), "{text}");
            assert!(lines[1].contains("written: 2"), "{text}");
            assert!(lines[2].contains("written: 1"), "{text}");
            assert!(lines.iter().all(|line| line.starts_with(&writer.mark)), "{text}");
            assert_eq!(lost.load(Ordering::Relaxed), 0);
        }
    }
}
