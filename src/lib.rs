//! Graphfix positions GNSS receivers: raw observations in, stored solutions out.
//!
//! # The map, in reading order
//!
//! The package `graphfix-compute` has all code that computes. Its modules are here under their
//! names. The page of the package begins with what an estimator computes.
//!
//! | module | what it is |
//! |---|---|
//! | [`gnss`] | the vocabulary: time, coordinates, observations, ephemerides, solutions |
//! | [`refusal`] | the codes of all refusals, each with its remedy |
//! | [`id`] | random identifiers of one kind each |
//! | [`config`] | options of estimators and service, each with name, unit, default and meaning |
//! | [`models`] | physics between a satellite and a receiver |
//! | [`graph`] | least squares on a chain of states with a border |
//! | [`lambda`] | integer least squares |
//! | [`snapshot`] | the state of a computation as bytes, and back with the same bits |
//! | [`positioning`] | the estimators |
//! | [`formats`] | bytes to vocabulary and back: RINEX, RTCM 3, UBX, GnssLogger, solution files |
//! | [`simulation`] | observations with known truth |
//! | [`evaluation`] | solutions against truth |
//! | [`reception`] | a receiver's stream of bytes into epochs and navigation data |
//! | [`store`] | the database |
//! | [`clock`] | the system clock |
//! | [`tls`] | the certificate of the service, and what clients trust |
//! | [`keys`] | API keys: who may call what |
//! | [`aiding`] | ephemerides and base stations, for all sessions |
//! | [`feeds`] | casters and archives, which fill `aiding` |
//! | [`recording`] | files of a rover and its base, positioned together |
//! | [`session`] | one task for each receiver: order, estimate, commit, answer |
//! | [`contract`] | the messages of both network interfaces and their error codes |
//! | [`grpc`], [`http`] | the network interfaces |
//! | [`app`] | opens a service by its configuration |
//! | [`cli`] | the command line |
//!
//! `ARCHITECTURE.md` has the invariants and which module may name which.

pub use graphfix_compute::{
    config, evaluation, formats, gnss, graph, lambda, models, positioning, reception, recording,
    refusal, simulation, snapshot,
};

pub mod id;
pub mod tenant;

pub mod secrets;

pub mod store;

pub mod clock;
mod meters;
mod panics;

pub mod tls;

pub mod traces;

pub mod keys;
pub mod quotas;

pub mod aiding;

pub mod feeds;

pub mod cluster;

pub mod session;

pub mod jobs;

pub mod contract;

pub mod grpc;
pub mod http;

pub mod app;

pub mod cli;
