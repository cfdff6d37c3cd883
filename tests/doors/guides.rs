//! The guides: their commands run in order, in a folder of their own, as a new user would run them.

use std::path::Path;
use std::process::Command;

use crate::support::python;
use crate::support::server::free_port;

/// Starts the service beside the other commands, and waits until it is ready.
const SERVE: &str = "graphfix serve --log error --listen 127.0.0.1:8080 & server=$!
trap 'kill $server' EXIT
for attempt in $(seq 300); do curl --silent --fail localhost:8080/readyz >ready && break; sleep 0.1; done";

/// The same for the operator's guide, where it also stops the service that runs.
const SERVE_TLS: &str = "[ -z \"${server:-}\" ] || { kill $server; wait $server; }
graphfix serve --config graphfix.toml --log error & server=$!
trap 'kill $server' EXIT
for attempt in $(seq 300); do
    curl --silent --fail --cacert ca.pem https://localhost:8443/readyz >ready && break; sleep 0.1
done";

/// Installs the Python client as its wheel would be, without a package index: its sources, and what
/// `PYTHON` generates of the schema.
const PYTHON_CLIENT: &str = r#"mkdir --parents device/bin
cp --recursive "$graphfix/clients/python/src/graphfix" device/graphfix
(cd "$graphfix/proto" && PYTHON -m grpc_tools.protoc -I . --python_out="$OLDPWD/device" \
    --grpc_python_out="$OLDPWD/device" $(find . -name '*.proto'))
printf '#!/bin/sh\nPYTHONPATH=%s exec PYTHON "$@"\n' "$PWD/device" >device/bin/python
chmod +x device/bin/python"#;

/// The commands of a guide: its indented lines, some of them in another form.
fn commands(guide: &str, other_forms: &[(&str, &str)]) -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/guides").join(guide);
    let text = std::fs::read_to_string(path).unwrap();
    let lines: Vec<&str> = text.lines().filter_map(|line| line.strip_prefix("    ")).collect();
    for (line, _) in other_forms {
        assert!(lines.contains(line), "{guide} has no line {line:?} any more");
    }
    let form = |line: &str| other_forms.iter().find(|(ours, _)| *ours == line).map(|form| form.1);
    lines.iter().map(|line| form(line).unwrap_or(line).to_owned() + "\n").collect()
}

/// Runs a guide for a service of this machine, and returns what it prints.
fn tried(guide: &str, other_forms: &[(&str, &str)]) -> String {
    let script = commands(guide, other_forms)
        .replace("graphfix stream", "graphfix stream --server http://localhost:8080")
        .replace("graphfix load", "graphfix load --server http://localhost:8080");
    run(guide, &script)
}

/// Runs commands with a port of their own, and returns what they print.
fn run(guide: &str, script: &str) -> String {
    let port = free_port().to_string();
    let script = script.replace("8080", &port).replace("8443", &port);
    let folder = tempfile::tempdir().unwrap();
    let programs = Path::new(env!("CARGO_BIN_EXE_graphfix")).parent().unwrap();
    let path = format!("{}:{}", programs.display(), std::env::var("PATH").unwrap());
    let mut shell = Command::new("bash");
    shell.args(["-o", "errexit", "-o", "nounset", "-o", "pipefail", "-o", "xtrace", "-c", &script]);
    shell.current_dir(&folder).env("PATH", path).env("graphfix", env!("CARGO_MANIFEST_DIR"));
    let output = shell.output().unwrap();
    let [printed, errors] =
        [&output.stdout, &output.stderr].map(|text| String::from_utf8_lossy(text).into_owned());
    assert!(output.status.success(), "{guide}: {printed}\n{errors}");
    printed
}

/// Names in capitals in the guides are reasons, statuses or codes of the program.
#[test]
fn the_reasons_and_codes_of_the_guides_exist() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let vocabulary = std::fs::read_to_string(root.join("compute/src/gnss/solution.rs")).unwrap();
    let codes = std::fs::read_to_string(root.join("docs/errors.md")).unwrap();
    for guide in std::fs::read_dir(root.join("docs/guides")).unwrap() {
        let text = std::fs::read_to_string(guide.unwrap().path()).unwrap();
        let is_name = |word: &&str| {
            3 < word.len() && word.bytes().all(|byte| byte.is_ascii_uppercase() || byte == b'_')
        };
        // Every second part is between back quotes.
        for name in text.split('`').skip(1).step_by(2).filter(is_name) {
            let is_known = vocabulary.contains(&format!("\"{name}\""))
                || codes.contains(&format!("| `{name}` |"));
            assert!(is_known, "{name}");
        }
    }
}

#[test]
fn a_surveyor_positions_files() {
    let printed = tried("surveyor.md", &[]);
    assert!(printed.contains("301 epochs, 301 answered"), "{printed}");
    assert!(printed.contains("written to rtk/track.kml"), "{printed}");
}

#[test]
fn a_device_sends_and_resumes() {
    let printed = tried("device.md", &[("graphfix serve", SERVE)]);
    assert!(printed.contains("61 skipped as stored"), "{printed}");
    assert!(printed.contains("TOO_FEW_SATELLITES"), "{printed}");
}

#[test]
fn a_developer_reads_what_is_stored() {
    let printed = tried("developer.md", &[("graphfix serve", SERVE)]);
    assert!(printed.contains("\"solutions\":["), "{printed}");
    assert!(printed.contains("SESSION_NOT_FOUND"), "{printed}");
}

#[test]
fn an_operator_serves_two_tenants() {
    let Some(python) = python::with("grpc_tools, grpc_status") else { return };
    let client = PYTHON_CLIENT.replace("PYTHON ", &format!("{python} "));
    let printed = tried(
        "operator.md",
        &[
            ("graphfix serve --config graphfix.toml", SERVE_TLS),
            ("python3 -m venv device", &client),
            ("device/bin/pip install --quiet \"$graphfix/clients/python\"", "true"),
        ],
    );
    assert!(printed.contains("with 26 satellites"), "{printed}");
    // Another tenant asks for the first one's data, and gets none.
    assert!(printed.contains("{\"heads\":[],"), "{printed}");
    assert!(printed.contains("SESSION_NOT_FOUND"), "{printed}");
    assert!(printed.contains("SESSION_QUOTA_EXCEEDED"), "{printed}");
    assert!(printed.contains(" 0 different"), "{printed}");
    assert!(printed.contains("KEY_REVOKED"), "{printed}");
    // The end of the certificate, first that of a year, then that of three months.
    let ends: Vec<u64> = printed
        .lines()
        .filter(|line| line.starts_with("graphfix_tls_certificate_expiry_seconds"))
        .filter_map(|line| line.rsplit_once(' ')?.1.parse().ok())
        .collect();
    assert!(matches!(ends[..], [first, last] if last < first), "{printed}");
}

/// A service with what the calls of the pages name: a session, two bases and a job that has ended.
const PREPARED: &str = r#"curl() {
    command curl --silent --show-error --fail-with-body --output-dir "$(mktemp -d -p .)" $limit "$@"
}
limit=""
graphfix simulate --scenario rtk-open --seed 1 --duration 60 --output rtk
ln -s rtk sim
cp rtk/base.obs base.obs
graphfix serve --log error --listen 127.0.0.1:8080 --fetch-host '*.example.org' & server=$!
trap 'kill $server' EXIT
for attempt in $(seq 300); do curl localhost:8080/readyz >ready && break; sleep 0.1; done
curl localhost:8080/v1/navigation -H 'content-type: application/octet-stream' \
    --data-binary @rtk/navigation.rnx
graphfix stream --server http://localhost:8080 --rover rtk/rover.obs --mode fgo --speed max
found() { grep -o -m 1 "$1_[0-9a-f]*" | sed 1q; }
session=$(curl localhost:8080/v1/sessions | found ses)
json='content-type: application/json'
SECRET=whsec_$(openssl rand -base64 32)
base=$(curl localhost:8080/v1/bases -H "$json" -d '{"label": "one"}' | found bas)
other=$(curl localhost:8080/v1/bases -H "$json" -d '{"label": "other"}' | found bas)
job=$(curl localhost:8080/v1/jobs -F rover=@rtk/rover.obs -F 'options={"mode": "spp"}' |
    found job)
curl "localhost:8080/v1/jobs/$job/events" >events
GRAPHFIX_KEY=gfx_
while IFS= read -r line; do
    line=${line//ses_…/$session} line=${line//job_…/$job}
    line=${line/bas_…/$base} line=${line/bas_…/$other}
    # A watch of the fleet has no end.
    limit=""; [[ $line != *sessions:watch* ]] || limit="--max-time 1"
    eval "$line" </dev/null || [ -n "$limit" ]
done <<'END'
"#;

/// Every `curl` command of the README and of the pages of `docs/`, on one line each.
fn calls() -> Vec<String> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let pages = std::fs::read_dir(root.join("docs")).unwrap().map(|entry| entry.unwrap().path());
    let pages = pages.chain([root.join("README.md")]);
    let pages = pages.filter(|path| path.extension().is_some_and(|extension| extension == "md"));
    let text: String = pages.map(|path| std::fs::read_to_string(path).unwrap()).collect();
    let joined = text.replace("\\\n", " ");
    let calls = joined.lines().filter(|line| line.starts_with("    curl "));
    calls.map(|line| line.trim().to_owned()).collect()
}

/// Every call on a page is answered as printed there, with ids in place of dots.
#[test]
fn the_calls_of_the_pages_are_answered() {
    // These calls need an antenna calibration or a receiver's recording.
    let is_left_out = |call: &String| call.contains("antenna") || call.contains("chunk.ubx");
    let (left_out, calls): (Vec<String>, Vec<String>) = calls().into_iter().partition(is_left_out);
    assert_eq!(left_out.len(), 2, "{left_out:?}");
    assert!(30 <= calls.len(), "{calls:?}");
    let printed = run("pages", &format!("{PREPARED}{}\nEND\n", calls.join("\n")));
    assert!(printed.contains("\"state\":\"SUCCEEDED\""), "{printed}");
    assert!(printed.contains("\"quotas\":{\"sessions\":500"), "{printed}");
}
