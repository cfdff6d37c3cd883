//! Graphfix positions GNSS receivers: raw observations in, stored solutions out.
//!
//! # The objective
//!
//! An estimator looks for the states x that explain best what was observed:
//!
//! x̂ = argmin over x of Σᵢ ρᵢ(rᵢ(x)),  rᵢ(x) = (hᵢ(x) − zᵢ)/σᵢ
//!
//! | symbol | what it is | module |
//! |---|---|---|
//! | zᵢ | an observation: pseudorange, carrier phase, Doppler, displacement | [`gnss`] |
//! | hᵢ | its model: satellite, signal path, atmosphere, electronics | [`models`] |
//! | σᵢ | its standard deviation, by elevation and C/N0 | `weights` in [`models`] |
//! | rᵢ | the whitened residual with its Jacobian, a *factor* | `factors` in [`positioning`] |
//! | ρᵢ | a robust kernel, which bounds the pull of a wrong observation | [`graph::kernel`] |
//! | x | position, velocity, clock of each epoch; ambiguities, biases | [`graph::estimate`] |
//! | argmin | Gauss–Newton on the normal equations | [`graph::optimizer`] |
//! | | their solution by block elimination | [`graph::elimination`] |
//! | | whole cycles for the ambiguities of x̂ | [`lambda`] |
//!
//! [`positioning::Estimator`] answers epoch by epoch, from that epoch and those before it;
//! [`positioning::Batch`] solves a whole recording at once.
//!
//! # The map, in reading order
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
//! [`gnss`], [`models`], [`graph`], [`lambda`], [`snapshot`], [`positioning`], [`formats`] and
//! [`reception`] only compute: no clock, no file, no network, and the same input gives the same
//! bits. `ARCHITECTURE.md` has all invariants and which module may name which.

pub mod gnss;

pub mod refusal;

pub mod id;
pub mod tenant;

pub mod config;

pub mod models;

pub mod graph;
pub mod lambda;

pub mod snapshot;

pub mod positioning;

pub mod formats;

pub mod simulation;

pub mod evaluation;

pub mod reception;

pub mod secrets;

pub mod store;

pub mod clock;
mod meters;

pub mod tls;

pub mod traces;

pub mod keys;
pub mod quotas;

pub mod aiding;

pub mod feeds;

pub mod cluster;

pub mod recording;

pub mod session;

pub mod jobs;

pub mod contract;

pub mod grpc;
pub mod http;

pub mod app;

pub mod cli;
