//! `graphfix load`: every acknowledged epoch is in the store once, also after `kill -9`. Also
//! `graphfix stream`, which uses the same client.

use std::process::{Command, Stdio};

use graphfix::contract::v1;
use graphfix::grpc::v1::sessions_client::SessionsClient;
use serde_json::Value;
use tonic::transport::Channel;

use crate::support::casters::gzip;
use crate::support::database::{Database, on_both_databases, sqlite_url};
use crate::support::pair::PAIR;
use crate::support::server::{Server, free_port, opened};
use crate::support::wait::until;

on_both_databases!(loads_of_each_kind_are_answered, a_load_outlives_a_kill);

/// `graphfix load` on the service at `port`.
fn load(port: u16, arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_graphfix"));
    command.args(["load", "--json", "--server", &format!("http://127.0.0.1:{port}")]);
    command.args(arguments).stdout(Stdio::piped()).stderr(Stdio::piped());
    command
}

/// The JSON that a successful load printed.
fn result(output: &std::process::Output) -> Value {
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{errors}{}", String::from_utf8_lossy(&output.stdout));
    serde_json::from_slice(&output.stdout).unwrap()
}

fn assert_complete(result: &Value, epochs: u64) {
    assert_eq!(result["epochs"], epochs, "{result}");
    for none in ["errors", "lost", "doubled", "repeated", "unanswered"] {
        assert_eq!(result[none], 0, "{none}: {result}");
    }
}

/// Number of sessions that have epochs.
async fn sessions_with_epochs(channel: &Channel) -> usize {
    let request = v1::ListSessionsRequest { page_size: 100, ..Default::default() };
    let listed = SessionsClient::new(channel.clone()).list(request).await.unwrap().into_inner();
    listed.sessions.iter().filter(|session| session.durable_through.is_some()).count()
}

async fn loads_of_each_kind_are_answered(database: Database) {
    let port = free_port();
    let server = Server::start(&database.url, port);
    opened(&server.channel(), None).await;
    let kinds = [&["--mode", "fgo"][..], &["--mode", "spp", "--raw"], &["--mode", "rtk-fgo"]];
    for kind in kinds {
        let mut command = load(port, &["--devices", "7", "--rate", "5", "--duration", "2"]);
        let result = result(&command.args(kind).output().unwrap());
        assert_complete(&result, 70);
        assert_eq!((&result["breaks"], &result["devices"]), (&0.into(), &7.into()));
        let [median, worst] = ["ackP50Ms", "ackMaxMs"].map(|delay| result[delay].as_f64().unwrap());
        assert!(0.0 < median && median <= worst && worst < 60_000.0, "{result}");
    }
}

async fn a_load_outlives_a_kill(database: Database) {
    let port = free_port();
    let server = Server::start(&database.url, port);
    let channel = server.channel();
    opened(&channel, None).await;
    let arguments = ["--devices", "5", "--rate", "20", "--duration", "3", "--mode", "spp"];
    let mut child = load(port, &arguments).spawn().unwrap();
    let streaming = async || sessions_with_epochs(&channel).await;
    until("all devices streaming", streaming, |sessions| *sessions == 5).await;
    server.kill();
    let _server = Server::start(&database.url, port);
    let ended = async || child.try_wait().unwrap().is_some();
    until("the load has ended", ended, |ended| *ended).await;
    let result = result(&child.wait_with_output().unwrap());
    assert_complete(&result, 300);
    assert!(5 <= result["breaks"].as_u64().unwrap(), "{result}");
}

/// A load without a service fails with a reason.
#[test]
fn a_load_without_a_service_fails() {
    let output = load(free_port(), &["--devices", "1", "--patience", "0"]).output().unwrap();
    assert!(!output.status.success());
    let errors = String::from_utf8(output.stderr).unwrap();
    assert!(errors.contains("error[SERVICE_UNREACHABLE]"), "{errors}");
    let usage = load(1, &["--devices", "300", "--connections", "2"]).output().unwrap();
    let errors = String::from_utf8(usage.stderr).unwrap();
    assert!(errors.contains("error[USAGE]: 300 devices do not fit on 2 connections"), "{errors}");
}

/// A refused epoch is never durable, and `graphfix stream` does not wait for it at the end.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_stream_ends_after_a_refused_epoch() {
    let folder = tempfile::tempdir().unwrap();
    let simulated = folder.path().join("simulated");
    let mut simulate = Command::new(env!("CARGO_BIN_EXE_graphfix"));
    simulate.args(["simulate", "--scenario", "open-sky", "--seed", "1", "--duration", "9"]);
    assert!(simulate.arg("--output").arg(&simulated).output().unwrap().status.success());
    let rover = simulated.join("rover.obs");
    let mut text = std::fs::read_to_string(&rover).unwrap();
    let last = text[text.rfind("\n>").unwrap() + 1..].to_owned();
    text.push_str(&last);
    std::fs::write(&rover, text).unwrap();
    let server = Server::start(&sqlite_url(&folder.path().join("stream.db")), free_port());
    opened(&server.channel(), None).await;
    let mut stream = Command::new(env!("CARGO_BIN_EXE_graphfix"));
    stream.args(["stream", "--speed", "max", "--rover"]).arg(&rover);
    stream.args(["--server", &format!("http://127.0.0.1:{}", server.port)]);
    let mut child = stream.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let ended = async || child.try_wait().unwrap().is_some();
    until("the end of the stream", ended, |ended| *ended).await;
    let output = child.wait_with_output().unwrap();
    let (text, errors) =
        (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert!(output.status.success() && text.contains("10 epochs acknowledged"), "{text}{errors}");
    assert!(
        text.contains(" 1 refused") && errors.contains("epoch 11 refused: OUT_OF_ORDER"),
        "{text}{errors}"
    );
}

/// A packed file that is cut off is sent up to the cut, and the command reports this.
#[tokio::test]
async fn a_file_that_is_cut_off_is_streamed_up_to_there() {
    let folder = tempfile::tempdir().unwrap();
    let rover = folder.path().join("rover.obs.gz");
    let packed = gzip(&PAIR.base_file(None));
    std::fs::write(&rover, &packed[..packed.len() / 2]).unwrap();
    let server = Server::start(&sqlite_url(&folder.path().join("stream.db")), free_port());
    opened(&server.channel(), None).await;
    let mut stream = Command::new(env!("CARGO_BIN_EXE_graphfix"));
    stream.args(["stream", "--speed", "max", "--rover"]).arg(&rover);
    stream.args(["--server", &format!("http://127.0.0.1:{}", server.port)]);
    let mut child = stream.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let ended = async || child.try_wait().unwrap().is_some();
    until("the end of the stream", ended, |ended| *ended).await;
    let output = child.wait_with_output().unwrap();
    let (text, errors) =
        (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert!(output.status.success() && text.contains(" epochs acknowledged"), "{text}{errors}");
    let cut = errors.lines().any(|line| {
        line.contains("rover.obs.gz: the gzip stream is cut off after ")
            && line.ends_with(" unpacked bytes: what follows is missing")
    });
    assert!(cut, "{errors}");
}
