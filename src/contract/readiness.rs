//! Whether the service can work now, and if not, why.

use std::collections::BTreeMap;
use std::time::Duration;

use serde::Serialize;
use tokio::time::timeout;

use crate::cluster::Cluster;
use crate::store::{CommitterHealth, CommitterState, DatabaseSetting, SettingRisk, Store};

use super::Service;
use super::refusal::{RETRY_AFTER, spread};

/// Longest time without a confirmation by the database. An idle committer probes every two seconds,
/// and a commit has a deadline of five.
const SILENCE_MAX: Duration = Duration::from_secs(10);
/// Longest time of a read; less than what those who ask for the readiness wait.
const READ_MAX: Duration = Duration::from_secs(2);

/// Whether the service can work now, and if not, why.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(rename_all = "camelCase")]
pub(crate) struct Readiness {
    /// Name of the node.
    pub node: String,
    /// Whether requests are accepted and epochs can be committed.
    pub ready: bool,
    /// The delay before another attempt makes sense (ms), at random; absent if ready.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub retry_after_ms: Option<u64>,
    /// What prevents it; empty if ready.
    pub problems: Vec<String>,
    /// What needs the operator's attention, although the service can work.
    pub warnings: Vec<String>,
    /// The service is about to stop.
    pub draining: bool,
    /// The database.
    pub database: DatabaseReadiness,
    /// The cluster; absent without one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub cluster: Option<ClusterReadiness>,
    /// States of sessions loaded from the database since the start.
    pub restores: u64,
    /// Epochs on which an estimator panicked, and chunks on which a decoder did, since the start.
    pub quarantined: u64,
}

/// The database's part of [`Readiness`].
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(rename_all = "camelCase")]
pub(crate) struct DatabaseReadiness {
    /// Time since the database last confirmed a commit or a probe (ms).
    pub confirmed_ms_ago: u64,
    /// Commits that failed since the start.
    pub failures: u64,
    /// Panics of the committer since the start.
    pub panics: u64,
    /// Bytes that the disk of the database file has left; absent for a server.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub free_bytes: Option<u64>,
    /// Settings on which durability and space depend, by name, as they were at the start.
    pub settings: BTreeMap<&'static str, String>,
    /// Settings with which a power failure may lose acknowledged data.
    pub unsafe_settings: Vec<&'static str>,
}

/// The cluster's part of [`Readiness`].
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(rename_all = "camelCase")]
pub(crate) struct ClusterReadiness {
    /// Names of the live nodes, as this one knows them.
    pub nodes: Vec<String>,
    /// Name of the leading node; absent while no node leads.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub leader: Option<String>,
    /// Number of this node's lease.
    pub lease: i64,
}

impl Service {
    /// Whether the service can do its work now. It reads from the database.
    pub(crate) async fn readiness(&self) -> Readiness {
        let store = self.sessions().store();
        let (health, counts) = (store.committer_health(), self.sessions().counts());
        let free_bytes = store.free_bytes();
        let draining = self.is_draining() || self.sessions().is_draining();
        let mut problems = Vec::new();
        if draining {
            problems.push("the service is about to stop".to_owned());
        }
        problems.extend(committer_problem(&health));
        let needed = self.limits().disk_free_min_bytes;
        if let Some(free) = free_bytes.filter(|free| *free < needed) {
            problems.push(format!("the database's disk has {free} bytes left of {needed} needed"));
        }
        // A database whose commits fail already is not asked: its answer may take long.
        if problems.is_empty() {
            problems.extend(read_problem(store).await);
        }
        let clock = self.sessions().clock_ahead().map(clock_warning);
        let clock = clock.or_else(|| self.sessions().clock_behind().map(late_clock_warning));
        let job_disk = self.jobs().free_bytes().filter(|free| *free < needed);
        let retry_after = (!problems.is_empty()).then(|| spread(RETRY_AFTER));
        Readiness {
            node: self.node().to_owned(),
            ready: problems.is_empty(),
            retry_after_ms: retry_after.map(|delay| delay.as_millis() as u64),
            problems,
            warnings: clock
                .into_iter()
                .chain(growth_warning(store))
                .chain(job_disk.map(|free| {
                    format!("the disk of the jobs' files has {free} bytes left of {needed} needed")
                }))
                .collect(),
            draining,
            database: database(store, &health, free_bytes),
            cluster: self.nodes().map(|nodes| cluster(&nodes.cluster, store)),
            restores: counts.restores(),
            quarantined: counts.quarantined(),
        }
    }
}

async fn read_problem(store: &Store) -> Option<String> {
    match timeout(READ_MAX, store.check_reads()).await {
        Ok(read) => read.err().map(|error| error.to_string()),
        Err(_) => Some(format!("the database answers no read within {} s", READ_MAX.as_secs())),
    }
}

fn committer_problem(health: &CommitterHealth) -> Option<String> {
    match &health.state {
        CommitterState::Failed { why } => Some(format!("commits fail: {why}")),
        CommitterState::Stopped => Some("the committer has stopped".to_owned()),
        CommitterState::LeaseLost { holder } => {
            Some(format!("node {holder} had the database meanwhile; this one must start again"))
        }
        CommitterState::Working if SILENCE_MAX < health.silence() => {
            let silence_s = health.silence().as_secs_f64();
            Some(format!("the database has confirmed nothing for {silence_s:.1} s"))
        }
        CommitterState::Working => None,
    }
}

fn cluster(cluster: &Cluster, store: &Store) -> ClusterReadiness {
    ClusterReadiness {
        nodes: cluster.nodes().into_iter().map(|node| node.name).collect(),
        leader: cluster.leader().map(|node| node.name),
        lease: store.fence().unwrap_or_default(),
    }
}

fn clock_warning(ahead: Duration) -> String {
    let days = ahead.as_secs_f64() / 86_400.0;
    format!(
        "the clock is {days:.1} days ahead of what is stored; check it. Epochs are kept for longer \
         by as much until a device sends present ones"
    )
}

fn late_clock_warning(behind: Duration) -> String {
    let days = behind.as_secs_f64() / 86_400.0;
    format!(
        "the clock is {days:.1} days behind what is stored; set it. Until then what arrives is \
         stored with the time of the last expiry"
    )
}

/// Warns of a database that grows for ever.
fn growth_warning(store: &Store) -> Option<String> {
    let grows = |setting: &&DatabaseSetting| setting.risk == Some(SettingRisk::Growth);
    let DatabaseSetting { name, value, .. } = store.settings().iter().find(grows)?;
    Some(format!("{name} of the database is {value}: {}", SettingRisk::Growth.words()))
}

fn database(store: &Store, health: &CommitterHealth, free_bytes: Option<u64>) -> DatabaseReadiness {
    let settings = store.settings();
    let is_unsafe = |setting: &&DatabaseSetting| setting.risk == Some(SettingRisk::PowerFailure);
    DatabaseReadiness {
        confirmed_ms_ago: health.silence().as_millis() as u64,
        failures: health.failures,
        panics: health.panics,
        free_bytes,
        settings: settings.iter().map(|setting| (setting.name, setting.value.clone())).collect(),
        unsafe_settings: settings.iter().filter(is_unsafe).map(|setting| setting.name).collect(),
    }
}
