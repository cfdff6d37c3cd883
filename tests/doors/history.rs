//! The history of sessions and fleets from rollups, on both databases.

use std::collections::BTreeMap;

use axum::http::StatusCode;
use graphfix::aiding::{AidingDesk, AidingLimits};
use graphfix::clock::Clock;
use graphfix::contract::{convert, v1};
use graphfix::gnss::GpsTime;
use graphfix::grpc::v1::history_client::HistoryClient;
use graphfix::grpc::v1::sessions_client::SessionsClient;
use graphfix::session::{HistoryQuery, SequencedEpoch, SessionId, SessionLimits, Sessions};
use serde_json::{Value, json};

use crate::support::database::{Database, on_both_databases};
use crate::support::doors::{Doors, code, epoch};
use crate::support::drive::DRIVE;
use crate::support::sessions::{self, new_session};

on_both_databases!(
    rollups_are_sums_of_first_answers,
    a_fleet_is_the_sum_of_its_sessions,
    sessions_are_found_by_area,
    both_doors_show_the_same_history,
    hours_outlive_epochs_and_minutes,
);

const EPOCHS: usize = 330;
const MINUTE_NS: u64 = 60_000_000_000;

/// Pushes the epochs of the drive from an index on.
async fn push(doors: &Doors, session: &str, epochs: std::ops::Range<usize>) {
    let message = |e: &SequencedEpoch| convert::epoch_message(e.seq, &e.epoch);
    let epochs: Vec<_> = DRIVE.epochs[epochs].iter().map(message).collect();
    let path = format!("/v1/sessions/{session}/epochs");
    let (status, answer) = doors.post(&path, json!({"epochs": epochs})).await;
    assert_eq!(status, StatusCode::OK, "{answer}");
    let results = answer["results"].as_array().unwrap();
    assert!(results.iter().all(|result| result["refusal"].is_null()), "{answer}");
}

/// A session in mode `fgo` with a part of the drive, in two pushes.
async fn driven(doors: &Doors, label: &str, epochs: usize) -> String {
    let (status, _) = doors.upload("/v1/navigation", DRIVE.navigation_file()).await;
    assert_eq!(status, StatusCode::OK);
    let (_, session) = doors.post("/v1/sessions", json!({"mode": "fgo", "label": label})).await;
    let session = session["session"].as_str().unwrap().to_owned();
    push(doors, &session, 0..epochs / 2).await;
    push(doors, &session, epochs / 2..epochs).await;
    session
}

/// The time of an epoch of the drive, as REST takes it.
fn time(index: usize) -> String {
    let time = DRIVE.epochs[index].epoch.time;
    format!("{}:{}", time.week(), time.seconds_of_week())
}

/// The query of the whole drive.
fn whole() -> String {
    format!("from={}&to={}", time(0), time(EPOCHS - 1))
}

async fn answer(doors: &Doors, path: &str) -> Value {
    let (status, answer) = doors.get(path).await;
    assert_eq!(status, StatusCode::OK, "{path}: {answer}");
    answer
}

async fn refused(doors: &Doors, path: &str) -> (String, String) {
    let (status, answer) = doors.get(path).await;
    assert_eq!(status, StatusCode::BAD_REQUEST, "{path}: {answer}");
    (code(&answer).to_owned(), answer["field"].as_str().unwrap_or_default().to_owned())
}

/// Counts by status, in any order.
fn counts(statuses: &Value) -> BTreeMap<String, u64> {
    let of =
        |s: &Value| (s["status"].as_str().unwrap().to_owned(), s["solutions"].as_u64().unwrap());
    statuses.as_array().unwrap().iter().map(of).collect()
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("{value} is not a number"))
}

/// The numbers under a path, of the solutions that have it.
fn values(solutions: &[&Value], of: impl Fn(&Value) -> Option<f64>) -> Vec<f64> {
    solutions.iter().filter_map(|solution| of(solution)).collect()
}

/// Checks a range with a relative tolerance of 1e-6, as minima and maxima are stored in 32 bits.
fn check_range(range: &Value, values: &[f64], what: &str) {
    let least = values.iter().copied().fold(f64::INFINITY, f64::min);
    let greatest = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    let last = *values.last().unwrap();
    for (name, expected) in [("min", least), ("max", greatest), ("mean", mean), ("last", last)] {
        let given = number(&range[name]);
        assert!(
            (given - expected).abs() <= 1e-6 * expected.abs(),
            "{what} {name}: {given}, {expected}"
        );
    }
}

/// Each minute has the sums of the first answers of its epochs; revisions, which the closed session
/// has, and epochs that are sent again change nothing.
async fn rollups_are_sums_of_first_answers(database: Database) {
    let doors = Doors::on(&database.url).await;
    let session = driven(&doors, "", EPOCHS).await;
    push(&doors, &session, EPOCHS - 20..EPOCHS).await; // Again.
    doors.send("DELETE", &format!("/v1/sessions/{session}"), json!({})).await;
    assert!(EPOCHS as i64 / 2 < database.count("revisions").await);
    let path = format!("/v1/sessions/{session}/solutions?revisions=first&pageSize=10000");
    let listed = answer(&doors, &path).await;
    let mut minutes: BTreeMap<u64, Vec<&Value>> = BTreeMap::new();
    for solution in listed["solutions"].as_array().unwrap() {
        let ns = solution["time"]["nsOfWeek"].as_u64().unwrap();
        minutes.entry(ns / MINUTE_NS).or_default().push(solution);
    }
    let path = format!("/v1/history/sessions/{session}?{}", whole());
    let history = answer(&doors, &path).await;
    assert_eq!((&history["rollupLengthS"], &history["solutions"]), (&json!(60), &json!(EPOCHS)));
    assert_eq!(history["intervalLengthS"], json!(60.0));
    let intervals = history["intervals"].as_array().unwrap();
    assert!(5 < minutes.len() && intervals.len() == minutes.len());
    let first = *minutes.first_key_value().unwrap().0;
    for (interval, (minute, solutions)) in intervals.iter().zip(&minutes) {
        assert_eq!(interval["index"], json!(minute - first));
        check_interval(interval, solutions);
    }
    // The same in two intervals, and over hours where the span is longer than a week.
    let halves = answer(&doors, &format!("{path}&points=2")).await;
    let halves = halves["intervals"].as_array().unwrap();
    let all: Vec<&Value> = minutes.values().flatten().copied().collect();
    let sum: u64 = halves.iter().map(|half| half["solutions"].as_u64().unwrap()).sum();
    assert_eq!((halves.len(), sum), (2, EPOCHS as u64));
    let (week, to) = (DRIVE.epochs[0].epoch.time.week(), time(EPOCHS - 1));
    let month = format!("/v1/history/sessions/{session}?from={}:0&to={to}&points=1", week - 4);
    let month = answer(&doors, &month).await;
    assert_eq!(month["rollupLengthS"], json!(3600));
    check_interval(&month["intervals"][0], &all);
    doors.close().await;
}

fn check_interval(interval: &Value, solutions: &[&Value]) {
    assert_eq!(interval["solutions"], json!(solutions.len()));
    let mut statuses = BTreeMap::new();
    for solution in solutions {
        *statuses.entry(solution["status"].as_str().unwrap().to_owned()).or_insert(0) += 1;
    }
    assert_eq!(counts(&interval["statuses"]), statuses);
    let (first, last) = (solutions[0], solutions[solutions.len() - 1]);
    assert_eq!((&interval["firstTime"], &interval["lastTime"]), (&first["time"], &last["time"]));
    assert_eq!((&interval["seq"], &interval["status"]), (&last["seq"], &last["status"]));
    let geodetic = |field: &'static str| {
        values(solutions, move |solution| solution["position"]["geodetic"][field].as_f64())
    };
    check_range(&interval["heightM"], &geodetic("heightM"), "height");
    let satellites = values(solutions, |solution| {
        let used = solution["satellitesUsed"].as_array().unwrap().len() as f64;
        (!solution["position"].is_null()).then_some(used)
    });
    check_range(&interval["satellites"], &satellites, "satellites");
    // The greater eigenvalue of east and north.
    let sigmas = values(solutions, |solution| {
        let enu = &solution["position"]["covarianceEnuM2"];
        let [east, north, both] =
            ["firstFirst", "secondSecond", "firstSecond"].map(|name| enu[name].as_f64());
        let (east, north, both) = (east?, north?, both?);
        Some((f64::midpoint(east, north) + ((east - north) / 2.0).hypot(both)).sqrt())
    });
    check_range(&interval["horizontalSigmaM"], &sigmas, "sigma");
    assert!(interval["ageS"].is_null());
    let (latitudes, longitudes) = (geodetic("latitudeDeg"), geodetic("longitudeDeg"));
    let area = &interval["area"];
    for (side, values, sign) in [
        ("southDeg", &latitudes, -1.0),
        ("northDeg", &latitudes, 1.0),
        ("westDeg", &longitudes, -1.0),
        ("eastDeg", &longitudes, 1.0),
    ] {
        let end = values.iter().map(|value| sign * value).fold(f64::NEG_INFINITY, f64::max);
        assert_eq!(number(&area[side]), sign * end, "{side}");
    }
    let position = &interval["position"];
    assert_eq!(number(&position["latitudeDeg"]), *latitudes.last().unwrap());
    assert_eq!(number(&position["longitudeDeg"]), *longitudes.last().unwrap());
}

/// A deleted session is no longer in the fleet's history: two sessions, then one, then none.
async fn a_fleet_is_the_sum_of_its_sessions(database: Database) {
    let doors = Doors::on(&database.url).await;
    let fleet = format!("/v1/history/fleet?{}&points=1", whole());
    assert_eq!(answer(&doors, &fleet).await["intervals"], json!([]));
    let (one, other) = (driven(&doors, "", 200).await, driven(&doors, "", EPOCHS).await);
    let mut expected: BTreeMap<String, u64> = BTreeMap::new();
    for session in [&one, &other] {
        let history = answer(&doors, &format!("/v1/history/sessions/{session}?{}", whole())).await;
        for (status, solutions) in counts(&history["statuses"]) {
            *expected.entry(status).or_default() += solutions;
        }
    }
    let both = answer(&doors, &fleet).await;
    assert_eq!(counts(&both["statuses"]), expected);
    assert_eq!(expected.values().sum::<u64>(), 200 + EPOCHS as u64);
    let interval = &both["intervals"][0];
    assert_eq!((&interval["sessions"], &interval["index"]), (&json!(2), &json!(0)));
    assert_eq!(counts(&interval["statuses"]), expected);
    assert!(0.0 < number(&interval["horizontalSigmaMeanM"]) && interval["ageMeanS"].is_null());
    assert!(4.0 < number(&interval["satellitesMean"]));

    doors.send("DELETE", &format!("/v1/sessions/{one}?purge=true"), Value::Null).await;
    let left = doors.until(&fleet, |fleet| fleet["intervals"][0]["sessions"] == json!(1)).await;
    let history = answer(&doors, &format!("/v1/history/sessions/{other}?{}", whole())).await;
    assert_eq!(counts(&left["statuses"]), counts(&history["statuses"]));
    doors.send("DELETE", &format!("/v1/sessions/{other}?purge=true"), Value::Null).await;
    doors.until(&fleet, |fleet| fleet["intervals"] == json!([])).await;
    for table in ["rollups", "fleet_hours"] {
        assert_eq!(database.count(table).await, 0, "{table}");
    }
    for (query, code, field) in [
        ("points=4001", "INVALID_FIELD", "points"),
        ("from=1000:0&to=1058:0", "INVALID_FIELD", "from"),
        ("from=yesterday", "INVALID_TIME", "from"),
        ("from=2000:10&to=2000:5", "INVALID_FIELD", "to"),
    ] {
        let refusal = refused(&doors, &format!("/v1/history/fleet?{query}")).await;
        assert_eq!(refusal, (code.to_owned(), field.to_owned()), "{query}");
    }
    let empty = answer(&doors, "/v1/history/fleet?from=2000:5&to=2000:10").await;
    assert_eq!(empty["intervals"], json!([]));
    doors.close().await;
}

/// Sessions by the area in which they have been or are now, page by page and with the other
/// filters.
async fn sessions_are_found_by_area(database: Database) {
    let doors = Doors::on(&database.url).await;
    let mut driven_ids = Vec::new();
    for label in ["a", "b", "a"] {
        driven_ids.insert(0, driven(&doors, label, 60).await);
    }
    let session = doors.session().await; // Without a position.
    doors.post(&format!("/v1/sessions/{session}/epochs"), json!({"epochs": [epoch(1)]})).await;
    let summary =
        &answer(&doors, &format!("/v1/history/sessions?{}", whole())).await["sessions"][0];
    let side = |name: &str| number(&summary["area"][name]);
    let (south, west) = (side("southDeg"), side("westDeg"));
    let (north, east) = (side("northDeg"), side("eastDeg"));
    assert_eq!((&summary["solutions"], &summary["label"]), (&json!(60), &json!("a")));
    assert!(number(&summary["horizontalSigmaMeanM"]) <= number(&summary["horizontalSigmaMaxM"]));
    assert!(number(&summary["satellitesMin"]) <= number(&summary["satellitesMean"]));

    let around = format!("{},{},{},{}", south - 0.1, west - 0.1, north + 0.1, east + 0.1);
    let beside = format!("{},{},{},{}", north + 0.1, west - 0.1, north + 0.2, east + 0.1);
    // An area from just east of the session around the world to just west of it does not contain
    // it.
    let without = format!("{},{},{},{}", south - 0.1, east + 0.1, north + 0.1, west - 0.1);
    let across = format!("{},{},{},{}", south - 0.1, west - 0.1, north + 0.1, west - 0.2);
    let (heads, histories) = ("/v1/sessions:heads?", format!("/v1/history/sessions?{}", whole()));
    for (list, path) in [("heads", heads), ("sessions", &histories)] {
        for (query, expected) in [
            (format!("&area={around}"), &driven_ids[..]),
            (format!("&area={across}"), &driven_ids[..]),
            (format!("&area={beside}"), &[]),
            (format!("&area={without}"), &[]),
            (format!("&area={around}&label=b&mode=fgo&closed=false"), &driven_ids[1..2]),
            (format!("&area={around}&closed=true"), &[]),
        ] {
            let found = pages(&doors, list, &format!("{path}{query}"), 2).await;
            assert_eq!(found, expected, "{list} {query}");
        }
        for (area, field) in [
            ("1,2,3", "area"),
            ("91,0,92,1", "area.southDeg"),
            ("0,-181,1,1", "area.westDeg"),
            ("2,0,1,1", "area.northDeg"),
            ("0,0,1,NaN", "area.eastDeg"),
        ] {
            let refusal = refused(&doors, &format!("{path}&area={area}")).await;
            assert_eq!(refusal, ("INVALID_FIELD".to_owned(), field.to_owned()), "{list} {area}");
        }
    }
    let refusal = refused(&doors, &format!("{histories}&pageSize=1001")).await;
    assert_eq!(refusal.0, "PAGE_SIZE_INVALID");
    let (_, page) = doors.get(&format!("{histories}&pageSize=1")).await;
    let token = page["nextPageToken"].as_str().unwrap();
    let other = format!("{histories}&area={around}&pageToken={token}");
    assert_eq!(refused(&doors, &other).await.0, "PAGE_TOKEN_INVALID");
    doors.close().await;
}

/// The sessions of a list, page by page.
async fn pages(doors: &Doors, list: &str, path: &str, size: usize) -> Vec<String> {
    let (mut found, mut token) = (Vec::new(), String::new());
    for _ in 0..10 {
        let page = answer(doors, &format!("{path}&pageSize={size}&pageToken={token}")).await;
        let items = page[list].as_array().unwrap();
        assert!(items.len() <= size);
        found.extend(items.iter().map(|item| item["session"].as_str().unwrap().to_owned()));
        token = page["nextPageToken"].as_str().unwrap().to_owned();
        if token.is_empty() {
            return found;
        }
    }
    panic!("{path} has no last page");
}

async fn both_doors_show_the_same_history(database: Database) {
    let doors = Doors::on(&database.url).await;
    let session = driven(&doors, "", 100).await;
    let mut history = HistoryClient::new(doors.router.clone());
    let span = |index: usize| Some(v1::GpsTime::from(DRIVE.epochs[index].epoch.time));
    let (from, to) = (span(0), span(EPOCHS - 1));

    let request = v1::FleetHistoryRequest { from, to, points: 0 };
    let mut fleet = json!(history.fleet(request).await.unwrap().into_inner());
    let mut by_rest = answer(&doors, &format!("/v1/history/fleet?{}", whole())).await;
    fleet["nowUtc"] = json!("");
    by_rest["nowUtc"] = json!("");
    assert_eq!(fleet, by_rest);

    let area =
        Some(v1::Area { south_deg: -90.0, west_deg: -180.0, north_deg: 90.0, east_deg: 180.0 });
    let request = v1::ListSessionHistoriesRequest { from, to, area, ..Default::default() };
    let sessions = json!(history.sessions(request).await.unwrap().into_inner());
    assert_eq!(sessions["sessions"][0]["session"], json!(session));
    let path = format!("/v1/history/sessions?{}&area=-90,-180,90,180", whole());
    assert_eq!(sessions, answer(&doors, &path).await);

    // Without a span: the day before the last hour of the session.
    let request = v1::SessionHistoryRequest { session: session.clone(), ..Default::default() };
    let one = json!(history.session(request).await.unwrap().into_inner());
    assert_eq!(one["solutions"], json!(100));
    assert_eq!(one, answer(&doors, &format!("/v1/history/sessions/{session}")).await);

    let request = v1::ListHeadsRequest { area, ..Default::default() };
    let heads = SessionsClient::new(doors.router.clone()).heads(request).await.unwrap();
    assert_eq!(heads.into_inner().heads.len(), 1);
    let unknown = format!("/v1/history/sessions/{}", SessionId::random());
    assert_eq!(code(&doors.get(&unknown).await.1), "SESSION_NOT_FOUND");
    doors.close().await;
}

const MS_PER_DAY: i64 = 86_400_000;
/// 2026-01-01 12:00 UTC.
const START: i64 = (20_454 * 2 + 1) * MS_PER_DAY / 2;
const PER_DAY: u64 = 300;

/// Minutes are removed with their epochs, and the session's history is then that of hours; these
/// are removed after a time of their own.
async fn hours_outlive_epochs_and_minutes(database: Database) {
    let (store, clock) = (database.store().await, Clock::at(START));
    let aiding = AidingDesk::open(store.clone(), AidingLimits::service()).await.unwrap();
    let limits = SessionLimits { retention_days: 2, history_days: 8, ..SessionLimits::service() };
    let desk = Sessions::open_at(store.clone(), aiding, limits, clock.clone());
    let id = desk.create(new_session()).await.unwrap().id;
    for day in 0..5 {
        clock.set(START + day * MS_PER_DAY);
        let seqs = day as u64 * PER_DAY + 1..=(day as u64 + 1) * PER_DAY;
        let epochs = seqs.map(|seq| sessions::epoch(seq, 10.0 * seq as f64)).collect();
        let submitted = desk.submit(&id, epochs).await.unwrap();
        assert!(submitted.outcomes.iter().all(|outcome| outcome.result.is_ok()));
        desk.remove_expired().await.unwrap();
    }
    let epochs = database.count("epochs").await as u64;
    assert!((2 * PER_DAY..=4 * PER_DAY).contains(&epochs), "{epochs}");
    let all = HistoryQuery {
        from: Some(GpsTime::from_week_seconds(2051, 0.0)),
        to: Some(GpsTime::from_week_seconds(2051, 20_000.0)),
        points: 4_000,
    };
    let history = desk.history(&id, &all).await.unwrap();
    assert_eq!((history.rollup_s, history.statuses.total()), (3_600, 5 * PER_DAY));
    let recent = HistoryQuery { from: Some(GpsTime::from_week_seconds(2051, 12_000.0)), ..all };
    let history = desk.history(&id, &recent).await.unwrap();
    assert_eq!(history.rollup_s, 60);
    assert_eq!(history.statuses.total(), 5 * PER_DAY - 1_199);

    desk.close(&id).await.unwrap();
    clock.set(START + 10 * MS_PER_DAY);
    desk.remove_expired().await.unwrap();
    assert_eq!(database.count("epochs").await, 0);
    assert_eq!(database.count("rollups WHERE seconds = 60").await, 0);
    let hours = database.count("rollups").await;
    assert_eq!(hours, 4, "of five hours the first had its last epoch nine days before");
    clock.set(START + 14 * MS_PER_DAY);
    desk.remove_expired().await.unwrap();
    for table in ["rollups", "fleet_hours"] {
        assert_eq!(database.count(table).await, 0, "{table}");
    }
    desk.drain().await;
    store.close().await;
}
