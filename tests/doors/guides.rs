//! The guides: their commands, run in their order in a folder of their own, as a newcomer would.

use std::path::Path;
use std::process::Command;

use crate::support::server::free_port;

/// Starts the service beside the other commands, and waits until it is ready.
const SERVE: &str = "graphfix serve --log error --listen 127.0.0.1:8080 & server=$!
trap 'kill $server' EXIT
for attempt in $(seq 300); do curl --silent --fail localhost:8080/readyz >ready && break; sleep 0.1; done";

/// The commands of a guide: its indented lines.
fn commands(guide: &str) -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/guides").join(guide);
    let text = std::fs::read_to_string(path).unwrap();
    let lines = text.lines().filter_map(|line| line.strip_prefix("    "));
    lines
        .map(|line| if line == "graphfix serve" { SERVE } else { line }.to_owned() + "\n")
        .collect()
}

/// Runs a guide with a port of its own, and returns what it prints.
fn tried(guide: &str) -> String {
    let port = free_port().to_string();
    let script = commands(guide)
        .replace("graphfix stream", "graphfix stream --server http://localhost:8080")
        .replace("graphfix load", "graphfix load --server http://localhost:8080")
        .replace("8080", &port);
    let folder = tempfile::tempdir().unwrap();
    let programs = Path::new(env!("CARGO_BIN_EXE_graphfix")).parent().unwrap();
    let path = format!("{}:{}", programs.display(), std::env::var("PATH").unwrap());
    let mut shell = Command::new("bash");
    shell.args(["-o", "errexit", "-o", "nounset", "-o", "pipefail", "-o", "xtrace", "-c", &script]);
    let output = shell.current_dir(&folder).env("PATH", path).output().unwrap();
    let [printed, errors] =
        [&output.stdout, &output.stderr].map(|text| String::from_utf8_lossy(text).into_owned());
    assert!(output.status.success(), "{guide}: {printed}\n{errors}");
    printed
}

/// What the guides name in capitals is a reason or a status of the program.
#[test]
fn the_reasons_of_the_guides_exist() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let vocabulary = std::fs::read_to_string(root.join("src/gnss/solution.rs")).unwrap();
    for guide in std::fs::read_dir(root.join("docs/guides")).unwrap() {
        let text = std::fs::read_to_string(guide.unwrap().path()).unwrap();
        let is_name = |word: &&str| {
            3 < word.len() && word.bytes().all(|byte| byte.is_ascii_uppercase() || byte == b'_')
        };
        // Every second part stands between back quotes.
        for name in text.split('`').skip(1).step_by(2).filter(is_name) {
            assert!(vocabulary.contains(&format!("\"{name}\"")), "{name}");
        }
    }
}

#[test]
fn a_surveyor_positions_files() {
    let printed = tried("surveyor.md");
    assert!(printed.contains("301 epochs, 301 answered"), "{printed}");
    assert!(printed.contains("written to rtk/track.kml"), "{printed}");
}

#[test]
fn a_device_sends_and_resumes() {
    let printed = tried("device.md");
    assert!(printed.contains("61 skipped as stored"), "{printed}");
    assert!(printed.contains("TOO_FEW_SATELLITES"), "{printed}");
}

#[test]
fn a_developer_reads_what_is_stored() {
    let printed = tried("developer.md");
    assert!(printed.contains("\"solutions\":["), "{printed}");
    assert!(printed.contains("SESSION_NOT_FOUND"), "{printed}");
}
