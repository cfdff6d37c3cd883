//! Sessions correct observations for antennas like `solve --antex`, and replay does the same.

use std::collections::BTreeMap;

use axum::http::StatusCode;
use graphfix::aiding::bases::{BaseFile, BaseFileLimits, BaseId, NewBase};
use graphfix::aiding::{AidingDesk, AidingLimits};
use graphfix::config::{Mode, PositioningOptions, Profile};
use graphfix::contract::v1;
use graphfix::formats::antex;
use graphfix::formats::rinex::{ObservationReader, read_navigation, write_navigation};
use graphfix::gnss::{AntennaCatalogue, Ecef, Epoch, GpsTime, Solution};
use graphfix::grpc::v1::sessions_client::SessionsClient;
use graphfix::recording::{AnswerKind, Input, RecordingInputs, Solutions};
use graphfix::refusal::Code;
use graphfix::session::{
    Burst, Check, NewSession, Recomputation, SequencedEpoch, SessionId, SessionLimits,
    SessionUpdate, Sessions,
};
use serde_json::json;

use crate::support::antex::antex as antex_file;
use crate::support::database::{Database, on_both_databases};
use crate::support::doors::{Doors, code};
use crate::support::pair::PAIR;

const ROVER: (&str, &str) = ("ROVER1", "     20.00    -10.00    150.00");
const BASE: (&str, &str) = ("BASE1", "     -5.00      0.00     60.00");
const EPOCHS: usize = 60;
/// Epochs before the service restarts.
const BEFORE: usize = 30;

on_both_databases!(
    a_session_corrects_as_solve_does_and_replays_without_the_file,
    a_base_that_is_calibrated_later_begins_the_estimator_again,
    a_session_without_an_antenna_is_not_corrected,
    a_burst_corrects_as_a_session_does,
);

fn catalogue(antennas: &[(&str, &str)]) -> AntennaCatalogue {
    antex::read(antex_file(antennas).as_bytes()).unwrap()
}

/// A file whose header names an antenna.
fn file(epochs: &[Epoch], position: Option<Ecef>, antenna: &str) -> Vec<u8> {
    let text = String::from_utf8(PAIR.file_of(epochs, position)).unwrap();
    let ideal = format!("{:<20}", "IDEAL");
    assert!(text.contains(&ideal));
    text.replacen(&ideal, &format!("{antenna:<16}NONE"), 1).into_bytes()
}

fn rover_file() -> Vec<u8> {
    let epochs: Vec<Epoch> = PAIR.rover[..EPOCHS].iter().map(|e| e.epoch.clone()).collect();
    file(&epochs, None, ROVER.0)
}

const LIMITS: BaseFileLimits =
    BaseFileLimits { epochs: 1_000, bytes: 8 << 20, observations_per_epoch: 512 };

fn base_file() -> Vec<u8> {
    file(&PAIR.base[..EPOCHS], Some(PAIR.position), BASE.0)
}

fn navigation_file() -> Vec<u8> {
    let mut file = Vec::new();
    write_navigation(&mut file, &PAIR.navigation).unwrap();
    file
}

/// The solutions of `solve` with these calibrations.
fn solved(calibrated: Option<&[(&str, &str)]>) -> Vec<Solution> {
    let input = |name: &str, bytes: Vec<u8>| Input::from_bytes(name.to_owned(), bytes.into());
    let antex = calibrated.map(|antennas| antex_file(antennas).into_bytes());
    let inputs = RecordingInputs {
        navigation: vec![input("navigation", navigation_file())],
        base: Some(input("base", base_file())),
        antex: antex.map(|antex| input("antex", antex)),
        ..RecordingInputs::of_rover(input("rover", rover_file()))
    };
    let options = PositioningOptions::new(Mode::RtkFgo, Profile::General);
    let solutions = Solutions::open(&inputs, options, AnswerKind::Causal).unwrap();
    solutions.map(Result::unwrap).collect()
}

/// A service with these calibrations, opened on a database.
struct Desk {
    aiding: AidingDesk,
    sessions: Sessions,
}

impl Desk {
    async fn open(database: &Database, calibrated: &[(&str, &str)]) -> Self {
        let store = database.store().await;
        let (limits, catalogue) = (AidingLimits::service(), catalogue(calibrated));
        let aiding = AidingDesk::open_with(store.clone(), limits, catalogue).await.unwrap();
        Self { sessions: Sessions::open(store, aiding.clone(), SessionLimits::service()), aiding }
    }

    /// Uploads navigation data, and a base whose file's header contains position and antenna.
    async fn fill(&self) -> BaseId {
        let (navigation, _) = read_navigation(navigation_file().as_slice()).unwrap();
        self.aiding.navigation.push(navigation, "test").await.unwrap();
        let base = self.aiding.bases.create(NewBase::default()).await.unwrap();
        let base = BaseId::parse(&base.name.id).unwrap();
        self.push(&base, 0..BEFORE).await;
        base
    }

    async fn push(&self, base: &BaseId, span: std::ops::Range<usize>) {
        let BaseFile { epochs, site, .. } = BaseFile::read(&*base_file(), &LIMITS).unwrap();
        let epochs = epochs[span].to_vec();
        self.aiding.bases.upload(base, epochs, site.as_ref()).await.unwrap();
    }

    async fn session(&self, base: &BaseId, antenna: &str) -> SessionId {
        let new = NewSession {
            label: String::new(),
            mode: "rtk-fgo".to_owned(),
            profile: "general".to_owned(),
            overrides: BTreeMap::new(),
            base: Some(base.clone()).into(),
            antenna: antenna.to_owned(),
            retention_days: None,
        };
        self.sessions.create(new).await.unwrap().id
    }

    async fn submit(&self, id: &SessionId, span: std::ops::Range<usize>) -> Vec<Solution> {
        let answer = self.sessions.submit(id, rover()[span].to_vec()).await.unwrap();
        let outcomes = answer.outcomes.into_iter();
        outcomes.map(|outcome| outcome.result.unwrap().solution.solution).collect()
    }
}

fn rover() -> Vec<SequencedEpoch> {
    let bytes = rover_file();
    let mut reader = ObservationReader::new(bytes.as_slice()).unwrap();
    let mut epoch = Epoch::new(GpsTime::EPOCH);
    let mut epochs = Vec::new();
    while reader.read_epoch(&mut epoch).unwrap() {
        epochs.push(SequencedEpoch { seq: epochs.len() as u64 + 1, epoch: epoch.clone() });
    }
    epochs
}

/// The result of a replay that has the stored calibrations only.
async fn replayed(database: &Database, id: &SessionId) -> Check {
    let store = database.store().await;
    let aiding = AidingDesk::open(store.clone(), AidingLimits::service()).await.unwrap();
    Recomputation::open(store, aiding, id, None).await.unwrap().check().await.unwrap()
}

fn assert_same(answers: &[Solution], expected: &[Solution]) {
    assert_eq!(answers.len(), expected.len());
    for (answer, expected) in answers.iter().zip(expected) {
        assert_eq!(answer.estimate, expected.estimate, "{}", expected.time);
        assert_eq!(answer.status, expected.status, "{}", expected.time);
    }
}

/// A session gives the same bits as `solve --antex`, also after a restart without the ANTEX file.
async fn a_session_corrects_as_solve_does_and_replays_without_the_file(database: Database) {
    let expected = solved(Some(&[ROVER, BASE]));
    let desk = Desk::open(&database, &[ROVER, BASE]).await;
    let base = desk.fill().await;
    let site = desk.aiding.bases.site(&base).unwrap().unwrap();
    assert_eq!(site.calibration.unwrap().antenna, BASE.0);
    let session = desk.session(&base, "ROVER1 NONE").await;
    assert_same(&desk.submit(&session, 0..BEFORE).await, &expected[..BEFORE]);
    desk.sessions.drain().await;

    let desk = Desk::open(&database, &[]).await;
    desk.push(&base, BEFORE..EPOCHS).await;
    assert_same(&desk.submit(&session, BEFORE..EPOCHS).await, &expected[BEFORE..]);
    desk.sessions.drain().await;
    let check = replayed(&database, &session).await;
    assert!(check.is_same() && EPOCHS <= check.compared, "{check:?}");
}

/// A calibration of the base's antenna is added after half of the epochs. From then on the session
/// answers like one that begins there, and a replay does the same.
async fn a_base_that_is_calibrated_later_begins_the_estimator_again(database: Database) {
    let desk = Desk::open(&database, &[ROVER]).await;
    let base = desk.fill().await;
    let session = desk.session(&base, "ROVER1").await;
    desk.submit(&session, 0..BEFORE).await;
    desk.sessions.drain().await;

    let desk = Desk::open(&database, &[ROVER, BASE]).await;
    desk.push(&base, BEFORE..EPOCHS).await;
    let answers = desk.submit(&session, BEFORE..EPOCHS).await;
    let late = desk.session(&base, "ROVER1").await;
    let expected = desk.submit(&late, BEFORE..EPOCHS).await;
    for (answer, expected) in answers.iter().zip(&expected) {
        let (answered, begun) = (answer.estimate.as_ref(), expected.estimate.as_ref());
        let apart_m = answered.unwrap().position.distance_m(begun.unwrap().position);
        // Ambiguities from before would keep the base's correction of 6 cm in the height.
        assert!(apart_m < 0.01, "{}: {apart_m}", expected.time);
    }
    desk.sessions.drain().await;
    let check = replayed(&database, &session).await;
    assert!(check.is_same() && EPOCHS <= check.compared, "{check:?}");
}

/// Without a named antenna nothing is corrected; nor is a session after its antenna is removed.
async fn a_session_without_an_antenna_is_not_corrected(database: Database) {
    let expected = solved(None);
    let corrected = solved(Some(&[ROVER, BASE]));
    assert!(expected.iter().zip(&corrected).all(|(a, b)| a.estimate != b.estimate));
    let desk = Desk::open(&database, &[ROVER, BASE]).await;
    let base = desk.fill().await;
    let session = desk.session(&base, "").await;
    assert_same(&desk.submit(&session, 0..BEFORE).await, &expected[..BEFORE]);

    let session = desk.session(&base, "ROVER1").await;
    let antenna = desk.sessions.get(&session).await.unwrap().antenna.unwrap();
    assert_eq!(antenna.name, "ROVER1 NONE");
    let update = SessionUpdate { antenna: Some(String::new()), ..SessionUpdate::default() };
    assert_eq!(desk.sessions.update(&session, update).await.unwrap().antenna, None);
    assert_same(&desk.submit(&session, 0..BEFORE).await, &expected[..BEFORE]);
}

/// Epochs without a session are corrected like those of a session.
async fn a_burst_corrects_as_a_session_does(database: Database) {
    let expected = solved(Some(&[ROVER, BASE]));
    let desk = Desk::open(&database, &[ROVER, BASE]).await;
    let base = desk.fill().await;
    let burst = Burst {
        mode: "rtk-fgo".to_owned(),
        profile: "general".to_owned(),
        overrides: BTreeMap::new(),
        epochs: rover()[..BEFORE].to_vec(),
        navigation: None,
        base: Some(base.clone()).into(),
        antenna: "ROVER1".to_owned(),
    };
    let computed = desk.sessions.solve_once(burst.clone()).await.unwrap();
    let session = desk.session(&base, "ROVER1").await;
    let hash = desk.sessions.get(&session).await.unwrap().configuration_hash;
    assert!(computed.iter().all(|answer| *answer.configuration_hash == *hash));
    let answers: Vec<Solution> = computed.into_iter().map(|answer| answer.solution).collect();
    assert_same(&answers, &expected[..BEFORE]);
    let unknown = Burst { antenna: "OTHER".to_owned(), ..burst };
    let error = desk.sessions.solve_once(unknown).await.unwrap_err();
    assert_eq!(error.code(), Code::AntennaUnknown);
}

/// By both doors a session shows its antenna and the calibration. An antenna without a calibration
/// is refused with a code.
#[tokio::test]
async fn doors_name_the_antenna_or_refuse_it() {
    let doors = Doors::with_antex(&antex_file(&[ROVER, BASE])).await;
    let (status, plain) = doors.post("/v1/sessions", json!({})).await;
    assert_eq!((status, &plain["antenna"]), (StatusCode::CREATED, &json!("")));
    let (status, session) = doors.post("/v1/sessions", json!({"antenna": "ROVER1"})).await;
    assert_eq!((status, &session["antenna"]), (StatusCode::CREATED, &json!("ROVER1 NONE")));
    assert_eq!(session["antennaCalibration"].as_str().unwrap().len(), 64);
    assert_ne!(session["configurationHash"], plain["configurationHash"]);

    let (status, refused) = doors.post("/v1/sessions", json!({"antenna": "ROVER1 DOME"})).await;
    assert_eq!((status, code(&refused)), (StatusCode::BAD_REQUEST, "ANTENNA_UNKNOWN"));
    assert_eq!(refused["field"], "antenna");
    let marker = json!({"xM": PAIR.position.0.x, "yM": PAIR.position.0.y, "zM": PAIR.position.0.z});
    let (status, refused) =
        doors.post("/v1/bases", json!({"marker": marker, "antenna": "OTHER"})).await;
    assert_eq!((status, code(&refused)), (StatusCode::BAD_REQUEST, "ANTENNA_UNKNOWN"));
    let (status, base) =
        doors.post("/v1/bases", json!({"marker": marker, "antenna": "BASE1"})).await;
    assert_eq!(status, StatusCode::CREATED, "{base}");
    assert_eq!(base["site"]["antennaCalibrated"], true);

    let mut client = SessionsClient::new(doors.router.clone());
    let request = |antenna: &str| v1::CreateSessionRequest {
        antenna: antenna.to_owned(),
        ..Default::default()
    };
    let created = client.create(request("ROVER1     NONE")).await.unwrap().into_inner();
    assert_eq!(created.antenna, "ROVER1 NONE");
    assert_eq!(created.antenna_calibration, session["antennaCalibration"]);
    let refused = client.create(request("OTHER")).await.unwrap_err();
    assert_eq!(graphfix::grpc::code_of(&refused).as_deref(), Some("ANTENNA_UNKNOWN"));
}
