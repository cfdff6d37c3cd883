//! `graphfix worker`: runs the jobs of a service.

use std::io;
use std::os::unix::process::CommandExt;
use std::path::PathBuf;
use std::{env, process};

use clap::Args;
use rustix::process::{Resource, Rlimit, getrlimit, nice, setrlimit};

use crate::app;
use crate::config::ServiceConfiguration;
use crate::feeds::TimeLimits;
use crate::refusal::Code;

use super::database::{DatabaseArgument, read_url};
use super::serve::configuration_of;
use super::{Failure, host};

/// Least memory of a worker (MB): what its process needs without a job.
const MEMORY_MIN_MB: i64 = 64;
/// The niceness of a process to which the system prefers all others.
const LOWEST_PRIORITY: u8 = 19;

/// Runs the jobs of a service on Postgres, in a process of its own. Any number of workers may share
/// the queue.
#[derive(Debug, Args)]
pub(super) struct WorkerArguments {
    /// Configuration file (TOML) of the service. Options here come before those in the file.
    #[arg(long, value_name = "FILE", env = "GRAPHFIX_CONFIG")]
    config: Option<PathBuf>,
    #[command(flatten)]
    database: DatabaseArgument,
    /// The service's folder of jobs. Default: jobs.folder of the configuration file.
    #[arg(long, value_name = "FOLDER")]
    folder: Option<PathBuf>,
    /// Memory of the process (MB). A job that needs more ends the process; a job that has ended
    /// several processes fails.
    #[arg(long, value_name = "MB", default_value_t = 2048,
        value_parser = clap::value_parser!(u64).range(MEMORY_MIN_MB as u64..))]
    memory: u64,
    /// Jobs that run at the same time, which share the memory.
    #[arg(long, value_name = "N", default_value_t = 1,
        value_parser = clap::value_parser!(u16).range(1..=1000))]
    running: u16,
    /// Niceness of the process, 0 to 19: the higher, the more the system prefers others. 19 leaves
    /// the processor to a service on the same machine.
    #[arg(long, value_name = "N", default_value_t = LOWEST_PRIORITY,
        value_parser = clap::value_parser!(u8).range(0..=i64::from(LOWEST_PRIORITY)))]
    nice: u8,
    /// Name of this worker in the log. Default: the host's name and a random suffix.
    #[arg(long, value_name = "NAME", env = "GRAPHFIX_NODE")]
    node: Option<String>,
    /// Filter of the log, such as info or graphfix=debug.
    #[arg(long, value_name = "FILTER", env = "GRAPHFIX_LOG")]
    log: Option<String>,
    /// Log one JSON object per line.
    #[arg(long, env = "GRAPHFIX_LOG_JSON")]
    log_json: bool,
}

impl WorkerArguments {
    /// The configuration from the file and the arguments, checked.
    fn configuration(self) -> Result<ServiceConfiguration, Failure> {
        let mut configuration = configuration_of(self.config.as_deref())?;
        self.database.choose(&mut configuration);
        configuration.jobs.folder = self.folder.or(configuration.jobs.folder);
        configuration.jobs.running = usize::from(self.running);
        configuration.node = self.node.unwrap_or(configuration.node);
        configuration.log.filter = self.log.unwrap_or(configuration.log.filter);
        configuration.log.json |= self.log_json;
        if configuration.node.is_empty() {
            configuration.node = app::random_node(); // The log needs the name, too.
        }
        configuration.check()?;
        read_url(&mut configuration)?;
        Ok(configuration)
    }
}

/// Runs jobs until it is interrupted.
///
/// # Errors
/// The configuration is refused, or the memory cannot be limited. The database or the folder is
/// not that of a service on Postgres.
pub(super) fn run(arguments: WorkerArguments) -> Result<(), Failure> {
    let (memory_mb, niceness) = (arguments.memory, arguments.nice);
    limit(memory_mb)?;
    let configuration = arguments.configuration()?;
    host::start_log(&configuration)?;
    if let Err(error) = nice(i32::from(niceness)) {
        tracing::warn!(%error, "the priority stays as it is");
    }
    host::block_on(async {
        let worker = app::open_worker(&configuration, TimeLimits::standard()).await?;
        tracing::info!(memory_mb, running = configuration.jobs.running, "taking jobs");
        if !worker.work(host::interrupted()).await {
            return Err(Failure::of(Code::Internal, "a task of the worker has ended"));
        }
        tracing::info!("stopped; what was not finished is in the queue again");
        Ok(())
    })
}

/// Limits the memory of this process: it starts the program again, under the limit.
///
/// A limit must be there before the first allocation. The allocator reserves memory then, and a
/// later limit would not cover it.
fn limit(memory_mb: u64) -> Result<(), Failure> {
    let bytes = Some(memory_mb.saturating_mul(1 << 20));
    let limits = Rlimit { current: bytes, maximum: bytes };
    let of = getrlimit(Resource::Data);
    if (of.current, of.maximum) == (bytes, bytes) {
        return Ok(());
    }
    let refused =
        |error: io::Error| Failure::of(Code::MemoryNotLimited, format!("{memory_mb} MB: {error}"));
    setrlimit(Resource::Data, limits).map_err(|error| refused(error.into()))?;
    let program = env::current_exe().map_err(refused)?;
    Err(refused(process::Command::new(program).args(env::args_os().skip(1)).exec()))
}
