//! Puts load on a running service. Each device has its own connection, and pushes one epoch or one
//! chunk of a receiver's bytes a call. Prints the rate, the delays, and the processor time of the
//! service for each durable epoch.
//!
//! `cargo run --release --example service_cost -- --server URL --pid PID [--devices 64]
//! [--seconds 15] [--interval-ms 0] [--raw FILE.ubx]`
//!
//! `scripts/cost` starts services on both stores and runs this program.

use std::fs;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

use clap::Parser;
use graphfix::config::{Mode, PositioningOptions, Profile};
use graphfix::contract::{convert, v1};
use graphfix::formats::rinex::write_navigation;
use graphfix::gnss::{Constellation, Epoch};
use graphfix::grpc::v1::navigation_client::NavigationClient;
use graphfix::grpc::v1::positioning_client::PositioningClient;
use graphfix::grpc::v1::sessions_client::SessionsClient;
use graphfix::positioning::{Aiding, Estimator};
use graphfix::simulation::{Scenario, Simulator};
use tonic::transport::{Channel, Endpoint};

/// Epochs that are simulated; a device that has sent them all begins another session.
const EPOCHS: usize = 2_000;
/// Sync characters, class and id of UBX-RXM-RAWX, the measurements of one epoch.
const RAWX: [u8; 4] = [0xb5, 0x62, 0x02, 0x15];
/// Length of a UBX frame without its payload.
const FRAME_BYTES: usize = 8;
/// Clock ticks of `/proc` (1/s); Linux fixes it for all user programs.
const TICKS_PER_S: f64 = 100.0;

type Failure = Box<dyn std::error::Error + Send + Sync>;

#[derive(Clone, Debug, Parser)]
struct Arguments {
    /// Address of the service
    #[arg(long)]
    server: String,
    /// Process of the service
    #[arg(long)]
    pid: u32,
    /// Devices, each with a session and a connection
    #[arg(long, default_value_t = 64)]
    devices: usize,
    /// Duration that is measured (s)
    #[arg(long, default_value_t = 15.0)]
    seconds: f64,
    /// Duration before that (s)
    #[arg(long, default_value_t = 3.0)]
    warm_up: f64,
    /// Interval between the epochs of a device (ms); 0: as fast as they are answered
    #[arg(long, default_value_t = 0)]
    interval_ms: u64,
    /// Estimator of the sessions
    #[arg(long, default_value = "spp")]
    mode: String,
    /// Sends the bytes of this receiver (UBX), one epoch a piece
    #[arg(long)]
    raw: Option<String>,
}

/// The data that devices send.
enum Load {
    Epochs(Vec<v1::Epoch>),
    Pieces(Vec<bytes::Bytes>),
}

#[derive(Default)]
struct Counts {
    acknowledged: AtomicU64,
    calls: AtomicU64,
    is_measuring: AtomicBool,
    is_over: AtomicBool,
}

#[tokio::main]
async fn main() -> ExitCode {
    match run(Arguments::parse()).await {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("{error}");
            ExitCode::FAILURE
        }
    }
}

async fn run(arguments: Arguments) -> Result<(), Failure> {
    // A receiver of GPS and Galileo on two frequencies: some 36 observations an epoch.
    let constellations = vec![Constellation::Gps, Constellation::Galileo];
    let scenario = Scenario { duration_s: EPOCHS as f64, constellations, ..Scenario::open_sky() };
    let receiver = Simulator::new(scenario, 1);
    let navigation = receiver.navigation().clone();
    let mut file = Vec::new();
    write_navigation(&mut file, &navigation)?;
    let channel = connected(&arguments.server).await?;
    let request = v1::PushNavigationRequest { content: file.into() };
    NavigationClient::new(channel).push(request).await?;
    let load = match &arguments.raw {
        Some(path) => Load::Pieces(pieces(&fs::read(path)?)),
        None => {
            let epochs: Vec<Epoch> = receiver.take(EPOCHS).map(|epoch| epoch.rover).collect();
            let mode = Mode::from_name(&arguments.mode).ok_or("unknown mode")?;
            print_solver_alone(&epochs, &navigation, mode);
            let message = |(seq, epoch)| convert::epoch_message(seq, epoch);
            Load::Epochs((1..).zip(&epochs).map(message).collect())
        }
    };
    let (load, counts) = (Arc::new(load), Arc::new(Counts::default()));
    let mut devices = Vec::new();
    for index in 0..arguments.devices {
        let device =
            Device::open(&arguments, index, Arc::clone(&load), Arc::clone(&counts)).await?;
        devices.push(tokio::spawn(device.run()));
    }
    tokio::time::sleep(Duration::from_secs_f64(arguments.warm_up)).await;
    let before = Usage::of(arguments.pid)?;
    counts.is_measuring.store(true, Ordering::Release);
    let from = [&counts.acknowledged, &counts.calls].map(|count| count.load(Ordering::Acquire));
    let begun = Instant::now();
    tokio::time::sleep(Duration::from_secs_f64(arguments.seconds)).await;
    let to = [&counts.acknowledged, &counts.calls].map(|count| count.load(Ordering::Acquire));
    let elapsed_s = begun.elapsed().as_secs_f64();
    let after = Usage::of(arguments.pid)?;
    counts.is_over.store(true, Ordering::Release);
    let mut delays_ms = Vec::new();
    for device in devices {
        delays_ms.extend(device.await??);
    }
    delays_ms.sort_by(f64::total_cmp);
    let at = |share: f64| delays_ms[((delays_ms.len() - 1) as f64 * share) as usize];
    let [epochs, calls] = [0, 1].map(|index| (to[index] - from[index]) as f64);
    let per = |after: f64, before: f64| 1e6 * (after - before) / epochs;
    println!(
        "{} devices: {:.0} epochs/s in {:.0} calls/s, {:.1} µs of CPU an epoch ({:.1} user, {:.1} \
         system), {:.2} switches, delay p50 {:.1} p99 {:.1} ms",
        arguments.devices,
        epochs / elapsed_s,
        calls / elapsed_s,
        per(after.user_s, before.user_s) + per(after.system_s, before.system_s),
        per(after.user_s, before.user_s),
        per(after.system_s, before.system_s),
        (after.switches - before.switches) as f64 / epochs,
        at(0.5),
        at(0.99),
    );
    Ok(())
}

async fn connected(server: &str) -> Result<Channel, Failure> {
    let endpoint = Endpoint::from_shared(server.to_owned())?.tcp_nodelay(true);
    Ok(endpoint.connect().await?)
}

/// Prints what processor time the estimator alone needs for the same epochs.
fn print_solver_alone(epochs: &[Epoch], navigation: &graphfix::gnss::Navigation, mode: Mode) {
    let mut estimator = Estimator::new(PositioningOptions::new(mode, Profile::General));
    let begun = thread_time();
    for epoch in epochs {
        estimator.advance(epoch, &Aiding { navigation, base: None });
    }
    let each_us = 1e6 * (thread_time() - begun).as_secs_f64() / epochs.len() as f64;
    let observations: usize = epochs.iter().map(|epoch| epoch.observations.len()).sum();
    let mean = observations as f64 / epochs.len() as f64;
    println!("the estimator alone: {each_us:.1} µs an epoch of {mean:.1} observations");
}

/// The processor time that this thread has used. The clock would also count other work.
fn thread_time() -> Duration {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
    Duration::try_from(time).expect("a thread has used no negative time")
}

/// The bytes of a receiver in chunks that end with the measurements of an epoch.
fn pieces(bytes: &[u8]) -> Vec<bytes::Bytes> {
    let mut pieces = Vec::new();
    let (mut start, mut at) = (0, 0);
    while let Some(frame) = bytes.get(at..at + FRAME_BYTES) {
        if !frame.starts_with(&RAWX) {
            at += 1;
            continue;
        }
        at += FRAME_BYTES + usize::from(u16::from_le_bytes([frame[4], frame[5]]));
        let end = at.min(bytes.len());
        pieces.push(bytes::Bytes::copy_from_slice(&bytes[start..end]));
        start = end;
    }
    pieces
}

/// A device. It sends each epoch or chunk after the answer to the previous one.
struct Device {
    channel: Channel,
    session: String,
    arguments: Arguments,
    index: usize,
    load: Arc<Load>,
    counts: Arc<Counts>,
}

impl Device {
    async fn open(
        arguments: &Arguments,
        index: usize,
        load: Arc<Load>,
        counts: Arc<Counts>,
    ) -> Result<Self, Failure> {
        let channel = connected(&arguments.server).await?;
        let (session, arguments) = (String::new(), arguments.clone());
        let mut device = Self { channel, session, arguments, index, load, counts };
        device.begin().await?;
        Ok(device)
    }

    /// Begins another session.
    async fn begin(&mut self) -> Result<(), Failure> {
        let mode = self.arguments.mode.clone();
        let request = v1::CreateSessionRequest { mode, ..Default::default() };
        let mut client = SessionsClient::new(self.channel.clone());
        self.session = client.create(request).await?.into_inner().session;
        Ok(())
    }

    /// Sends until the measurement ends. Returns the measured delays (ms).
    async fn run(mut self) -> Result<Vec<f64>, Failure> {
        let interval = Duration::from_millis(self.arguments.interval_ms);
        let mut client = PositioningClient::new(self.channel.clone());
        let mut delays_ms = Vec::new();
        tokio::time::sleep(interval.mul_f64(self.index as f64 / self.arguments.devices as f64))
            .await;
        let (mut next, mut offset) = (0, 0);
        while !self.counts.is_over.load(Ordering::Acquire) {
            if next == self.count() {
                self.begin().await?;
                (next, offset) = (0, 0);
            }
            let begun = Instant::now();
            let acknowledged = self.push(&mut client, next, &mut offset).await?;
            next += 1;
            self.counts.acknowledged.fetch_add(acknowledged, Ordering::AcqRel);
            self.counts.calls.fetch_add(1, Ordering::AcqRel);
            if self.counts.is_measuring.load(Ordering::Acquire) {
                delays_ms.push(1e3 * begun.elapsed().as_secs_f64());
            }
            tokio::time::sleep_until((begun + interval).into()).await;
        }
        Ok(delays_ms)
    }

    fn count(&self) -> usize {
        match &*self.load {
            Load::Epochs(epochs) => epochs.len(),
            Load::Pieces(pieces) => pieces.len(),
        }
    }

    /// Sends the next epoch or chunk. Returns the number of durable solutions.
    async fn push(
        &self,
        client: &mut PositioningClient<Channel>,
        next: usize,
        offset: &mut u64,
    ) -> Result<u64, Failure> {
        let session = self.session.clone();
        let results = match &*self.load {
            Load::Epochs(epochs) => {
                let request = v1::PushEpochsRequest { session, epochs: vec![epochs[next].clone()] };
                client.push_epochs(request).await?.into_inner().results
            }
            Load::Pieces(pieces) => {
                let content = pieces[next].clone();
                let request =
                    v1::PushRawRequest { session, offset: *offset, content, ..Default::default() };
                *offset += pieces[next].len() as u64;
                client.push_raw(request).await?.into_inner().results
            }
        };
        if let Some(refusal) = results.iter().find_map(|result| result.refusal.as_ref()) {
            return Err(format!("{}: {}", refusal.code, refusal.message).into());
        }
        Ok(results.len() as u64)
    }
}

/// What a process has used since its start.
struct Usage {
    user_s: f64,
    system_s: f64,
    /// Times that its threads have waited.
    switches: u64,
}

impl Usage {
    fn of(pid: u32) -> Result<Self, Failure> {
        let stat = fs::read_to_string(format!("/proc/{pid}/stat"))?;
        // The name before the last parenthesis may have spaces; utime and stime are fields 14, 15.
        let (_, after) = stat.rsplit_once(')').ok_or("no name in stat")?;
        let mut fields = after.split_whitespace().skip(11).map(str::parse::<f64>);
        let mut ticks = || fields.next().ok_or("too few fields in stat");
        let (user_s, system_s) = (ticks()?? / TICKS_PER_S, ticks()?? / TICKS_PER_S);
        let mut switches = 0;
        for thread in fs::read_dir(format!("/proc/{pid}/task"))? {
            // Err: the thread has ended.
            let Ok(status) = fs::read_to_string(thread?.path().join("status")) else { continue };
            let line = status.lines().find_map(|l| l.strip_prefix("voluntary_ctxt_switches:"));
            switches += line.ok_or("no switches in status")?.trim().parse::<u64>()?;
        }
        Ok(Self { user_s, system_s, switches })
    }
}
