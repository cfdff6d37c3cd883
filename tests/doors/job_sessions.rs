//! Jobs over stored sessions: the same positions again, or those that other options, another base
//! or smoothing would have given.

use std::collections::BTreeMap;

use axum::http::{Request, StatusCode};
use graphfix::aiding::bases::{BaseChoice, BaseId};
use graphfix::config::{JobsConfiguration, Mode, PositioningOptions, Profile};
use graphfix::contract::v1;
use graphfix::gnss::{Epoch, GpsTime, Navigation, Solution};
use graphfix::positioning::{Aiding, Batch};
use graphfix::session::{NewSession, SequencedEpoch, SessionId, SessionUpdate, Sessions};
use serde_json::{Value, json};

use super::jobs::{
    all_turns, bytes_of, created, ended, held_midway, kept_answers, post, restarted_midway,
};
use super::tenants::world::{Key, asked as asked_by, operator, sent, session};
use crate::support::database::{Database, on_both_databases};
use crate::support::doors::{Doors, code, epoch};
use crate::support::drive::DRIVE;
use crate::support::jobs::{BOUNDARY, LONG, MINUTE, body};
use crate::support::pair::PAIR;
use crate::support::sessions::new_session;

on_both_databases!(
    the_session_itself_gives_its_stored_solutions,
    a_restart_changes_no_answer,
    another_mode_gives_what_a_session_of_it_has,
    a_base_gives_what_a_session_relative_to_it_has,
    a_deleted_session_fails_its_jobs,
    a_database_that_fails_for_a_time_fails_no_job,
);

/// Resolution of positions in CSV (m), and rounding.
const CSV_M: f64 = 1e-3;

/// A job's options as the only part.
fn asked(options: &Value) -> Vec<u8> {
    body(&[("options", options.to_string().as_bytes())])
}

async fn opened(doors: &Doors, mode: &str, base: BaseChoice<BaseId>) -> SessionId {
    let new = NewSession { mode: mode.to_owned(), base, ..new_session() };
    sessions(doors).create(new).await.unwrap().id
}

fn sessions(doors: &Doors) -> &Sessions {
    doors.service.sessions()
}

async fn pushed(doors: &Doors, id: &SessionId, epochs: &[SequencedEpoch]) {
    for batch in epochs.chunks(50) {
        let outcomes = sessions(doors).submit(id, batch.to_vec()).await.unwrap().outcomes;
        assert!(outcomes.iter().all(|outcome| outcome.result.is_ok()));
    }
}

async fn given(doors: &Doors, navigation: &Navigation) {
    doors.service.navigation().push(navigation.clone(), "simulation").await.unwrap();
}

/// A session's stored solutions of one revision, as rows like those of a job's CSV result.
async fn stored(doors: &Doors, id: &SessionId, revision: &str) -> Vec<String> {
    let path = format!("/v1/sessions/{id}/track.csv?revisions=all");
    let (status, content) = bytes_of(doors, &path).await;
    assert_eq!(status, StatusCode::OK);
    let text = String::from_utf8(content).unwrap();
    let of_revision = |line: &str| {
        let [_, of, row] = line.splitn(3, ',').collect::<Vec<_>>()[..] else { panic!("{line}") };
        (of == revision).then(|| row.to_owned())
    };
    text.lines().skip(1).filter_map(of_revision).collect()
}

/// The rows of a job's result, which is CSV, and its report.
async fn computed(doors: &Doors, content: Vec<u8>) -> (Vec<String>, Value) {
    let job = created(doors, content).await;
    let done = ended(doors, &job).await;
    assert_eq!(done["state"], "SUCCEEDED", "{done}");
    assert_eq!(done["progress"]["percent"], 100.0, "{done}");
    let (_, report) = doors.get(&format!("/v1/jobs/{job}/report")).await;
    (rows_of(doors, &job).await, report)
}

async fn rows_of(doors: &Doors, job: &str) -> Vec<String> {
    let (_, result) = bytes_of(doors, &format!("/v1/jobs/{job}/result")).await;
    let text = String::from_utf8(result).unwrap();
    text.lines().skip(1).map(ToOwned::to_owned).collect()
}

/// A session had other ephemerides, other options and a reset on the way. A job with the session's
/// own options gives the bits of its solutions and its revisions.
async fn the_session_itself_gives_its_stored_solutions(database: Database) {
    let doors = Doors::on(&database.url).await;
    given(&doors, &DRIVE.navigation_without_galileo()).await;
    let id = opened(&doors, "fgo", BaseChoice::None).await;
    pushed(&doors, &id, &DRIVE.epochs[..80]).await;
    given(&doors, &DRIVE.navigation).await;
    pushed(&doors, &id, &DRIVE.epochs[80..150]).await;
    let overrides = BTreeMap::from([("elevation_mask_deg".to_owned(), "12".to_owned())]);
    let change = SessionUpdate { overrides, ..SessionUpdate::default() };
    sessions(&doors).update(&id, change).await.unwrap();
    pushed(&doors, &id, &DRIVE.epochs[150..300]).await;
    sessions(&doors).reset(&id).await.unwrap();
    pushed(&doors, &id, &DRIVE.epochs[300..]).await;
    sessions(&doors).close(&id).await.unwrap();

    let own = json!({"session": id.to_string(), "format": "csv"});
    let (rows, report) = computed(&doors, asked(&own)).await;
    assert_eq!(rows.len(), DRIVE.epochs.len());
    assert_eq!(rows, stored(&doors, &id, "0").await);
    let lines = report["provenance"].to_string();
    let epochs = format!("session {id}: epochs 1 to {}", DRIVE.epochs.len());
    assert!(lines.contains(&epochs) && lines.contains("those of the session's answers"), "{lines}");
    let mut smoothed = own.clone();
    smoothed["smoothed"] = json!(true);
    let (rows, _) = computed(&doors, asked(&smoothed)).await;
    let revisions = stored(&doors, &id, "1").await;
    assert!(300 < revisions.len());
    assert_eq!(rows, revisions);

    // The session's options, named in the request, give the same result. A span that begins later
    // gives the result of a session that begins there.
    let named = json!({"session": id.to_string(), "mode": "fgo", "profile": "general",
        "overrides": {"elevation_mask_deg": "12"}, "format": "csv"});
    assert_eq!(computed(&doors, asked(&named)).await.0, stored(&doors, &id, "0").await);
    let time = |index: usize| -> GpsTime { DRIVE.epochs[index].epoch.time };
    let message = |time: GpsTime| json!(v1::GpsTime::from(time));
    let mut span = own.clone();
    (span["from"], span["to"]) = (message(time(100)), message(time(259)));
    let (rows, report) = computed(&doors, asked(&span)).await;
    assert_eq!((rows.len(), &report["epochs"]), (160, &json!(160)), "{report}");
    assert_ne!(rows, stored(&doors, &id, "0").await[100..260]);
    doors.close().await;
}

/// The service stops while jobs run, and they continue after its restart. They compute a session
/// with its own options and a reset, with another mode and smoothing, and with a base from a file.
async fn a_restart_changes_no_answer(database: Database) {
    let mut doors = Doors::on(&database.url).await;
    given(&doors, &DRIVE.navigation).await;
    let id = opened(&doors, "fgo", BaseChoice::None).await;
    pushed(&doors, &id, &DRIVE.epochs[..200]).await;
    sessions(&doors).reset(&id).await.unwrap();
    pushed(&doors, &id, &DRIVE.epochs[200..]).await;
    let own = json!({"session": id.to_string(), "format": "csv"});
    let smoothed = json!({"session": id.to_string(), "mode": "fgo", "profile": "paper",
        "smoothed": true, "format": "csv"});
    for options in [own, smoothed] {
        let (whole, _) = computed(&doors, asked(&options)).await;
        let job = created(&doors, asked(&options)).await;
        let (turns, _) = held_midway(&doors, &job).await;
        doors = restarted_midway(doors, turns).await;
        assert_eq!(ended(&doors, &job).await["state"], "SUCCEEDED");
        let kept = kept_answers(&doors, &job).await;
        assert!(0 < kept && kept < whole.len() as u64, "{kept}");
        assert_eq!(rows_of(&doors, &job).await, whole);
    }
    doors.close().await;
}

/// A job in another mode gives the positions of a session in this mode with the same epochs.
async fn another_mode_gives_what_a_session_of_it_has(database: Database) {
    let doors = Doors::on(&database.url).await;
    given(&doors, &DRIVE.navigation).await;
    let mut of_mode = Vec::new();
    for mode in ["spp", "ekf", "fgo"] {
        let id = opened(&doors, mode, BaseChoice::None).await;
        pushed(&doors, &id, &DRIVE.epochs).await;
        of_mode.push((mode, id));
    }
    let [(_, spp), _, (_, fgo)] = &of_mode[..] else { panic!("three modes") };
    // Later ephemerides change nothing.
    given(&doors, &DRIVE.navigation_without_galileo()).await;
    for (mode, id) in &of_mode {
        let options = json!({"session": spp.to_string(), "mode": mode, "format": "csv"});
        let (rows, _) = computed(&doors, asked(&options)).await;
        assert_eq!(rows, stored(&doors, id, "0").await, "{mode}");
    }
    sessions(&doors).close(fgo).await.unwrap();
    let smoothed = json!({"session": spp.to_string(), "mode": "fgo", "smoothed": true,
        "format": "csv"});
    let (rows, _) = computed(&doors, asked(&smoothed)).await;
    assert_eq!(rows, stored(&doors, fgo, "1").await);

    let mut batch = smoothed.clone();
    (batch["smoothed"], batch["batch"]) = (json!(false), json!(true));
    let (rows, _) = computed(&doors, asked(&batch)).await;
    let mut whole = Batch::new(PositioningOptions::new(Mode::Fgo, Profile::General));
    for SequencedEpoch { epoch, .. } in &DRIVE.epochs {
        whole.push(epoch, &Aiding::alone(&DRIVE.navigation));
    }
    check_positions(&rows, &whole.finish());
    doors.close().await;
}

/// Compares the columns `x_m`, `y_m` and `z_m` of rows with solutions.
fn check_positions(rows: &[String], solutions: &[Solution]) {
    assert_eq!(rows.len(), solutions.len());
    for (row, solution) in rows.iter().zip(solutions) {
        let columns: Vec<&str> = row.split(',').collect();
        let status = format!("{:?}", solution.status).to_uppercase();
        assert_eq!(columns[2], status, "{row}");
        let Some(estimate) = &solution.estimate else { continue };
        for (column, value_m) in columns[3..6].iter().zip(estimate.position.0.iter()) {
            let written_m: f64 = column.parse().unwrap();
            assert!((written_m - value_m).abs() < CSV_M, "{row}");
        }
    }
}

/// Base epochs arrive between rover epochs, some of them late. With the session's own options a job
/// uses for each answer the base epochs that the session had. With other options it uses all stored
/// base epochs.
async fn a_base_gives_what_a_session_relative_to_it_has(database: Database) {
    let doors = Doors::on(&database.url).await;
    given(&doors, &PAIR.navigation).await;
    let bases = doors.service.bases();
    let base = bases.create(PAIR.new_base(0.0)).await.unwrap().name.id;
    let base = BaseId::parse(&base).unwrap();
    let relative = opened(&doors, "rtk-fgo", BaseChoice::One(base.clone())).await;
    let alone = opened(&doors, "fgo", BaseChoice::None).await;
    for (rover, epochs) in PAIR.rover.chunks(20).zip(PAIR.base.chunks(20)) {
        let (early, late): (&[Epoch], &[Epoch]) = epochs.split_at(epochs.len() * 3 / 4);
        bases.push(&base, early.to_vec()).await.unwrap();
        pushed(&doors, &relative, rover).await;
        pushed(&doors, &alone, rover).await;
        bases.push(&base, late.to_vec()).await.unwrap();
    }
    let own = json!({"session": relative.to_string(), "format": "csv"});
    let (rows, _) = computed(&doors, asked(&own)).await;
    assert_eq!(rows, stored(&doors, &relative, "0").await);

    // With a base, the job over a session without one gives positions relative to it.
    let with_base = json!({"session": alone.to_string(), "base": base.to_string(),
        "format": "csv"});
    let (rows, report) = computed(&doors, asked(&with_base)).await;
    check_positions(&rows, &PAIR.solved(Mode::RtkFgo, &base));
    let lines = report["provenance"].to_string();
    assert!(lines.contains("base epochs are those that are stored now"), "{lines}");
    let nearest = json!({"session": alone.to_string(), "base": "nearest", "format": "csv"});
    let (nearest, _) = computed(&doors, asked(&nearest)).await;
    assert!(nearest.len() == rows.len() && nearest[149].contains("FIXED"), "{}", nearest[149]);

    // A base file gives the same positions as a base that was filled with this file.
    let file = PAIR.base_file(Some(PAIR.position));
    let filled = bases.create(Default::default()).await.unwrap().name.id;
    let (status, answer) =
        doors.upload(&format!("/v1/bases/{filled}/observations"), file.clone()).await;
    assert_eq!(status, StatusCode::OK, "{answer}");
    let by_id = json!({"session": alone.to_string(), "base": &*filled, "format": "csv"});
    let by_file = json!({"session": alone.to_string(), "format": "csv"}).to_string();
    let parts = body(&[("options", by_file.as_bytes()), ("base", &file)]);
    let (rows, report) = computed(&doors, parts).await;
    assert_eq!(rows, computed(&doors, asked(&by_id)).await.0);
    let lines = report["provenance"].to_string();
    assert!(lines.contains("from its header") && rows[100].contains("FIXED"), "{lines}");
    doors.close().await;
}

/// Sessions are deleted while one job waits for its turn and while another reads its session.
async fn a_deleted_session_fails_its_jobs(database: Database) {
    let doors = Doors::on(&database.url).await;
    given(&doors, &DRIVE.navigation).await;
    let mut ids = Vec::new();
    for _ in 0..2 {
        let id = opened(&doors, "spp", BaseChoice::None).await;
        pushed(&doors, &id, &DRIVE.epochs).await;
        ids.push(id);
    }
    let turns = all_turns(&doors).await;
    let job =
        async |id: &SessionId| created(&doors, asked(&json!({"session": id.to_string()}))).await;
    let reading = job(&ids[0]).await;
    let running = |job: &Value| job["state"] == "RUNNING";
    doors.until(&format!("/v1/jobs/{reading}"), running).await;
    let options = asked(&json!({"session": ids[1].to_string()}));
    let named = [("idempotency-key", "of a session")];
    let (status, first) = post(&doors, options.clone(), &named).await;
    assert_eq!(status, StatusCode::CREATED, "{first}");
    let waiting = first["job"].as_str().unwrap().to_owned();
    for id in &ids {
        let path = format!("/v1/sessions/{id}?purge=true");
        let (status, answer) = doors.send("DELETE", &path, json!({})).await;
        assert_eq!(status, StatusCode::OK, "{answer}");
    }
    // The same request still gives the same job.
    let (status, again) = post(&doors, options, &named).await;
    assert_eq!((status, &again["job"]), (StatusCode::OK, &first["job"]), "{again}");
    drop(turns);
    for (job, id) in [(reading, &ids[0]), (waiting, &ids[1])] {
        let failed = ended(&doors, &job).await;
        let failure = &failed["failure"];
        assert_eq!(failed["state"], "FAILED", "{failed}");
        assert_eq!(failure["code"], "SESSION_NOT_FOUND", "{failed}");
        assert_eq!(failure["field"], "options.session", "{failed}");
        let message = format!("session \"{id}\" was deleted after the job was created");
        assert_eq!(failure["message"], message.as_str(), "{failed}");
    }
    doors.close().await;
}

#[tokio::test]
async fn what_is_no_job_over_a_session_is_refused() {
    let doors = Doors::with_jobs(JobsConfiguration::standard()).await;
    given(&doors, &DRIVE.navigation).await;
    let id = opened(&doors, "spp", BaseChoice::None).await;
    let session = id.to_string();
    let (status, empty) = post(&doors, asked(&json!({"session": session})), &[]).await;
    assert_eq!((status.as_u16(), code(&empty)), (409, "SESSION_EMPTY"), "{empty}");
    pushed(&doors, &id, &DRIVE.epochs[..20]).await;
    let unknown = SessionId::random().to_string();
    let time = |week: i64| json!({"week": week, "nsOfWeek": 0});
    let late = json!({"session": session, "from": time(3000)});
    for (options, status, expected, field) in [
        (json!({"session": unknown}), 404, "SESSION_NOT_FOUND", "options.session"),
        (json!({"session": "ses_1"}), 404, "SESSION_NOT_FOUND", "options.session"),
        (json!({"session": session, "mode": "ppp"}), 400, "UNKNOWN_MODE", "options.mode"),
        (json!({"session": session, "mode": "rtk-ekf"}), 400, "BASE_REQUIRED", "options.base"),
        (json!({"session": session, "smoothed": true}), 400, "INVALID_FIELD", "options.smoothed"),
        (json!({"session": session, "base": "bas_1"}), 404, "BASE_NOT_FOUND", "options.base"),
        (late, 404, "EPOCH_NOT_FOUND", "options.from"),
        (
            json!({"session": session, "from": time(2), "to": time(1)}),
            400,
            "INVALID_FIELD",
            "options.to",
        ),
        (json!({"from": time(2)}), 400, "INVALID_FIELD", "options.from"),
        (json!({"base": "nearest"}), 400, "INVALID_FIELD", "rover"),
    ] {
        let (answered, problem) = post(&doors, asked(&options), &[]).await;
        let got = (answered.as_u16(), code(&problem), problem["field"].as_str());
        assert_eq!(got, (status, expected, Some(field)), "{options}: {problem}");
    }
    let options = json!({"session": session, "base": "nearest"}).to_string();
    for (part, field) in
        [("rover", "rover"), ("navigation", "navigation"), ("base", "options.base")]
    {
        let parts = body(&[("options", options.as_bytes()), (part, &MINUTE.rover)]);
        let (_, problem) = post(&doors, parts, &[]).await;
        assert_eq!(
            (code(&problem), &problem["field"]),
            ("INVALID_FIELD", &json!(field)),
            "{problem}"
        );
    }
    assert_eq!(doors.get("/v1/jobs").await.1["jobs"], json!([]));
}

/// A job takes the epochs that are stored when it is created. The same request gives the same job,
/// also after more epochs have come.
#[tokio::test]
async fn a_job_takes_what_is_stored() {
    let doors = Doors::with_jobs(JobsConfiguration::standard()).await;
    given(&doors, &DRIVE.navigation).await;
    let id = opened(&doors, "ekf", BaseChoice::None).await;
    pushed(&doors, &id, &DRIVE.epochs[..50]).await;
    let turns = all_turns(&doors).await;
    let first = created(&doors, LONG.body(&json!({"mode": "spp"}))).await;
    let named = [("idempotency-key", "so far")];
    let options = json!({"session": id.to_string(), "profile": "static"});
    let (status, job) = post(&doors, asked(&options), &named).await;
    assert_eq!(status, StatusCode::CREATED, "{job}");
    assert_eq!(job["options"]["mode"], "ekf", "{job}");
    assert_eq!((&job["options"]["profile"], &job["inputs"]), (&json!("static"), &json!([])));
    pushed(&doors, &id, &DRIVE.epochs[50..90]).await;
    let (status, again) = post(&doors, asked(&options), &named).await;
    assert_eq!((status, &again["job"]), (StatusCode::OK, &job["job"]), "{again}");
    drop(turns);
    ended(&doors, &first).await;
    let done = ended(&doors, job["job"].as_str().unwrap()).await;
    assert_eq!((&done["state"], &done["progress"]["epochs"]), (&json!("SUCCEEDED"), &json!(50)));
}

/// A key with the right to create jobs but not to read cannot read a session by a job.
#[tokio::test]
async fn a_session_is_for_keys_that_read() {
    let doors = Doors::with_jobs(JobsConfiguration::standard()).await;
    let operator = operator(&doors).await;
    let id = session(&doors, &operator, json!({})).await;
    let epochs = json!({"epochs": [epoch(1)]});
    asked_by(&doors, &operator, "POST", &format!("/v1/sessions/{id}/epochs"), epochs).await;
    for (rights, expected) in [(json!(["operate"]), 403), (json!(["operate", "read"]), 201)] {
        let new = json!({"rights": rights});
        let (_, key) = asked_by(&doors, &operator, "POST", "/v1/keys", new).await;
        let text = |value: &Value| value.as_str().unwrap().to_owned();
        let key = Key { id: text(&key["key"]["key"]), secret: text(&key["secret"]) };
        let kind = format!("multipart/form-data; boundary={BOUNDARY}");
        let post = Request::post("/v1/jobs").header("content-type", kind);
        let answer = sent(&doors, &key, post.body(asked(&json!({"session": id})).into()).unwrap());
        let answer = answer.await;
        assert_eq!(answer.status.as_u16(), expected, "{answer:?}");
        assert!(expected == 201 || answer.text.contains("RIGHT_MISSING"), "{answer:?}");
    }
}

/// The table of epochs is missing while a job runs, so its reads fail. The job is queued again, and
/// succeeds once the table is there.
async fn a_database_that_fails_for_a_time_fails_no_job(database: Database) {
    let doors = Doors::on(&database.url).await;
    given(&doors, &DRIVE.navigation).await;
    let id = opened(&doors, "spp", BaseChoice::None).await;
    pushed(&doors, &id, &DRIVE.epochs).await;
    let turns = all_turns(&doors).await;
    let job = created(&doors, asked(&json!({"session": id.to_string(), "format": "csv"}))).await;
    database.execute("ALTER TABLE epochs RENAME TO epochs_elsewhere").await;
    drop(turns);
    // Its claim, its return, and its next claim.
    let fence = async || database.text("SELECT CAST(fence AS TEXT) FROM jobs").await;
    let is_claimed_again = |fence: &String| 3 <= fence.parse::<u64>().unwrap();
    crate::support::wait::until("claimed again", fence, is_claimed_again).await;
    database.execute("ALTER TABLE epochs_elsewhere RENAME TO epochs").await;
    let done = ended(&doors, &job).await;
    assert_eq!(done["state"], "SUCCEEDED", "{done}");
    assert_eq!(rows_of(&doors, &job).await, stored(&doors, &id, "0").await);
    doors.close().await;
}
