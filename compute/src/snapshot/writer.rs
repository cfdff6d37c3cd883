//! Values to bytes.

/// Bytes of the hash at the end.
pub(super) const HASH: usize = 8;

/// Writes a snapshot.
#[derive(Debug)]
pub struct SnapshotWriter {
    bytes: Vec<u8>,
}

impl SnapshotWriter {
    /// One of `layout`, with nothing in it yet.
    pub fn new(layout: u16) -> Self {
        Self::within(layout, Vec::new())
    }

    /// The same in the memory of a buffer, whose content is dropped.
    pub fn within(layout: u16, mut buffer: Vec<u8>) -> Self {
        buffer.clear();
        buffer.extend_from_slice(&layout.to_le_bytes());
        Self { bytes: buffer }
    }

    /// One byte.
    #[inline]
    pub fn u8(&mut self, value: u8) {
        self.bytes.push(value);
    }

    /// An integer, small ones in few bytes.
    #[inline]
    pub fn unsigned(&mut self, mut value: u64) {
        while 0x80 <= value {
            self.bytes.push(value as u8 | 0x80);
            value >>= 7;
        }
        self.bytes.push(value as u8);
    }

    /// A number, bit by bit.
    #[inline]
    pub fn f64(&mut self, value: f64) {
        self.bytes.extend_from_slice(&value.to_le_bytes());
    }

    /// Bytes of another form, preceded by their length.
    pub fn bytes(&mut self, bytes: &[u8]) {
        self.unsigned(bytes.len() as u64);
        self.bytes.extend_from_slice(bytes);
    }

    /// Number of bytes so far.
    pub const fn size(&self) -> usize {
        self.bytes.len()
    }

    /// The snapshot.
    pub fn finish(self) -> Vec<u8> {
        seal(self.bytes)
    }

    /// The snapshot without its hash, for bytes that do not leave the memory of the process.
    /// [`seal`] makes it a snapshot that may.
    pub fn finish_unsealed(self) -> Vec<u8> {
        self.bytes
    }
}

/// Adds its hash to an unsealed snapshot.
pub fn seal(mut unsealed: Vec<u8>) -> Vec<u8> {
    let hash = blake3::hash(&unsealed);
    unsealed.extend_from_slice(&hash.as_bytes()[..HASH]);
    unsealed
}
