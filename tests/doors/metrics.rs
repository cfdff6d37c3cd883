//! `/metrics`: its counts, its format, which other programs read, and the names that the alert
//! rules and the dashboard for Grafana use.

use std::collections::{BTreeMap, BTreeSet};
use std::io::Write;
use std::process::{Command, Stdio};

use axum::body::Body;
use axum::http::{Request, StatusCode};
use graphfix::contract::v1;
use serde_json::json;
use tower::ServiceExt;

use crate::support::doors::{Doors, epoch};
use crate::support::pair::PAIR;
use crate::support::{flow, python};

use super::tenants::world;

async fn page(doors: &Doors) -> String {
    let request = Request::get("/metrics").body(Body::empty()).unwrap();
    let response = doors.router.clone().oneshot(request).await.unwrap();
    assert_eq!(response.status(), StatusCode::OK);
    let kind = response.headers()["content-type"].to_str().unwrap();
    assert!(kind.starts_with("application/openmetrics-text; version=1.0.0"), "{kind}");
    let body = axum::body::to_bytes(response.into_body(), usize::MAX).await.unwrap();
    String::from_utf8(body.to_vec()).unwrap()
}

/// Values of the lines by their name and labels, without the label of the node.
fn values(page: &str) -> BTreeMap<String, f64> {
    let lines = page.lines().filter(|line| !line.starts_with('#'));
    let value = |line: &str| {
        let (name, value) = line.rsplit_once(' ').unwrap();
        (without_node(name), value.parse().unwrap())
    };
    lines.map(value).collect()
}

fn without_node(name: &str) -> String {
    let Some((name, labels)) = name.split_once('{') else { return name.to_owned() };
    let labels = labels.trim_end_matches('}').split(',').filter(|l| !l.starts_with("node="));
    let labels: Vec<&str> = labels.collect();
    if labels.is_empty() { name.to_owned() } else { format!("{name}{{{}}}", labels.join(",")) }
}

#[tokio::test]
async fn epochs_stages_commits_and_requests_are_counted() {
    let doors = Doors::open().await;
    let before = values(&page(&doors).await);
    assert_eq!(before["graphfix_epochs_total{status=\"NONE\"}"], 0.0);
    let session = doors.session().await;
    let push = json!({ "epochs": [epoch(1), epoch(2), epoch(2)] });
    doors.post(&format!("/v1/sessions/{session}/epochs"), push).await;
    doors.get("/v1/nothing").await;
    let after = values(&page(&doors).await);
    let rise = |name: &str| after[name] - before.get(name).unwrap_or(&0.0);
    for (name, expected) in [
        ("graphfix_epochs_total{status=\"NONE\"}", 2.0),
        ("graphfix_epochs_total{status=\"FIXED\"}", 0.0),
        ("graphfix_stage_seconds_count{stage=\"waiting\"}", 1.0),
        ("graphfix_stage_seconds_count{stage=\"solving\"}", 1.0),
        ("graphfix_stage_seconds_count{stage=\"committing\"}", 1.0),
        ("graphfix_commits_total", 1.0),
        ("graphfix_commit_epochs_sum", 2.0),
        ("graphfix_requests_total{door=\"rest\",outcome=\"refused\"}", 1.0),
        ("graphfix_requests_total{door=\"rest\",outcome=\"failed\"}", 0.0),
        ("graphfix_failures_total", 0.0),
        ("graphfix_restores_total", 0.0), // There was nothing to load.
        ("graphfix_sessions_in_memory", 1.0),
    ] {
        assert_eq!(rise(name), expected, "{name}");
    }
    // The requests are the session, the push and the first page of metrics.
    assert_eq!(rise("graphfix_requests_total{door=\"rest\",outcome=\"answered\"}"), 3.0);
    assert_eq!(after["graphfix_committer_working"], 1.0);
    assert!(after["process_resident_memory_bytes"] > 1e6);
    assert!(after["graphfix_stage_seconds_sum{stage=\"committing\"}"] > 0.0);

    let doors = doors.restarted().await;
    let push = json!({ "epochs": [epoch(3)] });
    doors.post(&format!("/v1/sessions/{session}/epochs"), push).await;
    let restarted = values(&page(&doors).await);
    assert_eq!(restarted["graphfix_restores_total"], 1.0);
}

/// Refused epochs of every call are counted, whether an epoch is refused alone, with its push, or
/// before it is decoded.
#[tokio::test]
async fn refused_epochs_are_counted_by_whichever_call() {
    let doors = Doors::open().await;
    let session = doors.session().await;
    let path = format!("/v1/sessions/{session}/epochs");
    let counted = async || values(&page(&doors).await)["graphfix_epochs_refused_total"];
    doors.post(&path, json!({ "epochs": [epoch(1), epoch(5)] })).await;
    assert_eq!(counted().await, 0.0);

    let mut other = epoch(1);
    other["observations"][0]["pseudorangeM"] = json!(23_000_000.0);
    let (_, refused) = doors.post(&path, json!({ "epochs": [other] })).await;
    assert_eq!((&refused["code"], counted().await), (&json!("SEQUENCE_CONFLICT"), 1.0));
    doors.post(&path, json!({ "epochs": [epoch(2), epoch(5), epoch(6)] })).await;
    assert_eq!(counted().await, 2.0, "superseded");
    let mut malformed = epoch(7);
    malformed["observations"][0]["satellite"] = json!("X99");
    doors.post(&path, json!({ "epochs": [epoch(8), malformed] })).await;
    assert_eq!(counted().await, 4.0, "all of a push that is malformed");
    let absent = format!("/v1/sessions/ses_{}/epochs", "0".repeat(32));
    doors.post(&absent, json!({ "epochs": [epoch(1)] })).await;
    assert_eq!(counted().await, 5.0, "of no session");

    let opening = v1::StreamOpening { session: session.clone(), ..Default::default() };
    let mut stream = flow::epochs(doors.router.clone(), opening).await;
    stream.answer().await;
    let message = |value| serde_json::from_value::<v1::Epoch>(value).unwrap();
    stream.push(vec![message(epoch(3)), message(epoch(9))]).await;
    stream.until_durable(9).await;
    assert_eq!(counted().await, 6.0, "by a stream");
    let malformed = v1::Epoch { time: None, ..message(epoch(10)) };
    stream.push(vec![malformed, message(epoch(11))]).await;
    stream.refusal().await;
    assert_eq!(counted().await, 8.0, "with the message of a stream");

    let file = PAIR.base_file(Some(PAIR.position));
    let mut late = epoch(12);
    late["time"]["week"] = json!(2400);
    doors.post(&path, json!({ "epochs": [late] })).await;
    let raw = format!("/v1/sessions/{session}/raw?offset=0");
    let (status, answer) = doors.upload(&raw, file[..100_000].to_vec()).await;
    assert_eq!(status, StatusCode::OK, "{answer}");
    let results = answer["results"].as_array().unwrap();
    let are_late = results.iter().all(|result| result["refusal"]["code"] == "OUT_OF_ORDER");
    assert!(are_late, "{}", results[0]);
    assert!(!results.is_empty());
    assert_eq!(counted().await, 8.0 + results.len() as f64, "of raw bytes");
}

#[tokio::test]
async fn epochs_beyond_a_quota_are_counted_as_refused() {
    let doors = Doors::open().await;
    let operator = world::operator(&doors).await;
    let key = world::key_of(&doors, &operator, "a", "").await;
    let session = world::session(&doors, &key, json!({})).await;
    let quotas = json!({"quotas": {"epochsPerS": 0.0}});
    world::asked(&doors, &operator, "PUT", "/v1/tenants/a", quotas).await;
    let push = json!({ "epochs": [epoch(1), epoch(2)] });
    let path = format!("/v1/sessions/{session}/epochs");
    let (status, refused) = world::asked(&doors, &key, "POST", &path, push).await;
    assert_eq!(status, StatusCode::TOO_MANY_REQUESTS, "{refused}");
    assert_eq!(read_by(&doors, &operator).await["graphfix_epochs_refused_total"], 2.0);
}

/// The values of the page that a key reads.
async fn read_by(doors: &Doors, key: &world::Key) -> BTreeMap<String, f64> {
    let request = Request::get("/metrics").body(Body::empty()).unwrap();
    values(&world::sent(doors, key, request).await.text)
}

/// The page has the use of each tenant beside its quotas, and nothing of a tenant that does not
/// exist.
#[tokio::test]
async fn the_use_of_quotas_is_on_the_page() {
    let doors = Doors::open().await;
    let operator = world::operator(&doors).await;
    let limited = world::key_of(&doors, &operator, "limited", "").await;
    let free = world::key_of(&doors, &operator, "free", "").await;
    for key in [&limited, &free] {
        let session = world::session(&doors, key, json!({})).await;
        let path = format!("/v1/sessions/{session}/epochs");
        let push = json!({ "epochs": [epoch(1), epoch(2)] });
        assert_eq!(world::asked(&doors, key, "POST", &path, push).await.0, StatusCode::OK);
    }
    for key in [&limited, &free] {
        let upload = Request::post("/v1/uploads").header("tus-resumable", "1.0.0");
        let upload = upload.header("upload-length", 1_234).body(Body::empty()).unwrap();
        assert_eq!(world::sent(&doors, key, upload).await.status, StatusCode::CREATED);
    }
    let absent = "/v1/tenants/absent";
    world::asked(&doors, &operator, "GET", absent, json!(null)).await;
    let quotas = json!({"sessions": 7, "epochsPerS": 100.0, "cpuSPerMinute": 30.0,
                        "storedBytes": 1_000_000, "jobBytes": 5_000});
    let quotas = json!({ "quotas": quotas });
    let (status, set) = world::asked(&doors, &operator, "PUT", "/v1/tenants/limited", quotas).await;
    assert_eq!(status, StatusCode::OK, "{set}");
    let page = read_by(&doors, &operator).await;
    let of = |name: &str, tenant: &str| {
        page.get(&format!("graphfix_tenant_{name}{{tenant=\"{tenant}\"}}")).copied()
    };
    for (name, limit) in [
        ("sessions", 7.0),
        ("epochs_per_second", 100.0),
        ("cpu_seconds_per_minute", 30.0),
        ("stored_bytes", 1e6),
        ("job_bytes", 5e3),
    ] {
        assert_eq!(of(&format!("{name}_limit"), "limited"), Some(limit), "{name}");
        assert_eq!(of(&format!("{name}_limit"), "free"), None, "{name}");
        assert_eq!(of(name, "absent"), None, "{name}");
    }
    assert_eq!((of("sessions", "limited"), of("sessions", "free")), (Some(1.0), None));
    assert!(0.0 < of("stored_bytes", "limited").unwrap());
    assert_eq!((of("job_bytes", "limited"), of("job_bytes", "free")), (Some(1_234.0), None));
    assert!(0.0 < of("epochs_per_second", "free").unwrap());
    assert!(100.0 < page["graphfix_received_bytes_total"]);
    assert!(100.0 < page["graphfix_committed_bytes_total"]);
}

/// The parser of Prometheus's own Python client takes the page.
#[tokio::test]
async fn a_foreign_parser_reads_the_page() {
    let Some(python) = python::with("prometheus_client") else { return };
    let doors = Doors::open().await;
    let script = "import sys\n\
                  from prometheus_client.openmetrics.parser import text_string_to_metric_families\n\
                  families = list(text_string_to_metric_families(sys.stdin.read()))\n\
                  print(' '.join(sorted(family.name for family in families)))";
    let mut command = Command::new(python);
    command.args(["-c", script]).stdin(Stdio::piped()).stdout(Stdio::piped());
    let mut child = command.stderr(Stdio::inherit()).spawn().unwrap();
    child.stdin.take().unwrap().write_all(page(&doors).await.as_bytes()).unwrap();
    let output = child.wait_with_output().unwrap();
    assert!(output.status.success());
    let names = String::from_utf8(output.stdout).unwrap();
    for name in ["graphfix_build", "graphfix_epochs", "graphfix_stage_seconds", "process_cpu"] {
        assert!(names.split_whitespace().any(|found| found.starts_with(name)), "{names}");
    }
}

/// Names of meters in a text: those of this service, and those of the process.
fn named(text: &str) -> BTreeSet<String> {
    let words = text.split(|c: char| !c.is_ascii_alphanumeric() && c != '_');
    let is_meter = |word: &&str| word.starts_with("graphfix_") || word.starts_with("process_");
    words.filter(is_meter).map(str::to_owned).collect()
}

#[tokio::test]
async fn rules_and_dashboard_name_what_is_there() {
    let doors = Doors::open().await;
    doors.session().await;
    let push = json!({ "epochs": [epoch(1)] });
    let session = doors.session().await;
    doors.post(&format!("/v1/sessions/{session}/epochs"), push).await;
    let lines = page(&doors).await;
    let there: BTreeSet<String> = values(&lines)
        .into_keys()
        .map(|name| name.split('{').next().unwrap_or_default().to_owned())
        .collect();
    let rules = include_str!("../../docs/alerts.yml");
    let dashboard = include_str!("../../docs/grafana.json");
    for (text, least) in [(rules, 10), (dashboard, 25)] {
        let named = named(text);
        assert!(least <= named.len(), "{named:?}");
        let missing: Vec<_> = named.difference(&there).collect();
        assert!(missing.is_empty(), "{missing:?} are not on the page");
    }
    // Every rule has its section, and the operator's manual explains every meter.
    let manual = include_str!("../../docs/operations.md");
    for rule in rules.lines().filter_map(|line| line.trim().strip_prefix("- alert: ")) {
        assert!(manual.contains(&format!("### {rule}\n")), "{rule} has no section");
        let link = format!("docs/operations.md#{}", rule.to_lowercase());
        assert!(rules.contains(&link), "{link}");
    }
    for name in there.iter().filter(|name| !name.ends_with("_sum") && !name.ends_with("_count")) {
        let name = name.trim_end_matches("_bucket");
        assert!(manual.contains(&format!("`{name}`")), "{name} is not explained");
    }
}
