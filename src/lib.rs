//! Graphfix positions GNSS receivers: raw observations in, stored solutions out.
//!
//! Modules in reading order, from the ground floor up; see `ARCHITECTURE.md` for the invariants.

pub mod clock;
pub mod config;
pub mod gnss;
pub mod id;
pub mod refusal;
pub mod snapshot;

pub mod formats;
pub mod graph;
pub mod lambda;
pub mod models;
pub mod simulation;

pub mod evaluation;
pub mod positioning;
pub mod reception;
pub mod store;

pub mod aiding;
pub mod feeds;
pub mod session;

pub mod contract;

pub mod cli;
pub mod grpc;
pub mod http;
