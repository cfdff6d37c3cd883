//! The report of a job as a page, by the service and by `graphfix solve`.

use std::process::Command;

use axum::body::Body;
use axum::http::{HeaderMap, Request, StatusCode, header};
use serde_json::{Value, json};
use tower::ServiceExt;

use super::jobs::{created, ended, files};
use crate::support::doors::{Doors, code};
use crate::support::jobs::{MINUTE, body};

/// The report at a path with a header `Accept`: its headers and its text.
pub(super) async fn report(doors: &Doors, path: &str, accept: Option<&str>) -> (HeaderMap, String) {
    let mut request = Request::get(path);
    if let Some(accept) = accept {
        request = request.header(header::ACCEPT, accept);
    }
    let response = doors.router.clone().oneshot(request.body(Body::empty()).unwrap()).await;
    let response = response.unwrap();
    assert_eq!(response.status(), StatusCode::OK, "{path}");
    let headers = response.headers().clone();
    let bytes = axum::body::to_bytes(response.into_body(), usize::MAX).await.unwrap();
    (headers, String::from_utf8(bytes.to_vec()).unwrap())
}

/// A page that runs nothing and loads nothing.
fn assert_self_contained(page: &str) {
    let others = page.replace("http://www.w3.org/2000/svg", "");
    for foreign in ["<script", "<link", "<img", "<iframe", " src=", " href=", "url(", "@import"] {
        assert!(!others.contains(foreign), "{foreign}");
    }
    assert!(!others.contains(" style=") && !others.contains("http:"), "no style of an element");
    assert_eq!(page.matches("<svg").count(), page.matches("</svg>").count());
    assert!(page.contains("prefers-color-scheme:dark"));
}

#[tokio::test]
async fn a_report_is_a_page_for_browsers() {
    let doors = Doors::open().await;
    let options = json!({"mode": "rtk-fgo", "overrides": {"elevation_mask_deg": "12"}});
    let job = created(&doors, MINUTE.body(&options)).await;
    let path = format!("/v1/jobs/{job}/report");
    assert_eq!(ended(&doors, &job).await["state"], "SUCCEEDED");
    let (headers, page) = report(&doors, &format!("{path}?format=html"), None).await;
    assert_eq!(headers[header::CONTENT_TYPE], "text/html; charset=utf-8");
    assert_eq!(headers[header::VARY], "accept");
    let policy = headers[header::CONTENT_SECURITY_POLICY].to_str().unwrap();
    assert!(policy.starts_with("default-src 'none'") && !policy.contains("script"), "{policy}");
    let name = headers[header::CONTENT_DISPOSITION].to_str().unwrap();
    assert_eq!(name, format!("inline; filename=\"{job}-report.html\""));
    assert_self_contained(&page);

    let (_, counted) = doors.get(&path).await;
    for count in counted["statuses"].as_array().unwrap() {
        let (name, epochs) = (count["name"].as_str().unwrap(), &count["epochs"]);
        let row = format!("<th scope=\"row\">{name}</th><td>{epochs}</td>");
        assert!(page.contains(&row), "{row}");
    }
    for count in counted["reasons"].as_array().unwrap() {
        let code = count["name"].as_str().unwrap();
        let row = format!("<code>{code}</code></th><td class=\"number\">{}</td>", count["epochs"]);
        assert!(page.contains(&row), "{row}");
    }
    for text in [
        &job,
        "rtk-fgo",
        "elevation_mask_deg=12",
        "a.file",
        counted["configurationHash"].as_str().unwrap(),
        "61 of 61 epochs",
        "base: marker at",
        "<h2>Track</h2>",
        "Height over time",
        "Horizontal uncertainty over time",
        "Satellites used over time",
        "Ratio of the integers over time",
    ] {
        assert!(page.contains(text), "{text}");
    }

    let browser = "text/html,application/xhtml+xml,application/xml;q=0.9,*/*;q=0.8";
    assert_eq!(report(&doors, &path, Some(browser)).await.1, page);
    for accept in [None, Some("*/*"), Some("application/json")] {
        let (headers, text) = report(&doors, &path, accept).await;
        assert_eq!(headers[header::CONTENT_TYPE], "application/json", "{accept:?}");
        assert_eq!(serde_json::from_str::<Value>(&text).unwrap(), counted);
    }
    let (headers, _) = report(&doors, &format!("{path}?format=json"), Some(browser)).await;
    assert_eq!(headers[header::CONTENT_TYPE], "application/json");
    let (status, refused) = doors.get(&format!("{path}?format=pdf")).await;
    assert_eq!((status.as_u16(), code(&refused)), (400, "INVALID_FIELD"), "{refused}");
    assert_eq!(refused["field"], "format");
    assert_eq!(doors.service.budget().used(), 0);
}

/// A report without figures is still a page. Figures are deleted with their job.
#[tokio::test]
async fn figures_are_kept_as_long_as_their_result() {
    let doors = Doors::open().await;
    let job = created(&doors, MINUTE.body(&json!({"mode": "spp"}))).await;
    assert_eq!(ended(&doors, &job).await["state"], "SUCCEEDED");
    let path = format!("/v1/jobs/{job}/report?format=html");
    assert!(report(&doors, &path, None).await.1.contains("<h2>Track</h2>"));
    // Figures have the name of their result, so a restart and the removal of old files keep them.
    let doors = doors.restarted().await;
    doors.service.jobs().remove_expired().await.unwrap();
    assert!(report(&doors, &path, None).await.1.contains("<h2>Track</h2>"));
    let results = doors.folder().join("test.db.jobs/results");
    let names = std::fs::read_dir(&results).unwrap().map(|entry| entry.unwrap().path());
    let figures = names.filter(|name| name.to_string_lossy().ends_with("-figures"));
    let [figures] = figures.collect::<Vec<_>>().try_into().unwrap();
    // Jobs of earlier versions have no figures.
    let kept = std::fs::read(&figures).unwrap();
    std::fs::remove_file(&figures).unwrap();
    let (_, page) = report(&doors, &path, None).await;
    assert!(page.contains("were not kept") && page.contains("SINGLE"), "{page}");
    std::fs::write(&figures, kept).unwrap();
    let purged = format!("/v1/jobs/{job}?purge=true");
    assert_eq!(doors.send("DELETE", &purged, Value::Null).await.0, StatusCode::OK);
    assert!(!figures.exists());
    assert_eq!(files(&doors), 3, "the inputs, until they are old");
    let (status, gone) = doors.get(&path).await;
    assert_eq!((status.as_u16(), code(&gone)), (404, "JOB_NOT_FOUND"));
}

#[tokio::test]
async fn a_job_without_result_has_no_page() {
    let doors = Doors::open().await;
    let text = body(&[("rover", b"neither"), ("navigation", &MINUTE.navigation)]);
    let job = created(&doors, text).await;
    assert_eq!(ended(&doors, &job).await["state"], "FAILED");
    let (status, refused) = doors.get(&format!("/v1/jobs/{job}/report?format=html")).await;
    assert_eq!((status.as_u16(), code(&refused)), (409, "JOB_WITHOUT_RESULT"), "{refused}");
}

#[test]
fn solve_writes_the_page_for_files() {
    let folder = tempfile::tempdir().unwrap();
    let [rover, navigation, base] = MINUTE.write(folder.path());
    let solve = |report: &str| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_graphfix"));
        command.arg("solve").arg("--rover").arg(&rover).arg("--nav").arg(&navigation);
        command.arg("--base").arg(&base).arg("--output").arg(folder.path().join("o.pos"));
        command.arg("--report").arg(folder.path().join(report)).output().unwrap()
    };
    let done = solve("report.html");
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    let page = std::fs::read_to_string(folder.path().join("report.html")).unwrap();
    assert_self_contained(&page);
    for text in ["<h1>rover</h1>", "rtk-fgo", "<h2>Track</h2>", "61 of 61 epochs", "base: marker"] {
        assert!(page.contains(text), "{text}");
    }
    let refused = solve("report.txt");
    let told = String::from_utf8_lossy(&refused.stderr).into_owned();
    assert!(!refused.status.success() && told.contains("UNKNOWN_OUTPUT_FORMAT"), "{told}");
}
