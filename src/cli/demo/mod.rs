//! `graphfix demo`: the service, a simulated fleet and its positions, in one command.

mod fleet;
mod table;

use std::io::IsTerminal;
use std::sync::Arc;
use std::time::Duration;

use clap::{Args, value_parser};
use tokio::net::TcpListener;
use tokio::sync::{mpsc, oneshot};

use crate::app;
use crate::config::ServiceConfiguration;
use crate::feeds::{FeedOptions, TimeLimits};
use crate::formats::rinex::write_navigation;
use crate::refusal::Code;
use crate::simulation::{self, Scenario};

use self::fleet::{Report, Sky};
use self::table::Table;
use super::Failure;
use super::device::Connection;
use super::host;

/// The port that is tried first.
const PORT: u16 = 8080;

/// Starts the service on this machine, simulates a fleet, sends its observations over gRPC and
/// shows the errors of the positions; then serves until interrupted. Nothing is kept.
#[derive(Clone, Debug, Args)]
pub(super) struct DemoArguments {
    /// Devices, alternately under open sky and among high buildings.
    #[arg(long, value_name = "N", default_value_t = 6)]
    #[arg(value_parser = value_parser!(u16).range(1..=100))]
    devices: u16,
    /// Simulated seconds, one epoch each.
    #[arg(long, value_name = "SECONDS", default_value_t = 120)]
    #[arg(value_parser = value_parser!(u32).range(1..=3600))]
    duration: u32,
    /// Speed as a multiple of real time.
    #[arg(long, value_name = "FACTOR", default_value_t = 4)]
    #[arg(value_parser = value_parser!(u32).range(1..=1000))]
    speed: u32,
    /// Seed of the simulated errors.
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// Exit after the summary.
    #[arg(long)]
    exit: bool,
}

/// Runs the demo.
///
/// # Errors
/// There is no free port or no temporary folder, or the service fails.
pub(super) fn run(arguments: DemoArguments) -> Result<(), Failure> {
    host::block_on(demo(arguments))
}

async fn demo(arguments: DemoArguments) -> Result<(), Failure> {
    let folder = TemporaryFolder::create()?;
    let database = format!("sqlite://{}", folder.0.join("demo.db").display());
    let listener = listener().await?;
    let address = listener.local_addr().map_err(|error| no_port(&error))?;
    let configuration = ServiceConfiguration { database, ..ServiceConfiguration::standard() };
    let opened = app::open(&configuration, TimeLimits::standard(), FeedOptions::standard());
    let app = opened.await?;
    let (stop, stopped) = oneshot::channel::<()>();
    // Err: the demo failed and dropped the sender, which also stops the service.
    let serving = tokio::spawn(app.serve(listener, async { drop(stopped.await) }));
    println!("serving gRPC and REST at http://{address}/ (open it: /docs explains every call)");

    let server = format!("http://{address}");
    let played = tokio::select! {
        played = play(&arguments, &server) => played,
        () = host::interrupted() => Ok(()),
    };
    if played.is_ok() && !arguments.exit {
        println!("still serving at http://{address}/v1/sessions; interrupt to end");
        host::interrupted().await;
    }
    drop(stop);
    serving.await.map_err(|panic| Failure::new(Code::Internal, panic, "report this"))?;
    played
}

/// Drives the fleet and shows its errors.
async fn play(arguments: &DemoArguments, server: &str) -> Result<(), Failure> {
    let duration_s = f64::from(arguments.duration);
    let open = Scenario { duration_s, base: None, ..Scenario::open_sky() };
    let navigation = Arc::new(simulation::navigation(&open));
    let mut rinex = Vec::new();
    write_navigation(&mut rinex, &navigation)
        .map_err(|error| Failure::new(Code::Internal, error, "report this"))?;
    let connection = Connection::to(server, Duration::from_secs(10))?;
    let ephemerides = connection.push_navigation_bytes(rinex.into()).await?;
    println!("pushed {ephemerides} simulated ephemerides; {} devices set off", arguments.devices);

    let (reports, mut inbox) = mpsc::channel::<Report>(1024);
    let mut fleet = tokio::task::JoinSet::new();
    for index in 0..arguments.devices {
        let sky = if index % 2 == 0 { Sky::Open } else { Sky::Urban };
        let device = fleet::Plan {
            index: usize::from(index),
            sky,
            seed: arguments.seed + u64::from(index),
            duration_s,
            speed: f64::from(arguments.speed),
        };
        let (navigation, reports) = (navigation.clone(), reports.clone());
        fleet.spawn(fleet::drive(device, navigation, connection.clone(), reports));
    }
    drop(reports);
    let live = std::io::stdout().is_terminal();
    let mut table = Table::new(usize::from(arguments.devices), arguments.duration, live);
    while let Some(report) = inbox.recv().await {
        table.take(report);
    }
    while let Some(driven) = fleet.join_next().await {
        driven.map_err(|panic| Failure::new(Code::Internal, panic, "report this"))??;
    }
    table.summarise();
    Ok(())
}

/// The standard port, or a free one if it is in use.
async fn listener() -> Result<TcpListener, Failure> {
    match TcpListener::bind(("127.0.0.1", PORT)).await {
        Ok(listener) => Ok(listener),
        Err(_) => TcpListener::bind("127.0.0.1:0").await.map_err(|error| no_port(&error)),
    }
}

fn no_port(error: &std::io::Error) -> Failure {
    Failure::of(Code::AddressUnavailable, error)
}

/// A folder that is removed when dropped.
struct TemporaryFolder(std::path::PathBuf);

impl TemporaryFolder {
    fn create() -> Result<Self, Failure> {
        let name = format!("graphfix-demo-{}", uuid::Uuid::new_v4().simple());
        let path = std::env::temp_dir().join(name);
        std::fs::create_dir(&path).map_err(|error| {
            let message = format!("{}: {error}", path.display());
            Failure::new(
                Code::FileNotWritable,
                message,
                "set TMPDIR to a folder that can be written",
            )
        })?;
        Ok(Self(path))
    }
}

impl Drop for TemporaryFolder {
    fn drop(&mut self) {
        // Err: the system removes old files of the temporary folder.
        std::fs::remove_dir_all(&self.0).ok();
    }
}
