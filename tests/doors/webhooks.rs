//! Webhooks of batch jobs: a signed message reports the end of a job, and is repeated until the
//! host accepts it.

use std::io::Write;
use std::process::{Command, Stdio};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use axum::body::Body;
use axum::http::{Request, StatusCode};
use graphfix::app;
use graphfix::config::{FetchConfiguration, JobsConfiguration, ServiceConfiguration};
use graphfix::contract::v1;
use graphfix::grpc::v1::jobs_client::JobsClient;
use graphfix::store::{DeliveryAttempt, DeliveryEnd, JobEnd, WebhookState};
use graphfix::tenant::Tenant;
use serde_json::{Value, json};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tower::ServiceExt;

use crate::support::casters::{BRISK, HostileCaster, PATIENCE, answer};
use crate::support::database::{Database, on_both_databases};
use crate::support::doors::{Doors, code};
use crate::support::jobs::{BOUNDARY, LONG, MINUTE, body};
use crate::support::python;
use crate::support::server::free_port;

use super::jobs::{all_turns, created, ended, new_job, post};

on_both_databases!(
    each_attempt_is_made_once,
    a_webhook_is_told_until_it_answers,
    a_step_of_the_clock_loses_no_message,
);

const SECRET: &str = "whsec_MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSw";

/// Checks a signature with another program: head and body of a message on its input.
const VERIFY: &str = "
import base64, hashlib, hmac, sys
head, body = sys.stdin.buffer.read().split(b'\\r\\n\\r\\n', 1)
lines = [line.split(b':', 1) for line in head.split(b'\\r\\n')[1:]]
fields = {name.strip().lower(): value.strip() for name, value in lines}
key = base64.b64decode(sys.argv[1].removeprefix('whsec_'))
signed = b'.'.join([fields[b'webhook-id'], fields[b'webhook-timestamp'], body])
digest = base64.b64encode(hmac.new(key, signed, hashlib.sha256).digest())
assert fields[b'webhook-signature'] == b'v1,' + digest, fields
print(fields[b'webhook-id'].decode())
";

/// What came to a host: head and body of each message.
type Messages = Arc<Mutex<Vec<(String, String)>>>;

/// A host that takes messages and gives `answers` in order, the last one for all that follow.
async fn host(answers: Vec<Vec<u8>>) -> (HostileCaster, Messages) {
    let messages = Messages::default();
    let (kept, answers) = (messages.clone(), Arc::new(answers));
    let host = HostileCaster::start(move |number, mut stream, head| {
        let (kept, answers) = (kept.clone(), answers.clone());
        async move {
            let length = head.to_ascii_lowercase();
            let length = length.split("content-length: ").nth(1).unwrap();
            let length = length.split("\r\n").next().unwrap().parse().unwrap();
            let mut body = vec![0; length];
            stream.read_exact(&mut body).await.unwrap();
            kept.lock().unwrap().push((head, String::from_utf8(body).unwrap()));
            stream.write_all(&answers[number.min(answers.len() - 1)]).await.ok();
            stream.shutdown().await.ok();
        }
    });
    (host.await, messages)
}

fn verify((head, body): &(String, String)) -> String {
    let python = python::with("hmac").expect("Python has hmac");
    let mut child = Command::new(python)
        .args(["-c", VERIFY, SECRET])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut input = child.stdin.take().unwrap();
    input.write_all(format!("{head}{body}").as_bytes()).unwrap();
    drop(input);
    let output = child.wait_with_output().unwrap();
    assert!(output.status.success(), "{head}{body}");
    String::from_utf8(output.stdout).unwrap().trim().to_owned()
}

fn webhook(port: u16) -> Value {
    json!({"url": format!("http://127.0.0.1:{port}/hooks?of=jobs"), "secret": SECRET})
}

fn quick() -> JobsConfiguration {
    JobsConfiguration { webhook_delay_s: 1, ..JobsConfiguration::standard() }
}

/// The attempts, once no further one follows.
async fn told(doors: &Doors, job: &str) -> Value {
    let path = format!("/v1/jobs/{job}/deliveries");
    doors.until(&path, |told| told["state"] != "WAITING").await
}

async fn a_webhook_is_told_until_it_answers(database: Database) {
    let doors = Doors::on_with_jobs(&database.url, quick()).await;
    let late = answer("503 Later\r\nRetry-After: 1\r\nContent-Length: 0", b"");
    let taken = answer("202 Accepted\r\nContent-Length: 2", b"ok");
    let (host, messages) = host(vec![late, b"no HTTP\r\n\r\n".to_vec(), taken]).await;
    let options = json!({"mode": "spp", "webhook": webhook(host.port)});
    let job = created(&doors, MINUTE.body(&options)).await;
    let told = told(&doors, &job).await;
    assert_eq!(told["state"], "DELIVERED", "{told}");
    let attempts = told["deliveries"].as_array().unwrap();
    let shown = attempts.iter().map(|attempt| {
        assert!(!attempt["endedUtc"].as_str().unwrap().is_empty(), "{attempt}");
        (attempt["attempt"].as_u64(), attempt["httpStatus"].as_u64(), attempt["code"].as_str())
    });
    assert_eq!(
        shown.collect::<Vec<_>>(),
        [
            (Some(1), Some(503), Some("HOST_REFUSES")),
            (Some(2), None, Some("HOST_PROTOCOL")),
            (Some(3), Some(202), Some("")),
        ]
    );
    assert_eq!((&told["nextUtc"], &told["url"]), (&json!(""), &webhook(host.port)["url"]));

    let messages = messages.lock().unwrap().clone();
    assert_eq!(messages.len(), 3, "{messages:?}");
    for message in &messages {
        assert_eq!(verify(message), job);
        assert!(message.0.starts_with("POST /hooks?of=jobs HTTP/1.1\r\n"), "{message:?}");
        assert_eq!(message.1, messages[0].1);
    }
    let (_, shown) = doors.get(&format!("/v1/jobs/{job}")).await;
    let path = format!("/v1/jobs/{job}");
    let links = json!({
        "job": path, "result": format!("{path}/result"), "report": format!("{path}/report")
    });
    let data = json!({"job": job, "state": "SUCCEEDED", "failure": null, "links": links});
    let expected = json!({"type": "job.ended", "timestamp": shown["endedUtc"], "data": data});
    assert_eq!(serde_json::from_str::<Value>(&messages[0].1).unwrap(), expected);
    // No answer contains the secret.
    assert_eq!(shown["webhookState"], "DELIVERED");
    assert!(!shown.to_string().contains("whsec_"), "{shown}");

    let mut client = JobsClient::new(doors.router.clone());
    let request = v1::GetJobRequest { job: job.clone() };
    let by_grpc = client.deliveries(request).await.unwrap().into_inner();
    assert_eq!(serde_json::to_value(&by_grpc).unwrap(), told);
    doors.close().await;
}

/// The clock of the service was two days ahead for a time. The age of a message is that of the time
/// by which all expires, and a message that is due two days later is due now.
async fn a_step_of_the_clock_loses_no_message(database: Database) {
    let now = "(SELECT MAX(created_unix_ms) FROM jobs)";
    let two_days = 2 * 86_400_000_i64;
    let store = database.store().await;
    store.close().await;
    // The time by which all expires is two days behind the clock, as after a step.
    let unix_ms = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap();
    let counted = unix_ms.as_millis() as i64 - two_days;
    database.execute(&format!("UPDATE expiry_clock SET unix_ms = {counted}")).await;
    let doors = Doors::on_with_jobs(&database.url, quick()).await;
    let late = answer("503 Later\r\nContent-Length: 0", b"");
    let taken = answer("204 No Content", b"");
    let (host, messages) = host(vec![late.clone(), late, taken]).await;
    let turns = all_turns(&doors).await;
    let options = json!({"mode": "spp", "webhook": webhook(host.port)});
    let job = created(&doors, MINUTE.body(&options)).await;
    // It ends before the step, and the message is due by the clock that is ahead.
    database
        .execute(&format!(
            "UPDATE jobs SET state = 'CANCELLED', ended_unix_ms = {now} - {two_days}, \
             webhook_due_unix_ms = {now} + {two_days}"
        ))
        .await;
    let told = told(&doors, &job).await;
    assert_eq!(told["state"], "DELIVERED", "{told}");
    assert_eq!(messages.lock().unwrap().len(), 3, "{told}");
    drop(turns);
    doors.close().await;
}

#[tokio::test]
async fn a_job_without_webhook_and_a_missing_one_have_no_deliveries() {
    let doors = Doors::with_jobs(quick()).await;
    let job = created(&doors, MINUTE.body(&json!({"mode": "spp"}))).await;
    let (status, none) = doors.get(&format!("/v1/jobs/{job}/deliveries")).await;
    let expected = json!({"job": job, "url": "", "state": "", "deliveries": [], "nextUtc": ""});
    assert_eq!((status, none), (StatusCode::OK, expected));
    let path = format!("/v1/jobs/job_{}/deliveries", "0".repeat(32));
    let (status, problem) = doors.get(&path).await;
    assert_eq!((status.as_u16(), code(&problem)), (404, "JOB_NOT_FOUND"));
}

/// Attempts are bounded, redirections are not followed, and a host that is gone is left alone.
#[tokio::test]
async fn a_message_that_no_host_takes_is_given_up() {
    let limits = JobsConfiguration { webhook_attempts: 2, ..quick() };
    let doors = Doors::with_jobs(limits).await;
    let (elsewhere, others) = host(vec![answer("200 OK", b"")]).await;
    let to = format!("307 There\r\nLocation: http://127.0.0.1:{}/", elsewhere.port);
    let (redirecting, messages) = host(vec![answer(&to, b"")]).await;
    let (gone, _) = host(vec![answer("410 Gone", b"")]).await;
    let silent = HostileCaster::start(|_, mut stream, _| async move {
        stream.read_to_end(&mut Vec::new()).await.ok();
    });
    let silent = silent.await;
    for (port, expected, attempts) in [
        (redirecting.port, "HOST_REDIRECTS", 2),
        (gone.port, "HOST_REFUSES", 1),
        (silent.port, "HOST_SLOW", 2),
        (free_port(), "HOST_UNREACHABLE", 2),
    ] {
        let options = json!({"mode": "spp", "webhook": webhook(port)});
        let files = [("rover", &b"no observations"[..]), ("navigation", b"none")];
        let options = options.to_string();
        let parts = [files[0], files[1], ("options", options.as_bytes())];
        let job = created(&doors, body(&parts)).await;
        let told = told(&doors, &job).await;
        assert_eq!(told["state"], "FAILED", "{told}");
        let deliveries = told["deliveries"].as_array().unwrap();
        assert_eq!(deliveries.len(), attempts, "{told}");
        assert!(deliveries.iter().all(|attempt| attempt["code"] == expected), "{told}");
        assert_eq!(told["nextUtc"], "");
    }
    assert_eq!(others.lock().unwrap().len(), 0, "a redirection was followed");
    let (_, body) = messages.lock().unwrap()[0].clone();
    let body: Value = serde_json::from_str(&body).unwrap();
    assert_eq!(body["data"]["state"], "FAILED", "{body}");
    assert_eq!(body["data"]["failure"], "FILE_NOT_UNDERSTOOD", "{body}");
}

/// Due messages are in the store, so a service that starts again continues the attempts.
#[tokio::test]
async fn a_restart_goes_on_with_the_attempts() {
    let doors = Doors::with_jobs(quick()).await;
    let port = free_port();
    let turns = all_turns(&doors).await;
    let options = json!({"mode": "rtk-fgo", "webhook": webhook(port)});
    let job = created(&doors, LONG.body(&options)).await;
    let path = format!("/v1/jobs/{job}/deliveries");
    let (_, early) = doors.get(&path).await;
    assert_eq!((&early["state"], &early["nextUtc"]), (&json!("WAITING"), &json!("")), "{early}");
    // A cancellation by a user is also reported.
    doors.send("DELETE", &format!("/v1/jobs/{job}"), json!({})).await;
    let has_tried = |told: &Value| {
        told["deliveries"].as_array().is_some_and(|attempts| !attempts.is_empty())
            && !told["nextUtc"].as_str().unwrap().is_empty()
    };
    doors.until(&path, has_tried).await;
    drop(turns);
    let doors = doors.restarted().await;
    let listener = tokio::net::TcpListener::bind(("127.0.0.1", port)).await.unwrap();
    let (mut stream, _) = listener.accept().await.unwrap();
    let mut head = [0; 4096];
    let length = stream.read(&mut head).await.unwrap();
    stream.write_all(b"HTTP/1.1 204 No Content\r\n\r\n").await.unwrap();
    let head = String::from_utf8_lossy(&head[..length]).into_owned();
    let told = told(&doors, &job).await;
    assert_eq!(told["state"], "DELIVERED", "{told}");
    let attempts = told["deliveries"].as_array().unwrap();
    let numbers = attempts.iter().map(|attempt| attempt["attempt"].as_u64().unwrap());
    assert!(numbers.eq(1..=attempts.len() as u64) && 2 <= attempts.len(), "{told}");
    assert_eq!(attempts[0]["code"], "HOST_UNREACHABLE");
    assert!(head.contains(&job), "{head}");
    assert_eq!(ended(&doors, &job).await["state"], "CANCELLED");
}

#[tokio::test]
async fn what_is_no_webhook_is_refused() {
    let doors = Doors::with_jobs(quick()).await;
    let with = |url: &str, secret: &str| {
        MINUTE.body(&json!({"mode": "spp", "webhook": {"url": url, "secret": secret}}))
    };
    let here = "http://127.0.0.1:9/";
    for (url, secret, status, expected, field) in [
        ("ftp://127.0.0.1/", SECRET, 400, "LOCATION_INVALID", "options.webhook.url"),
        ("", SECRET, 400, "LOCATION_INVALID", "options.webhook.url"),
        ("http://a@127.0.0.1/", SECRET, 400, "LOCATION_INVALID", "options.webhook.url"),
        ("https://elsewhere.example/", SECRET, 409, "HOST_NOT_ALLOWED", "options.webhook.url"),
        ("http://169.254.169.254/", SECRET, 409, "HOST_NOT_ALLOWED", "options.webhook.url"),
        (here, "", 400, "INVALID_FIELD", "options.webhook.secret"),
        (here, "whsec_c2hvcnQ=", 400, "INVALID_FIELD", "options.webhook.secret"),
    ] {
        let (answered, problem) = post(&doors, with(url, secret), &[]).await;
        let got = (answered.as_u16(), code(&problem), problem["field"].as_str());
        assert_eq!(got, (status, expected, Some(field)), "{problem}");
    }
    assert_eq!(doors.get("/v1/jobs").await.1["jobs"], json!([]));

    let named = [("idempotency-key", "told")];
    let (status, first) = post(&doors, with(here, SECRET), &named).await;
    assert_eq!(status, StatusCode::CREATED, "{first}");
    let (status, again) = post(&doors, with(here, SECRET), &named).await;
    assert_eq!((status, &again["job"]), (StatusCode::OK, &first["job"]));
    let other = "whsec_AAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAA";
    for changed in [with(here, other), with("http://127.0.0.1:8/", SECRET)] {
        let (_, refused) = post(&doors, changed, &named).await;
        assert_eq!(code(&refused), "IDEMPOTENCY_CONFLICT", "{refused}");
    }
}

/// A listed name whose address is not public is contacted only if the operator allows it.
#[tokio::test]
async fn a_webhook_does_not_lead_into_the_operators_network() {
    let folder = tempfile::tempdir().unwrap();
    let (host, messages) = host(vec![answer("200 OK", b"")]).await;
    let configuration = ServiceConfiguration {
        database: format!("sqlite://{}", folder.path().join("a.db").display()),
        fetch: FetchConfiguration {
            hosts: vec!["localhost".to_owned()],
            ..ServiceConfiguration::standard().fetch
        },
        jobs: JobsConfiguration { webhook_attempts: 1, ..quick() },
        ..ServiceConfiguration::standard()
    };
    let app = app::open(&configuration, PATIENCE, BRISK).await.unwrap();
    let router = graphfix::http::router(app.service());
    let ask = async |request: Request<Body>| -> Value {
        let response = router.clone().oneshot(request).await.unwrap();
        let bytes = axum::body::to_bytes(response.into_body(), usize::MAX).await.unwrap();
        serde_json::from_slice(&bytes).unwrap()
    };
    let url = format!("http://localhost:{}/", host.port);
    let options = json!({"mode": "spp", "webhook": {"url": url, "secret": SECRET}});
    let kind = format!("multipart/form-data; boundary={BOUNDARY}");
    let create = Request::post("/v1/jobs").header("content-type", kind);
    let job = ask(create.body(Body::from(MINUTE.body(&options))).unwrap()).await;
    let path = format!("/v1/jobs/{}/deliveries", job["job"].as_str().unwrap());
    let told = crate::support::wait::until(
        "told",
        async || ask(Request::get(&path).body(Body::empty()).unwrap()).await,
        |told: &Value| told["state"] == "FAILED",
    );
    let told = told.await;
    assert_eq!(told["deliveries"][0]["code"], "ADDRESS_REFUSED", "{told}");
    assert_eq!(messages.lock().unwrap().len(), 0);
    app.close().await;
}

async fn each_attempt_is_made_once(database: Database) {
    let (store, tenant) = (database.store().await, Tenant::operator());
    let new = |id| graphfix::store::NewJob {
        webhook_secret: Some("secret".to_owned()),
        ..new_job(id, None)
    };
    let waiting = store.create_job(&new("waiting")).await.unwrap().0;
    assert_eq!(waiting.webhook_state, Some(WebhookState::Waiting));
    assert_eq!(store.create_job(&new_job("silent", None)).await.unwrap().0.webhook_state, None);
    // Before the end of the job nothing is due.
    assert!(store.begin_delivery(&tenant, 1000, 2000).await.unwrap().is_none());
    assert!(store.tenants_with_due_webhooks(1000).await.unwrap().is_empty());
    let claimed = store.claim_job("node", Duration::from_secs(60)).await.unwrap().unwrap();
    assert_eq!(claimed.id, "waiting");
    let failed = JobEnd::Failed { failure: "{}".to_owned() };
    assert!(store.end_job(claimed.claim(), &failed, 1100).await.unwrap());
    assert!(store.cancel_job(&tenant, "silent", 1100).await.unwrap());

    let due = store.tenants_with_due_webhooks(1200).await.unwrap();
    assert_eq!(due, std::slice::from_ref(&tenant));
    let begin = async |now| store.begin_delivery(&tenant, now, now + 500).await.unwrap();
    let (a, b) = tokio::join!(begin(1200), begin(1200));
    assert!(a.is_some() != b.is_some(), "an attempt is made twice");
    let first = a.or(b).unwrap();
    assert_eq!((first.job.id.as_str(), first.attempt, &*first.secret), ("waiting", 1, "secret"));
    // The first attempt is not ended, so the next one begins later. A late end of the first then
    // changes nothing.
    assert!(begin(1699).await.is_none());
    let second = begin(1700).await.unwrap();
    assert_eq!(second.attempt, 2);
    let attempt = |number, ended_unix_ms, failure: Option<&str>| DeliveryAttempt {
        number,
        begun_unix_ms: if number == 1 { 1200 } else { 1700 },
        ended_unix_ms,
        http_status: Some(503),
        failure: failure.map(|code| (code.to_owned(), "why".to_owned())),
    };
    let late = attempt(1, Some(1750), None);
    store.end_delivery(first.job.key, &late, DeliveryEnd::Delivered).await.unwrap();
    let (attempts, due) = store.deliveries(first.job.key).await.unwrap();
    let unended = DeliveryAttempt { http_status: None, failure: None, ..attempt(2, None, None) };
    assert_eq!((attempts, due), (vec![late.clone(), unended], Some(2200)));
    let refused = attempt(2, Some(1800), Some("HOST_REFUSES"));
    let again = DeliveryEnd::Again { due_unix_ms: 3000 };
    store.end_delivery(first.job.key, &refused, again).await.unwrap();
    assert!(begin(2999).await.is_none());
    assert_eq!(store.give_up_webhooks(2999, 2, 0).await.unwrap(), 0);
    assert_eq!(store.give_up_webhooks(3000, 3, 1100).await.unwrap(), 0);
    assert_eq!(store.give_up_webhooks(3000, 3, 1101).await.unwrap(), 1);
    let row = store.job(&tenant, "waiting").await.unwrap().unwrap();
    assert_eq!(row.webhook_state, Some(WebhookState::Failed));
    assert_eq!(store.deliveries(row.key).await.unwrap(), (vec![late, refused], None));
    // The attempts are removed with the job.
    assert_eq!(store.delete_jobs(1101).await.unwrap(), 2);
    assert_eq!(store.deliveries(row.key).await.unwrap(), (Vec::new(), None));
    store.close().await;
}
