//! Every refusal is in `docs/errors.md`, and the REST door answers with its code and status.

use std::collections::BTreeSet;
use std::path::Path;

use axum::body::Body;
use axum::http::Request;
use graphfix::contract::Refusal;
use graphfix::grpc::grpc_code;
use graphfix::http::http_status;
use graphfix::refusal::{Class, Code};
use serde_json::{Value, json};
use tower::ServiceExt;

use crate::doors::http::navigation::navigation;
use crate::support::doors::{Doors, code, epoch};
use crate::support::jobs::MINUTE;

/// Codes that no request in this file causes, each with the test file that does.
const REACHED_BY: &[(Code, &str)] = &[
    (Code::FeatureNotBuilt, "compute/src/config/option_table.rs"),
    (Code::TooCostly, "tests/faults/hostile.rs"),
    (Code::CompressedTooMuch, "tests/faults/hostile.rs"),
    (Code::BodyTooSlow, "tests/faults/hostile.rs"),
    (Code::DeadlineExceeded, "tests/faults/hostile.rs"),
    (Code::MemoryExhausted, "tests/faults/hostile.rs"),
    (Code::TooManyConnections, "tests/faults/hostile.rs"),
    (Code::TlsRequired, "tests/doors/tls.rs"),
    (Code::SessionElsewhere, "tests/faults/nodes.rs"),
    (Code::NodeUnreachable, "tests/faults/nodes.rs"),
    (Code::HostRefused, "tests/faults/hostile.rs"),
    (Code::OriginRefused, "tests/faults/hostile.rs"),
    (Code::KeyRequired, "tests/doors/keys.rs"),
    (Code::KeyInvalid, "tests/doors/keys.rs"),
    (Code::KeyExpired, "tests/doors/keys.rs"),
    (Code::KeyRevoked, "tests/doors/keys.rs"),
    (Code::SignInEnded, "tests/doors/sign_in.rs"),
    (Code::CsrfTokenInvalid, "tests/doors/sign_in.rs"),
    (Code::RightMissing, "tests/doors/keys.rs"),
    (Code::OperatorOnly, "tests/doors/tenants/mod.rs"),
    (Code::TenantNotFound, "tests/doors/quotas.rs"),
    (Code::SessionQuotaExceeded, "tests/doors/quotas.rs"),
    (Code::EpochQuotaExceeded, "tests/doors/quotas.rs"),
    (Code::CpuQuotaExceeded, "tests/doors/quotas.rs"),
    (Code::StorageQuotaExceeded, "tests/doors/quotas.rs"),
    (Code::JobStorageQuotaExceeded, "tests/doors/quotas.rs"),
    (Code::BaseOfOperator, "tests/doors/tenants/mod.rs"),
    (Code::TooManyAttempts, "tests/doors/operator_keys.rs"),
    (Code::KeyNotFound, "tests/doors/operator_keys.rs"),
    (Code::KeyEnded, "tests/doors/operator_keys.rs"),
    (Code::TooManyKeys, "src/keys/registry.rs"),
    (Code::TooManyStreams, "tests/doors/streams.rs"),
    (Code::CreditExceeded, "tests/doors/streams.rs"),
    (Code::StreamIdle, "tests/doors/streams.rs"),
    (Code::TooManyWatches, "tests/doors/watches.rs"),
    (Code::WatchTooSlow, "tests/doors/watches.rs"),
    (Code::CursorInvalid, "tests/doors/watches.rs"),
    (Code::AcknowledgementUnknown, "tests/doors/streams.rs"),
    (Code::RawStreamTooLong, "compute/src/reception/stream/mod.rs"),
    (Code::GnssLoggerHeaderInvalid, "tests/doors/raw.rs"),
    (Code::GnssLoggerLineTooLong, "tests/doors/raw.rs"),
    (Code::DatabaseFailed, "tests/doors/store.rs"),
    (Code::DatabaseSchemaNewer, "tests/doors/store.rs"),
    (Code::DatabaseInUse, "tests/faults/lease.rs"),
    (Code::LeaseLost, "tests/faults/lease.rs"),
    (Code::DatabaseSchemaOlder, "tests/faults/database.rs"),
    (Code::DatabaseMigrationFailed, "tests/doors/store.rs"),
    (Code::TimeImplausible, "tests/doors/sessions.rs"),
    (Code::AlreadyAcknowledged, "tests/doors/retention.rs"),
    (Code::ReplayStartMissing, "tests/doors/retention.rs"),
    (Code::WrittenElsewhere, "tests/doors/sessions.rs"),
    (Code::StoredDataCorrupt, "tests/doors/sessions.rs"),
    (Code::MailboxFull, "tests/doors/sessions.rs"),
    (Code::Overloaded, "tests/doors/sessions.rs"),
    (Code::TooManyActiveSessions, "tests/doors/sessions.rs"),
    (Code::TooManyUpdates, "src/session/update_rates.rs"),
    (Code::TooManyArcs, "tests/doors/sessions.rs"),
    (Code::EstimatorFailed, "src/session/solvers/mod.rs"),
    (Code::EpochNotFound, "tests/doors/http/solutions.rs"),
    (Code::BasePositionRefused, "tests/doors/bases.rs"),
    (Code::AntennaUnknown, "tests/doors/session_antennas.rs"),
    (Code::BaseForgotten, "tests/doors/bases.rs"),
    (Code::NavigationForgotten, "tests/invariance/windows.rs"),
    (Code::Internal, "src/http/server.rs"),
    (Code::HostUnresolved, "src/feeds/address.rs"),
    (Code::AddressRefused, "src/feeds/address.rs"),
    (Code::HostUnreachable, "tests/faults/casters.rs"),
    (Code::TlsFailed, "tests/faults/casters.rs"),
    (Code::CasterUnauthorised, "tests/faults/casters.rs"),
    (Code::NoSuchMountpoint, "tests/faults/casters.rs"),
    (Code::CasterTryLater, "tests/faults/casters.rs"),
    (Code::CasterRedirects, "tests/faults/casters.rs"),
    (Code::CasterProtocol, "tests/faults/casters.rs"),
    (Code::CasterSilent, "tests/faults/casters.rs"),
    (Code::CasterNoEpochs, "tests/doors/feeds.rs"),
    (Code::CasterClosed, "tests/doors/feeds.rs"),
    (Code::FileNotFound, "tests/doors/archives.rs"),
    (Code::FileUnreadable, "tests/doors/archives.rs"),
    (Code::FileOfOtherTime, "tests/doors/base_files.rs"),
    (Code::FileCut, "tests/doors/archives.rs"),
    (Code::FileTooLarge, "tests/doors/archives.rs"),
    (Code::HostSlow, "tests/doors/archives.rs"),
    (Code::HostRefuses, "tests/doors/archives.rs"),
    (Code::HostRedirects, "tests/doors/archives.rs"),
    (Code::HostProtocol, "tests/doors/archives.rs"),
    (Code::JobsOff, "tests/doors/jobs.rs"),
    (Code::JobNotFound, "tests/doors/jobs.rs"),
    (Code::TooManyJobs, "tests/doors/jobs.rs"),
    (Code::TooManyUploads, "tests/doors/uploads.rs"),
    (Code::JobTooLarge, "tests/doors/jobs.rs"),
    (Code::JobOptionsTooLarge, "tests/doors/jobs.rs"),
    (Code::JobSpaceExhausted, "tests/doors/jobs.rs"),
    (Code::IdempotencyConflict, "tests/doors/jobs.rs"),
    (Code::EtagMismatch, "tests/doors/repeats.rs"),
    (Code::JobNotEnded, "tests/doors/jobs.rs"),
    (Code::JobWithoutResult, "tests/doors/jobs.rs"),
    (Code::JobTooLong, "tests/doors/jobs.rs"),
    (Code::UploadNotFound, "tests/doors/uploads.rs"),
    (Code::UploadBusy, "tests/doors/uploads.rs"),
    (Code::UploadOffsetDiffers, "tests/doors/uploads.rs"),
    (Code::UploadTooLong, "tests/doors/uploads.rs"),
    (Code::UploadIncomplete, "tests/doors/uploads.rs"),
    (Code::UploadProtocolUnknown, "tests/doors/uploads.rs"),
    (Code::JobLost, "tests/faults/workers.rs"),
    (Code::WorkerNeedsPostgres, "tests/faults/workers.rs"),
    (Code::JobFolderDiffers, "tests/faults/workers.rs"),
    (Code::ListenNotEncrypted, "tests/doors/tls.rs"),
    (Code::SecretsKeyMissing, "tests/doors/secrets.rs"),
    (Code::SecretsKeyInvalid, "tests/doors/secrets.rs"),
    (Code::SecretsKeyUnknown, "tests/doors/secrets.rs"),
    (Code::TelemetryEndpointInvalid, "tests/doors/traces.rs"),
    (Code::TlsFileInvalid, "tests/doors/tls.rs"),
    (Code::TlsKeyMismatch, "tests/doors/tls.rs"),
    (Code::TlsCertificateExpired, "tests/doors/tls.rs"),
    (Code::ServiceNotReady, "tests/doors/tls.rs"),
    (Code::ReplayDiffers, "src/cli/replay.rs"),
    (Code::UnknownScenario, "tests/doors/simulation.rs"),
    (Code::FileExists, "tests/doors/simulation.rs"),
    (Code::UnknownOutputFormat, "tests/doors/compare.rs"),
    (Code::NothingToPlot, "tests/oracles/evaluation.rs"),
    (Code::ServiceUnreachable, "src/cli/connection.rs"),
    (Code::ServiceRefused, "src/cli/connection.rs"),
    (Code::LoadIncomplete, "src/cli/load/report.rs"),
    (Code::BucketUnavailable, "tests/faults/buckets.rs"),
    (Code::BucketRefuses, "tests/faults/buckets.rs"),
];

/// Codes that no test reaches, each with the reason.
const UNREACHED: &[(Code, &str)] = &[
    (Code::JobFilesFailed, "the disk of the folder of jobs does not fail on request"),
    (Code::Interrupted, "a session's task ends early only if it panics outside the solver pool"),
    (Code::MemoryNotLimited, "the superuser, as whom tests may run, can raise any limit"),
    (Code::NoThreads, "threads do not run out on request"),
    (Code::NoReferenceTime, "a stream without its week or day in any message is not at hand"),
];

fn read(path: &str) -> String {
    std::fs::read_to_string(format!("{}/{path}", env!("CARGO_MANIFEST_DIR"))).unwrap()
}

#[test]
fn the_document_and_the_table_are_one_set() {
    let document = read("docs/errors.md");
    let rows: Vec<&str> = document.lines().filter(|line| line.starts_with("| `")).collect();
    for code in Code::ALL {
        let of_code = |row: &&&str| row.starts_with(&format!("| `{code}` |"));
        let [row] = rows.iter().filter(of_code).collect::<Vec<_>>()[..] else {
            panic!("docs/errors.md must have one row of {code}");
        };
        let remedy = code.remedy();
        let (http, grpc) = (http_status(code.class()).as_u16(), grpc_code(code.class()));
        let (cause, retry) = (code.cause(), code.class().retry());
        let expected = match code.class() {
            Class::NoCall => format!("| `{code}` | {cause} | {remedy} |"),
            _ => format!("| `{code}` | {cause} | {remedy} | {retry} | {http} | {grpc:?} |"),
        };
        assert!(row.starts_with(&expected), "{code}: {expected:?} is not in {row:?}");
    }
    assert_eq!(rows.len(), Code::ALL.len(), "docs/errors.md has a row that is no code");
}

/// An answer's `type` leads to the entry of its code.
#[tokio::test]
async fn a_problem_links_to_its_code() {
    let doors = Doors::open().await;
    let (_, problem) = doors.get("/v1/sessions/ses_0").await;
    let (page, entry) = problem["type"].as_str().unwrap().split_once('#').unwrap();
    let (status, page) = doors.get(page).await;
    assert_eq!(status, 200);
    let page = page.as_str().unwrap();
    assert!(page.contains(&format!("<h2 id=\"{entry}\">")), "{problem}");
    for code in Code::ALL {
        assert!(page.contains(&format!("id=\"{code}\"")), "{code} is not on the page");
    }
}

/// Every module takes its codes from the table; none writes a code as text.
#[test]
fn no_room_spells_a_code_again() {
    const ROOMS: [&str; 19] = [
        "aiding",
        "app",
        "cli",
        "config",
        "contract",
        "feeds",
        "formats",
        "grpc",
        "http",
        "jobs",
        "keys",
        "quotas",
        "reception",
        "recording",
        "simulation",
        "session",
        "store",
        "tls",
        "positioning",
    ];
    let folder = |room: &&str| {
        let packages = ["compute/src", "src"].map(|sources| Path::new(sources).join(room));
        packages.into_iter().find(|folder| folder.is_dir()).expect("it is in one of both")
    };
    let mut files: Vec<_> = ROOMS.iter().map(folder).collect();
    while let Some(path) = files.pop() {
        if path.is_dir() {
            let inside = std::fs::read_dir(path).unwrap().map(|entry| entry.unwrap().path());
            files.extend(inside);
            continue;
        }
        let text = std::fs::read_to_string(&path).unwrap();
        let text = text.split("#[cfg(test)]\nmod tests").next().unwrap();
        for code in Code::ALL {
            let spelt = text.contains(&format!("\"{code}\""));
            assert!(!spelt, "{} spells {code}", path.display());
        }
    }
}

/// A push of one epoch in which `change` was made.
fn push(change: impl FnOnce(&mut Value)) -> Value {
    let mut epoch = epoch(5);
    change(&mut epoch);
    json!({ "epochs": [epoch] })
}

/// Requests with JSON bodies that must be refused: method, path, body, code, field.
fn requests(session: &str, closed: &str) -> Vec<(&'static str, String, Value, Code, &'static str)> {
    let epochs = format!("/v1/sessions/{session}/epochs");
    let solutions = format!("/v1/sessions/{session}/solutions");
    let create = "/v1/sessions".to_owned();
    let observation = |e: &mut Value, key: &str, value: Value| e["observations"][0][key] = value;
    let many: Vec<Value> = (1..=40)
        .map(|n| json!({"satellite": format!("G{n:02}"), "code": "1C", "pseudorangeM": 2.2e7}))
        .collect();
    let twice = vec![epoch(5)["observations"][0].clone(); 2];
    let codes = ["1C", "1W", "1X", "2W", "2X", "5Q"]
        .map(|code| json!({"satellite": "G01", "code": code, "pseudorangeM": 2.2e7}));
    let long = "x".repeat(201);
    vec![
        ("POST", create.clone(), json!({"labl": ""}), Code::UnknownField, "labl"),
        ("POST", create.clone(), json!({"label": 7}), Code::InvalidField, "label"),
        ("POST", create.clone(), json!({"label": long}), Code::LabelTooLong, "label"),
        ("POST", create.clone(), json!({"mode": "rtk"}), Code::UnknownMode, "mode"),
        ("POST", create.clone(), json!({"profile": "x"}), Code::UnknownProfile, "profile"),
        (
            "POST",
            create.clone(),
            json!({"overrides": {"x": "1"}}),
            Code::UnknownOption,
            "overrides.x",
        ),
        (
            "POST",
            create,
            json!({"overrides": {"elevation_mask_deg": "steep"}}),
            Code::InvalidOptionValue,
            "overrides.elevation_mask_deg",
        ),
        ("GET", "/v1/nothing".into(), json!({}), Code::RouteNotFound, ""),
        ("PUT", "/v1/sessions".into(), json!({}), Code::MethodNotAllowed, ""),
        ("GET", "/v1/sessions/ses_1".into(), json!({}), Code::SessionNotFound, "session"),
        ("GET", "/v1/sessions?pageSize=2000".into(), json!({}), Code::PageSizeInvalid, "pageSize"),
        ("GET", "/v1/sessions?pageToken=x".into(), json!({}), Code::PageTokenInvalid, "pageToken"),
        (
            "POST",
            format!("/v1/sessions/{closed}/epochs"),
            push(|_| ()),
            Code::SessionClosed,
            "session",
        ),
        ("POST", format!("/v1/sessions/{closed}:solve"), json!({}), Code::SessionEmpty, "session"),
        ("GET", format!("{solutions}?from=now"), json!({}), Code::InvalidTime, "from"),
        ("POST", epochs.clone(), json!({"epochs": []}), Code::NoEpochs, "epochs"),
        (
            "POST",
            epochs.clone(),
            push(|e| e["odometry"] = json!({"intervalS": 1.0, "frame": "ned"})),
            Code::InvalidOdometry,
            "epochs[0].odometry.frame",
        ),
        (
            "POST",
            epochs.clone(),
            json!({"epochs": vec![epoch(5); 4]}),
            Code::TooManyEpochs,
            "epochs",
        ),
        (
            "POST",
            epochs.clone(),
            push(|e| e["time"] = Value::Null),
            Code::InvalidTime,
            "epochs[0].time",
        ),
        (
            "POST",
            epochs.clone(),
            push(|e| e["seq"] = json!(0)),
            Code::InvalidSequence,
            "epochs[0].seq",
        ),
        (
            "POST",
            epochs.clone(),
            push(|e| observation(e, "satellite", json!("G"))),
            Code::InvalidSatellite,
            "epochs[0].observations[0].satellite",
        ),
        (
            "POST",
            epochs.clone(),
            push(|e| observation(e, "code", json!("7Q"))),
            Code::InvalidSignal,
            "epochs[0].observations[0].code",
        ),
        (
            "POST",
            epochs.clone(),
            push(|e| observation(e, "pseudorangeM", json!(-1.0))),
            Code::InvalidMeasurement,
            "epochs[0].observations[0].pseudorangeM",
        ),
        (
            "POST",
            epochs.clone(),
            push(|e| e["observations"] = json!(twice)),
            Code::DuplicateSignal,
            "epochs[0].observations",
        ),
        (
            "POST",
            epochs.clone(),
            push(|e| e["observations"] = json!(codes)),
            Code::TooManyObservations,
            "epochs[0].observations",
        ),
        (
            "POST",
            epochs.clone(),
            push(|e| e["observations"] = json!(many[..5])),
            Code::TooManySatellites,
            "epochs[0].observations",
        ),
        (
            "POST",
            epochs.clone(),
            push(|e| {
                e["seq"] = json!(10);
                observation(e, "pseudorangeM", json!(2.3e7));
            }),
            Code::SequenceConflict,
            "epochs[0].seq",
        ),
        ("POST", epochs.clone(), push(|_| ()), Code::SequenceSuperseded, "epochs[0].seq"),
        ("POST", epochs, push(|e| e["seq"] = json!(11)), Code::OutOfOrder, "epochs[0].time"),
    ]
}

/// Requests about two bases: `used` has a position and an epoch, and a session uses it; the
/// position of `unlocated` is unknown. More than two bases, or two epochs, are not allowed.
fn base_requests(
    used: &str,
    unlocated: &str,
) -> Vec<(&'static str, String, Value, Code, &'static str)> {
    let bases = "/v1/bases".to_owned();
    let epochs = format!("/v1/bases/{used}/epochs");
    let other = push(|e| {
        *e = epoch(10);
        e["observations"][0]["pseudorangeM"] = json!(2.3e7);
    });
    let many = json!({"epochs": [epoch(20), epoch(21), epoch(22)]});
    vec![
        ("POST", bases.clone(), json!({}), Code::TooManyBases, ""),
        (
            "POST",
            bases.clone(),
            json!({"ntrip": {"caster": "caster.example.org", "mountpoint": "M"}}),
            Code::CasterAddressInvalid,
            "ntrip.caster",
        ),
        (
            "POST",
            bases.clone(),
            json!({"ntrip": {"caster": "ntrip://127.0.0.1:1", "mountpoint": "../M"}}),
            Code::MountpointInvalid,
            "ntrip.mountpoint",
        ),
        (
            "POST",
            bases.clone(),
            json!({"ntrip": {"caster": "ntrip://caster.example.org", "mountpoint": "M"}}),
            Code::HostNotAllowed,
            "ntrip.caster",
        ),
        (
            "POST",
            bases.clone(),
            json!({"ntrip": {"caster": "ntrip://127.0.0.1:1", "mountpoint": "M", "user": "a:b"}}),
            Code::InvalidField,
            "ntrip.user",
        ),
        (
            "POST",
            bases.clone(),
            json!({"archive": {"template": "file:///{yyyy}/{ddd}"}}),
            Code::LocationInvalid,
            "archive.template",
        ),
        ("GET", format!("{bases}/bas_1"), json!({}), Code::BaseNotFound, "base"),
        ("POST", "/v1/sessions".into(), json!({"mode": "rtk-fgo"}), Code::BaseRequired, "base"),
        (
            "POST",
            "/v1/sessions".into(),
            json!({"mode": "rtk-fgo", "base": used, "overrides": {"frame": "ETRS89"}}),
            Code::FrameUnavailable,
            "overrides.frame",
        ),
        (
            "POST",
            "/v1/sessions".into(),
            json!({"overrides": {"geoid": "on"}}),
            Code::GeoidMissing,
            "overrides.geoid",
        ),
        ("DELETE", format!("{bases}/{used}"), json!({}), Code::BaseInUse, "base"),
        (
            "POST",
            format!("{bases}/{unlocated}/epochs"),
            push(|_| ()),
            Code::BasePositionMissing,
            "base",
        ),
        ("POST", epochs.clone(), other, Code::BaseEpochConflict, "epochs[0].time"),
        ("POST", epochs.clone(), push(|_| ()), Code::BaseOutOfOrder, "epochs[0].time"),
        ("POST", epochs, many, Code::BaseTooLarge, ""),
    ]
}

/// Bodies other than JSON requests: path, content type, body, code.
fn uploads() -> Vec<(&'static str, &'static str, Vec<u8>, Code)> {
    let rinex = |line: &str| format!("{line}\n").into_bytes();
    let nav = |version: &str, kind: &str| {
        rinex(&format!("{version:>9}{:11}{kind:<20}{:20}RINEX VERSION / TYPE", "", ""))
    };
    let mut damaged = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    std::io::Write::write_all(&mut damaged, &[b'\n'; 5]).unwrap();
    let mut damaged = damaged.finish().unwrap();
    let mut bomb = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    let head = format!("{:60}END OF HEADER\n", "");
    let content = [nav("3.05", "N: GNSS NAV DATA"), head.into_bytes(), vec![b'\n'; 200_000]];
    std::io::Write::write_all(&mut bomb, &content.concat()).unwrap();
    damaged[2] ^= 0xff; // Not deflate.
    let json = "application/json";
    let raw = "application/octet-stream";
    let path = "/v1/navigation";
    vec![
        ("/v1/solve", json, b"{\"epochs\": [}".to_vec(), Code::MalformedBody),
        ("/v1/solve", "text/plain", b"{}".to_vec(), Code::UnsupportedMediaType),
        ("/v1/solve", json, vec![b' '; 200_000], Code::BodyTooLarge),
        (path, raw, bomb.finish().unwrap(), Code::DecompressedTooLarge),
        (path, raw, rinex("not a navigation file"), Code::RinexNotRinex),
        (path, raw, nav("3.05", "OBSERVATION DATA"), Code::RinexWrongKind),
        (path, raw, nav("9.00", "N: GNSS NAV DATA"), Code::RinexUnsupportedVersion),
        (path, raw, nav("3.05", "N: GNSS NAV DATA"), Code::RinexTruncated),
        (path, raw, vec![0x1f, 0x9d, 0x90, 0, 0, 0], Code::RinexCompressionUnsupported),
        (path, raw, damaged, Code::RinexReadFailed),
        (path, raw, vec![b'x'; 90_000], Code::RinexLineTooLong),
        (path, raw, navigation(4), Code::TooManyEphemerides),
    ]
}

/// A RINEX observation file whose header does not list the observation types.
fn header_without_types() -> Vec<u8> {
    let first =
        format!("{:>9}{:11}{:<20}{:20}RINEX VERSION / TYPE\n", "3.05", "", "OBSERVATION DATA", "G");
    format!("{first}{:60}END OF HEADER\n", "").into_bytes()
}

/// Chunks of raw bytes: query, body, code, field. One byte is stored already.
fn pieces() -> Vec<(&'static str, Vec<u8>, Code, &'static str)> {
    vec![
        ("", vec![0; 50_001], Code::PieceTooLarge, "content"),
        ("?offset=1", vec![0; 40_000], Code::RawFormatUnknown, "content"),
        ("?offset=5", vec![0], Code::RawGap, "offset"),
        ("?offset=99999999999999999", vec![0], Code::InvalidField, "offset"),
        ("?near=yesterday", vec![0], Code::InvalidTime, "near"),
        ("?offset=0", vec![0xb5], Code::RawConflict, "content"),
    ]
}

fn limits() -> graphfix::config::Limits {
    graphfix::config::Limits {
        body_bytes: 100_000,
        decompressed_bytes: 100_000,
        epochs_per_push: 3,
        raw_piece_bytes: 50_000,
        satellites_per_epoch: 4,
        observations_per_epoch: 5,
        ephemerides_per_satellite: 2,
        bases: 2,
        epochs_per_base: 2,
        ..graphfix::config::Limits::standard()
    }
}

#[tokio::test]
async fn every_refusal_is_answered_by_code_status_and_field() {
    let doors = Doors::with(limits()).await;
    let (session, closed) = (doors.session().await, doors.session().await);
    doors.send("DELETE", &format!("/v1/sessions/{closed}"), json!({})).await;
    let first = json!({"epochs": [epoch(10)]});
    doors.post(&format!("/v1/sessions/{session}/epochs"), first).await;

    let marker = json!({"xM": 4_033_460.75, "yM": 23_538.02, "zM": 4_924_318.39});
    let mut bases = Vec::new();
    for base in [json!({"marker": marker}), json!({})] {
        let (_, base) = doors.post("/v1/bases", base).await;
        bases.push(base["base"].as_str().unwrap().to_owned());
    }
    let first = json!({"epochs": [epoch(10)]});
    doors.post(&format!("/v1/bases/{}/epochs", bases[0]), first).await;
    doors.post("/v1/sessions", json!({"mode": "rtk-fgo", "base": bases[0]})).await;

    let mut seen = BTreeSet::new();
    let mut wrong = Vec::new();
    let mut check = |what: String, expected: Code, field: &str, status: u16, answer: &Value| {
        seen.insert(expected.name());
        let right = (expected.name(), http_status(expected.class()).as_u16(), field);
        let given = (code(answer), status, answer["field"].as_str().unwrap_or(""));
        let has_texts =
            answer["remedy"] == expected.remedy() && answer["type"] == expected.link().as_str();
        if right != given || !has_texts {
            wrong.push(format!("{what}: {right:?} expected, {answer}"));
        }
    };
    let of_bases = base_requests(&bases[0], &bases[1]);
    for (method, path, body, expected, field) in
        requests(&session, &closed).into_iter().chain(of_bases)
    {
        let (status, answer) = doors.send(method, &path, body).await;
        check(format!("{method} {path}"), expected, field, status.as_u16(), &answer);
    }
    for (path, kind, body, expected) in uploads() {
        let request = Request::post(path).header("content-type", kind);
        let (status, answer) = doors.ask(request.body(Body::from(body)).unwrap()).await;
        check(format!("{path} {expected}"), expected, "", status.as_u16(), &answer);
    }
    let path = format!("/v1/bases/{}/observations", bases[0]);
    let (status, answer) = doors.upload(&path, header_without_types()).await;
    check(path, Code::RinexHeaderInvalid, "", status.as_u16(), &answer);
    let path = format!("/v1/sessions/{}/raw", doors.session().await);
    doors.upload(&path, vec![b'$']).await;
    for (query, body, expected, field) in pieces() {
        let (status, answer) = doors.upload(&format!("{path}{query}"), body).await;
        check(format!("{path}{query}"), expected, field, status.as_u16(), &answer);
    }
    doors.service.sessions().drain().await;
    let path = format!("/v1/sessions/{session}/epochs");
    let (status, answer) = doors.post(&path, json!({"epochs": [epoch(20)]})).await;
    check("draining".into(), Code::Draining, "", status.as_u16(), &answer);

    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    seen.extend(refused_starts().into_iter().map(|(_, _, code)| code.name()));
    seen.extend(refused_commands().into_iter().map(|(_, code)| code.name()));
    for (code, file) in REACHED_BY {
        let text = read(file);
        let tested =
            &text[if file.starts_with("tests") { 0 } else { text.find("mod tests").unwrap() }..];
        let names_it = |name: String| tested.contains(&name);
        assert!(
            ["\"{}\"", "error[{}]"].iter().any(|form| names_it(form.replace("{}", code.name())))
                || names_it(format!("Code::{code:?}")),
            "{code}: {file}"
        );
        assert!(seen.insert(code.name()), "{code} is listed, and reached here");
    }
    for (code, why) in UNREACHED {
        assert!(seen.insert(code.name()), "{code} is reached, though {why}");
    }
    let all: BTreeSet<_> = Code::ALL.iter().map(|code| code.name()).collect();
    assert_eq!(seen, all, "a code has no test");
}

/// Starts of the service that must fail: argument, configuration, code.
fn refused_starts() -> Vec<(&'static str, &'static str, Code)> {
    let nothing = "--log=info";
    vec![
        ("--listen=0.0.0.0:80", "", Code::ListenNotLoopback),
        ("--log=[", "", Code::LogFilterInvalid),
        (nothing, "[limits]\nepochs = 7", Code::ConfigurationMalformed),
        (nothing, "[limits]\nmailbox_epochs = 0", Code::LimitZero),
        (nothing, "[navigation]\narchive_interval_s = 9", Code::ArchiveIntervalTooShort),
        (nothing, "[bases]\ntable_interval_s = 9", Code::TableIntervalTooShort),
        (nothing, "[fetch]\nhosts = [\"a b\"]", Code::FetchHostInvalid),
        (nothing, "[fetch]\nca_file = \"/no/such/file\"", Code::CertificatesInvalid),
        (nothing, "[antennas]\nantex = \"/no/such/file\"", Code::AntexInvalid),
        (nothing, "geoid_file = \"graphfix.toml\"", Code::GeoidInvalid),
        ("--database=mysql://x/y", "", Code::DatabaseUrlInvalid),
        ("--cluster=http://127.0.0.1:1", "", Code::ClusterNeedsPostgres),
        (
            "--database=postgres://x/y",
            "[cluster]\naddress = \"127.0.0.1\"",
            Code::ClusterAddressInvalid,
        ),
        (
            "--database=postgres://x/y",
            "[cluster]\naddress = \"http://127.0.0.1:1\"\n\
             [[bases.networks]]\ncaster = \"ntrip://127.0.0.1:1\"",
            Code::NotInCluster,
        ),
        ("--listen=TAKEN", "", Code::AddressUnavailable),
    ]
}

#[test]
fn a_refused_start_has_its_code_and_remedy() {
    let folder = tempfile::tempdir().unwrap();
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let taken = listener.local_addr().unwrap().to_string();
    for (argument, configuration, code) in refused_starts() {
        let file = folder.path().join("graphfix.toml");
        std::fs::write(&file, configuration).unwrap();
        let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_graphfix"));
        command.current_dir(&folder).arg("serve").arg("--config").arg(&file);
        if !argument.starts_with("--listen") {
            command.arg("--listen=127.0.0.1:0");
        }
        let output = command.arg(argument.replace("TAKEN", &taken)).output().unwrap();
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(1), "{code}: {said}");
        let line = said.lines().last().unwrap_or_default();
        assert!(line.starts_with(&format!("error[{code}]: ")), "{code}: {line}");
        assert!(line.ends_with(&format!("({})", code.remedy())), "{code}: {line}");
    }
}

/// Commands that must fail, in a folder with `text.obs`, which is not RINEX, and `rover.obs`, which
/// is.
fn refused_commands() -> Vec<(&'static str, Code)> {
    vec![
        ("solve", Code::Usage),
        ("solve --rover none.obs --nav none.nav --output a.pos", Code::FileNotReadable),
        ("solve --rover text.obs --nav text.obs --output a.pos", Code::FileNotUnderstood),
        ("solve --rover text.obs", Code::FileNotUnderstood),
        ("solve --rover rover.obs", Code::NavigationRequired),
        ("evaluate --solution text.obs --truth text.obs", Code::FileMalformed),
        ("simulate --scenario clean --seed 1 --output /dev/null/x", Code::FileNotWritable),
    ]
}

#[test]
fn a_refused_command_has_its_code_in_one_line() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("text.obs"), "hello\n").unwrap();
    std::fs::write(folder.path().join("rover.obs"), &MINUTE.rover).unwrap();
    for (arguments, code) in refused_commands() {
        let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_graphfix"));
        let output = command.current_dir(&folder).args(arguments.split(' ')).output().unwrap();
        let text = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(!output.status.success(), "{arguments}: {text}");
        let line = text.lines().last().unwrap_or_default();
        assert!(line.starts_with(&format!("error[{code}]: ")), "{arguments}: {line}");
    }
}

/// Every answer of both doors has the id of its request, also if the request is refused before its
/// call begins.
#[tokio::test]
async fn every_answer_has_the_id_of_its_request() {
    let doors = Doors::open().await;
    let (_, key) = doors.post("/v1/keys", json!({"rights": ["read"]})).await;
    let bearer = format!("Bearer {}", key["secret"].as_str().unwrap());
    let mut ids = BTreeSet::new();
    for (method, path, name, value, status) in [
        ("GET", "/v1/sessions", "authorization", &*bearer, 200),
        ("GET", "/v1/sessions/ses_0", "authorization", &bearer, 404),
        ("GET", "/v1/sessions", "authorization", "Bearer gfx_0", 401),
        ("GET", "/v1/sessions", "accept", "*/*", 401),
        ("POST", "/v1/sessions", "authorization", &bearer, 403),
        ("GET", "/v1/sessions", "host", "evil.example", 403),
        ("GET", "/v1/sessions", "origin", "https://evil.example", 403),
        ("GET", "/v1/nothing", "accept", "*/*", 404),
        ("PUT", "/v1/sessions", "accept", "*/*", 405),
        ("POST", "/graphfix.v1.Sessions/List", "content-type", "application/grpc", 200),
    ] {
        let request = Request::builder().method(method).uri(path).header(name, value);
        let request = request.body(Body::empty()).unwrap();
        let response = doors.router.clone().oneshot(request).await.unwrap();
        assert_eq!(response.status().as_u16(), status, "{method} {path}");
        let id = response.headers()["x-request-id"].to_str().unwrap().to_owned();
        assert!(ids.insert(id.clone()), "{method} {path}: {id} again");
    }
}

/// A refusal that ends without a change of the request states a delay.
#[test]
fn a_full_mailbox_asks_for_a_delay() {
    let retry_after = std::time::Duration::from_millis(100);
    let full = graphfix::session::SessionError::MailboxFull { waiting: 9, limit: 9, retry_after };
    let refusal = Refusal::from(full);
    assert_eq!(refusal.code, Code::MailboxFull);
    let delay = refusal.retry_after.unwrap();
    assert!((retry_after..=2 * retry_after).contains(&delay), "{delay:?}");
}
