//! Bytes to vocabulary and back. Takes readers and writers, opens nothing.

pub mod csv;
mod decimal;
pub mod geojson;
pub mod pos;
pub mod truth;
