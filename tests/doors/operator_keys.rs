//! API keys by the command line, beside a running service, and what a service does at its start.

use std::process::{Command, Output};

use axum::http::StatusCode;
use graphfix::contract::v1;
use graphfix::grpc::code_of;
use graphfix::grpc::v1::sessions_client::SessionsClient;
use serde_json::Value;

use crate::support::database::{Database, on_both_databases};
use crate::support::doors::{Doors, code};
use crate::support::server::{Server, free_port, get_with};
use crate::support::wait::until;

on_both_databases!(the_operator_changes_keys_beside_the_service);

fn keys(database: &str, arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_graphfix"));
    command.args(["keys", "--database", database]).args(arguments).output().unwrap()
}

/// The output of a command that must succeed.
fn done(database: &str, arguments: &[&str]) -> String {
    let output = keys(database, arguments);
    let errors = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{arguments:?}: {errors}");
    String::from_utf8(output.stdout).unwrap()
}

/// Id and secret in the output of a command that creates a key.
fn created(text: &str) -> (String, String) {
    let id = text.split(' ').next().unwrap().to_owned();
    let secret = text.lines().last().unwrap().to_owned();
    assert!(id.starts_with("key_") && secret.starts_with("gfx_"), "{text}");
    (id, secret)
}

/// Status and code of the service's list of sessions with a key.
async fn listed(doors: &Doors, secret: &str) -> (StatusCode, String) {
    let request = axum::http::Request::get("/v1/sessions")
        .header("authorization", format!("Bearer {secret}"))
        .body(axum::body::Body::empty())
        .unwrap();
    let (status, answer) = doors.ask(request).await;
    (status, code(&answer).to_owned())
}

/// A secret that cannot be shown is a failure of the command, as is a report.
#[cfg(target_os = "linux")]
#[test]
fn output_that_cannot_be_written_is_a_failure() {
    let folder = tempfile::tempdir().unwrap();
    let database = format!("sqlite://{}", folder.path().join("keys.db").display());
    let create = ["keys", "--database", &database, "create", "--right", "read"];
    for arguments in [&create[..], &["config"]] {
        let full = std::fs::OpenOptions::new().write(true).open("/dev/full").unwrap();
        let mut command = Command::new(env!("CARGO_BIN_EXE_graphfix"));
        let output = command.args(arguments).stdout(full).output().unwrap();
        let errors = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(1), "{arguments:?}: {errors}");
        assert!(errors.contains("FILE_NOT_WRITABLE"), "{errors}");
    }
}

async fn the_operator_changes_keys_beside_the_service(database: Database) {
    let doors = Doors::on(&database.url).await;
    let url = &*database.url;
    assert_eq!(listed(&doors, "gfx_0").await.0, StatusCode::OK, "no key exists");
    let (first, secret) = created(&done(url, &["create", "--right", "read,device"]));
    let without = async || doors.get("/v1/sessions").await.0;
    until("closed", without, |status| *status == StatusCode::UNAUTHORIZED).await;
    assert_eq!(listed(&doors, &secret).await.0, StatusCode::OK);

    let rotated = done(url, &["rotate", &first, "--overlap", "0", "--days", "30"]);
    let (second, newer) = created(&rotated);
    let code_of_first = async || listed(&doors, &secret).await.1;
    until("expired", code_of_first, |code| code == "KEY_EXPIRED").await;
    assert_eq!(listed(&doors, &newer).await.0, StatusCode::OK);

    done(url, &["revoke", &second]);
    let code_of_second = async || listed(&doors, &newer).await.1;
    until("revoked", code_of_second, |code| code == "KEY_REVOKED").await;
    let table = done(url, &["list"]);
    let lines: Vec<&str> = table.lines().collect();
    assert!(lines[0].starts_with(&second) && lines[0].contains("revoked 20"), "{table}");
    assert!(lines[1].starts_with(&first) && lines[1].contains("[device read] expired"), "{table}");
    assert!(!table.contains("gfx_"), "{table}");
    assert_eq!(doors.get("/v1/sessions").await.0, StatusCode::UNAUTHORIZED, "ended keys count");
}

#[test]
fn a_wrong_act_is_refused() {
    let database = Database::sqlite();
    let url = &*database.url;
    let (key, _) = created(&done(url, &["create", "--right", "admin"])); // Creates the database.
    done(url, &["revoke", &key]);
    for (arguments, expected) in [
        (&["create"][..], "USAGE"),
        (&["create", "--right", "write"], "USAGE"),
        (&["create", "--right", "read", "--days", "0"], "USAGE"),
        (&["revoke", "key_1"], "KEY_NOT_FOUND"),
        (&["rotate", &key], "KEY_ENDED"),
    ] {
        let output = keys(url, arguments);
        let errors = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(!output.status.success(), "{arguments:?}");
        assert!(errors.starts_with(&format!("error[{expected}]: ")), "{arguments:?}: {errors}");
        assert_eq!(errors.lines().count(), 1, "{errors}");
    }
}

/// A service listens beyond loopback once a key exists. The number of wrong keys from one address
/// is limited; right keys from the same address still work.
#[tokio::test]
async fn a_service_with_keys_listens_to_others() {
    let database = Database::sqlite();
    let (_, secret) = created(&done(&database.url, &["create", "--right", "read,device"]));
    let port = free_port();
    let everywhere = format!("--listen=0.0.0.0:{port}");
    let server = Server::start_with(&database.url, port, |command| {
        command.arg(everywhere).arg("--plaintext");
    });
    let ask = async |key: &str| get_with(port, "/v1/sessions", &format!("Bearer {key}"));
    let right = until("served", async || ask(&secret).await, |answer| answer.is_ok()).await;
    assert_eq!(right.unwrap().0, 200);
    let wrong = format!("gfx_{}", "0".repeat(64));
    let mut codes = Vec::new();
    for _ in 0..30 {
        let (status, answer) = ask(&wrong).await.unwrap();
        let answer: Value = serde_json::from_str(&answer).unwrap();
        codes.push((status, code(&answer).to_owned()));
    }
    assert_eq!(codes[0], (401, "KEY_INVALID".to_owned()));
    assert!(codes.contains(&(429, "TOO_MANY_ATTEMPTS".to_owned())), "{codes:?}");
    assert_eq!(ask(&secret).await.unwrap().0, 200);

    let refused = SessionsClient::new(server.channel())
        .get(v1::GetSessionRequest::default())
        .await
        .unwrap_err();
    assert_eq!(refused.code(), tonic::Code::Unauthenticated);
    assert_eq!(code_of(&refused).as_deref(), Some("KEY_REQUIRED"));
}

/// `graphfix stream` takes its key from the environment, or by `--key`.
#[tokio::test]
async fn a_device_streams_with_its_key() {
    let database = Database::sqlite();
    let (_, secret) = created(&done(&database.url, &["create", "--right", "device"]));
    let server = Server::start(&database.url, free_port());
    let folder = tempfile::tempdir().unwrap();
    let mut simulate = Command::new(env!("CARGO_BIN_EXE_graphfix"));
    simulate.args(["simulate", "--scenario", "clean", "--seed", "1", "--force", "--output"]);
    assert!(simulate.arg(folder.path()).status().unwrap().success());
    let rover = folder.path().join("rover.obs");
    let stream = |change: &dyn Fn(&mut Command)| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_graphfix"));
        let address = format!("http://127.0.0.1:{}", server.port);
        command.args(["stream", "--speed", "max", "--server", &address, "--rover"]).arg(&rover);
        change(&mut command);
        let output = command.output().unwrap();
        (output.status.success(), String::from_utf8(output.stderr).unwrap())
    };
    let (is_done, errors) = stream(&|command| _ = command.env("GRAPHFIX_KEY", &secret));
    assert!(is_done, "{errors}");
    let (is_done, errors) = stream(&|command| _ = command.args(["--key", &secret]));
    assert!(is_done, "{errors}");
    let (is_done, errors) = stream(&|_| ());
    assert!(!is_done && errors.starts_with("error[KEY_REQUIRED]: "), "{errors}");
}
