//! The stored epochs of a session as RINEX, by both doors, read here and by RTKLIB.

use std::process::Command;

use axum::body::Body;
use axum::http::{Request, StatusCode};
use futures::TryStreamExt;
use graphfix::contract::{convert, v1};
use graphfix::gnss::{Cycles, Epoch, GpsTime};
use graphfix::grpc::v1::sessions_client::SessionsClient;
use graphfix::grpc::v1::solutions_client::SolutionsClient;
use graphfix::session::SequencedEpoch;
use serde_json::json;
use tower::ServiceExt;

use crate::support::data;
use crate::support::doors::{Doors, code};
use crate::support::drive::DRIVE;
use crate::support::reading::epochs_of;

/// More than two pages of the store.
const EPOCHS: usize = 300;

/// A session with the first epochs of the drive. One epoch has a phase that is too large for a
/// column of RINEX. Also returns these epochs without this phase.
pub(super) async fn driven(doors: &Doors) -> (String, Vec<Epoch>) {
    let (status, _) = doors.upload("/v1/navigation", DRIVE.navigation_file()).await;
    assert_eq!(status, StatusCode::OK);
    let (_, session) = doors.post("/v1/sessions", json!({"mode": "spp", "label": "car 7"})).await;
    let session = session["session"].as_str().unwrap().to_owned();
    let mut epochs: Vec<SequencedEpoch> = DRIVE.epochs[..EPOCHS].to_vec();
    epochs[3].epoch.observations[0].carrier_phase = Some(Cycles(1e11));
    let messages: Vec<_> = epochs.iter().map(|e| convert::epoch_message(e.seq, &e.epoch)).collect();
    let path = format!("/v1/sessions/{session}/epochs");
    let (status, answer) = doors.post(&path, json!({"epochs": messages})).await;
    assert_eq!(status, StatusCode::OK, "{answer}");
    epochs[3].epoch.observations[0].carrier_phase = None;
    (session, epochs.into_iter().map(|sequenced| sequenced.epoch).collect())
}

/// The file at a path.
async fn file(doors: &Doors, path: &str) -> String {
    let request = Request::get(path).body(Body::empty()).unwrap();
    let response = doors.router.clone().oneshot(request).await.unwrap();
    assert_eq!(response.status(), StatusCode::OK, "{path}");
    let bytes = axum::body::to_bytes(response.into_body(), usize::MAX).await.unwrap();
    String::from_utf8(bytes.to_vec()).unwrap()
}

/// The epoch as a file has it: three decimals, and signals in the order of their codes.
fn rounded(epoch: &Epoch) -> Epoch {
    let round = |value: f64| (value * 1e3).round() / 1e3;
    let mut epoch = epoch.clone();
    for observation in &mut epoch.observations {
        observation.pseudorange_m = observation.pseudorange_m.map(round);
        observation.carrier_phase = observation.carrier_phase.map(|p| Cycles(round(p.0)));
        observation.doppler_hz = observation.doppler_hz.map(round);
        observation.cn0_db_hz = observation.cn0_db_hz.map(round);
    }
    epoch.observations.sort_by_key(|o| (o.satellite, o.code));
    epoch
}

fn assert_same(read: &[Epoch], sent: &[Epoch]) {
    assert_eq!(read.len(), sent.len());
    for (read, sent) in read.iter().zip(sent) {
        assert_eq!(rounded(read), rounded(sent));
    }
}

#[tokio::test]
async fn the_file_has_every_observation_that_was_sent() {
    let doors = Doors::open().await;
    let (session, sent) = driven(&doors).await;
    let whole = file(&doors, &format!("/v1/sessions/{session}/observations.rnx")).await;
    assert!(whole.contains("car 7 ") && whole.contains("APPROX POSITION XYZ"), "{whole:.2000}");
    assert_same(&epochs_of(whole.as_bytes()), &sent);
    let text = |time: GpsTime| {
        let time = v1::GpsTime::from(time);
        format!("{}:{}", time.week, time.ns_of_week as f64 * 1e-9)
    };
    let span = format!("from={}&to={}", text(sent[20].time), text(sent[250].time));
    let part = file(&doors, &format!("/v1/sessions/{session}/observations.rnx?{span}")).await;
    assert_same(&epochs_of(part.as_bytes()), &sent[20..=250]);

    // The list of solutions in the format RINEX is the same file, by both doors.
    let path = format!("/v1/sessions/{session}/solutions?format=rinex");
    assert_eq!(file(&doors, &path).await, whole);
    assert_eq!(file(&doors, &format!("{path}&{span}")).await, part);
    for (query, field) in [("status=FIXED", "status"), ("revisions=all", "revisions")] {
        let (status, refused) = doors.get(&format!("{path}&{query}")).await;
        assert_eq!((status.as_u16(), code(&refused)), (400, "INVALID_FIELD"), "{refused}");
        assert_eq!(refused["field"], field);
    }
    let request = v1::TrackRequest {
        session: session.clone(),
        format: "rinex".to_owned(),
        ..Default::default()
    };
    let mut solutions = SolutionsClient::new(doors.router.clone());
    let answers = solutions.track(request).await.unwrap().into_inner();
    let parts: Vec<_> = answers.map_ok(|answer| answer.content).try_collect().await.unwrap();
    assert_eq!(String::from_utf8(parts.concat()).unwrap(), whole);

    let mut client = SessionsClient::new(doors.router.clone());
    let request = v1::SessionObservationsRequest { session, ..Default::default() };
    let answers = client.observations(request).await.unwrap().into_inner();
    let parts: Vec<_> = answers.map_ok(|answer| answer.content).try_collect().await.unwrap();
    assert_eq!(String::from_utf8(parts.concat()).unwrap(), whole);
}

#[tokio::test]
async fn a_session_without_epochs_gives_a_header() {
    let doors = Doors::open().await;
    let session = doors.session().await;
    let whole = file(&doors, &format!("/v1/sessions/{session}/observations.rnx")).await;
    assert!(whole.trim_end().ends_with("END OF HEADER"), "{whole}");
    let path = format!("/v1/sessions/{session}/observations.rnx?from=now");
    let (status, problem) = doors.get(&path).await;
    assert_eq!((status.as_u16(), code(&problem)), (400, "INVALID_TIME"));
    let (status, problem) = doors.get("/v1/sessions/ses_0/observations.rnx").await;
    assert_eq!((status.as_u16(), code(&problem)), (404, "SESSION_NOT_FOUND"));
}

/// RTKLIB positions at least nine of ten epochs of the file.
#[tokio::test]
async fn rtklib_reads_the_file() {
    if Command::new("rnx2rtkp").arg("-?").output().is_err() {
        return data::note_missing("RTKLIB's rnx2rtkp");
    }
    let doors = Doors::open().await;
    let (session, sent) = driven(&doors).await;
    let whole = file(&doors, &format!("/v1/sessions/{session}/observations.rnx")).await;
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("session.obs"), whole).unwrap();
    std::fs::write(folder.path().join("session.nav"), DRIVE.navigation_file()).unwrap();
    let arguments = ["-p", "0", "-o", "session.pos", "session.obs", "session.nav"];
    let run = Command::new("rnx2rtkp").current_dir(folder.path()).args(arguments).output();
    assert!(run.unwrap().status.success());
    let solved = std::fs::read_to_string(folder.path().join("session.pos")).unwrap();
    let rows = solved.lines().filter(|line| !line.starts_with('%')).count();
    assert!(9 * sent.len() <= 10 * rows && rows <= sent.len(), "{rows} of {}", sent.len());
}
