//! `graphfix load`: many simulated devices on a running service, each with a stream of its own.

mod device;
mod report;
mod schedule;
mod traffic;
mod verification;

use std::num::NonZeroUsize;
use std::sync::Arc;
use std::time::Duration;

use clap::{Args, value_parser};
use tokio::task::JoinSet;
use tokio::time::Instant;

use crate::config::Mode;
use crate::contract::v1;
use crate::meters::Usage;
use crate::refusal::Code;

use self::device::{Device, Sent};
use self::report::Report;
use self::schedule::{Beginning, Schedule};
use self::traffic::Traffic;
use super::Failure;
use super::connection::Connection;
use super::host;
use super::trust::TrustArguments;
use crate::cli::output::note;

/// Streams of one connection; the service allows some more, which the other calls use.
const STREAMS_PER_CONNECTION: usize = 100;
/// Sessions that are created, opened or verified at the same time.
const AT_ONCE: usize = 32;

/// Sends the epochs of many simulated devices to a service, and checks every acknowledgement in its
/// store.
///
/// Each device has a session and a stream, which it opens again after a break. They begin when all
/// streams are open. A delay runs from when an epoch is due to its acknowledgement, so a service
/// that falls behind shows in the delays. All devices observe one simulated drive, each from
/// another second of it on.
#[derive(Clone, Debug, Args)]
pub(super) struct LoadArguments {
    /// The service; https:// for TLS.
    #[arg(long, value_name = "URL", default_value = "http://127.0.0.1:8080")]
    server: String,
    /// Key of the service, with the rights device, read and operate.
    #[arg(long, value_name = "KEY", env = "GRAPHFIX_KEY", hide_env_values = true)]
    key: Option<String>,
    #[command(flatten)]
    trust: TrustArguments,
    /// Number of devices.
    #[arg(long, value_name = "N")]
    #[arg(value_parser = value_parser!(u32).range(1..=100_000))]
    devices: u32,
    /// Epochs of each device in a second.
    #[arg(long, value_name = "HZ", default_value_t = 1.0, value_parser = rate)]
    rate: f64,
    /// Estimator of the sessions. For a mode relative to a base, a base is created and filled.
    #[arg(long, value_name = "MODE", default_value = "fgo", value_parser = mode)]
    mode: Mode,
    /// Profile of the sessions.
    #[arg(long, value_name = "NAME", default_value = "general")]
    profile: String,
    /// Duration (s).
    #[arg(long, value_name = "SECONDS", default_value_t = 60)]
    #[arg(value_parser = value_parser!(u32).range(1..=86_400))]
    duration: u32,
    /// Sends the bytes of a u-blox receiver (UBX-RXM-RAWX) instead of epochs.
    #[arg(long)]
    raw: bool,
    /// Devices with one band, as cheap receivers have, instead of two.
    #[arg(long)]
    one_band: bool,
    /// Connections, which the devices share. Default: one for each 100 devices.
    #[arg(long, value_name = "N")]
    connections: Option<NonZeroUsize>,
    /// Duration of the attempts to reach a service that does not answer (s).
    #[arg(long, value_name = "SECONDS", default_value_t = 60)]
    patience: u64,
    /// Process of the service on this machine, whose processor time for an epoch is reported.
    #[arg(long, value_name = "PID")]
    pid: Option<u32>,
    /// Prints the result as JSON.
    #[arg(long)]
    json: bool,
}

/// Parses a rate.
fn rate(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(rate) if (0.001..=1000.0).contains(&rate) => Ok(rate),
        _ => Err("not a number from 0.001 to 1000".to_owned()),
    }
}

/// Parses a mode.
fn mode(text: &str) -> Result<Mode, String> {
    Mode::parse(text).map_err(|error| error.to_string())
}

/// Runs the load.
///
/// # Errors
/// The service cannot be reached, refuses a session, or has lost or doubled an epoch.
pub(super) fn run(arguments: LoadArguments) -> Result<(), Failure> {
    host::block_on(load(arguments))
}

async fn load(arguments: LoadArguments) -> Result<(), Failure> {
    let connections = connections(&arguments)?;
    let schedule = Schedule::new(arguments.rate, arguments.duration);
    let content = (arguments.raw, arguments.one_band);
    let traffic = Arc::new(Traffic::simulate(arguments.mode, content, schedule)?);
    note!("{}", traffic.description());
    let base = traffic.prepare(&connections[0]).await?;
    let new = v1::CreateSessionRequest {
        label: "load".to_owned(),
        mode: arguments.mode.name().to_owned(),
        profile: arguments.profile.clone(),
        base,
        ..Default::default()
    };
    if let Some(pid) = arguments.pid.filter(|pid| Usage::of(&pid.to_string()).processor_s.is_none())
    {
        let message = format!("--pid {pid}: /proc has no such process");
        return Err(Failure::of(Code::Usage, message));
    }
    let devices = created(&arguments, &connections, &new).await?;
    note!("{} sessions created", devices.len());
    let (opening, beginning) = (Instant::now(), Arc::new(Beginning::new(devices.len(), AT_ONCE)));
    let mut running = JoinSet::new();
    for device in devices {
        running.spawn(device.run(Arc::clone(&traffic), schedule, Arc::clone(&beginning)));
    }
    let begin = beginning.at().await;
    let opened = opening.elapsed();
    note!("streams open after {:.1} s", opened.as_secs_f64());
    let used = || Usage::of(&arguments.pid?.to_string()).processor_s;
    let used_before = used();
    let sent: Vec<Sent> = running.join_all().await;
    let elapsed = begin.elapsed();
    let processor_s = used().zip(used_before).map(|(after, before)| after - before);
    let verified = verification::verify(sent, &connections).await?;
    let report =
        Report::new(&arguments, (opened, elapsed), verified).with_processor_time(processor_s);
    report.print(arguments.json);
    report.check()
}

fn connections(arguments: &LoadArguments) -> Result<Vec<Connection>, Failure> {
    let devices = arguments.devices as usize;
    let count = arguments.connections.map_or(devices.div_ceil(STREAMS_PER_CONNECTION), usize::from);
    if count * STREAMS_PER_CONNECTION < devices {
        let message = format!("{devices} devices do not fit on {count} connections");
        let remedy = format!("a connection carries {STREAMS_PER_CONNECTION} streams");
        return Err(Failure::new(Code::Usage, message, remedy));
    }
    let patience = Duration::from_secs(arguments.patience);
    let LoadArguments { server, key, trust, .. } = arguments;
    (0..count).map(|_| Connection::to(server, key.as_deref(), trust, patience)).collect()
}

/// Creates the sessions.
async fn created(
    arguments: &LoadArguments,
    connections: &[Connection],
    new: &v1::CreateSessionRequest,
) -> Result<Vec<Device>, Failure> {
    let (mut devices, mut creating) = (Vec::new(), JoinSet::new());
    for index in 0..arguments.devices as usize {
        let (connection, new) = (connections[index % connections.len()].clone(), new.clone());
        creating.spawn(async move {
            let session = connection.session(None, new).await?.session;
            Ok::<_, Failure>(Device { index, session, connection })
        });
        if AT_ONCE <= creating.len() {
            devices.extend(creating.join_next().await);
        }
    }
    devices.extend(creating.join_all().await.into_iter().map(Ok));
    devices.into_iter().map(|device| device.expect("no device panics")).collect()
}
