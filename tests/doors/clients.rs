//! Independent clients: Python's grpcio with stubs generated from `proto/`, curl, and the tests of
//! the Python client.

use std::fs;
use std::path::Path;
use std::process::Command;

use graphfix::contract::{convert, v1};
use serde_json::{Value, json};

use crate::support::database::sqlite_url;
use crate::support::server::{Server, free_port, opened};
use crate::support::{data, python, reading};

fn run(command: &mut Command) -> String {
    let output = command.output().unwrap();
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{command:?}: {errors}");
    String::from_utf8(output.stdout).unwrap()
}

fn curl(arguments: &[&str]) -> Value {
    let text = run(Command::new("curl").args(["--silent", "--show-error"]).args(arguments));
    serde_json::from_str(&text).unwrap_or_else(|error| panic!("{error}: {text}"))
}

/// Some epochs of the middle of the file, as messages.
fn epochs(rover: &Path) -> Vec<v1::Epoch> {
    let numbered = (1..=905).zip(reading::epochs(rover)).skip(899);
    numbered.map(|(seq, epoch)| convert::epoch_message(seq, &epoch)).collect()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn python_and_curl_read_the_same_solution() {
    let (Some(data), Some(python)) = (data::set("tst-2019"), python::with("grpc_tools")) else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let server = Server::start(&sqlite_url(&folder.path().join("clients.db")), free_port());
    let address = format!("127.0.0.1:{}", server.port);
    opened(&server.channel(), None).await;
    let epochs = epochs(&data.join("COM3_190428_124409.obs"));
    let file = folder.path().join("epochs.json");
    fs::write(&file, serde_json::to_string(&epochs).unwrap()).unwrap();

    let stubs = folder.path().join("stubs");
    fs::create_dir(&stubs).unwrap();
    let names =
        ["lists", "observation", "solution", "sessions", "positioning", "solutions", "navigation"];
    let proto = Path::new(env!("CARGO_MANIFEST_DIR")).join("proto");
    let mut generate = Command::new(&python);
    generate.args(["-m", "grpc_tools.protoc", "-I"]).arg(&proto);
    generate.arg(format!("--python_out={}", stubs.display()));
    generate.arg(format!("--grpc_python_out={}", stubs.display()));
    run(generate.args(names.map(|name| format!("graphfix/v1/{name}.proto"))));
    let client = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/support/python/client.py");
    let gps = data.join("hksc1180.19n");
    let mut asks = Command::new(&python);
    asks.arg(client).arg(&stubs).arg(&address).arg(&gps).arg(&file);
    let by_grpc: Value = serde_json::from_str(&run(&mut asks)).unwrap();

    // The same through the other door, with another session.
    let session = by_grpc["session"].as_str().unwrap();
    let list = |session: &str| {
        curl(&[&format!("http://{address}/v1/sessions/{session}/solutions")])["solutions"].take()
    };
    let by_rest = list(session);
    let seen: Vec<Value> = by_rest.as_array().unwrap().iter().map(as_python_prints).collect();
    assert_eq!(Value::from(seen), by_grpc["solutions"]);
    assert!(by_rest[0]["position"].is_object(), "no position: {}", by_rest[0]);

    let kind = "content-type: application/json";
    let create =
        ["-H", kind, "-d", "{\"label\": \"curl\"}", &format!("http://{address}/v1/sessions")];
    let own = curl(&create)["session"].as_str().unwrap().to_owned();
    let push = folder.path().join("push.json");
    fs::write(&push, json!({ "epochs": epochs }).to_string()).unwrap();
    let body = format!("@{}", push.display());
    let pushed =
        curl(&["-H", kind, "-d", &body, &format!("http://{address}/v1/sessions/{own}/epochs")]);
    assert_eq!(pushed["durableThrough"], 905, "{pushed}");
    assert_eq!(list(&own), by_rest, "the same epochs gave other solutions");
}

fn as_python_prints(solution: &Value) -> Value {
    let ecef = &solution["position"]["ecef"];
    let status = match solution["status"].as_str() {
        Some("SINGLE") => 2,
        Some("FGO") => 3,
        _ => 1,
    };
    json!({
        "seq": solution["seq"],
        "status": status,
        "ecef": [ecef["xM"], ecef["yM"], ecef["zM"]],
        "hash": solution["provenance"]["configurationHash"],
    })
}

/// Builds the wheel, installs it into a clean environment, and runs the client's own tests: among
/// them `kill -9` in the middle of streams.
#[test]
fn the_python_client_passes_its_tests() {
    // If the variable is not set, no Python with the packages of the client has been prepared.
    let Some(python) = python::with("grpc_tools") else { return };
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("scripts/client");
    let mut tests = Command::new(script);
    tests.arg(env!("CARGO_BIN_EXE_graphfix")).arg(env!("CARGO_TARGET_TMPDIR"));
    let output = tests.env("GRAPHFIX_TEST_PYTHON", python).output().unwrap();
    let [printed, errors] =
        [&output.stdout, &output.stderr].map(|text| String::from_utf8_lossy(text));
    assert!(output.status.success(), "{printed}{errors}");
    // pytest prints the number of tests that passed. No such line is a mistake of the script.
    assert!(printed.contains(" passed"), "{printed}");
}
