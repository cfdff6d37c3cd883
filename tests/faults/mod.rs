//! Faults: crashes, failing databases, hostile casters and clients, and receivers whose clock steps
//! or that lose satellites.

#[cfg(feature = "s3")]
mod buckets;
mod casters;
mod cluster;
mod crash;
mod database;
mod disk;
mod forged;
mod handshakes;
mod hostile;
mod jobs;
mod lease;
mod mutated;
mod navigation;
mod node_bases;
mod node_jobs;
mod node_keys;
mod nodes;
mod robustness;
mod server;
mod streams;
mod windows;
mod workers;
