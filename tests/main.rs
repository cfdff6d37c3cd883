//! The integration tests, one binary: goldens on real data, doors, and the architecture itself.

#![allow(clippy::unwrap_used, reason = "a test that panics says what went wrong")]

mod antennas;
mod archives;
mod base_files;
mod base_positions;
mod bases;
mod casters;
mod clients;
mod compare;
mod crash;
mod data;
mod database;
mod doors;
mod drive;
mod ekf;
mod errors;
mod evaluation;
mod feeds;
mod fgo;
mod grpc;
mod http;
mod models;
mod nearest;
mod network_casters;
mod networks;
mod odometry;
mod pair;
mod raw;
mod recording;
mod restoring;
mod rinex;
mod robustness;
mod rtcm;
mod rtk;
mod sessions;
mod simulation;
mod slips;
mod snapshot;
mod spp;
mod store;
mod streams;
mod windows;

mod tidy;
mod ubx;
