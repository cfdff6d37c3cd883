//! Positions in the ETRS89 and heights above the geoid, in every output of solutions.

use axum::body::Body;
use axum::http::{Request, StatusCode};
use futures::StreamExt;
use graphfix::aiding::bases::{BaseId, BaseInfo, NewBase};
use graphfix::contract::{calls, convert, v1};
use graphfix::formats::rinex::write_navigation;
use graphfix::gnss::{CoordinateFrame, Ecef};
use graphfix::grpc::v1::positioning_client::PositioningClient;
use graphfix::session::SequencedEpoch;
use serde_json::{Value, json};
use tower::ServiceExt;

use crate::support::doors::{Doors, code};
use crate::support::geoid::{plane, plane_height_m};
use crate::support::jobs::{BOUNDARY, Files};
use crate::support::pair::{MUNICH, PAIR};

/// A service with a table of the geoid, the navigation data, and a base of this frame.
async fn served(frame: &str) -> (Doors, String) {
    let doors = Doors::with_geoid(&plane()).await;
    doors.service.navigation().push(MUNICH.navigation.clone(), "test").await.unwrap();
    let base = base(&doors, frame).await.name.id.to_string();
    (doors, base)
}

async fn base(doors: &Doors, frame: &str) -> BaseInfo {
    let bases = doors.service.bases();
    let new = NewBase { frame: CoordinateFrame::parse(frame), ..MUNICH.new_base(0.0) };
    let info = bases.create(new).await.unwrap();
    let id = BaseId::parse(&info.name.id).unwrap();
    bases.push(&id, MUNICH.base.clone()).await.unwrap();
    info
}

async fn session(doors: &Doors, base: &str, overrides: Value) -> String {
    let new = json!({"mode": "rtk-fgo", "base": base, "overrides": overrides});
    let (status, session) = doors.post("/v1/sessions", new).await;
    assert_eq!(status, StatusCode::CREATED, "{session}");
    session["session"].as_str().unwrap().to_owned()
}

fn messages(epochs: &[SequencedEpoch]) -> Vec<v1::Epoch> {
    epochs.iter().map(|e| convert::epoch_message(e.seq, &e.epoch)).collect()
}

/// The answers to a push of epochs.
async fn pushed(doors: &Doors, session: &str, epochs: &[SequencedEpoch]) -> Vec<Value> {
    let path = format!("/v1/sessions/{session}/epochs");
    let (status, answer) = doors.post(&path, json!({"epochs": messages(epochs)})).await;
    assert_eq!(status, StatusCode::OK, "{answer}");
    let results = answer["results"].as_array().unwrap();
    results.iter().map(|result| result["solution"].clone()).collect()
}

fn ecef(solution: &Value) -> Ecef {
    let of = |axis: &str| solution["position"]["ecef"][axis].as_f64().unwrap();
    Ecef::new(of("xM"), of("yM"), of("zM"))
}

/// Checks that two solutions differ only in their position and in the local directions east, north
/// and up.
fn without_position(solution: &Value) -> Value {
    let mut solution = solution.clone();
    solution["position"] = Value::Null;
    for axis in ["eastMS", "northMS", "upMS"] {
        solution["velocity"][axis] = Value::Null;
    }
    solution
}

/// A base in ITRF2014, with coordinates of 2010: the plate has moved by about half a metre since
/// 1989. The same session without the option has the same bits, except for the position.
#[tokio::test]
async fn a_session_asks_for_the_etrs89_and_heights_above_the_geoid() {
    let (doors, base) = served("ITRF2014@2010.0").await;
    let native = session(&doors, &base, json!({})).await;
    let asked = session(&doors, &base, json!({"frame": "ETRS89", "geoid": "on"})).await;
    let computed = pushed(&doors, &native, &MUNICH.rover).await;
    let answers = pushed(&doors, &asked, &MUNICH.rover).await;
    assert_eq!(answers.len(), computed.len());
    for (answer, computed) in answers.iter().zip(&computed) {
        assert_eq!(without_position(answer), without_position(computed));
        let (there, here) = (&answer["position"], &computed["position"]);
        assert_eq!((&there["frame"], &here["frame"]), (&json!("ETRF2000"), &json!("BASE")));
        assert_eq!(there["frameEpochYear"], 2010.0);
        assert_eq!((&there["baseFrame"], &there["baseFrameEpochYear"]), (&json!(""), &json!(null)));
        let stated = (&here["baseFrame"], &here["baseFrameEpochYear"]);
        assert_eq!(stated, (&json!("ITRF2014"), &json!(2010.0)));
        assert_eq!(
            (&here["frameEpochYear"], &here["orthometricHeightM"]),
            (&json!(null), &json!(null))
        );
        let moved_m = ecef(answer).distance_m(ecef(computed));
        assert!((0.45..0.65).contains(&moved_m), "{moved_m}");
        let of = |name: &str| there["geodetic"][name].as_f64().unwrap();
        let geoid_m = plane_height_m(of("latitudeDeg"), of("longitudeDeg"));
        let orthometric_m = there["orthometricHeightM"].as_f64().unwrap();
        assert!((of("heightM") - geoid_m - orthometric_m).abs() < 1e-4, "{answer}");
    }

    // Solutions are stored as computed. Another option transforms the same stored solutions
    // differently, the estimator continues, and a restart changes nothing.
    let listed = async |doors: &Doors, session: &str| {
        let path = format!("/v1/sessions/{session}/solutions?revisions=first");
        doors.get(&path).await.1["solutions"].as_array().unwrap().clone()
    };
    assert_eq!(listed(&doors, &asked).await, answers);
    let path = format!("/v1/sessions/{asked}");
    let change = json!({"clearOverrides": ["frame", "geoid"]});
    let (status, changed) = doors.send("PATCH", &path, change).await;
    assert_eq!(status, StatusCode::OK, "{changed}");
    assert_eq!(listed(&doors, &asked).await, computed);
    let change = json!({"overrides": {"frame": "ETRS89", "geoid": "on"}});
    assert_eq!(doors.send("PATCH", &path, change).await.0, StatusCode::OK);
    let doors = doors.restarted().await;
    assert_eq!(listed(&doors, &asked).await, answers);
}

/// Lists, explanations, streams with their summaries, watches, tracks and resent epochs have the
/// same position as the answer to a push.
#[tokio::test]
async fn every_way_out_gives_the_same() {
    let (doors, base) = served("ITRF2020@2015.0").await;
    let overrides = json!({"frame": "ETRS89", "geoid": "on", "window_s": "5"});
    let session = session(&doors, &base, overrides).await;
    let caller = doors.caller();
    let watch = v1::WatchSolutionsRequest {
        session: session.clone(),
        revisions: v1::Revisions::First.into(),
        ..Default::default()
    };
    let mut watch = Box::pin(calls::watch::watch(&caller, watch).await.unwrap());
    let answers = pushed(&doors, &session, &MUNICH.rover).await;
    let mut watched: Vec<v1::Solution> = Vec::new();
    while watched.len() < answers.len() {
        watched.extend(watch.next().await.unwrap().unwrap().solutions);
    }
    let watched: Vec<Value> = watched.iter().map(|s| serde_json::to_value(s).unwrap()).collect();
    assert_eq!(watched, answers);
    assert_eq!(pushed(&doors, &session, &MUNICH.rover[..3]).await, answers[..3]);
    let (_, explained) = doors.get(&format!("/v1/sessions/{session}/epochs/5")).await;
    assert_eq!(explained["solutions"][0]["position"], answers[4]["position"], "{explained}");

    let once = json!({
        "mode": "rtk-fgo", "base": base, "epochs": messages(&MUNICH.rover),
        "overrides": {"frame": "ETRS89", "geoid": "on", "window_s": "5"},
    });
    let (_, once) = doors.post("/v1/solve", once).await;
    assert_eq!(once["solutions"][4]["position"], answers[4]["position"], "{once}");
    let other = json!({"overrides": {"frame": "native"}});
    let (_, solved) = doors.post(&format!("/v1/sessions/{session}:solve"), other).await;
    assert_eq!(solved["solution"]["position"]["frame"], "BASE", "{solved}");

    let track = async |format: &str| {
        let request =
            Request::get(format!("/v1/sessions/{session}/track.{format}?revisions=first"));
        let request = request.body(Body::empty()).unwrap();
        let response = doors.router.clone().oneshot(request).await.unwrap();
        let bytes = axum::body::to_bytes(response.into_body(), usize::MAX).await.unwrap();
        String::from_utf8(bytes.to_vec()).unwrap()
    };
    let height_m = answers[0]["position"]["orthometricHeightM"].as_f64().unwrap();
    let csv = track("csv").await;
    let mut rows = csv.lines();
    assert!(rows.next().unwrap().ends_with(",vpl_m,frame,frame_epoch_year,orthometric_height_m"));
    let end = format!(",ETRF2000,2015.0000,{height_m:.4}");
    assert!(rows.next().unwrap().ends_with(&end), "{csv}");
    assert!(track("pos").await.contains("% frame     : ETRS89\n"));
    assert!(
        track("geojson").await.contains("\"frame\":\"ETRF2000\",\"frameEpochYear\":2015.0000,")
    );
    assert!(track("gpx").await.contains(&format!("<ele>{height_m:.4}</ele>")));
    let gga = track("nmea").await;
    let fields: Vec<&str> = gga.lines().next().unwrap().split(',').collect();
    assert_eq!(fields[9], format!("{height_m:.3}"), "{gga}");
    let geodetic = &answers[0]["position"]["geodetic"];
    let sum_m: f64 = fields[9].parse::<f64>().unwrap() + fields[11].parse::<f64>().unwrap();
    assert!((sum_m - geodetic["heightM"].as_f64().unwrap()).abs() < 0.0011, "{gga}");
}

#[tokio::test]
async fn a_stream_gives_the_same() {
    let (doors, base) = served("WGS84@2020.5").await;
    let overrides = json!({"frame": "ETRS89", "geoid": "on"});
    let session = session(&doors, &base, overrides).await;
    let answers = pushed(&doors, &session, &MUNICH.rover[..10]).await;
    for kind in [v1::Answers::Full, v1::Answers::Summary] {
        let opening = v1::StreamOpening {
            session: session.clone(),
            last_acknowledged: Some(0),
            answers: kind.into(),
        };
        let opening = v1::StreamRequest { opening: Some(opening), epochs: Vec::new() };
        let mut client = PositioningClient::new(doors.router.clone());
        let requests = futures::stream::iter([opening]).chain(futures::stream::pending());
        let mut responses = client.stream(requests).await.unwrap().into_inner();
        let mut results = Vec::new();
        while results.len() < 10 {
            results.extend(responses.message().await.unwrap().unwrap().results);
        }
        for (result, answer) in results.into_iter().zip(&answers) {
            let position = &answer["position"];
            match (result.solution, result.summary) {
                (Some(solution), None) => {
                    assert_eq!(serde_json::to_value(&solution).unwrap(), *answer);
                }
                (None, Some(summary)) => {
                    let geodetic = serde_json::to_value(summary.position).unwrap();
                    assert_eq!(geodetic, position["geodetic"]);
                    let height_m = position["orthometricHeightM"].as_f64();
                    assert_eq!(summary.orthometric_height_m, height_m);
                }
                other => panic!("{other:?}"),
            }
        }
    }
}

/// A base without a stated frame. A session that names this base is refused. A session that takes
/// the nearest base has its positions in the frame of the base, and the reason.
#[tokio::test]
async fn an_unknown_frame_is_not_guessed() {
    let (doors, unknown) = served("").await;
    let ask = |base: &str, more: &str| {
        let overrides = match more {
            "" => json!({"frame": "ETRS89"}),
            frame => json!({"frame": "ETRS89", "base_frame": frame}),
        };
        json!({"mode": "rtk-fgo", "base": base, "overrides": overrides})
    };
    for (name, why) in [
        (unknown.clone(), "frame of the base's coordinates is unknown"),
        (base(&doors, "ITRF2014").await.name.id.to_string(), "epoch of the base's coordinates"),
        (base(&doors, "GDA94@1994.0").await.name.id.to_string(), "no published parameters"),
    ] {
        let (status, refused) = doors.post("/v1/sessions", ask(&name, "")).await;
        assert_eq!((status, code(&refused)), (StatusCode::BAD_REQUEST, "FRAME_UNAVAILABLE"));
        assert_eq!(refused["field"], "overrides.frame");
        assert!(refused["detail"].as_str().unwrap().contains(why), "{refused}");
        let once = json!({"epochs": messages(&MUNICH.rover[..1])});
        let mut once = once.as_object().unwrap().clone();
        once.extend(ask(&name, "").as_object().unwrap().clone());
        let (_, refused) = doors.post("/v1/solve", json!(once)).await;
        assert_eq!(code(&refused), "FRAME_UNAVAILABLE", "{refused}");
    }
    let native = session(&doors, &unknown, json!({})).await;
    let change = json!({"overrides": {"frame": "ETRS89"}});
    let (_, refused) = doors.send("PATCH", &format!("/v1/sessions/{native}"), change).await;
    assert_eq!(code(&refused), "FRAME_UNAVAILABLE");
    let computed = pushed(&doors, &native, &MUNICH.rover).await;

    let (_, stated) = doors.post("/v1/sessions", ask(&unknown, "ETRF2000")).await;
    let stated = pushed(&doors, stated["session"].as_str().unwrap(), &MUNICH.rover).await;
    assert_eq!(ecef(&stated[3]), ecef(&computed[3]));
    let base_frame = |solution: &Value| solution["position"]["baseFrame"].clone();
    assert_eq!((base_frame(&computed[3]), base_frame(&stated[3])), (json!("UNKNOWN"), json!("")));
    // The option states the frame of a base that states none. Positions in the base's own frame
    // then have it, too.
    let (_, native) = doors
        .post("/v1/sessions", {
            let overrides = json!({"base_frame": "NAD83(2011)@2010.0"});
            json!({"mode": "rtk-fgo", "base": unknown, "overrides": overrides})
        })
        .await;
    let native = pushed(&doors, native["session"].as_str().unwrap(), &MUNICH.rover[..1]).await;
    let position = &native[0]["position"];
    assert_eq!(
        (&position["frame"], &position["baseFrame"]),
        (&json!("BASE"), &json!("NAD83(2011)"))
    );
    assert_eq!(position["baseFrameEpochYear"], 2010.0);
    assert_eq!(stated[3]["position"]["frame"], "ETRF2000");

    let only = Doors::with_geoid(&plane()).await;
    only.service.navigation().push(MUNICH.navigation.clone(), "test").await.unwrap();
    base(&only, "").await;
    let (_, nearest) = only.post("/v1/sessions", ask("nearest", "")).await;
    let nearest = nearest["session"].as_str().unwrap_or_else(|| panic!("{nearest}"));
    let answers = pushed(&only, nearest, &MUNICH.rover).await;
    for answer in &answers {
        assert_eq!(answer["position"]["frame"], "BASE");
        let reasons = answer["reasons"].as_array().unwrap();
        let reason = reasons.iter().find(|reason| reason["code"] == "FRAME_UNAVAILABLE").unwrap();
        assert!(reason["remedy"].as_str().unwrap().contains("state the frame"), "{reason}");
    }
    let track = async |format: &str| {
        let request = Request::get(format!("/v1/sessions/{nearest}/track.{format}"));
        let response = only.router.clone().oneshot(request.body(Body::empty()).unwrap()).await;
        let bytes = axum::body::to_bytes(response.unwrap().into_body(), usize::MAX).await.unwrap();
        String::from_utf8(bytes.to_vec()).unwrap()
    };
    let csv = track("csv").await;
    assert!(csv.lines().skip(1).all(|row| row.ends_with(",BASE,")), "{csv}");
    assert!(csv.contains("FRAME_UNAVAILABLE{the frame of the base's coordinates is unknown}"));
    assert!(!track("gpx").await.contains("<trkpt"));
    assert!(track("nmea").await.lines().all(|line| !line.contains(",E,")));
}

/// Files name the frame that the base states, and a session without such a base has no columns.
#[tokio::test]
async fn files_name_the_frame_that_the_base_states() {
    let (doors, stated) = served("ITRF2014@2010.0").await;
    let unknown = base(&doors, "").await.name.id.to_string();
    for (base, frame) in [(stated, Some("ITRF2014")), (unknown, None)] {
        let session = session(&doors, &base, json!({})).await;
        pushed(&doors, &session, &MUNICH.rover).await;
        let path = format!("/v1/sessions/{session}/track");
        let (_, csv) = doors.get(&format!("{path}.csv")).await;
        let mut lines = csv.as_str().unwrap().lines();
        let titles = lines.next().unwrap();
        let (_, geojson) = doors.get(&format!("{path}.geojson")).await;
        let properties = &geojson["features"][0]["properties"];
        assert_eq!(properties["frame"].as_str(), frame, "{properties}");
        match frame {
            Some(_) => {
                assert!(titles.ends_with(",vpl_m,frame,frame_epoch_year"), "{titles}");
                assert!(lines.all(|row| row.ends_with(",ITRF2014,2010.0000")), "{csv}");
                assert_eq!(properties["frameEpochYear"], 2010.0);
            }
            None => assert!(titles.ends_with(",vpl_m"), "{titles}"),
        }
    }
}

/// Positions outside of Europe, and outside of the geoid's table.
#[tokio::test]
async fn outside_there_is_neither() {
    let doors = Doors::with_geoid(&plane()).await;
    doors.service.navigation().push(PAIR.navigation.clone(), "test").await.unwrap();
    let asked = json!({"mode": "spp", "overrides": {"frame": "ETRS89", "geoid": "on"}});
    let (_, session) = doors.post("/v1/sessions", asked).await;
    let session = session["session"].as_str().unwrap();
    for answer in pushed(&doors, session, &PAIR.rover[..2]).await {
        assert_eq!(answer["position"]["frame"], "WGS84");
        assert_eq!(answer["position"]["orthometricHeightM"], Value::Null);
        let reason = answer["reasons"].as_array().unwrap().last().unwrap();
        assert_eq!(reason["code"], "FRAME_UNAVAILABLE");
    }
}

/// A job gives the same bytes as `solve`. A wrong option is refused with its field.
#[tokio::test]
async fn a_job_asks_for_them_too() {
    let doors = Doors::with_geoid(&plane()).await;
    let mut navigation = Vec::new();
    write_navigation(&mut navigation, &MUNICH.navigation).unwrap();
    let base = MUNICH.base_file(Some(MUNICH.position));
    let files = Files { rover: MUNICH.rover_file(), base, navigation };
    let post = async |overrides: Value| {
        let options = json!({"mode": "rtk-fgo", "format": "csv", "overrides": overrides});
        let kind = format!("multipart/form-data; boundary={BOUNDARY}");
        let request = Request::post("/v1/jobs").header("content-type", kind);
        doors.ask(request.body(Body::from(files.body(&options))).unwrap()).await
    };
    let (status, refused) = post(json!({"frame": "ETRS89"})).await;
    assert_eq!((status, code(&refused)), (StatusCode::BAD_REQUEST, "FRAME_UNAVAILABLE"));
    assert_eq!(refused["field"], "options.overrides.frame");
    let asked = json!({"frame": "ETRS89", "base_frame": "ITRF2008@2005.0", "geoid": "on"});
    let (status, job) = post(asked).await;
    assert_eq!(status, StatusCode::CREATED, "{job}");
    let path = format!("/v1/jobs/{}", job["job"].as_str().unwrap());
    doors.until(&path, |job| job["state"] == "SUCCEEDED").await;
    let (_, csv) = doors.get(&format!("{path}/result")).await;
    let csv = csv.as_str().unwrap();
    let row = csv.lines().nth(10).unwrap();
    assert!(row.contains(",ETRF2000,2005.0000,"), "{csv}");
    let height_m = row.rsplit(',').next().unwrap().parse::<f64>().unwrap();
    assert!((490.0..520.0).contains(&height_m), "{row}");

    let table = doors.folder().join("geoid.gtx");
    let table = table.to_str().unwrap();
    let arguments = ["--frame", "ETRS89", "--base-frame", "ITRF2008@2005.0", "--geoid", table];
    assert_eq!(String::from_utf8(files.solved(&arguments, "csv")).unwrap(), csv);
}
