//! Lines of a byte stream, without a copy or an allocation per line.

use std::io::{ErrorKind, Read};

use super::RinexError;

/// Longest line (bytes): 999 observation types of 16 columns and their satellite, with room.
pub(super) const LINE_LIMIT: usize = 1 << 15;
const BUFFER_BYTES: usize = 1 << 16;

/// Splits the bytes of `input` into lines at `\n` or `\r\n`.
#[derive(Clone, Debug)]
pub(super) struct Lines<R> {
    input: R,
    buffer: Vec<u8>,
    /// Index of the current line's first byte, for [`Lines::unread`].
    current: usize,
    /// Index of the next line's first byte.
    next: usize,
    /// Index after the last valid byte.
    end: usize,
    number: u64,
    at_end: bool,
}

impl<R: Read> Lines<R> {
    pub(super) fn new(input: R) -> Self {
        let buffer = vec![0; BUFFER_BYTES];
        Self { input, buffer, current: 0, next: 0, end: 0, number: 0, at_end: false }
    }

    /// Number (from 1) of the current line, 0 before the first.
    pub(super) const fn number(&self) -> u64 {
        self.number
    }

    /// The source of the bytes.
    pub(super) const fn input(&self) -> &R {
        &self.input
    }

    /// The source of the bytes, to append to it.
    pub(super) const fn input_mut(&mut self) -> &mut R {
        &mut self.input
    }

    /// Number of bytes read from `input` that belong to no line yet.
    pub(super) const fn untaken(&self) -> usize {
        self.end - self.next
    }

    /// The next line without its end, or `None` after the last.
    pub(super) fn next(&mut self) -> Result<Option<&[u8]>, RinexError> {
        let mut searched = 0;
        loop {
            let unread = &self.buffer[self.next..self.end];
            if let Some(found) = memchr::memchr(b'\n', &unread[searched..]) {
                let length = searched + found;
                return self.take(length, length + 1);
            }
            searched = unread.len();
            if self.at_end {
                // After the end there is no line to return again.
                self.current = self.next;
                return if searched == 0 { Ok(None) } else { self.take(searched, searched) };
            }
            if LINE_LIMIT < searched {
                return Err(self.too_long());
            }
            self.refill()?;
        }
    }

    /// The current line; empty before the first and after the last.
    pub(super) fn current(&self) -> &[u8] {
        let line = &self.buffer[self.current..self.next];
        let line = line.strip_suffix(b"\n").unwrap_or(line);
        line.strip_suffix(b"\r").unwrap_or(line)
    }

    /// Makes `next` return the current line once more.
    pub(super) fn unread(&mut self) {
        if self.current < self.next {
            self.next = self.current;
            self.number -= 1;
        }
    }

    /// The first bytes of the stream; fewer only if the stream is shorter.
    pub(super) fn peek_start(&mut self) -> Result<&[u8], RinexError> {
        while self.end < 4 && !self.at_end {
            self.refill()?;
        }
        Ok(&self.buffer[..self.end.min(4)])
    }

    fn take(&mut self, length: usize, consumed: usize) -> Result<Option<&[u8]>, RinexError> {
        if LINE_LIMIT < length {
            return Err(self.too_long());
        }
        self.number += 1;
        self.current = self.next;
        self.next += consumed;
        let line = &self.buffer[self.current..self.current + length];
        Ok(Some(line.strip_suffix(b"\r").unwrap_or(line)))
    }

    fn too_long(&self) -> RinexError {
        RinexError::LineTooLong { line: self.number + 1, limit: LINE_LIMIT }
    }

    /// Moves the remaining bytes to the front and reads more after them.
    fn refill(&mut self) -> Result<(), RinexError> {
        self.buffer.copy_within(self.next..self.end, 0);
        self.end -= self.next;
        self.next = 0;
        self.current = 0;
        loop {
            match self.input.read(&mut self.buffer[self.end..]) {
                Ok(0) => self.at_end = true,
                Ok(count) => self.end += count,
                Err(error) if error.kind() == ErrorKind::Interrupted => continue,
                Err(source) => {
                    return Err(RinexError::ReadFailed { line: self.number + 1, source });
                }
            }
            return Ok(());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::refusal::Code;

    #[test]
    fn line_ends_of_both_kinds_and_none() {
        let mut lines = Lines::new(b"one\r\n\ntwo\nlast".as_slice());
        let mut seen = Vec::new();
        while let Some(line) = lines.next().unwrap() {
            seen.push(line.to_vec());
        }
        assert_eq!(seen, [b"one".as_slice(), b"", b"two", b"last"]);
        assert_eq!(lines.number(), 4);
        lines.unread();
        assert!(lines.next().unwrap().is_none(), "a line came again behind the end");
    }

    #[test]
    fn a_line_is_given_again_after_a_refill() {
        let text = "x"
            .repeat(40)
            .into_bytes()
            .repeat(10) // 400 bytes
            .into_iter()
            .chain(*b"\n")
            .collect::<Vec<_>>()
            .repeat(1000);
        let mut lines = Lines::new(text.as_slice());
        for number in 1..=1000 {
            assert_eq!(lines.next().unwrap().unwrap().len(), 400);
            lines.unread();
            assert_eq!(lines.next().unwrap().unwrap().len(), 400);
            assert_eq!(lines.number(), number);
        }
        assert!(lines.next().unwrap().is_none());
    }

    /// An input that fails, as a packed file that is cut off.
    struct Cut;

    impl Read for Cut {
        fn read(&mut self, _: &mut [u8]) -> std::io::Result<usize> {
            Err(ErrorKind::UnexpectedEof.into())
        }
    }

    #[test]
    fn a_failure_names_the_line_that_was_being_read() {
        let error = Lines::new(Cut).next().unwrap_err();
        assert_eq!((error.code(), error.line()), (Code::RinexReadFailed, 1));
        let mut lines = Lines::new(b"one\ntw".chain(Cut));
        assert_eq!(lines.next().unwrap(), Some(&b"one"[..]));
        assert_eq!(lines.next().unwrap_err().line(), 2);
    }

    #[test]
    fn endless_lines_are_refused() {
        let error = Lines::new(std::io::repeat(b'a')).next().unwrap_err();
        assert_eq!((error.code(), error.line()), (Code::RinexLineTooLong, 1));
    }
}
