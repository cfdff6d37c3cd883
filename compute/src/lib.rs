//! The part of Graphfix that computes: observations in, positions out; no server, no database.
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
//! | [`recording`] | files of a rover and its base, positioned together |
//!
//! [`gnss`], [`models`], [`graph`], [`lambda`], [`snapshot`], [`positioning`], [`formats`] and
//! [`reception`] only compute: no clock, no file, no network, and the same input gives the same
//! bits. `ARCHITECTURE.md` has all invariants and which module may name which.

pub mod gnss;

pub mod refusal;

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

pub mod recording;
