//! The rover's observations as the result of a job and of `graphfix solve`.

use std::process::Command;

use axum::http::header;
use graphfix::formats::receiver::RawxWriter;
use serde_json::json;

use super::job_reports::report;
use super::jobs::{bytes_of, created, ended, post};
use super::observations::driven;
use crate::support::data;
use crate::support::doors::{Doors, code};
use crate::support::jobs::{MINUTE, body};
use crate::support::reading::epochs_of;

/// The rover of the minute as a receiver's log.
fn log() -> Vec<u8> {
    let mut writer = RawxWriter::default();
    epochs_of(&MINUTE.rover).iter().flat_map(|epoch| writer.frame(epoch)).collect()
}

/// A log in UBX becomes RINEX with the same observations, which RTKLIB positions.
#[tokio::test]
async fn a_log_becomes_rinex() {
    let doors = Doors::open().await;
    let options = json!({"mode": "spp", "format": "rinex"}).to_string();
    let log = log();
    let upload = body(&[
        ("rover", &log),
        ("navigation", &MINUTE.navigation),
        ("options", options.as_bytes()),
    ]);
    let job = created(&doors, upload).await;
    let done = ended(&doors, &job).await;
    assert_eq!(done["state"], "SUCCEEDED", "{done}");
    let (headers, text) = report(&doors, &format!("/v1/jobs/{job}/result"), None).await;
    let name = headers[header::CONTENT_DISPOSITION].to_str().unwrap();
    assert_eq!(name, format!("attachment; filename=\"{job}.rnx\""));
    assert_eq!(done["resultBytes"], text.len());
    let (read, sent) = (epochs_of(text.as_bytes()), epochs_of(&MINUTE.rover));
    assert_eq!(read.len(), sent.len());
    for (read, sent) in read.iter().zip(&sent) {
        assert!((read.time - sent.time).abs() < 1e-6);
        assert_eq!(read.observations.len(), sent.observations.len());
        for (read, sent) in read.observations.iter().zip(&sent.observations) {
            assert_eq!((read.satellite, read.code), (sent.satellite, sent.code));
            let (read, sent) = (read.pseudorange_m.unwrap(), sent.pseudorange_m.unwrap());
            assert!((read - sent).abs() < 2e-3, "{read} {sent}");
        }
    }
    // The job has also computed positions.
    let (_, counted) = doors.get(&format!("/v1/jobs/{job}/report")).await;
    assert_eq!((&counted["epochs"], &counted["answered"]), (&json!(61), &json!(61)), "{counted}");

    if Command::new("rnx2rtkp").arg("-?").output().is_err() {
        return data::note_missing("RTKLIB's rnx2rtkp");
    }
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("rover.obs"), text).unwrap();
    std::fs::write(folder.path().join("rover.nav"), &MINUTE.navigation).unwrap();
    let arguments = ["-p", "0", "-o", "rover.pos", "rover.obs", "rover.nav"];
    let run = Command::new("rnx2rtkp").current_dir(folder.path()).args(arguments).output();
    assert!(run.unwrap().status.success());
    let solved = std::fs::read_to_string(folder.path().join("rover.pos")).unwrap();
    let rows = solved.lines().filter(|line| !line.starts_with('%')).count();
    assert!(9 * 61 <= 10 * rows, "{rows} of 61");
}

#[tokio::test]
async fn the_observations_of_a_session_are_not_a_job() {
    let doors = Doors::open().await;
    let (session, _) = driven(&doors).await;
    let options = json!({"session": session, "format": "rinex"}).to_string();
    let (status, refused) = post(&doors, body(&[("options", options.as_bytes())]), &[]).await;
    assert_eq!((status.as_u16(), code(&refused)), (400, "INVALID_FIELD"), "{refused}");
    assert_eq!(refused["field"], "options.format");
    assert!(refused["detail"].as_str().unwrap().contains("observations.rnx"), "{refused}");
    let options = json!({"format": "rnx"});
    let (status, refused) = post(&doors, MINUTE.body(&options), &[]).await;
    assert_eq!(status.as_u16(), 400);
    assert!(refused["detail"].as_str().unwrap().contains("parquet, rinex"), "{refused}");
    let (_, all) = bytes_of(&doors, "/v1/jobs").await;
    assert!(String::from_utf8(all).unwrap().contains("\"jobs\":[]"));
}

/// `solve` never overwrites its input.
#[test]
fn solve_writes_rinex_beside_its_input() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str, content: &[u8]| {
        let path = folder.path().join(name);
        std::fs::write(&path, content).unwrap();
        path
    };
    let rover = file("rover.obs", &MINUTE.rover);
    let navigation = file("navigation.rnx", &MINUTE.navigation);
    let solve = |output: &str| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_graphfix"));
        command.arg("solve").arg("--rover").arg(&rover).arg("--nav").arg(&navigation);
        command.arg("--output").arg(folder.path().join(output)).output().unwrap()
    };
    for input in [&rover, &navigation] {
        let before = std::fs::read(input).unwrap();
        let refused = solve(input.file_name().unwrap().to_str().unwrap());
        let told = String::from_utf8_lossy(&refused.stderr).into_owned();
        assert!(!refused.status.success() && told.contains("is an input"), "{told}");
        assert_eq!(std::fs::read(input).unwrap(), before);
    }
    let done = solve("again.rnx");
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    let again = std::fs::read(folder.path().join("again.rnx")).unwrap();
    assert_eq!(epochs_of(&again).len(), 61);
}
