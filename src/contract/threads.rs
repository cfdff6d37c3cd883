//! Keeps long computations off the threads that serve the network.

use tokio::runtime::{Handle, RuntimeFlavor};
use tokio::task::{block_in_place, spawn_blocking};

use crate::refusal::Code;

use super::{Lease, Refusal};

/// Messages up to this size are decoded on the thread that received them (bytes).
const SHORT_BYTES: usize = 64 << 10;

/// Runs `work` on a blocking thread. The work keeps the lease of the request until it is done, even
/// if the caller has disconnected.
///
/// # Errors
/// It panicked.
pub(crate) async fn in_background<T: Send + 'static>(
    work: impl FnOnce() -> T + Send + 'static,
) -> Result<T, Refusal> {
    let lease = Lease::current();
    let done = spawn_blocking(move || {
        let _lease = lease;
        work()
    });
    let done = done.await;
    done.map_err(|panic| Refusal::new(Code::Internal, panic.to_string()))
}

/// Runs `work`, which processes `bytes` bytes. If they are many, the runtime first moves the other
/// tasks of this thread to another thread.
pub(crate) fn off_the_network<T>(bytes: usize, work: impl FnOnce() -> T) -> T {
    let is_movable =
        || Handle::try_current().is_ok_and(|at| at.runtime_flavor() == RuntimeFlavor::MultiThread);
    if SHORT_BYTES < bytes && is_movable() { block_in_place(work) } else { work() }
}

/// Shows whether the thread that serves the network is free while a message is encoded.
#[cfg(test)]
pub(crate) mod probe {
    use std::future::Future;
    use std::sync::atomic::{AtomicBool, Ordering};
    use std::sync::mpsc::{Receiver, channel};
    use std::sync::{Arc, Mutex};
    use std::time::Duration;

    use bytes::{Buf, BufMut};
    use prost::encoding::{DecodeContext, WireType};
    use prost::{DecodeError, Message};
    use serde::{Serialize, Serializer};

    use super::SHORT_BYTES;

    /// Time that an encoding waits for the other task.
    const PATIENCE: Duration = Duration::from_millis(500);

    /// A message whose encoding ends when another task of the runtime has run, or after some time.
    #[derive(Debug, Default)]
    pub(crate) struct Probe {
        bytes: usize,
        other: Option<Mutex<Receiver<()>>>,
        was_served: Arc<AtomicBool>,
    }

    impl Probe {
        fn wait(&self) {
            let other = self.other.as_ref().expect("it is made by `is_served_during`");
            let served = other.lock().unwrap().recv_timeout(PATIENCE).is_ok();
            self.was_served.store(served, Ordering::SeqCst);
        }
    }

    impl Serialize for Probe {
        fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
            self.wait();
            serializer.serialize_unit()
        }
    }

    impl Message for Probe {
        fn encode_raw(&self, buffer: &mut impl BufMut) {
            self.wait();
            buffer.put_bytes(0, self.bytes);
        }

        fn merge_field(
            &mut self,
            _: u32,
            _: WireType,
            _: &mut impl Buf,
            _: DecodeContext,
        ) -> Result<(), DecodeError> {
            Ok(())
        }

        fn encoded_len(&self) -> usize {
            self.bytes
        }

        fn clear(&mut self) {}
    }

    /// Whether another task runs while `encode` encodes a long message, and a short one, in a
    /// runtime with one thread for the network.
    pub(crate) fn is_served_during<F: Future<Output = ()> + Send + 'static>(
        encode: fn(Probe) -> F,
    ) -> [bool; 2] {
        let runtime = tokio::runtime::Builder::new_multi_thread();
        let runtime = { runtime }.worker_threads(1).build().unwrap();
        [SHORT_BYTES + 1, SHORT_BYTES].map(|bytes| {
            let (sender, other) = channel();
            let was_served = Arc::new(AtomicBool::new(false));
            let probe =
                Probe { bytes, other: Some(Mutex::new(other)), was_served: was_served.clone() };
            let encoding = runtime.spawn(async move {
                // Err: the encoding no longer waits.
                tokio::spawn(async move { sender.send(()).ok() });
                encode(probe).await;
            });
            runtime.block_on(encoding).unwrap();
            was_served.load(Ordering::SeqCst)
        })
    }
}
