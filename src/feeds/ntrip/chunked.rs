//! Decodes a chunked HTTP/1.1 body as it arrives.

/// Longest line with a chunk's size, including extensions (bytes).
const SIZE_LINE_LIMIT: usize = 256;
/// Most hexadecimal digits of a size: chunks are below 4 GiB.
const SIZE_DIGITS: usize = 8;

/// Which part of the body the next byte belongs to.
#[derive(Debug)]
enum Part {
    /// The line with the size. These bytes of it have arrived.
    Size(Vec<u8>),
    /// A chunk. This many of its bytes are missing.
    Content(u32),
    /// The line end after a chunk.
    LineEnd,
    /// The bytes after the last chunk.
    End,
}

/// Why a body is not validly chunked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Unchunked(pub(super) &'static str);

/// Extracts the content of a chunked body.
#[derive(Debug)]
pub(super) struct Unchunker {
    part: Part,
}

impl Unchunker {
    pub(super) const fn new() -> Self {
        Self { part: Part::Size(Vec::new()) }
    }

    /// Whether the last chunk has arrived.
    pub(super) const fn is_at_end(&self) -> bool {
        matches!(self.part, Part::End)
    }

    /// Appends the content in `bytes` to `content`.
    ///
    /// # Errors
    /// The body is not validly chunked.
    pub(super) fn push(&mut self, bytes: &[u8], content: &mut Vec<u8>) -> Result<(), Unchunked> {
        let mut rest = bytes;
        while let [first, after @ ..] = rest {
            match &mut self.part {
                Part::Size(line) => {
                    rest = after;
                    if *first == b'\n' {
                        let size = size_of(line)?;
                        self.part = if size == 0 { Part::End } else { Part::Content(size) };
                    } else if line.len() == SIZE_LINE_LIMIT {
                        return Err(Unchunked("the line of a chunk's size is too long"));
                    } else {
                        line.push(*first);
                    }
                }
                Part::Content(missing) => {
                    let length = rest.len().min(*missing as usize);
                    content.extend_from_slice(&rest[..length]);
                    rest = &rest[length..];
                    *missing -= length as u32;
                    if *missing == 0 {
                        self.part = Part::LineEnd;
                    }
                }
                Part::LineEnd => {
                    rest = after;
                    match first {
                        b'\r' => {}
                        b'\n' => self.part = Part::Size(Vec::new()),
                        _ => return Err(Unchunked("a chunk is longer than its stated size")),
                    }
                }
                // Trailers are not used.
                Part::End => return Ok(()),
            }
        }
        Ok(())
    }
}

fn size_of(line: &[u8]) -> Result<u32, Unchunked> {
    let digits = line.split(|byte| *byte == b';').next().unwrap_or_default().trim_ascii();
    let text = std::str::from_utf8(digits).ok().filter(|text| text.len() <= SIZE_DIGITS);
    let size = text.and_then(|text| u32::from_str_radix(text, 16).ok());
    size.ok_or(Unchunked("a chunk has no size"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn unchunked(body: &[u8], size: usize) -> Result<(Vec<u8>, bool), Unchunked> {
        let (mut unchunker, mut content) = (Unchunker::new(), Vec::new());
        for bytes in body.chunks(size) {
            unchunker.push(bytes, &mut content)?;
        }
        Ok((content, unchunker.is_at_end()))
    }

    #[test]
    fn chunks_are_joined_wherever_they_are_split() {
        let body = b"5\r\nhello\r\nA;name=value\r\n0123456789\r\n1\r\n\n\r\n0\r\n\r\n";
        for size in 1..body.len() {
            let (content, is_at_end) = unchunked(body, size).unwrap();
            assert_eq!((content.as_slice(), is_at_end), (&b"hello0123456789\n"[..], true));
        }
    }

    #[test]
    fn what_is_not_chunked_is_refused() {
        let long = [b"5;".as_slice(), &[b'x'; 400]].concat();
        for body in [&b"\r\n"[..], b"xyz\r\n", b"fffffffff\r\n", b"-1\r\n", b"2\r\nabc", &long] {
            assert!(unchunked(body, 7).is_err(), "{:?}", String::from_utf8_lossy(body));
        }
    }
}
