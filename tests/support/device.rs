//! A device that sends the bytes of its receiver, here the logs of `galway-static`.

use bytes::Bytes;
use graphfix::contract::{calls, v1};
use graphfix::gnss::GpsTime;

use super::data;
use super::doors::Doors;
use super::streams::unpacked;

/// Within half a day of the Galway logs.
pub(crate) const NEAR: GpsTime = GpsTime::from_ns((2021 * 604_800 + 391_000) * 1_000_000_000);

/// The logs of the static rover and of its base. The rover's has RXM-RAWX, the base's has messages
/// 1005, 1077 and 1087.
pub(crate) fn logs() -> Option<(Vec<u8>, Vec<u8>)> {
    let folder = data::set("galway-static")?;
    let log = |name: &str| unpacked(&folder.join(name));
    Some((log("rover-20181004-1237.ubx.gz"), log("base-20181004-1236.ubx.gz")))
}

/// Sends bytes of a device's receiver. Returns the answer.
pub(crate) async fn push(
    doors: &Doors,
    session: &str,
    offset: usize,
    bytes: &[u8],
) -> Vec<v1::Solution> {
    let mut solutions = Vec::new();
    for (index, content) in bytes.chunks(20_000).enumerate() {
        let push = v1::PushRawRequest {
            session: session.to_owned(),
            offset: (offset + index * 20_000) as u64,
            content: Bytes::copy_from_slice(content),
            end: false,
            near: None,
        };
        let answer = calls::raw::push(&doors.caller(), push).await.unwrap();
        solutions.extend(answer.results.into_iter().map(|result| result.solution.unwrap()));
    }
    solutions
}

/// Number of solutions relative to a base.
pub(crate) fn relative(solutions: &[v1::Solution]) -> usize {
    let is_relative = |status| matches!(status, v1::Status::Fixed | v1::Status::Float);
    solutions.iter().filter(|solution| is_relative(solution.status())).count()
}

pub(crate) fn fixed(solutions: &[v1::Solution]) -> usize {
    solutions.iter().filter(|solution| solution.status() == v1::Status::Fixed).count()
}
