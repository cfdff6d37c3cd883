//! The gRPC door, through the same router.

use axum::Router;
use graphfix::contract::v1;
use graphfix::grpc::v1::navigation_client::NavigationClient;
use graphfix::grpc::v1::positioning_client::PositioningClient;
use graphfix::grpc::v1::sessions_client::SessionsClient;
use graphfix::grpc::v1::solutions_client::SolutionsClient;
use prost::Message;
use tonic::Code;
use tonic::codec::CompressionEncoding;
use tonic_types::StatusExt;

use crate::support::doors::{Doors, epoch};
use crate::support::snapshot;

fn message(seq: u64) -> v1::Epoch {
    serde_json::from_value(epoch(seq)).unwrap()
}

async fn session(router: &Router) -> String {
    let request = v1::CreateSessionRequest::default();
    SessionsClient::new(router.clone()).create(request).await.unwrap().into_inner().session
}

#[tokio::test]
async fn what_is_pushed_is_listed() {
    let doors = Doors::open().await;
    let session = session(&doors.router).await;
    let epochs = vec![message(1), message(2)];
    let push = v1::PushEpochsRequest { session: session.clone(), epochs };
    let pushed = PositioningClient::new(doors.router.clone()).push_epochs(push).await.unwrap();
    let pushed = pushed.into_inner();
    assert_eq!(pushed.durable_through, Some(2));
    let list = v1::ListSolutionsRequest { session, ..Default::default() };
    let listed = SolutionsClient::new(doors.router.clone()).list(list).await.unwrap().into_inner();
    let pushed: Vec<_> =
        pushed.results.into_iter().map(|result| result.solution.unwrap()).collect();
    assert_eq!(listed.solutions, pushed);
}

/// Heads, series, residuals and explanations are the same by either door.
#[tokio::test]
async fn both_doors_show_the_same() {
    let doors = Doors::open().await;
    let session = session(&doors.router).await;
    let push =
        v1::PushEpochsRequest { session: session.clone(), epochs: vec![message(1), message(2)] };
    PositioningClient::new(doors.router.clone()).push_epochs(push).await.unwrap();
    let mut solutions = SolutionsClient::new(doors.router.clone());

    let mut sessions = SessionsClient::new(doors.router.clone());
    let heads = sessions.heads(v1::ListHeadsRequest::default()).await.unwrap().into_inner();
    let (_, by_rest) = doors.get("/v1/sessions:heads").await;
    assert_eq!(serde_json::json!(heads.heads[0].last_seq), by_rest["heads"][0]["lastSeq"]);

    let asked = v1::SolutionSeriesRequest { session: session.clone(), ..Default::default() };
    let series = solutions.series(asked).await.unwrap().into_inner();
    let path = format!("/v1/sessions/{session}/solutions:series");
    assert_eq!(serde_json::json!(series), doors.get(&path).await.1);

    let asked = v1::ResidualsRequest { session: session.clone(), ..Default::default() };
    let residuals = solutions.residuals(asked).await.unwrap().into_inner();
    assert_eq!(residuals.points.len(), 2);
    let path = format!("/v1/sessions/{session}/solutions:residuals");
    assert_eq!(serde_json::json!(residuals), doors.get(&path).await.1);

    let asked = v1::ExplainEpochRequest { session: session.clone(), seq: 0 };
    let explained = solutions.explain(asked).await.unwrap().into_inner();
    assert_eq!(explained.satellites[0].role, "NO_EPHEMERIS");
    let path = format!("/v1/sessions/{session}/epochs/2");
    assert_eq!(serde_json::json!(explained), doors.get(&path).await.1);
}

#[tokio::test]
async fn a_refusal_has_code_field_and_remedy() {
    let doors = Doors::open().await;
    let session = session(&doors.router).await;
    let mut wrong = message(1);
    wrong.observations[0].satellite = "X05".into();
    let push = v1::PushEpochsRequest { session, epochs: vec![wrong] };
    let status = PositioningClient::new(doors.router.clone()).push_epochs(push).await.unwrap_err();
    assert_eq!(status.code(), Code::InvalidArgument);
    let info = status.get_details_error_info().unwrap();
    assert_eq!(info.reason, "INVALID_SATELLITE");
    assert_eq!(info.metadata["field"], "epochs[0].observations[0].satellite");
    assert!(info.metadata["remedy"].contains("G05"));
}

/// A message beyond the limit is refused by its length; a packed one by its unpacked length.
#[tokio::test]
async fn a_message_too_large_is_refused_packed_and_plain() {
    let mut limits = graphfix::config::Limits::standard();
    limits.body_bytes = 10_000;
    let doors = Doors::with(limits).await;
    for packed in [false, true] {
        let mut client = NavigationClient::new(doors.router.clone());
        if packed {
            client = client.send_compressed(CompressionEncoding::Gzip);
        }
        let request = v1::PushNavigationRequest { content: vec![b' '; 1_000_000].into() };
        let status = client.push(request).await.unwrap_err();
        assert_eq!(status.code(), Code::InvalidArgument, "packed {packed}: {status}");
        let code = graphfix::grpc::code_of(&status);
        assert_eq!(code.as_deref(), Some("BODY_TOO_LARGE"), "packed {packed}");
    }
}

#[tokio::test]
async fn a_service_that_is_not_there_is_unimplemented() {
    let doors = Doors::open().await;
    let mut client = tonic::client::Grpc::new(doors.router.clone());
    let path = axum::http::uri::PathAndQuery::from_static("/graphfix.v1.Nothing/Do");
    let request = tonic::Request::new(v1::NavigationStatusRequest {});
    let codec = graphfix::grpc::Codec::<_, v1::NavigationStatusResponse>::default();
    let status = client.unary(request, path, codec).await.unwrap_err();
    assert_eq!(status.code(), Code::Unimplemented);
    assert_eq!(graphfix::grpc::code_of(&status).as_deref(), Some("ROUTE_NOT_FOUND"));
}

/// The schema by reflection: it must not change unnoticed, because clients were built against it.
#[test]
fn the_schema_is_a_snapshot() {
    let set = prost_types::FileDescriptorSet::decode(graphfix::grpc::DESCRIPTORS).unwrap();
    let mut text = String::new();
    for file in set.file.iter().filter(|file| file.package() == "graphfix.v1") {
        for service in &file.service {
            for method in &service.method {
                let (input, output) = (method.input_type(), method.output_type());
                text += &format!("{}.{} {input} {output}\n", service.name(), method.name());
            }
        }
        for message in &file.message_type {
            for field in &message.field {
                let kind = format!("{:?} {:?}", field.label(), field.r#type());
                let place = format!("{}.{}", message.name(), field.name());
                text += &format!("{place} = {} {kind} {}\n", field.number(), field.type_name());
            }
        }
        for choice in &file.enum_type {
            for value in &choice.value {
                text += &format!("{}.{} = {}\n", choice.name(), value.name(), value.number());
            }
        }
    }
    snapshot::assert("schema.txt", &text);
}
