//! `/v1/jobs`.

use axum::body::Body;
use axum::extract::{Path, Request};
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use futures::TryStreamExt;
use serde::Deserialize;
use utoipa::IntoParams;

use crate::contract::{Caller, Refusal, calls, log_failure, v1};

use super::body::{StrictQuery, json};
use super::conditions::{IdempotencyKey, Location, created, location};
use super::json::Json;
use super::lists::order;
use super::multipart::Multipart;
use super::problem::Refused;

/// Path of the call that takes uploads.
pub(super) const PATH: &str = "/v1/jobs";
/// Name of the part with the options.
const OPTIONS: &str = "options";
/// Longest part with options (bytes).
const OPTIONS_BYTES: usize = 64 << 10;

/// Creates a job from uploaded files.
///
/// The body has the parts `rover`, `navigation` (once or several times), `base` (in modes relative
/// to one) and `options` (JSON). Files are RINEX, CRINEX, UBX, RTCM 3 or Android GnssLogger logs,
/// plain or gzip; their content decides. With the header `Idempotency-Key` a repetition of the same
/// request returns the same job, with status 200.
#[utoipa::path(post, operation_id = "jobsCreate",
    path = "/v1/jobs", tag = "Jobs",
    params(("Idempotency-Key" = Option<String>, Header, description = "Names this request")),
    request_body(content = JobUpload, content_type = "multipart/form-data"),
    responses(
        (status = 201, description = "The job", body = v1::Job,
            headers(("Location" = String, description = "Path of the job"))),
        (status = 200, description = "The job, which this request has created before",
            body = v1::Job),
        Refused))]
pub(super) async fn create(
    caller: Caller,
    IdempotencyKey(key): IdempotencyKey,
    request: Request,
) -> Result<(StatusCode, Location, Json<v1::Job>), Refused> {
    let mut parts = Multipart::of(request)?;
    let mut arriving = calls::jobs::begin(&caller).await?;
    while let Some(mut part) = parts.next().await? {
        let name = part.name()?.to_owned();
        if name == OPTIONS {
            let content = part.whole_options(OPTIONS_BYTES).await?;
            let within = |refusal: Refusal| refusal.within(OPTIONS);
            arriving.options(json(&content).map_err(within)?)?;
        } else {
            let mut file = arriving.begin(&name, &part.file_name()).await?;
            while let Some(bytes) = part.chunk().await? {
                file.write(&bytes).await?;
            }
            arriving.finish(file).await?;
        }
    }
    let (job, is_new) = arriving.submit(&caller, key.as_deref()).await?;
    Ok((created(is_new), location(PATH, &job.job), Json(job)))
}

/// The parts of an upload.
#[derive(utoipa::ToSchema)]
#[expect(dead_code, reason = "it describes the body")]
pub(super) struct JobUpload {
    /// Observations of the rover.
    #[schema(value_type = String, format = Binary)]
    rover: Vec<u8>,
    /// Navigation data; the part may be repeated.
    #[schema(value_type = Vec<String>, format = Binary)]
    navigation: Vec<Vec<u8>>,
    /// Observations of the base.
    #[schema(value_type = Option<String>, format = Binary)]
    base: Option<Vec<u8>>,
    /// What to compute.
    options: Option<v1::JobOptions>,
}

/// Returns a job with its progress, and why it has failed.
#[utoipa::path(get, operation_id = "jobsGet",
    path = "/v1/jobs/{job}", tag = "Jobs",
    params(("job" = String, Path, description = "Its id")),
    responses((status = 200, description = "The job", body = v1::Job), Refused))]
pub(super) async fn get(caller: Caller, Path(job): Path<String>) -> Result<Json<v1::Job>, Refused> {
    Ok(Json(calls::jobs::get(&caller, v1::GetJobRequest { job }).await?))
}

/// Which jobs to list.
#[derive(Clone, Debug, Default, Deserialize, IntoParams)]
#[serde(rename_all = "camelCase", default, deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct JobsQuery {
    /// At most this many items on the page, 1 to 1000; 100 if absent. A page has at most 256
    /// jobs. It may have fewer although more exist, because memory is scarce.
    #[param(minimum = 0, maximum = 1000)]
    page_size: u32,
    /// `nextPageToken` of the previous answer. The other parameters but `pageSize` must be those of
    /// its request.
    page_token: String,
    /// Only those of this state, such as `RUNNING`.
    state: String,
    /// `NEWEST_FIRST` (if absent) or `OLDEST_FIRST`.
    order: Option<String>,
}

/// Lists jobs, the newest first unless asked otherwise.
#[utoipa::path(get, operation_id = "jobsList",
    path = "/v1/jobs", tag = "Jobs", params(JobsQuery),
    responses((status = 200, description = "A page of jobs",
        body = v1::ListJobsResponse), Refused))]
pub(super) async fn list(
    caller: Caller,
    StrictQuery(query): StrictQuery<JobsQuery>,
) -> Result<Json<v1::ListJobsResponse>, Refused> {
    let JobsQuery { page_size, page_token, state, order: by } = query;
    let request = v1::ListJobsRequest { page_size, page_token, state, order: order(by)? };
    Ok(Json(calls::jobs::list(&caller, request).await?))
}

/// Whether to delete a job.
#[derive(Clone, Debug, Default, Deserialize, IntoParams)]
#[serde(rename_all = "camelCase", default, deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct EndQuery {
    /// Deletes a job that has ended, with its result, before it expires. It is then not found any
    /// more.
    purge: bool,
}

/// Ends a job that waits or runs. A job that has ended stays as it is, unless it is purged.
#[utoipa::path(delete, operation_id = "jobsCancel",
    path = "/v1/jobs/{job}", tag = "Jobs",
    params(("job" = String, Path, description = "Its id"), EndQuery),
    responses((status = 200, description = "The job as it is now, or was",
        body = v1::Job), Refused))]
pub(super) async fn end(
    caller: Caller,
    Path(job): Path<String>,
    StrictQuery(query): StrictQuery<EndQuery>,
) -> Result<Json<v1::Job>, Refused> {
    if query.purge {
        return Ok(Json(calls::jobs::delete(&caller, v1::DeleteJobRequest { job }).await?));
    }
    Ok(Json(calls::jobs::cancel(&caller, v1::CancelJobRequest { job }).await?))
}

/// Returns the file of positions of a job that has succeeded.
#[utoipa::path(get, operation_id = "jobsResult",
    path = "/v1/jobs/{job}/result", tag = "Jobs",
    params(("job" = String, Path, description = "Its id")),
    responses((status = 200, description = "The file of positions",
        content((String = "text/plain"), (String = "text/csv"),
            (String = "application/geo+json"), (String = "application/vnd.google-earth.kml+xml"),
            (String = "application/gpx+xml"), (String = "application/vnd.apache.parquet"))),
        Refused))]
pub(super) async fn result(caller: Caller, Path(job): Path<String>) -> Result<Response, Refused> {
    let result = calls::jobs::result(&caller, v1::GetJobRequest { job }).await?;
    let headers = [
        (header::CONTENT_TYPE, result.content_type.to_owned()),
        (header::CONTENT_LENGTH, result.bytes.to_string()),
        (header::CONTENT_DISPOSITION, format!("attachment; filename=\"{}\"", result.name)),
    ];
    let content = result.content().inspect_err(|refusal: &Refusal| {
        log_failure(refusal, "a result breaks off: ");
    });
    Ok((headers, Body::from_stream(content)).into_response())
}

/// Returns the attempts to tell the webhook of a job of its end.
#[utoipa::path(get, operation_id = "jobsDeliveries",
    path = "/v1/jobs/{job}/deliveries", tag = "Jobs",
    params(("job" = String, Path, description = "Its id")),
    responses((status = 200, description = "The attempts", body = v1::JobDeliveries), Refused))]
pub(super) async fn deliveries(
    caller: Caller,
    Path(job): Path<String>,
) -> Result<Json<v1::JobDeliveries>, Refused> {
    Ok(Json(calls::job_deliveries::list(&caller, v1::GetJobRequest { job }).await?))
}
