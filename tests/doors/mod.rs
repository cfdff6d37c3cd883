//! The service from the view of its clients and its operator: REST, gRPC, streams, sessions, the
//! command line, and the store below them.

mod archives;
mod base_files;
mod base_positions;
mod bases;
mod clients;
mod compare;
mod errors;
mod feeds;
mod grpc;
mod http;
mod job_events;
mod jobs;
mod keys;
mod lifecycle;
mod load;
mod metrics;
mod nearest;
mod network_casters;
mod networks;
mod odometry;
mod operator_keys;
mod quotas;
mod raw;
mod retention;
mod session_antennas;
mod sessions;
mod sign_in;
mod simulation;
mod storage;
mod store;
mod streams;
mod tenants;
mod tracks;
mod upgrade;
mod watches;
