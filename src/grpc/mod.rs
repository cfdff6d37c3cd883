//! Door: gRPC.
