//! The solver pool: estimation runs here, never on the threads that serve the network.

mod lanes;
mod newest;

use std::num::NonZeroUsize;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio::time::sleep;

use crate::clock::Stopwatch;
use crate::positioning::Scratch;
use crate::quotas::{Meter, Meters};
use crate::tenant::Tenant;

use super::SessionError;
use super::panics::caught;
use super::state::State;

pub(super) use lanes::Lane;
use lanes::{Lanes, Turn};
use newest::{Admitted, Newest};

/// A quantum ends after this time, or after `QUANTUM_STEPS` steps if other work waits.
const QUANTUM: Duration = Duration::from_millis(10);
const QUANTUM_STEPS: usize = 16;
/// Interval at which a waiting job checks whether its tenant may compute again. Quotas may change.
const QUOTA_LOOK: Duration = Duration::from_secs(1);
/// Sessions that are restored at the same time, for each thread: as many as a statement reads, so
/// that some are read while others are computed.
const RESTORES_PER_THREAD: usize = 16;
/// Memory of all streams of receivers that are restored at the same time (bytes). A CRINEX or gzip
/// stream has up to 16 MB, the others 128 kB.
const STREAM_MEMORY_BYTES: usize = 48 << 20;
/// Copies of the stored bytes while a stream is restored: the rows, all bytes joined, the
/// decoder's.
const STREAM_COPIES: u64 = 3;
/// States that are stored at the same time when the service stops. They fill three transactions.
const STATES_STORED: usize = 512;
/// Most spare states, and buffers of encoded ones, that are kept.
const SPARE_STATES: usize = 64;
/// Longest buffer that is kept (bytes).
const SPARE_BUFFER_BYTES: usize = 256 << 10;

/// A bounded number of threads for estimation, which lanes share. A handle works for one tenant and
/// counts its time on the tenant's meter.
#[derive(Clone)]
pub(super) struct Solvers {
    lanes: Lanes,
    meter: Arc<Meter>,
    memory: MemoryPool,
    threads: usize,
    restores: Newest,
    /// Kilobytes that the restoring of streams may use.
    stream_memory: Arc<Semaphore>,
    /// States that are being encoded and stored.
    storing: Arc<Semaphore>,
}

/// Time after which a batch job ends its turn.
pub const BATCH_QUANTUM: Duration = QUANTUM;

/// The lane of batch jobs in the pool.
#[derive(Clone)]
pub struct BatchLane {
    lanes: Lanes,
    meters: Meters,
}

/// The right of a batch job to compute. Dropping it ends the turn.
#[derive(Debug)]
#[must_use = "the turn ends when it is dropped"]
pub struct BatchTurn {
    _turn: Turn,
    begun: Instant,
    meter: Arc<Meter>,
}

impl BatchLane {
    /// The pool of a process without sessions, in which this number of jobs compute at a time.
    pub fn alone(jobs: usize, meters: Meters) -> Self {
        // The lane of batch jobs leaves one thread of a pool to sessions, so one more is needed.
        Self { lanes: Lanes::new(jobs + 1), meters }
    }

    /// Waits for a turn of a tenant. A tenant that has used its processor time gets none until its
    /// quota allows more. The turn should end after [`BATCH_QUANTUM`].
    pub async fn turn(&self, tenant: &Tenant) -> BatchTurn {
        let meter = self.meters.of(tenant);
        loop {
            let delay = meter.computation_delay();
            if delay.is_zero() {
                break;
            }
            sleep(delay.min(QUOTA_LOOK)).await;
        }
        let turn = self.lanes.turn(Lane::Batch, tenant.clone()).await;
        BatchTurn { _turn: turn, begun: Instant::now(), meter }
    }
}

impl Drop for BatchTurn {
    fn drop(&mut self) {
        self.meter.count_cpu(self.begun.elapsed());
    }
}

/// Whether steps are left after a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Progress {
    Remaining,
    Done,
}

/// Memory that all sessions share, so that an idle session needs only its state.
#[derive(Clone, Default)]
pub(super) struct MemoryPool {
    shared: Arc<Mutex<Shared>>,
}

#[derive(Default)]
struct Shared {
    states: Vec<State>,
    /// Buffers of encoded states.
    buffers: Vec<Vec<u8>>,
    /// Scratches: as many as estimations have run at the same time.
    scratches: Vec<Box<Scratch>>,
}

impl Solvers {
    /// A pool for the operator, whose time is counted on its own meter.
    pub(super) fn new(threads: NonZeroUsize) -> Self {
        let threads = threads.get();
        let (lanes, memory) = (Lanes::new(threads), MemoryPool::default());
        let restores = Newest::new(RESTORES_PER_THREAD * threads);
        let stream_memory = Arc::new(Semaphore::new(STREAM_MEMORY_BYTES >> 10));
        let storing = Arc::new(Semaphore::new(STATES_STORED));
        let meter = Meters::default().of(&Tenant::operator());
        Self { lanes, meter, memory, threads, restores, stream_memory, storing }
    }

    /// The meter on which the time is counted.
    pub(super) fn meter(&self) -> &Meter {
        &self.meter
    }

    /// The same pool for the tenant of a meter.
    pub(super) fn of(&self, meter: Arc<Meter>) -> Self {
        Self { meter, ..self.clone() }
    }

    /// Number of threads.
    pub(super) const fn threads(&self) -> usize {
        self.threads
    }

    /// Waits until a session may be restored. The limit is high enough to keep the pool busy while
    /// other sessions read the store.
    pub(super) async fn admitted_restore(&self) -> Admitted {
        self.restores.admitted().await
    }

    /// Waits until a state may be stored. The limit is as many states as fill some transactions.
    pub(super) async fn admitted_storing(&self) -> OwnedSemaphorePermit {
        let permit = self.storing.clone().acquire_owned().await;
        permit.expect("the semaphore is never closed")
    }

    /// Waits until the memory is free that a stream of `stored_bytes` needs while it is restored. A
    /// stream that needs more than the limit waits for all of the memory.
    pub(super) async fn admitted_stream(&self, stored_bytes: u64) -> OwnedSemaphorePermit {
        let bytes = stored_bytes.saturating_mul(STREAM_COPIES).min(STREAM_MEMORY_BYTES as u64);
        let permits = self.stream_memory.clone().acquire_many_owned((bytes >> 10) as u32).await;
        permits.expect("the semaphore is never closed")
    }

    /// The part of the pool that batch jobs have.
    pub(super) fn batch_lane(&self, meters: Meters) -> BatchLane {
        BatchLane { lanes: self.lanes.clone(), meters }
    }

    pub(super) fn memory(&self) -> &MemoryPool {
        &self.memory
    }

    /// Runs `work` on a thread of the pool.
    ///
    /// # Errors
    /// It panicked.
    pub(super) async fn run<T: Send + 'static>(
        &self,
        lane: Lane,
        work: impl FnOnce() -> T + Send + 'static,
    ) -> Result<T, SessionError> {
        let meter = self.meter.clone();
        let measured = move || {
            let begun = Stopwatch::started();
            let done = work();
            meter.count_cpu(begun.elapsed());
            done
        };
        let done = self.lanes.run(lane, self.meter.tenant().clone(), measured).await;
        let done = done.unwrap_or_else(|| Err("it was cancelled".to_owned()));
        done.map_err(|message| SessionError::EstimatorFailed { message })
    }

    /// Runs `work` on a thread of the pool, with an estimator's scratch.
    ///
    /// # Errors
    /// It panicked.
    pub(super) async fn estimate<T: Send + 'static>(
        &self,
        lane: Lane,
        work: impl FnOnce(&mut Scratch) -> T + Send + 'static,
    ) -> Result<T, SessionError> {
        let memory = self.memory.clone();
        self.run(lane, move || memory.with_scratch(work)).await
    }

    /// Runs `work` on the calling thread. `work` returns its result and the processor time that it
    /// has used. This is for work that is shorter than passing it to a thread of the pool.
    ///
    /// # Errors
    /// It panicked.
    pub(super) fn run_here<T>(
        &self,
        work: impl FnOnce(&mut Scratch) -> (T, Duration),
    ) -> Result<T, SessionError> {
        let done = caught(|| self.memory.with_scratch(work));
        let (done, used) = done.map_err(|message| SessionError::EstimatorFailed { message })?;
        self.meter.count_cpu(used);
        Ok(done)
    }

    /// Runs `step` on `work` until it returns [`Progress::Done`]. Other work of the lane has its
    /// turn after each quantum. Dropping the future ends the work after its present quantum.
    ///
    /// # Errors
    /// It panicked.
    pub(super) async fn in_quanta<T: Send + 'static>(
        &self,
        lane: Lane,
        work: T,
        step: impl Fn(&mut T, &mut Scratch) -> Progress + Copy + Send + 'static,
    ) -> Result<T, SessionError> {
        let mut work = work;
        loop {
            let lanes = self.lanes.clone();
            let quantum = move |scratch: &mut Scratch| {
                let begun = Instant::now();
                for steps in 1.. {
                    if step(&mut work, scratch) == Progress::Done {
                        return (work, Progress::Done);
                    }
                    let elapsed = begun.elapsed();
                    if QUANTUM < elapsed || (QUANTUM_STEPS <= steps && lanes.is_awaited()) {
                        break;
                    }
                }
                (work, Progress::Remaining)
            };
            let (advanced, progress) = self.estimate(lane, quantum).await?;
            if progress == Progress::Done {
                return Ok(advanced);
            }
            work = advanced;
        }
    }
}

impl MemoryPool {
    /// A copy of `state`, in storage that an earlier one left.
    pub(super) fn copy_of(&self, state: &State) -> State {
        let spare = self.shared().states.pop();
        match spare {
            None => state.clone(),
            Some(mut spare) => {
                spare.clone_from(state);
                spare
            }
        }
    }

    /// Runs `work` with a scratch that nobody else uses meanwhile. After a panic it is not used
    /// again.
    fn with_scratch<T>(&self, work: impl FnOnce(&mut Scratch) -> T) -> T {
        let scratch = self.shared().scratches.pop();
        let mut scratch = scratch.unwrap_or_default();
        let done = work(&mut scratch);
        self.shared().scratches.push(scratch);
        done
    }

    /// Keeps the storage of a state that is no longer needed.
    pub(super) fn recycle(&self, state: State) {
        let mut shared = self.shared();
        if shared.states.len() < SPARE_STATES {
            shared.states.push(state);
        }
    }

    /// A buffer for an encoded state, that of an earlier one if there is any.
    pub(super) fn buffer(&self) -> Vec<u8> {
        self.shared().buffers.pop().unwrap_or_default()
    }

    /// Keeps the buffer of a state that is decoded.
    pub(super) fn recycle_buffer(&self, buffer: Vec<u8>) {
        let mut shared = self.shared();
        if shared.buffers.len() < SPARE_STATES && buffer.capacity() <= SPARE_BUFFER_BYTES {
            shared.buffers.push(buffer);
        }
    }

    fn shared(&self) -> std::sync::MutexGuard<'_, Shared> {
        self.shared.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicUsize, Ordering};

    use super::*;
    use crate::refusal::Code;

    #[test]
    fn a_panic_on_the_calling_thread_is_an_error() {
        let solvers = Solvers::new(NonZeroUsize::MIN);
        assert_eq!(solvers.run_here(|_| (7, Duration::from_micros(3))).unwrap(), 7);
        let failed = solvers.run_here(|_| -> ((), Duration) { panic!("singular") }).unwrap_err();
        assert!(failed.to_string().ends_with("singular"), "{failed}");
    }

    #[tokio::test]
    async fn a_panic_is_an_error_and_frees_its_thread() {
        let solvers = Solvers::new(NonZeroUsize::MIN);
        let failed = solvers.run(Lane::RealTime, || panic!("singular at {}", 3)).await.unwrap_err();
        assert_eq!(failed.code(), Code::EstimatorFailed);
        assert!(failed.to_string().ends_with("singular at 3"), "{failed}");
        assert_eq!(solvers.run(Lane::RealTime, || 7).await.unwrap(), 7);
    }

    /// Long streams are restored one after another, short ones beside each other.
    #[tokio::test]
    async fn streams_are_restored_within_the_memory() {
        let solvers = Solvers::new(NonZeroUsize::MIN);
        let short = solvers.admitted_stream(128 << 10).await;
        let other = solvers.admitted_stream(128 << 10).await;
        let mut long = Box::pin(solvers.admitted_stream(u64::MAX));
        assert!(futures::poll!(&mut long).is_pending());
        drop((short, other));
        let long = long.await;
        let mut next = Box::pin(solvers.admitted_stream(16 << 20));
        assert!(futures::poll!(&mut next).is_pending());
        drop(long);
        drop(next.await);
    }

    /// A computation of many steps lets a computation of one step pass, and ends when dropped.
    #[tokio::test]
    async fn long_work_lets_others_pass() {
        let solvers = Solvers::new(NonZeroUsize::MIN);
        let steps = Arc::new(AtomicUsize::new(0));
        let step = |steps: &mut Arc<AtomicUsize>, _: &mut Scratch| {
            steps.fetch_add(1, Ordering::AcqRel);
            Progress::Remaining
        };
        let endless = solvers.in_quanta(Lane::OnDemand, steps.clone(), step);
        tokio::select! {
            _ = endless => panic!("it has no end"),
            done = async {
                while steps.load(Ordering::Acquire) == 0 {
                    tokio::task::yield_now().await;
                }
                solvers.run(Lane::RealTime, || 7).await
            } => assert_eq!(done.unwrap(), 7),
        }
        solvers.run(Lane::RealTime, || ()).await.unwrap();
        let ended = steps.load(Ordering::Acquire);
        solvers.run(Lane::RealTime, || ()).await.unwrap();
        assert_eq!(steps.load(Ordering::Acquire), ended);
    }
}
