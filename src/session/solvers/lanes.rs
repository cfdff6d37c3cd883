//! The order in which work uses the solver pool.
//!
//! Work waits in a lane. Each lane has a share of the pool while others wait, too. Within a lane,
//! tenants take turns, and the work of a tenant is served in order. A session has at most one
//! quantum of work in the queue. After each quantum it returns behind the other sessions of its
//! tenant, so sessions take turns.
//!
//! The next lane is the one with the least time on the pool, divided by its share (stride
//! scheduling: Waldspurger and Weihl, 1995, *Stride Scheduling: Deterministic Proportional-Share
//! Resource Management*). A lane that has been empty begins at the present virtual time, so it
//! gains nothing from the time before.

use std::collections::{HashMap, VecDeque};
use std::fmt;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use tokio::runtime::Handle;
use tokio::sync::oneshot;

use crate::session::panics::caught;
use crate::tenant::Tenant;

/// The purpose of work.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::session) enum Lane {
    /// New epochs of sessions.
    RealTime,
    /// Restoring the state of sessions that are not in memory.
    Restore,
    /// Computations that are not stored.
    OnDemand,
    /// Batch jobs.
    Batch,
}

/// Shares of the pool, by lane.
const SHARES: [f64; 4] = [8.0, 4.0, 1.0, 1.0];
/// All lanes.
const LANES: [Lane; 4] = [Lane::RealTime, Lane::Restore, Lane::OnDemand, Lane::Batch];

/// The threads of a pool, and the lanes that share them. All clones share both.
#[derive(Clone)]
pub(super) struct Lanes(Arc<Mutex<Queues>>);

struct Queues {
    /// Number of idle threads.
    free: usize,
    queues: [Queue; 4],
    /// Virtual time: the largest `used_s` at which a lane was served (s).
    now_s: f64,
}

#[derive(Default)]
struct Queue {
    /// The waiting work of each tenant that has any.
    waiting: HashMap<Tenant, VecDeque<Waiting>>,
    /// These tenants, in the order in which they are served.
    order: VecDeque<Tenant>,
    /// Number of threads that work for this lane. `most` is its limit.
    running: usize,
    most: usize,
    /// Time on the pool, divided by the share (s).
    used_s: f64,
}

/// An entry that waits for a thread.
enum Waiting {
    /// A caller that computes on its own thread.
    Turn(oneshot::Sender<Turn>),
    /// Work for a thread of the pool.
    Work(Box<dyn Work>),
}

/// Work whose caller waits for its result.
trait Work: Send {
    /// Whether its caller no longer waits.
    fn is_left(&self) -> bool;

    /// The runtime whose blocking threads do it.
    fn runtime(&self) -> Handle;

    /// Does the work, and sends the result to its caller.
    fn compute(self: Box<Self>);
}

struct Awaited<T, F> {
    work: F,
    done: oneshot::Sender<Result<T, String>>,
    runtime: Handle,
}

impl<T: Send, F: FnOnce() -> T + Send> Work for Awaited<T, F> {
    fn is_left(&self) -> bool {
        self.done.is_closed()
    }

    fn runtime(&self) -> Handle {
        self.runtime.clone()
    }

    fn compute(self: Box<Self>) {
        // Err: the caller has gone.
        self.done.send(caught(self.work)).ok();
    }
}

impl Waiting {
    fn is_left(&self) -> bool {
        match self {
            Self::Turn(turn) => turn.is_closed(),
            Self::Work(work) => work.is_left(),
        }
    }
}

/// The right to use a thread of the pool. Dropping it returns the thread.
pub(super) struct Turn {
    lanes: Lanes,
    lane: Lane,
    begun: Instant,
    /// Whether its end begins the next work.
    serves_next: bool,
}

impl Lanes {
    /// A pool of `threads` threads. Computations on request leave one of the threads to other
    /// lanes, and so do batch jobs.
    pub(super) fn new(threads: usize) -> Self {
        let fewer = threads.saturating_sub(1).max(1);
        let most = [threads, threads, fewer, fewer];
        let queues = most.map(|most| Queue { most, ..Queue::default() });
        Self(Arc::new(Mutex::new(Queues { free: threads, queues, now_s: 0.0 })))
    }

    /// Waits for a thread.
    pub(super) async fn turn(&self, lane: Lane, tenant: Tenant) -> Turn {
        let (turn, granted) = oneshot::channel();
        self.enter(lane, tenant, Waiting::Turn(turn));
        granted.await.expect("a turn that waits is granted")
    }

    /// Does `work` on a blocking thread, in its turn. Returns its result, or the message of its
    /// panic; `None` if the runtime ends before.
    pub(super) async fn run<T: Send + 'static>(
        &self,
        lane: Lane,
        tenant: Tenant,
        work: impl FnOnce() -> T + Send + 'static,
    ) -> Option<Result<T, String>> {
        let (done, result) = oneshot::channel();
        let work = Box::new(Awaited { work, done, runtime: Handle::current() });
        self.enter(lane, tenant, Waiting::Work(work));
        result.await.ok()
    }

    fn enter(&self, lane: Lane, tenant: Tenant, waiting: Waiting) {
        self.queues().enter(lane, tenant, waiting);
        self.serve();
    }

    /// Whether work waits for a thread.
    pub(super) fn is_awaited(&self) -> bool {
        self.queues().queues.iter().any(|queue| !queue.order.is_empty())
    }

    /// Grants turns and begins work while threads are free.
    fn serve(&self) {
        while let Some((turn, work)) = self.next_work() {
            work.runtime().spawn_blocking(move || turn.work(work));
        }
    }

    /// The next work for a thread of the pool, with its turn. Callers that wait for a turn before
    /// it get their turns. `None` if nothing waits, or no thread is free.
    fn next_work(&self) -> Option<(Turn, Box<dyn Work>)> {
        loop {
            let (lane, waiting) = self.queues().next()?;
            let (lanes, begun, serves_next) = (self.clone(), Instant::now(), true);
            let turn = Turn { lanes, lane, begun, serves_next };
            match waiting {
                // Err: the caller has gone; dropping the turn returns the thread.
                Waiting::Turn(granted) => drop(granted.send(turn)),
                Waiting::Work(work) => return Some((turn, work)),
            }
        }
    }

    fn queues(&self) -> MutexGuard<'_, Queues> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Queue {
    /// Adds work of a tenant. A tenant without waiting work is served last.
    fn add(&mut self, tenant: Tenant, work: Waiting) {
        match self.waiting.get_mut(&tenant) {
            Some(own) => own.push_back(work),
            None => {
                self.order.push_back(tenant.clone());
                self.waiting.insert(tenant, VecDeque::from([work]));
            }
        }
    }

    /// Takes the next work: the first of the tenant that has waited longest for its turn.
    fn take(&mut self) -> Option<Waiting> {
        let tenant = self.order.pop_front()?;
        let own = self.waiting.get_mut(&tenant)?;
        let work = own.pop_front();
        if own.is_empty() {
            self.waiting.remove(&tenant);
        } else {
            self.order.push_back(tenant);
        }
        work
    }

    /// Removes work whose caller has gone from the front, until a caller waits for the next work.
    fn drop_left(&mut self) {
        while let Some(tenant) = self.order.front() {
            let Some(own) = self.waiting.get_mut(tenant) else { return };
            while own.front().is_some_and(|work| work.is_left()) {
                own.pop_front();
            }
            if !own.is_empty() {
                return;
            }
            self.waiting.remove(tenant);
            self.order.pop_front();
        }
    }
}

impl Queues {
    fn enter(&mut self, lane: Lane, tenant: Tenant, waiting: Waiting) {
        let now_s = self.now_s;
        let queue = &mut self.queues[lane as usize];
        if queue.order.is_empty() && queue.running == 0 {
            queue.used_s = queue.used_s.max(now_s);
        }
        queue.add(tenant, waiting);
    }

    /// The next work, if a thread is free for it.
    fn next(&mut self) -> Option<(Lane, Waiting)> {
        self.queues.iter_mut().for_each(Queue::drop_left);
        if self.free == 0 {
            return None;
        }
        let queue = |lane: &Lane| &self.queues[*lane as usize];
        let can_run =
            |lane: &Lane| !queue(lane).order.is_empty() && queue(lane).running < queue(lane).most;
        let by_used = |a: &Lane, b: &Lane| queue(a).used_s.total_cmp(&queue(b).used_s);
        let lane = LANES.into_iter().filter(can_run).min_by(by_used)?;
        let queue = &mut self.queues[lane as usize];
        let waiting = queue.take()?;
        queue.running += 1;
        self.free -= 1;
        self.now_s = self.now_s.max(queue.used_s);
        Some((lane, waiting))
    }

    fn leave(&mut self, lane: Lane, used: Duration) {
        let queue = &mut self.queues[lane as usize];
        queue.running -= 1;
        queue.used_s += used.as_secs_f64() / SHARES[lane as usize];
        self.free += 1;
    }
}

impl fmt::Debug for Turn {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Turn").field("lane", &self.lane).finish_non_exhaustive()
    }
}

impl Turn {
    /// Does work, and then the next work on the same thread, because it takes time to wake another
    /// thread.
    fn work(self, work: Box<dyn Work>) {
        let mut next = Some((self, work));
        while let Some((turn, work)) = next {
            work.compute();
            let lanes = turn.lanes.clone();
            turn.end();
            next = lanes.next_work();
        }
    }

    /// Returns the thread. The caller then asks for the next work itself.
    fn end(mut self) {
        self.serves_next = false;
    }
}

impl Drop for Turn {
    fn drop(&mut self) {
        self.lanes.queues().leave(self.lane, self.begun.elapsed());
        if self.serves_next {
            self.lanes.serve();
        }
    }
}

#[cfg(test)]
mod tests {
    use std::future::Future;
    use std::pin::pin;
    use std::task::{Context, Poll, Waker};

    use super::*;

    fn now<F: Future>(future: F) -> Option<F::Output> {
        match pin!(future).poll(&mut Context::from_waker(Waker::noop())) {
            Poll::Ready(output) => Some(output),
            Poll::Pending => None,
        }
    }

    fn own() -> Tenant {
        Tenant::operator()
    }

    /// Keeps work waiting in all lanes; returns how many of `turns` each lane had.
    fn served(lanes: &Lanes, turns: usize) -> [usize; 4] {
        let mut waiting: Vec<_> =
            LANES.iter().map(|lane| Box::pin(lanes.turn(*lane, own()))).collect();
        let mut counts = [0; 4];
        for index in (0..LANES.len()).cycle() {
            let Some(mut turn) = now(waiting[index].as_mut()) else { continue };
            counts[index] += 1;
            if counts.iter().sum::<usize>() == turns {
                break;
            }
            // The lane waits again before the thread is free; each quantum takes 10 ms.
            waiting[index] = Box::pin(lanes.turn(LANES[index], own()));
            assert!(now(waiting[index].as_mut()).is_none());
            turn.begun -= Duration::from_millis(10);
        }
        counts
    }

    #[test]
    fn lanes_have_their_shares() {
        let [real_time, restore, on_demand, batch] = served(&Lanes::new(1), 1400);
        assert!((780..=820).contains(&real_time), "{real_time} of 800");
        assert!((380..=420).contains(&restore), "{restore} of 400");
        assert!((90..=110).contains(&on_demand), "{on_demand} of 100");
        assert!((90..=110).contains(&batch), "{batch} of 100");
    }

    #[test]
    fn a_lane_that_was_empty_has_no_claim_to_the_past() {
        let lanes = Lanes::new(1);
        for _ in 0..100 {
            let mut turn = now(lanes.turn(Lane::RealTime, own())).unwrap();
            turn.begun -= Duration::from_secs(1);
        }
        let turn = now(lanes.turn(Lane::RealTime, own())).unwrap();
        let (mut late, mut next) = (
            Box::pin(lanes.turn(Lane::OnDemand, own())),
            Box::pin(lanes.turn(Lane::RealTime, own())),
        );
        assert!(now(late.as_mut()).is_none() && now(next.as_mut()).is_none());
        drop(turn);
        let mut turn = now(late.as_mut()).unwrap();
        turn.begun -= Duration::from_secs(1);
        drop(turn);
        for _ in 0..8 {
            let mut turn = now(next.as_mut()).unwrap();
            turn.begun -= Duration::from_millis(100);
            late = Box::pin(lanes.turn(Lane::OnDemand, own()));
            next = Box::pin(lanes.turn(Lane::RealTime, own()));
            assert!(now(late.as_mut()).is_none() && now(next.as_mut()).is_none());
        }
    }

    #[test]
    fn a_caller_that_goes_loses_no_thread() {
        let lanes = Lanes::new(1);
        let turn = now(lanes.turn(Lane::RealTime, own())).unwrap();
        let mut gone = Box::pin(lanes.turn(Lane::RealTime, own()));
        let mut granted = Box::pin(lanes.turn(Lane::RealTime, own()));
        assert!(now(gone.as_mut()).is_none() && now(granted.as_mut()).is_none());
        drop(gone);
        drop(turn);
        // Granted, but never taken.
        drop(granted);
        assert!(now(lanes.turn(Lane::RealTime, own())).is_some());
    }

    #[test]
    fn computations_on_request_leave_a_thread_to_others() {
        let lanes = Lanes::new(2);
        let _first = now(lanes.turn(Lane::OnDemand, own())).unwrap();
        assert!(now(lanes.turn(Lane::OnDemand, own())).is_none());
        assert!(now(lanes.turn(Lane::RealTime, own())).is_some());
    }

    /// A tenant with more work does not get more turns.
    #[test]
    fn tenants_take_turns() {
        let lanes = Lanes::new(1);
        let (few, many) = (Tenant::parse("few").unwrap(), Tenant::parse("many").unwrap());
        let turn = now(lanes.turn(Lane::RealTime, many.clone())).unwrap();
        let work = |tenant: &Tenant| {
            let mut work = Box::pin(lanes.turn(Lane::RealTime, tenant.clone()));
            assert!(now(work.as_mut()).is_none());
            work
        };
        let mut of_many: Vec<_> = (0..10).map(|_| work(&many)).collect();
        let mut of_few: Vec<_> = (0..2).map(|_| work(&few)).collect();
        let mut served = Vec::new();
        let mut present = Some(turn);
        for _ in 0..6 {
            drop(present.take());
            for (name, works) in [("many", &mut of_many), ("few", &mut of_few)] {
                let next = works.first_mut().and_then(|work| now(work.as_mut()));
                if let Some(turn) = next {
                    drop(works.remove(0));
                    served.push(name);
                    present = Some(turn);
                }
            }
        }
        assert_eq!(served, ["many", "few", "many", "few", "many", "many"]);
    }
}
