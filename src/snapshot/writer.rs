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
        Self { bytes: layout.to_le_bytes().to_vec() }
    }

    /// One byte.
    pub fn u8(&mut self, value: u8) {
        self.bytes.push(value);
    }

    /// An integer, small ones in few bytes.
    pub fn unsigned(&mut self, mut value: u64) {
        while 0x80 <= value {
            self.bytes.push(value as u8 | 0x80);
            value >>= 7;
        }
        self.bytes.push(value as u8);
    }

    /// A number, bit by bit.
    pub fn f64(&mut self, value: f64) {
        self.bytes.extend_from_slice(&value.to_le_bytes());
    }

    /// Bytes of another form, preceded by their length.
    pub fn bytes(&mut self, bytes: &[u8]) {
        self.unsigned(bytes.len() as u64);
        self.bytes.extend_from_slice(bytes);
    }

    /// The snapshot.
    pub fn finish(mut self) -> Vec<u8> {
        let hash = blake3::hash(&self.bytes);
        self.bytes.extend_from_slice(&hash.as_bytes()[..HASH]);
        self.bytes
    }
}
