//! TLS on the port of the service: both doors, certificates of clients, renewal, and what a service
//! refuses to start with.

use std::process::{Command, Output};
use std::time::Duration;

use futures::StreamExt;
use graphfix::config::{Limits, TlsConfiguration};
use graphfix::contract::v1;
use graphfix::grpc::v1::sessions_client::SessionsClient;
use graphfix::grpc::v1::solutions_client::SolutionsClient;
use graphfix::refusal::Code;
use serde_json::Value;
use tokio::io::AsyncWriteExt;
use tokio::net::TcpStream;
use tonic::transport::Channel;

use crate::support::doors::epoch;
use crate::support::flow::{self, EpochFlow};
use crate::support::tls::{
    Authority, Files, NAME, Pair, channel, connected, der, last_words, meter, page, seen, text,
};
use crate::support::wait::{stays, until};

fn graphfix(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_graphfix")).args(arguments).output().unwrap()
}

/// The code of a command that must fail, and its line.
fn failure(arguments: &[&str]) -> (String, String) {
    let output = graphfix(arguments);
    let said = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{arguments:?}: {said}");
    let line = said.lines().last().unwrap_or_default().to_owned();
    let code = line.split(['[', ']']).nth(1).unwrap_or_default().to_owned();
    (code, line)
}

async fn session(channel: &Channel) -> String {
    let mut client = SessionsClient::new(channel.clone());
    client.create(v1::CreateSessionRequest::default()).await.unwrap().into_inner().session
}

async fn stream(channel: Channel, session: &str) -> EpochFlow {
    let opening = v1::StreamOpening {
        session: session.to_owned(),
        answers: v1::Answers::Summary.into(),
        last_acknowledged: None,
    };
    let mut flow = flow::epochs(channel, opening).await;
    flow.answer().await;
    flow
}

fn message(seq: u64) -> v1::Epoch {
    serde_json::from_value(epoch(seq)).unwrap()
}

/// gRPC with a stream and a watch, REST, and the dashboard's sign-in, on one port.
#[tokio::test]
async fn both_doors_are_behind_tls() {
    let authority = Authority::new("ours");
    let files = Files::new(&authority.signed());
    let (_service, port) = files.serve(files.configuration(None), Limits::standard()).await;
    let by_grpc = channel(port, &authority.client(None, "h2"));
    let session = session(&by_grpc).await;
    let request = v1::WatchSolutionsRequest { session: session.clone(), ..Default::default() };
    let watch = SolutionsClient::new(by_grpc.clone()).watch(request).await.unwrap();
    let mut flow = stream(by_grpc, &session).await;
    flow.push((1..=20).map(message).collect()).await;
    flow.until_durable(20).await;
    let mut watched =
        watch.into_inner().flat_map(|message| futures::stream::iter(message.unwrap().solutions));
    assert_eq!(watched.next().await.unwrap().seq, 1);

    let by_rest = authority.client(None, "http/1.1");
    let path = format!("/v1/sessions/{session}");
    let answer = page(port, &by_rest, &format!("localhost:{port}"), &path).await;
    let (head, body) = answer.split_once("\r\n\r\n").unwrap();
    assert!(head.starts_with("HTTP/1.1 200 OK"), "{head}");
    let body: Value = serde_json::from_str(body).unwrap();
    assert_eq!(body["durableThrough"], 20, "{body}");
    assert!(meter(port, &authority, "graphfix_tls_certificate_expiry_seconds").await > 3.7e9);

    // Browsers remember TLS for a host name of the service only: other services may use the same
    // address.
    for (host, remembers) in [(NAME, true), ("localhost", false), ("127.0.0.1", false)] {
        let answer = page(port, &by_rest, host, "/healthz").await;
        let remembered = answer.contains("strict-transport-security: max-age=31536000\r\n");
        assert_eq!(remembered, remembers, "{answer}");
    }
    let mut stream = connected(port, &by_rest).await.unwrap();
    let sign_in = "POST /v1/sign-in HTTP/1.1\r\nhost: localhost\r\nconnection: close\r\n\r\n";
    stream.write_all(sign_in.as_bytes()).await.unwrap();
    let answer = last_words(&mut stream).await;
    let cookie = answer.lines().find(|line| line.starts_with("set-cookie: ")).unwrap();
    assert!(cookie.ends_with("; Secure"), "{cookie}");
}

/// `graphfix load`, `stream` and `health` verify a service by its certificate authority.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn clients_refuse_a_service_of_another_authority() {
    let (authority, other) = (Authority::new("ours"), Authority::new("theirs"));
    let files = Files::new(&authority.signed());
    let (_service, port) = files.serve(files.configuration(None), Limits::standard()).await;
    let server = format!("https://localhost:{port}");
    let [ours, theirs] =
        [("ours.pem", &authority), ("theirs.pem", &other)].map(|(n, a)| files.write(n, &a.pem));
    let load = ["load", "--devices", "2", "--rate", "5", "--duration", "1", "--mode", "spp"];
    let load = [&load[..], &["--server", &server, "--json", "--ca"]].concat();
    let output = graphfix(&[&load[..], &[text(&ours)]].concat());
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let counted: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!((&counted["epochs"], &counted["lost"]), (&10.into(), &0.into()), "{counted}");
    let output = graphfix(&["health", &server, "--ca", text(&ours)]);
    assert_eq!(output.stdout, b"ready\n", "{}", String::from_utf8_lossy(&output.stderr));
    let by_address = format!("https://127.0.0.1:{port}");
    let named = ["health", &by_address, "--name", NAME, "--ca", text(&ours)];
    assert!(graphfix(&named).status.success());
    let wrong = ["health", &server, "--name", "other.example", "--ca", text(&ours)];
    assert_eq!(failure(&wrong).0, "TLS_FAILED");

    for own in [&["--ca", text(&theirs)][..], &[]] {
        let (code, line) = failure(&[&["health", &server][..], own].concat());
        assert_eq!(code, "TLS_FAILED", "{line}");
        assert!(line.contains("certificate") && line.contains("--ca"), "{line}");
    }
    let (code, line) = failure(&[&load[..], &[text(&theirs)]].concat());
    assert_eq!(code, "TLS_FAILED", "{line}");
    let (code, line) = failure(&["health", &server, "--ca", text(&files.path("none.pem"))]);
    assert_eq!(code, "TLS_FILE_INVALID", "{line}");
}

/// With an authority for clients, a client needs a certificate of this authority, whatever its key.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn clients_prove_who_they_are() {
    let (authority, clients) = (Authority::new("ours"), Authority::new("devices"));
    let files = Files::new(&authority.signed());
    let tls = files.configuration(Some(&clients));
    let (_service, port) = files.serve(tls, Limits::standard()).await;
    let ca = files.write("ours.pem", &authority.pem);
    let server = format!("https://localhost:{port}");
    let ask = ["health", &server, "--ca", text(&ca)];
    let own = |name: &str, pair: &Pair| {
        let certificate = files.write(&format!("{name}.pem"), &pair.certificate);
        let key = files.write(&format!("{name}.key"), &pair.key);
        ["--client-cert", text(&certificate), "--client-key", text(&key)].map(str::to_owned)
    };
    let [right, foreign, expired] = [
        ("right", clients.signed()),
        ("foreign", authority.signed()),
        ("expired", clients.signed_for(2020, 2021)),
    ]
    .map(|(name, pair)| own(name, &pair));
    let with = |arguments: &[&str], own: &[String]| {
        let own: Vec<&str> = own.iter().map(String::as_str).collect();
        graphfix(&[arguments, &own].concat())
    };
    let load = ["load", "--devices", "1", "--duration", "1", "--mode", "spp", "--server", &server];
    let load = [&load[..], &["--ca", text(&ca)]].concat();
    for command in [&ask[..], &load] {
        let output = with(command, &right);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        for own in [&[][..], &foreign, &expired] {
            let said = String::from_utf8(with(command, own).stderr).unwrap();
            assert!(said.contains("error[TLS_FAILED]"), "{command:?} {own:?}: {said}");
        }
    }
    // The key of another certificate.
    let mixed = [&right[..3], &foreign[3..]].concat();
    let said = String::from_utf8(with(&ask, &mixed).stderr).unwrap();
    assert!(said.contains("error[TLS_KEY_MISMATCH]"), "{said}");
}

/// Whether a service answers a client with this certificate.
async fn is_served(port: u16, authority: &Authority, own: &Pair) -> bool {
    let Ok(mut stream) = connected(port, &authority.client(Some(own), "http/1.1")).await else {
        return false;
    };
    let ask = b"GET /readyz HTTP/1.1\r\nhost: localhost\r\nconnection: close\r\n\r\n";
    // In TLS 1.3 a client learns only after its handshake that its certificate is refused.
    stream.write_all(ask).await.is_ok()
        && last_words(&mut stream).await.starts_with("HTTP/1.1 200 OK")
}

/// A device whose certificate is on the authority's revocation list is refused. A new list needs no
/// restart.
#[tokio::test]
async fn revoked_clients_are_refused() {
    let (authority, clients) = (Authority::new("ours"), Authority::new("devices"));
    let files = Files::new(&authority.signed());
    let list = files.write("revoked.pem", &clients.revoked(&[7], 2080));
    let tls =
        TlsConfiguration { client_crl_file: Some(list), ..files.configuration(Some(&clients)) };
    let (_service, port) = files.serve(tls, Limits::standard()).await;
    let [seven, eight] = [7, 8].map(|serial| clients.signed_as(serial));
    assert!(!is_served(port, &authority, &seven).await);
    assert!(is_served(port, &authority, &eight).await);

    files.write("revoked.pem", &clients.revoked(&[8], 2081));
    let others = async || {
        (is_served(port, &authority, &seven).await, is_served(port, &authority, &eight).await)
    };
    until("the new list", others, |served| *served == (true, false)).await;
    let by_seven = authority.client(Some(&seven), "http/1.1");
    let meters = page(port, &by_seven, "localhost", "/metrics").await;
    // `date -u -d 2081-01-01 +%s`
    let end = meters.lines().find(|line| line.contains("revocation_list_expiry_seconds{"));
    assert!(end.is_some_and(|line| line.ends_with(" 3502915200")), "{end:?}");

    // A file that is no list changes nothing. A list of another authority excludes all clients.
    files.write("revoked.pem", "hello\n");
    stays("the last list", Duration::from_secs(5), others, |served| *served == (true, false)).await;
    files.write("revoked.pem", &authority.revoked(&[], 2080));
    until("a foreign list", others, |served| *served == (false, false)).await;
    files.write("revoked.pem", &clients.revoked(&[], 2082));
    until("nobody is revoked", others, |served| *served == (true, true)).await;
}

/// New connections get the renewed certificate; an open stream continues.
#[tokio::test]
async fn a_renewal_needs_no_restart() {
    let authority = Authority::new("ours");
    let [first, second] = [authority.signed_for(2020, 2080), authority.signed_for(2020, 2081)];
    let files = Files::new(&first);
    let (_service, port) = files.serve(files.configuration(None), Limits::standard()).await;
    let client = authority.client(None, "h2");
    assert_eq!(seen(port, &client).await, der(&first.certificate));
    let by_grpc = channel(port, &client);
    let session = session(&by_grpc).await;
    let mut flow = stream(by_grpc, &session).await;
    flow.push(vec![message(1)]).await;
    flow.until_durable(1).await;

    files.put(&second);
    let new = der(&second.certificate);
    until("renewed", async || seen(port, &client).await, |seen| *seen == new).await;
    flow.push(vec![message(2)]).await;
    flow.until_durable(2).await;
    assert!(meter(port, &authority, "graphfix_tls_certificate_expiry_seconds").await > 3.5e9);
    assert_eq!(meter(port, &authority, "graphfix_tls_renewal_failed").await, 0.0);

    // Files that cannot be used change nothing, until valid ones replace them.
    let broken = [
        ("service.pem", "no certificate".to_owned()),
        ("service.pem", authority.signed_for(2020, 2021).certificate),
        ("service.key", authority.signed().key),
    ];
    for (name, text) in broken {
        files.write(name, &text);
        let failed = async || meter(port, &authority, "graphfix_tls_renewal_failed").await;
        until("reported", failed, |failed| *failed == 1.0).await;
        assert_eq!(seen(port, &client).await, new, "{name}");
        files.put(&second);
        until("repaired", failed, |failed| *failed == 0.0).await;
    }
    flow.push(vec![message(3)]).await;
    flow.until_durable(3).await;
    let is_new = |seen: &_| *seen == new;
    stays("served", Duration::from_secs(1), async || seen(port, &client).await, is_new).await;
}

/// A service does not start with a certificate that its clients would refuse.
#[test]
fn a_wrong_certificate_is_refused_at_the_start() {
    let authority = Authority::new("ours");
    let files = Files::new(&authority.signed());
    let pair = ["--tls-certificate", "--tls-key"];
    let database = format!("sqlite://{}", files.path("start.db").display());
    let start = |certificate: &str, key: &str, more: &[&str]| {
        let (certificate, key) = (files.path(certificate), files.path(key));
        let tls = [pair[0], text(&certificate), pair[1], text(&key)];
        let serve = ["serve", "--listen", "127.0.0.1:0", "--database", &database];
        failure(&[&serve[..], &tls, more].concat())
    };
    files.write("old.pem", &authority.signed_for(2020, 2021).certificate);
    files.write("early.pem", &authority.signed_for(2080, 2081).certificate);
    files.write("other.key", &authority.signed().key);
    files.write("text.pem", "hello\n");
    let cases = [
        ("old.pem", "service.key", Code::TlsCertificateExpired, "2021-01-01 00:00:00 UTC"),
        ("early.pem", "service.key", Code::TlsCertificateExpired, "not valid before 2080-01-01"),
        ("service.pem", "other.key", Code::TlsKeyMismatch, "other.key"),
        ("text.pem", "service.key", Code::TlsFileInvalid, "text.pem: the file has no certificate"),
        ("service.pem", "text.pem", Code::TlsFileInvalid, "text.pem: no private key"),
        ("none.pem", "service.key", Code::TlsFileInvalid, "none.pem: No such file"),
    ];
    for (certificate, key, code, words) in cases {
        let (given, line) = start(certificate, key, &[]);
        assert_eq!(given, code.name(), "{line}");
        assert!(line.contains(words) && line.ends_with(&format!("({})", code.remedy())), "{line}");
    }
    let clients = ["--tls-client-ca", text(&files.path("text.pem"))].map(str::to_owned);
    let (code, line) = start("service.pem", "service.key", &[&clients[0], &clients[1]]);
    assert_eq!(code, "TLS_FILE_INVALID", "{line}");
    let ca = files.write("clients.pem", &authority.pem);
    let old = files.write("old-list.pem", &authority.revoked(&[], 2022));
    for (list, code, words) in [
        (
            &old,
            Code::TlsCertificateExpired,
            "list of revoked certificates has expired at 2022-01-01",
        ),
        (&ca, Code::TlsFileInvalid, "the file has no list of revoked certificates"),
    ] {
        let more = ["--tls-client-ca", text(&ca), "--tls-client-crl", text(list)];
        let (given, line) = start("service.pem", "service.key", &more);
        assert_eq!(given, code.name(), "{line}");
        assert!(line.contains(words), "{line}");
    }
    let (code, line) = start("service.pem", "service.key", &["--tls-client-crl", text(&old)]);
    assert_eq!(code, "CONFIGURATION_MALFORMED", "{line}");
    assert!(line.contains("needs tls.client_ca_file"), "{line}");
    let serve = ["serve", "--listen", "127.0.0.1:0", "--database", &database];
    let alone = files.path("service.pem");
    let (code, line) = failure(&[&serve[..], &[pair[0], text(&alone)]].concat());
    assert_eq!(code, "CONFIGURATION_MALFORMED", "{line}");
    assert!(line.contains("tls.key_file"), "{line}");
}

/// Beyond loopback a service needs a key, and TLS or the option that a proxy has TLS.
#[test]
fn others_are_served_encrypted_only() {
    let authority = Authority::new("ours");
    let files = Files::new(&authority.signed());
    let database = format!("sqlite://{}", files.path("start.db").display());
    let beyond = ["serve", "--listen", "0.0.0.0:0", "--database", &database];
    let (certificate, key) = (files.path("service.pem"), files.path("service.key"));
    let tls = ["--tls-certificate", text(&certificate), "--tls-key", text(&key)];
    for more in [&["--plaintext"][..], &tls, &[]] {
        assert_eq!(failure(&[&beyond[..], more].concat()).0, "LISTEN_NOT_LOOPBACK", "{more:?}");
    }
    let create = ["keys", "create", "--right", "admin", "--database", &database];
    assert!(graphfix(&create).status.success());
    let (code, line) = failure(&beyond);
    assert_eq!(code, "LISTEN_NOT_ENCRYPTED", "{line}");
    assert!(line.contains("--plaintext"), "{line}");
    for more in [&["--plaintext"][..], &tls] {
        let arguments = [&beyond[..], more].concat();
        let mut command = Command::new(env!("CARGO_BIN_EXE_graphfix"));
        let mut child =
            command.args(&arguments).stderr(std::process::Stdio::piped()).spawn().unwrap();
        let lines = std::io::BufRead::lines(std::io::BufReader::new(child.stderr.take().unwrap()));
        let served = lines.map_while(Result::ok).any(|line| line.contains("serving gRPC and REST"));
        child.kill().unwrap();
        child.wait().unwrap();
        assert!(served, "{more:?}");
    }
}

/// An HTTP request without TLS gets an answer with the remedy.
#[tokio::test]
async fn a_plain_request_is_answered() {
    let authority = Authority::new("ours");
    let files = Files::new(&authority.signed());
    let (_service, port) = files.serve(files.configuration(None), Limits::standard()).await;
    let mut stream = TcpStream::connect(("127.0.0.1", port)).await.unwrap();
    let request = "POST /v1/sessions HTTP/1.1\r\nhost: localhost\r\ncontent-length: 30000\r\n\r\n";
    let body = "x".repeat(30_000);
    stream.write_all(format!("{request}{body}").as_bytes()).await.unwrap();
    let answer = last_words(&mut stream).await;
    let (head, body) = answer.split_once("\r\n\r\n").unwrap();
    assert!(head.starts_with("HTTP/1.1 400 Bad Request\r\n"), "{head}");
    let problem: Value = serde_json::from_str(body).unwrap();
    assert_eq!(problem["code"], "TLS_REQUIRED");
    assert_eq!(problem["remedy"], "begin the address with https://");
    // gRPC without TLS: the reason is in the frame that ends the connection.
    let mut stream = TcpStream::connect(("127.0.0.1", port)).await.unwrap();
    stream.write_all(b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n").await.unwrap();
    assert!(last_words(&mut stream).await.contains("TLS_REQUIRED: this port takes TLS only"));
    assert!(meter(port, &authority, "graphfix_tls_handshakes_failed_total").await >= 2.0);
}

/// `graphfix health` reports that a service is about to stop.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn health_says_why_a_service_is_not_ready() {
    let authority = Authority::new("ours");
    let files = Files::new(&authority.signed());
    let (service, port) = files.serve(files.configuration(None), Limits::standard()).await;
    let ca = files.write("ours.pem", &authority.pem);
    let server = format!("https://localhost:{port}");
    let ask = ["health", &server, "--ca", text(&ca)];
    assert!(graphfix(&ask).status.success());
    service.drain();
    let (code, line) = failure(&ask);
    assert_eq!(code, "SERVICE_NOT_READY", "{line}");
    assert!(line.contains("stop"), "{line}");
    let (code, line) = failure(&["health", &format!("http://localhost:{port}")]);
    assert_eq!(code, "SERVICE_REFUSED", "{line}");
    assert!(line.contains("TLS_REQUIRED") && line.ends_with("(begin the address with https://)"));
    let (code, line) = failure(&["health", "http://127.0.0.1:1"]);
    assert_eq!(code, "SERVICE_UNREACHABLE", "{line}");
}
