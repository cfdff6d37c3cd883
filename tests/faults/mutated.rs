//! Mutated requests through both doors. Each is answered or refused, none fails inside the service,
//! and afterwards no memory is reserved.
//!
//! Each target runs for half a second. `scripts/fuzz SECONDS` runs each target longer and from
//! other seeds, by the variables `GRAPHFIX_FUZZ_S` (duration) and `GRAPHFIX_FUZZ_SEED`.

use std::io::Write;
use std::time::{Duration, Instant};

use axum::body::Body;
use axum::http::Request;
use flate2::Compression;
use flate2::write::GzEncoder;
use graphfix::contract::{convert, v1};
use graphfix::formats::rinex::write_navigation;
use prost::Message;
use serde_json::json;
use tower::ServiceExt;

use crate::support::doors::{Doors, epoch};
use crate::support::drive::DRIVE;
use crate::support::streams::{Random, mutate};

const JSON: &str = "application/json";
const OCTETS: &str = "application/octet-stream";
const GRPC: &str = "application/grpc";
/// The statuses of gRPC that mean that the service has failed.
const FAILURES: [&str; 5] = ["2", "13", "14", "15", "unreadable"];

fn variable(name: &str) -> Option<f64> {
    std::env::var(name).ok().map(|text| text.parse().expect("a number"))
}

fn gzip(content: &[u8]) -> Vec<u8> {
    let mut packer = GzEncoder::new(Vec::new(), Compression::default());
    packer.write_all(content).unwrap();
    packer.finish().unwrap()
}

/// A message as gRPC sends it.
fn framed(message: &[u8], is_packed: bool) -> Vec<u8> {
    [&[u8::from(is_packed)][..], &(message.len() as u32).to_be_bytes(), message].concat()
}

/// Sends the service the requests that `request` makes of mutated seeds, until the time is over.
async fn survives(
    doors: &Doors,
    seeds: &[Vec<u8>],
    request: impl Fn(&[u8]) -> Option<Request<Body>>,
) {
    let duration = Duration::from_secs_f64(variable("GRAPHFIX_FUZZ_S").unwrap_or(0.5));
    let first = variable("GRAPHFIX_FUZZ_SEED").unwrap_or(1.0) as u64;
    let mut random = Random::new(0x9e37_79b9_7f4a_7c15 ^ first);
    let begun = Instant::now();
    let mut asked = 0;
    while begun.elapsed() < duration || asked < 2 * seeds.len() {
        let mut bytes = seeds[asked % seeds.len()].clone();
        // The first round is not mutated.
        if seeds.len() <= asked {
            mutate(&mut bytes, &mut random);
        }
        asked += 1;
        let Some(request) = request(&bytes) else { continue };
        let response = doors.router.clone().oneshot(request).await.unwrap();
        let header = |name: &str| {
            response
                .headers()
                .get(name)
                .map(|value| value.to_str().unwrap_or("unreadable").to_owned())
        };
        let has_failed = header("grpc-status").is_some_and(|status| FAILURES.contains(&&*status));
        let status = response.status();
        let answer = axum::body::to_bytes(response.into_body(), usize::MAX).await.unwrap();
        assert!(
            !status.is_server_error() && !has_failed,
            "{status} {}: {:?}",
            String::from_utf8_lossy(&answer),
            String::from_utf8_lossy(&bytes),
        );
    }
    assert_eq!(doors.service.budget().used(), 0);
}

fn post(path: &str, kind: &str, body: &[u8]) -> Option<Request<Body>> {
    let request = Request::post(path).header("content-type", kind);
    request.body(Body::from(body.to_vec())).ok()
}

#[tokio::test]
async fn json_is_survived() {
    let doors = Doors::open().await;
    let overrides = json!({"window_s": "5", "elevation_mask_deg": "10"});
    let epochs = [epoch(1), epoch(2)];
    let seeds = [
        json!({"mode": "spp", "epochs": epochs, "overrides": overrides}),
        json!({"mode": "fgo", "profile": "phone", "epochs": epochs}),
    ];
    let seeds = seeds.map(|seed| seed.to_string().into_bytes());
    survives(&doors, &seeds, |body| post("/v1/solve", JSON, body)).await;
    let path = format!("/v1/sessions/{}/epochs", doors.session().await);
    let push = json!({"epochs": epochs}).to_string().into_bytes();
    survives(&doors, &[push], |body| post(&path, JSON, body)).await;
    let marker = json!({"xM": 4.0e6, "yM": 2.0e5, "zM": 4.9e6});
    let base = json!({"label": "roof", "antenna": "TRM59800.00 NONE", "marker": marker});
    survives(&doors, &[base.to_string().into_bytes()], |body| post("/v1/bases", JSON, body)).await;
}

/// Protobuf, plain and packed. The service counts epochs before it decodes them: a mutated message
/// must not pass the counter and then fail inside the service.
#[tokio::test]
async fn messages_are_survived() {
    let doors = Doors::open().await;
    let message = |count: usize| {
        let epochs = &DRIVE.epochs[..count];
        let epochs = epochs.iter().map(|e| convert::epoch_message(e.seq, &e.epoch)).collect();
        v1::SolveOnceRequest { epochs, ..Default::default() }.encode_to_vec()
    };
    let path = "/graphfix.v1.Positioning/SolveOnce";
    let plain = [message(1), message(3)];
    survives(&doors, &plain, |message| post(path, GRPC, &framed(message, false))).await;
    let packed = plain.map(|message| gzip(&message));
    survives(&doors, &packed, |message| {
        let mut request = post(path, GRPC, &framed(message, true))?;
        request.headers_mut().insert("grpc-encoding", "gzip".parse().ok()?);
        Some(request)
    })
    .await;
}

#[tokio::test]
async fn files_of_navigation_are_survived() {
    let doors = Doors::open().await;
    let mut file = Vec::new();
    write_navigation(&mut file, &DRIVE.navigation).unwrap();
    file.truncate(4_000);
    let seeds = [gzip(&file), file];
    survives(&doors, &seeds, |file| post("/v1/navigation", OCTETS, file)).await;
}

/// CRINEX with two satellites.
const COMPACT: &str = include_str!("../../compute/src/formats/rinex/sample.crx");

#[tokio::test]
async fn files_of_bases_are_survived() {
    let doors = Doors::open().await;
    let (_, base) = doors.post("/v1/bases", json!({})).await;
    let path = format!("/v1/bases/{}/observations", base["base"].as_str().unwrap());
    let seeds = [COMPACT.as_bytes().to_vec(), gzip(COMPACT.as_bytes())];
    survives(&doors, &seeds, |file| post(&path, OCTETS, file)).await;
}

#[tokio::test]
async fn tokens_and_ids_are_survived() {
    let doors = Doors::open().await;
    let session = doors.session().await;
    let (_, pushed) = doors
        .post(&format!("/v1/sessions/{session}/epochs"), json!({"epochs": [epoch(1), epoch(2)]}))
        .await;
    assert_eq!(pushed["durableThrough"], 2, "{pushed}");
    let solutions = format!("/v1/sessions/{session}/solutions");
    let (_, page) = doors.get(&format!("{solutions}?pageSize=1")).await;
    let token = page["nextPageToken"].as_str().unwrap().as_bytes().to_vec();
    let escaped =
        |bytes: &[u8]| bytes.iter().map(|byte| format!("%{byte:02x}")).collect::<String>();
    let seeds = [token, session.clone().into_bytes()];
    let get = |path: String| Request::get(path).body(Body::empty()).ok();
    survives(&doors, &seeds, |text| {
        get(format!("{solutions}?pageSize=1&pageToken={}", escaped(text)))
    })
    .await;
    survives(&doors, &seeds, |text| get(format!("/v1/sessions?pageToken={}", escaped(text)))).await;
    survives(&doors, &seeds, |text| get(format!("/v1/sessions/{}/solutions", escaped(text)))).await;
}
