//! Comparisons with independent programs. `lambda` is a crate of its own: see its Cargo.toml.

mod evaluation;
mod frames;
mod gnss_logger;
mod models;
mod openapi;
mod rtcm;
mod tracks;
mod ubx;
