//! The integration tests, one binary: goldens on real data, doors, and the architecture itself.

#![allow(clippy::unwrap_used, reason = "a test that panics says what went wrong")]

mod data;
mod database;
mod evaluation;
mod models;
mod rinex;
mod sessions;
mod simulation;
mod spp;
mod store;

mod tidy;
