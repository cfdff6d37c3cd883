//! Meters of the service for Prometheus: every meter, with its name.
//!
//! `docs/operations.md` lists the names with their meaning for an operator.

use std::borrow::Cow;
use std::sync::atomic::AtomicU64;

use prometheus_client::encoding::text::{encode, encode_registry};
use prometheus_client::metrics::counter::ConstCounter;
use prometheus_client::metrics::gauge::ConstGauge;
use prometheus_client::metrics::info::Info;
use prometheus_client::registry::{Registry, Unit};

use crate::aiding::bases::BaseId;
use crate::cluster::ClusterMeters;
use crate::meters::{Family, Gauge, Label, Usage};
use crate::quotas::Meter;
use crate::store::CommitterState;

use super::Service;

/// States of streams of casters, as the API names them.
const FEED_STATES: [&str; 3] = ["CONNECTING", "STREAMING", "WAITING"];

/// A gauge with a value for each tenant.
type OfTenants = Family<[(&'static str, String); 1], Gauge<f64, AtomicU64>>;
/// The use of a quota by a tenant, if it is known, and the quota, if there is one.
type Budget = fn(&Meter) -> (Option<f64>, Option<f64>);

/// The quotas that meters of tenants measure.
const BUDGETS: [(&str, &str, Budget); 5] = [
    ("tenant_epochs_per_second", "Epochs a second of a tenant, over ten seconds", |meter| {
        (Some(meter.rates().epochs_per_s), meter.quotas().epochs_per_s)
    }),
    ("tenant_cpu_seconds_per_minute", "Time of solvers for a tenant in a minute", |meter| {
        (Some(meter.rates().cpu_s_per_minute), meter.quotas().cpu_s_per_minute)
    }),
    ("tenant_sessions", "Sessions of a tenant, if it has a quota of what is stored", |meter| {
        let number = |sessions: u64| sessions as f64;
        (meter.stored().map(|stored| number(stored.sessions)), meter.quotas().sessions.map(number))
    }),
    ("tenant_stored_bytes", "Bytes of a tenant, if it has a quota of what is stored", |meter| {
        let number = |bytes: u64| bytes as f64;
        let stored = meter.stored().map(|stored| number(stored.stored_bytes));
        (stored, meter.quotas().stored_bytes.map(number))
    }),
    ("tenant_job_bytes", "Bytes of files of a tenant's jobs, if it has a quota of them", |meter| {
        let number = |bytes: u64| bytes as f64;
        (meter.job_bytes().map(number), meter.quotas().job_bytes.map(number))
    }),
];

/// The page of meters while it is written.
struct Page(Registry);

impl Page {
    fn gauge(&mut self, name: &str, help: &str, value: f64) {
        self.0.register(name, help, ConstGauge::new(value));
    }

    fn bytes(&mut self, name: &str, help: &str, value: u64) {
        self.0.register_with_unit(name, help, Unit::Bytes, ConstGauge::new(value as f64));
    }

    fn counter(&mut self, name: &str, help: &str, value: u64) {
        self.0.register(name, help, ConstCounter::new(value));
    }
}

impl Service {
    /// The page of all meters, in the text format of OpenMetrics 1.0.
    pub(crate) async fn metrics(&self) -> String {
        let labels = [(Cow::from("node"), Cow::from(self.node().to_owned()))];
        let mut page = Page(Registry::with_prefix_and_labels("graphfix", labels.into_iter()));
        let build = Info::new([("version", env!("CARGO_PKG_VERSION"))]);
        page.0.register("build", "Version of the service", build);
        self.write_sessions(&mut page);
        self.write_store(&mut page);
        self.write_requests(&mut page);
        self.write_tenants(&mut page);
        self.write_aiding(&mut page).await;
        let mut text = String::new();
        encode_registry(&mut text, &process()).expect("a string takes any text");
        encode(&mut text, &page.0).expect("a string takes any text");
        text
    }

    fn write_sessions(&self, page: &mut Page) {
        let counts = self.sessions().counts();
        let meters = counts.meters();
        let registry = &mut page.0;
        let epochs = "Committed epochs by the status of their first answer";
        registry.register("epochs", epochs, meters.epochs.clone());
        registry.register("epochs_refused", "Refused epochs", meters.refused.clone());
        let restores = "Sessions with epochs loaded from the database";
        registry.register("restores", restores, meters.restores.clone());
        let quarantined =
            "Epochs on which an estimator failed, and chunks on which a decoder failed";
        registry.register("epochs_quarantined", quarantined, meters.quarantined.clone());
        let help = "Time of a batch of epochs in each stage";
        registry.register_with_unit("stage", help, Unit::Seconds, meters.stages.clone());
        let in_memory = counts.in_memory() as f64;
        page.gauge("sessions_in_memory", "Sessions with an estimator in memory", in_memory);
        let waiting = counts.waiting() as f64;
        page.gauge("epochs_waiting", "Epochs in all mailboxes", waiting);
        let limit = self.limits().waiting_epochs as f64;
        page.gauge("epochs_waiting_limit", "Epochs that may be in all mailboxes", limit);
    }

    fn write_store(&self, page: &mut Page) {
        let store = self.sessions().store();
        let (meters, health) = (store.committer_meters(), store.committer_health());
        let registry = &mut page.0;
        registry.register("commits", "Committed transactions", meters.transactions.clone());
        let seconds = "Time of a transaction";
        registry.register_with_unit("commit", seconds, Unit::Seconds, meters.seconds.clone());
        registry.register("commit_epochs", "Epochs of a transaction", meters.epochs.clone());
        let bytes = "Bytes of epochs, solutions, states and raw pieces in transactions";
        registry.register_with_unit("committed", bytes, Unit::Bytes, meters.bytes.clone());
        page.counter("commit_failures", "Failed transactions", health.failures);
        page.counter("committer_panics", "Panics of the committer", health.panics);
        let is_working = f64::from(health.state == CommitterState::Working);
        page.gauge("committer_working", "1 while commits work, otherwise 0", is_working);
        let batches = store.waiting_batches() as f64;
        page.gauge("commit_batches_waiting", "Batches that wait for a transaction", batches);
        if let Some(free) = store.free_bytes() {
            page.bytes("database_disk_free", "Space left on the database's disk", free);
        }
        if let Some(free) = self.jobs().free_bytes() {
            page.bytes("jobs_disk_free", "Space left on the disk of the jobs' files", free);
        }
    }

    fn write_requests(&self, page: &mut Page) {
        let meters = self.meters();
        let registry = &mut page.0;
        registry.register("requests", "Requests by door and outcome", meters.requests.clone());
        let seconds = "Time from a request to the head of its answer";
        registry.register_with_unit("request", seconds, Unit::Seconds, meters.seconds.clone());
        let failures = self.budget().failures().clone();
        registry.register("failures", "Failures that were logged", failures);
        registry.register("connections", "Open connections", meters.connections.clone());
        let (received, bytes) = (self.budget().arrived().clone(), "Bytes of bodies of requests");
        registry.register_with_unit("received", bytes, Unit::Bytes, received);
        let tls = self.tls().map(|tls| tls.meters().clone()).unwrap_or_default();
        let help = "End of the certificate (Unix time), 0 without TLS";
        let expiry = tls.expiry_s.clone();
        registry.register_with_unit("tls_certificate_expiry", help, Unit::Seconds, expiry);
        let help = "End of the first list of revoked certificates to expire (Unix time)";
        let expiry = tls.list_expiry_s.clone();
        registry.register_with_unit("tls_revocation_list_expiry", help, Unit::Seconds, expiry);
        let help = "1 while invalid files prevent the renewal of the certificate, otherwise 0";
        registry.register("tls_renewal_failed", help, tls.renewal_failed.clone());
        let help = "TLS handshakes that failed";
        registry.register("tls_handshakes_failed", help, tls.failed_handshakes.clone());
        if let Some(nodes) = self.nodes() {
            write_cluster(page, nodes.cluster.meters());
        }
        let (streams, watches) = self.open_streams();
        page.gauge("streams", "Open streams of devices", streams as f64);
        page.gauge("watches", "Open watches of solutions", watches as f64);
        let used = self.budget().used() as u64;
        page.bytes("request_memory", "Memory that all requests have reserved", used);
        let total = self.budget().total() as u64;
        page.bytes("request_memory_limit", "Memory that all requests may reserve", total);
        let traces = self.tracer().map(|tracer| tracer.meters().clone()).unwrap_or_default();
        let help = "Spans of traces that the collector has taken";
        page.0.register("trace_spans_exported", help, traces.exported);
        let help = "Spans of traces that were dropped, as the collector has not taken them";
        page.0.register("trace_spans_dropped", help, traces.dropped);
        let is_draining = f64::from(self.is_draining());
        page.gauge("draining", "1 while the service is about to stop, otherwise 0", is_draining);
    }

    /// Writes what tenants use of their quotas, as their meters know it, and the quotas.
    fn write_tenants(&self, page: &mut Page) {
        let meters = self.sessions().meters().all();
        for (name, help, budget) in BUDGETS {
            let (used, limit) = <(OfTenants, OfTenants)>::default();
            for meter in &meters {
                let tenant = [("tenant", meter.tenant().name().to_owned())];
                let (amount, quota) = budget(meter);
                for (family, value) in [(&used, amount), (&limit, quota)] {
                    if let Some(value) = value {
                        family.get_or_create(&tenant).set(value);
                    }
                }
            }
            page.0.register(name, help, used);
            page.0.register(format!("{name}_limit"), format!("Quota: {help}"), limit);
        }
    }

    async fn write_aiding(&self, page: &mut Page) {
        let bases = self.bases().list().await;
        let states: Vec<_> = bases
            .iter()
            .filter_map(|base| self.feeds().health(&BaseId::parse(&base.name.id)?))
            .map(|health| health.state.name())
            .collect();
        let streams = Family::<Label, Gauge>::default();
        for state in FEED_STATES {
            let count = states.iter().filter(|of_base| **of_base == state).count();
            streams.get_or_create(&[("state", state)]).set(count as i64);
        }
        page.0.register("caster_streams", "Streams of casters by state", streams);
        page.gauge("bases", "Base stations", bases.len() as f64);
        let ephemerides = self.navigation().status().ephemerides as f64;
        page.gauge("ephemerides", "Ephemerides in force", ephemerides);
    }
}

fn write_cluster(Page(registry): &mut Page, meters: &ClusterMeters) {
    let help = "Live nodes of the cluster, as this one knows them";
    registry.register("cluster_nodes", help, meters.nodes.clone());
    let help = "1 while this node leads the cluster, otherwise 0";
    registry.register("cluster_leads", help, meters.is_leader.clone());
    let help = "Leases of other nodes that this one has ended";
    registry.register("cluster_ended_leases", help, meters.ended_leases.clone());
    let help = "Requests sent on to another node";
    registry.register("cluster_forwarded", help, meters.forwarded.clone());
    let help = "Requests sent on that the other node has not answered";
    registry.register("cluster_unanswered", help, meters.unanswered.clone());
}

/// Meters of the process, under the names that all Prometheus clients use.
fn process() -> Registry {
    let usage = Usage::now();
    let mut registry = Registry::with_prefix("process");
    if let Some(seconds) = usage.processor_s {
        let help = "Processor time of user and system";
        registry.register_with_unit("cpu", help, Unit::Seconds, ConstCounter::new(seconds));
    }
    if let Some(bytes) = usage.resident_bytes {
        let gauge = ConstGauge::new(bytes);
        registry.register_with_unit("resident_memory", "Resident memory", Unit::Bytes, gauge);
    }
    if let Some(files) = usage.open_files {
        registry.register("open_fds", "Open file descriptors", ConstGauge::new(files));
    }
    registry
}
