//! Raw bytes of receivers, split anywhere, sent again, and over restarts of the service.

use std::collections::BTreeMap;
use std::process::Command;
use std::time::Duration;

use bytes::Bytes;
use graphfix::contract::{calls, v1};
use graphfix::formats::gnss_logger::{LogReader, LogWriter};
use graphfix::formats::receiver::TimeReference;
use graphfix::formats::rinex::{ChunkReader, ObservationReader};
use graphfix::gnss::{Ecef, Epoch, Geodetic, GpsTime, Status};
use graphfix::grpc::v1::positioning_client::PositioningClient;
use graphfix::grpc::v1::solutions_client::SolutionsClient;
use graphfix::session::{RawChunk, RawReceived, SessionId};
use graphfix::store::{Store, StoredEpoch};
use serde_json::{Value, json};
use tonic::transport::Channel;

use crate::support::casters::gzip;
use crate::support::data;
use crate::support::database::{Database, on_both_databases, sqlite_url};
use crate::support::doors::{Doors, code};
use crate::support::pair::PAIR;
use crate::support::reading::epochs_of;
use crate::support::server::{Server, free_port, opened};
use crate::support::sessions::{created, desk};
use crate::support::streams::{Random, decode, epochs, unpacked};
use crate::support::wait::interrupted;

on_both_databases!(
    split_anywhere_it_gives_the_epochs_of_the_file,
    bytes_sent_again_change_nothing,
    rinex_comes_in_pieces,
    crinex_comes_in_pieces,
    a_phones_log_comes_in_pieces,
    packed_streams_come_in_pieces,
    the_end_of_a_stream_begins_another,
);

fn piece(stream: &[u8], from: usize, to: usize) -> RawChunk {
    RawChunk {
        offset: from as u64,
        content: Bytes::copy_from_slice(&stream[from..to]),
        is_end: to == stream.len(),
        near: None,
    }
}

fn numbers(received: &RawReceived) -> Vec<u64> {
    received.outcomes.iter().map(|outcome| outcome.seq).collect()
}

/// All stored epochs of a session, numbered from 1.
async fn stored(store: &Store, id: &SessionId) -> Vec<Epoch> {
    let key = store.session_of_any(id.as_str()).await.unwrap().unwrap().key;
    let mut rows: Vec<StoredEpoch> = store.epochs_after(key, None, 10_000).await.unwrap();
    rows.sort_by_key(|row| row.solution.seq);
    for (index, row) in rows.iter().enumerate() {
        assert_eq!(row.solution.seq, index as u64 + 1);
    }
    rows.into_iter().map(|row| row.epoch).collect()
}

/// The first `length` bytes of a real rover's log: RXM-RAWX, RXM-SFRBX and other messages.
fn log(length: usize) -> Option<Vec<u8>> {
    let folder = data::set("galway-static")?;
    let mut bytes = unpacked(&folder.join("rover-20181004-1237.ubx.gz"));
    bytes.truncate(length);
    Some(bytes)
}

/// Pushes a stream in random chunks. At random the service restarts, or a chunk is sent twice.
/// Returns the numbers of both.
async fn push_at_random(
    database: &Database,
    id: &SessionId,
    stream: &[u8],
    longest: usize,
) -> (usize, usize) {
    let mut random = Random::new(7);
    let (mut at, mut restarts, mut resent) = (0, 0, 0);
    let mut sessions = desk(&database.store().await).await;
    while at < stream.len() {
        let to = (at + 1 + random.below(longest)).min(stream.len());
        let answer = sessions.receive(id, piece(stream, at, to)).await.unwrap();
        assert_eq!((answer.raw_through, answer.resent), (to as u64, false));
        match random.below(12) {
            0 => {
                sessions.drain().await;
                sessions = desk(&database.store().await).await;
                restarts += 1;
                assert_eq!(sessions.get(id).await.unwrap().raw_through, Some(to as u64));
            }
            1 => {
                // The answer was lost: the same chunk again has the same answer.
                let again = sessions.receive(id, piece(stream, at, to)).await.unwrap();
                assert!(again.resent);
                let solution = |answer: &RawReceived, index: usize| {
                    answer.outcomes[index].result.as_ref().unwrap().solution.clone()
                };
                assert_eq!(numbers(&again), numbers(&answer));
                for index in 0..again.outcomes.len() {
                    assert_eq!(solution(&again, index), solution(&answer, index));
                }
                resent += 1;
            }
            _ => {}
        }
        at = to;
    }
    sessions.drain().await;
    (restarts, resent)
}

async fn split_anywhere_it_gives_the_epochs_of_the_file(database: Database) {
    let Some(stream) = log(500_000) else { return };
    let store = database.store().await;
    let id = created(&desk(&store).await).await;
    let (restarts, resent) = push_at_random(&database, &id, &stream, 5_000).await;
    assert!(5 < restarts && 5 < resent, "{restarts} restarts, {resent} sent again");
    let expected = epochs(decode(&stream, None).0);
    assert!(200 < expected.len(), "{}", expected.len());
    assert_eq!(stored(&store, &id).await, expected);
    // The session has only these bytes. They contain the ephemerides.
    let key = store.session_of_any(id.as_str()).await.unwrap().unwrap().key;
    let rows = store.epochs_after(key, None, 10_000).await.unwrap();
    let single = rows.iter().filter(|row| row.solution.solution.status == Status::Single).count();
    assert!(expected.len() * 8 / 10 < single, "{single} of {}", expected.len());
}

async fn bytes_sent_again_change_nothing(database: Database) {
    let Some(stream) = log(60_000) else { return };
    let sessions = desk(&database.store().await).await;
    let id = created(&sessions).await;
    let gap = sessions.receive(&id, piece(&stream, 10, 20)).await.unwrap_err();
    assert_eq!(gap.code().name(), "RAW_GAP");
    let first = sessions.receive(&id, piece(&stream, 0, 30_000)).await.unwrap();
    let second = sessions.receive(&id, piece(&stream, 30_000, 40_000)).await.unwrap();
    assert!(!numbers(&first).is_empty() && !numbers(&second).is_empty());
    // Within the first chunk, across both, and beyond the stored bytes.
    for (from, to, new) in [(0, 30_000, 0), (10_000, 35_000, 0), (20_000, 50_000, 10_000)] {
        let answer = sessions.receive(&id, piece(&stream, from, to)).await.unwrap();
        assert_eq!(answer.resent, new == 0);
        assert_eq!(answer.raw_through, 40_000 + new);
    }
    let gap = sessions.receive(&id, piece(&stream, 50_001, 60_000)).await.unwrap_err();
    assert_eq!(gap.code().name(), "RAW_GAP");
    let mut other = stream.clone();
    other[45_000] ^= 1;
    let conflict = sessions.receive(&id, piece(&other, 20_000, 50_000)).await.unwrap_err();
    assert_eq!(conflict.code().name(), "RAW_CONFLICT");
    sessions.receive(&id, piece(&stream, 50_000, 60_000)).await.unwrap();
    let expected = epochs(decode(&stream, None).0);
    assert_eq!(stored(&database.store().await, &id).await, expected);
}

async fn rinex_comes_in_pieces(database: Database) {
    let file = PAIR.base_file(Some(PAIR.position));
    let store = database.store().await;
    let id = created(&desk(&store).await).await;
    let (restarts, resent) = push_at_random(&database, &id, &file, 3_000).await;
    assert!(5 < restarts && 5 < resent, "{restarts} restarts, {resent} sent again");
    let found = stored(&store, &id).await;
    assert_eq!((found.len(), found), (PAIR.base.len(), epochs_of(&file)));
}

/// Every epoch of CRINEX depends on those before it, also over restarts.
async fn crinex_comes_in_pieces(database: Database) {
    let Some(folder) = data::set("formats") else { return };
    for name in ["crx1/eijs0010.21d", "crx3/YEBE00ESP_R_20230891800_01H_30S_MO.crx.gz"] {
        let file = unpacked(&folder.join(name));
        let expected = epochs_of(&file);
        assert!(70 < expected.len(), "{name}: {} epochs", expected.len());
        let store = database.store().await;
        let id = created(&desk(&store).await).await;
        let (restarts, resent) = push_at_random(&database, &id, &file, 3_000).await;
        assert!(0 < restarts && 0 < resent, "{restarts} restarts, {resent} sent again");
        assert!(stored(&store, &id).await == expected, "{name}: other epochs");
    }
}

/// Gzip of frames, of RINEX and of CRINEX: the same content however it is split.
async fn packed_streams_come_in_pieces(database: Database) {
    let (Some(frames), Some(folder)) = (log(400_000), data::set("formats")) else { return };
    let crinex = unpacked(&folder.join("crx1/eijs0010.21d"));
    let rinex = PAIR.base_file(Some(PAIR.position));
    let of_frames = epochs(decode(&frames, None).0);
    // Two gzip members, one after the other.
    let frames = [gzip(&frames[..250_001]), gzip(&frames[250_001..])].concat();
    for (packed, expected) in [
        (frames, of_frames),
        (gzip(&rinex), epochs_of(&rinex)),
        (gzip(&crinex), epochs_of(&crinex)),
    ] {
        let store = database.store().await;
        let id = created(&desk(&store).await).await;
        let (restarts, resent) = push_at_random(&database, &id, &packed, packed.len() / 40).await;
        assert!(0 < restarts && 0 < resent, "{restarts} restarts, {resent} sent again");
        assert!(70 < expected.len() && stored(&store, &id).await == expected, "other epochs");
    }
}

/// A phone's log of a minute and a half. In the second half the lines of its sensors between two
/// epochs are longer than the kept text.
fn phone_log() -> Vec<u8> {
    let mut log = LogWriter::new(Vec::new(), &PAIR.navigation).unwrap();
    for rover in &PAIR.rover[..90] {
        log.write_epoch(&rover.epoch).unwrap();
    }
    let log = String::from_utf8(log.finish().unwrap()).unwrap();
    let (mut text, mut before, mut seconds) = (String::new(), "", 0);
    for line in log.lines() {
        let time = line.split(',').nth(2).unwrap_or_default();
        if line.starts_with("Raw,") && time != before {
            let count = if seconds % 30 == 20 { 8_000 } else { 40 };
            text += &"UncalGyro,1700000000000,1,0.25,-0.125,1.0\n".repeat(count);
            (before, seconds) = (time, seconds + 1);
        }
        text += line;
        text += "\n";
    }
    text.into_bytes()
}

fn log_epochs(log: &[u8]) -> Vec<Epoch> {
    let mut reader = LogReader::new(log);
    let (mut epochs, mut epoch) = (Vec::new(), Epoch::new(GpsTime::EPOCH));
    while reader.read_epoch(&mut epoch).unwrap() {
        epochs.push(epoch.clone());
    }
    assert!(reader.skipped().is_empty(), "{:?}", reader.skipped());
    epochs
}

async fn a_phones_log_comes_in_pieces(database: Database) {
    let log = phone_log();
    let expected = log_epochs(&log);
    assert_eq!(expected.len(), 90);
    for stream in [log.clone(), gzip(&log)] {
        let store = database.store().await;
        let id = created(&desk(&store).await).await;
        let (restarts, resent) = push_at_random(&database, &id, &stream, stream.len() / 40).await;
        assert!(0 < restarts && 0 < resent, "{restarts} restarts, {resent} sent again");
        assert!(stored(&store, &id).await == expected, "other epochs");
    }
}

/// The refusal of a log names the wrong line, in every part of the log. Measurements that the phone
/// could not use are counted.
#[tokio::test]
async fn phones_logs_are_judged() {
    let doors = Doors::open().await;
    let session = doors.session().await;
    let log = String::from_utf8(phone_log()[..40_000].to_vec()).unwrap();
    let title = log.lines().position(|line| line.starts_with("# Raw,")).unwrap() + 1;
    let long = format!("{}{}", &log[..3_000], "x".repeat(1 << 16));
    for (bytes, expected, line) in [
        (log.replace(",State,", ",Stat,").into_bytes(), "GNSS_LOGGER_HEADER_INVALID", title),
        (b"Raw,1,2,3\n".to_vec(), "GNSS_LOGGER_HEADER_INVALID", 1),
        (long.into_bytes(), "GNSS_LOGGER_LINE_TOO_LONG", log[..3_000].lines().count()),
    ] {
        let (status, answer) = push(&doors, &session, "", &bytes).await;
        assert_eq!((status, code(&answer)), (400, expected), "{answer}");
        assert_eq!(answer["line"], json!(line), "{answer}");
    }
    let records: Vec<&str> = log.lines().filter(|line| line.starts_with("Raw,")).collect();
    let head: String = log.lines().take(title).map(|line| format!("{line}\n")).collect();
    let weak = records[0].replacen(",16399,", ",1,", 1);
    assert_ne!(weak, records[0]);
    let text = format!("{head}{weak}\n{}\n{}\n", records[1], records[2]);
    let (status, answer) = push(&doors, &session, "end=true", text.as_bytes()).await;
    assert_eq!((status, &answer["format"]), (200, &json!("gnss-logger")), "{answer}");
    assert_eq!(answer["results"].as_array().unwrap().len(), 1, "{answer}");
    assert_eq!(answer["leftOut"][0]["why"], "time of transmission is ambiguous (State)");
    assert_eq!(answer["leftOut"][0]["first"], json!(title + 1));
}

/// Incomplete data at the end is decoded; another format may follow. The request dates RTCM 3.
async fn the_end_of_a_stream_begins_another(database: Database) {
    let Some(folder) = data::set("galway-static") else { return };
    let Some(ubx) = log(60_000) else { return };
    let mut base = unpacked(&folder.join("base-20181004-1236.ubx.gz"));
    base.truncate(100_000);
    let near = GpsTime::from_week_seconds(2021, 391_000.0);
    let file = PAIR.base_file(Some(PAIR.position));
    let store = database.store().await;
    let sessions = desk(&store).await;
    let id = created(&sessions).await;
    let mut offset = 0;
    let mut expected = epochs(decode(&base, Some(TimeReference::Day(near))).0);
    let of_base = expected.len();
    assert!(10 < of_base);
    expected.extend(epochs_of(&file).into_iter().take(100));
    for (stream, near) in [(&base[..], Some(near)), (&file[..], None), (&ubx[..], None)] {
        let pieces = stream.chunks(20_000);
        let last = pieces.len() - 1;
        for (index, bytes) in pieces.enumerate() {
            let content = Bytes::copy_from_slice(bytes);
            let piece = RawChunk { offset, content, is_end: index == last, near };
            offset += bytes.len() as u64;
            let answer = sessions.receive(&id, piece).await.unwrap();
            assert_eq!(answer.raw_through, offset);
        }
    }
    let found = stored(&store, &id).await;
    // The simulated file is years later than both logs: the second log is refused epoch by epoch.
    assert_eq!(found.len(), of_base + PAIR.base.len());
    assert_eq!(found[..of_base + 100], expected);
}

/// Reading in chunks gives the same as reading the file, for every split.
#[test]
fn rinex_of_every_version_is_read_in_pieces() {
    let Some(folder) = data::set("formats") else { return };
    let mut random = Random::new(3);
    let (mut files, mut total) = (0, 0);
    for kind in ["obs2", "obs3", "rinex4", "crx1", "crx3"] {
        for entry in std::fs::read_dir(folder.join(kind)).unwrap() {
            let bytes = unpacked(&entry.unwrap().path());
            let Ok(_) = ObservationReader::new(bytes.as_slice()) else { continue };
            let bytes = &bytes[..bytes.len().min(400_000)];
            let expected = epochs_of(bytes);
            let (mut at, mut found, mut epoch) = (0, Vec::new(), Epoch::new(GpsTime::EPOCH));
            let mut reader = ChunkReader::default();
            let mut changed = false;
            while at <= bytes.len() && !changed {
                let to = (at + 1 + random.below(9_000)).min(bytes.len());
                reader.push(&bytes[at..to]).unwrap();
                if to == bytes.len() {
                    reader.finish();
                }
                loop {
                    match reader.read_epoch(&mut epoch) {
                        Ok(true) => found.push(epoch.clone()),
                        Ok(false) => break,
                        Err(error) => {
                            assert!(error.to_string().contains("changes inside"), "{error}");
                            changed = true;
                            break;
                        }
                    }
                }
                at = if to == bytes.len() { to + 1 } else { to };
            }
            assert!(expected.starts_with(&found), "{kind}: other epochs");
            assert!(changed || expected.len() == found.len(), "{kind}: {}", found.len());
            (files, total) = (files + 1, total + found.len());
        }
    }
    assert!(8 < files && 500 < total, "{files} files, {total} epochs");
}

async fn push(doors: &Doors, session: &str, query: &str, bytes: &[u8]) -> (u16, Value) {
    let path = format!("/v1/sessions/{session}/raw?{query}");
    let (status, answer) = doors.upload(&path, bytes.to_vec()).await;
    (status.as_u16(), answer)
}

/// Both doors give the same answers, with counts of the content.
#[tokio::test]
async fn both_doors_answer_alike() {
    let Some(stream) = log(100_000) else { return };
    let mut answers = Vec::new();
    for grpc in [false, true] {
        let doors = Doors::open().await;
        let session = doors.session().await;
        let mut of_door = Vec::new();
        for (index, bytes) in stream.chunks(9_999).enumerate() {
            let offset = index as u64 * 9_999;
            let end = (index + 1) * 9_999 >= stream.len();
            of_door.push(if grpc {
                let content = Bytes::copy_from_slice(bytes);
                let session = session.clone();
                let push = v1::PushRawRequest { session, offset, content, end, near: None };
                let mut client = PositioningClient::new(doors.router.clone());
                client.push_raw(push).await.unwrap().into_inner()
            } else {
                let query = format!("offset={offset}&end={end}");
                let (status, answer) = push(&doors, &session, &query, bytes).await;
                assert_eq!(status, 200, "{answer}");
                serde_json::from_value(answer).unwrap()
            });
        }
        let (_, held) = doors.get(&format!("/v1/sessions/{session}")).await;
        assert_eq!(held["rawThrough"], json!(stream.len()));
        // The decoded ephemerides serve this session only, until another device sends the same.
        let (_, navigation) = doors.get("/v1/navigation").await;
        assert_eq!(navigation["satellites"], json!([]));
        let other = doors.session().await;
        push(&doors, &other, "offset=0&end=true", &stream[..80_000]).await;
        let (_, navigation) = doors.get("/v1/navigation").await;
        assert_eq!(navigation["satellites"][0]["source"], "agreed");
        answers.push(of_door);
    }
    assert_eq!(answers[0], answers[1]);
    let answers = &answers[0];
    let total = |kind: &str| {
        let messages = answers.iter().flat_map(|answer| &answer.messages);
        messages.filter(|total| total.kind == kind).map(|total| total.decoded).sum::<u64>()
    };
    let statistics = decode(&stream, None).1;
    for (kind, count) in statistics.messages() {
        assert_eq!(total(&kind.to_string()), count.decoded, "{kind}");
    }
    let results: usize = answers.iter().map(|answer| answer.results.len()).sum();
    assert_eq!(results, epochs(decode(&stream, None).0).len());
    assert!(answers.iter().all(|answer| answer.format == "receiver" && !answer.resent));
    assert!(0 < answers.iter().map(|answer| answer.ephemerides).sum::<u64>());
}

#[tokio::test]
async fn what_is_no_stream_is_refused() {
    let doors = Doors::open().await;
    let session = doors.session().await;
    let garbage = vec![0_u8; 40_000];
    let mut damaged = gzip(&PAIR.base_file(None)[..50_000]);
    let middle = damaged.len() / 2;
    damaged[middle..].fill(0xff);
    for (bytes, expected) in [
        (garbage.clone(), "RAW_FORMAT_UNKNOWN"),
        (gzip(&garbage), "RAW_FORMAT_UNKNOWN"),
        (gzip(&gzip(&PAIR.base_file(None)[..50_000])), "RAW_FORMAT_UNKNOWN"),
        (vec![0x1f, 0x8b, 9, 0], "RINEX_READ_FAILED"),
        (damaged, "RINEX_READ_FAILED"),
        (gzip(&bomb()), "TOO_MANY_EPOCHS"),
    ] {
        let (status, answer) = push(&doors, &session, "", &bytes).await;
        assert_eq!(code(&answer), expected, "{answer}");
        assert!((400..500).contains(&status) && answer["field"] == "content", "{answer}");
    }
    // A navigation file, and one that ends in its header: the decoded data is kept.
    let mut navigation = Vec::new();
    graphfix::formats::rinex::write_navigation(&mut navigation, &PAIR.navigation).unwrap();
    let (status, answer) = push(&doors, &session, "", &navigation).await;
    assert_eq!((status, code(&answer)), (400, "RINEX_WRONG_KIND"));
    let (_, held) = doors.get(&format!("/v1/sessions/{session}")).await;
    assert_eq!(held["rawThrough"], Value::Null, "{held}");
    let file = PAIR.base_file(None);
    let (_, answer) = push(&doors, &session, "end=true", &file[..300]).await;
    assert_eq!((&answer["rawThrough"], &answer["results"]), (&json!(300), &json!([])));
    // The stream has ended, but the session accepts another one.
    let (_, answer) = push(&doors, &session, "offset=300", &file[..100_000]).await;
    assert!(9 < answer["results"].as_array().unwrap().len(), "{answer}");
}

/// Valid RINEX without end: its header, then epochs without satellites.
fn bomb() -> Vec<u8> {
    let file = String::from_utf8(PAIR.base_file(None)).unwrap();
    let end = file.find("END OF HEADER").unwrap() + 14;
    let epoch = "> 2024 01 01 00 00  0.0000000  0  0\n";
    [&file[..end], &epoch.repeat((9 << 20) / epoch.len())].concat().into_bytes()
}

/// A truncated stream of gzip: its content is decoded, and the truncation is reported.
#[tokio::test]
async fn a_packed_stream_may_be_cut() {
    let doors = Doors::open().await;
    let session = doors.session().await;
    let file = PAIR.base_file(Some(PAIR.position));
    let packed = gzip(&file);
    let (status, answer) = push(&doors, &session, "end=true", &packed[..packed.len() / 2]).await;
    assert_eq!((status, &answer["format"]), (200, &json!("rinex")), "{answer}");
    let results = answer["results"].as_array().unwrap().len();
    assert!(0 < results && results < PAIR.base.len(), "{results}");
    assert_eq!(answer["leftOut"][0]["why"], "gzip ends before its end");
}

/// Pushes from `at` on until the service is killed or all is sent.
async fn push_on(
    channel: &Channel,
    session: &str,
    stream: &[u8],
    at: u64,
    acknowledged: &mut BTreeMap<u64, v1::Solution>,
) {
    let mut client = PositioningClient::new(channel.clone());
    let rest = &stream[at as usize..];
    for (index, bytes) in rest.chunks(1_001).enumerate() {
        let offset = at + index as u64 * 1_001;
        let end = offset + bytes.len() as u64 == stream.len() as u64;
        let (session, content) = (session.to_owned(), Bytes::copy_from_slice(bytes));
        let push = v1::PushRawRequest { session, offset, content, end, near: None };
        let Ok(answer) = client.push_raw(push).await else { return };
        for result in answer.into_inner().results {
            let solution = result.solution.unwrap();
            if let Some(before) = acknowledged.insert(solution.seq, solution.clone()) {
                assert_eq!(before, solution, "bytes sent again got another answer");
            }
        }
    }
}

/// `kill -9` in the middle of a stream: the device continues at the offset that the service gives.
/// No epoch is missing or stored twice, and each is as in the file.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_stream_outlives_kill_9() {
    let Some(stream) = log(400_000) else { return };
    outlives_kill_9(&stream, epochs(decode(&stream, None).0)).await;
}

/// The same with CRINEX packed with gzip, neither of which can be read from the middle.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_packed_stream_outlives_kill_9() {
    let Some(folder) = data::set("formats") else { return };
    let file = unpacked(&folder.join("crx3/GRAS00FRA_R_20223151700_15M_01S_MO.crx.gz"));
    outlives_kill_9(&gzip(&file), epochs_of(&file)).await;
}

async fn outlives_kill_9(stream: &[u8], expected: Vec<Epoch>) {
    let folder = tempfile::tempdir().unwrap();
    let (database, port) = (sqlite_url(&folder.path().join("raw.db")), free_port());
    let mut server = Server::start(&database, port);
    let session = opened(&server.channel(), None).await.session;
    let mut acknowledged = BTreeMap::new();
    for after_ms in [5, 15, 30, 60, 100] {
        let channel = server.channel();
        let at = opened(&channel, Some(&session)).await.raw_through.unwrap_or(0);
        let pushing = push_on(&channel, &session, stream, at, &mut acknowledged);
        interrupted(pushing, Duration::from_millis(after_ms), || server.kill()).await;
        server = Server::start(&database, port);
    }
    let channel = server.channel();
    let at = opened(&channel, Some(&session)).await.raw_through.unwrap();
    assert!(0 < at && at < stream.len() as u64, "all was sent before the last kill");
    push_on(&channel, &session, stream, at, &mut acknowledged).await;

    let list = v1::ListSolutionsRequest { session, page_size: 10_000, ..Default::default() };
    let listed = SolutionsClient::new(channel).list(list).await.unwrap().into_inner().solutions;
    let expected: Vec<(u64, Option<v1::GpsTime>)> =
        (1..).zip(expected).map(|(seq, epoch)| (seq, Some(epoch.time.into()))).collect();
    let found: Vec<_> = listed.iter().map(|solution| (solution.seq, solution.time)).collect();
    assert_eq!(found, expected, "missing, doubled, or of other times");
    for solution in listed {
        let before = acknowledged.get(&solution.seq);
        assert!(before.is_none_or(|before| *before == solution), "epoch {}", solution.seq);
    }
}

/// `graphfix stream` sends the bytes of a receiver's file unchanged, and continues where it ended.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_receivers_file_is_streamed() {
    let Some(bytes) = log(300_000) else { return };
    let folder = tempfile::tempdir().unwrap();
    let server = Server::start(&sqlite_url(&folder.path().join("stream.db")), free_port());
    let session = opened(&server.channel(), None).await.session;
    let expected = epochs(decode(&bytes, None).0).len();
    for (length, speed) in [(200_000, "max"), (bytes.len(), "1000")] {
        let file = folder.path().join("rover.ubx");
        std::fs::write(&file, &bytes[..length]).unwrap();
        let mut command = Command::new(env!("CARGO_BIN_EXE_graphfix"));
        command.args(["stream", "--session", &session, "--speed", speed, "--rover"]).arg(&file);
        command.args(["--server", &format!("http://127.0.0.1:{}", server.port)]);
        let output = command.output().unwrap();
        let text = String::from_utf8(output.stdout).unwrap();
        let errors = String::from_utf8(output.stderr).unwrap();
        assert!(output.status.success() && text.contains(" 0 refused"), "{text}{errors}");
    }
    let list = v1::ListSolutionsRequest { session, page_size: 10_000, ..Default::default() };
    let listed = SolutionsClient::new(server.channel()).list(list).await.unwrap().into_inner();
    // The first run ended its stream inside a frame, which the second run cannot decode.
    let found = listed.solutions.len();
    assert!(expected - 1 <= found && found <= expected, "{found} of {expected}");
}

/// The bytes alone are enough for a device: a factor graph gives the receiver's position.
#[tokio::test]
async fn a_device_needs_nothing_but_its_bytes() {
    let Some(stream) = log(600_000) else { return };
    let doors = Doors::open().await;
    let new = v1::CreateSessionRequest { mode: "fgo".into(), ..Default::default() };
    let session = calls::sessions::create(&doors.caller(), new).await.unwrap().0.session;
    let (mut offset, mut errors_m) = (0, Vec::new());
    // The receiver's own RTK position in the data set.
    let (latitude_rad, longitude_rad) =
        (53.280_471_167_f64.to_radians(), -9.057_821_f64.to_radians());
    let truth = Geodetic { latitude_rad, longitude_rad, height_m: 67.8 }.to_ecef();
    for bytes in stream.chunks(10_000) {
        let content = Bytes::copy_from_slice(bytes);
        let session = session.clone();
        let push = v1::PushRawRequest { session, offset, content, end: false, near: None };
        offset += bytes.len() as u64;
        for result in calls::raw::push(&doors.caller(), push).await.unwrap().results {
            let Some(position) = result.solution.unwrap().position else { continue };
            let there = position.ecef.unwrap();
            let there = Ecef::new(there.x_m, there.y_m, there.z_m);
            errors_m.push((there.0 - truth.0).norm());
        }
    }
    let count = errors_m.len();
    errors_m.sort_by(f64::total_cmp);
    assert!(200 < count, "{count} positions");
    assert!(errors_m[count / 2] < 10.0, "median {} m", errors_m[count / 2]);
}
