//! The services of this door as routes of the shared port.

use std::panic::AssertUnwindSafe;
use std::time::Duration;

use axum::Router;
use axum::extract::{Request, State};
use axum::middleware::{self, Next};
use axum::response::Response;
use futures::FutureExt;
use tokio::time::timeout;
use tonic::service::Routes;
use tonic_health::ServingStatus;
use tonic_health::server::HealthReporter;

use crate::contract::Service;

use super::admission::MessageLimits;
use super::longrunning::operations_server::OperationsServer;
use super::v1::audit_server::AuditServer;
use super::v1::bases_server::BasesServer;
use super::v1::history_server::HistoryServer;
use super::v1::jobs_server::JobsServer;
use super::v1::keys_server::KeysServer;
use super::v1::navigation_server::NavigationServer;
use super::v1::positioning_server::PositioningServer;
use super::v1::sessions_server::SessionsServer;
use super::v1::solutions_server::SolutionsServer;
use super::v1::tenants_server::TenantsServer;
use super::{DESCRIPTORS, Door, admission, frame};

/// Interval at which the service's readiness is checked.
const HEALTH_INTERVAL: Duration = Duration::from_secs(1);

/// All services, health and reflection, without a fallback, which the shared router has.
///
/// # Panics
/// Outside a tokio runtime, because a task reports the service's readiness as gRPC health.
pub(crate) fn routes(service: &Service) -> Router {
    let limit = service.limits().body_bytes;
    let limits = MessageLimits { of_call: limit, of_stream: service.limits().stream_bytes };
    let door = Door(service.clone());
    let (health, health_service) = tonic_health::server::health_reporter();
    tokio::spawn(report_health(service.clone(), health));
    let reflection = || {
        tonic_reflection::server::Builder::configure()
            .register_encoded_file_descriptor_set(DESCRIPTORS)
            .register_encoded_file_descriptor_set(tonic_health::pb::FILE_DESCRIPTOR_SET)
    };
    let v1 = reflection().build_v1().expect("the descriptors are protox's");
    let v1alpha = reflection().build_v1alpha().expect("the descriptors are protox's");
    macro_rules! limited {
        ($server:ident) => {
            $server::new(door.clone())
                .max_decoding_message_size(limit)
                .max_encoding_message_size(usize::MAX)
                .send_compressed(tonic::codec::CompressionEncoding::Gzip)
        };
    }
    Routes::new(health_service)
        .add_service(v1)
        .add_service(v1alpha)
        .add_service(limited!(SessionsServer))
        .add_service(limited!(PositioningServer))
        .add_service(limited!(SolutionsServer))
        .add_service(limited!(NavigationServer))
        .add_service(limited!(BasesServer))
        .add_service(limited!(JobsServer))
        .add_service(limited!(OperationsServer))
        .add_service(limited!(KeysServer))
        .add_service(limited!(TenantsServer))
        .add_service(limited!(AuditServer))
        .add_service(limited!(HistoryServer))
        .into_axum_router()
        .reset_fallback()
        .layer(middleware::from_fn_with_state(limits, serve))
}

/// Serves a request. Refusals of tonic and panics become refusals with a code. This is one layer,
/// because each layer costs an allocation or two for each request.
async fn serve(State(limits): State<MessageLimits>, request: Request, next: Next) -> Response {
    let served = AssertUnwindSafe(admission::admit(limits, request, next)).catch_unwind().await;
    frame::explain(served.unwrap_or_else(frame::panicked))
}

/// Reports each second whether the services and the server are serving, until the service drains.
async fn report_health(service: Service, health: HealthReporter) {
    const NAMES: [&str; 11] = [
        "",
        "graphfix.v1.Sessions",
        "graphfix.v1.Positioning",
        "graphfix.v1.Solutions",
        "graphfix.v1.Navigation",
        "graphfix.v1.Bases",
        "graphfix.v1.Jobs",
        "google.longrunning.Operations",
        "graphfix.v1.Keys",
        "graphfix.v1.Tenants",
        "graphfix.v1.Audit",
    ];
    let report = async |status| {
        for name in NAMES {
            health.set_service_status(name, status).await;
        }
    };
    let mut drained = std::pin::pin!(service.drained());
    loop {
        let ready = service.readiness().await.ready;
        report(if ready { ServingStatus::Serving } else { ServingStatus::NotServing }).await;
        if timeout(HEALTH_INTERVAL, &mut drained).await.is_ok() {
            return report(ServingStatus::NotServing).await;
        }
    }
}
