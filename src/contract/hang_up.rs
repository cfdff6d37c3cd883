//! Requests whose callers disconnect: work that has begun is finished. Its memory is returned to
//! the budget only when it is really free.

use std::future::Future;
use std::pin::Pin;
use std::task::{Context, Poll, ready};

use tokio::runtime::Handle;

use super::Lease;

/// Work that is finished even if nobody waits for it any more.
struct Finished<T: Send + 'static> {
    /// The work; `None` when it is done.
    work: Option<Pin<Box<dyn Future<Output = T> + Send>>>,
    lease: Option<Lease>,
}

/// Runs `work`, which passes data of the request on to desks. If the returned future is dropped, a
/// task finishes the work, with the lease of the request.
pub(crate) async fn finished<T: Send + 'static>(
    work: impl Future<Output = T> + Send + 'static,
) -> T {
    Finished { work: Some(Box::pin(work)), lease: Lease::current() }.await
}

impl<T: Send + 'static> Future for Finished<T> {
    type Output = T;

    fn poll(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<T> {
        let work = self.work.as_mut().expect("a future is not polled once it is ready");
        let done = ready!(work.as_mut().poll(context));
        self.work = None;
        Poll::Ready(done)
    }
}

impl<T: Send + 'static> Drop for Finished<T> {
    fn drop(&mut self) {
        let (Some(work), lease) = (self.work.take(), self.lease.take()) else { return };
        // Err: the runtime has ended, so nothing can be finished.
        if let Ok(runtime) = Handle::try_current() {
            runtime.spawn(async move {
                work.await;
                drop(lease);
            });
        }
    }
}

#[cfg(test)]
mod tests {
    use tokio::sync::oneshot;

    use crate::config::IntakeLimits;
    use crate::contract::Budget;

    use super::*;

    fn budget() -> Budget {
        let limits =
            IntakeLimits { epochs_per_push: 1, satellites_per_epoch: 1, observations_per_epoch: 1 };
        Budget::new(16 << 20, limits)
    }

    /// When a caller disconnects, its memory stays in use until the work is done.
    #[tokio::test]
    async fn memory_is_returned_when_it_is_free() {
        let budget = budget();
        let lease = budget.lease(None).unwrap();
        lease.reserve(1 << 20).unwrap();
        let ((done, is_done), (answered, answer)) = (oneshot::channel::<()>(), oneshot::channel());
        let work = async move {
            is_done.await.ok();
            answered.send(()).ok();
        };
        let mut call = Box::pin(lease.scope(finished(work)));
        assert!(futures::poll!(&mut call).is_pending());
        drop(call);
        tokio::task::yield_now().await;
        assert!(1 << 20 < budget.used());
        done.send(()).unwrap();
        answer.await.unwrap();
        while 0 < budget.used() {
            tokio::task::yield_now().await;
        }
    }

    /// The same for work on a blocking thread.
    #[tokio::test]
    async fn memory_is_returned_when_a_thread_is_ready() {
        let budget = budget();
        let lease = budget.lease(None).unwrap();
        lease.reserve(1 << 20).unwrap();
        let (done, is_done) = std::sync::mpsc::channel::<()>();
        let work = crate::contract::in_background(move || is_done.recv().is_ok());
        let mut call = Box::pin(lease.scope(work));
        assert!(futures::poll!(&mut call).is_pending());
        drop(call);
        assert!(1 << 20 < budget.used());
        done.send(()).unwrap();
        while 0 < budget.used() {
            tokio::task::yield_now().await;
        }
    }
}
