//! Tracks: a session's stored solutions as files, by both doors.

use axum::body::Body;
use axum::http::{Request, StatusCode};
use futures::{StreamExt, TryStreamExt};
use graphfix::contract::{convert, v1};
use graphfix::grpc::v1::solutions_client::SolutionsClient;
use graphfix::session::SequencedEpoch;
use serde_json::{Value, json};
use tower::ServiceExt;

use crate::support::doors::{Doors, code};
use crate::support::drive::DRIVE;
use crate::support::jobs::body;
use crate::support::python;

use super::jobs::{bytes_of, ended};

/// More than two batches of the store.
const EPOCHS: usize = 330;

/// A closed session in mode `fgo` with the epochs of the drive, which has revisions. The first
/// epoch has no observations, so no position.
async fn driven(doors: &Doors) -> String {
    let (status, _) = doors.upload("/v1/navigation", DRIVE.navigation_file()).await;
    assert_eq!(status, StatusCode::OK);
    let (_, session) = doors.post("/v1/sessions", json!({"mode": "fgo"})).await;
    let session = session["session"].as_str().unwrap().to_owned();
    let message = |e: &SequencedEpoch| convert::epoch_message(e.seq, &e.epoch);
    let mut epochs: Vec<_> = DRIVE.epochs[..EPOCHS].iter().map(message).collect();
    epochs[0].observations.clear();
    let path = format!("/v1/sessions/{session}/epochs");
    let (status, answer) = doors.post(&path, json!({"epochs": epochs})).await;
    assert_eq!(status, StatusCode::OK, "{answer}");
    let (status, _) = doors.send("DELETE", &format!("/v1/sessions/{session}"), json!({})).await;
    assert_eq!(status, StatusCode::OK);
    session
}

/// All listed solutions.
async fn listed(doors: &Doors, session: &str, query: &str) -> Vec<Value> {
    let path = format!("/v1/sessions/{session}/solutions?pageSize=10000{query}");
    let (status, page) = doors.get(&path).await;
    assert_eq!(status, StatusCode::OK, "{page}");
    page["solutions"].as_array().unwrap().clone()
}

/// Content type and text of a track.
async fn track(doors: &Doors, session: &str, file: &str) -> (String, String) {
    let (name, kind, text) = downloaded(doors, session, file).await;
    let expected = file.split('?').next().unwrap().replace("track", session);
    assert_eq!(name, format!("attachment; filename=\"{expected}\""));
    (kind, text)
}

/// Disposition, content type and text of a file.
async fn downloaded(doors: &Doors, session: &str, file: &str) -> (String, String, String) {
    let request = Request::get(format!("/v1/sessions/{session}/{file}"));
    let request = request.body(Body::empty()).unwrap();
    let response = doors.router.clone().oneshot(request).await.unwrap();
    assert_eq!(response.status(), StatusCode::OK, "{file}");
    let header = |name: &str| response.headers()[name].to_str().unwrap().to_owned();
    let (name, kind) = (header("content-disposition"), header("content-type"));
    let bytes = axum::body::to_bytes(response.into_body(), usize::MAX).await.unwrap();
    (name, kind, String::from_utf8(bytes.to_vec()).unwrap())
}

#[tokio::test]
async fn each_format_has_every_listed_solution_once() {
    let doors = Doors::open().await;
    let session = driven(&doors).await;
    let solutions = listed(&doors, &session, "").await;
    assert_eq!(solutions.len(), EPOCHS);
    let positions = solutions.iter().filter(|solution| solution["status"] != "NONE").count();
    assert!(positions < EPOCHS, "no epoch without position");
    let lines = |text: &str, start: char| text.lines().filter(|l| l.starts_with(start)).count();

    let (kind, pos) = track(&doors, &session, "track.pos").await;
    assert_eq!((&*kind, lines(&pos, '2')), ("text/plain; charset=utf-8", positions));
    assert!(pos.contains(&format!("% session   : {session}\n% revisions : last\n")), "{pos}");
    let (kind, csv) = track(&doors, &session, "track.csv").await;
    assert_eq!((&*kind, csv.lines().count()), ("text/csv; charset=utf-8", EPOCHS + 1));
    for (row, solution) in csv.lines().skip(1).zip(&solutions) {
        let expected = format!("{},{},", solution["seq"], solution["revision"]);
        assert!(row.starts_with(&expected), "{expected} {row}");
    }
    let (kind, geojson) = track(&doors, &session, "track.geojson").await;
    assert_eq!(kind, "application/geo+json");
    let document: Value = serde_json::from_str(&geojson).unwrap();
    let features = document["features"].as_array().unwrap();
    let points = features.iter().filter(|f| f["geometry"]["type"] == "Point").count();
    assert_eq!(points, positions);
    let (kind, kml) = track(&doors, &session, "track.kml").await;
    assert_eq!(kind, "application/vnd.google-earth.kml+xml");
    assert_eq!(kml.matches("<Point>").count(), positions);
    let (kind, gpx) = track(&doors, &session, "track.gpx").await;
    assert_eq!((&*kind, gpx.matches("<trkpt").count()), ("application/gpx+xml", positions));
    let (kind, nmea) = track(&doors, &session, "track.nmea").await;
    assert_eq!((&*kind, lines(&nmea, '$')), ("text/plain; charset=utf-8", 4 * EPOCHS));
}

#[tokio::test]
async fn a_track_is_chosen_as_a_list_is() {
    let doors = Doors::open().await;
    let session = driven(&doors).await;
    let rows = async |query: &str| {
        let (_, csv) = track(&doors, &session, &format!("track.csv?{query}")).await;
        let numbers = |row: &str| {
            let mut fields = row.split(',');
            (fields.next().unwrap().to_owned(), fields.next().unwrap().to_owned())
        };
        csv.lines().skip(1).map(numbers).collect::<Vec<_>>()
    };
    let time = |solution: &Value| {
        let ns = solution["time"]["nsOfWeek"].as_u64().unwrap();
        format!("{}:{}", solution["time"]["week"], ns as f64 * 1e-9)
    };
    let all = listed(&doors, &session, "").await;
    let (from, to) = (time(&all[20]), time(&all[300]));
    for query in [
        "revisions=all",
        "revisions=first",
        "status=FGO",
        "status=NONE&revisions=first",
        &format!("from={from}&to={to}"),
    ] {
        let solutions = listed(&doors, &session, &format!("&{query}")).await;
        let expected: Vec<_> =
            solutions.iter().map(|s| (s["seq"].to_string(), s["revision"].to_string())).collect();
        assert!(!expected.is_empty(), "{query}");
        assert_eq!(rows(query).await, expected, "{query}");
    }
}

/// A list with a format is the file of that format. Without a format, or with JSON, it is a page.
#[tokio::test]
async fn a_list_is_a_file_in_each_format() {
    let doors = Doors::open().await;
    let session = driven(&doors).await;
    for format in ["pos", "csv", "geojson", "kml", "gpx", "nmea"] {
        let chosen = "revisions=first&status=FGO";
        let by_list = format!("solutions?format={format}&{chosen}");
        let by_name = format!("track.{format}?{chosen}");
        let by_list = downloaded(&doors, &session, &by_list).await;
        assert_eq!(by_list, downloaded(&doors, &session, &by_name).await);
    }
    let path = format!("/v1/sessions/{session}/solutions?format=json&pageSize=2");
    let (status, page) = doors.get(&path).await;
    assert_eq!((status, page["solutions"].as_array().unwrap().len()), (StatusCode::OK, 2));
    for (query, field) in [
        ("format=csv&pageSize=2", "pageSize"),
        ("format=csv&pageToken=a", "pageToken"),
        ("format=csv&view=BASIC", "view"),
        ("format=shp", "format"),
    ] {
        let (status, problem) =
            doors.get(&format!("/v1/sessions/{session}/solutions?{query}")).await;
        let got = (status.as_u16(), problem["code"].as_str(), problem["field"].as_str());
        assert_eq!(got, (400, Some("INVALID_FIELD"), Some(field)), "{problem}");
    }
}

#[tokio::test]
async fn what_is_no_track_is_refused() {
    let doors = Doors::open().await;
    let session = driven(&doors).await;
    for (path, status, expected, field) in [
        ("{}/track.kml?revisions=all", 400, "INVALID_FIELD", "revisions"),
        ("{}/track.pos?revisions=newest", 400, "INVALID_FIELD", "revisions"),
        ("{}/track.csv?status=GOOD", 400, "INVALID_FIELD", "status"),
        ("{}/track.csv?to=now", 400, "INVALID_TIME", "to"),
        ("{}/track.csv?pageSize=2", 400, "UNKNOWN_FIELD", "pageSize"),
        ("ses_0/track.csv", 404, "SESSION_NOT_FOUND", "session"),
    ] {
        let path = format!("/v1/sessions/{}", path.replace("{}", &session));
        let (answered, problem) = doors.get(&path).await;
        let got = (answered.as_u16(), code(&problem), problem["field"].as_str());
        assert_eq!(got, (status, expected, Some(field)), "{path}");
    }
    let (status, problem) = doors.get(&format!("/v1/sessions/{session}/track.shp")).await;
    assert_eq!((status.as_u16(), code(&problem)), (404, "ROUTE_NOT_FOUND"));
    let mut client = SolutionsClient::new(doors.router.clone());
    let request = v1::TrackRequest { session, format: "shp".to_owned(), ..Default::default() };
    let refused = client.track(request).await.unwrap_err();
    assert!(refused.message().contains("pos, csv, geojson, kml, gpx, nmea"), "{refused}");
}

/// A program that is built with Parquet gives it. Others refuse it with the wrong field.
#[tokio::test]
async fn parquet_is_a_feature_of_the_build() {
    let doors = Doors::open().await;
    let session = driven(&doors).await;
    let path = format!("/v1/sessions/{session}/track.parquet?revisions=all");
    if cfg!(not(feature = "parquet")) {
        let (status, problem) = doors.get(&path).await;
        let got = (status.as_u16(), code(&problem), problem["field"].as_str());
        assert_eq!(got, (400, "FEATURE_NOT_BUILT", Some("format")), "{problem}");
        let (status, problem) = post_job(&doors, &session).await;
        let got = (status.as_u16(), code(&problem), problem["field"].as_str());
        assert_eq!(got, (400, "FEATURE_NOT_BUILT", Some("options.format")), "{problem}");
        return;
    }
    let (status, file) = bytes_of(&doors, &path).await;
    assert_eq!(
        (status, &file[..4], &file[file.len() - 4..]),
        (StatusCode::OK, &b"PAR1"[..], &b"PAR1"[..])
    );
    let (status, job) = post_job(&doors, &session).await;
    assert_eq!(status, StatusCode::CREATED, "{job}");
    let job = job["job"].as_str().unwrap();
    let done = ended(&doors, job).await;
    assert_eq!(done["state"], "SUCCEEDED", "{done}");
    let (_, result) = bytes_of(&doors, &format!("/v1/jobs/{job}/result")).await;
    // A stored solution has its number and revision, too.
    let Some(python) = python::with("pyarrow, duckdb") else { return };
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("stored.parquet"), &file).unwrap();
    std::fs::write(folder.path().join("computed.parquet"), &result).unwrap();
    let script = "import sys, pyarrow.parquet as p\n\
        s, c = (p.read_table(sys.argv[1] + n) for n in ('/stored.parquet', '/computed.parquet'))\n\
        print(s.num_rows, c.num_rows, s.column_names[:3], c.column_names[:2])";
    let mut read = std::process::Command::new(python);
    let read = read.args(["-c", script]).arg(folder.path()).output().unwrap();
    let text = String::from_utf8(read.stdout).unwrap();
    let listed = listed(&doors, &session, "&revisions=all").await.len();
    let columns = "['seq', 'revision', 'time_utc'] ['time_utc', 'gps_week']";
    assert_eq!(text.trim(), format!("{listed} {EPOCHS} {columns}"));
}

/// A job of the session with a result in Parquet.
async fn post_job(doors: &Doors, session: &str) -> (StatusCode, Value) {
    let options = json!({"session": session, "format": "parquet"}).to_string();
    super::jobs::post(doors, body(&[("options", options.as_bytes())]), &[]).await
}

/// A session without solutions is a complete file, too.
#[tokio::test]
async fn an_empty_track_is_a_document() {
    let doors = Doors::open().await;
    let session = doors.session().await;
    let (_, gpx) = track(&doors, &session, "track.gpx").await;
    assert!(gpx.contains("<trk>") && gpx.ends_with("</gpx>\n"), "{gpx}");
    let (_, geojson) = track(&doors, &session, "track.geojson").await;
    let document: Value = serde_json::from_str(&geojson).unwrap();
    assert_eq!(document["features"], json!([]));
}

#[tokio::test]
async fn both_doors_give_the_same_bytes_and_free_their_memory() {
    let doors = Doors::open().await;
    let session = driven(&doors).await;
    for format in ["csv", "geojson", "kml"] {
        let (_, by_rest) = track(&doors, &session, &format!("track.{format}")).await;
        let mut client = SolutionsClient::new(doors.router.clone());
        let format = format.to_owned();
        let request = v1::TrackRequest { session: session.clone(), format, ..Default::default() };
        let stream = client.track(request).await.unwrap().into_inner();
        let messages: Vec<_> = stream.map(|m| m.map(|m| m.content)).try_collect().await.unwrap();
        assert!(1 < messages.len(), "{} messages", messages.len());
        assert_eq!(String::from_utf8(messages.concat()).unwrap(), by_rest);
    }
    assert_eq!(doors.service.budget().used(), 0);
}
