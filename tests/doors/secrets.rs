//! Passwords at casters and secrets of webhooks are encrypted with the operator's key, which may be
//! rotated or lost. Also the database's URL from a file.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::{Arc, Mutex};

use axum::http::StatusCode;
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use graphfix::app;
use graphfix::config::{SecretsConfiguration, ServiceConfiguration};
use serde_json::{Value, json};
use tokio::io::AsyncWriteExt;

use crate::support::casters::{BRISK, HostileCaster, PATIENCE};
use crate::support::database::{Database, on_both_databases};
use crate::support::doors::Doors;
use crate::support::server::free_port;
use crate::support::wait::until;

use super::tenants::world::{asked, operator};

on_both_databases!(
    a_password_is_stored_under_the_key_in_force,
    a_service_with_api_keys_stores_no_secret_as_it_is,
);

const PASSWORD: &str = "open sesame";
const STORED: &str = "SELECT password FROM base_feeds";
const KEY: &str = "SELECT password_key FROM base_feeds";

/// The file of a key that consists of one digit.
fn file(folder: &Path, digit: char) -> PathBuf {
    let path = folder.join(format!("{digit}.key"));
    std::fs::write(&path, digit.to_string().repeat(64) + "\n").unwrap();
    path
}

fn keys(folder: &Path, current: char, former: &[char]) -> SecretsConfiguration {
    let former_key_files = former.iter().map(|digit| file(folder, *digit)).collect();
    let key_file = Some(file(folder, current));
    SecretsConfiguration { key_file, former_key_files, key: None }
}

/// The error with which a service refuses to start with these keys.
async fn refused(database: &Database, secrets: SecretsConfiguration) -> String {
    let url = database.url.clone();
    let configuration = ServiceConfiguration { database: url, secrets, ..Default::default() };
    let opened = app::open(&configuration, PATIENCE, BRISK).await;
    opened.err().expect("the service does not start").to_string()
}

fn graphfix(arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_graphfix"));
    command.args(arguments).env_remove("GRAPHFIX_SECRETS_KEY").output().unwrap()
}

/// The output of a command that must succeed.
fn done(arguments: &[&str]) -> String {
    let output = graphfix(arguments);
    let errors = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{arguments:?}: {errors}");
    String::from_utf8(output.stdout).unwrap()
}

async fn a_password_is_stored_under_the_key_in_force(database: Database) {
    let folder = tempfile::tempdir().unwrap();
    let heads = Arc::new(Mutex::new(Vec::new()));
    let kept = heads.clone();
    let caster = HostileCaster::start(move |_, mut stream, head| {
        kept.lock().unwrap().push(head);
        async move {
            // Err: the service has stopped.
            stream.write_all(b"HTTP/1.1 503 Later\r\nContent-Length: 0\r\n\r\n").await.ok();
            stream.shutdown().await.ok();
        }
    })
    .await;
    let credentials = STANDARD.encode(format!("rover:{PASSWORD}"));
    let authorised = format!("Basic {credentials}");
    let asked_caster = async || {
        heads.lock().unwrap().clear();
        let last = async || heads.lock().unwrap().last().cloned().unwrap_or_default();
        until("the caster is asked with the password", last, |head| head.contains(&authorised))
            .await;
    };
    let caster = format!("ntrip://127.0.0.1:{}", caster.port);
    let ntrip = json!({"caster": caster, "mountpoint": "ROOF", "user": "rover",
                       "password": PASSWORD});
    let new = json!({"label": "roof", "ntrip": ntrip, "requestId": "roof"});

    // Without a key of secrets, and while no API key is needed, a password is stored as it is.
    let doors = Doors::on_with_secrets(&database.url, SecretsConfiguration::default()).await;
    let (status, base) = doors.post("/v1/bases", new.clone()).await;
    assert_eq!(status, StatusCode::CREATED, "{base}");
    asked_caster().await;
    doors.close().await;
    assert_eq!(database.text(STORED).await, PASSWORD);
    assert!(done(&["secrets", "list", "--database", &database.url]).contains("not encrypted: 1"));

    // With a key the password is encrypted at the start, and the caster still gets it.
    let mut ids = Vec::new();
    for secrets in [keys(folder.path(), 'a', &[]), keys(folder.path(), 'b', &['c', 'a'])] {
        let doors = Doors::on_with_secrets(&database.url, secrets).await;
        asked_caster().await;
        doors.close().await;
        let stored = database.text(STORED).await;
        assert!(!stored.contains("sesame") && !stored.contains(&credentials), "{stored}");
        ids.push(database.text(KEY).await);
    }
    assert!(ids[0] != ids[1] && ids.iter().all(|id| id.len() == 8), "{ids:?}");
    let unknown = format!("the key {}, which is not given", ids[1]);
    for secrets in [SecretsConfiguration::default(), keys(folder.path(), 'a', &[])] {
        let why = refused(&database, secrets).await;
        assert!(why.contains(&unknown), "{why}");
    }

    let (listen, wrong) = (format!("127.0.0.1:{}", free_port()), file(folder.path(), 'a'));
    let serve = ["serve", "--listen", &listen, "--database", &database.url];
    let started =
        graphfix(&[&serve[..], &["--secrets-key-file", wrong.to_str().unwrap()]].concat());
    let line = String::from_utf8(started.stderr).unwrap();
    assert!(line.contains("error[SECRETS_KEY_UNKNOWN]"), "{line}");

    // The key is lost: `forget` removes the secrets that it has encrypted.
    assert!(done(&["secrets", "list", "--database", &database.url]).contains(&ids[1]));
    let unknown = graphfix(&["secrets", "forget", "nope", "--database", &database.url]);
    assert_eq!(unknown.status.code(), Some(1));
    let line = String::from_utf8(unknown.stderr).unwrap();
    assert!(line.contains("under the key \"nope\""), "{line}");
    assert!(!done(&["keys", "audit", "--database", &database.url]).contains("Secrets.Forget"));
    let forgotten = done(&["secrets", "forget", &ids[1], "--database", &database.url]);
    assert_eq!(forgotten, "1 secrets are given up\n");
    let acts = done(&["keys", "audit", "--database", &database.url]);
    assert!(acts.contains("Secrets.Forget") && acts.contains(&ids[1]), "{acts}");
    let doors = Doors::on_with_secrets(&database.url, keys(folder.path(), 'c', &[])).await;
    let listed = doors.get("/v1/bases").await.1;
    assert_eq!(listed["bases"][0]["base"], base["base"]);
    doors.close().await;
}

async fn a_service_with_api_keys_stores_no_secret_as_it_is(database: Database) {
    let none = SecretsConfiguration::default();
    let doors = Doors::on_with_secrets(&database.url, none).await;
    let operator = operator(&doors).await;
    let base = |password: &str| {
        let ntrip = json!({"caster": "http://127.0.0.1:1", "mountpoint": "ROOF", "user": "rover",
                           "password": password});
        json!({"label": "roof", "ntrip": ntrip})
    };
    let (status, answer) = asked(&doors, &operator, "POST", "/v1/bases", base(PASSWORD)).await;
    let expected = (&json!("SECRETS_KEY_MISSING"), &json!("ntrip.password"));
    assert_eq!(status, StatusCode::CONFLICT, "{answer}");
    assert_eq!((&answer["code"], &answer["field"]), expected);
    assert!(!answer.to_string().contains(PASSWORD), "{answer}");
    let (status, answer) = asked(&doors, &operator, "POST", "/v1/bases", base("")).await;
    assert_eq!(status, StatusCode::CREATED, "{answer}");
    doors.close().await;
    assert_eq!(database.text(STORED).await, "");

    // With a key the password is accepted. The same request again gives the same base. A request
    // with another password is a conflict.
    let folder = tempfile::tempdir().unwrap();
    let doors = Doors::on_with_secrets(&database.url, keys(folder.path(), 'a', &[])).await;
    let named = |password: &str| {
        let mut new = base(password);
        new["requestId"] = Value::from("with a password");
        new
    };
    for (password, expected) in [
        (PASSWORD, StatusCode::CREATED),
        (PASSWORD, StatusCode::OK),
        ("another", StatusCode::CONFLICT),
    ] {
        let (status, answer) = asked(&doors, &operator, "POST", "/v1/bases", named(password)).await;
        assert_eq!(status, expected, "{password}: {answer}");
    }
    doors.close().await;
}

#[test]
fn keys_that_are_none_are_refused_at_the_start() {
    let folder = tempfile::tempdir().unwrap();
    let database = format!("sqlite://{}", folder.path().join("graphfix.db").display());
    let wrong = folder.path().join("wrong.key");
    std::fs::write(&wrong, "open sesame").unwrap();
    let [right, absent] = [file(folder.path(), 'a'), folder.path().join("absent")];
    let path = |path: &Path| path.to_str().unwrap().to_owned();
    let listen = format!("127.0.0.1:{}", free_port());
    let refused = |arguments: &[&str], variable: Option<&str>| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_graphfix"));
        command.args(["serve", "--database", &database, "--listen", &listen]).args(arguments);
        if let Some(key) = variable {
            command.env("GRAPHFIX_SECRETS_KEY", key);
        }
        let output = command.output().unwrap();
        assert!(!output.status.success(), "{arguments:?}");
        String::from_utf8(output.stderr).unwrap()
    };
    for file in [&wrong, &absent] {
        let line = refused(&["--secrets-key-file", &path(file)], None);
        assert!(line.contains("SECRETS_KEY_INVALID") && line.contains(&path(file)), "{line}");
    }
    let line = refused(&[], Some("open sesame"));
    assert!(line.contains("SECRETS_KEY_INVALID") && !line.contains("sesame"), "{line}");
    let twice = refused(&["--secrets-key-file", &path(&right)], Some(&"b".repeat(64)));
    assert!(twice.contains("CONFIGURATION_MALFORMED"), "{twice}");
    let alone = refused(&["--secrets-former-key-file", &path(&right)], None);
    assert!(alone.contains("CONFIGURATION_MALFORMED"), "{alone}");
}

#[test]
fn the_url_of_the_database_may_be_in_a_file() {
    let folder = tempfile::tempdir().unwrap();
    let database = format!("sqlite://{}", folder.path().join("graphfix.db").display());
    let file = folder.path().join("database.url");
    std::fs::write(&file, format!("{database}\n")).unwrap();
    let file = file.to_str().unwrap();
    done(&["keys", "create", "--right", "read", "--database-file", file]);
    assert!(done(&["keys", "list", "--database", &database]).contains("read"));
    assert!(done(&["tenants", "list", "--database-file", file]).contains("default"));

    let both = graphfix(&["keys", "list", "--database", &database, "--database-file", file]);
    assert_eq!(both.status.code(), Some(2));
    // The command line has priority over the environment.
    let elsewhere = format!("sqlite://{}", folder.path().join("elsewhere.db").display());
    for (argument, variable) in [
        (["--database-file", file], ("GRAPHFIX_DATABASE", &*elsewhere)),
        (["--database", &database], ("GRAPHFIX_DATABASE_FILE", "/no/such/file")),
    ] {
        let mut command = Command::new(env!("CARGO_BIN_EXE_graphfix"));
        command.args(["keys", "list"]).args(argument).env(variable.0, variable.1);
        let listed = command.output().unwrap();
        assert!(listed.status.success(), "{}", String::from_utf8_lossy(&listed.stderr));
        assert!(String::from_utf8_lossy(&listed.stdout).contains("read"));
    }
    let mut command = Command::new(env!("CARGO_BIN_EXE_graphfix"));
    let variables = [("GRAPHFIX_DATABASE", &*database), ("GRAPHFIX_DATABASE_FILE", file)];
    let both = command.args(["keys", "list"]).envs(variables).output().unwrap();
    assert_eq!(both.status.code(), Some(2));
    let absent = graphfix(&["keys", "list", "--database-file", "/no/such/file"]);
    let line = String::from_utf8(absent.stderr).unwrap();
    assert!(line.contains("FILE_NOT_READABLE") && line.contains("/no/such/file"), "{line}");

    // A service also reads the file, here named by the configuration. The service is refused beyond
    // loopback without TLS. The refusal names the port, so the database was opened before.
    let configuration = folder.path().join("graphfix.toml");
    let listen = format!("0.0.0.0:{}", free_port());
    let text = format!("listen = \"{listen}\"\ndatabase_file = {file:?}\n");
    std::fs::write(&configuration, &text).unwrap();
    let serve = ["serve", "--config", configuration.to_str().unwrap()];
    let line = String::from_utf8(graphfix(&serve).stderr).unwrap();
    assert!(line.contains("LISTEN_NOT_ENCRYPTED"), "{line}");
    std::fs::write(&configuration, text + "database = \"sqlite://other.db\"\n").unwrap();
    let line = String::from_utf8(graphfix(&serve).stderr).unwrap();
    assert!(line.contains("CONFIGURATION_MALFORMED") && line.contains("database_file"), "{line}");
}
