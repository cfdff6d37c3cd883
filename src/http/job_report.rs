//! `/v1/jobs/{job}/report`.

use axum::extract::Path;
use axum::http::{HeaderMap, HeaderValue, header};
use axum::response::{IntoResponse, Response};
use serde::Deserialize;
use utoipa::IntoParams;

use crate::contract::{Caller, Refusal, calls, v1};
use crate::refusal::Code;

use super::body::StrictQuery;
use super::json::Json;
use super::problem::Refused;

/// `Content-Security-Policy` of the page, which needs only its own style sheet.
const POLICY: &str = "default-src 'none'; style-src 'unsafe-inline'; base-uri 'none'; \
                      form-action 'none'; frame-ancestors 'none'";

/// The form of a report.
#[derive(Clone, Debug, Default, Deserialize, IntoParams)]
#[serde(rename_all = "camelCase", default, deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct ReportQuery {
    /// `json`, or `html` for a page with figures that needs no other file; if absent, what the
    /// header `Accept` prefers, or `json`.
    format: Option<String>,
}

/// A form of a report.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Form {
    Json,
    Html,
}

/// Returns the report of a job that has succeeded: epochs, statuses, reasons, what the positions
/// rest on, and what was skipped of the files. As a page it also has the job's files and options,
/// and figures of track, statuses, height, uncertainty, satellites and integers over time.
#[utoipa::path(get, operation_id = "jobsReport",
    path = "/v1/jobs/{job}/report", tag = "Jobs",
    params(("job" = String, Path, description = "Its id"), ReportQuery),
    responses((status = 200, description = "The report",
        content((v1::JobReport = "application/json"), (String = "text/html"))), Refused))]
pub(super) async fn report(
    caller: Caller,
    Path(job): Path<String>,
    StrictQuery(query): StrictQuery<ReportQuery>,
    headers: HeaderMap,
) -> Result<Response, Refused> {
    let form = query.format.as_deref().map_or_else(|| Ok(accepted(&headers)), named)?;
    let request = v1::GetJobRequest { job };
    let mut response = match form {
        Form::Json => Json(calls::jobs::report(&caller, request).await?).into_response(),
        Form::Html => {
            let name = format!("inline; filename=\"{}-report.html\"", request.job);
            let page = calls::jobs::report_page(&caller, request).await?;
            let headers = [
                (header::CONTENT_TYPE, "text/html; charset=utf-8"),
                (header::CONTENT_SECURITY_POLICY, POLICY),
                (header::REFERRER_POLICY, "no-referrer"),
                (header::CONTENT_DISPOSITION, name.as_str()),
            ];
            (headers, page).into_response()
        }
    };
    response.headers_mut().insert(header::VARY, HeaderValue::from_static("accept"));
    Ok(response)
}

/// The form with this name.
///
/// # Errors
/// There is no such form.
fn named(format: &str) -> Result<Form, Refusal> {
    match format {
        "json" => Ok(Form::Json),
        "html" => Ok(Form::Html),
        _ => {
            let message = "it is not a format of reports; known are json, html";
            Err(Refusal::new(Code::InvalidField, message).at("format"))
        }
    }
}

/// HTML for a client that prefers it to JSON, as browsers do.
fn accepted(headers: &HeaderMap) -> Form {
    let texts = headers.get_all(header::ACCEPT).iter().filter_map(|value| value.to_str().ok());
    let ranges: Vec<(String, f64)> =
        texts.flat_map(|text| text.split(',')).filter_map(media_range).collect();
    // The most specific range that contains a type counts (RFC 9110, section 12.5.1).
    let quality = |kind: &str| {
        let group = format!("{}/*", kind.split('/').next().unwrap_or_default());
        let of = |name: &str| ranges.iter().find(|(range, _)| range == name);
        let found = of(kind).or_else(|| of(&group)).or_else(|| of("*/*"));
        found.map_or(0.0, |(_, quality)| *quality)
    };
    match quality("application/json") < quality("text/html") {
        true => Form::Html,
        false => Form::Json,
    }
}

/// A media range and its quality.
fn media_range(text: &str) -> Option<(String, f64)> {
    let mut parts = text.split(';').map(str::trim);
    let range = parts.next()?.to_ascii_lowercase();
    let quality = parts.find_map(|part| part.strip_prefix("q="));
    Some((range, quality.map_or(Some(1.0), |quality| quality.parse().ok())?))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn form(accept: &str) -> Form {
        let value = accept.parse().unwrap();
        accepted(&HeaderMap::from_iter([(header::ACCEPT, value)]))
    }

    #[test]
    fn browsers_get_a_page_and_programs_json() {
        let of_firefox = "text/html,application/xhtml+xml,application/xml;q=0.9,*/*;q=0.8";
        for html in [of_firefox, "text/html", "text/*", "application/json;q=0.5, Text/HTML;q=0.6"] {
            assert_eq!(form(html), Form::Html, "{html}");
        }
        for json in ["*/*", "application/json", "application/json, text/html", "image/png", "", ";"]
        {
            assert_eq!(form(json), Form::Json, "{json}");
        }
        assert_eq!(form("text/html;q=0.1, */*"), Form::Json);
        assert_eq!(form("text/html;q=none"), Form::Json);
        assert_eq!(accepted(&HeaderMap::new()), Form::Json);
    }
}
