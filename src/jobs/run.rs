//! One run of a job, on a blocking thread: files in, a file of positions and a report out.

use std::collections::HashMap;
use std::fs::File;
use std::io::{self, BufWriter};
use std::sync::Arc;
use std::time::{Duration, Instant};

use tokio::runtime::Handle;
use tokio::time::timeout;

use crate::aiding::AidingDesk;
use crate::clock::Stopwatch;
use crate::evaluation::Overview;
use crate::gnss::{Ecef, Geoid, LeapSeconds, Solution};
use crate::recording::{AnswerKind, ExportError, Input, RecordingInputs, Solutions, Tally};
use crate::refusal::Code;
use crate::session::{BATCH_QUANTUM, BatchLane, BatchTurn, Rerun, RerunRequest, SessionId};
use crate::store::{JobProgress, Store};
use crate::tenant::Tenant;

use super::checkpoints::{Checkpoints, Found};
use super::content::FIGURES_BYTES;
use super::files::JobFiles;
use super::request::{JobInput, JobRequest, Part, Plan};
use super::sources::{Files, SessionEpochs, Source};
use super::state::{LOOK, Running, unless_stopped};
use super::watched::Watched;
use super::writing::{ResultWriter, unwritable};
use super::{Failure, JobError, Report};

/// Answers of an earlier run that are written in one turn, which takes some milliseconds.
const ANSWERS_PER_TURN: usize = 512;

/// Everything that a run needs.
pub(super) struct Run {
    pub(super) request: JobRequest,
    pub(super) plan: Plan,
    pub(super) files: Arc<JobFiles>,
    /// The inputs by their hashes, once they are opened.
    pub(super) inputs: HashMap<String, Arc<File>>,
    /// The store of sessions and the aiding with which they were answered; `None` if the job has no
    /// session.
    pub(super) stored: Option<(Store, AidingDesk)>,
    pub(super) lane: BatchLane,
    pub(super) tenant: Tenant,
    pub(super) running: Arc<Running>,
    /// The operator's table of the geoid.
    pub(super) geoid: Option<Arc<Geoid>>,
    /// The id of the job.
    pub(super) job: String,
    /// Name of the result's file.
    pub(super) result: String,
    /// Longest time that it may take.
    pub(super) longest: Duration,
    /// Time between two checkpoints.
    pub(super) checkpoint_interval: Duration,
    /// Largest size of an input, unpacked (bytes).
    pub(super) unpacked_bytes: u64,
}

/// A completed run, with its result on the disk.
pub(super) struct Done {
    pub(super) bytes: u64,
    pub(super) report: Report,
}

/// The answers of a run.
struct Output {
    writer: ResultWriter,
    tally: Tally,
    overview: Overview,
    /// `None` if no more checkpoints are written.
    checkpoints: Option<Checkpoints>,
    /// Time that the earlier runs have taken (s).
    seconds_before: f64,
    /// Progress of the earlier runs: epochs, and the part of the rover's file or of the session.
    resumed: (u64, u64),
}

/// Why a run has no result.
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
    /// Computes the result. An unfinished result is removed.
    ///
    /// # Errors
    /// The job fails, or the run is stopped.
    pub(super) fn compute(mut self, runtime: &Handle) -> Result<Done, Ended> {
        self.inputs = self.opened(runtime)?;
        let mut space = Space { run: &self, bytes: 0, is_done: false };
        let done = self.solve(runtime, &mut space);
        space.is_done = done.is_ok();
        done
    }

    /// Opens all inputs, by their hashes.
    fn opened(&self, runtime: &Handle) -> Result<HashMap<String, Arc<File>>, Ended> {
        let mut opened = HashMap::new();
        for input in &self.request.inputs {
            let opening = self.files.open_input(&input.hash, input.bytes);
            let file = self.awaited(runtime, opening)?;
            opened.insert(input.hash.clone(), Arc::new(file));
        }
        Ok(opened)
    }

    fn solve(&self, runtime: &Handle, space: &mut Space<'_>) -> Result<Done, Ended> {
        let (began, used) = (Instant::now(), Stopwatch::started());
        let watched = Watched::default();
        let of = |part: Part| self.request.inputs.iter().find(move |input| input.part == part);
        let base = of(Part::Base).map(|file| self.input(&watched, file, "base"));
        let rerun = self.request.options.rerun(base.is_some()).map_err(|e| failed(&e))?;
        if let Some((id, rerun)) = rerun {
            let mut source = self.session(runtime, (id, &rerun), watched)?;
            if let Some(base) = &base {
                source.read(runtime)?;
                let turn = self.turn(runtime, began)?;
                source.follow(base, &self.plan)?;
                drop(turn);
            }
            return self.written(source, (runtime, began, &used), space);
        }
        let inputs = self.recording(&watched, base);
        let Plan { options, answer, .. } = &self.plan;
        let turn = self.turn(runtime, began)?;
        let opened = Solutions::open(&inputs, options.clone(), *answer);
        let solutions = opened.map_err(|error| watched.failure(&error))?;
        drop(turn);
        let source = Files::new(solutions, watched);
        self.written(source, (runtime, began, &used), space)
    }

    /// Positions all epochs and writes the result.
    fn written(
        &self,
        mut source: impl Source,
        (runtime, began, used): (&Handle, Instant, &Stopwatch),
        space: &mut Space<'_>,
    ) -> Result<Done, Ended> {
        let mut output = Output {
            writer: self.writer(source.leap_seconds())?,
            tally: Tally::default(),
            overview: Overview::new(),
            checkpoints: self.has_checkpoints().then(|| self.checkpoints()),
            seconds_before: 0.0,
            resumed: (0, 0),
        };
        self.resume((&mut source, &mut output), (runtime, began), space)?;
        let kept = output.tally.epochs;
        let positioned = loop {
            match self.advance((&mut source, &mut output), (runtime, began, used), space) {
                Ok(true) => {}
                Ok(false) => break Ok(()),
                Err(ended) => break Err(ended),
            }
            if output.checkpoints.as_ref().is_some_and(Checkpoints::is_due) {
                self.leave_checkpoint((&source, &mut output), (runtime, began));
            }
        };
        if matches!(positioned, Err(Ended::Stopped)) {
            self.leave_checkpoint((&source, &mut output), (runtime, began));
        }
        positioned?;
        let Output { writer, tally, overview, seconds_before, .. } = output;
        let written = (writer, &source, overview.first_position());
        let bytes = self.stored(written, (runtime, began, used), space)?;
        space.grow_to(bytes)?;
        self.check(began)?;
        let seconds = seconds_before + began.elapsed().as_secs_f64();
        let hash = self.plan.options.configuration_hash();
        let mut report = Report::of(&tally, &source.provenance(), hash, seconds);
        let own = self.request.inputs.iter().filter(|input| input.is_own);
        let added = own.map(JobInput::remark);
        report.provenance.extend(added.chain(source.remarks()));
        if 0 < kept {
            let line = format!("the first {kept} answers are those of a run that was cut off");
            report.provenance.push(line);
        }
        self.keep_figures((runtime, began), &overview);
        Ok(Done { bytes, report })
    }

    /// Stores figures of the answers beside the result. If this fails, the report has no figures.
    fn keep_figures(&self, (runtime, began): (&Handle, Instant), overview: &Overview) {
        let turn = self.turn(runtime, began);
        let drawn = overview.figures();
        drop(turn);
        let stored = match drawn {
            Ok(figures) if figures.len() <= FIGURES_BYTES => {
                runtime.block_on(self.files.store_figures(&self.result, &figures))
            }
            Ok(figures) => Err(JobError::disk("drawing figures")(io::Error::other(format!(
                "{} bytes are too many",
                figures.len()
            )))),
            Err(error) => Err(JobError::disk("drawing figures")(io::Error::other(error))),
        };
        if let Err(error) = stored {
            tracing::warn!(%error, job = self.job, "the report of a job has no figures");
        }
    }

    /// Positions epochs for one turn. Returns whether there may be more.
    fn advance(
        &self,
        (source, output): (&mut impl Source, &mut Output),
        (runtime, began, used): (&Handle, Instant, &Stopwatch),
        space: &mut Space<'_>,
    ) -> Result<bool, Ended> {
        if !source.read(runtime)? {
            return Ok(false);
        }
        let turn = self.turn(runtime, began)?;
        let advanced = quantum(source, output);
        drop(turn);
        self.running.set_cpu(used.elapsed());
        advanced?;
        space.grow_to(output.writer.bytes())?;
        // A batch has no answers before its end, and those of a window are late.
        let Tally { epochs, answered, .. } = output.tally;
        let epochs = epochs.max(source.epochs());
        let read_bytes = source.passed();
        let (resumed_epochs, resumed_bytes) = output.resumed;
        let taken_over = JobProgress { resumed_epochs, resumed_bytes, ..JobProgress::default() };
        self.running.set_progress(JobProgress { epochs, answered, read_bytes, ..taken_over });
        Ok(true)
    }

    /// Whether the run writes checkpoints. A batch is answered as a whole, so it cannot.
    fn has_checkpoints(&self) -> bool {
        self.plan.answer != AnswerKind::Batch
    }

    fn checkpoints(&self) -> Checkpoints {
        Checkpoints::new(self.job.clone(), self.checkpoint_interval)
    }

    /// Continues where an earlier run of the job was interrupted, if it has left checkpoints.
    fn resume(
        &self,
        (source, output): (&mut impl Source, &mut Output),
        (runtime, began): (&Handle, Instant),
        space: &mut Space<'_>,
    ) -> Result<(), Ended> {
        let Some(mut chain) = self.has_checkpoints().then(|| self.checkpoints()) else {
            return Ok(());
        };
        let found = self.awaited(runtime, chain.found(&self.files))?;
        let Some(Found { parts, state, seconds }) = found else { return Ok(()) };
        if !source.resume(&state, runtime)? {
            return Ok(());
        }
        for _ in 0..parts {
            let answers = self.awaited(runtime, chain.take(&self.files))?;
            // Another process has changed the checkpoints: it has claimed the job again.
            let answers = answers.ok_or(Ended::Stopped)?;
            for some in answers.chunks(ANSWERS_PER_TURN) {
                let turn = self.turn(runtime, began)?;
                some.iter().try_for_each(|answer| output.write(answer))?;
                drop(turn);
                space.grow_to(output.writer.bytes())?;
            }
        }
        (output.checkpoints, output.seconds_before) = (Some(chain), seconds);
        output.resumed = (output.tally.epochs, source.passed());
        Ok(())
    }

    /// Waits for work on the files, unless the run is stopped.
    fn awaited<T>(
        &self,
        runtime: &Handle,
        work: impl Future<Output = Result<T, JobError>>,
    ) -> Result<T, Ended> {
        let done = runtime.block_on(unless_stopped(&self.running, work));
        Ok(done.ok_or(Ended::Stopped)?.map_err(|error| failed(&error))?)
    }

    /// Writes a checkpoint for the next run. If this fails, the next run repeats more epochs.
    fn leave_checkpoint(
        &self,
        (source, output): (&impl Source, &mut Output),
        (runtime, began): (&Handle, Instant),
    ) {
        let Some(mut checkpoints) = output.checkpoints.take() else { return };
        let Some(state) = source.checkpoint() else { return };
        let seconds = output.seconds_before + began.elapsed().as_secs_f64();
        match runtime.block_on(checkpoints.write(&self.files, (&state, seconds))) {
            Ok(()) => output.checkpoints = Some(checkpoints),
            Err(error) => {
                tracing::warn!(%error, job = self.job, "a job has no checkpoints from here on");
            }
        }
    }

    /// Opens the session that replaces the rover's file.
    fn session<'a>(
        &'a self,
        runtime: &Handle,
        (id, request): (SessionId, &RerunRequest),
        watched: Watched,
    ) -> Result<SessionEpochs<'a>, Failure> {
        let session = self.request.session.as_ref().expect("it was planned with the job");
        let plan = session.plan().map_err(|error| failed(&error))?;
        let stored = self.stored.clone().expect("it was read, because the job has a session");
        let opened = Rerun::open(request, plan, stored, &self.tenant, &id);
        let rerun = runtime.block_on(opened).map_err(|error| Failure::of_session(&error))?;
        let mode = self.plan.options.mode;
        Ok(SessionEpochs::new(rerun, (id, request), session, mode, watched))
    }

    /// Waits for a turn, unless the run is stopped or takes too long.
    fn turn(&self, runtime: &Handle, began: Instant) -> Result<BatchTurn, Ended> {
        loop {
            self.check(began)?;
            let turn = async { timeout(LOOK, self.lane.turn(&self.tenant)).await };
            // Err: no turn was granted yet.
            if let Ok(turn) = runtime.block_on(turn) {
                return Ok(turn);
            }
        }
    }

    /// Begins the result.
    fn writer(&self, leap: LeapSeconds) -> Result<ResultWriter, Failure> {
        let mut options = self.plan.options.clone();
        let output = &mut options.output;
        output.base_frame = output.base_frame.or_else(|| self.request.frame_of_own_base());
        let presentation = output.presentation(self.geoid.as_ref());
        let (format, ways) = (self.plan.format, (leap, presentation));
        let file = self.files.begin_result(&self.result);
        let begun = file.and_then(|file| ResultWriter::begin(file, format, &options, ways));
        begun.map_err(|error| unwritable(&error))
    }

    /// Completes the result, and returns its size (bytes). It is then durable. `position` is the
    /// first position of the rover.
    fn stored(
        &self,
        (writer, source, position): (ResultWriter, &impl Source, Option<Ecef>),
        (runtime, began, used): (&Handle, Instant, &Stopwatch),
        space: &mut Space<'_>,
    ) -> Result<u64, Ended> {
        let (file, bytes) = match writer {
            ResultWriter::Positions(writer) => {
                writer.finish().map_err(|error| unwritable(&error))?
            }
            ResultWriter::Observations(file) => {
                self.observed((file, source, position), (runtime, began, used), space)?
            }
        };
        let file = file.into_inner().map_err(io::IntoInnerError::into_error);
        let file = file.map_err(|error| unwritable(&error))?;
        self.awaited(runtime, self.files.finish_result(&self.result, (file, bytes)))?;
        Ok(bytes)
    }

    /// Writes the rover's observations. Returns the file and its size (bytes).
    fn observed(
        &self,
        (file, source, position): (BufWriter<File>, &impl Source, Option<Ecef>),
        (runtime, began, used): (&Handle, Instant, &Stopwatch),
        space: &mut Space<'_>,
    ) -> Result<(BufWriter<File>, u64), Ended> {
        let (recording, watched) =
            source.recording().expect("the plan refuses observations of a session");
        let failure = |error| match error {
            ExportError::Read(error) => watched.failure(&error),
            ExportError::Write(error) => unwritable(&error),
        };
        let export = recording.export(file, position);
        let mut export = export.map_err(|error| watched.failure(&error))?;
        let mut goes_on = true;
        while goes_on {
            let turn = self.turn(runtime, began)?;
            let begun = Instant::now();
            while goes_on && begun.elapsed() < BATCH_QUANTUM {
                goes_on = export.step().map_err(failure)?;
            }
            drop(turn);
            self.running.set_cpu(used.elapsed());
            space.grow_to(export.bytes())?;
        }
        Ok(export.finish().map_err(failure)?)
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

    /// The files of a recording, named after their parts.
    fn recording(&self, watched: &Watched, base: Option<Input>) -> RecordingInputs {
        let of = |part: Part| self.request.inputs.iter().filter(move |input| input.part == part);
        let rover = of(Part::Rover).next().expect("the plan has checked the parts");
        let several = 1 < of(Part::Navigation).count();
        let navigation = of(Part::Navigation).enumerate().map(|(index, file)| {
            let name = if several { format!("navigation[{index}]") } else { "navigation".into() };
            self.input(watched, file, &name)
        });
        RecordingInputs {
            navigation: navigation.collect(),
            base,
            base_position: self.plan.base_position,
            reference: self.plan.reference,
            ..RecordingInputs::of_rover(self.input(watched, rover, "rover"))
        }
    }

    /// An input file by its name in the upload.
    fn input(&self, watched: &Watched, file: &JobInput, name: &str) -> Input {
        let opened = self.inputs.get(&file.hash).expect("all inputs were opened").clone();
        watched.input(opened, self.unpacked_bytes, file.part, name)
    }
}

/// The failure of a job whose request the desk refuses.
pub(super) fn failed(error: &JobError) -> Failure {
    Failure::new(error.code(), error.to_string(), error.field())
}

/// Positions epochs for the length of a turn, or until more must be read.
fn quantum(source: &mut impl Source, output: &mut Output) -> Result<(), Failure> {
    let begun = Instant::now();
    let (mut goes_on, mut due) = (true, Vec::new());
    while goes_on && begun.elapsed() < BATCH_QUANTUM {
        goes_on = source.step(&mut due)?;
        for solution in due.drain(..) {
            output.write(&solution)?;
            if let Some(checkpoints) = &mut output.checkpoints {
                checkpoints.add(&solution);
            }
        }
    }
    Ok(())
}

impl Output {
    /// Writes and counts an answer.
    fn write(&mut self, solution: &Solution) -> Result<(), Failure> {
        let foreign = self.writer.write(solution).map_err(|error| unwritable(&error))?;
        self.tally.add(solution, foreign);
        self.overview.add(solution);
        Ok(())
    }
}

/// The space that the result takes of all files. Without a result, file and space are given up.
struct Space<'a> {
    run: &'a Run,
    bytes: u64,
    is_done: bool,
}

impl Space<'_> {
    fn grow_to(&mut self, bytes: u64) -> Result<(), Failure> {
        let reserved = self.run.files.reserve_for_result(bytes - self.bytes);
        reserved.map_err(|error| Failure::new(error.code(), error.to_string(), None))?;
        self.bytes = bytes;
        Ok(())
    }
}

impl Drop for Space<'_> {
    fn drop(&mut self) {
        self.run.files.end_result(&self.run.result, self.bytes, self.is_done);
    }
}
