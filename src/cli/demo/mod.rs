//! `graphfix demo`: the service, a simulated fleet and its positions, in one command.

mod fleet;
mod survey;
mod table;

use std::io::IsTerminal;
use std::sync::Arc;
use std::time::{Duration, SystemTime};

use clap::{Args, value_parser};
use tokio::net::TcpListener;
use tokio::sync::{mpsc, oneshot};

use crate::app;
use crate::config::ServiceConfiguration;
use crate::feeds::{FeedOptions, TimeLimits};
use crate::formats::rinex::write_navigation;
use crate::gnss::{GpsTime, LeapSeconds};
use crate::refusal::Code;
use crate::simulation::{self, Scenario};

use self::fleet::Report;
use self::table::Table;
use super::Failure;
use super::connection::Connection;
use super::host;
use super::trust::TrustArguments;
use crate::cli::output::say;

/// The port that is tried first.
const PORT: u16 = 8080;
/// Duration for which the fleet drives on in real time (s).
const LIVE_S: f64 = 6.0 * 3600.0;

/// Starts the service on this machine, simulates a fleet with base stations, sends its observations
/// over gRPC and shows the errors of the positions; then the fleet drives on in real time until
/// interrupted. The dashboard shows it all the while. Nothing is kept.
#[derive(Clone, Debug, Args)]
pub(super) struct DemoArguments {
    /// Devices: relative to a base and without, under open sky and among high buildings; the sixth
    /// falls silent on the way.
    #[arg(long, value_name = "N", default_value_t = 6)]
    #[arg(value_parser = value_parser!(u16).range(1..=100))]
    devices: u16,
    /// Simulated seconds until the summary, one epoch each.
    #[arg(long, value_name = "SECONDS", default_value_t = 300)]
    #[arg(value_parser = value_parser!(u32).range(1..=3600))]
    duration: u32,
    /// Speed until the summary, as a multiple of real time.
    #[arg(long, value_name = "FACTOR", default_value_t = 10)]
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
    say!("the dashboard is at http://{address}/ (gRPC and REST too: /docs explains every call)");

    let server = format!("http://{address}");
    let played = tokio::select! {
        played = play(&arguments, &server) => played,
        () = host::interrupted() => Ok(()),
    };
    drop(stop);
    serving.await.map_err(|panic| Failure::new(Code::Internal, panic, "report this"))??;
    played
}

/// Drives the fleet and shows its errors. Then the fleet drives on until interrupted, or exits.
async fn play(arguments: &DemoArguments, server: &str) -> Result<(), Failure> {
    let trust = TrustArguments::default();
    let connection = Connection::to(server, None, &trust, Duration::from_secs(10))?;
    let start = start(arguments);
    let live_s = if arguments.exit { 0.0 } else { LIVE_S };
    let duration_s = f64::from(arguments.duration);
    let sky = Scenario { start, duration_s: duration_s + live_s, ..Scenario::open_sky() };
    let navigation = Arc::new(simulation::navigation(&sky));
    let mut rinex = Vec::new();
    write_navigation(&mut rinex, &navigation)
        .map_err(|error| Failure::new(Code::Internal, error, "report this"))?;
    let ephemerides = connection.push_navigation_bytes(rinex.into()).await?;
    say!("pushed {ephemerides} simulated ephemerides; {} devices set off", arguments.devices);

    // The computation of this batch job gives way to that of the fleet's epochs.
    let survey = (!arguments.exit).then(|| {
        let (connection, navigation) = (connection.clone(), navigation.clone());
        tokio::spawn(survey::submit(connection, start, arguments.seed, navigation))
    });
    let (reports, mut inbox) = mpsc::channel::<Report>(1024);
    let mut fleet = tokio::task::JoinSet::new();
    for index in 0..usize::from(arguments.devices) {
        let (seed, speed) = (arguments.seed + index as u64, f64::from(arguments.speed));
        let plan = fleet::Plan { index, seed, start, duration_s, live_s, speed };
        let (navigation, reports) = (navigation.clone(), reports.clone());
        fleet.spawn(fleet::drive(plan, navigation, connection.clone(), reports));
    }
    drop(reports);
    let live = std::io::stdout().is_terminal();
    let mut table = Table::new(usize::from(arguments.devices), live);
    while let Some(report) = inbox.recv().await {
        table.take(report);
    }
    table.summarise();
    if let Some(survey) = survey {
        let job = survey.await.map_err(|panic| Failure::new(Code::Internal, panic, "report this"));
        say!("a recording as a batch job: {server}/#/jobs/{}", job??);
        say!("the fleet drives on: see {server}/; interrupt to end");
    }
    while let Some(driven) = fleet.join_next().await {
        driven.map_err(|panic| Failure::new(Code::Internal, panic, "report this"))??;
    }
    if !arguments.exit {
        say!("the drive is over; still serving at {server}/; interrupt to end");
        host::interrupted().await;
    }
    Ok(())
}

/// Time tag of the first epoch. It makes the epochs reach the present at the summary.
fn start(arguments: &DemoArguments) -> GpsTime {
    let since_1970 = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
    let unix_ms = i64::try_from(since_1970.as_secs() * 1000).unwrap_or(0);
    let (duration_s, speed) = (f64::from(arguments.duration), f64::from(arguments.speed));
    let behind_s = (duration_s - duration_s / speed).floor();
    GpsTime::from_unix_ms(unix_ms, &LeapSeconds::table()) + -behind_s
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
