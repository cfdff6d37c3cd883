//! The integration tests, one binary: goldens on real data, doors, and the architecture itself.

mod data;
mod rinex;

mod evaluation;

mod tidy;
