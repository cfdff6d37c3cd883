//! A proxy to the Postgres server of the tests that fails on demand.

use std::net::SocketAddr;
use std::time::Duration;

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream, lookup_host};
use tokio::sync::watch;
use tokio::time::{sleep, timeout};

/// Behaviour of the proxy.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Mode {
    /// Forwards everything.
    Pass,
    /// Forwards nothing, and keeps all connections open.
    Frozen,
    /// Like [`Self::Frozen`], from the next lock of a table on.
    FrozenAtLock,
    /// Closes all connections, and accepts no other.
    Refuse,
    /// Closes the connection that commits next before the server receives `COMMIT`.
    CutBeforeCommit,
    /// Closes the connection that commits next. The server has then committed, and the client has
    /// no answer yet.
    CutAfterCommit,
    /// Closes the connection that commits next. The server receives `COMMIT` a second later.
    CommitLate,
    /// Closes the connection that ends a job next. The server has then ended it, and the client has
    /// no answer yet.
    CutAfterEndOfJob,
}

/// The statement that ends a job. A connection sends it once, to prepare it, and then executes it.
const END_OF_JOB: &[u8] = b"UPDATE jobs SET state = $3";

/// Cuts a connection at most this long after `COMMIT`, answered or not.
const ANSWER: Duration = Duration::from_secs(2);
/// Delay of a late `COMMIT`.
const LATE: Duration = Duration::from_secs(1);

pub(crate) struct Proxy {
    address: SocketAddr,
    mode: watch::Sender<Mode>,
}

impl Proxy {
    /// Listens before the server of this URL.
    pub(crate) async fn before(url: &str) -> Self {
        let (_, rest) = url.split_once("://").unwrap();
        let authority = rest.split(['/', '?']).next().unwrap();
        let host = authority.rsplit('@').next().unwrap();
        let server = lookup_host(host).await.unwrap().next().unwrap();
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap();
        let mode = watch::Sender::new(Mode::Pass);
        let modes = mode.clone();
        tokio::spawn(async move {
            while let Ok((client, _)) = listener.accept().await {
                tokio::spawn(forward(client, server, modes.clone()));
            }
        });
        Self { address, mode }
    }

    /// The URL with the proxy in place of the server, without TLS, so that the proxy sees `COMMIT`.
    pub(crate) fn url(&self, url: &str) -> String {
        let (scheme, rest) = url.split_once("://").unwrap();
        let end = rest.find(['/', '?']).unwrap_or(rest.len());
        let (authority, path) = rest.split_at(end);
        let user = authority.rsplit_once('@').map_or(String::new(), |(user, _)| format!("{user}@"));
        let separator = if path.contains('?') { '&' } else { '?' };
        format!("{scheme}://{user}{}{path}{separator}sslmode=disable", self.address)
    }

    pub(crate) fn set(&self, mode: Mode) {
        self.mode.send_replace(mode);
    }

    pub(crate) fn mode(&self) -> Mode {
        *self.mode.borrow()
    }
}

/// Forwards one connection until one end closes it, or until the mode requires it.
async fn forward(mut client: TcpStream, server: SocketAddr, mode: watch::Sender<Mode>) {
    let (mut modes, mut closing) = (mode.subscribe(), mode.subscribe());
    if thawed(&mut modes).await == Mode::Refuse {
        return;
    }
    let mut server = TcpStream::connect(server).await.unwrap();
    let (mut sent, mut answered) = (vec![0; 1 << 16], vec![0; 1 << 16]);
    let mut ends_job = false;
    loop {
        tokio::select! {
            read = client.read(&mut sent) => {
                let Ok(length @ 1..) = read else { return };
                let now = thawed(&mut modes).await;
                let has = |text: &[u8]| sent[..length].windows(text.len()).any(|part| part == text);
                if now == Mode::FrozenAtLock && has(b"LOCK TABLE") {
                    mode.send_replace(Mode::Frozen);
                    thawed(&mut modes).await;
                }
                let commits = has(b"COMMIT\0");
                let cuts = match now {
                    Mode::CutBeforeCommit | Mode::CutAfterCommit | Mode::CommitLate => commits,
                    Mode::CutAfterEndOfJob => ends_job,
                    Mode::Pass | Mode::Frozen | Mode::FrozenAtLock | Mode::Refuse => false,
                };
                ends_job = has(END_OF_JOB);
                if cuts {
                    mode.send_replace(Mode::Pass);
                }
                if cuts && now == Mode::CutBeforeCommit {
                    return;
                }
                if cuts && now == Mode::CommitLate {
                    drop(client);
                    sleep(LATE).await;
                    server.write_all(&sent[..length]).await.unwrap();
                    let length = server.read(&mut answered).await.unwrap();
                    assert!(0 < length, "the server answers the commit");
                    return;
                }
                if server.write_all(&sent[..length]).await.is_err() {
                    return;
                }
                if cuts {
                    timeout(ANSWER, server.read(&mut answered)).await.ok();
                    return;
                }
            }
            read = server.read(&mut answered) => {
                let Ok(length @ 1..) = read else { return };
                thawed(&mut modes).await;
                if client.write_all(&answered[..length]).await.is_err() {
                    return;
                }
            }
            () = refused(&mut closing) => return,
        }
    }
}

/// Waits for [`Mode::Refuse`].
async fn refused(modes: &mut watch::Receiver<Mode>) {
    modes.wait_for(|mode| *mode == Mode::Refuse).await.unwrap();
}

/// The mode, once it is not [`Mode::Frozen`].
async fn thawed(modes: &mut watch::Receiver<Mode>) -> Mode {
    *modes.wait_for(|mode| *mode != Mode::Frozen).await.unwrap()
}
