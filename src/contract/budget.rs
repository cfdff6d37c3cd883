//! The memory of all requests: one budget in bytes, from which each request has a lease.
//!
//! A lease is extended before memory is used: before a body is read, before it is unpacked, and
//! before a message is decoded. It ends with the request. A quarter of the budget is for small
//! requests only, so that large ones cannot keep devices from pushing their epochs.

use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, LazyLock, OnceLock};

use uuid::{Builder, Uuid};

use crate::clock::unix_ms;
use crate::config::IntakeLimits;
use crate::formats;
use crate::keys::Pass;
use crate::meters::Counter;
use crate::refusal::Code;
use crate::traces::Trace;

use super::Refusal;

/// Memory that every request uses besides its content (bytes).
const REQUEST_BYTES: usize = 4 << 10;
/// Largest memory of a small request (bytes).
const SMALL_BYTES: usize = 128 << 10;

tokio::task_local! {
    /// The lease of the request that the task serves.
    static CURRENT: Lease;
}

/// The memory that all requests share. All clones share it.
#[derive(Clone, Debug)]
pub struct Budget(Arc<Shared>);

#[derive(Debug)]
struct Shared {
    total: usize,
    used: AtomicUsize,
    limits: IntakeLimits,
    /// Bytes of all bodies that have arrived, as sent.
    arrived: Counter,
    /// Failures of the service that were logged.
    failures: Counter,
}

/// The memory of one request. It is returned when the last clone is dropped.
#[derive(Clone, Debug)]
pub(crate) struct Lease(Arc<Leased>);

#[derive(Debug)]
struct Leased {
    budget: Budget,
    reserved: AtomicUsize,
    /// Bytes of the body that have arrived, as sent.
    arrived: AtomicUsize,
    /// Bytes of a stream's body that have arrived and are not decoded yet.
    undecoded: AtomicUsize,
    /// Length of the last message that was decoded (bytes).
    message: AtomicUsize,
    /// Identifies the request in answers and in the log.
    id: Uuid,
    /// The sender; `None` if no key is needed.
    pass: Option<Pass>,
    /// The trace of the request, if it is traced.
    trace: OnceLock<Arc<Trace>>,
    /// Id of the session that the request names, for the log.
    session: OnceLock<Box<str>>,
}

impl Budget {
    /// A budget of `total` bytes for requests with these limits.
    pub(crate) fn new(total: usize, limits: IntakeLimits) -> Self {
        Self(Arc::new(Shared {
            total,
            used: AtomicUsize::new(0),
            limits,
            arrived: Counter::default(),
            failures: Counter::default(),
        }))
    }

    /// The lease of a request of `pass` that begins now.
    ///
    /// # Errors
    /// The budget is exhausted.
    pub(crate) fn lease(&self, pass: Option<Pass>) -> Result<Lease, Refusal> {
        let lease = self.empty_lease(pass);
        lease.reserve(REQUEST_BYTES)?;
        Ok(lease)
    }

    /// The lease of a request that is refused and uses no memory. It gives the answer and the log
    /// its id.
    pub(crate) fn empty_lease(&self, pass: Option<Pass>) -> Lease {
        Lease(Arc::new(Leased {
            budget: self.clone(),
            reserved: AtomicUsize::new(0),
            arrived: AtomicUsize::new(0),
            undecoded: AtomicUsize::new(0),
            message: AtomicUsize::new(0),
            id: request_id(),
            pass,
            trace: OnceLock::new(),
            session: OnceLock::new(),
        }))
    }

    /// Bytes of all bodies that have arrived, as sent.
    pub(super) fn arrived(&self) -> &Counter {
        &self.0.arrived
    }

    /// Failures of the service that were logged.
    pub(super) fn failures(&self) -> &Counter {
        &self.0.failures
    }

    /// Bytes in use.
    pub fn used(&self) -> usize {
        self.0.used.load(Ordering::Acquire)
    }

    /// Size of the budget (bytes).
    pub(super) fn total(&self) -> usize {
        self.0.total
    }

    /// The part of the budget that large requests may use (bytes).
    fn of_large(&self) -> usize {
        self.0.total - self.0.total / 4
    }
}

impl Lease {
    /// The lease of the request that the present task serves; none outside a door.
    pub(crate) fn current() -> Option<Self> {
        CURRENT.try_with(Self::clone).ok()
    }

    /// Runs `work` with this as [`Lease::current`].
    pub(crate) async fn scope<F: Future>(self, work: F) -> F::Output {
        CURRENT.scope(self, work).await
    }

    /// Like [`Self::scope`], for work that does not wait.
    pub(crate) fn during<T>(&self, work: impl FnOnce() -> T) -> T {
        CURRENT.sync_scope(self.clone(), work)
    }

    /// The id of the request.
    pub(crate) fn request_id(&self) -> Uuid {
        self.0.id
    }

    /// The sender of the request; `None` if no key is needed.
    pub(crate) fn pass(&self) -> Option<&Pass> {
        self.0.pass.as_ref()
    }

    /// Counts a failure of the service.
    pub(super) fn count_failure(&self) {
        self.0.budget.0.failures.inc();
    }

    /// Notes that the request is traced.
    pub(crate) fn set_trace(&self, trace: Trace) {
        // Err: the request already has a trace, which stays.
        self.0.trace.set(Arc::new(trace)).ok();
    }

    /// Notes the session that the request names.
    pub(crate) fn set_session(&self, id: &str) {
        // Err: the request names another session, too. The first one, from its path, stays.
        self.0.session.set(id.into()).ok();
    }

    /// Id of the session that the request names; `None` if it names none.
    pub(crate) fn session(&self) -> Option<&str> {
        self.0.session.get().map(|id| &**id)
    }

    /// The trace of the request; `None` if it is not traced.
    pub(crate) fn trace(&self) -> Option<&Arc<Trace>> {
        self.0.trace.get()
    }

    /// The limits on the content of a request.
    pub(crate) fn limits(&self) -> &IntakeLimits {
        &self.0.budget.0.limits
    }

    /// Adds `bytes` to the lease.
    ///
    /// # Errors
    /// The budget is exhausted, or the request alone exceeds it. Nothing is added.
    pub(crate) fn reserve(&self, bytes: usize) -> Result<(), Refusal> {
        let Leased { budget, reserved, .. } = &*self.0;
        let whole = reserved.load(Ordering::Acquire).saturating_add(bytes);
        let of_large = budget.of_large();
        if of_large < whole {
            let message = format!("the request needs {whole} bytes of memory, at most {of_large}");
            return Err(Refusal::new(Code::BodyTooLarge, message));
        }
        let limit = if whole <= SMALL_BYTES { budget.0.total } else { of_large };
        let add = |used: usize| used.checked_add(bytes).filter(|used| *used <= limit);
        if budget.0.used.fetch_update(Ordering::AcqRel, Ordering::Acquire, add).is_err() {
            let message = format!("all requests together use {} bytes of memory", budget.used());
            return Err(Refusal::new(Code::MemoryExhausted, message));
        }
        reserved.fetch_add(bytes, Ordering::AcqRel);
        Ok(())
    }

    /// Returns everything that is reserved beyond `bytes`, because that memory is free again.
    pub(crate) fn shrink_to(&self, bytes: usize) {
        let Leased { budget, reserved, .. } = &*self.0;
        let before = reserved.fetch_min(bytes, Ordering::AcqRel);
        budget.0.used.fetch_sub(before.saturating_sub(bytes), Ordering::AcqRel);
    }

    /// Whether memory is short. A stream then reads no further message until its earlier messages
    /// are answered.
    pub(crate) fn is_short(&self) -> bool {
        let budget = &self.0.budget;
        budget.total() / 2 < budget.used()
    }

    /// Reserves memory for bytes of a stream's body that have arrived.
    ///
    /// # Errors
    /// The budget is exhausted.
    pub(crate) fn arrive_undecoded(&self, bytes: usize) -> Result<(), Refusal> {
        self.reserve(bytes)?;
        self.0.undecoded.fetch_add(bytes, Ordering::AcqRel);
        Ok(())
    }

    /// Notes that a message was decoded: its length, and the bytes that it took in the body.
    pub(crate) fn note_decoded(&self, length: usize, in_body: usize) {
        let rest = |undecoded: usize| Some(undecoded.saturating_sub(in_body));
        // Err: never, as the closure always gives a value.
        self.0.undecoded.fetch_update(Ordering::AcqRel, Ordering::Acquire, rest).ok();
        self.0.message.store(length, Ordering::Release);
    }

    /// Length of the last message that was decoded (bytes).
    pub(crate) fn last_message(&self) -> usize {
        self.0.message.load(Ordering::Acquire)
    }

    /// Sets the memory of a stream to `in_flight` bytes, and the bytes that are not decoded yet.
    ///
    /// # Errors
    /// It has less memory, and the budget is exhausted.
    pub(crate) fn settle(&self, in_flight: usize) -> Result<(), Refusal> {
        let whole = REQUEST_BYTES + self.0.undecoded.load(Ordering::Acquire) + in_flight;
        self.shrink_to(whole);
        let missing = whole.saturating_sub(self.0.reserved.load(Ordering::Acquire));
        if missing == 0 { Ok(()) } else { self.reserve(missing) }
    }

    /// Counts bytes of the body that have arrived.
    pub(crate) fn arrive(&self, bytes: usize) {
        self.0.arrived.fetch_add(bytes, Ordering::AcqRel);
        self.0.budget.0.arrived.inc_by(bytes as u64);
    }

    /// Bytes of the body that have arrived, as sent.
    pub(crate) fn arrived(&self) -> usize {
        self.0.arrived.load(Ordering::Acquire)
    }

    /// Checks the ratio of unpacked content to the bytes that have arrived.
    ///
    /// # Errors
    /// [`Code::CompressedTooMuch`].
    pub(crate) fn check_ratio(&self, unpacked: usize) -> Result<(), Refusal> {
        check_ratio(self.arrived(), unpacked)
    }
}

impl Drop for Leased {
    fn drop(&mut self) {
        self.budget.0.used.fetch_sub(*self.reserved.get_mut(), Ordering::AcqRel);
    }
}

/// An id for a request: a UUID of version 7. Its random part is chosen once and then counted up
/// (RFC 9562, section 6.2, method 2), because random bits for each request would be a system call.
fn request_id() -> Uuid {
    static BEGIN: LazyLock<([u8; 10], AtomicU64)> = LazyLock::new(|| {
        let [random @ .., _, _, _, _, _, _] = Uuid::new_v4().into_bytes();
        let (_, count) = Uuid::new_v4().as_u64_pair();
        (random, AtomicU64::new(count))
    });
    let (mut random, count) = (BEGIN.0, BEGIN.1.fetch_add(1, Ordering::Relaxed));
    let [_, _, lowest @ ..] = count.to_be_bytes();
    random[4..].copy_from_slice(&lowest);
    Builder::from_unix_timestamp_millis(unix_ms() as u64, &random).into_uuid()
}

/// Checks the ratio of unpacked to packed content.
///
/// # Errors
/// [`Code::CompressedTooMuch`].
pub(crate) fn check_ratio(packed: usize, unpacked: usize) -> Result<(), Refusal> {
    Ok(formats::check_ratio(packed as u64, unpacked as u64)?)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn budget(total: usize) -> Budget {
        let limits =
            IntakeLimits { epochs_per_push: 1, satellites_per_epoch: 1, observations_per_epoch: 1 };
        Budget::new(total, limits)
    }

    #[test]
    fn large_requests_leave_a_quarter_to_small_ones() {
        let budget = budget(16 << 20);
        let large: Vec<Lease> = (0..3).map(|_| budget.lease(None).unwrap()).collect();
        for lease in &large {
            lease.reserve((4 << 20) - REQUEST_BYTES).unwrap();
        }
        let late = budget.lease(None).unwrap();
        let refusal = late.reserve(1 << 20).unwrap_err();
        assert_eq!(refusal.code, Code::MemoryExhausted);
        assert!(refusal.retry_after.is_some());
        late.reserve(SMALL_BYTES - REQUEST_BYTES).unwrap();
        drop((large, late));
        assert_eq!(budget.used(), 0);
    }

    #[test]
    fn what_is_returned_is_free_for_others() {
        let budget = budget(16 << 20);
        let (one, other) = (budget.lease(None).unwrap(), budget.lease(None).unwrap());
        one.reserve(11 << 20).unwrap();
        assert_eq!(other.reserve(11 << 20).unwrap_err().code, Code::MemoryExhausted);
        one.shrink_to(1 << 20);
        one.shrink_to(2 << 20); // It has less.
        assert_eq!(budget.used(), (1 << 20) + REQUEST_BYTES);
        other.reserve(10 << 20).unwrap();
        drop((one, other));
        assert_eq!(budget.used(), 0);
    }

    /// The bytes of a message are given back when it is decoded, its epochs when they are answered.
    #[test]
    fn a_stream_keeps_the_memory_of_what_is_on_its_way() {
        let budget = budget(16 << 20);
        let lease = budget.lease(None).unwrap();
        lease.arrive_undecoded(1000).unwrap();
        lease.reserve(5000).unwrap(); // Decoding one of 595 bytes and a prefix.
        lease.note_decoded(595, 600);
        lease.settle(3000).unwrap();
        assert_eq!((lease.last_message(), budget.used()), (595, REQUEST_BYTES + 400 + 3000));
        lease.settle(4000).unwrap();
        lease.note_decoded(395, 400);
        lease.settle(0).unwrap();
        assert_eq!(budget.used(), REQUEST_BYTES);
    }

    #[test]
    fn ids_of_requests_differ_and_have_the_time() {
        let ids: std::collections::HashSet<Uuid> = (0..10_000).map(|_| request_id()).collect();
        assert_eq!(ids.len(), 10_000);
        let id = request_id();
        assert_eq!((id.get_version_num(), id.get_variant()), (7, uuid::Variant::RFC4122));
        let (unix_s, _) = id.get_timestamp().unwrap().to_unix();
        assert!(unix_s.abs_diff(unix_ms() as u64 / 1_000) <= 1);
    }

    #[test]
    fn a_request_that_never_fits_is_too_large() {
        let lease = budget(16 << 20).lease(None).unwrap();
        assert_eq!(lease.reserve(13 << 20).unwrap_err().code, Code::BodyTooLarge);
        assert_eq!(lease.reserve(usize::MAX).unwrap_err().code, Code::BodyTooLarge);
    }

    #[test]
    fn packed_content_has_a_largest_ratio() {
        assert!(check_ratio(10, 1 << 20).is_ok());
        assert!(check_ratio(20_000, 2_000_000).is_ok());
        let refusal = check_ratio(16_000, 2_000_000).unwrap_err();
        assert_eq!(refusal.code, Code::CompressedTooMuch);
    }
}
