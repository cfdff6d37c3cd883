//! Streams of a device: answers, credit, resumption, and what ends one.

use bytes::Bytes;
use graphfix::config::Limits;
use graphfix::contract::{convert, v1};
use graphfix::grpc::code_of;
use graphfix::grpc::v1::positioning_client::PositioningClient;
use graphfix::grpc::v1::solutions_client::SolutionsClient;
use serde_json::json;
use tonic::codec::CompressionEncoding;
use tonic::{Code, Status};
use tonic_types::StatusExt;

use crate::support::device::{NEAR, logs};
use crate::support::doors::{Doors, epoch};
use crate::support::drive::DRIVE;
use crate::support::flow::{self, EpochFlow};
use crate::support::wait::until;

fn message(seq: u64) -> v1::Epoch {
    serde_json::from_value(epoch(seq)).unwrap()
}

fn opening(session: &str, answers: v1::Answers) -> v1::StreamOpening {
    v1::StreamOpening {
        session: session.to_owned(),
        answers: answers.into(),
        last_acknowledged: None,
    }
}

/// A stream whose first answer is read.
async fn opened(doors: &Doors, opening: v1::StreamOpening) -> (EpochFlow, v1::StreamOpened) {
    let mut flow = flow::epochs(doors.router.clone(), opening).await;
    let first = flow.answer().await;
    (flow, first.opened.unwrap())
}

async fn listed(doors: &Doors, session: &str) -> Vec<v1::Solution> {
    let list = v1::ListSolutionsRequest {
        session: session.to_owned(),
        page_size: 10_000,
        revisions: v1::Revisions::First.into(),
        ..Default::default()
    };
    let mut client = SolutionsClient::new(doors.router.clone());
    client.list(list).await.unwrap().into_inner().solutions
}

fn code(status: &Status) -> String {
    code_of(status).unwrap_or_else(|| format!("no code: {status:?}"))
}

fn field(status: &Status) -> String {
    let info = status.get_details_error_info().unwrap();
    info.metadata.get("field").cloned().unwrap_or_default()
}

/// If the memory of all requests is short, a stream waits and continues to read as its epochs are
/// answered. It does not end, because the device would then send everything again.
#[tokio::test]
async fn a_stream_waits_where_memory_is_short() {
    let doors = Doors::with(Limits { request_memory_bytes: 512 << 10, ..Limits::standard() }).await;
    let session = doors.session().await;
    let (mut flow, _) = opened(&doors, opening(&session, v1::Answers::Summary)).await;
    for e in &DRIVE.epochs[..250] {
        flow.push(vec![convert::epoch_message(e.seq, &e.epoch)]).await;
    }
    assert_eq!(flow.until_durable(250).await.len(), 250);
}

/// The device sends many messages before it has answers. The answers are those of PushEpochs, and
/// are stored. The stream ends when the device closes its side.
#[tokio::test]
async fn a_stream_answers_as_a_push_does() {
    let doors = Doors::open().await;
    doors.service.navigation().push(DRIVE.navigation.clone(), "test").await.unwrap();
    let session = doors.session().await;
    let (mut flow, first) = opened(&doors, opening(&session, v1::Answers::Full)).await;
    assert_eq!((first.durable_through, first.oldest_available_seq), (None, None));
    assert_eq!(first.idle_s, 300.0);
    let epochs: Vec<_> =
        DRIVE.epochs[..50].iter().map(|e| convert::epoch_message(e.seq, &e.epoch)).collect();
    for batch in epochs.chunks(3) {
        flow.push(batch.to_vec()).await;
    }
    flow.close();
    let (mut solutions, mut answers) = (Vec::new(), 0);
    while let Some(answer) = flow.next().await.unwrap() {
        answers += 1;
        solutions.extend(answer.results.into_iter().map(|result| result.solution.unwrap()));
        assert_eq!(answer.durable_through, solutions.last().map(|solution| solution.seq));
    }
    assert!(answers < 17, "17 messages were answered by {answers}: nothing was coalesced");
    assert_eq!(solutions.len(), 50);
    assert!(solutions.iter().filter(|solution| solution.position.is_some()).count() > 40);
    assert_eq!(listed(&doors, &session).await, solutions);
    let pushed = doors.session().await;
    let push = v1::PushEpochsRequest { session: pushed, epochs };
    let mut client = PositioningClient::new(doors.router.clone());
    let by_push = client.push_epochs(push).await.unwrap().into_inner().results;
    let by_push: Vec<_> = by_push.into_iter().map(|result| result.solution.unwrap()).collect();
    assert_eq!(by_push, solutions);
    let budget = async || doors.service.budget().used();
    drop(flow);
    until("returned to the budget", budget, |used| *used == 0).await;
}

/// The refusal of an epoch does not end the stream. It is reported in every form of answers.
#[tokio::test]
async fn answers_are_as_long_as_asked_for() {
    let doors = Doors::open().await;
    for answers in [v1::Answers::None, v1::Answers::Summary] {
        let session = doors.session().await;
        let (mut flow, _) = opened(&doors, opening(&session, answers)).await;
        flow.push(vec![message(1), message(2)]).await;
        let mut late = message(3);
        late.time = message(1).time;
        flow.push(vec![late, message(4)]).await;
        let results = flow.until_durable(4).await;
        let refused: Vec<_> = results.iter().filter_map(|r| r.refusal.as_ref()).collect();
        assert_eq!(refused.len(), 1, "{results:?}");
        assert_eq!(refused[0].code, "OUT_OF_ORDER");
        let answered: Vec<u64> = results.iter().map(|result| result.seq).collect();
        match answers {
            v1::Answers::None => assert_eq!(answered, [3]),
            _ => {
                assert_eq!(answered, [1, 2, 3, 4]);
                let summary = results[0].summary.as_ref().unwrap();
                assert_eq!(summary.status(), v1::Status::None);
                assert_eq!(summary.time, message(1).time);
                assert!(results.iter().all(|result| result.solution.is_none()));
            }
        }
    }
}

/// After a break the service reports where to continue, and sends the answers that the device has
/// missed, in pages.
#[tokio::test]
async fn a_stream_goes_on_where_another_ended() {
    let doors = Doors::open().await;
    let session = doors.session().await;
    let (mut flow, _) = opened(&doors, opening(&session, v1::Answers::None)).await;
    flow.push((1..=70).map(message).collect()).await;
    flow.until_durable(70).await;
    drop(flow);

    let again =
        v1::StreamOpening { last_acknowledged: Some(3), ..opening(&session, v1::Answers::Full) };
    let (mut flow, first) = opened(&doors, again).await;
    assert_eq!(first.durable_through, Some(70));
    // Resent and new epochs: each is answered, and stored once.
    flow.push((69..=72).map(message).collect()).await;
    let results = flow.until_durable(72).await;
    let numbers: Vec<u64> = results.iter().map(|result| result.seq).collect();
    assert_eq!(numbers, (4..=70).chain(69..=72).collect::<Vec<_>>());
    let stored = listed(&doors, &session).await;
    assert_eq!(stored.len(), 72);
    let answered = results.iter().map(|result| result.solution.as_ref().unwrap());
    for solution in answered {
        assert_eq!(Some(solution), stored.get(solution.seq as usize - 1));
    }
}

/// A message without epochs is answered and keeps a stream open. A stream without any message ends.
#[tokio::test]
async fn a_silent_stream_is_ended() {
    let doors = Doors::with(Limits { stream_idle_s: 1, ..Limits::standard() }).await;
    let session = doors.session().await;
    let (mut flow, first) = opened(&doors, opening(&session, v1::Answers::None)).await;
    assert_eq!(first.idle_s, 1.0);
    flow.push(Vec::new()).await;
    let answer = flow.answer().await;
    assert!(answer.results.is_empty() && answer.credit.is_some(), "{answer:?}");
    let status = flow.refusal().await;
    assert_eq!((status.code(), &*code(&status)), (Code::DeadlineExceeded, "STREAM_IDLE"));
}

/// Wrong first messages are refused with the wrong field.
#[tokio::test]
async fn a_wrong_opening_is_refused_with_its_field() {
    let doors = Doors::open().await;
    let (session, closed) = (doors.session().await, doors.session().await);
    doors.send("DELETE", &format!("/v1/sessions/{closed}"), json!(null)).await;
    let good = || opening(&session, v1::Answers::None);
    let of = |session: &str| opening(session, v1::Answers::None);
    let cases = [
        (of("ses_0"), "SESSION_NOT_FOUND", "opening.session"),
        (of(&closed), "SESSION_CLOSED", "session"),
        (v1::StreamOpening { answers: 9, ..good() }, "INVALID_FIELD", "opening.answers"),
        (
            v1::StreamOpening { last_acknowledged: Some(5), ..good() },
            "ACKNOWLEDGEMENT_UNKNOWN",
            "opening.lastAcknowledged",
        ),
    ];
    for (opening, expected, at) in cases {
        let status = flow::epochs(doors.router.clone(), opening).await.refusal().await;
        assert_eq!((&*code(&status), &*field(&status)), (expected, at));
    }
    let mut client = PositioningClient::new(doors.router.clone());
    let epochs = vec![message(1)];
    let wrong = [
        (vec![], "opening"),
        (vec![v1::StreamRequest { opening: None, epochs: epochs.clone() }], "opening"),
        (vec![v1::StreamRequest { opening: Some(good()), epochs }], "epochs"),
    ];
    for (messages, at) in wrong {
        let mut answers = client.stream(tokio_stream::iter(messages)).await.unwrap().into_inner();
        let status = answers.message().await.unwrap_err();
        assert_eq!((&*code(&status), &*field(&status)), ("INVALID_FIELD", at));
    }
    assert!(listed(&doors, &session).await.is_empty());
}

/// The messages before a wrong one are answered; then the stream ends with its code and field.
#[tokio::test]
async fn a_wrong_message_ends_the_stream_after_the_answers_before_it() {
    let limits = Limits { stream_epochs: 8, stream_bytes: 2000, ..Limits::standard() };
    let doors = Doors::with(limits).await;
    let mut bad = message(2);
    bad.observations[0].satellite = "X05".into();
    let session = doors.session().await;
    let second = v1::StreamRequest {
        opening: Some(opening(&session, v1::Answers::None)),
        epochs: vec![message(2)],
    };
    let mut long = message(2);
    long.observations = vec![long.observations[0].clone(); 110];
    let of = |epochs| v1::StreamRequest { opening: None, epochs };
    let at = "epochs[0].observations[0].satellite";
    let cases = [
        (of(vec![bad]), "INVALID_SATELLITE", at),
        (second, "INVALID_FIELD", "opening"),
        (of(vec![message(0)]), "INVALID_SEQUENCE", "epochs[0].seq"),
        (of((2..=20).map(message).collect()), "CREDIT_EXCEEDED", "credit.epochs"),
        (of(vec![long]), "CREDIT_EXCEEDED", "credit.bytes"),
    ];
    for (wrong, expected, at) in cases {
        let session = doors.session().await;
        let (mut flow, _) = opened(&doors, opening(&session, v1::Answers::Full)).await;
        flow.push(vec![message(1)]).await;
        flow.send(wrong).await;
        let mut answered = Vec::new();
        let status = loop {
            match flow.next().await {
                Ok(answer) => answered.extend(answer.unwrap().results),
                Err(status) => break status,
            }
        };
        assert_eq!((&*code(&status), &*field(&status)), (expected, at));
        assert_eq!(answered.len(), 1, "{expected}: the epoch before was not answered");
        assert_eq!(listed(&doors, &session).await.len(), 1, "{expected}");
    }
}

/// A device that respects its credit may send without end.
#[tokio::test]
async fn credit_rises_with_the_answers() {
    let doors = Doors::with(Limits { stream_epochs: 4, ..Limits::standard() }).await;
    let session = doors.session().await;
    let mut flow = flow::epochs(doors.router.clone(), opening(&session, v1::Answers::None)).await;
    let (mut credit, mut sent, mut durable) = (0, 0, None);
    while durable < Some(30) {
        let answer = flow.answer().await;
        durable = durable.max(answer.durable_through);
        credit = answer.credit.unwrap().epochs;
        assert!(credit <= durable.unwrap_or(0) + 4);
        for seq in sent + 1..=credit.min(30) {
            flow.push(vec![message(seq)]).await;
            sent = seq;
        }
    }
    assert!(30 < credit);
}

#[tokio::test]
async fn streams_are_counted() {
    let doors = Doors::with(Limits { streams: 1, ..Limits::standard() }).await;
    let session = doors.session().await;
    let good = || opening(&session, v1::Answers::None);
    let (flow, _) = opened(&doors, good()).await;
    let status = flow::epochs(doors.router.clone(), good()).await.refusal().await;
    assert_eq!((status.code(), &*code(&status)), (Code::ResourceExhausted, "TOO_MANY_STREAMS"));
    assert!(status.get_details_retry_info().unwrap().retry_delay.is_some());
    drop(flow);
    let reopen = async || flow::epochs(doors.router.clone(), good()).await.next().await;
    until("opened again", reopen, Result::is_ok).await.unwrap();
}

#[tokio::test]
async fn packed_messages_are_refused() {
    let doors = Doors::open().await;
    let mut client = PositioningClient::new(doors.router.clone())
        .send_compressed(CompressionEncoding::Gzip)
        .accept_compressed(CompressionEncoding::Gzip);
    let request = v1::StreamRequest::default();
    let status = client.stream(tokio_stream::iter([request])).await.unwrap_err();
    assert_eq!(code(&status), "UNSUPPORTED_MEDIA_TYPE");
}

/// A draining service announces the end of the stream, still answers epochs that are sent, and ends
/// the stream. The status tells the device to open another one after a random delay.
#[tokio::test]
async fn a_service_that_stops_ends_its_streams() {
    let doors = Doors::open().await;
    let session = doors.session().await;
    let (mut flow, _) = opened(&doors, opening(&session, v1::Answers::None)).await;
    doors.service.drain();
    let ending = flow.answer().await.ending.unwrap();
    assert_eq!(ending.code, "DRAINING");
    assert!((1.0..=2.0).contains(&ending.retry_after_s), "{}", ending.retry_after_s);
    flow.push(vec![message(1)]).await;
    flow.until_durable(1).await;
    let status = flow.refusal().await;
    assert_eq!((status.code(), &*code(&status)), (Code::Unavailable, "DRAINING"));
    assert!(status.get_details_retry_info().unwrap().retry_delay.is_some());
    let late = flow::epochs(doors.router.clone(), opening(&session, v1::Answers::None)).await;
    let status = { late }.refusal().await;
    assert_eq!(code(&status), "DRAINING");
}

/// A device that closes its side after this announcement gets its answers and no refusal.
#[tokio::test]
async fn a_device_that_closes_its_side_is_not_refused() {
    let doors = Doors::open().await;
    let session = doors.session().await;
    let (mut flow, _) = opened(&doors, opening(&session, v1::Answers::None)).await;
    flow.push(vec![message(1)]).await;
    doors.service.drain();
    flow.close();
    let mut durable = None;
    while let Some(answer) = flow.next().await.unwrap() {
        durable = durable.max(answer.durable_through);
    }
    assert_eq!(durable, Some(1));
}

fn chunks(bytes: &[u8], from: usize) -> impl Iterator<Item = v1::StreamRawRequest> {
    bytes[from..].chunks(3000).enumerate().map(move |(index, content)| v1::StreamRawRequest {
        opening: None,
        offset: (from + 3000 * index) as u64,
        content: Bytes::copy_from_slice(content),
        end: false,
    })
}

/// A stream of a receiver's bytes breaks after some chunks, and resumes at the offset that the
/// service reports. The answers are those of PushRaw.
#[tokio::test]
async fn raw_bytes_go_on_where_a_stream_ended() {
    let Some((mut log, _)) = logs() else { return };
    log.truncate(90_000);
    let doors = Doors::open().await;
    let session = doors.session().await;
    let open = |last_acknowledged, raw_acknowledged| v1::StreamRawOpening {
        session: session.clone(),
        answers: v1::Answers::Full.into(),
        near: Some(NEAR.into()),
        last_acknowledged,
        raw_acknowledged,
    };
    let mut flow = flow::raw(doors.router.clone(), open(None, None)).await;
    assert_eq!(flow.answer().await.opened.unwrap().raw_through, 0);
    let mut answered = Vec::new();
    for chunk in chunks(&log, 0).take(12) {
        flow.send(chunk).await;
    }
    while answered.is_empty() {
        answered.extend(flow.answer().await.results);
    }
    drop(flow);
    let seen = answered.last().unwrap().seq;

    let mut flow = flow::raw(doors.router.clone(), open(Some(seen), Some(1000))).await;
    let first = flow.answer().await.opened.unwrap();
    let through = first.raw_through as usize;
    assert!((1000..=36_000).contains(&through), "{through}");
    // Some bytes are sent twice.
    for chunk in chunks(&log, through.saturating_sub(500)) {
        flow.send(chunk).await;
    }
    flow.close();
    let (mut last, mut formats) = (0, Vec::new());
    while let Some(answer) = flow.next().await.unwrap() {
        answered.extend(answer.results);
        formats.extend(answer.reports.into_iter().map(|report| report.format));
        last = answer.raw_through;
    }
    assert_eq!(last, log.len() as u64);
    assert!(formats.contains(&"receiver".to_owned()));
    let answered: Vec<_> = answered.into_iter().map(|result| result.solution.unwrap()).collect();
    assert_eq!(answered, listed(&doors, &session).await, "lost or doubled");

    let pushed = doors.session().await;
    let by_push = crate::support::device::push(&doors, &pushed, 0, &log).await;
    let observed = |solutions: &[v1::Solution]| -> Vec<_> {
        solutions.iter().map(|s| (s.seq, s.time)).collect()
    };
    assert_eq!(observed(&answered), observed(&by_push));
}

#[tokio::test]
async fn raw_bytes_that_do_not_follow_are_refused() {
    let doors = Doors::open().await;
    let session = doors.session().await;
    let open = |raw_acknowledged| v1::StreamRawOpening {
        session: session.clone(),
        raw_acknowledged,
        ..Default::default()
    };
    let mut flow = flow::raw(doors.router.clone(), open(None)).await;
    let content = Bytes::from_static(&[0xd3; 10]);
    flow.send(v1::StreamRawRequest { offset: 7, content, ..Default::default() }).await;
    assert_eq!(code(&flow.refusal().await), "RAW_GAP");
    let status = flow::raw(doors.router.clone(), open(Some(1))).await.refusal().await;
    assert_eq!(field(&status), "opening.rawAcknowledged");
    let second = v1::StreamRawRequest { opening: Some(open(None)), ..Default::default() };
    let mut flow = flow::raw(doors.router.clone(), open(None)).await;
    flow.send(second).await;
    assert_eq!(field(&flow.refusal().await), "opening");
}
