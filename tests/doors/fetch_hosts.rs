//! Hosts that one tenant alone may name: for the casters and archives of its bases, and for the
//! URLs and webhooks of its jobs.

use std::collections::BTreeMap;

use axum::body::Body;
use axum::http::{Request, StatusCode};
use graphfix::app;
use graphfix::config::{FetchConfiguration, ServiceConfiguration};
use serde_json::{Value, json};

use super::job_urls::host;
use super::tenants::world::{Answer, Key, asked, get, key_of, marker, operator, sent};
use crate::support::casters::{BRISK, PATIENCE};
use crate::support::doors::Doors;
use crate::support::jobs::{BOUNDARY, MINUTE, body};
use crate::support::wait::until;

const SECRET: &str = "whsec_MTIzNDU2Nzg5MDEyMzQ1Njc4OTAxMjM0NTY3ODkw";

fn fetch(tenant: &str, host: &str) -> FetchConfiguration {
    FetchConfiguration {
        hosts: vec!["shared.example.org".to_owned()],
        tenants: BTreeMap::from([(tenant.to_owned(), vec![host.to_owned()])]),
        private_addresses: true,
        ..ServiceConfiguration::standard().fetch
    }
}

/// Posts a job with these options and no files.
async fn posted(doors: &Doors, key: &Key, options: Value) -> Answer {
    let kind = format!("multipart/form-data; boundary={BOUNDARY}");
    let content = body(&[("options", options.to_string().as_bytes())]);
    let request = Request::post("/v1/jobs").header("content-type", kind);
    sent(doors, key, request.body(Body::from(content)).unwrap()).await
}

#[tokio::test]
async fn a_host_of_a_tenant_is_for_that_tenant() {
    let host =
        host(vec![("/rover", MINUTE.rover.clone()), ("/navigation", MINUTE.navigation.clone())]);
    let host = host.await;
    let at = format!("127.0.0.1:{}", host.port);
    let doors = Doors::with_fetch(fetch("acme", &at)).await;
    let operator = operator(&doors).await;
    let acme = key_of(&doors, &operator, "acme", "").await;
    let other = key_of(&doors, &operator, "other", "").await;
    let url = |part: &str| json!({"part": part, "url": format!("http://{at}/{part}")});
    let urls = json!({"mode": "spp", "urls": [url("rover"), url("navigation")]});
    let hook = json!({"url": format!("http://{at}/hook"), "secret": SECRET});
    let shared = json!({"part": "rover", "url": "http://shared.example.org/rover"});
    let told = json!({"mode": "spp", "webhook": hook, "urls": [shared, url("navigation")]});
    let ntrip = json!({"ntrip": {"caster": format!("ntrip://{at}"), "mountpoint": "BASE"}});
    let archive = json!({"archive": {"template": format!("http://{at}/{{yyyy}}/{{ddd}}.rnx")}, "marker": marker()});

    for (key, expected) in [(&acme, None), (&other, Some(())), (&operator, Some(()))] {
        for options in [&urls, &told] {
            let answer = posted(&doors, key, options.clone()).await;
            let refusal = answer.refusal.map(|(code, _)| assert_eq!(code, "HOST_NOT_ALLOWED"));
            assert_eq!(refusal, expected, "{}", answer.text);
        }
        for new in [&ntrip, &archive] {
            let (status, answer) = asked(&doors, key, "POST", "/v1/bases", new.clone()).await;
            match expected {
                None => assert_eq!(status, StatusCode::CREATED, "{answer}"),
                Some(()) => assert_eq!(answer["code"], "HOST_NOT_ALLOWED", "{answer}"),
            }
        }
    }
    // The host gets requests for the tenant's files only. The refused requests of the other tenant
    // contact no host.
    let jobs = async || get(&doors, &acme, "/v1/jobs").await["jobs"].clone();
    let succeeded =
        |jobs: &Value| jobs.as_array().unwrap().iter().any(|job| job["state"] == "SUCCEEDED");
    until("the files are fetched and computed", jobs, succeeded).await;
    doors.close().await;
}

#[tokio::test]
async fn hosts_of_no_tenant_are_refused_at_the_start() {
    for (tenant, host, named) in
        [("Acme Ltd", "localhost", "Acme Ltd"), ("acme", "http://localhost", "http://localhost")]
    {
        let folder = tempfile::tempdir().unwrap();
        let configuration = ServiceConfiguration {
            database: format!("sqlite://{}", folder.path().join("a.db").display()),
            fetch: fetch(tenant, host),
            ..ServiceConfiguration::standard()
        };
        let refused = app::open(&configuration, PATIENCE, BRISK).await.err().unwrap().to_string();
        assert!(refused.contains(named), "{refused}");
    }
}
