//! The service as its clients and its operator meet it: REST, gRPC, streams, sessions, the command
//! line, and the store under them.

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
mod nearest;
mod network_casters;
mod networks;
mod odometry;
mod raw;
mod session_antennas;
mod sessions;
mod simulation;
mod store;
