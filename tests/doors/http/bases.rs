//! `/v1/bases`, and sessions that name one, end to end through both doors.

use axum::http::StatusCode;
use graphfix::contract::{calls, convert, v1};
use graphfix::formats::rinex::write_navigation;
use graphfix::gnss::Ecef;
use serde_json::{Value, json};

use crate::support::casters::gzip;
use crate::support::doors::{Doors, code};
use crate::support::pair::PAIR;
use crate::support::reading;

async fn created(doors: &Doors, base: Value) -> String {
    let (status, base) = doors.post("/v1/bases", base).await;
    assert_eq!(status, StatusCode::CREATED, "{base}");
    base["base"].as_str().unwrap().to_owned()
}

async fn navigated() -> Doors {
    let doors = Doors::open().await;
    let mut file = Vec::new();
    write_navigation(&mut file, &PAIR.navigation).unwrap();
    let (status, answer) = doors.upload("/v1/navigation", file).await;
    assert_eq!(status, StatusCode::OK, "{answer}");
    doors
}

/// A marker 1.5 m below the antenna, as in the file's header.
fn marker() -> Ecef {
    let frame = graphfix::gnss::LocalFrame::at(PAIR.position);
    frame.to_ecef(graphfix::gnss::Enu(nalgebra::Vector3::new(0.0, 0.0, -1.5)))
}

fn rover(count: usize) -> Vec<v1::Epoch> {
    PAIR.rover[..count].iter().map(|e| convert::epoch_message(e.seq, &e.epoch)).collect()
}

fn epochs_of(file: &[u8]) -> Vec<v1::Epoch> {
    reading::epochs_of(file).iter().map(|epoch| convert::epoch_message(0, epoch)).collect()
}

/// REST: the base from a file whose header contains its position; a session relative to it is
/// fixed.
#[tokio::test]
async fn a_file_fills_a_base_and_its_session_is_fixed() {
    let doors = navigated().await;
    let base = created(&doors, json!({"label": "roof"})).await;
    let path = format!("/v1/bases/{base}/observations");
    let (status, zero) = doors.upload(&path, PAIR.base_file(None)).await;
    assert_eq!((status, code(&zero)), (StatusCode::CONFLICT, "BASE_POSITION_MISSING"));
    let count = PAIR.base.len();
    for new in [count, 0] {
        let (status, answer) = doors.upload(&path, PAIR.base_file(Some(marker()))).await;
        assert_eq!(status, StatusCode::OK, "{answer}");
        assert_eq!((&answer["epochs"], &answer["newEpochs"]), (&json!(count), &json!(new)));
        assert_eq!((&answer["refusedEpochs"], &answer["warnings"]), (&json!(0), &json!([])));
    }
    let (_, held) = doors.get(&format!("/v1/bases/{base}")).await;
    let site = &held["site"];
    assert_eq!((&site["source"], &site["antenna"]), (&json!("header"), &json!("IDEAL")));
    assert_eq!(site["antennaDeltaHenM"], json!([1.5, 0.0, 0.0]));
    let above = site["antennaReferencePoint"]["zM"].as_f64().unwrap() - PAIR.position.0.z;
    assert!(above.abs() < 1e-3, "{above}");
    assert_eq!(
        (&held["epochs"], &held["positionCheck"]["verdict"]),
        (&json!(count), &json!("AGREES"))
    );
    assert!(held["ageS"].as_f64().unwrap() < 60.0, "{held}");
    assert_eq!(doors.get("/v1/bases").await.1["bases"][0]["lastTime"], held["lastTime"]);

    let session = json!({"mode": "rtk-fgo", "base": base});
    let (status, session) = doors.post("/v1/sessions", session).await;
    assert_eq!((status, &session["base"]), (StatusCode::CREATED, &json!(base)));
    let path = format!("/v1/sessions/{}/epochs", session["session"].as_str().unwrap());
    let (status, answer) = doors.post(&path, json!({"epochs": rover(60)})).await;
    assert_eq!(status, StatusCode::OK, "{answer}");
    let last = &answer["results"][59]["solution"];
    assert_eq!(
        (&last["status"], &last["provenance"]["base"]["base"]),
        (&json!("FIXED"), &json!(base))
    );
    assert_eq!(last["provenance"]["base"]["time"], last["time"]);
    assert_eq!(last["position"]["frame"], "BASE");

    let (status, refused) = doors.send("DELETE", &format!("/v1/bases/{base}"), json!({})).await;
    assert_eq!((status, code(&refused)), (StatusCode::CONFLICT, "BASE_IN_USE"));
}

/// The same calls through gRPC: a stated marker, pushed epochs, the same positions.
#[tokio::test]
async fn pushed_epochs_give_the_positions_of_a_file() {
    let doors = navigated().await;
    let service = &doors.caller();
    let by_file = created(&doors, json!({})).await;
    let file = PAIR.base_file(Some(marker()));
    let epochs = epochs_of(&file);
    let upload = v1::UploadBaseRequest { base: by_file.clone(), content: file.into() };
    calls::bases::upload(service, upload).await.unwrap();
    let get = v1::GetBaseRequest { base: by_file.clone() };
    let site = calls::bases::get(service, get).await.unwrap().site.unwrap();
    let new = v1::CreateBaseRequest {
        marker: site.marker,
        antenna_delta_hen_m: site.antenna_delta_hen_m,
        ..Default::default()
    };
    let by_push = calls::bases::create(service, new).await.unwrap().0.base;
    let push = v1::PushBaseEpochsRequest { base: by_push.clone(), epochs };
    let pushed = calls::bases::push_epochs(service, push).await.unwrap();
    let numbers: Vec<_> = pushed.results.iter().filter_map(|result| result.number).collect();
    assert_eq!(numbers, (1..=PAIR.base.len() as u64).collect::<Vec<_>>());
    let mut positions = Vec::new();
    for base in [by_file, by_push] {
        let new = v1::CreateSessionRequest { mode: "rtk-fgo".into(), base, ..Default::default() };
        let session = calls::sessions::create(service, new).await.unwrap().0.session;
        let push = v1::PushEpochsRequest { session, epochs: rover(60) };
        let answer = calls::positioning::push_epochs(service, push).await.unwrap();
        let of = |result: v1::EpochResult| result.solution.unwrap().position.unwrap().ecef.unwrap();
        positions.push(answer.results.into_iter().map(of).collect::<Vec<_>>());
    }
    assert_eq!(positions[0].len(), 60);
    assert_eq!(positions[0], positions[1]);
}

/// A base has the frame that its creator states, also after a restart, or none.
#[tokio::test]
async fn a_base_states_its_frame_or_that_it_is_unknown() {
    let doors = Doors::open().await;
    let marker = json!({"xM": 4_033_460.75, "yM": 23_538.02, "zM": 4_924_318.39});
    let new = json!({"marker": marker, "frame": "ETRF2000", "frameEpochYear": 2010.5});
    let (stated, unknown) = (created(&doors, new).await, created(&doors, json!({})).await);
    let doors = doors.restarted().await;
    for (base, frame, year) in [(stated, "ETRF2000", json!(2010.5)), (unknown, "", Value::Null)] {
        let (_, base) = doors.get(&format!("/v1/bases/{base}")).await;
        assert_eq!((&base["frame"], &base["frameEpochYear"]), (&json!(frame), &year));
    }
    for (request, field) in [
        (json!({"frame": "ETRF89"}), "frame"),
        (json!({"frame": "itrf2020"}), "frame"),
        (json!({"frame": "ITRF2020", "frameEpochYear": 20.1}), "frameEpochYear"),
        (json!({"frameEpochYear": 2020.0}), "frameEpochYear"),
    ] {
        let (status, answer) = doors.post("/v1/bases", request).await;
        assert_eq!((status, code(&answer)), (StatusCode::BAD_REQUEST, "INVALID_FIELD"));
        assert_eq!(answer["field"], field, "{answer}");
    }
}

#[tokio::test]
async fn places_that_cannot_be_are_refused() {
    let doors = Doors::open().await;
    let marker = json!({"xM": 4_033_460.75, "yM": 23_538.02, "zM": 4_924_318.39});
    for (request, field) in [
        (json!({"marker": {"xM": 0.0, "yM": 0.0, "zM": 0.0}}), "marker"),
        (json!({"marker": {"xM": 4_033.0, "yM": 23.0, "zM": 4_924.0}}), "marker"),
        (json!({"marker": marker, "antennaDeltaHenM": [1.0]}), "antennaDeltaHenM"),
        (json!({"marker": marker, "antennaDeltaHenM": [1.0, 0.0, 2e3]}), "antennaDeltaHenM"),
        (json!({"antennaDeltaHenM": [1.0, 0.0, 0.0]}), "antennaDeltaHenM"),
    ] {
        let (status, answer) = doors.post("/v1/bases", request).await;
        assert_eq!((status, code(&answer)), (StatusCode::BAD_REQUEST, "INVALID_FIELD"));
        assert_eq!(answer["field"], field, "{answer}");
    }
    for _ in 0..3 {
        created(&doors, json!({"marker": marker})).await;
    }
    let (_, first) = doors.get("/v1/bases?pageSize=2").await;
    let token = first["nextPageToken"].as_str().unwrap();
    let (_, rest) = doors.get(&format!("/v1/bases?pageSize=2&pageToken={token}")).await;
    assert_eq!(
        (first["bases"].as_array().unwrap().len(), rest["bases"].as_array().unwrap().len()),
        (2, 1)
    );
    assert_eq!(rest["nextPageToken"], "");
}

/// A packed file that is cut off fills a base up to there, and says so; a damaged one nothing.
#[tokio::test]
async fn a_packed_file_that_is_cut_off_fills_a_base_up_to_there() {
    let doors = Doors::open().await;
    let base = created(&doors, json!({"label": "roof"})).await;
    let path = format!("/v1/bases/{base}/observations");
    let packed = gzip(&PAIR.base_file(Some(marker())));
    let mut damaged = packed.clone();
    damaged[packed.len() - 8] ^= 1;
    let (status, refused) = doors.upload(&path, damaged).await;
    assert_eq!((status.as_u16(), code(&refused)), (400, "RINEX_READ_FAILED"), "{refused}");
    assert!(refused["byteOffset"].is_u64(), "{refused}");
    let (status, refused) = doors.upload(&path, packed[..12].into()).await;
    assert_eq!((status.as_u16(), refused["byteOffset"].as_u64()), (400, Some(12)), "{refused}");
    let (_, stored) = doors.get(&format!("/v1/bases/{base}")).await;
    assert_eq!((&stored["epochs"], &stored["site"]), (&json!(0), &Value::Null));

    let (status, answer) = doors.upload(&path, packed[..packed.len() / 2].into()).await;
    assert_eq!(status, StatusCode::OK, "{answer}");
    let epochs = answer["newEpochs"].as_u64().unwrap() as usize;
    assert!((1..PAIR.base.len()).contains(&epochs), "{answer}");
    let cut = answer["skipped"].as_array().unwrap().last().unwrap();
    assert!(cut["what"].as_str().unwrap().starts_with("the gzip stream is cut off"), "{answer}");
}
