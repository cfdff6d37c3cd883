//! The integration tests, one binary, by kind: truth, doors, faults, invariance, oracles, and the
//! architecture itself.

#![allow(clippy::unwrap_used, reason = "a test that panics says what went wrong")]

mod doors;
mod faults;
mod goldens;
mod invariance;
mod oracles;
mod support;
mod tidy;
