//! Bytes to vocabulary and back; takes readers and writers, opens nothing.
