//! Casters and hosts on this machine: our own, controlled by a test, and RTKLIB's.

use std::io::Write;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use graphfix::feeds::ntrip::{Credentials, NtripVersion, StreamRequest};
use graphfix::feeds::{Connector, FeedOptions, FetchPolicy, TimeLimits};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};

use super::doors::Doors;
use super::server::free_port;
use super::wait::until;

/// Time limits that are long enough for this machine.
pub(crate) const PATIENCE: TimeLimits = TimeLimits {
    connecting: Duration::from_secs(2),
    answering: Duration::from_millis(800),
    listing: Duration::from_secs(3),
};

/// Shorter delays than for casters on the internet.
pub(crate) const BRISK: FeedOptions = FeedOptions {
    silence: Duration::from_millis(1500),
    no_epochs: Duration::from_millis(2500),
    delay: Duration::from_millis(50),
    delay_ceiling: Duration::from_millis(800),
    lasting_delay: Duration::from_millis(400),
    lasting_ceiling: Duration::from_secs(3),
    steady: Duration::from_secs(1),
    position_interval: Duration::from_millis(200),
    file_delay: Duration::from_millis(100),
    file_ceiling: Duration::from_millis(800),
    file_refresh: Duration::from_millis(300),
};

/// The same delays and no limit of silence, for casters that have sent everything.
pub(crate) const CONTENT: FeedOptions =
    FeedOptions { silence: Duration::from_secs(300), no_epochs: Duration::from_secs(300), ..BRISK };

pub(crate) fn connector(authorities: Option<&Path>) -> Connector {
    let hosts = ["localhost", "127.0.0.1"].map(str::to_owned);
    Connector::new(FetchPolicy::new(&hosts, true).unwrap(), PATIENCE, authorities).unwrap()
}

pub(crate) fn request(port: u16, mountpoint: &str) -> StreamRequest {
    StreamRequest {
        caster: format!("ntrip://127.0.0.1:{port}").parse().unwrap(),
        mountpoint: mountpoint.to_owned(),
        credentials: None,
        version: NtripVersion::Two,
    }
}

/// Our own caster, which serves each connection as the test defines.
pub(crate) struct HostileCaster {
    pub(crate) port: u16,
    pub(crate) connections: Arc<AtomicUsize>,
}

impl HostileCaster {
    /// Calls `serve` for each connection when its request has arrived. Connections are numbered
    /// from 0.
    pub(crate) async fn start<F: Future<Output = ()> + Send + 'static>(
        serve: impl Fn(usize, TcpStream, String) -> F + Send + Sync + 'static,
    ) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let port = listener.local_addr().unwrap().port();
        let connections = Arc::new(AtomicUsize::new(0));
        let (counted, serve) = (connections.clone(), Arc::new(serve));
        tokio::spawn(async move {
            while let Ok((mut stream, _)) = listener.accept().await {
                let (number, serve) = (counted.fetch_add(1, Ordering::SeqCst), serve.clone());
                tokio::spawn(async move {
                    let mut request = Vec::new();
                    while !request.ends_with(b"\r\n\r\n") {
                        let Ok(byte) = stream.read_u8().await else { return };
                        request.push(byte);
                    }
                    serve(number, stream, String::from_utf8(request).unwrap()).await;
                });
            }
        });
        Self { port, connections }
    }

    /// Answers every request with these bytes, and closes.
    pub(crate) async fn answering(answer: impl Into<Vec<u8>>) -> Self {
        let answer = Arc::new(answer.into());
        Self::start(move |_, mut stream, _| {
            let answer = answer.clone();
            async move {
                // Err: the client has closed the connection.
                stream.write_all(&answer).await.ok();
                stream.shutdown().await.ok();
            }
        })
        .await
    }
}

/// An answer by HTTP.
pub(crate) fn answer(head: &str, body: &[u8]) -> Vec<u8> {
    [format!("HTTP/1.1 {head}\r\n\r\n").as_bytes(), body].concat()
}

pub(crate) fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut packed = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    packed.write_all(bytes).unwrap();
    packed.finish().unwrap()
}

/// A program that is killed at the end of its test.
pub(crate) struct Running(pub(crate) Child);

impl Drop for Running {
    fn drop(&mut self) {
        self.0.kill().ok();
        self.0.wait().ok();
    }
}

/// RTKLIB's `str2str` as a caster: forwards its TCP input to clients with the password.
pub(crate) struct Str2str {
    pub(crate) port: u16,
    /// Bytes written here are its stream.
    pub(crate) source: TcpStream,
    _running: Running,
}

/// Keeps a connection until the client ends it.
pub(crate) async fn keep(mut stream: TcpStream) {
    stream.read_to_end(&mut Vec::new()).await.ok();
}

/// Sends a chunk repeatedly, one each `interval`, until the client closes the connection.
pub(crate) async fn drip(
    mut stream: TcpStream,
    pieces: impl Iterator<Item = Vec<u8>>,
    interval: Duration,
) {
    let mut ticks = tokio::time::interval(interval);
    for piece in pieces {
        ticks.tick().await;
        if stream.write_all(&piece).await.is_err() {
            return;
        }
    }
}

impl Str2str {
    pub(crate) const NAME: &str = "rover";
    pub(crate) const PASSWORD: &str = "secret";

    pub(crate) async fn start(mountpoint: &str) -> Self {
        Self::start_at(mountpoint, free_port()).await
    }

    pub(crate) async fn start_at(mountpoint: &str, port: u16) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let input = format!("tcpcli://127.0.0.1:{}", listener.local_addr().unwrap().port());
        let record = "Town;RTCM 3.2;1005(10),1077(1);2;GPS;NET;IRL;53.28;-9.06;0;0;x;B;N;9;";
        let output =
            format!("ntripc://{}:{}@:{port}/{mountpoint}:{record}", Self::NAME, Self::PASSWORD);
        let running = Command::new("str2str")
            .args(["-in", &input, "-out", &output])
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .expect("str2str is installed");
        let running = Running(running);
        let (source, _) = listener.accept().await.unwrap();
        Self { port, source, _running: running }
    }

    /// Sends bytes no faster than `str2str` forwards them, until the feed of a base has received
    /// all.
    pub(crate) async fn play(&mut self, doors: &Doors, base: &str, bytes: &[u8]) {
        let path = format!("/v1/bases/{base}");
        let counted = async || doors.get(&path).await.1["feed"]["bytes"].as_u64().unwrap();
        let begin = counted().await;
        // `str2str` drops data that arrives before a client is connected.
        let probe = async || {
            self.source.write_all(&[0]).await.unwrap();
            counted().await
        };
        let mut sent = until("handed on", probe, |count| begin < *count).await;
        for piece in bytes.chunks(4_000) {
            self.source.write_all(piece).await.unwrap();
            sent += piece.len() as u64;
            // Half of the buffer of `str2str`.
            until("handed on", counted, |count| sent <= count + 16_000).await;
        }
        until("handed on", counted, |count| sent <= *count).await;
    }

    pub(crate) fn request(&self, mountpoint: &str) -> StreamRequest {
        let credentials =
            Credentials { name: Self::NAME.to_owned(), password: Self::PASSWORD.to_owned() };
        StreamRequest { credentials: Some(credentials), ..request(self.port, mountpoint) }
    }
}
