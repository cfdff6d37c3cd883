//! The architecture as a test: who may name whom, and how long things may be.
