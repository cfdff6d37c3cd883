//! A `graphfix serve` in a process of its own.

use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use graphfix::contract::v1;
use graphfix::grpc::v1::sessions_client::SessionsClient;
use tonic::transport::{Channel, Endpoint};

use super::wait::until;

/// Longest time without a byte of an answer.
const ANSWER: Duration = Duration::from_secs(30);

/// The variable that names another build of the program, which the tests then start.
const PROGRAM: &str = "GRAPHFIX_TEST_PROGRAM";

/// The program that the tests start.
pub(crate) fn program() -> PathBuf {
    std::env::var_os(PROGRAM).map_or_else(|| env!("CARGO_BIN_EXE_graphfix").into(), PathBuf::from)
}

/// A `graphfix serve` of its own, killed when dropped.
pub(crate) struct Server {
    child: Child,
    pub(crate) port: u16,
}

impl Server {
    /// A service with the database of this URL.
    pub(crate) fn start(database: &str, port: u16) -> Self {
        Self::start_with(database, port, |_| {})
    }

    /// Starts a service by a command with these changes.
    pub(crate) fn start_with(database: &str, port: u16, change: impl FnOnce(&mut Command)) -> Self {
        let mut command = Command::new(program());
        command
            .args(["serve", "--log", "warn", "--database", database])
            .env("GRAPHFIX_LISTEN", format!("127.0.0.1:{port}"))
            .stdin(Stdio::null());
        change(&mut command);
        Self { child: command.spawn().unwrap(), port }
    }

    /// The number of its process.
    #[cfg(target_os = "linux")]
    pub(crate) fn process(&self) -> u32 {
        self.child.id()
    }

    /// Sends a signal, such as `STOP`.
    #[cfg(target_os = "linux")]
    pub(crate) fn signal(&self, name: &str) {
        let number = self.process().to_string();
        assert!(Command::new("kill").args(["-s", name, &number]).status().unwrap().success());
    }

    /// Whether it has ended, and whether with success.
    pub(crate) fn ended(&mut self) -> Option<bool> {
        self.child.try_wait().unwrap().map(|status| status.success())
    }

    /// Kills the process by SIGKILL, which a process cannot handle.
    pub(crate) fn kill(mut self) {
        self.child.kill().unwrap();
        self.child.wait().unwrap();
    }

    pub(crate) fn channel(&self) -> Channel {
        let address = format!("http://127.0.0.1:{}", self.port);
        Endpoint::from_shared(address).unwrap().connect_lazy()
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        // Err: it was killed before.
        self.child.kill().ok();
        self.child.wait().ok();
    }
}

/// The result of `graphfix replay` for a session: whether it succeeds, its output and its errors.
pub(crate) fn replayed(
    database: &str,
    session: &str,
    arguments: &[&str],
) -> (bool, String, String) {
    let mut command = Command::new(program());
    command.args(["replay", session, "--database", database]).args(arguments);
    let output = command.output().unwrap();
    let text = String::from_utf8(output.stdout).unwrap();
    (output.status.success(), text, String::from_utf8(output.stderr).unwrap())
}

/// A connection whose reads have a time limit. If nobody listens on the port, the connection may
/// connect to itself, and then no answer comes.
fn connected(port: u16) -> std::io::Result<TcpStream> {
    let stream = TcpStream::connect(("127.0.0.1", port))?;
    stream.set_read_timeout(Some(ANSWER))?;
    Ok(stream)
}

/// The HTTP status of a page.
pub(crate) fn status_of(port: u16, path: &str) -> u16 {
    let mut stream = connected(port).unwrap();
    write!(stream, "GET {path} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n").unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    answer.split(' ').nth(1).unwrap().parse().unwrap()
}

/// Status and body of a page that is asked for with this `authorization`; an error if the service
/// does not answer.
pub(crate) fn get_with(
    port: u16,
    path: &str,
    authorization: &str,
) -> std::io::Result<(u16, String)> {
    let mut stream = connected(port)?;
    let head = format!("Host: localhost\r\nAuthorization: {authorization}\r\nConnection: close");
    write!(stream, "GET {path} HTTP/1.1\r\n{head}\r\n\r\n")?;
    let mut answer = String::new();
    stream.read_to_string(&mut answer)?;
    let (head, body) = answer.split_once("\r\n\r\n").unwrap_or_default();
    Ok((head.split(' ').nth(1).unwrap_or_default().parse().unwrap_or(0), body.to_owned()))
}

/// An answer by HTTP/1.1.
#[derive(Debug)]
pub(crate) struct Answer {
    pub(crate) status: u16,
    pub(crate) head: String,
    pub(crate) body: String,
}

impl Answer {
    /// The value of a header; empty without it.
    pub(crate) fn header(&self, name: &str) -> &str {
        let mut lines = self.head.lines().filter_map(|line| line.split_once(": "));
        lines.find(|(found, _)| found.eq_ignore_ascii_case(name)).map_or("", |(_, value)| value)
    }

    /// The body as JSON.
    pub(crate) fn json(&self) -> serde_json::Value {
        serde_json::from_str(&self.body).unwrap_or_default()
    }
}

/// Sends a request with these headers and a JSON body; an error if the service does not answer.
pub(crate) fn ask(
    port: u16,
    (method, path): (&str, &str),
    headers: &[(&str, &str)],
    body: &str,
) -> std::io::Result<Answer> {
    let mut stream = connected(port)?;
    let mut request = format!("{method} {path} HTTP/1.1\r\nHost: localhost\r\n");
    for (name, value) in headers {
        request += &format!("{name}: {value}\r\n");
    }
    if !body.is_empty() {
        request += &format!("Content-Type: application/json\r\nContent-Length: {}\r\n", body.len());
    }
    write!(stream, "{request}Connection: close\r\n\r\n{body}")?;
    let mut answer = String::new();
    stream.read_to_string(&mut answer)?;
    let (head, body) = answer.split_once("\r\n\r\n").unwrap_or_default();
    let status = head.split(' ').nth(1).unwrap_or_default().parse().unwrap_or(0);
    Ok(Answer { status, head: head.to_owned(), body: body.to_owned() })
}

pub(crate) fn free_port() -> u16 {
    TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port()
}

/// Requests a new session, or an existing one, until the service answers.
pub(crate) async fn opened(channel: &Channel, session: Option<&str>) -> v1::Session {
    let ask = async || {
        let mut client = SessionsClient::new(channel.clone());
        match session {
            None => client.create(v1::CreateSessionRequest::default()).await,
            Some(id) => client.get(v1::GetSessionRequest { session: id.to_owned() }).await,
        }
    };
    until("answered", ask, Result::is_ok).await.unwrap().into_inner()
}
