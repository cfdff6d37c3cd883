//! `/v1/sessions/{session}/solutions`.

use axum::http::StatusCode;
use graphfix::config::Limits;
use graphfix::contract::convert;
use graphfix::session::SequencedEpoch;
use serde_json::{Value, json};

use crate::support::doors::{Doors, code, epoch};
use crate::support::drive::DRIVE;

fn numbers(page: &Value) -> Vec<u64> {
    let solutions = page["solutions"].as_array().unwrap();
    solutions.iter().map(|solution| solution["seq"].as_u64().unwrap()).collect()
}

#[tokio::test]
async fn solutions_are_listed_by_time_status_and_page() {
    let doors = Doors::open().await;
    let session = doors.session().await;
    let epochs: Vec<_> = (1..=5).map(epoch).collect();
    doors.post(&format!("/v1/sessions/{session}/epochs"), json!({"epochs": epochs})).await;
    let path = format!("/v1/sessions/{session}/solutions");

    let (status, first) = doors.get(&format!("{path}?pageSize=3")).await;
    assert_eq!((status, numbers(&first)), (StatusCode::OK, vec![1, 2, 3]));
    let token = first["nextPageToken"].as_str().unwrap();
    let (_, second) = doors.get(&format!("{path}?pageSize=3&pageToken={token}")).await;
    assert_eq!((numbers(&second), &second["nextPageToken"]), (vec![4, 5], &json!("")));

    let (_, basic) = doors.get(&format!("{path}?pageSize=3&view=BASIC")).await;
    assert_eq!(numbers(&basic), [1, 2, 3]);
    let (whole, short) = (&first["solutions"][0], &basic["solutions"][0]);
    assert_eq!((&short["status"], &short["reasons"]), (&whole["status"], &whole["reasons"]));
    assert!(whole["provenance"].is_object() && short["provenance"].is_null(), "{short}");

    let (_, within) = doors.get(&format!("{path}?from=2051:46703&to=2051:46704.5")).await;
    assert_eq!(numbers(&within), [2, 3]);
    assert_eq!(numbers(&doors.get(&format!("{path}?status=NONE")).await.1).len(), 5);
    assert_eq!(numbers(&doors.get(&format!("{path}?status=SINGLE")).await.1), [0; 0]);
}

/// A page that needs more memory than there is ends early, and its token goes on.
#[tokio::test]
async fn a_page_ends_before_the_memory_does() {
    let doors = Doors::with(Limits { request_memory_bytes: 16 << 20, ..Limits::standard() }).await;
    let session = doors.session().await;
    for first in [1, 601] {
        let epochs: Vec<_> = (first..first + 600).map(epoch).collect();
        let path = format!("/v1/sessions/{session}/epochs");
        let (status, answer) = doors.post(&path, json!({"epochs": epochs})).await;
        assert_eq!(status, StatusCode::OK, "{answer}");
    }
    let path = format!("/v1/sessions/{session}/solutions?pageSize=10000");
    let (_, page) = doors.get(&path).await;
    assert_eq!(numbers(&page), (1..=1024).collect::<Vec<_>>());
    let token = page["nextPageToken"].as_str().unwrap();
    let (_, rest) = doors.get(&format!("{path}&pageToken={token}")).await;
    assert_eq!(numbers(&rest), (1025..=1200).collect::<Vec<_>>());
    assert_eq!(rest["nextPageToken"], json!(""));
    let (status, refused) = doors.get(&format!("{path}0")).await;
    assert_eq!((status, code(&refused)), (StatusCode::BAD_REQUEST, "PAGE_SIZE_INVALID"));
}

/// The latest answer to each epoch unless the query requires another one.
#[tokio::test]
async fn revisions_are_chosen() {
    let doors = Doors::open().await;
    let (status, _) = doors.upload("/v1/navigation", DRIVE.navigation_file()).await;
    assert_eq!(status, StatusCode::OK);
    let (_, session) = doors.post("/v1/sessions", json!({"mode": "fgo"})).await;
    let session = session["session"].as_str().unwrap();
    let message = |e: &SequencedEpoch| convert::epoch_message(e.seq, &e.epoch);
    let epochs: Vec<_> = DRIVE.epochs[..30].iter().map(message).collect();
    let (status, answer) =
        doors.post(&format!("/v1/sessions/{session}/epochs"), json!({"epochs": epochs})).await;
    assert_eq!((status, &answer["durableThrough"]), (StatusCode::OK, &json!(30)));
    let (status, closed) =
        doors.send("DELETE", &format!("/v1/sessions/{session}"), json!({})).await;
    assert_eq!((status, &closed["closed"]), (StatusCode::OK, &json!(true)));
    let listed = async |query: &str| {
        let path = format!("/v1/sessions/{session}/solutions{query}");
        let (status, page) = doors.get(&path).await;
        assert_eq!(status, StatusCode::OK, "{page}");
        let revision = |solution: &Value| solution["revision"].as_u64().unwrap();
        page["solutions"].as_array().unwrap().iter().map(revision).collect::<Vec<_>>()
    };
    assert_eq!(listed("").await, [1; 30]);
    assert_eq!(listed("?revisions=last").await, [1; 30]);
    assert_eq!(listed("?revisions=first").await, [0; 30]);
    assert_eq!(listed("?revisions=all").await, [0, 1].repeat(30));
    let (status, refused) =
        doors.get(&format!("/v1/sessions/{session}/solutions?revisions=ALL")).await;
    assert_eq!((status, &refused["field"]), (StatusCode::BAD_REQUEST, &json!("revisions")));
}

/// A session in mode `fgo` with the first epochs of the drive.
async fn driven(doors: &Doors, epochs: usize) -> String {
    let (status, _) = doors.upload("/v1/navigation", DRIVE.navigation_file()).await;
    assert_eq!(status, StatusCode::OK);
    let (_, session) = doors.post("/v1/sessions", json!({"mode": "fgo"})).await;
    let session = session["session"].as_str().unwrap().to_owned();
    let message = |e: &SequencedEpoch| convert::epoch_message(e.seq, &e.epoch);
    let epochs: Vec<_> = DRIVE.epochs[..epochs].iter().map(message).collect();
    let path = format!("/v1/sessions/{session}/epochs");
    let (status, answer) = doors.post(&path, json!({"epochs": epochs})).await;
    assert_eq!(status, StatusCode::OK, "{answer}");
    session
}

/// The intervals of a series against the listed solutions that fall into them.
#[tokio::test]
async fn a_series_thins_the_solutions() {
    let doors = Doors::open().await;
    let session = driven(&doors, 30).await;
    let path = format!("/v1/sessions/{session}/solutions");
    let (_, listed) = doors.get(&format!("{path}?revisions=first")).await;
    let (status, series) = doors.get(&format!("{path}:series?points=7&revisions=first")).await;
    assert_eq!((status, &series["solutions"]), (StatusCode::OK, &json!(30)), "{series}");
    let intervals = series["intervals"].as_array().unwrap();
    assert_eq!(intervals.len(), 7);
    let mut rest = listed["solutions"].as_array().unwrap().as_slice();
    for interval in intervals {
        let count = interval["solutions"].as_u64().unwrap() as usize;
        let (inside, after) = rest.split_at(count);
        rest = after;
        let last = inside.last().unwrap();
        assert_eq!((&interval["seq"], &interval["time"]), (&last["seq"], &last["time"]));
        assert_eq!(interval["status"], last["status"]);
        assert_eq!(interval["position"], last["position"]["geodetic"]);
        let count = |s: &Value| s["satellitesUsed"].as_array().unwrap().len() as f64;
        let used = inside.iter().map(count);
        let range = &interval["satellites"];
        assert_eq!(range["min"].as_f64(), used.clone().reduce(f64::min));
        assert_eq!(range["max"].as_f64(), used.clone().reduce(f64::max));
        assert_eq!(range["last"].as_f64(), inside.last().map(count));
    }
    assert!(rest.is_empty());
    let statuses = series["statuses"].as_array().unwrap().iter();
    assert_eq!(statuses.map(|of| of["solutions"].as_u64().unwrap()).sum::<u64>(), 30);

    let one = &listed["solutions"][10]["time"];
    let second = one["nsOfWeek"].as_u64().unwrap() as f64 * 1e-9;
    let at = format!("{}:{second}", one["week"]);
    let (_, single) = doors.get(&format!("{path}:series?from={at}&to={at}")).await;
    assert_eq!(single["intervals"].as_array().unwrap().len(), 1, "{single}");
    assert_eq!(single["intervals"][0]["seq"], listed["solutions"][10]["seq"]);
}

#[tokio::test]
async fn a_series_has_limits() {
    let doors = Doors::open().await;
    let session = doors.session().await;
    let path = format!("/v1/sessions/{session}/solutions:series");
    let (status, empty) = doors.get(&path).await;
    assert_eq!(
        (status, &empty["intervals"], &empty["from"]),
        (StatusCode::OK, &json!([]), &json!(null))
    );
    for (query, field) in
        [("points=4001", "points"), ("revisions=all", "revisions"), ("pageToken=x", "pageToken")]
    {
        let epochs: Vec<_> = (1..=2).map(epoch).collect();
        doors.post(&format!("/v1/sessions/{session}/epochs"), json!({"epochs": epochs})).await;
        let (status, refused) = doors.get(&format!("{path}?{query}")).await;
        assert_eq!(
            (status, &refused["field"]),
            (StatusCode::BAD_REQUEST, &json!(field)),
            "{refused}"
        );
    }
}

/// Each satellite of an epoch has its direction and role; those of the position agree with it.
#[tokio::test]
async fn an_epoch_is_explained() {
    let doors = Doors::open().await;
    let session = driven(&doors, 5).await;
    let path = format!("/v1/sessions/{session}");
    let (status, last) = doors.get(&format!("{path}/epochs/last")).await;
    assert_eq!(status, StatusCode::OK, "{last}");
    let (_, fifth) = doors.get(&format!("{path}/epochs/5")).await;
    assert_eq!(last, fifth);
    let (_, listed) = doors.get(&format!("{path}/solutions?from=2051:0")).await;
    let solution = listed["solutions"].as_array().unwrap().last().unwrap();
    assert_eq!(last["solutions"], json!([solution]));

    let satellites = last["satellites"].as_array().unwrap();
    let used: Vec<&Value> = satellites.iter().filter(|view| view["role"] == "USED").collect();
    let mut names: Vec<&str> =
        used.iter().map(|view| view["satellite"].as_str().unwrap()).collect();
    names.sort_unstable();
    let used_by = solution["satellitesUsed"].as_array().unwrap();
    let mut used_names: Vec<&str> = used_by.iter().map(|name| name.as_str().unwrap()).collect();
    used_names.sort_unstable();
    assert_eq!(names, used_names);
    for view in &used {
        let (azimuth, elevation) = (view["azimuthDeg"].as_f64(), view["elevationDeg"].as_f64());
        assert!((0.0..360.0).contains(&azimuth.unwrap()), "{view}");
        assert!((0.0..90.0).contains(&elevation.unwrap()), "{view}");
        assert!(view["signals"][0]["cn0DbHz"].as_f64().is_some_and(|cn0| 10.0 < cn0), "{view}");
    }
    // The median of each constellation takes its clock away, so residuals are metres.
    let residuals = used.iter().filter_map(|view| view["residualM"].as_f64());
    assert!(4 <= residuals.clone().count());
    assert!(residuals.clone().all(|residual_m| residual_m.abs() < 100.0), "{last}");

    let (status, refused) = doors.get(&format!("{path}/epochs/77")).await;
    assert_eq!((status, code(&refused)), (StatusCode::NOT_FOUND, "EPOCH_NOT_FOUND"));
    let (status, refused) = doors.get(&format!("{path}/epochs/first")).await;
    assert_eq!((status, &refused["field"]), (StatusCode::BAD_REQUEST, &json!("seq")));
}

/// The residuals of an epoch are those of its explanation.
#[tokio::test]
async fn residuals_over_time_are_those_of_each_epoch() {
    let doors = Doors::open().await;
    let session = driven(&doors, 9).await;
    let path = format!("/v1/sessions/{session}");
    let (status, answer) = doors.get(&format!("{path}/solutions:residuals?points=3")).await;
    assert_eq!(status, StatusCode::OK, "{answer}");
    let points = answer["points"].as_array().unwrap();
    let seqs: Vec<u64> = points.iter().map(|point| point["seq"].as_u64().unwrap()).collect();
    assert_eq!(seqs, [1, 5, 9]);
    for point in points {
        let (_, explained) = doors.get(&format!("{path}/epochs/{}", point["seq"])).await;
        assert_eq!(point["time"], explained["solutions"][0]["time"]);
        let views = explained["satellites"].as_array().unwrap().iter();
        let used = views.filter(|view| view["role"] == "USED");
        let residuals: Vec<(f64, &Value)> =
            used.filter_map(|view| Some((view["residualM"].as_f64()?, view))).collect();
        assert!(4 <= residuals.len(), "{explained}");
        let squares: f64 = residuals.iter().map(|(metres, _)| metres * metres).sum();
        let rms_m = (squares / residuals.len() as f64).sqrt();
        assert_eq!(point["satellites"], json!(residuals.len()));
        assert!((point["rmsM"].as_f64().unwrap() - rms_m).abs() < 1e-9, "{point}");
        let by_amount = |a: &&(f64, &Value), b: &&(f64, &Value)| a.0.abs().total_cmp(&b.0.abs());
        let (largest_m, view) = residuals.iter().max_by(by_amount).unwrap();
        assert_eq!(point["largestM"].as_f64(), Some(*largest_m));
        assert_eq!(point["largestSatellite"], view["satellite"]);
    }

    let (week, from) = (&points[1]["time"]["week"], &points[1]["time"]["nsOfWeek"]);
    let second = from.as_u64().unwrap() as f64 * 1e-9;
    let (_, later) = doors.get(&format!("{path}/solutions:residuals?from={week}:{second}")).await;
    let later = later["points"].as_array().unwrap();
    assert_eq!((later.len(), &later[0]), (5, &points[1]));
    let (status, refused) = doors.get(&format!("{path}/solutions:residuals?points=501")).await;
    assert_eq!((status, &refused["field"]), (StatusCode::BAD_REQUEST, &json!("points")));
    let empty = doors.session().await;
    let (_, none) = doors.get(&format!("/v1/sessions/{empty}/solutions:residuals")).await;
    assert_eq!(none["points"], json!([]));
}
