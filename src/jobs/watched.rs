//! The inputs of a run, read within the limits of unpacking.

use std::fs::File;
use std::io::{self, BufRead, BufReader, Read};
use std::os::unix::fs::FileExt;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};

use crate::formats::{UnpackError, read_block, unpack_error, unpack_reader_within};
use crate::recording::{Input, RecordingError};

use super::Failure;
use super::request::Part;

const READ_BUFFER_BYTES: usize = 1 << 16;

/// The reports of the readers of the inputs.
#[derive(Clone, Default)]
pub(super) struct Watched(Arc<Reports>);

#[derive(Default)]
struct Reports {
    /// The part that exceeds the limits of unpacking, and how.
    fault: OnceLock<(String, UnpackError)>,
    /// Bytes that each reader of the rover's file has read.
    readers: Mutex<Vec<Arc<AtomicU64>>>,
}

impl Watched {
    /// An input that is read from its first byte each time, within the limits of unpacking.
    pub(super) fn input(&self, file: Arc<File>, limit: u64, part: Part, name: &str) -> Input {
        let (watched, named) = (self.clone(), name.to_owned());
        let open = move || {
            let reader = watched.open(file.clone(), limit, part, named.clone())?;
            Ok(Box::new(reader) as Box<dyn BufRead>)
        };
        Input::unpacked(name.to_owned(), open)
    }

    /// Opens an input within the limits of unpacking.
    fn open(
        &self,
        file: Arc<File>,
        limit: u64,
        part: Part,
        name: String,
    ) -> io::Result<impl BufRead + use<>> {
        let length = file.metadata()?.len();
        let read = Arc::<AtomicU64>::default();
        if part == Part::Rover {
            self.readers().push(read.clone());
        }
        let file = BufReader::with_capacity(READ_BUFFER_BYTES, Counted { file, at: 0, read });
        let input = unpack_reader_within(file, length, limit)?;
        Ok(Noting { input, reports: self.0.clone(), name })
    }

    /// The failure of a job whose recording fails.
    pub(super) fn failure(&self, error: &RecordingError) -> Failure {
        match self.0.fault.get() {
            Some((part, fault)) => Failure::of_unpacking(*fault, part),
            None => Failure::of_recording(error),
        }
    }

    /// Bytes that the rover's reader has read. The file is opened several times; readers that are
    /// no longer in use are ignored.
    pub(super) fn rover_bytes(&self) -> u64 {
        let mut readers = self.readers();
        readers.retain(|read| 1 < Arc::strong_count(read));
        readers.iter().map(|read| read.load(Ordering::Acquire)).max().unwrap_or(0)
    }

    fn readers(&self) -> MutexGuard<'_, Vec<Arc<AtomicU64>>> {
        self.0.readers.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// A file, read from its first byte, that counts the bytes read. Other readers may read it, too.
struct Counted {
    file: Arc<File>,
    at: u64,
    read: Arc<AtomicU64>,
}

impl Read for Counted {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let count = self.file.read_at(buffer, self.at)?;
        self.at += count as u64;
        self.read.fetch_add(count as u64, Ordering::AcqRel);
        Ok(count)
    }
}

/// A reader that records why unpacking ended.
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
        read_block(self, buffer)
    }
}
