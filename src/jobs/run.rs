//! One run of a job, on a blocking thread: files in, a file of positions and a report out.

use std::fs::File;
use std::io::{self, BufRead, BufReader, BufWriter, Read};
use std::path::PathBuf;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::time::{Duration, Instant};

use tokio::runtime::Handle;
use tokio::time::timeout;

use crate::formats::{UnpackError, unpack_error, unpack_reader_within};
use crate::gnss::{Geoid, LeapSeconds};
use crate::recording::{
    Input, RecordingError, RecordingInputs, SolutionWriter, Solutions, Tally, comments_of,
};
use crate::refusal::Code;
use crate::session::{BATCH_QUANTUM, BatchLane, BatchTurn};
use crate::store::JobProgress;
use crate::tenant::Tenant;

use super::files::{JobFiles, sync};
use super::request::{JobRequest, Part, Plan};
use super::state::Running;
use super::{Failure, Report};

/// Interval at which a run that waits for a turn looks whether it is stopped.
const LOOK: Duration = Duration::from_secs(1);
const READ_BUFFER_BYTES: usize = 1 << 16;
const WRITE_BUFFER_BYTES: usize = 1 << 16;

type ResultWriter = SolutionWriter<BufWriter<File>>;

/// What a run needs.
pub(super) struct Run {
    pub(super) request: JobRequest,
    pub(super) plan: Plan,
    pub(super) files: Arc<JobFiles>,
    pub(super) lane: BatchLane,
    pub(super) tenant: Tenant,
    pub(super) running: Arc<Running>,
    /// The operator's table of the geoid.
    pub(super) geoid: Option<Arc<Geoid>>,
    /// Name of the result's file.
    pub(super) result: String,
    /// Longest time that it may take.
    pub(super) longest: Duration,
    /// Largest size of an input, unpacked (bytes).
    pub(super) unpacked_bytes: u64,
}

/// A run that has its result on the disk.
pub(super) struct Done {
    pub(super) bytes: u64,
    pub(super) report: Report,
}

/// Why a run has none.
pub(super) enum Ended {
    /// The job fails.
    Failed(Failure),
    /// Its claim has ended, or the service stops.
    Stopped,
}

impl From<Failure> for Ended {
    fn from(failure: Failure) -> Self {
        Self::Failed(failure)
    }
}

impl Run {
    /// Computes the result. What it has written and not finished is removed.
    ///
    /// # Errors
    /// The job fails, or the run is stopped.
    pub(super) fn compute(&self, runtime: &Handle) -> Result<Done, Ended> {
        let mut space = Space { run: self, bytes: 0, is_done: false };
        let done = self.solve(runtime, &mut space);
        space.is_done = done.is_ok();
        done
    }

    fn solve(&self, runtime: &Handle, space: &mut Space<'_>) -> Result<Done, Ended> {
        let began = Instant::now();
        let watched = Watched::default();
        let inputs = self.inputs(&watched);
        let Plan { options, answer, .. } = &self.plan;
        let turn = self.turn(runtime, began)?;
        let opened = Solutions::open(&inputs, options.clone(), *answer);
        let mut solutions = opened.map_err(|error| watched.failure(&error))?;
        drop(turn);
        let mut writer = self.writer(solutions.leap_seconds())?;
        let mut tally = Tally::default();
        let mut has_more = true;
        while has_more {
            let turn = self.turn(runtime, began)?;
            let advanced = quantum(&mut solutions, &mut writer, &mut tally);
            drop(turn);
            has_more = advanced.map_err(|fault| match fault {
                Fault::Recording(error) => watched.failure(&error),
                Fault::Output(error) => unwritable(&error),
            })?;
            space.grow_to(writer.bytes())?;
            self.note(&tally, &watched);
        }
        let bytes = self.stored(writer).map_err(|error| unwritable(&error))?;
        space.grow_to(bytes)?;
        self.check(began)?;
        let seconds = began.elapsed().as_secs_f64();
        let hash = options.configuration_hash();
        let mut report = Report::of(&tally, &solutions.provenance(), hash, seconds);
        let own = self.request.inputs.iter().filter(|input| input.is_own);
        let added = own.map(|input| format!("{}: {}", input.part.name(), input.name));
        report.provenance.extend(added);
        Ok(Done { bytes, report })
    }

    /// Waits for a turn, unless the run is stopped or takes too long.
    fn turn(&self, runtime: &Handle, began: Instant) -> Result<BatchTurn, Ended> {
        loop {
            self.check(began)?;
            let turn = async { timeout(LOOK, self.lane.turn(&self.tenant)).await };
            // Err: there was none yet.
            if let Ok(turn) = runtime.block_on(turn) {
                return Ok(turn);
            }
        }
    }

    /// Begins the result.
    fn writer(&self, leap: LeapSeconds) -> Result<ResultWriter, Failure> {
        let comments = comments_of(&self.plan.options);
        let presentation = self.plan.options.output.presentation(self.geoid.as_ref());
        File::create_new(self.files.result(&self.result))
            .map(|file| BufWriter::with_capacity(WRITE_BUFFER_BYTES, file))
            .and_then(|file| {
                SolutionWriter::new(file, self.plan.format, &comments, leap, presentation)
            })
            .map_err(|error| unwritable(&error))
    }

    /// Completes the result. It is on the disk when this returns its size (bytes).
    fn stored(&self, writer: ResultWriter) -> io::Result<u64> {
        let (file, bytes) = writer.finish()?;
        file.into_inner().map_err(io::IntoInnerError::into_error)?.sync_all()?;
        let path = self.files.result(&self.result);
        sync(path.parent().expect("a result is in the folder of results"))?;
        Ok(bytes)
    }

    /// Ends a run that is stopped or takes too long.
    fn check(&self, began: Instant) -> Result<(), Ended> {
        if self.running.is_stopped() {
            return Err(Ended::Stopped);
        }
        if self.longest < began.elapsed() {
            let message = format!("the job has run for {} s", self.longest.as_secs());
            return Err(Failure::new(Code::JobTooLong, message, None).into());
        }
        Ok(())
    }

    fn note(&self, tally: &Tally, watched: &Watched) {
        let (epochs, answered) = (tally.epochs, tally.answered);
        let read_bytes = watched.rover_bytes();
        self.running.set_progress(JobProgress { epochs, answered, read_bytes });
    }

    /// The input files, named after their parts.
    fn inputs(&self, watched: &Watched) -> RecordingInputs {
        let of = |part: Part| self.request.inputs.iter().filter(move |input| input.part == part);
        let several = 1 < of(Part::Navigation).count();
        let input = |part: Part, index: usize, hash: &str| {
            let name = match (part, several) {
                (Part::Navigation, true) => format!("navigation[{index}]"),
                _ => part.name().to_owned(),
            };
            let (path, limit) = (self.files.input(hash), self.unpacked_bytes);
            let (watched, part_name) = (watched.clone(), name.clone());
            let open = move || {
                let reader = watched.open(&path, limit, part, part_name.clone())?;
                Ok(Box::new(reader) as Box<dyn BufRead>)
            };
            Input::unpacked(name, open)
        };
        let rover = of(Part::Rover).next().expect("the plan has checked the parts");
        let navigation = of(Part::Navigation).enumerate();
        RecordingInputs {
            navigation: navigation.map(|(at, file)| input(file.part, at, &file.hash)).collect(),
            base: of(Part::Base).next().map(|file| input(file.part, 0, &file.hash)),
            base_position: self.plan.base_position,
            reference: self.plan.reference,
            ..RecordingInputs::of_rover(input(Part::Rover, 0, &rover.hash))
        }
    }
}

/// Why a step of a run fails.
enum Fault {
    Recording(RecordingError),
    Output(io::Error),
}

/// Positions epochs for the length of a turn. Returns whether the recording goes on.
fn quantum(
    solutions: &mut Solutions<'_>,
    writer: &mut ResultWriter,
    tally: &mut Tally,
) -> Result<bool, Fault> {
    let begun = Instant::now();
    let (mut has_more, mut due) = (true, Vec::new());
    while has_more && begun.elapsed() < BATCH_QUANTUM {
        has_more = solutions.step(&mut due).map_err(Fault::Recording)?;
        for solution in due.drain(..) {
            let foreign = writer.write(&solution).map_err(Fault::Output)?;
            tally.add(&solution, foreign);
        }
    }
    Ok(has_more)
}

fn unwritable(error: &io::Error) -> Failure {
    Failure::new(Code::JobFilesFailed, format!("writing the result: {error}"), None)
}

/// The result's bytes in the space of all files. Without a result both are given up.
struct Space<'a> {
    run: &'a Run,
    bytes: u64,
    is_done: bool,
}

impl Space<'_> {
    fn grow_to(&mut self, bytes: u64) -> Result<(), Failure> {
        let reserved = self.run.files.reserve(bytes - self.bytes);
        reserved.map_err(|error| Failure::new(error.code(), error.to_string(), None))?;
        self.bytes = bytes;
        Ok(())
    }
}

impl Drop for Space<'_> {
    fn drop(&mut self) {
        if !self.is_done {
            self.run.files.remove_result(&self.run.result, self.bytes);
        }
    }
}

/// What the readers of the inputs report.
#[derive(Clone, Default)]
struct Watched(Arc<Reports>);

#[derive(Default)]
struct Reports {
    /// The part that exceeds the limits of unpacking, and how.
    fault: OnceLock<(String, UnpackError)>,
    /// Bytes that each reader of the rover's file has read.
    readers: Mutex<Vec<Arc<AtomicU64>>>,
}

impl Watched {
    /// Opens an input within the limits of unpacking.
    fn open(
        &self,
        path: &PathBuf,
        limit: u64,
        part: Part,
        name: String,
    ) -> io::Result<Noting<impl BufRead + use<>>> {
        let file = File::open(path)?;
        let length = file.metadata()?.len();
        let read = Arc::<AtomicU64>::default();
        if part == Part::Rover {
            self.readers().push(read.clone());
        }
        let file = BufReader::with_capacity(READ_BUFFER_BYTES, Counted { file, read });
        let input = unpack_reader_within(file, length, limit)?;
        Ok(Noting { input, reports: self.0.clone(), name })
    }

    /// The failure of a job whose recording fails.
    fn failure(&self, error: &RecordingError) -> Failure {
        match self.0.fault.get() {
            Some((part, fault)) => Failure::of_unpacking(*fault, part),
            None => Failure::of_recording(error),
        }
    }

    /// Bytes that the rover's reader has read. The file is opened several times; the readers that
    /// are in use no more are left out.
    fn rover_bytes(&self) -> u64 {
        let mut readers = self.readers();
        readers.retain(|read| 1 < Arc::strong_count(read));
        readers.iter().map(|read| read.load(Ordering::Acquire)).max().unwrap_or(0)
    }

    fn readers(&self) -> std::sync::MutexGuard<'_, Vec<Arc<AtomicU64>>> {
        self.0.readers.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// A file that counts what is read.
struct Counted {
    file: File,
    read: Arc<AtomicU64>,
}

impl Read for Counted {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let count = self.file.read(buffer)?;
        self.read.fetch_add(count as u64, Ordering::AcqRel);
        Ok(count)
    }
}

/// A reader that notes why unpacking ends.
struct Noting<R> {
    input: R,
    reports: Arc<Reports>,
    name: String,
}

impl<R: BufRead> BufRead for Noting<R> {
    fn fill_buf(&mut self) -> io::Result<&[u8]> {
        let Self { input, reports, name } = self;
        input.fill_buf().inspect_err(|error| {
            if let Some(fault) = unpack_error(error) {
                reports.fault.get_or_init(|| (name.clone(), fault));
            }
        })
    }

    fn consume(&mut self, amount: usize) {
        self.input.consume(amount);
    }
}

impl<R: BufRead> Read for Noting<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let block = self.fill_buf()?;
        let length = block.len().min(buffer.len());
        buffer[..length].copy_from_slice(&block[..length]);
        self.consume(length);
        Ok(length)
    }
}
