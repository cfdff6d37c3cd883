//! `/v1/sessions/{session}/raw`.

use axum::Json;
use axum::extract::Path;
use serde::Deserialize;
use utoipa::IntoParams;

use crate::contract::{Caller, Refusal, calls, intake, v1};

use super::body::{RawBody, StrictQuery};
use super::problem::Refused;

/// Position of a chunk in its stream.
#[derive(Clone, Debug, Default, Deserialize, IntoParams)]
#[serde(rename_all = "camelCase", default, deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct RawQuery {
    /// Number of bytes sent to the session before this chunk, from its very first byte; 0 if
    /// absent.
    offset: u64,
    /// The stream ends with this chunk; the next one begins another stream.
    end: bool,
    /// A time within half a day of the stream's first message, for messages without a week number:
    /// GPS week and seconds of week, such as `2051:46701.5`. The service's clock if absent.
    near: Option<String>,
}

/// Takes the bytes of a receiver as they arrive, split anywhere.
///
/// The bytes are frames of RTCM 3 and UBX, RINEX observations, or the log of Android's GnssLogger.
/// All bytes before `rawThrough` of the answer are stored, and the epochs that they complete are
/// committed. The device continues at this offset. Repeated bytes change nothing.
#[utoipa::path(post, operation_id = "rawPush",
    path = "/v1/sessions/{session}/raw", tag = "Positioning",
    params(("session" = String, Path, description = "Its id"), RawQuery),
    request_body(content = String, content_type = "application/octet-stream",
        description = "Bytes of the stream"),
    responses((status = 200, description = "How far the stream is stored, and what it brought",
        body = v1::PushRawResponse), Refused))]
pub(super) async fn push(
    caller: Caller,
    Path(session): Path<String>,
    StrictQuery(query): StrictQuery<RawQuery>,
    RawBody(content): RawBody,
) -> Result<Json<v1::PushRawResponse>, Refused> {
    let RawQuery { offset, end, near } = query;
    let at_near = |refusal: Refusal| refusal.at("near");
    let near = near.map(|text| intake::time_text(&text).map(Into::into).map_err(at_near));
    let request = v1::PushRawRequest { session, offset, content, end, near: near.transpose()? };
    Ok(Json(calls::raw::push(&caller, request).await?))
}
