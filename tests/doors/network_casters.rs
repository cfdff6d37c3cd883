//! Casters that compute a stream for a rover: the positions they receive, and the bases they fill.

use std::time::{Duration, Instant};

use graphfix::aiding::bases::BaseId;
use graphfix::config::Limits;
use graphfix::contract::{calls, convert, v1};
use graphfix::formats::receiver::{Event, TimeReference};
use graphfix::gnss::{Ecef, GpsTime};
use graphfix::store::BaseUse;
use serde_json::json;
use tokio::io::{AsyncBufReadExt, AsyncWriteExt, BufReader};

use crate::support::casters::{BRISK, CONTENT, HostileCaster, keep};
use crate::support::data;
use crate::support::device::NEAR;
use crate::support::doors::Doors;
use crate::support::pair::PAIR;
use crate::support::streams::{
    decode, message_number, moved_station, rtcm_frame, rtcm_payloads, unpacked,
};
use crate::support::wait::until;

/// Degrees of a GGA sentence's latitude or longitude.
fn degrees(field: &str, hemisphere: &str) -> f64 {
    let point = field.find('.').unwrap();
    let (whole, minutes) = field.split_at(point - 2);
    let angle = whole.parse::<f64>().unwrap() + minutes.parse::<f64>().unwrap() / 60.0;
    if "SW".contains(hemisphere) { -angle } else { angle }
}

/// No position is sent until the rover has one. From then on its last answered position is sent.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_caster_is_told_where_the_rover_is() {
    let doors = Doors::open().await;
    doors.service.navigation().push(PAIR.navigation.clone(), "test").await.unwrap();
    let (told, mut telling) = tokio::sync::mpsc::unbounded_channel();
    let (asked, mut asking) = tokio::sync::mpsc::unbounded_channel();
    let caster = HostileCaster::start(move |_, mut stream, request| {
        let (told, asked) = (told.clone(), asked.clone());
        async move {
            asked.send(request).unwrap();
            stream.write_all(b"ICY 200 OK\r\n").await.unwrap();
            let mut lines = BufReader::new(stream).lines();
            while let Ok(Some(line)) = lines.next_line().await {
                told.send(line).unwrap();
            }
        }
    })
    .await;
    let base = following(&doors, caster.port).await;
    let request = asking.recv().await.unwrap();
    assert!(!request.contains("GGA"), "{request}");
    let told = tokio::time::timeout(2 * BRISK.position_interval, telling.recv()).await;
    assert!(told.is_err(), "a place is told that nobody knows: {told:?}");

    let new = v1::CreateSessionRequest { mode: "rtk-fgo".to_owned(), base, ..Default::default() };
    let session = calls::sessions::create(&doors.caller(), new).await.unwrap().0.session;
    for batch in PAIR.rover[..40].chunks(20) {
        let epochs = batch.iter().map(|e| convert::epoch_message(e.seq, &e.epoch)).collect();
        let push = v1::PushEpochsRequest { session: session.clone(), epochs };
        let answer = calls::positioning::push_epochs(&doors.caller(), push).await.unwrap();
        let last = answer.results.last().unwrap().solution.as_ref().unwrap();
        let ecef = last.position.as_ref().unwrap().ecef.as_ref().unwrap();
        let place = Ecef::new(ecef.x_m, ecef.y_m, ecef.z_m).to_geodetic();
        let start = Instant::now();
        loop {
            let line = tokio::time::timeout(Duration::from_secs(10), telling.recv());
            let line = line.await.unwrap().unwrap();
            assert!(line.starts_with("$GPGGA,"), "{line}");
            let fields: Vec<&str> = line.split(',').collect();
            let off_deg = [
                degrees(fields[2], fields[3]) - place.latitude_rad.to_degrees(),
                degrees(fields[4], fields[5]) - place.longitude_rad.to_degrees(),
            ];
            // The sentence has a resolution of 10⁻⁴ minutes, 0.2 m.
            if off_deg.iter().all(|off| off.abs() < 1e-6) {
                break;
            }
            assert!(start.elapsed() < Duration::from_secs(10), "{line}, not {place:?}");
        }
    }
    // After a reconnection the position is sent at once: in the request of version 2, and as a
    // sentence.
    let request = loop {
        let request = tokio::time::timeout(Duration::from_secs(10), asking.recv());
        let request = request.await.unwrap().unwrap();
        if request.contains("GGA") {
            break request;
        }
    };
    assert!(request.contains("Ntrip-GGA: $GPGGA,"), "{request}");
}

/// A base that a caster on this machine computes for its rovers.
async fn following(doors: &Doors, port: u16) -> String {
    let near: v1::GpsTime = NEAR.into();
    let ntrip = json!({
        "caster": format!("ntrip://127.0.0.1:{port}"),
        "mountpoint": "VRS",
        "followRover": true,
        "near": {"week": near.week, "nsOfWeek": near.ns_of_week},
    });
    let (status, base) = doors.post("/v1/bases", json!({"ntrip": ntrip})).await;
    assert_eq!(status.as_u16(), 201, "{base}");
    base["base"].as_str().unwrap().to_owned()
}

/// Frames of the log, in which each message 1005 moves the base by 5 m. Returns the data of one
/// connection and of the next one, which begins without a message 1005.
fn moving() -> Option<[Vec<u8>; 2]> {
    let folder = data::set("galway-static")?;
    let log = unpacked(&folder.join("base-20181004-1236.ubx.gz"));
    let mut moves = 0;
    let mut streams = [Vec::new(), Vec::new()];
    for payload in rtcm_payloads(&log[..log.len() / 6]) {
        let stream = &mut streams[usize::from(5 <= moves)];
        if message_number(&payload) != 1005 {
            stream.extend(rtcm_frame(&payload));
            continue;
        }
        moves += 1;
        if !(5..12).contains(&moves) {
            stream.extend(rtcm_frame(&moved_station(&payload, moves * 50_000)));
        }
    }
    Some(streams)
}

/// The epochs of a stream by time, each with the latest position before it. Epochs before the first
/// position have the first position.
fn places(stream: &[u8]) -> Vec<(GpsTime, Ecef)> {
    let mut place = None;
    let mut epochs: Vec<(GpsTime, Option<Ecef>)> = Vec::new();
    for event in decode(stream, Some(TimeReference::Day(NEAR))).0 {
        match event {
            Event::Epoch(epoch) => epochs.push((epoch.time, place)),
            Event::Station(station) => place = station.antenna_reference_point.or(place),
            _ => {}
        }
    }
    let first = epochs.iter().find_map(|(_, place)| *place).unwrap();
    epochs.into_iter().map(|(time, place)| (time, place.unwrap_or(first))).collect()
}

/// Messages move the base by 5 m each, many in one chunk, and also between two connections. Each
/// epoch keeps the position that was sent for it.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn epochs_keep_the_place_of_their_virtual_base() {
    let Some(streams) = moving() else { return };
    let [first, second] = streams.each_ref().map(|stream| places(stream));
    let expected = [first, second].concat();
    let doors = Doors::with_feeds(Limits::standard(), CONTENT).await;
    let caster = HostileCaster::start(move |number, mut socket, _| {
        let stream = streams[number.min(1)].clone();
        async move {
            socket.write_all(&[b"ICY 200 OK\r\n", stream.as_slice()].concat()).await.unwrap();
            socket.flush().await.unwrap();
            if number == 0 {
                socket.shutdown().await.unwrap();
            }
            keep(socket).await;
        }
    })
    .await;
    let base = BaseId::parse(&following(&doors, caster.port).await).unwrap();
    let ask = async || doors.service.bases().get(&base).await.unwrap();
    // The last epoch of a connection may be incomplete, because its last message does not come.
    let held = until("filled", ask, |held| expected.len() - 2 <= held.epochs).await;
    let mut seen = Vec::new();
    for number in 1..=held.epochs as u64 {
        let used = BaseUse { base: held.name.key, after: number - 1, through: number };
        let given = doors.service.bases().used(&[used])[0].replayed_input(used).unwrap();
        let aiding = given.aiding().unwrap();
        let (time, point) = (aiding.epochs[0].time, aiding.station.antenna_reference_point);
        let (_, place) = expected.iter().find(|(other, _)| *other == time).unwrap();
        assert!(point.distance_m(*place) < 1e-3, "{point:?}, not {place:?} at {time}");
        seen.push(point);
    }
    seen.dedup();
    assert!(6 <= seen.len(), "{} places", seen.len());
    assert_eq!(caster.connections.load(std::sync::atomic::Ordering::SeqCst), 2);
}
