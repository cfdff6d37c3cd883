//! The client of NTRIP casters against independent casters, and against a hostile one.

use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use graphfix::feeds::ntrip::{
    self, Credentials, NtripError, NtripStream, NtripVersion, StreamRequest,
};
use graphfix::feeds::{Connector, FetchPolicy};
use graphfix::refusal::Code;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::sync::Notify;
use tokio::time::timeout;

use crate::support::casters::{
    HostileCaster, PATIENCE, Running, Str2str, connector, drip, keep, request,
};
use crate::support::python;
use crate::support::server::free_port;
use crate::support::wait::until;

/// The content of the stream up to its end, or `limit` bytes.
async fn content(stream: &mut NtripStream, limit: usize) -> Vec<u8> {
    let mut content = Vec::new();
    while content.len() < limit && stream.read(&mut content).await.is_ok() {}
    content
}

/// The answer of a caster that may not listen yet.
async fn connected(
    connector: &Connector,
    asked: &StreamRequest,
) -> Result<NtripStream, NtripError> {
    let ask = async || ntrip::connect(connector, asked, None).await;
    let listens = |answer: &Result<_, NtripError>| {
        !answer.as_ref().is_err_and(|error| error.code() == Code::HostUnreachable)
    };
    until("listening", ask, listens).await
}

async fn refusal(answer: impl Into<Vec<u8>>) -> &'static str {
    let caster = HostileCaster::answering(answer).await;
    let refused = ntrip::connect(&connector(None), &request(caster.port, "M"), None).await;
    refused.unwrap_err().code().name()
}

#[tokio::test]
async fn answers_are_told_apart() {
    for (answer, code) in [
        ("HTTP/1.1 401 Unauthorized\r\n\r\n", "CASTER_UNAUTHORISED"),
        ("ERROR - Bad Password\r\n", "CASTER_UNAUTHORISED"),
        ("HTTP/1.1 404 Not Found\r\n\r\n", "NO_SUCH_MOUNTPOINT"),
        (
            "SOURCETABLE 200 OK\r\nContent-Type: text/plain\r\n\r\nENDSOURCETABLE\r\n",
            "NO_SUCH_MOUNTPOINT",
        ),
        ("HTTP/1.1 503 Busy\r\nRetry-After: 3\r\n\r\n", "CASTER_TRY_LATER"),
        ("HTTP/1.1 301 Moved\r\nLocation: http://169.254.169.254/\r\n\r\n", "CASTER_REDIRECTS"),
        ("SSH-2.0-OpenSSH_9.2\r\n", "CASTER_PROTOCOL"),
        ("HTTP/1.1 200", "CASTER_CLOSED"),
        ("", "CASTER_CLOSED"),
    ] {
        assert_eq!(refusal(answer).await, code, "{answer:?}");
    }
    let endless = [b"HTTP/1.1 200 OK\r\n".as_slice(), &b"X-Filler: y\r\n".repeat(100_000)].concat();
    assert_eq!(refusal(endless).await, "CASTER_PROTOCOL");
    assert_eq!(refusal(vec![b'H'; 10]).await, "CASTER_PROTOCOL");
    assert_eq!(
        refusal([b"ICY 200 OK".as_slice(), &[b' '; 20_000]].concat()).await,
        "CASTER_PROTOCOL"
    );
}

/// The time limit for a head also holds if its bytes arrive slowly, one by one.
#[tokio::test]
async fn a_head_that_drips_is_given_up() {
    let caster = HostileCaster::start(|_, stream, _| {
        let head = b"HTTP/1.1 200 OK\r\n".iter().cycle();
        drip(stream, head.map(|byte| vec![*byte]), Duration::from_millis(100))
    })
    .await;
    let start = Instant::now();
    let refused = ntrip::connect(&connector(None), &request(caster.port, "M"), None).await;
    assert_eq!(refused.unwrap_err().code().name(), "CASTER_SILENT");
    assert!(start.elapsed() < Duration::from_secs(2), "{:?}", start.elapsed());
}

/// Chunks split by the network; bytes that arrive with the head are kept.
#[tokio::test]
async fn chunks_arrive_whole_however_they_are_cut() {
    let sent: Vec<u8> = (0..50_000_u32).map(|i| (i * 7) as u8).collect();
    let expected = sent.clone();
    let caster = HostileCaster::start(move |_, mut stream, request| {
        let sent = sent.clone();
        async move {
            assert!(request.starts_with("GET /M HTTP/1.1\r\n"), "{request}");
            let head = b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n";
            let mut wire = head.to_vec();
            for (index, chunk) in sent.chunks(777).enumerate() {
                wire.extend(format!("{:X};x={index}\r\n", chunk.len()).bytes());
                wire.extend_from_slice(chunk);
                wire.extend(b"\r\n");
            }
            wire.extend(b"0\r\n\r\n");
            for piece in wire.chunks(1_003) {
                stream.write_all(piece).await.unwrap();
                tokio::task::yield_now().await;
            }
        }
    })
    .await;
    let granted = ntrip::connect(&connector(None), &request(caster.port, "M"), None).await;
    assert_eq!(content(&mut granted.unwrap(), usize::MAX).await, expected);
}

#[tokio::test]
async fn chunks_that_lie_end_the_stream() {
    for body in ["zz\r\n", "5\r\nhelloX", "99999999999\r\n"] {
        let head = "HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n3\r\nabc\r\n";
        let heard = Arc::new(Notify::new());
        let told = heard.clone();
        let caster = HostileCaster::start(move |_, mut stream, _| {
            let told = told.clone();
            async move {
                stream.write_all(head.as_bytes()).await.unwrap();
                told.notified().await;
                stream.write_all(body.as_bytes()).await.ok();
                keep(stream).await;
            }
        })
        .await;
        let granted = ntrip::connect(&connector(None), &request(caster.port, "M"), None).await;
        let (mut stream, mut content) = (granted.unwrap(), Vec::new());
        let error = loop {
            if let Err(error) = stream.read(&mut content).await {
                break error;
            }
            heard.notify_one();
        };
        assert_eq!(error.code().name(), "CASTER_PROTOCOL", "{body}");
        assert!(content.starts_with(b"abc"));
    }
}

#[tokio::test]
async fn a_sourcetable_that_never_ends_is_given_up() {
    let caster = HostileCaster::start(|_, mut stream, _| async move {
        let head = b"SOURCETABLE 200 OK\r\n\r\n";
        stream.write_all(head).await.unwrap();
        let record = b"STR;A;B;RTCM 3;;2;GPS;N;C;1.00;2.00;0;0;x;n;N;N;0;\r\n".repeat(1000);
        while stream.write_all(&record).await.is_ok() {}
    })
    .await;
    let listed = ntrip::sourcetable(&connector(None), &request(caster.port, "")).await;
    assert_eq!(listed.unwrap_err().code().name(), "CASTER_PROTOCOL");
}

/// No unlisted host is contacted, and no address of a private network.
#[tokio::test]
async fn hosts_that_may_not_be_asked_are_not() {
    let caster = HostileCaster::answering("ICY 200 OK\r\n").await;
    let policy = |hosts: &[&str], allows_private| {
        let hosts: Vec<String> = hosts.iter().map(|host| (*host).to_owned()).collect();
        let policy = FetchPolicy::new(&hosts, allows_private).unwrap();
        Connector::new(policy, PATIENCE, None).unwrap()
    };
    let asked = request(caster.port, "M");
    for (connector, code) in [
        (policy(&[], true), "HOST_NOT_ALLOWED"),
        (policy(&["caster.example.org"], true), "HOST_NOT_ALLOWED"),
        (policy(&["127.0.0.1:1"], true), "HOST_NOT_ALLOWED"),
        (policy(&["127.0.0.1"], false), "ADDRESS_REFUSED"),
    ] {
        let refused = ntrip::connect(&connector, &asked, None).await.unwrap_err();
        assert_eq!(refused.code().name(), code);
    }
    assert_eq!(caster.connections.load(Ordering::SeqCst), 0);
    assert!(ntrip::connect(&policy(&["127.0.0.1"], true), &asked, None).await.is_ok());
}

/// TLS with a certificate of an authority that the operator names, and without one.
#[tokio::test]
async fn encrypted_casters_must_prove_who_they_are() {
    let folder = tempfile::tempdir().unwrap();
    let (certificate, key) = (folder.path().join("cert.pem"), folder.path().join("key.pem"));
    let made = Command::new("openssl")
        .args(["req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1"])
        .args(["-nodes", "-days", "2", "-subj", "/CN=localhost"])
        .args(["-addext", "subjectAltName=DNS:localhost", "-addext", "basicConstraints=CA:FALSE"])
        .arg("-keyout")
        .arg(&key)
        .arg("-out")
        .arg(&certificate)
        .stderr(Stdio::null())
        .status();
    assert!(made.unwrap().success(), "openssl");
    let port = free_port();
    let mut server = Running(
        Command::new("openssl")
            .args(["s_server", "-quiet", "-accept", &port.to_string()])
            .arg("-cert")
            .arg(&certificate)
            .arg("-key")
            .arg(&key)
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap(),
    );
    let mut asked = request(port, "M");
    asked.caster = format!("ntrips://localhost:{port}").parse().unwrap();
    let stranger = connected(&connector(None), &asked).await.unwrap_err();
    assert_eq!(stranger.code(), Code::TlsFailed, "{stranger}");
    use std::io::Write;
    let stdin = server.0.stdin.as_mut().unwrap();
    stdin.write_all(b"ICY 200 OK\r\nstream").unwrap();
    stdin.flush().unwrap();
    let mut granted = ntrip::connect(&connector(Some(&certificate)), &asked, None).await.unwrap();
    assert_eq!(content(&mut granted, 6).await, b"stream");
}

/// A stream through `str2str`, by requests of both versions; wrong passwords and mountpoints.
#[tokio::test]
async fn str2str_gives_its_stream_to_who_may_have_it() {
    for version in [NtripVersion::One, NtripVersion::Two] {
        let mut caster = Str2str::start("BASE").await;
        let connector = connector(None);
        let asked = StreamRequest { version, ..caster.request("BASE") };
        let mut stream = connected(&connector, &asked).await.unwrap();
        let sent: Vec<u8> = (0..40_000_u32).map(|i| ((i * 13) >> 3) as u8).collect();
        // `str2str` drops data that arrives before a client is connected.
        while timeout(Duration::from_millis(100), stream.read(&mut Vec::new())).await.is_err() {
            caster.source.write_all(&[0]).await.unwrap();
        }
        caster.source.write_all(&sent).await.unwrap();
        let found = timeout(Duration::from_secs(10), content(&mut stream, sent.len()));
        let found = found.await.unwrap();
        assert!(found.ends_with(&sent), "{} of {} bytes", found.len(), sent.len());

        let wrong = Credentials { name: "rover".into(), password: "guess".into() };
        let asked_wrongly = StreamRequest { credentials: Some(wrong), ..asked.clone() };
        let refused = ntrip::connect(&connector, &asked_wrongly, None).await.unwrap_err();
        assert_eq!(refused.code().name(), "CASTER_UNAUTHORISED", "{refused}");
        let elsewhere = StreamRequest { mountpoint: "OTHER".into(), ..asked.clone() };
        let refused = ntrip::connect(&connector, &elsewhere, None).await.unwrap_err();
        assert_eq!(refused.code().name(), "NO_SUCH_MOUNTPOINT", "{refused}");
        let list = StreamRequest { mountpoint: String::new(), ..asked };
        let table = ntrip::sourcetable(&connector, &list).await.unwrap();
        let found = table.get("BASE").unwrap();
        assert_eq!((found.format.as_str(), found.position_deg), ("RTCM 3.2", Some((53.28, -9.06))));
    }
}

/// A caster that computes a stream for the rover's position receives this position in the request
/// and again later.
#[tokio::test]
async fn a_position_is_sent_to_casters_that_need_it() {
    let (told, mut telling) = tokio::sync::mpsc::unbounded_channel();
    let caster = HostileCaster::start(move |_, mut stream, request| {
        let told = told.clone();
        async move {
            stream.write_all(b"ICY 200 OK\r\n").await.unwrap();
            let mut line = vec![0; 200];
            let length = stream.read(&mut line).await.unwrap();
            told.send((request, String::from_utf8(line[..length].to_vec()).unwrap())).unwrap();
            keep(stream).await;
        }
    })
    .await;
    let sentence = ntrip::position_sentence(53.28, -9.06, 60.0, 3661);
    let asked = request(caster.port, "VRS");
    let mut stream = ntrip::connect(&connector(None), &asked, Some(&sentence)).await.unwrap();
    let (head, line) = telling.recv().await.unwrap();
    assert!(head.contains("Ntrip-GGA: $GPGGA,010101.00,5316.8000,N,00903.6000,W,"), "{head}");
    assert_eq!(line, sentence);
    stream.send(&sentence).await.unwrap();
}

/// `pygnssutils`' caster; `None`, with a note, if it is not installed.
fn pygnssutils(port: u16, version: &str) -> Option<Running> {
    let python = python::with("pygnssutils")?;
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/support/python/caster.py");
    let running = Command::new(python)
        .arg(script)
        .args([&port.to_string(), version, Str2str::NAME, Str2str::PASSWORD])
        .stdin(Stdio::piped())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn();
    Some(Running(running.unwrap()))
}

/// A stream through `pygnssutils`, by both versions of NTRIP. `pygnssutils` chooses the name of its
/// only mountpoint. In version 2 the head of its answer lacks the end of the first line.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn pygnssutils_gives_its_stream_to_who_may_have_it() {
    use std::io::Write;
    for version in ["1.0", "2.0"] {
        let port = free_port();
        let Some(mut caster) = pygnssutils(port, version) else { return };
        let connector = connector(None);
        let credentials =
            Credentials { name: Str2str::NAME.to_owned(), password: Str2str::PASSWORD.to_owned() };
        let asked =
            StreamRequest { credentials: Some(credentials), ..request(port, "pygnssutils") };
        let mut stream = connected(&connector, &asked).await.unwrap();
        let sent: Vec<u8> = (0..40_000_u32).map(|i| ((i * 13) >> 3) as u8).collect();
        caster.0.stdin.as_mut().unwrap().write_all(&sent).unwrap();
        caster.0.stdin.as_mut().unwrap().flush().unwrap();
        let found = timeout(Duration::from_secs(10), content(&mut stream, sent.len()));
        let found = found.await.unwrap();
        assert!(found.ends_with(&sent), "{version}: {} of {} bytes", found.len(), sent.len());

        let wrong = Credentials { name: Str2str::NAME.into(), password: "guess".into() };
        let asked_wrongly = StreamRequest { credentials: Some(wrong), ..asked.clone() };
        let refused = ntrip::connect(&connector, &asked_wrongly, None).await.unwrap_err();
        assert_eq!(refused.code().name(), "CASTER_UNAUTHORISED", "{version}: {refused}");
        let elsewhere = StreamRequest { mountpoint: "OTHER".into(), ..asked.clone() };
        let refused = ntrip::connect(&connector, &elsewhere, None).await.unwrap_err();
        assert_eq!(refused.code().name(), "NO_SUCH_MOUNTPOINT", "{version}: {refused}");
        let list = StreamRequest { mountpoint: String::new(), ..asked };
        let table = ntrip::sourcetable(&connector, &list).await.unwrap();
        assert_eq!(table.get("pygnssutils").unwrap().format, "RTCM 3.3", "{version}");
    }
}
