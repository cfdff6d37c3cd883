//! A service in this process; requests go through its router.

use std::collections::BTreeMap;

use axum::Router;
use axum::body::Body;
use axum::http::{Request, StatusCode};
use graphfix::app::{self, App};
use graphfix::config::{
    AntennasConfiguration, FetchConfiguration, JobsConfiguration, Limits, SecretsConfiguration,
    ServiceConfiguration,
};
use graphfix::contract::{Caller, Service};
use graphfix::feeds::FeedOptions;
use serde_json::{Value, json};
use tokio::net::TcpListener;
use tower::ServiceExt;

use super::casters::{BRISK, PATIENCE};
use super::wait::until;

/// The operator's calibrations of antennas, in the folder of the database.
const ANTEX: &str = "antennas.atx";
/// The operator's table of the geoid, in the same folder.
const GEOID: &str = "geoid.gtx";

pub(crate) struct Doors {
    pub(crate) router: Router,
    pub(crate) service: Service,
    app: App,
    jobs: JobsConfiguration,
    folder: tempfile::TempDir,
    database: String,
}

impl Doors {
    /// With the database of this URL and these keys of secrets.
    pub(crate) async fn on_with_secrets(database: &str, secrets: SecretsConfiguration) -> Self {
        let (folder, limits) = (tempfile::tempdir().unwrap(), Limits::standard());
        let jobs = JobsConfiguration::standard();
        let jobs = JobsConfiguration { folder: Some(folder.path().join("jobs")), ..jobs };
        let place = (folder, Some(database.to_owned()));
        let change = |configuration| ServiceConfiguration { secrets, ..configuration };
        Self::changed(place, limits, jobs, BRISK, change).await
    }

    /// With traces that go to this collector.
    #[cfg(feature = "otlp")]
    pub(crate) async fn with_collector(endpoint: &str) -> Self {
        let otlp_endpoint = Some(endpoint.to_owned());
        let telemetry =
            graphfix::config::TelemetryConfiguration { otlp_endpoint, ..Default::default() };
        let place = (tempfile::tempdir().unwrap(), None);
        let (limits, jobs) = (Limits::standard(), JobsConfiguration::standard());
        let change = |configuration| ServiceConfiguration { telemetry, ..configuration };
        Self::changed(place, limits, jobs, BRISK, change).await
    }

    /// With these origins of web pages, by tenant.
    pub(crate) async fn with_cors(cors: BTreeMap<String, Vec<String>>) -> Self {
        let place = (tempfile::tempdir().unwrap(), None);
        let (limits, jobs) = (Limits::standard(), JobsConfiguration::standard());
        let change = |configuration| ServiceConfiguration { cors, ..configuration };
        Self::changed(place, limits, jobs, BRISK, change).await
    }

    /// With these hosts that clients may name.
    pub(crate) async fn with_fetch(fetch: FetchConfiguration) -> Self {
        let place = (tempfile::tempdir().unwrap(), None);
        let (limits, jobs) = (Limits::standard(), JobsConfiguration::standard());
        let change = |configuration| ServiceConfiguration { fetch, ..configuration };
        Self::changed(place, limits, jobs, BRISK, change).await
    }

    /// With these archives of ephemerides.
    pub(crate) async fn with_archives(archives: Vec<String>) -> Self {
        let place = (tempfile::tempdir().unwrap(), None);
        let (limits, jobs) = (Limits::standard(), JobsConfiguration::standard());
        let change = |mut configuration: ServiceConfiguration| {
            configuration.navigation.archives = archives;
            configuration
        };
        Self::changed(place, limits, jobs, BRISK, change).await
    }

    pub(crate) async fn open() -> Self {
        Self::with(Limits::standard()).await
    }

    pub(crate) async fn with(limits: Limits) -> Self {
        Self::with_feeds(limits, BRISK).await
    }

    /// With these limits, on a port of its own, which it listens to.
    pub(crate) async fn listening(limits: Limits) -> (Self, u16) {
        let doors = Self::with(limits).await;
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let port = listener.local_addr().unwrap().port();
        let service = doors.service.clone();
        tokio::spawn(async move {
            let (stop, closed) = (std::future::pending(), std::future::ready(()));
            graphfix::http::serve(listener, &service, stop, closed).await;
        });
        (doors, port)
    }

    /// With these options of streams.
    pub(crate) async fn with_feeds(limits: Limits, options: FeedOptions) -> Self {
        let (folder, jobs) = (tempfile::tempdir().unwrap(), JobsConfiguration::standard());
        Self::within((folder, None), limits, jobs, options).await
    }

    /// With these options of batch jobs.
    pub(crate) async fn with_jobs(jobs: JobsConfiguration) -> Self {
        let folder = tempfile::tempdir().unwrap();
        Self::within((folder, None), Limits::standard(), jobs, BRISK).await
    }

    /// With the database of this URL.
    pub(crate) async fn on(database: &str) -> Self {
        Self::on_with_jobs(database, JobsConfiguration::standard()).await
    }

    /// With the database of this URL and these options of batch jobs.
    pub(crate) async fn on_with_jobs(database: &str, jobs: JobsConfiguration) -> Self {
        let folder = tempfile::tempdir().unwrap();
        // A server has no folder beside it.
        let jobs = JobsConfiguration { folder: Some(folder.path().join("jobs")), ..jobs };
        let place = (folder, Some(database.to_owned()));
        Self::within(place, Limits::standard(), jobs, BRISK).await
    }

    /// With calibrations of these antennas.
    pub(crate) async fn with_antex(antex: &str) -> Self {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join(ANTEX), antex).unwrap();
        let jobs = JobsConfiguration::standard();
        Self::within((folder, None), Limits::standard(), jobs, BRISK).await
    }

    /// With this table of the geoid.
    pub(crate) async fn with_geoid(table: &[u8]) -> Self {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join(GEOID), table).unwrap();
        let jobs = JobsConfiguration::standard();
        Self::within((folder, None), Limits::standard(), jobs, BRISK).await
    }

    /// The service after it has stopped and started again.
    pub(crate) async fn restarted(self) -> Self {
        self.app.close().await;
        let place = (self.folder, Some(self.database));
        Self::within(place, Limits::standard(), self.jobs, BRISK).await
    }

    /// Stops the service: nothing of it uses the database any more.
    pub(crate) async fn close(self) {
        self.app.close().await;
    }

    /// The caller of requests without a key.
    pub(crate) fn caller(&self) -> Caller {
        self.service.without_key().unwrap()
    }

    /// The folder of the database.
    pub(crate) fn folder(&self) -> &std::path::Path {
        self.folder.path()
    }

    async fn within(
        (folder, database): (tempfile::TempDir, Option<String>),
        limits: Limits,
        jobs: JobsConfiguration,
        options: FeedOptions,
    ) -> Self {
        Self::changed((folder, database), limits, jobs, options, |same| same).await
    }

    async fn changed(
        (folder, database): (tempfile::TempDir, Option<String>),
        limits: Limits,
        jobs: JobsConfiguration,
        options: FeedOptions,
        change: impl FnOnce(ServiceConfiguration) -> ServiceConfiguration,
    ) -> Self {
        let own = || format!("sqlite://{}", folder.path().join("test.db").display());
        let database = database.unwrap_or_else(own);
        let hosts = ["localhost", "127.0.0.1"].map(str::to_owned).to_vec();
        let [antex, geoid] = [ANTEX, GEOID].map(|name| folder.path().join(name));
        let configuration = ServiceConfiguration {
            database: database.clone(),
            fetch: FetchConfiguration {
                hosts,
                private_addresses: true,
                ..ServiceConfiguration::standard().fetch
            },
            antennas: AntennasConfiguration { antex: antex.is_file().then_some(antex) },
            geoid_file: geoid.is_file().then_some(geoid),
            jobs: jobs.clone(),
            // Stored secrets are encrypted, except in the tests of a service without a key.
            secrets: SecretsConfiguration { key: Some("5e".repeat(32)), ..Default::default() },
            limits,
            ..ServiceConfiguration::standard()
        };
        let configuration = change(configuration);
        let app = app::open(&configuration, PATIENCE, options).await.unwrap();
        let service = app.service().clone();
        Self { router: graphfix::http::router(&service), service, app, jobs, folder, database }
    }

    /// Status and JSON of the answer to a request.
    pub(crate) async fn ask(&self, request: Request<Body>) -> (StatusCode, Value) {
        let response = self.router.clone().oneshot(request).await.unwrap();
        let status = response.status();
        let bytes = axum::body::to_bytes(response.into_body(), usize::MAX).await.unwrap();
        let text = String::from_utf8_lossy(&bytes).into_owned();
        (status, serde_json::from_slice(&bytes).unwrap_or(Value::String(text)))
    }

    pub(crate) async fn get(&self, path: &str) -> (StatusCode, Value) {
        self.ask(Request::get(path).body(Body::empty()).unwrap()).await
    }

    /// The answer of `path` once `is_so` holds for it.
    pub(crate) async fn until(&self, path: &str, is_so: impl Fn(&Value) -> bool) -> Value {
        until(path, async || self.get(path).await.1, is_so).await
    }

    pub(crate) async fn send(&self, method: &str, path: &str, body: Value) -> (StatusCode, Value) {
        let request = Request::builder().method(method).uri(path);
        let request = request.header("content-type", "application/json");
        self.ask(request.body(Body::from(body.to_string())).unwrap()).await
    }

    pub(crate) async fn post(&self, path: &str, body: Value) -> (StatusCode, Value) {
        self.send("POST", path, body).await
    }

    /// Pushes a file unchanged.
    pub(crate) async fn upload(&self, path: &str, bytes: Vec<u8>) -> (StatusCode, Value) {
        let request = Request::post(path).header("content-type", "application/octet-stream");
        self.ask(request.body(Body::from(bytes)).unwrap()).await
    }

    /// A new session's id.
    pub(crate) async fn session(&self) -> String {
        let (status, session) = self.post("/v1/sessions", json!({"label": "rover"})).await;
        assert_eq!(status, StatusCode::CREATED, "{session}");
        session["session"].as_str().unwrap().to_owned()
    }
}

/// An epoch without an ephemeris: its answer has the status NONE and the reason.
pub(crate) fn epoch(seq: u64) -> Value {
    let observation = json!({"satellite": "G05", "code": "1C", "pseudorangeM": 22_000_000.0});
    let time = json!({"week": 2051, "nsOfWeek": 46_701_000_000_000_u64 + seq * 1_000_000_000});
    json!({"seq": seq, "time": time, "observations": [observation]})
}

pub(crate) fn code(answer: &Value) -> &str {
    answer["code"].as_str().unwrap_or("no code")
}
