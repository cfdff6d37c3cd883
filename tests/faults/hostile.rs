//! Clients that try to exhaust the service: each is refused, and others are served meanwhile.

use std::io::Write;

use axum::http::StatusCode;
use flate2::Compression;
use flate2::write::GzEncoder;
use graphfix::config::Limits;
use graphfix::contract::convert;
use graphfix::session::SequencedEpoch;
use serde_json::{Value, json};

use crate::support::doors::{Doors, code};
use crate::support::drive::DRIVE;

fn gzip(content: &[u8]) -> Vec<u8> {
    let mut packer = GzEncoder::new(Vec::new(), Compression::default());
    packer.write_all(content).unwrap();
    packer.finish().unwrap()
}

/// A RINEX line of `content` with its label.
fn line(content: &str, label: &str) -> String {
    format!("{content:<60}{label}\n")
}

/// A CRINEX file: 32 satellites with four observations each, of which every epoch after the first
/// needs eight bytes a satellite.
fn compact_file(epochs: usize) -> String {
    let marker = "  4033460.7500    23538.0200  4924318.3900";
    let mut text = line("3.0                 COMPACT RINEX FORMAT", "CRINEX VERS   / TYPE")
        + &line("hostile", "CRINEX PROG / DATE")
        + &line("     3.05           OBSERVATION DATA    G", "RINEX VERSION / TYPE")
        + &line(marker, "APPROX POSITION XYZ")
        + &line("G    4 C1C L1C D1C S1C", "SYS / # / OBS TYPES")
        + &line("", "END OF HEADER");
    let satellites: String = (1..=32).map(|number| format!("G{number:02}")).collect();
    for epoch in 0..epochs {
        let (minute, second) = (epoch / 60 % 60, epoch % 60);
        let (day, hour) = (1 + epoch / 86_400 % 28, epoch / 3600 % 24);
        text +=
            &format!("> 2019 04 {day:02} {hour:02} {minute:02} {second:02}.0000000  0 32      ");
        text += &satellites;
        text += "\n\n";
        let first = "3&22000000000 3&115000000000 3&1000 3&45000\n";
        text += &if epoch == 0 { first } else { "1 1 0 0\n" }.repeat(32);
    }
    text
}

#[tokio::test]
async fn files_that_unpack_to_much_are_refused_while_they_are_read() {
    let limits =
        Limits { epochs_per_base: 100_000, bytes_per_base: 32 << 10, ..Limits::standard() };
    let doors = Doors::with(limits).await;
    let (_, base) = doors.post("/v1/bases", json!({})).await;
    let path = format!("/v1/bases/{}/observations", base["base"].as_str().unwrap());
    let file = compact_file(1_000);
    let (_, taken) = doors.upload(&path, compact_file(3).into_bytes()).await;
    assert_eq!(taken["epochs"], 3, "{taken}");
    let (_, refusal) = doors.upload(&path, file.clone().into_bytes()).await;
    assert_eq!(code(&refusal), "BASE_TOO_LARGE", "{refusal}");
    let (_, refusal) = doors.upload(&path, gzip(file.repeat(20).as_bytes())).await;
    assert!(["BASE_TOO_LARGE", "COMPRESSED_TOO_MUCH"].contains(&code(&refusal)), "{refusal}");
    let first = line("     3.05           N: GNSS NAV DATA    M", "RINEX VERSION / TYPE");
    let bomb = first + &line("", "END OF HEADER") + &(" ".repeat(69) + "\n").repeat(400_000);
    let (_, refusal) = doors.upload("/v1/navigation", gzip(bomb.as_bytes())).await;
    assert_eq!(code(&refusal), "COMPRESSED_TOO_MUCH", "{refusal}");
}

/// Packed, a chunk of 20 kB completes thousands of epochs.
#[tokio::test]
async fn a_packed_chunk_hides_no_epochs() {
    let doors = Doors::open().await;
    let path = format!("/v1/sessions/{}/raw?offset=0", doors.session().await);
    let (_, refusal) = doors.upload(&path, gzip(compact_file(9_000).as_bytes())).await;
    let codes = ["TOO_MANY_EPOCHS", "DECOMPRESSED_TOO_LARGE"];
    assert!(codes.contains(&code(&refusal)), "{refusal}");
}

/// What one request may compute is bounded by time and by the window.
#[tokio::test]
async fn a_solve_has_a_largest_cost() {
    let doors = Doors::with(Limits { solve_s: 0, ..Limits::standard() }).await;
    doors.service.navigation().push(DRIVE.navigation.clone(), "test").await.unwrap();
    let epochs = |count: usize| -> Vec<Value> {
        let message = |e: &SequencedEpoch| json!(convert::epoch_message(e.seq, &e.epoch));
        DRIVE.epochs[..count].iter().map(message).collect()
    };
    let (status, solved) = doors.post("/v1/solve", json!({"epochs": epochs(1)})).await;
    assert_eq!(status, StatusCode::OK, "{solved}");
    let request = json!({"mode": "fgo", "epochs": epochs(60)});
    let (status, refusal) = doors.post("/v1/solve", request).await;
    assert_eq!((status.as_u16(), code(&refusal)), (413, "TOO_COSTLY"), "{refusal}");
    let overrides = json!({"window_epochs_max": "1000"});
    let request = json!({"mode": "fgo", "overrides": overrides, "epochs": epochs(1)});
    let (_, refusal) = doors.post("/v1/solve", request).await;
    let at_fault = (code(&refusal), refusal["field"].as_str());
    assert_eq!(at_fault, ("TOO_COSTLY", Some("overrides.window_epochs_max")), "{refusal}");
}
