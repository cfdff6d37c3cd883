//! For every call the requests with which a tenant could try to reach what belongs to another.
//!
//! A call without a case fails the test, so that no new call is forgotten.

use axum::body::Body;
use axum::http::Request;
use graphfix::contract::access::Call;
use graphfix::contract::v1;
use graphfix::contract::v1::create_job_request::Content;
use graphfix::formats::rinex::write_navigation;
use graphfix::gnss::{Ephemeris, KeplerianEphemeris, Navigation};
use graphfix::grpc::longrunning::{GetOperationRequest, ListOperationsRequest};
use prost::Message;
use serde_json::{Value, json};

use crate::support::doors::epoch;
use crate::support::drive::DRIVE;
use crate::support::jobs::{BOUNDARY, MINUTE, body};

/// Ids of objects that another tenant has, or that do not exist.
#[derive(Clone, Debug)]
pub(in crate::doors) struct Things {
    pub(super) session: String,
    pub(super) base: String,
    pub(super) job: String,
    pub(super) upload: String,
    pub(super) key: String,
    pub(super) tenant: String,
    /// The name of a request.
    pub(super) request: String,
}

impl Things {
    /// A text in which each of these ids is replaced by the kind of its object.
    pub(super) fn hidden(&self, text: &str) -> String {
        let Self { session, base, job, upload, key, tenant, .. } = self;
        let ids = [
            (session, "SESSION"),
            (base, "BASE"),
            (job, "JOB"),
            (upload, "UPLOAD"),
            (key, "KEY"),
            (tenant, "TENANT"),
        ];
        ids.iter().fold(text.to_owned(), |text, (id, name)| text.replace(&**id, name))
    }
}

/// How a call could reach data of tenants.
pub(super) enum Case {
    /// Its answer is the same for everybody: nothing in it is stored.
    Open,
    /// The requests that name such objects, or that could show them.
    Requests(Vec<Request<Body>>),
}

/// A request of a gRPC method with these messages. The method is of this service's package, unless
/// its name has another one.
fn grpc(method: &str, messages: &[Vec<u8>]) -> Request<Body> {
    let mut content = Vec::new();
    for message in messages {
        content.push(0);
        content.extend_from_slice(&(message.len() as u32).to_be_bytes());
        content.extend_from_slice(message);
    }
    let path = match method.starts_with('/') {
        true => method.to_owned(),
        false => format!("/graphfix.v1.{method}"),
    };
    let request = Request::post(path);
    let request = request.header("content-type", "application/grpc").header("te", "trailers");
    request.body(Body::from(content)).unwrap()
}

/// A message of the schema, written as JSON.
fn message<M: Message + serde::de::DeserializeOwned>(json: Value) -> Vec<u8> {
    serde_json::from_value::<M>(json).unwrap().encode_to_vec()
}

fn rest(method: &str, path: &str, json: &Value) -> Request<Body> {
    let request = Request::builder().method(method).uri(path);
    let request = request.header("content-type", "application/json");
    let content = if json.is_null() { String::new() } else { json.to_string() };
    request.body(Body::from(content)).unwrap()
}

fn octets(path: &str, content: &[u8]) -> Request<Body> {
    let request = Request::post(path).header("content-type", "application/octet-stream");
    request.body(Body::from(content.to_vec())).unwrap()
}

/// The same request by gRPC with `$json`, and by REST with `$body`, which lacks the fields of the
/// path.
macro_rules! both {
    ($call:expr, $message:ty, $path:expr, $json:expr, $body:expr) => {{
        let method = $call.rest.split(' ').next().unwrap();
        vec![grpc($call.grpc, &[message::<$message>($json)]), rest(method, &$path, &$body)]
    }};
}

/// The requests of a call that name these objects.
///
/// # Panics
/// The call has no case: say here how it could reach what belongs to another tenant.
pub(super) fn case(call: &Call, of: &Things) -> Case {
    let name = if call.grpc.is_empty() { call.rest } else { call.grpc };
    let service = name.split('/').next().unwrap_or_default();
    let requests = match service {
        "Sessions" => sessions(call, of),
        "Positioning" => positioning(call, of),
        "Solutions" => solutions(call, of),
        "History" => history(call, of),
        "Bases" => bases(call, of),
        "Jobs" => jobs(call, of),
        "Keys" => keys(call, of),
        "Navigation" => navigation(call),
        "Tenants" => tenants(call, of),
        "Audit" => audit(call, of),
        _ => return others(call, of),
    };
    Case::Requests(requests.unwrap_or_else(|| panic!("no case for {name}")))
}

fn sessions(call: &Call, of: &Things) -> Option<Vec<Request<Body>>> {
    let (session, base) = (&of.session, &of.base);
    let path = format!("/v1/sessions/{session}");
    let named = json!({"session": session});
    let none = Value::Null;
    Some(match call.grpc {
        "Sessions/Create" => {
            let named = json!({"requestId": of.request});
            let relative = json!({"mode": "rtk-fgo", "base": base});
            [relative, json!({"mode": "rtk-fgo", "bases": [base]}), named]
                .into_iter()
                .flat_map(|new| {
                    both!(call, v1::CreateSessionRequest, "/v1/sessions", new.clone(), new)
                })
                .collect()
        }
        "Sessions/Get" => both!(call, v1::GetSessionRequest, path, named, none),
        "Sessions/List" | "Sessions/Heads" => {
            let path = call.rest.split(' ').nth(1)?;
            let behind = json!({"pageToken": session});
            let mut requests = both!(call, v1::ListSessionsRequest, path, json!({}), none);
            let path = format!("{path}?pageToken={session}");
            requests.extend(both!(call, v1::ListSessionsRequest, path, behind, none));
            requests
        }
        "Sessions/WatchHeads" => {
            both!(call, v1::WatchHeadsRequest, "/v1/sessions:watch", json!({}), none)
        }
        "Sessions/Update" => {
            let change = json!({"session": session, "label": "changed"});
            let mut requests = both!(call, v1::UpdateSessionRequest, path, change.clone(), change);
            let change = json!({"session": session, "mode": "rtk-fgo", "base": base});
            requests.extend(both!(call, v1::UpdateSessionRequest, path, change.clone(), change));
            requests
        }
        "Sessions/Reset" => {
            both!(call, v1::ResetSessionRequest, format!("{path}:reset"), named, json!({}))
        }
        "Sessions/Close" => both!(call, v1::CloseSessionRequest, path, named, none),
        "Sessions/Observations" => {
            let session = session.clone();
            let request = v1::SessionObservationsRequest { session, ..Default::default() };
            let path = format!("{path}/observations.rnx");
            vec![grpc(call.grpc, &[request.encode_to_vec()]), rest("GET", &path, &none)]
        }
        "Sessions/Delete" => {
            both!(call, v1::DeleteSessionRequest, format!("{path}?purge=true"), named, none)
        }
        _ => return None,
    })
}

fn positioning(call: &Call, of: &Things) -> Option<Vec<Request<Body>>> {
    let (session, base) = (&of.session, &of.base);
    let path = format!("/v1/sessions/{session}");
    Some(match call.grpc {
        "Positioning/PushEpochs" => {
            let push = json!({"session": session, "epochs": [epoch(1000)]});
            both!(call, v1::PushEpochsRequest, format!("{path}/epochs"), push.clone(), push)
        }
        "Positioning/PushRaw" => {
            let push = v1::PushRawRequest {
                session: session.clone(),
                content: vec![0xb5, 0x62].into(),
                ..Default::default()
            };
            let empty = v1::PushRawRequest { session: session.clone(), ..Default::default() };
            vec![
                grpc(call.grpc, &[push.encode_to_vec()]),
                grpc(call.grpc, &[empty.encode_to_vec()]),
                octets(&format!("{path}/raw?offset=0"), &[0xb5, 0x62]),
            ]
        }
        "Positioning/Stream" => {
            let opening = |last_acknowledged| v1::StreamRequest {
                opening: Some(v1::StreamOpening {
                    session: session.clone(),
                    last_acknowledged,
                    ..Default::default()
                }),
                ..Default::default()
            };
            let epoch: v1::Epoch = serde_json::from_value(epoch(1001)).unwrap();
            let epochs = v1::StreamRequest { epochs: vec![epoch], ..Default::default() };
            let encoded = |message: v1::StreamRequest| message.encode_to_vec();
            vec![
                grpc(call.grpc, &[encoded(opening(None)), encoded(epochs)]),
                grpc(call.grpc, &[encoded(opening(Some(1)))]),
            ]
        }
        "Positioning/StreamRaw" => {
            let opening = v1::StreamRawOpening { session: session.clone(), ..Default::default() };
            let opening = v1::StreamRawRequest { opening: Some(opening), ..Default::default() };
            vec![grpc(call.grpc, &[opening.encode_to_vec()])]
        }
        "Positioning/Solve" => {
            let solve = json!({"session": session, "mode": "spp"});
            both!(call, v1::SolveRequest, format!("{path}:solve"), solve.clone(), solve)
        }
        "Positioning/SolveOnce" => {
            let solve = json!({"mode": "rtk-fgo", "base": base, "epochs": [epoch(1)]});
            let mut requests = both!(call, v1::SolveOnceRequest, "/v1/solve", solve.clone(), solve);
            // The nearest base must not be that of another tenant.
            let solve = json!({"mode": "rtk-fgo", "base": "nearest", "epochs": [epoch(1)]});
            requests.extend(both!(call, v1::SolveOnceRequest, "/v1/solve", solve.clone(), solve));
            requests
        }
        _ => return None,
    })
}

fn solutions(call: &Call, of: &Things) -> Option<Vec<Request<Body>>> {
    let session = &of.session;
    let path = format!("/v1/sessions/{session}");
    let named = json!({"session": session});
    let none = Value::Null;
    Some(match call.grpc {
        "Solutions/List" => {
            both!(call, v1::ListSolutionsRequest, format!("{path}/solutions"), named, none)
        }
        "Solutions/Watch" => {
            let all = json!({"session": session, "afterSeq": 0});
            let path = format!("{path}/solutions:watch?afterSeq=0");
            both!(call, v1::WatchSolutionsRequest, path, all, none)
        }
        "Solutions/Track" => {
            let (session, format) = (session.clone(), "csv".to_owned());
            let track = v1::TrackRequest { session, format, ..Default::default() };
            let path = format!("{path}/track.csv");
            vec![grpc(call.grpc, &[track.encode_to_vec()]), rest("GET", &path, &none)]
        }
        "Solutions/Series" => {
            both!(call, v1::SolutionSeriesRequest, format!("{path}/solutions:series"), named, none)
        }
        "Solutions/Residuals" => {
            both!(call, v1::ResidualsRequest, format!("{path}/solutions:residuals"), named, none)
        }
        "Solutions/Explain" => {
            let epoch = json!({"session": session, "seq": 1});
            both!(call, v1::ExplainEpochRequest, format!("{path}/epochs/1"), epoch, none)
        }
        _ => return None,
    })
}

fn history(call: &Call, of: &Things) -> Option<Vec<Request<Body>>> {
    let none = Value::Null;
    // The epochs are in this week.
    let at = |second: u64| json!({"week": 2051, "nsOfWeek": second * 1_000_000_000});
    let (from, to, query) = (at(0), at(604_799), "from=2051:0&to=2051:604799");
    Some(match call.grpc {
        "History/Fleet" => {
            let asked = json!({"from": from, "to": to});
            let path = format!("/v1/history/fleet?{query}");
            both!(call, v1::FleetHistoryRequest, path, asked, none)
        }
        "History/Sessions" => {
            let asked = json!({"from": from, "to": to});
            let path = format!("/v1/history/sessions?{query}");
            let mut requests = both!(call, v1::ListSessionHistoriesRequest, path, asked, none);
            let behind = json!({"pageToken": of.session});
            let path = format!("/v1/history/sessions?pageToken={}", of.session);
            requests.extend(both!(call, v1::ListSessionHistoriesRequest, path, behind, none));
            requests
        }
        "History/Session" => {
            let named = json!({"session": of.session});
            let path = format!("/v1/history/sessions/{}", of.session);
            both!(call, v1::SessionHistoryRequest, path, named, none)
        }
        _ => return None,
    })
}

fn bases(call: &Call, of: &Things) -> Option<Vec<Request<Body>>> {
    let base = &of.base;
    let path = format!("/v1/bases/{base}");
    let named = json!({"base": base});
    let none = Value::Null;
    Some(match call.grpc {
        "Bases/Create" => {
            let new = json!({"label": "own", "requestId": of.request});
            both!(call, v1::CreateBaseRequest, "/v1/bases", new.clone(), new)
        }
        "Bases/List" => both!(call, v1::ListBasesRequest, "/v1/bases", json!({}), none),
        "Bases/Get" => both!(call, v1::GetBaseRequest, path, named, none),
        "Bases/Delete" => both!(call, v1::DeleteBaseRequest, path, named, none),
        "Bases/PushEpochs" => {
            let push = json!({"base": base, "epochs": [epoch(5)]});
            both!(call, v1::PushBaseEpochsRequest, format!("{path}/epochs"), push.clone(), push)
        }
        "Bases/Upload" => {
            let content = MINUTE.base.clone();
            let upload = v1::UploadBaseRequest { base: base.clone(), content: content.into() };
            vec![
                grpc(call.grpc, &[upload.encode_to_vec()]),
                octets(&format!("{path}/observations"), &MINUTE.base),
            ]
        }
        _ => return None,
    })
}

fn jobs(call: &Call, of: &Things) -> Option<Vec<Request<Body>>> {
    let job = &of.job;
    let path = format!("/v1/jobs/{job}");
    let named = json!({"job": job});
    let none = Value::Null;
    Some(match call.grpc {
        "Jobs/Create" => {
            let over = [
                json!({"session": of.session}),
                json!({"session": of.session, "bases": [of.base]}),
            ];
            let over = over.into_iter().flat_map(|options| session_job(call, options));
            let files = [posted_job(&of.request), streamed_job(call, &of.request)];
            files.into_iter().chain(over).collect()
        }
        "Jobs/Get" => both!(call, v1::GetJobRequest, path, named, none),
        "Jobs/List" => {
            let mut requests = both!(call, v1::ListJobsRequest, "/v1/jobs", json!({}), none);
            let path = format!("/v1/jobs?pageToken={job}");
            requests.extend(both!(
                call,
                v1::ListJobsRequest,
                path,
                json!({"pageToken": job}),
                none
            ));
            requests
        }
        "Jobs/Watch" => both!(call, v1::GetJobRequest, format!("{path}/events"), named, none),
        "Jobs/Cancel" => both!(call, v1::CancelJobRequest, path, named, none),
        "Jobs/Delete" => {
            both!(call, v1::DeleteJobRequest, format!("{path}?purge=true"), named, none)
        }
        "Jobs/Report" => both!(call, v1::GetJobRequest, format!("{path}/report"), named, none),
        "Jobs/Deliveries" => {
            both!(call, v1::GetJobRequest, format!("{path}/deliveries"), named, none)
        }
        "Jobs/Result" => both!(call, v1::GetJobRequest, format!("{path}/result"), named, none),
        _ => return None,
    })
}

/// The upload of a job under the name of a request.
pub(super) fn posted_job(request: &str) -> Request<Body> {
    let parts: [(&str, &[u8]); 3] = [
        ("rover", &MINUTE.rover),
        ("navigation", &MINUTE.navigation),
        ("options", br#"{"mode": "fgo"}"#),
    ];
    let kind = format!("multipart/form-data; boundary={BOUNDARY}");
    let post = Request::post("/v1/jobs").header("content-type", kind);
    post.header("idempotency-key", request).body(Body::from(body(&parts))).unwrap()
}

/// A job without files, by both doors.
fn session_job(call: &Call, options: Value) -> [Request<Body>; 2] {
    let kind = format!("multipart/form-data; boundary={BOUNDARY}");
    let post = Request::post("/v1/jobs").header("content-type", kind);
    let parts = body(&[("options", options.to_string().as_bytes())]);
    let content = Content::Options(serde_json::from_value(options).unwrap());
    let create = v1::CreateJobRequest { content: Some(content) }.encode_to_vec();
    [post.body(Body::from(parts)).unwrap(), grpc(call.grpc, &[create])]
}

fn streamed_job(call: &Call, request: &str) -> Request<Body> {
    let part = |part: &str| {
        Content::Part(v1::JobPart { part: part.to_owned(), name: "a.file".to_owned() })
    };
    let contents = [
        Content::IdempotencyKey(request.to_owned()),
        part("rover"),
        Content::Chunk(MINUTE.rover.clone()),
        part("navigation"),
        Content::Chunk(MINUTE.navigation.clone()),
    ];
    let message =
        |content: Content| v1::CreateJobRequest { content: Some(content) }.encode_to_vec();
    grpc(call.grpc, &contents.map(message))
}

fn keys(call: &Call, of: &Things) -> Option<Vec<Request<Body>>> {
    let (key, tenant) = (&of.key, &of.tenant);
    let none = Value::Null;
    Some(match call.grpc {
        "Keys/Create" => {
            let new = json!({"rights": ["read"], "tenant": tenant});
            both!(call, v1::CreateKeyRequest, "/v1/keys", new.clone(), new)
        }
        "Keys/List" => {
            let mut requests = both!(call, v1::ListKeysRequest, "/v1/keys", json!({}), none);
            for (field, value) in [("pageToken", key), ("tenant", tenant)] {
                let path = format!("/v1/keys?{field}={value}");
                requests.extend(both!(
                    call,
                    v1::ListKeysRequest,
                    path,
                    json!({field: value}),
                    none
                ));
            }
            requests
        }
        "Keys/Get" => {
            both!(call, v1::GetKeyRequest, format!("/v1/keys/{key}"), json!({"key": key}), none)
        }
        "Keys/Revoke" => {
            both!(call, v1::RevokeKeyRequest, format!("/v1/keys/{key}"), json!({"key": key}), none)
        }
        _ => return None,
    })
}

fn tenants(call: &Call, of: &Things) -> Option<Vec<Request<Body>>> {
    let named = json!({"tenant": of.tenant});
    let path = format!("/v1/tenants/{}", of.tenant);
    Some(match call.grpc {
        "Tenants/Get" => both!(call, v1::GetTenantRequest, path, named, Value::Null),
        "Tenants/List" => {
            both!(call, v1::ListTenantsRequest, "/v1/tenants", json!({}), Value::Null)
        }
        "Tenants/Set" => {
            let set = json!({"tenant": of.tenant, "quotas": {"sessions": 0}});
            both!(call, v1::SetTenantRequest, path, set.clone(), set)
        }
        _ => return None,
    })
}

fn audit(call: &Call, of: &Things) -> Option<Vec<Request<Body>>> {
    let none = Value::Null;
    let mut requests = both!(call, v1::ListAuditRequest, "/v1/audit", json!({}), none);
    let Things { session, base, key, tenant, .. } = of;
    for (field, value) in [
        ("tenant", tenant),
        ("actor", key),
        ("object", session),
        ("object", base),
        ("object", tenant),
        ("pageToken", key),
    ] {
        let path = format!("/v1/audit?{field}={value}");
        requests.extend(both!(call, v1::ListAuditRequest, path, json!({field: value}), none));
    }
    Some(requests)
}

fn navigation(call: &Call) -> Option<Vec<Request<Body>>> {
    Some(match call.grpc {
        "Navigation/Push" => {
            let content = other_broadcast();
            let push = v1::PushNavigationRequest { content: content.clone().into() };
            vec![grpc(call.grpc, &[push.encode_to_vec()]), octets("/v1/navigation", &content)]
        }
        "Navigation/Status" => {
            both!(call, v1::NavigationStatusRequest, "/v1/navigation", json!({}), Value::Null)
        }
        _ => return None,
    })
}

/// Navigation data that agree with no data of another tenant.
fn other_broadcast() -> Vec<u8> {
    let mut other = Navigation::default();
    for ephemeris in DRIVE.navigation.satellites().flat_map(|(_, list)| list) {
        if let Ephemeris::Keplerian(orbit) = ephemeris {
            let orbit = KeplerianEphemeris { m0_rad: orbit.m0_rad + 1e-4, ..orbit.clone() };
            other.insert(Ephemeris::Keplerian(orbit));
        }
    }
    let mut file = Vec::new();
    write_navigation(&mut file, &other).unwrap();
    file
}

/// A request of the protocol tus, for the first bytes of a file.
fn tus(method: &str, path: &str) -> Request<Body> {
    let request = Request::builder().method(method).uri(path).header("tus-resumable", "1.0.0");
    let request = request.header("upload-length", "7").header("upload-offset", "0");
    let request = request.header("content-type", "application/offset+octet-stream");
    request.body(Body::from(if method == "PATCH" { "content" } else { "" })).unwrap()
}

/// Calls of one door, and pages.
fn others(call: &Call, of: &Things) -> Case {
    let name = if call.grpc.is_empty() { call.rest } else { call.grpc };
    match name {
        "/google.longrunning.Operations/ListOperations" => {
            let token = ListOperationsRequest { page_token: of.job.clone(), ..Default::default() };
            let requests = [ListOperationsRequest::default(), token];
            Case::Requests(requests.map(|list| grpc(name, &[list.encode_to_vec()])).into())
        }
        // All have one field, the id.
        _ if name.starts_with("/google.longrunning.Operations/") => {
            let named = GetOperationRequest { name: of.job.clone() };
            Case::Requests(vec![grpc(name, &[named.encode_to_vec()])])
        }
        "POST /v1/uploads" => Case::Requests(vec![tus("POST", "/v1/uploads")]),
        "GET /v1/uploads/{upload}"
        | "PATCH /v1/uploads/{upload}"
        | "DELETE /v1/uploads/{upload}" => {
            let method = call.rest.split(' ').next().unwrap();
            Case::Requests(vec![tus(method, &format!("/v1/uploads/{}", of.upload))])
        }
        "OPTIONS /v1/uploads" => Case::Open,
        "GET /v1/sign-in" | "POST /v1/sign-in" | "DELETE /v1/sign-in" | "GET /metrics" => {
            let (method, path) = call.rest.split_once(' ').unwrap();
            Case::Requests(vec![rest(method, path, &Value::Null)])
        }
        "GET /healthz"
        | "GET /readyz"
        | "GET /openapi.json"
        | "GET /docs"
        | "GET /docs/"
        | "GET /docs/{file}"
        | "GET /"
        | "GET /licences.txt"
        | "GET /assets/{file}"
        | "/grpc.health.v1.Health/Check"
        | "/grpc.health.v1.Health/Watch"
        | "/grpc.reflection.v1.ServerReflection/ServerReflectionInfo"
        | "/grpc.reflection.v1alpha.ServerReflection/ServerReflectionInfo" => Case::Open,
        _ => panic!("no case for {name}"),
    }
}
