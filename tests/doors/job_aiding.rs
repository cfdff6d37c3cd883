//! Jobs whose files lack ephemerides or a base, which the service supplies: present ephemerides,
//! those of an archive, or its own base.

use axum::body::Body;
use axum::http::{Request, StatusCode};
use graphfix::aiding::bases::{BaseId, NewBase};
use graphfix::config::JobsConfiguration;
use graphfix::gnss::{BaseSite, CoordinateFrame, Ecef, Epoch};
use serde_json::{Value, json};

use crate::support::casters::{HostileCaster, answer, gzip};
use crate::support::data;
use crate::support::doors::{Doors, code};
use crate::support::drive::DRIVE;
use crate::support::jobs::{BOUNDARY, MINUTE, body, has_ended};
use crate::support::pair::{PAIR, Pair};
use crate::support::sessions::new_session;
use crate::support::wait::until;

use super::job_urls::host;
use super::jobs::{bytes_of, created, ended, post};
use super::tenants::world::{Key, asked, base, get, key_of, marker, operator, sent};

async fn doors() -> Doors {
    Doors::with_jobs(JobsConfiguration::standard()).await
}

/// A job of these parts that has ended.
async fn done(doors: &Doors, parts: &[(&str, &[u8])]) -> Value {
    let job = created(doors, body(parts)).await;
    ended(doors, &job).await
}

async fn result(doors: &Doors, done: &Value) -> Vec<u8> {
    assert_eq!(done["state"], "SUCCEEDED", "{done}");
    bytes_of(doors, &format!("/v1/jobs/{}/result", done["job"].as_str().unwrap())).await.1
}

/// The lines of the report on the sources of the positions.
async fn provenance(doors: &Doors, done: &Value) -> String {
    let path = format!("/v1/jobs/{}/report", done["job"].as_str().unwrap());
    doors.get(&path).await.1["provenance"].to_string()
}

/// A base of the service whose marker is at `place`, with these epochs.
async fn stored(doors: &Doors, place: Ecef, epochs: Vec<Epoch>) -> String {
    stored_in(doors, (place, None), epochs).await
}

/// The same, with coordinates of a frame.
async fn stored_in(
    doors: &Doors,
    (place, frame): (Ecef, Option<CoordinateFrame>),
    epochs: Vec<Epoch>,
) -> String {
    let site = BaseSite {
        marker: place,
        antenna_delta_hen_m: [1.5, 0.0, 0.0],
        antenna: "IDEAL".to_owned(),
        ..PAIR.new_base(0.0).site.unwrap()
    };
    let new = NewBase { site: Some(site), frame, ..PAIR.new_base(0.0) };
    let bases = doors.service.bases();
    let id = BaseId::parse(&bases.create(new).await.unwrap().name.id).unwrap();
    if !epochs.is_empty() {
        bases.push(&id, epochs).await.unwrap();
    }
    id.to_string()
}

fn failure(done: &Value) -> (&str, &str, &str) {
    let of = |name: &str| done["failure"][name].as_str().unwrap_or_default();
    assert_eq!(done["state"], "FAILED", "{done}");
    (of("code"), of("field"), of("message"))
}

fn navigation_of(pair: &Pair) -> Vec<u8> {
    let mut file = Vec::new();
    graphfix::formats::rinex::write_navigation(&mut file, &pair.navigation).unwrap();
    file
}

/// The service's own ephemerides replace the missing part of the request.
#[tokio::test]
async fn without_navigation_data_the_service_gives_its_own() {
    let doors = doors().await;
    let alone = [("rover", &MINUTE.rover[..])];
    let lacking = done(&doors, &alone).await;
    assert!(matches!(failure(&lacking), ("NAVIGATION_REQUIRED", "navigation", _)), "{lacking}");
    let (status, _) = doors.upload("/v1/navigation", MINUTE.navigation.clone()).await;
    assert_eq!(status, StatusCode::OK);
    let named = [("idempotency-key", "alone")];
    let (status, first) = post(&doors, body(&alone), &named).await;
    assert_eq!(status, StatusCode::CREATED, "{first}");
    let done = ended(&doors, first["job"].as_str().unwrap()).await;
    let own = result(&doors, &done).await;
    assert_eq!(
        (&done["inputs"][0]["own"], &done["inputs"][1]["own"]),
        (&json!(false), &json!(true))
    );
    let said = provenance(&doors, &done).await;
    assert!(said.contains("navigation: the service's own ephemerides"), "{said}");
    assert_eq!(own, MINUTE.solved(&["--mode", "fgo"], "pos"), "the same ephemerides");
    // New ephemerides of the service do not make the same request a different one.
    doors.upload("/v1/navigation", DRIVE.navigation_file()).await;
    let (status, again) = post(&doors, body(&alone), &named).await;
    assert_eq!((status, &again["job"]), (StatusCode::OK, &first["job"]), "{again}");
}

/// The service has no ephemerides of the recording's day, 1 January 2026: they come from the
/// operator's archive, and the positions are those of `solve` with that file.
#[tokio::test]
async fn ephemerides_of_an_old_recording_come_from_an_archive() {
    let archive = host(vec![("/2026/001/nav.rnx.gz", gzip(&MINUTE.navigation))]).await;
    let template = format!("http://127.0.0.1:{}/{{yyyy}}/{{ddd}}/nav.rnx.gz", archive.port);
    let doors = Doors::with_archives(vec![template]).await;
    let done = done(&doors, &[("rover", &MINUTE.rover)]).await;
    let own = result(&doors, &done).await;
    assert_eq!(own, MINUTE.solved(&["--mode", "fgo"], "pos"));
    let said = provenance(&doors, &done).await;
    assert!(said.contains("an archive's ephemerides of 2026-01-01 00:00"), "{said}");
}

/// The ephemerides that a receiver has decoded come before all others, as in `solve`.
#[tokio::test]
async fn the_ephemerides_of_a_receiver_are_its_own() {
    let Some(folder) = data::set("galway-static") else { return };
    let read = |name: &str| std::fs::read(folder.join(name)).unwrap();
    let rover = read("rover-20181004-1237.ubx.gz");
    let doors = doors().await;
    doors.upload("/v1/navigation", MINUTE.navigation.clone()).await;
    let done = done(&doors, &[("rover", &rover), ("options", b"{\"mode\": \"spp\"}")]).await;
    result(&doors, &done).await;
    assert_eq!(done["inputs"].as_array().unwrap().len(), 1, "{done}");
    let path = format!("/v1/jobs/{}/report", done["job"].as_str().unwrap());
    let (_, report) = doors.get(&path).await;
    assert_eq!(report["epochs"], report["answered"], "{report}");
}

/// Without the part base the nearest base of the service is taken, with its stored epochs, and the
/// positions are those with its epochs as a file.
#[tokio::test]
async fn without_a_base_the_nearest_of_the_service_is_taken() {
    let doors = doors().await;
    let (rover, navigation) = (PAIR.rover_file(), navigation_of(&PAIR));
    let relative = json!({"mode": "rtk-fgo", "format": "csv"}).to_string();
    let parts = |options: &'static str| -> Vec<(&str, &[u8])> {
        vec![("rover", &rover), ("navigation", &navigation), ("options", options.as_bytes())]
    };
    let relative: &'static str = relative.leak();
    let lacking = done(&doors, &parts(relative)).await;
    let (code_of, field, message) = failure(&lacking);
    assert_eq!((code_of, field), ("BASE_REQUIRED", "base"), "{message}");

    // There are three bases: one far away, one without epochs of this time, and the right one.
    let (elsewhere, place) = PAIR.base_elsewhere(30_000.0);
    let far = stored(&doors, place, elsewhere).await;
    stored(&doors, PAIR.position, Vec::new()).await;
    let near = stored(&doors, PAIR.position, PAIR.base.clone()).await;
    let nearest = done(&doors, &parts(relative)).await;
    let own = result(&doors, &nearest).await;
    let said = provenance(&doors, &nearest).await;
    assert!(said.contains(&format!("base: {near}, 8.")), "{said}");

    let file = PAIR.base_file(Some(PAIR.position));
    let mut given = parts(relative);
    given.push(("base", &file));
    let given = done(&doors, &given).await;
    assert_eq!(own, result(&doors, &given).await);

    // A base that is named makes positions relative to it.
    let named: &'static str = json!({"base": far}).to_string().leak();
    let named = done(&doors, &parts(named)).await;
    assert_eq!(named["options"]["mode"], "rtk-fgo");
    let said = provenance(&doors, &named).await;
    assert!(said.contains(&far), "{said}");
    let unknown = format!("bas_{}", "0".repeat(32));
    let unknown: &'static str = json!({"base": unknown}).to_string().leak();
    let (status, refused) = post(&doors, body(&parts(unknown)), &[]).await;
    let got = (status.as_u16(), code(&refused), refused["field"].as_str());
    assert_eq!(got, (404, "BASE_NOT_FOUND", Some("options.base")), "{refused}");
}

/// The result and the report have the frame that the service's base states, or report that it
/// states none.
#[tokio::test]
async fn the_frame_of_an_own_base_is_said() {
    let doors = doors().await;
    let (rover, navigation) = (PAIR.rover_file(), navigation_of(&PAIR));
    for (frame, of_report, of_result) in [
        ("", "unknown", "that of the base, which is not stated here"),
        ("ITRF2014@2010.0", "ITRF2014@2010.0", "ITRF2014@2010.0, which the base states"),
    ] {
        let place = (PAIR.position, CoordinateFrame::parse(frame));
        let base = stored_in(&doors, place, PAIR.base.clone()).await;
        let options = json!({"base": base, "format": "pos"}).to_string();
        let parts =
            [("rover", &rover[..]), ("navigation", &navigation), ("options", options.as_bytes())];
        let done = done(&doors, &parts).await;
        let head = String::from_utf8(result(&doors, &done).await).unwrap();
        assert!(head.contains(&format!("% frame     : {of_result}\n")), "{}", &head[..500]);
        let said = provenance(&doors, &done).await;
        assert!(said.contains(&format!("its stored epochs, frame: {of_report}")), "{said}");
    }
}

/// An archive fills the base, and no rover has needed the file before. It is fetched for a job of a
/// recording and for a job of a session, with the same positions.
#[tokio::test]
async fn files_of_a_base_come_from_its_archive() {
    let archive = host(vec![("/20260101.obs", PAIR.base_file(Some(PAIR.position)))]).await;
    let template = format!("http://127.0.0.1:{}/{{yyyy}}{{mm}}{{dd}}.obs", archive.port);
    let doors = doors().await;
    doors.upload("/v1/navigation", navigation_of(&PAIR)).await;
    let (_, base) = doors.post("/v1/bases", json!({"archive": {"template": template}})).await;
    let base = base["base"].as_str().unwrap();
    let rover = PAIR.rover_file();
    let options = json!({"base": base, "format": "csv"}).to_string();
    let parts = [("rover", &rover[..]), ("options", options.as_bytes())];
    let of_files = done(&doors, &parts).await;
    let said = provenance(&doors, &of_files).await;
    assert!(said.contains(&format!("base: {base}: a file of its archive")), "{said}");

    let sessions = doors.service.sessions();
    let id = sessions.create(new_session()).await.unwrap().id;
    for epochs in PAIR.rover.chunks(50) {
        sessions.submit(&id, epochs.to_vec()).await.unwrap();
    }
    let options = json!({"session": id.to_string(), "base": base, "format": "csv"}).to_string();
    let of_session = done(&doors, &[("options", options.as_bytes())]).await;
    let said = provenance(&doors, &of_session).await;
    assert!(said.contains(&format!("base: {base}")), "{said}");
    let fixes = |content: Vec<u8>| String::from_utf8(content).unwrap().matches("FIXED").count();
    let files = fixes(result(&doors, &of_files).await);
    assert!(140 < files && files == fixes(result(&doors, &of_session).await), "{files}");
}

/// An archive that does not answer delays a job no longer than the time limit for fetching an
/// input.
#[tokio::test]
async fn an_archive_that_is_silent_ends_the_job() {
    let silent = HostileCaster::start(|_, stream, _| async move {
        std::future::pending::<()>().await;
        drop(stream);
    })
    .await;
    let jobs = JobsConfiguration { fetch_s: 1, ..JobsConfiguration::standard() };
    let doors = Doors::with_jobs(jobs).await;
    let template = format!("http://127.0.0.1:{}/{{yyyy}}{{mm}}{{dd}}.obs", silent.port);
    let (_, base) = doors.post("/v1/bases", json!({"archive": {"template": template}})).await;
    let options = json!({"base": base["base"]}).to_string();
    let (rover, navigation) = (PAIR.rover_file(), navigation_of(&PAIR));
    let parts =
        [("rover", &rover[..]), ("navigation", &navigation), ("options", options.as_bytes())];
    let done = done(&doors, &parts).await;
    let (code_of, _, message) = failure(&done);
    assert_eq!((code_of, message), ("HOST_SLOW", "the archives took longer than 1 s"));
}

/// A job of a tenant that has ended, and all that the tenant sees of it.
async fn seen_by(doors: &Doors, key: &Key, parts: &[(&str, &[u8])]) -> (Value, String) {
    let kind = format!("multipart/form-data; boundary={BOUNDARY}");
    let create = Request::post("/v1/jobs").header("content-type", kind);
    let answer = sent(doors, key, create.body(Body::from(body(parts))).unwrap()).await;
    assert_eq!(answer.status, StatusCode::CREATED, "{}", answer.text);
    let job: Value = serde_json::from_str(&answer.text).unwrap();
    let path = format!("/v1/jobs/{}", job["job"].as_str().unwrap());
    let job = until("ended", async || get(doors, key, &path).await, has_ended).await;
    let (_, report) = asked(doors, key, "GET", &format!("{path}/report"), Value::Null).await;
    let text = format!("{job} {report}");
    (job, text)
}

/// The addresses of the operator's archives have tokens. Jobs of other tenants name neither.
#[tokio::test]
async fn jobs_of_others_show_no_address_of_an_archive() {
    let path = "/2026/001/nav.rnx.gz?token=secret";
    let archive = host(vec![(path, gzip(&MINUTE.navigation))]).await;
    let template =
        format!("http://127.0.0.1:{}/{{yyyy}}/{{ddd}}/nav.rnx.gz?token=secret", archive.port);
    let doors = Doors::with_archives(vec![template]).await;
    let operator = operator(&doors).await;
    let key = key_of(&doors, &operator, "a", "").await;
    let is_hidden = |text: &str| !text.contains("secret") && !text.contains("127.0.0.1");
    for key in [&key, &operator] {
        let (job, text) = seen_by(&doors, key, &[("rover", &MINUTE.rover)]).await;
        assert_eq!(job["state"], "SUCCEEDED", "{job}");
        assert!(is_hidden(&text), "{text}");
    }

    let elsewhere = answer("302 Found\r\nLocation: http://127.0.0.1:9/b?token=secret", b"");
    let redirecting = HostileCaster::answering(elsewhere).await;
    let template =
        format!("http://127.0.0.1:{}/{{yyyy}}{{mm}}{{dd}}.obs?token=secret", redirecting.port);
    let new = json!({"marker": marker(), "archive": {"template": template}});
    let base = base(&doors, &operator, new).await;
    let options = json!({"base": base}).to_string();
    let (rover, navigation) = (PAIR.rover_file(), navigation_of(&PAIR));
    let parts =
        [("rover", &rover[..]), ("navigation", &navigation), ("options", options.as_bytes())];
    let (job, text) = seen_by(&doors, &key, &parts).await;
    let (code, _, message) = failure(&job);
    assert_eq!(code, "BASE_REQUIRED", "{message}");
    assert!(message.contains("gives no file: HOST_REDIRECTS") && is_hidden(&text), "{text}");
    let (job, _) = seen_by(&doors, &operator, &parts).await;
    let own = failure(&job).2;
    assert!(own.contains("redirects to http://127.0.0.1:9/b, which") && !own.contains("secret"));
}
