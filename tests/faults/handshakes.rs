//! Peers that begin a TLS handshake and do not end it: each is closed, memory stays bounded, and
//! others are served meanwhile.

use std::time::{Duration, Instant};

use graphfix::config::Limits;
use tokio::io::AsyncWriteExt;
use tokio::net::TcpStream;

use crate::support::server::{Server, free_port};
use crate::support::tls::{Authority, Files, connected, last_words, meter, page, text};
use crate::support::wait::until;

/// The beginning of a handshake record, whose message claims this many bytes.
fn client_hello(length: u16) -> Vec<u8> {
    let [high, low] = length.to_be_bytes();
    let [record_high, record_low] = 0x3fff_u16.to_be_bytes();
    vec![22, 3, 1, record_high, record_low, 1, 0, high, low, 3, 3]
}

/// A connection on which these bytes are sent, as far as the service takes them.
async fn sent(port: u16, bytes: &[u8]) -> TcpStream {
    let mut stream = TcpStream::connect(("127.0.0.1", port)).await.unwrap();
    // Err: the service has closed it already.
    stream.write_all(bytes).await.ok();
    stream
}

async fn is_served(port: u16, authority: &Authority) -> bool {
    let client = authority.client(None, "http/1.1");
    page(port, &client, "localhost", "/healthz").await.contains("200 OK")
}

#[tokio::test]
async fn silent_and_half_handshakes_are_closed_in_time() {
    let authority = Authority::new("ours");
    let files = Files::new(&authority.signed());
    let limits = Limits { head_s: 1, ..Limits::standard() };
    let (_service, port) = files.serve(files.configuration(None), limits).await;
    let half = client_hello(300);
    let begun = Instant::now();
    let mut hostile = Vec::new();
    for bytes in [&[][..], &half[..1], &half[..7], &half, &[0x16, 3, 1]] {
        for _ in 0..20 {
            hostile.push(sent(port, bytes).await);
        }
    }
    assert!(is_served(port, &authority).await);
    for mut stream in hostile {
        last_words(&mut stream).await;
    }
    assert!(begun.elapsed() < Duration::from_secs(20), "{:?}", begun.elapsed());
}

/// A handshake that is wrong or too long is closed long before its time limit.
#[tokio::test]
async fn garbage_and_long_handshakes_are_closed_at_once() {
    let authority = Authority::new("ours");
    let files = Files::new(&authority.signed());
    let limits = Limits { head_s: 600, ..Limits::standard() };
    let (_service, port) = files.serve(files.configuration(None), limits).await;
    let whole = client_hello(60_000);
    // Two records: 32 kB of a message of 60 kB.
    let first = [&whole[..], &vec![0; 0x3fff - whole.len() + 5]].concat();
    let long = [&first[..], &[22, 3, 1, 0x3f, 0xff], &vec![0; 0x3fff]].concat();
    let wrong = [&[22, 3, 3, 0, 5], &b"hello"[..]].concat();
    let alert = [21, 3, 3, 0, 2, 2, 40];
    for bytes in [&b"\x00\x01\x02garbage"[..], b"\xff\xff\xff\xff", &wrong, &alert, &long] {
        let begun = Instant::now();
        for _ in 0..5 {
            last_words(&mut sent(port, bytes).await).await;
        }
        let elapsed = begun.elapsed();
        assert!(elapsed < Duration::from_secs(25), "{:?}: {elapsed:?}", &bytes[..4]);
    }
    assert!(is_served(port, &authority).await);
}

/// A peer that reads nothing is closed, although TLS has a buffer of its own.
#[tokio::test]
async fn a_silent_reader_is_closed() {
    let authority = Authority::new("ours");
    let files = Files::new(&authority.signed());
    let limits = Limits { body_silence_s: 1, ..Limits::standard() };
    let (_service, port) = files.serve(files.configuration(None), limits).await;
    let mut stream = connected(port, &authority.client(None, "http/1.1")).await.unwrap();
    // The answers are more than the buffers of both systems take.
    let requests = "GET /openapi.json HTTP/1.1\r\nhost: localhost\r\n\r\n".repeat(1000);
    let asked = stream.write_all(requests.as_bytes());
    // Err: the service has stopped reading.
    tokio::time::timeout(Duration::from_secs(1), asked).await.ok();
    let open = async || meter(port, &authority, "graphfix_connections").await;
    until("closed", open, |open| *open == 1.0).await;
    drop(stream);
}

/// Connections in their handshake count in the limit of connections. The service accepts at most
/// 16 kB of such a peer, and uses about 105 kB of resident memory for it, with all buffers.
#[cfg(target_os = "linux")]
#[tokio::test]
async fn many_half_handshakes_need_little_memory() {
    let authority = Authority::new("ours");
    let files = Files::new(&authority.signed());
    let database = format!("sqlite://{}", files.path("memory.db").display());
    let limits = "[limits]\nhead_s = 600\nconnections_per_address = 400\n";
    let configuration = files.write("graphfix.toml", limits);
    let server = Server::start_with(&database, free_port(), |command| {
        command.args(["--config", text(&configuration)]);
        command.arg("--tls-certificate").arg(files.path("service.pem"));
        command.arg("--tls-key").arg(files.path("service.key"));
    });
    let connects = async || TcpStream::connect(("127.0.0.1", server.port)).await.is_ok();
    until("listening", connects, |connects| *connects).await;
    let idle = resident_bytes(server.process());
    let mut half = client_hello(60_000);
    half.resize(15 << 10, 0);
    let mut hostile = Vec::new();
    for _ in 0..390 {
        hostile.push(sent(server.port, &half).await);
    }
    assert!(is_served(server.port, &authority).await);
    let more = resident_bytes(server.process()).saturating_sub(idle);
    assert!(more < 72 << 20, "{more} bytes for {} handshakes", hostile.len());
    // Connections beyond the limit begin no handshake.
    for _ in 0..20 {
        hostile.push(sent(server.port, &half).await);
    }
    assert_eq!(last_words(hostile.last_mut().unwrap()).await, "");
    drop(hostile);
    until("served again", async || tried(server.port, &authority).await, |served| *served).await;
}

/// Whether the service completes a handshake now.
async fn tried(port: u16, authority: &Authority) -> bool {
    let client = authority.client(None, "http/1.1");
    connected(port, &client).await.is_ok()
}

#[cfg(target_os = "linux")]
fn resident_bytes(process: u32) -> u64 {
    let status = std::fs::read_to_string(format!("/proc/{process}/status")).unwrap();
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:")).unwrap();
    line.trim().trim_end_matches(" kB").parse::<u64>().unwrap() << 10
}
