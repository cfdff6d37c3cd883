//! `graphfix stream`: sends a file to a service as a device does.

use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};
use std::time::Duration;

use clap::Args;

use tokio::time::Instant;

use crate::contract::{convert, v1};
use crate::formats::decompress;
use crate::formats::observations::{FileError, FileFormat, Observations, Recognised};
use crate::gnss::{Epoch, GpsTime, Navigation};
use crate::refusal::Code;

use super::Failure;
use super::cargo::{Epochs, RawBytes};
use super::connection::Connection;
use super::device_stream::DeviceStream;
use super::files::{self, StartTime};
use super::host;
use super::output::{note, say};
use super::progress::{Progress, Speed, parse_speed};
use super::stream_raw::Bytestream;
use super::trust::TrustArguments;

/// Epochs of one message at full speed.
const BATCH: usize = 16;

/// Sends observations to a service as a device does, also across restarts of the service.
#[derive(Clone, Debug, Args)]
pub(super) struct StreamArguments {
    /// Observations, plain or gzip. The epochs of RINEX and CRINEX are numbered from 1; the bytes
    /// of a receiver (UBX, RTCM 3) and of an Android GnssLogger log are sent unchanged.
    #[arg(long, value_name = "FILE")]
    rover: PathBuf,
    /// The service; https:// for TLS.
    #[arg(long, value_name = "URL", default_value = "http://127.0.0.1:8080")]
    server: String,
    /// Key of the service, with the right device. In the environment other users of this machine do
    /// not see it.
    #[arg(long, value_name = "KEY", env = "GRAPHFIX_KEY", hide_env_values = true)]
    key: Option<String>,
    #[command(flatten)]
    trust: TrustArguments,
    /// Navigation files to push first; the key then needs the right operate, too.
    #[arg(long, value_name = "FILE")]
    nav: Vec<PathBuf>,
    /// Speed: 1 is real time, 10 is ten times as fast, max is as fast as the service answers.
    #[arg(long, value_name = "FACTOR", default_value = "1", value_parser = parse_speed)]
    speed: Speed,
    /// An existing session to resume after the last epoch it committed.
    #[arg(long, value_name = "ID")]
    session: Option<String>,
    /// Estimator of a new session.
    #[arg(long, value_name = "MODE", default_value = "spp")]
    mode: String,
    /// Profile of a new session.
    #[arg(long, value_name = "NAME", default_value = "general")]
    profile: String,
    /// Type and radome of the rover's antenna, for a new session that corrects for antennas. The
    /// service must have a calibration of it.
    #[arg(long, value_name = "NAME", default_value = "")]
    antenna: String,
    /// Approximate start of RTCM 3 data, GPS time, within half a day: 2019-03-24T12:00:00. Default:
    /// the service's clock.
    #[arg(long, value_name = "TIME")]
    start_time: Option<StartTime>,
    /// Duration of the attempts to reach a service that does not answer (s).
    #[arg(long, value_name = "SECONDS", default_value_t = 60)]
    patience: u64,
}

/// Sends the file.
///
/// # Errors
/// The file cannot be read, the service refuses it, or the service does not answer again.
pub(super) fn run(arguments: StreamArguments) -> Result<(), Failure> {
    host::block_on(stream(arguments))
}

async fn stream(arguments: StreamArguments) -> Result<(), Failure> {
    let format = files::input(&arguments.rover).format()?;
    let is_raw = format != FileFormat::Rinex;
    let mut rover = if is_raw { None } else { Some(Rover::open(&arguments.rover)?) };
    let patience = Duration::from_secs(arguments.patience);
    let StreamArguments { server, key, trust, .. } = &arguments;
    let connection = Connection::to(server, key.as_deref(), trust, patience)?;
    for path in &arguments.nav {
        let new = connection.push_navigation(path).await?;
        note!("{}: {new} new ephemerides", path.display());
    }
    let label = arguments.rover.file_name().map(|name| name.to_string_lossy().into_owned());
    let new = v1::CreateSessionRequest {
        label: label.unwrap_or_default().chars().take(200).collect(),
        mode: arguments.mode,
        profile: arguments.profile,
        antenna: arguments.antenna,
        ..Default::default()
    };
    let session = connection.session(arguments.session.as_deref(), new).await?;
    say!("session {}", session.session);
    let mut progress = Progress::start();
    let (id, answered) = (&*session.session, session.durable_through.unwrap_or(0));
    let (speed, answers) = (arguments.speed, v1::Answers::Summary);
    match &mut rover {
        None => {
            let near = arguments.start_time.map(|StartTime(time)| time);
            let device = DeviceStream::new((&connection, RawBytes { near }), id, answers, answered);
            let stored = session.raw_through.unwrap_or(0);
            let bytes = Bytestream::open((&arguments.rover, format), stored, near)?;
            bytes.play(device, speed, &mut progress).await?;
        }
        Some(rover) => {
            let device = DeviceStream::new((&connection, Epochs), id, answers, answered);
            rover.skip_through(answered, &mut progress)?;
            rover.play(device, speed, &mut progress).await?;
        }
    }
    progress.close();
    if let Some(rover) = &rover {
        rover.report();
    }
    Ok(())
}

/// Sends epochs in one message.
fn send(device: &mut DeviceStream<Epochs>, epochs: Vec<v1::Epoch>, due: Instant) {
    let (count, through) = (epochs.len() as u64, epochs.last().map_or(0, |epoch| epoch.seq));
    device.send(v1::StreamRequest { opening: None, epochs }, count, through, due);
}

/// The observation file with numbered epochs.
struct Rover {
    reader: Observations<Box<dyn std::io::BufRead + Send>>,
    path: PathBuf,
    seq: u64,
    epoch: Epoch,
}

impl Rover {
    fn open(path: &Path) -> Result<Self, Failure> {
        let file = File::open(path).map_err(|error| {
            let message = format!("{}: {error}", path.display());
            Failure::of(Code::FileNotReadable, message)
        })?;
        let input: Box<dyn std::io::BufRead + Send> =
            Box::new(decompress(BufReader::with_capacity(1 << 16, file)));
        let reader = Observations::new(Recognised::new(input), None, &Navigation::default());
        let reader = reader.map_err(|error| unreadable(path, &error))?;
        let epoch = Epoch::new(GpsTime::EPOCH);
        Ok(Self { reader, path: path.to_owned(), seq: 0, epoch })
    }

    /// The next epoch with its number.
    fn next(&mut self) -> Result<Option<(u64, &Epoch)>, Failure> {
        let read = self.reader.read_epoch(&mut self.epoch);
        if !read.map_err(|error| unreadable(&self.path, &error))? {
            return Ok(None);
        }
        self.seq += 1;
        Ok(Some((self.seq, &self.epoch)))
    }

    /// Sends the file to its end.
    async fn play(
        &mut self,
        mut device: DeviceStream<Epochs>,
        speed: Speed,
        progress: &mut Progress,
    ) -> Result<(), Failure> {
        match speed {
            Speed::Max => self.at_full_speed(&mut device, progress).await?,
            Speed::Factor(factor) => self.paced(&mut device, factor, progress).await?,
        }
        progress.end(device).await
    }

    /// Sends epochs as fast as the service answers.
    async fn at_full_speed(
        &mut self,
        device: &mut DeviceStream<Epochs>,
        progress: &mut Progress,
    ) -> Result<(), Failure> {
        loop {
            let batch = self.batch(BATCH)?;
            if batch.is_empty() {
                return Ok(());
            }
            send(device, batch, Instant::now());
            progress.until_room(device).await?;
        }
    }

    /// Sends each epoch when it is due.
    async fn paced(
        &mut self,
        device: &mut DeviceStream<Epochs>,
        factor: f64,
        progress: &mut Progress,
    ) -> Result<(), Failure> {
        let start = Instant::now();
        let mut first: Option<GpsTime> = None;
        while let Some((seq, epoch)) = self.next()? {
            let after_s = (epoch.time - *first.get_or_insert(epoch.time)) / factor;
            let due = start + Duration::from_secs_f64(after_s.max(0.0));
            let message = convert::epoch_message(seq, epoch);
            progress.until_room(device).await?;
            progress.until(device, due).await?;
            send(device, vec![message], due);
        }
        Ok(())
    }

    fn batch(&mut self, size: usize) -> Result<Vec<v1::Epoch>, Failure> {
        let mut batch = Vec::with_capacity(size);
        while batch.len() < size
            && let Some((seq, epoch)) = self.next()?
        {
            batch.push(convert::epoch_message(seq, epoch));
        }
        Ok(batch)
    }

    /// Prints what was skipped in the file: parts that cannot be read, and what is missing because
    /// its gzip stream ends early.
    fn report(&self) {
        for line in self.reader.left_out().to_string().lines() {
            note!("{}: {line}", self.path.display());
        }
    }

    fn skip_through(&mut self, seq: u64, progress: &mut Progress) -> Result<(), Failure> {
        while self.seq < seq && self.next()?.is_some() {
            progress.skipped += 1;
        }
        Ok(())
    }
}

fn unreadable(path: &Path, error: &FileError) -> Failure {
    let code = match error {
        FileError::Rinex(error) => error.code(),
        _ => Code::RinexReadFailed,
    };
    Failure::of(code, format!("{}: {error}", path.display()))
}
